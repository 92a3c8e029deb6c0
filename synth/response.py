# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera responses: exposure × radiance (scene-linear, ≥ 0) → code value 0…1, each channel by itself."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bridge.srgb import to_srgb
from . import folder
from .errors import DamagedFileError, ResponseFileError, UnknownNameError

#: Above this, code value 1 is not a good anchor: its slope no longer determines the scale.
SATURATED = 0.95
#: The least code value that 8 bits do not round to black; as far below 1 it is not rounded to white.
BLACK = 0.5 / 255
MIDDLE_GREY = 0.18


@dataclass(frozen=True)
class Response:
    """A camera's curve. ``curve`` holds (exposure × radiance, code) pairs if it came from a file."""

    name: str
    function: Callable[[np.ndarray], np.ndarray]
    curve: list[list[float]] | None = None

    def __call__(self, exposed: np.ndarray) -> np.ndarray:
        """Code values in 0…1, float64, of exposure × radiance of any shape."""
        return np.clip(self.function(np.maximum(np.asarray(exposed, np.float64), 0.0)), 0.0, 1.0)

    def anchor(self) -> list[float]:
        """One known point [exposure × radiance, code] that pictures show: neither black nor white.

        At 1, or at middle grey where 1 is (nearly) white. A curve from a file may have x in another unit:
        where both points are lost, the anchor is where its code is nearest to 0.5. A curve that never shows
        anything between black and white has none: its code here is 0 or 1.
        """
        at_one, at_grey = (float(self(np.array(x))) for x in (1.0, MIDDLE_GREY))
        if _is_shown(at_one) and at_one < SATURATED:
            return [1.0, at_one]
        if _is_shown(at_grey) or self.curve is None:
            return [MIDDLE_GREY, at_grey]
        x = np.unique([0.0, *(pair[0] for pair in self.curve)])
        tried = np.unique([np.interp(0.5, self(x), x), *(x[1:] + x[:-1]) / 2, *x])[1:]  # but not 0
        middle = tried[np.abs(self(tried) - 0.5).argmin()]
        return [float(middle), float(self(middle))]

    def describe(self) -> dict[str, object]:
        """The ``response`` entry of dataset.json."""
        entry: dict[str, object] = {"name": self.name, "anchor": self.anchor()}
        if self.curve is not None:
            entry["curve"] = self.curve
        return entry


def _is_shown(code: float) -> bool:
    return BLACK <= code < 1.0 - BLACK


def reinhard_gamma(exposed: np.ndarray) -> np.ndarray:
    """(x / (1 + x))^(1 / 2.2): HDR-NeRF's synthetic camera (f(1) = 0.7297)."""
    return (exposed / (1.0 + exposed)) ** (1.0 / 2.2)


def srgb(exposed: np.ndarray) -> np.ndarray:
    """The sRGB curve, clipped at 1."""
    return to_srgb(np.minimum(exposed, 1.0))


def filmic(exposed: np.ndarray) -> np.ndarray:
    """The neutral axis of Blender's Filmic (look *Medium Contrast*), applied to each channel by itself.

    Tabulated at every half stop from Blender 5.2's own output; linear in log2(x) between the knots.
    """
    with np.errstate(divide="ignore"):
        stops = np.log2(np.maximum(exposed, 0.0))
    return np.interp(stops, FILMIC_STOPS, FILMIC_CODES)


FILMIC_STOPS = np.arange(-12.5, 4.75, 0.5)
# fmt: off
FILMIC_CODES = np.array([
    0, 0.0018, 0.00417, 0.00719, 0.01102, 0.01587, 0.02199,
    0.02969, 0.03938, 0.05151, 0.06661, 0.08527, 0.10817, 0.136,
    0.16944, 0.20903, 0.2551, 0.30764, 0.36617, 0.42969, 0.49667,
    0.56423, 0.63102, 0.69496, 0.75415, 0.80723, 0.85336, 0.89227,
    0.9241, 0.94939, 0.96881, 0.98315, 0.99322, 0.99974, 1,
])
# fmt: on

BUILT_IN: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "reinhard-gamma": reinhard_gamma,
    "srgb": srgb,
    "filmic": filmic,
}


def from_file(path: Path) -> Response:
    """A measured curve: JSON ``[[x, code], …]``, or text with two numbers a line (``#`` starts a comment).

    x (exposure × radiance) and code rise; between points the curve is linear in x, below the first it goes
    to 0 at x = 0, above the last it stays.

    Raises:
        ResponseFileError: unreadable, fewer than two points, negative, not rising, or all black or white.
    """
    try:
        text = folder.read(path).decode("utf-8-sig")  # Windows' editors begin with a mark
    except (DamagedFileError, UnicodeDecodeError) as error:
        raise ResponseFileError(f"cannot read the response file '{path}': {error}") from error
    try:
        if path.suffix.lower() == ".json":
            points = np.array(json.loads(text), np.float64)
        else:
            rows = [line.split("#")[0].replace(",", " ").split() for line in text.splitlines()]
            points = np.array([[float(value) for value in row] for row in rows if row], np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ResponseFileError(
            f"response file '{path}' is not a list of number pairs: {error!s:.200}"
        ) from error
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ResponseFileError(
            f"response file '{path}' must hold at least two pairs: exposure × radiance, code 0…1"
        )
    x, code = points.T
    if x[0] < 0 or (np.diff(x) <= 0).any() or (np.diff(code) < 0).any() or code[0] < 0 or code[-1] > 1:
        raise ResponseFileError(
            f"response file '{path}': both columns must rise, from 0 upward, codes within 0…1"
        )
    if x[0] > 0:
        x, code = np.insert(x, 0, 0.0), np.insert(code, 0, 0.0)
    found = Response("file", lambda exposed: np.interp(exposed, x, code), points.tolist())
    if not _is_shown(found.anchor()[1]):
        raise ResponseFileError(f"response file '{path}' has no code between black and white (0…1)")
    return found


def by_name(name: str) -> Response:
    """A built-in response, or one from a file where ``name`` is a path (has a suffix or a separator).

    Raises:
        UnknownNameError: no such name.
        ResponseFileError: the file holds no usable curve.
    """
    if name in BUILT_IN:
        return Response(name, BUILT_IN[name])
    if "/" in name or "\\" in name or Path(name).suffix:
        return from_file(Path(name))
    raise UnknownNameError("response (--crf)", name, [*BUILT_IN, "a file of the curve, such as curve.json"])
