# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of another data set, taken instead of new ones: ``--renders-of FOLDER``.

A render is the scene's light, before any camera: data sets that differ in exposures, response and camera
alone have the same ones.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import exr, folder
from .errors import ConflictError, DamagedFileError
from .plan import Shot

#: Options that do not change a render.
FREE = frozenset({"camera", "crf", "response", "exposures", "test_truth", "reference_samples"})


@dataclass(frozen=True)
class Renders:
    """The renders of a data set, finished or not."""

    root: Path

    def has(self, shot: Shot) -> bool:
        return (self.root / shot.passes).exists()

    def copy(self, shot: Shot, out: Path) -> None:
        """Put the pose's render where ``out`` has it.

        Raises:
            DamagedFileError: it is not whole.
            OutputFolderError: the disk is full.
        """
        exr.read_channels(self.root / shot.passes)  # else the copy would be blamed
        folder.write(out / shot.passes, folder.read(self.root / shot.passes))


def opened(root: Path, asked: dict[str, Any], maker: dict[str, str]) -> Renders:
    """
    ``asked``: what is remembered of the options of the data set that is made; ``maker``: who makes it.

    Raises:
        DamagedFileError: there is no data set, or its description cannot be read.
        ConflictError: it was rendered otherwise.
    """
    content = folder.read_description(root)
    there = content.get("options")
    if not isinstance(there, dict) or content.get("generator") != maker:
        raise DamagedFileError(f"'{root}' was not rendered by this program: choose another --renders-of")
    differing = [
        name for name in {**asked, **there} if name not in FREE and asked.get(name) != there.get(name)
    ]
    if differing:
        raise ConflictError(
            f"'{root}' was rendered with other options ({', '.join(differing):.200})",
            "only exposures, response and camera may differ from those of --renders-of",
        )
    return Renders(root)
