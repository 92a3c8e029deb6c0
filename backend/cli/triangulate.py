# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare --triangulate``: points by structure from motion in a data set's training pictures."""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ...bridge.errors import OutputError
from ...bridge.limits import THREADS_MAX, whole
from ...bridge.regular import resolved
from ..runs.files import writable_folder
from ..runs.terminal import console
from ..scene import read_scene
from ..scene.capture.structure import require_pycolmap
from ..scene.capture.triangulate import Triangulated, is_ours, triangulate, write_points
from ..shell import as_word
from ..train.config import TrainConfig
from ..train.forecast.size import sized
from ..train.views import training_exposures
from .preparing import Preparing

#: The file of points in the data set's folder.
SFM_FILE = "points3d_sfm.ply"


@dataclass(frozen=True, kw_only=True)
class PointOptions:
    """Points."""

    #: Find points for a data set of any known layout from its cameras: features of training pictures are
    #: matched and triangulated. As in a capture, points are sparse, with outliers and gaps.
    triangulate: bool = False
    #: Indices of the exposures to use, each matched by itself. Default: those that training uses; of
    #: photographs all.
    training_exposures: tuple[int, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class Triangulate(PointOptions, Preparing):
    """Find a data set's points by structure from motion (COLMAP). No pixel of a test view is read."""

    overwrite: bool = False
    threads: int = -1

    def work(self) -> dict[str, Any]:
        out = self.destination or self.source / SFM_FILE
        self._check(out)
        require_pycolmap("'physhdr prepare --triangulate' finds points")
        scene = read_scene(self.source, downscale=1.0)
        seen = TrainConfig()
        if self.training_exposures is None:
            seen, _ = sized(scene, seen)
        else:
            seen = replace(seen, training_exposures=self.training_exposures)
        exposures = [training_exposures(view, seen) for view in scene.train]
        with (
            TemporaryDirectory(prefix="physhdr-triangulate-", ignore_cleanup_errors=True) as work,
            console.status("") as status,
        ):

            def say(step: str) -> None:
                status.update(f"COLMAP: {step}")
                if not console.is_terminal:
                    console.print(f"COLMAP: {step}")

            points = triangulate(scene.train, exposures, Path(work), self.threads, say)
        write_points(out, points)
        self._report(out, points)
        return {"points": len(points.positions), "file": str(out)}

    def _check(self, out: Path) -> None:
        """Raises ``OutputError`` early if ``out`` must not or cannot be written."""
        whole("--threads", self.threads, -1, THREADS_MAX)
        if out.exists() and not self.overwrite:
            raise OutputError(f"{out} already exists", "Give another --out, or --overwrite to replace it.")
        if out.exists() and not is_ours(out):
            raise OutputError(
                f"not replacing {out}: it was not made by 'physhdr prepare --triangulate'",
                "Give another --out.",
            )
        if self.source.is_dir():  # else its reader reports the fault
            writable_folder(out.parent)

    def _report(self, out: Path, points: Triangulated) -> None:
        console.print(
            f"wrote {out}: {len(points.positions):,} points by COLMAP {points.words}, each seen in "
            f"{points.views.mean():.1f} on average; reprojection error {points.errors.mean():.2f} pixels",
            soft_wrap=True,
        )
        inside = resolved(out).is_relative_to(resolved(self.source))
        name = resolved(out).relative_to(resolved(self.source)) if inside else resolved(out)
        console.print(f"next: physhdr train {as_word(self.source)} --out RUN --points-file {as_word(name)}")
