# SPDX-License-Identifier: GPL-3.0-or-later
"""The text of ``--lens`` as a ``Lens``."""

import math
from pathlib import Path
from typing import Any

from . import folder
from .errors import OptionError, SynthError
from .lens import COEFFICIENTS, FISHEYE, OPENCV, Lens
from .parse import parse_numbers

#: Word of ``--lens`` → model.
MODELS = {"opencv": OPENCV, "fisheye": FISHEYE}
LARGEST_COEFFICIENT = 10.0
#: A JSON file's numbers in pixels, which go with its ``w`` and ``h``.
PIXELS = ("fl_x", "fl_y", "cx", "cy")


def parse_lens(text: str, size: tuple[int, int], angle_x: float) -> Lens:
    """``opencv:k1,k2,p1,p2``, ``fisheye:k1,k2,k3,k4`` or a JSON file, before a picture of ``size``.

    ``angle_x``: the field of view (radians) of the pinhole whose focal length the lens has, its centre in the
    middle. A file has nerfstudio's names: ``camera_model``, ``k1`` …, and, if it shall have a focal length or
    a centre of its own, ``fl_x``, ``fl_y``, ``cx``, ``cy`` with the ``w`` and ``h`` that they are for.

    Raises:
        OptionError: no lens, numbers out of range, or a picture that folds over.
    """
    word, colon, numbers = text.partition(":")
    if colon and word.lower() in MODELS:
        model = MODELS[word.lower()]
        return _lens(model, parse_numbers("--lens", numbers), size, angle_x, {}).check()
    try:
        content = folder.read_json(Path(text))
    except SynthError as error:
        raise OptionError(
            f"--lens '{text}': {error.message}",
            "write opencv:k1,k2,p1,p2 or fisheye:k1,k2,k3,k4, or a JSON file",
        ) from error
    model = content.get("camera_model", OPENCV)
    if model not in COEFFICIENTS:
        raise OptionError(
            f"--lens '{text}': camera_model is {model!r:.80}, not one of {', '.join(COEFFICIENTS)}"
        )
    coefficients = tuple(_number(text, content, name, 0.0) for name in COEFFICIENTS[model])
    return _lens(model, coefficients, size, angle_x, _pixels(text, content, size)).check()


def _lens(
    model: str, coefficients: tuple[float, ...], size: tuple[int, int], angle_x: float, own: dict[str, float]
) -> Lens:
    names = COEFFICIENTS[model]
    if len(coefficients) != len(names):
        raise OptionError(f"--lens: {model} has the {len(names)} numbers {', '.join(names)}")
    if not all(abs(value) <= LARGEST_COEFFICIENT for value in coefficients):  # also catches NaN
        raise OptionError(f"--lens: {coefficients} are not all within ±{LARGEST_COEFFICIENT:g}")
    width, height = size
    focal = width / 2 / math.tan(angle_x / 2)
    k1, k2, k3, k4 = coefficients
    return Lens(
        model=model,
        coefficients=(k1, k2, k3, k4),
        width=width,
        height=height,
        fx=own.get("fl_x", focal),
        fy=own.get("fl_y", own.get("fl_x", focal)),
        cx=own.get("cx", width / 2),
        cy=own.get("cy", height / 2),
    )


def _pixels(text: str, content: dict[str, Any], size: tuple[int, int]) -> dict[str, float]:
    """Focal lengths and centre of a JSON file, in pixels of our size."""
    in_pixels = [name for name in PIXELS if name in content]
    if not in_pixels:
        return {}
    sides = [_number(text, content, name, math.nan) for name in "wh"]
    if not all(side >= 1.0 for side in sides):
        raise OptionError(f"--lens '{text}': {in_pixels[0]} is in pixels: say of which 'w' and 'h'")
    scale = {"x": size[0] / sides[0], "y": size[1] / sides[1]}
    found = {name: _number(text, content, name, 0.0) * scale[name[-1]] for name in in_pixels}
    for name, value in found.items():
        if not value > 0.0:
            raise OptionError(f"--lens '{text}': {name} must be above 0")
    return found


def _number(text: str, content: dict[str, Any], name: str, otherwise: float) -> float:
    value = content.get(name, otherwise)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise OptionError(f"--lens '{text}': {name} is {value!r:.80}, not a number")
    return float(value)
