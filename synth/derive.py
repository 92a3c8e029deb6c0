# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything of a pose that follows from its passes: true radiance, brackets, relit truth. Numpy alone."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bridge.data_set import HELD_OUT
from . import exr, folder
from .errors import DamagedFileError
from .options import Options
from .passes import Passes
from .plan import Shot
from .png import encode
from .response import Response


@dataclass(frozen=True)
class Derivation:
    """Writes what is missing of a pose's files. The same passes and options give the same bytes."""

    out: Path
    options: Options
    response: Response

    def missing(self, shot: Shot) -> list[str]:
        """Names of the files of a pose that are not there; the passes first if they are among them."""
        return [name for name in shot.files(len(self.options.bracket)) if not (self.out / name).exists()]

    def check(self, shot: Shot) -> None:
        """
        Raises:
            DamagedFileError: an EXR that is there is not whole, or of another size.
        """
        width, height = self.options.resolution
        for name in (shot.hdr, *(shot.relit_hdr(light) for light in shot.relit)):
            path = self.out / name
            if path.exists():
                shape = exr.read(path).shape
                if shape != (height, width, 3):
                    raise DamagedFileError(
                        f"'{path}' is {shape[1]} × {shape[0]}, not {width} × {height}: "
                        "delete it and run again"
                    )

    def write(self, shot: Shot, passes: Passes) -> None:
        """Make what is missing.

        Raises:
            OutputFolderError: the disk is full.
        """
        missing = set(self.missing(shot))
        radiance = passes.radiance(shot.levels)
        if shot.hdr in missing:
            folder.write(self.out / shot.hdr, exr.encode_rgb(radiance))
        model = self.options.camera.systematic if shot.split in HELD_OUT else self.options.camera
        camera = model.view(self.options.seed, shot.stem)
        light = radiance.astype(np.float64)
        for k, exposure in enumerate(self.options.bracket):
            if shot.bracket(k) in missing:
                picture = encode(camera.develop(light, exposure, self.response))
                folder.write(self.out / shot.bracket(k), picture)
        for setting in shot.relit:
            if shot.relit_hdr(setting) in missing:
                relit = exr.encode_rgb(passes.radiance(setting.levels))
                folder.write(self.out / shot.relit_hdr(setting), relit)
