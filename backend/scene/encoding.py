# SPDX-License-Identifier: GPL-3.0-or-later
"""How a picture's codes follow from exposure × radiance: by a camera's unknown response, or by a known curve.

A picture is integers ``[H, W, 3]`` of 8 or 16 bits; its *values* are codes over the code that stands for 1
(``Encoding.unit``), and a loss compares values. A camera's response is learned. The others are known: such a
picture's exposure × radiance needs no learning, and the same curve, which is differentiable
(``developed``), makes of rendered radiance what it is compared with.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch

from ...bridge import srgb
from ...bridge.errors import BadValueError

#: The largest codes of 8 and of 16 bits.
LARGEST = {np.dtype(np.uint8): 255, np.dtype(np.uint16): 65535}
#: μ of ``LogEncoding``: that of the HDR protocol's μ-law. The curve is nearly a logarithm above scale / μ.
MU = 5000.0
#: Exposure × radiance (white is about 1) below which nothing is distinguished, and how much brighter than
#: white the model may make what is white even in its shortest exposure.
DARKEST_SEEN, BRIGHTEST_CLIPPED = 1.0 / 5000.0, 200.0
#: The largest value that codes of ``LogEncoding`` hold: there x / scale is (1 + μ)² / μ, which is 12 stops.
REACH = 2.0


@dataclass(frozen=True)
class Encoding(ABC):
    """One of ``CAMERA``, ``SRGB`` and ``LogEncoding(scale)``; equal ones compare equal."""

    @property
    def is_known(self) -> bool:
        """Whether codes give exposure × radiance without a learned response."""
        return True

    @property
    def clips(self) -> bool:
        """Whether the largest code means "at least this much"."""
        return True

    @property
    def span(self) -> tuple[float, float]:
        """Least and greatest exposure × radiance that training should be able to render for such pictures.

        How bright clipped areas are shows in another exposure, or stays unknown.
        """
        return DARKEST_SEEN, BRIGHTEST_CLIPPED

    def unit(self, dtype: np.dtype) -> float:
        """The code that stands for the value 1, where codes are uint8 or uint16."""
        return float(LARGEST[np.dtype(dtype)])

    @abstractmethod
    def encode(self, exposed: np.ndarray) -> np.ndarray:
        """Values of exposure × radiance, float64 of any shape; values below 0 become 0."""

    @abstractmethod
    def decode(self, values: np.ndarray) -> np.ndarray:
        """Exposure × radiance of values, float64 of any shape."""

    @abstractmethod
    def developed(self, exposed: torch.Tensor) -> torch.Tensor:
        """``encode`` of a tensor of any shape, differentiable; where it clips the gradient is 0."""

    def towards(self, exposed: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        """``developed`` for a loss that compares it with a picture's ``values``, of the same shape.

        Where the picture itself does not clip, the curve continues above white: what is rendered too bright
        must find its way back, and a clipped prediction would have no gradient.
        """
        return self.developed(exposed)

    @abstractmethod
    def __str__(self) -> str:
        """A few words for a report."""

    def codes(self, exposed: np.ndarray) -> np.ndarray:
        """Exposure × radiance → uint16 codes of the same shape."""
        unit = self.unit(np.dtype(np.uint16))
        return np.rint(self.encode(exposed) * unit).clip(0, 65535).astype(np.uint16)

    def exposed(self, codes: np.ndarray) -> np.ndarray:
        """Exposure × radiance, float64, of uint8 or uint16 codes."""
        return self.decode(codes / self.unit(codes.dtype))


@dataclass(frozen=True)
class CameraEncoding(Encoding):
    """An unknown response: it is learned."""

    @property
    def is_known(self) -> bool:
        return False

    def encode(self, exposed: np.ndarray) -> np.ndarray:
        raise self._unknown()

    def decode(self, values: np.ndarray) -> np.ndarray:
        raise self._unknown()

    def developed(self, exposed: torch.Tensor) -> torch.Tensor:
        raise self._unknown()

    def __str__(self) -> str:
        return "a camera's own response"

    @staticmethod
    def _unknown() -> BadValueError:
        return BadValueError("a camera's response is unknown: it has to be learned")


@dataclass(frozen=True)
class SrgbEncoding(Encoding):
    """Scene-linear pictures that clip at 1 (raw developments), encoded by the sRGB curve."""

    def encode(self, exposed: np.ndarray) -> np.ndarray:
        return srgb.to_srgb(np.asarray(exposed, np.float64).clip(0.0, 1.0))

    def decode(self, values: np.ndarray) -> np.ndarray:
        return srgb.to_linear(np.asarray(values, np.float64))

    def developed(self, exposed: torch.Tensor) -> torch.Tensor:
        return self._curve(exposed.clamp(0.0, 1.0))

    def towards(self, exposed: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        open_ended = self._curve(exposed.clamp_min(0.0))
        return torch.where(values < 1.0, open_ended, open_ended.clamp_max(1.0))

    @staticmethod
    def _curve(linear: torch.Tensor) -> torch.Tensor:
        power = srgb.SCALE * linear.clamp_min(srgb.LINEAR_KNEE) ** (1.0 / srgb.POWER) - srgb.OFFSET
        return torch.where(linear <= srgb.LINEAR_KNEE, linear * srgb.SLOPE, power)

    def __str__(self) -> str:
        return "the sRGB curve of scene-linear values, clipped at 1"


@dataclass(frozen=True)
class LogEncoding(Encoding):
    """Radiance (OpenEXR, .hdr): ln(1 + μ x / scale) / ln(1 + μ). Up to 5000 times ``scale`` nothing clips.

    ``scale``: the exposure × radiance whose value is 1, one for all pictures of a data set.
    """

    scale: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise BadValueError(f"the scale of a logarithmic encoding must be above 0, got {self.scale:g}")

    @property
    def clips(self) -> bool:
        return False

    @property
    def span(self) -> tuple[float, float]:
        return self.scale * DARKEST_SEEN, float(self.decode(np.array(REACH)))

    def unit(self, dtype: np.dtype) -> float:
        return super().unit(dtype) / REACH

    def encode(self, exposed: np.ndarray) -> np.ndarray:
        relative = np.maximum(np.asarray(exposed, np.float64), 0.0) / self.scale
        return np.log1p(MU * relative) / math.log1p(MU)

    def decode(self, values: np.ndarray) -> np.ndarray:
        return np.expm1(np.asarray(values, np.float64) * math.log1p(MU)) * (self.scale / MU)

    def developed(self, exposed: torch.Tensor) -> torch.Tensor:
        return (exposed.clamp_min(0.0) * (MU / self.scale)).log1p() / math.log1p(MU)

    def __str__(self) -> str:
        return f"radiance, compared as ln(1 + {MU:g} x / {self.scale:.4g}) / ln({1.0 + MU:g})"


def eight_bits(codes: np.ndarray) -> np.ndarray:
    """uint8 codes of uint8 or uint16 ones: the nearest."""
    if codes.dtype == np.uint8:
        return codes
    return ((codes.astype(np.uint32) + 128) // 257).astype(np.uint8)


CAMERA = CameraEncoding()
SRGB = SrgbEncoding()
