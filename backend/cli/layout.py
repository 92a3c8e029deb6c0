# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare --layout``: a data set in a folder that nerfstudio, gsplat and other programs open."""

from dataclasses import dataclass
from typing import Any

from ...bridge.errors import BadValueError, OutputError
from ..runs.terminal import console
from ..scene import read_scene
from ..scene.capture.data_set import new_folder
from ..scene.for_others import How, LaidOut, Layout, lay_out
from .preparing import Preparing
from .told import progress


@dataclass(frozen=True, kw_only=True)
class LayoutOptions:
    """For other programs."""

    #: Write a data set of any layout that is read, for nerfstudio (transforms.json and a PLY of points) or as
    #: a COLMAP folder (gsplat, 3DGS), with pinhole cameras. docs/other-programs.md
    layout: Layout | None = None
    #: Which exposure, counted from 0, the shortest; default: the middle one.
    exposure: int | None = None
    #: All exposures: a frame each with its exposure_time (nerfstudio), or beside the model's pictures, which
    #: are of --exposure, with exposure.json (colmap).
    brackets: bool = False
    #: Hard links to pictures that need no change, where the disk allows it: no space, but one file for both.
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
            raise BadValueError("--exposure is of one picture a pose, --brackets of all", "Leave one out.")
        scene = read_scene(self.source, self.downscale)
        out = self.folder
        if out.is_dir() and any(out.iterdir()):
            raise OutputError(f"{out} is not empty", "Give a folder that is not there yet.")
        how = How(layout=self.layout, exposure=self.exposure, brackets=self.brackets, link=self.link)
        with new_folder(out, overwrite=False) as folder, progress("layout", "view", False) as show:
            said = lay_out(scene, folder, how, show)
        for line in _in_words(said):
            console.print(line, soft_wrap=True)
        console.print(f"wrote {out}", soft_wrap=True)
        return {"folder": str(out)}


def _in_words(said: LaidOut) -> list[str]:
    """What was written, and what was not."""
    views = ", ".join(f"{count} {split}" for split, count in said.views.items() if count)
    came = {"copied": said.copied, "linked": said.linked, "written anew": said.made}
    pictures = ", ".join(f"{count} {how}" for how, count in came.items() if count)
    return [f"views: {views}; pictures: {pictures}", *said.messages]
