# SPDX-License-Identifier: GPL-3.0-or-later
"""What one render of one pose gives: the light of each group alone, and the geometry; as an EXR file.

Light transport is linear in each light, so the picture under any levels is Σ light × level: exact, and no
second render. Layers of the file: ``<light>.R/.G/.B``, ``depth.V``, ``normal.X/.Y/.Z``, ``index.V``,
``samples.V`` (docs/formats.md).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..bridge import data_set
from . import exr, folder
from .errors import DamagedFileError

#: The text of the file's header that holds ``Passes.facts``.
FACTS = "physhdr"
PLANES = ("depth", "index", "samples")
#: Names that no light may have: those of other layers, and that of the ambient light's levels in folders.
RESERVED = {*PLANES, "normal", data_set.LEVEL}
AXES = "XYZ"
#: Where no surface is seen Cycles gives this depth.
SKY = 1e10


@dataclass(frozen=True, eq=False)
class Passes:
    """One pose. All float32, top row first, working space Linear Rec.709."""

    #: Light → radiance [height, width, 3] that it alone causes, at level 1.
    lights: dict[str, np.ndarray]
    #: [height, width] metres along the camera's axis of the pixel's first sample; 1e10 where there is sky.
    depth: np.ndarray
    #: [height, width, 3] in world space, mean over the pixel.
    normal: np.ndarray
    #: [height, width] number (dataset.json ``objects``) of what the pixel's first sample hit; 0: none.
    index: np.ndarray
    #: [height, width] samples taken.
    samples: np.ndarray
    #: ``seed``, ``samples`` (mean a pixel), ``noise_psnr`` (dB, noise.estimate).
    facts: dict[str, Any]
    #: [height, width, 3] radiance of all lights before denoising: of a new render; it is not written.
    raw: np.ndarray | None = None

    def radiance(self, levels: Mapping[str, float]) -> np.ndarray:
        """Radiance [height, width, 3] float32 with each light at its level; those not named are at 1."""
        total = np.zeros(self.normal.shape, np.float64)
        for name, light in self.lights.items():
            total += light.astype(np.float64) * levels.get(name, 1.0)
        return total.astype(np.float32)


def encode(passes: Passes) -> bytes:
    """The EXR file; the same passes give the same bytes."""
    channels = {
        f"{name}.{colour}": light[..., k]
        for name, light in passes.lights.items()
        for k, colour in enumerate("RGB")
    }
    channels |= {f"{name}.V": getattr(passes, name) for name in PLANES}
    channels |= {f"normal.{axis}": passes.normal[..., k] for k, axis in enumerate(AXES)}
    return exr.encode(channels, {FACTS: json.dumps(passes.facts, sort_keys=True)})


def write(path: Path, passes: Passes) -> None:
    """Under a temporary name, then renamed: the file that is there is whole."""
    folder.write(path, encode(passes))


def read(path: Path, lights: Sequence[str], size: tuple[int, int]) -> Passes:
    """The passes of ``lights``, in that order, of a file that ``write`` made. ``size``: width, height.

    Raises:
        DamagedFileError: not whole, other lights, another size.
        NotFiniteError: it has values that are not finite.
    """
    channels, texts = exr.read_channels(path)
    remedy = "delete it and run again to render it anew"
    wanted = {f"{name}.{colour}" for name in lights for colour in "RGB"}
    wanted |= {f"{name}.V" for name in PLANES} | {f"normal.{axis}" for axis in AXES}
    if channels.keys() != wanted:
        odd = ", ".join(sorted(channels.keys() ^ wanted))
        raise DamagedFileError(f"'{path}' does not hold the passes of this scene ({odd}): {remedy}")
    height, width = channels["depth.V"].shape
    if (width, height) != size:
        raise DamagedFileError(f"'{path}' is {width} × {height}, not {size[0]} × {size[1]}: {remedy}")
    try:
        facts = json.loads(texts[FACTS])
    except (KeyError, ValueError) as error:
        raise DamagedFileError(f"'{path}' is damaged (no facts in its header): {remedy}") from error
    return Passes(
        {name: np.stack([channels[f"{name}.{colour}"] for colour in "RGB"], -1) for name in lights},
        normal=np.stack([channels[f"normal.{axis}"] for axis in AXES], -1),
        facts=facts,
        **{name: channels[f"{name}.V"] for name in PLANES},
    )
