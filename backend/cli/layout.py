# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare --layout``: writes a data set as a folder that nerfstudio, gsplat and others open."""

from dataclasses import dataclass
from typing import Any

from ...bridge.errors import BadValueError, OutputError
from ..runs.terminal import console
from ..scene import read_scene
from ..scene.capture.data_set import new_folder
from ..scene.for_others import How, LaidOut, Layout, lay_out
from .output import progress
from .preparing import Preparing


@dataclass(frozen=True, kw_only=True)
class LayoutOptions:
    """For other programs."""

    #: Convert a data set of any known layout for nerfstudio (transforms.json and a PLY of points) or to a
    #: COLMAP folder (gsplat, 3DGS), with pinhole cameras. docs/other-programs.md
    layout: Layout | None = None
    #: Which exposure, counted from 0, the shortest; default: the middle one.
    exposure: int | None = None
    #: All exposures: one frame each with its exposure_time (nerfstudio), or in addition to the model's
    #: pictures at --exposure, with exposure.json (colmap).
    brackets: bool = False
    #: Hard-link unchanged pictures where the disk allows it, which saves space but shares the files.
    link: bool = False


@dataclass(frozen=True, kw_only=True)
class LayOut(LayoutOptions, Preparing):
    """A data set in a new or empty folder, one exposure of each pose or the whole bracket."""

    downscale: float | None = None

    def work(self) -> dict[str, Any]:
        assert self.layout is not None
        if self.exposure is not None and self.exposure < 0:
            raise BadValueError(f"--exposure counts from 0, got {self.exposure}")
        if self.brackets and self.exposure is not None and self.layout == "nerfstudio":
            raise BadValueError("--exposure is one picture per pose, --brackets all", "Leave one out.")
        scene = read_scene(self.source, self.downscale)
        out = self.folder
        if out.is_dir() and any(out.iterdir()):
            raise OutputError(f"{out} is not empty", "Give a new folder.")
        how = How(layout=self.layout, exposure=self.exposure, brackets=self.brackets, link=self.link)
        with new_folder(out, overwrite=False) as folder, progress("layout", "view", False) as show:
            laid_out = lay_out(scene, folder, how, show)
        for line in _summary(laid_out):
            console.print(line, soft_wrap=True)
        console.print(f"wrote {out}", soft_wrap=True)
        return {"folder": str(out)}


def _summary(laid_out: LaidOut) -> list[str]:
    """What was written, and what was not."""
    views = ", ".join(f"{count} {split}" for split, count in laid_out.views.items() if count)
    counts = {"copied": laid_out.copied, "linked": laid_out.linked, "converted": laid_out.made}
    pictures = ", ".join(f"{count} {how}" for how, count in counts.items() if count)
    return [f"views: {views}; pictures: {pictures}", *laid_out.messages]
