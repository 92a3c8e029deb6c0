# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr calibrate``: save a camera's response and vignetting from a run, for its next capture."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from ...bridge.errors import DataMismatchError
from ..runs.run import open_run
from ..runs.terminal import console
from ..train.calibration import calibration_of, write_calibration
from ..train.saver import learned_of_photographs


@dataclass(frozen=True)
class Calibrate:
    """Write a camera's response and its lens's vignetting, for physhdr train --calibration FILE."""

    #: Folder of a trained run.
    folder: tyro.conf.Positional[Path]
    #: The file to write (JSON).
    out: Path
    #: The data set, where it has moved since training.
    data: Path | None = None

    def run(self) -> int:
        run = open_run(self.folder, self.data)
        (vignetting, reach), _ = learned_of_photographs(self.folder)
        calibration = calibration_of(run.method, vignetting, reach, run.scene.name)
        if calibration.response is None and calibration.vignetting is None:
            raise DataMismatchError(
                f"{self.folder} has learned nothing about its camera: the response of its pictures was known",
                "Train with --nuisances on, which learns the vignetting.",
            )
        write_calibration(self.out, calibration)
        parts = [
            *(["the response"] if calibration.response is not None else []),
            *(["the vignetting"] if calibration.vignetting is not None else []),
        ]
        console.print(f"wrote {self.out}: {' and '.join(parts)} of {calibration.origin}", soft_wrap=True)
        return 0
