# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture: what a photographer's places in a scene show through one lens, before any photo is taken.

    capture.json                what was asked for, the lens, and the camera of each place
    passes/place_007.exr        light and geometry as the lens shows it (synth/passes.py)
    pinhole/place_007.exr       the same without the lens' distortion, of places that are for testing

Not the layout of data sets: a program that reads that would take the pictures for a pinhole's. Numpy alone,
so that photos can be taken where there is no Blender (lab/tools/take_photos.py).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import folder, passes
from .errors import ConflictError, DamagedFileError, OutputFolderError
from .lens import Lens
from .passes import Passes

FORMAT, VERSION = "physhdr-rendered-capture", 1
CAPTURE_FILE = "capture.json"


@dataclass(frozen=True, eq=False)
class Place:
    """Where the camera stood once."""

    index: int
    #: Camera to world [4, 4], Blender's axes.
    pose: np.ndarray
    #: Whether it is one that is not trained on.
    test: bool

    @property
    def name(self) -> str:
        return f"place_{self.index:03d}"


@dataclass(frozen=True, eq=False)
class Capture:
    """A capture's folder."""

    root: Path
    #: What the renders were asked for: equal options give equal renders.
    options: dict[str, Any]
    lens: Lens
    #: The same without distortion.
    pinhole: Lens
    lights: tuple[str, ...]
    places: tuple[Place, ...]

    def file(self, place: Place, pinhole: bool = False) -> Path:
        return self.root / ("pinhole" if pinhole else "passes") / f"{place.name}.exr"

    def passes(self, place: Place, pinhole: bool = False) -> Passes:
        """Raises ``DamagedFileError`` where it has not been rendered, or not whole."""
        size = self.lens.width, self.lens.height
        return passes.read(self.file(place, pinhole), self.lights, size)

    def enter(self) -> None:
        """Make the folder, or see that it is of the same capture.

        Raises:
            ConflictError: of another one.
            OutputFolderError: it holds something else, or cannot be written.
        """
        path = self.root / CAPTURE_FILE
        if path.exists():
            there = opened(self.root)
            if there.options != self.options:
                differing = [key for key in self.options if there.options.get(key) != self.options[key]]
                raise ConflictError(
                    f"'{self.root}' was rendered with other options ({', '.join(differing)})",
                    "choose another folder (--out; nothing was changed)",
                )
            return
        if self.root.exists() and any(not entry.name.startswith(".") for entry in self.root.iterdir()):
            raise OutputFolderError(f"'{self.root}' holds files but no {CAPTURE_FILE}", "choose a new folder")
        content = {
            "format": FORMAT,
            "version": VERSION,
            "options": self.options,
            "lens": self.lens.describe(),
            "lights": list(self.lights),
            "places": [
                {"name": place.name, "test": place.test, "camera_to_world": place.pose.tolist()}
                for place in self.places
            ],
        }
        folder.write_json(path, content)


def opened(root: Path) -> Capture:
    """The capture in a folder, complete or not.

    Raises:
        DamagedFileError: there is none, or its description cannot be read.
    """
    content = folder.read_json(root / CAPTURE_FILE)
    if (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise DamagedFileError(f"'{root / CAPTURE_FILE}' is not of a capture that this program rendered")
    try:
        lens = Lens.described(content["lens"])
        places = tuple(
            Place(k, np.array(entry["camera_to_world"], np.float64).reshape(4, 4), bool(entry["test"]))
            for k, entry in enumerate(content["places"])
        )
        return Capture(root, content["options"], lens, lens.straight, tuple(content["lights"]), places)
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(f"'{root / CAPTURE_FILE}' is damaged ({error!s:.200})") from error
