# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr layout``: a data set in a folder that nerfstudio, gsplat and other programs open."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from ...bridge.errors import BadValueError, OutputError
from ..runs.terminal import console
from ..scene import read_scene
from ..scene.capture.data_set import new_folder
from ..scene.for_others import How, LaidOut, Layout, lay_out
from .told import progress


@dataclass(frozen=True)
class LayOut:
    """Write a data set of any layout as nerfstudio's transforms.json or as a COLMAP folder (gsplat, 3DGS).

    Cameras are pinholes, pictures have plain names, one exposure of each pose or the whole bracket.
    docs/other-programs.md says what each program must be told.
    """

    #: Folder of the data set, of any layout that physhdr train reads.
    data: tyro.conf.Positional[Path]
    #: The folder to write: new, or empty.
    out: tyro.conf.Positional[Path]
    #: nerfstudio: transforms.json and a PLY of points. colmap: sparse/0, binary.
    layout: Layout
    #: Which exposure, counted from 0, the shortest; default: the middle one.
    exposure: int | None = None
    #: All exposures: a frame each with its exposure_time (nerfstudio), or beside the model's pictures, which
    #: are of --exposure, with exposure.json (colmap).
    brackets: bool = False
    #: How many times smaller on each side; default: as training reads the data set.
    downscale: float | None = None
    #: Hard links to pictures that need no change, where the disk allows it: no space, but one file for both.
    link: bool = False

    def run(self) -> int:
        if self.exposure is not None and self.exposure < 0:
            raise BadValueError(f"--exposure counts from 0, got {self.exposure}")
        if self.brackets and self.exposure is not None and self.layout == "nerfstudio":
            raise BadValueError("--exposure is of one picture a pose, --brackets of all", "Leave one out.")
        scene = read_scene(self.data, self.downscale)
        if self.out.is_dir() and any(self.out.iterdir()):
            raise OutputError(f"{self.out} is not empty", "Give a folder that is not there yet.")
        how = How(layout=self.layout, exposure=self.exposure, brackets=self.brackets, link=self.link)
        with new_folder(self.out, overwrite=False) as folder, progress("layout", "view", False) as show:
            said = lay_out(scene, folder, how, show)
        for line in _in_words(said):
            console.print(line, soft_wrap=True)
        console.print(f"wrote {self.out}", soft_wrap=True)
        return 0


def _in_words(said: LaidOut) -> list[str]:
    """What was written, and what was not."""
    views = ", ".join(f"{count} {split}" for split, count in said.views.items() if count)
    came = {"copied": said.copied, "linked": said.linked, "written anew": said.made}
    pictures = ", ".join(f"{count} {how}" for how, count in came.items() if count)
    return [f"views: {views}; pictures: {pictures}", *said.messages]
