# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``physhdr export`` writes, a row a format: the suffix decides. What it reads stands in
``bridge/splat_files/reading.py``, where each format is known by its first bytes.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...bridge.axes import Up
from ...bridge.errors import BadValueError
from ...bridge.model_file import SUFFIX

#: What a format's colours are: as a screen shows them, scene-linear radiance, or a relightable model.
Holds = Literal["display", "radiance", "model"]


@dataclass(frozen=True)
class Target:
    """A format that is written."""

    name: str
    #: In lower case, with dots.
    suffixes: tuple[str, ...]
    holds: Holds
    #: Which way is up, where nobody asks for another, and what else the format could say or bear.
    up: Up
    ups: tuple[Up, ...]
    #: What of a model is lost in it.
    loses: str


_LOOK = "HDR, lights, response and confidence are not in it: one look"
_SPZ_STEPS = "in steps: colours of 1/136, opacity of 1/255, σ of 6 %, higher SH of 1/16 and 1/8"
TARGETS = (
    Target("PLY", (".ply",), "display", "z", ("z", "y", "colmap"), _LOOK),
    Target("SPZ", (".spz",), "display", "y", ("z", "y", "colmap"), f"{_LOOK}, {_SPZ_STEPS}"),
    Target("glTF", (".glb", ".gltf"), "display", "y", ("z", "y", "colmap"), _LOOK),
    Target(
        "USD",
        (".usdc", ".usda", ".usd", ".usdz"),
        "radiance",
        "z",
        ("z", "y"),
        "lights, response and confidence are not in it: the radiance of one light",
    ),
    Target("PhysHDR model", (SUFFIX,), "model", "z", ("z",), ""),
)
#: Suffixes that are read and not written, and what may be written instead.
_READ_ONLY = {".sog": ".spz", ".splat": ".spz", ".ksplat": ".spz", ".json": ".spz", ".csv": ".ply"}


def target_of(path: Path) -> Target:
    """The format that a file's name asks for; raises ``BadValueError`` naming those there are."""
    name = path.name.lower()
    if name.endswith(".compressed.ply"):
        raise BadValueError(f"{path}: compressed PLY can be read, not written", "Write .spz, or plain .ply.")
    for target in TARGETS:
        if name.endswith(target.suffixes):
            return target
    suffix = path.suffix.lower()
    if suffix in _READ_ONLY:
        raise BadValueError(
            f"{path}: {suffix} can be read, not written",
            f"Write {_READ_ONLY[suffix]}, and convert that with splat-transform or SuperSplat.",
        )
    known = ", ".join(each for target in TARGETS for each in target.suffixes)
    raise BadValueError(
        f"{path}: '{suffix}' is not a format that can be written", f"Its name must end in: {known}."
    )
