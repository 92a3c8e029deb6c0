# SPDX-License-Identifier: GPL-3.0-or-later
"""What was learned of a camera and holds for its next capture: its response, and its lens's vignetting.

``physhdr calibrate RUN`` writes it from a trained run; ``physhdr train --calibration FILE`` uses it as it is.
A response belongs to the camera's picture style, vignetting to a lens at one focal length and aperture.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.regular import read_json_object
from ..methods.base import Method
from ..model.camera_effects import COEFFICIENTS
from ..model.tone_mapper import ToneMapper
from .config import TrainConfig
from .nuisances import Nuisances

FORMAT, VERSION = "physhdr-calibration", 1
#: Every so many of the sampled response's rows are written, for people and other programs.
EVERY = 8


@dataclass(frozen=True, eq=False)
class Calibration:
    """``response``: the tone mapper's parameters by name, None where pictures have a known one.

    ``curve``: the same response as rows (ln(exposure × radiance), red, green, blue in 0…1), not read back.
    ``vignetting`` ``[3]`` and ``reach``, tan²θ where ρ is 1 (``model.camera_effects``); None where nothing
    of the lens was learned. ``origin``: which run it is of.
    """

    response: dict[str, torch.Tensor] | None
    curve: tuple[tuple[float, ...], ...]
    vignetting: tuple[float, ...] | None
    reach: float | None
    origin: str = ""


def calibration_of(
    method: Method, vignetting: torch.Tensor | None, reach: torch.Tensor | None, origin: str
) -> Calibration:
    """What a trained method knows; ``vignetting`` ``[L, 3]`` and ``reach`` ``[L]`` of its lenses.

    Raises ``DataMismatchError`` where there were several lenses, or the response is not one curve.
    """
    response, curve = None, ()
    if isinstance(method.tone_mapper, ToneMapper):
        response = _unanchored(method.tone_mapper)
        x, values = method.tone_mapper.sampled()
        rows = torch.cat([x[:, None], values], dim=1)[::EVERY].tolist()
        curve = tuple(tuple(row) for row in rows)
    if vignetting is None or reach is None:
        return Calibration(response, curve, None, None, origin)
    if len(vignetting) != 1:
        raise DataMismatchError(
            f"{origin} was taken with {len(vignetting)} lenses or focal lengths, a calibration is of one",
            "Train on the photographs of one of them.",
        )
    return Calibration(response, curve, tuple(vignetting[0].tolist()), float(reach[0]), origin)


def _unanchored(mapper: ToneMapper) -> dict[str, torch.Tensor]:
    """The parameters of the same curves without the anchor: its shift goes into the last bias."""
    if mapper.config.local:
        raise DataMismatchError(
            "this run has local tone curves, which belong to its pictures and not to the camera",
            "Train by the preset default.",
        )
    parameters = {name: value.detach().cpu().clone() for name, value in mapper.state_dict().items()}
    if mapper.config.anchored and mapper.anchor is not None:
        at = mapper.w1.new_full((3, 1), math.log(mapper.anchor[0]))
        with torch.no_grad():
            shifted, anchor = mapper.curve_logits(at), mapper.anchor
            mapper.anchor = None
            plain = mapper.curve_logits(at)
            mapper.anchor = anchor
        parameters["b2"] += (shifted - plain)[:, 0].cpu()
    return parameters


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write the JSON file; raises ``OutputError``."""
    response = calibration.response
    content = {
        "format": FORMAT,
        "version": VERSION,
        "origin": calibration.origin,
        "response": None if response is None else {name: value.tolist() for name, value in response.items()},
        "curve": [[round(value, 6) for value in row] for row in calibration.curve],
        "vignetting": calibration.vignetting,
        "reach": calibration.reach,
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_calibration(path: Path) -> Calibration:
    """What ``write_calibration`` wrote; raises ``FileMissingError`` and ``FileDamagedError``."""
    remedy = "Give a file that physhdr calibrate wrote."
    content = read_json_object(path, remedy)
    try:
        if (content.get("format"), content.get("version")) != (FORMAT, VERSION):
            raise ValueError(f"it is not of the format {FORMAT}, version {VERSION}")
        response = content["response"]
        if response is not None:
            response = {str(name): torch.tensor(value).float() for name, value in response.items()}
            if not all(value.isfinite().all() for value in response.values()):
                raise ValueError("its response has values that are not numbers")
        vignetting, reach = content["vignetting"], content["reach"]
        if vignetting is not None:
            vignetting, reach = tuple(float(value) for value in vignetting), float(reach)
            if len(vignetting) != COEFFICIENTS or not all(0.0 <= value < 100.0 for value in vignetting):
                raise ValueError(f"its vignetting is not {COEFFICIENTS} numbers of 0 or more")
            if not 0.0 < reach < math.inf:
                raise ValueError("its reach is not above 0")
        return Calibration(response, (), vignetting, reach, str(content.get("origin", "")))
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise FileDamagedError(f"{path} is not a calibration: {why}", remedy) from error


def calibrate(method: Method, nuisances: Nuisances | None, config: TrainConfig) -> None:
    """Begin with response and vignetting as ``config.calibration`` has them.

    Raises what ``read_calibration`` and ``use_response`` raise, and ``BadValueError`` for a vignetting that
    nothing would take notice of.
    """
    assert config.calibration is not None
    calibration = read_calibration(Path(config.calibration))
    use_response(method, calibration, config.calibration)
    if calibration.vignetting is None or not calibration.reach:
        return
    if nuisances is not None:
        nuisances.know_lens(calibration.vignetting, calibration.reach)
    elif any(calibration.vignetting):
        is_off = config.nuisances == "off" and config.method.traits.effects
        raise BadValueError(
            f"{config.calibration} knows the lens's vignetting, which this training would take no notice of",
            "Leave out --nuisances off; of a preset that has it, set --nuisances auto."
            if is_off
            else f"{config.method.name} does not model it: leave out --calibration.",
        )


def use_response(method: Method, calibration: Calibration, path: str) -> None:
    """Give the method the calibrated response; raises ``DataMismatchError`` where it cannot have it."""
    mapper = method.tone_mapper
    if not isinstance(mapper, ToneMapper):
        return  # these pictures' response is known
    if calibration.response is None:
        raise DataMismatchError(
            f"{path} is of pictures whose response is known; that of these is not",
            "Calibrate from pictures of the same kind, such as the camera's own JPEGs.",
        )
    state = mapper.state_dict()
    response = calibration.response
    wanted: dict[str, Any] = {name: tuple(value.shape) for name, value in state.items()}
    given = {name: tuple(value.shape) for name, value in response.items()}
    if wanted != given:
        raise DataMismatchError(
            f"{path} is of another kind of response curve than this training has",
            "Train by the preset and the method.tone_mapper settings that it was calibrated with.",
        )
    mapper.load_state_dict(response)


def freeze_response(method: Method) -> None:
    """From now on the response stays as it is."""
    method.tone_mapper.requires_grad_(False)
