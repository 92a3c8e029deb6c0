# SPDX-License-Identifier: GPL-3.0-or-later
"""LPIPS v0.1 with AlexNet (Zhang et al. 2018), rewritten because no package offers it without torchvision.

We may not ship the weights: the user gives the path of an ``.npz`` with AlexNet's five convolutions
(``conv{0,3,6,8,10}.weight/.bias``) and the five linear heads (``lin0`` … ``lin4``).
"""

from pathlib import Path

import numpy as np
import torch
from torch.nn import functional

from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.regular import damaged_where_it_fails, regular_file

#: (name, stride, padding, max-pooled before) of AlexNet's convolutions, torchvision's numbering.
LAYERS = (("conv0", 4, 2, False), ("conv3", 1, 2, True), ("conv6", 1, 1, True), ("conv8", 1, 1, False))
LAYERS += (("conv10", 1, 1, False),)
#: Output and input channels and the side of each convolution's weight.
SHAPES = {"conv0": (64, 3, 11), "conv3": (192, 64, 5), "conv6": (384, 192, 3), "conv8": (256, 384, 3)}
SHAPES["conv10"] = (256, 256, 3)
#: Maximum bytes of an array, unpacked; the largest of these has 3.5 million.
LARGEST_ARRAY = 1 << 26
#: ImageNet's mean and deviation, as LPIPS states them for inputs in −1…1.
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
#: Smaller pictures vanish in the second pooling.
SMALLEST_SIDE = 31
EPSILON = 1e-10  # of the original's unit normalisation


class Lpips:
    """The distance of two pictures on the CPU: 0 for equal ones."""

    def __init__(self, weights: dict[str, torch.Tensor]) -> None:
        self._weights = weights

    @classmethod
    def from_file(cls, path: Path) -> "Lpips":
        """Load the weights; raises ``FileMissingError`` or ``FileDamagedError``."""
        path = Path(path)
        remedy = "Give the path of lpips_alex_v0.1_float32.npz, or none to skip LPIPS."
        if not path.exists():
            raise FileMissingError(f"the LPIPS weights {path} are missing", remedy)
        regular_file(path, remedy)
        shapes: dict[str, tuple[int, ...]] = {}
        for i, (name, (wide, deep, side)) in enumerate(SHAPES.items()):
            shapes |= {
                f"{name}.weight": (wide, deep, side, side),
                f"{name}.bias": (wide,),
                f"lin{i}": (wide,),
            }
        what = f"{path} does not hold the weights of LPIPS"
        arrays = {}
        with damaged_where_it_fails(what, remedy), np.load(path, allow_pickle=False) as file:
            large = [member.filename for member in file.zip.infolist() if member.file_size > LARGEST_ARRAY]
            if large:
                raise ValueError(f"{large[0]} has more than {LARGEST_ARRAY} bytes")
            for name, shape in shapes.items():
                # The heads are [1, C, 1, 1] in the original.
                arrays[name] = np.asarray(file[name], np.float32).reshape(shape)
        odd = [name for name, array in arrays.items() if not np.isfinite(array).all()]
        if odd:
            raise FileDamagedError(f"{what} ({odd[0]} holds NaN or infinity)", remedy)
        return cls({name: torch.from_numpy(array) for name, array in arrays.items()})

    def both(self, picture: torch.Tensor, truth: torch.Tensor) -> tuple[float, float]:
        """``lpips`` and ``lpips_01`` of ``[3, H, W]`` pictures in 0…1.

        The former scales them to −1…1, as LPIPS is defined; the latter takes 0…1 directly, as 3DGS, GaussHDR
        and the paper do, and is lower. One pass is a sixth faster than two. Raises ``BadValueError`` if the
        pictures are too small.
        """
        pictures = torch.stack([picture, truth])
        canonical, unscaled = self._distances(torch.cat([2.0 * pictures - 1.0, pictures]))
        return canonical, unscaled

    @torch.no_grad()
    def _distances(self, x: torch.Tensor) -> list[float]:
        """The distances of the pairs in ``[2 P, 3, H, W]``: of the first two, of the next two and so on."""
        if min(x.shape[2:]) < SMALLEST_SIDE:
            raise BadValueError(
                f"LPIPS needs pictures of at least {SMALLEST_SIDE} pixels a side, got {tuple(x.shape[1:])}",
                "Use a higher resolution, or skip LPIPS.",
            )
        x = x.to(torch.float32)
        x = (x - x.new_tensor(SHIFT).view(1, 3, 1, 1)) / x.new_tensor(SCALE).view(1, 3, 1, 1)
        distances = x.new_zeros(len(x) // 2)
        for i, (name, stride, padding, pooled) in enumerate(LAYERS):
            if pooled:
                x = functional.max_pool2d(x, 3, 2)
            weight, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
            x = functional.relu(functional.conv2d(x, weight, bias, stride, padding))
            unit = x / (x.square().sum(dim=1, keepdim=True).sqrt() + EPSILON)
            difference = (unit[0::2] - unit[1::2]).square().mean(dim=(2, 3))
            distances = distances + difference @ self._weights[f"lin{i}"].flatten()
        return distances.tolist()
