# SPDX-License-Identifier: GPL-3.0-or-later
"""A PLY of Gaussians as a model that can be exposed, relit and rendered.

Another program's PLY is display-referred: its colours are linearised, nothing is known of its light (a level
scales everything) and it has no learned response. Our lossless PLY holds the trained parameters: with the
physical product and the additive modulator the model is what ``physhdr export`` would write, but for
opacities within 1.2e-7 of 0 and 1, which have no finite logit.

Two things that other programs do to a PLY cost more than they need. Where its comments are gone
(splat-transform 3.7 drops them), the baked look is imported and networks are said to be missing, although an
additive model has none. A logit of +∞, as which the same program writes an opacity of 1, counts as damage: of
the demo's 60,000 Gaussians 2,072, opaque ones, are left out.
"""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .display import ColorSpace, log_radiance_of
from .errors import BadValueError, DataMismatchError, FileDamagedError
from .gaussian_ply import read_ply
from .lights import AMBIENT, check_lights
from .limits import FARTHEST, LOG_RADIANCE_MAX, check_position
from .model_file import ADDITIVE_LIGHTS, Model, largest_log_radiance
from .spherical_harmonics import C0

#: Comment lines of a lossless PLY: ``phys_form COMPOSER MODULATOR``, ``phys_lights NAMES`` (a JSON list, only
#: where there are others than the ambient light), ``phys_curve NAME SHAPE PART BASE64`` (the sampled
#: response) and ``phys_network …`` of the same form (the networks, which need torch).
FORM, LIGHTS, CURVE, NETWORK = "phys_form", "phys_lights", "phys_curve", "phys_network"
#: Columns of the lights' logits: 3 of the ambient light alone, or 3 C of several (light by light).
AMBIENT_LOGITS, LIGHT_LOGITS = "phys_ambient_share_logits", "phys_light_share_logits"
#: Comment lines ``PhysHDR KEY: VALUE`` become metadata.
PROVENANCE = "PhysHDR "
#: Tensors are stored as base64 in comment lines of at most this many characters.
COMMENT_WIDTH = 400
#: No column of a Gaussian has a larger value; squares and sums of such are still finite in float32.
ABSURD = 1e15
#: Columns of ln reflectance: 3 of SH degree 0, and 3 (K − 1) of the others, coefficient by coefficient.
REFLECTANCE_DC, REFLECTANCE_REST = "phys_reflectance_dc", "phys_reflectance_rest"
#: Column of the confidence (``bridge.confidence``), of exports that had the training pictures.
CONFIDENCE = "phys_confidence"
#: Columns of ln illumination: one, or one a channel.
LOG_ILLUMINATION = "phys_log_illumination"
#: Columns that say how a lossless PLY's radiance is made; without all of them it is a standard PLY.
_RADIANCE = (f"{REFLECTANCE_DC}_0", f"{LOG_ILLUMINATION}_0")


@dataclass(frozen=True, eq=False)
class PlyModel:
    """What a PLY holds. ``notes``: sentences for the user about what could not be kept."""

    model: Model
    #: ``[N, K, 3]``: the file's own display-referred colours (Σ sh·Y + ½); ``None`` for a lossless PLY.
    colour_sh: np.ndarray | None
    #: Gaussians that were left out because a value is NaN, infinite or absurd.
    left_out: int
    notes: tuple[str, ...]


def read_ply_model(path: Path, color_space: ColorSpace = "SRGB") -> PlyModel:
    """Read a PLY of Gaussians of any kind as a model.

    ``color_space`` says what a standard PLY's colours are (``display.log_radiance_of``); a lossless PLY has
    none to guess. Raises what ``read_ply`` raises, and ``BadValueError`` where no Gaussian is usable or a
    lossless PLY's radiance needs networks.
    """
    ply = read_ply(path)
    notes: list[str] = []
    names = [n for n in ply.columns if n not in ("nx", "ny", "nz", "red", "green", "blue")]
    columns, left_out = _usable(path, {name: ply.columns[name] for name in names})
    is_lossless = False
    if all(name in columns for name in _RADIANCE):
        form = _form(ply.comments)
        is_lossless = form in (("product", "additive"), ("product", ADDITIVE_LIGHTS))
        if form is not None and not is_lossless:
            raise BadValueError(
                f"{path}: its radiance needs networks (composer {form[0]:.80}, modulator {form[1]:.80})",
                "Import the run's model.safetensors (physhdr export), or its baked.ply for one fixed look.",
            )
        if form is None:
            notes.append("Its phys_network comments are gone: imported as the look that was baked into it.")
    colour_sh = None
    if is_lossless:
        sh = _lossless_sh(path, columns)
    else:
        colour_sh = _colour_sh(columns)
        sh = log_radiance_of(colour_sh, color_space)
        if color_space == "SRGB":
            notes.append("Its colours are display-referred; they were linearised as sRGB.")
        notes.append("Nothing is known of its light: the lighting level scales everything.")
    drawable = largest_log_radiance(sh) <= LOG_RADIANCE_MAX
    if not drawable.all():
        columns, sh = _only(path, columns, drawable), sh[drawable]
        colour_sh = None if colour_sh is None else colour_sh[drawable]
        left_out += int(np.count_nonzero(~drawable))
    if left_out:
        notes.insert(0, f"{left_out} Gaussians with NaN, infinite or absurd values were left out.")
    light: dict[str, Any] = {"light_share": np.ones((len(sh), 1, 3), np.float32)}
    if is_lossless:
        light = _lossless_light(path, columns, ply.comments)
        if CONFIDENCE in columns:
            light["confidence"] = columns[CONFIDENCE]
    try:
        model = Model(**_shape(columns), log_radiance_sh=sh, **light, metadata=_provenance(ply.comments))
    except (DataMismatchError, BadValueError) as error:  # which know arrays, and not where they are from
        raise type(error)(f"{path}: {error.message}", error.hint) from error
    return PlyModel(model, colour_sh, left_out, tuple(notes))


def tensor_comments(kind: str, tensors: dict[str, np.ndarray]) -> list[str]:
    """Tensors as comment lines: ``KIND NAME SHAPE PART BASE64`` (float32, little endian)."""
    lines = []
    for name, tensor in tensors.items():
        text = base64.b64encode(np.ascontiguousarray(tensor, "<f4").tobytes()).decode()
        shape = json.dumps(list(tensor.shape), separators=(",", ":"))
        for part, start in enumerate(range(0, max(len(text), 1), COMMENT_WIDTH)):
            lines.append(f"{kind} {name} {shape} {part} {text[start : start + COMMENT_WIDTH]}")
    return lines


def tensors_from_comments(kind: str, comments: Sequence[str]) -> dict[str, np.ndarray]:
    """The tensors that ``tensor_comments`` wrote, by their names; those that cannot be read are left out."""
    texts: dict[str, list[str]] = {}
    shapes: dict[str, str] = {}
    for line in comments:
        words = line.split(" ")
        if len(words) == 5 and words[0] == kind:
            texts.setdefault(words[1], []).append(words[4])
            shapes[words[1]] = words[2]
    tensors = {}
    for name, parts in texts.items():
        try:
            values = np.frombuffer(base64.b64decode("".join(parts), validate=True), "<f4")
            tensors[name] = values.reshape(json.loads(shapes[name])).copy()
        except (ValueError, TypeError, RecursionError, OverflowError):
            continue
    return tensors


def _usable(path: Path, columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    """The columns without Gaussians that have a value nobody can draw, and how many those were."""
    if not len(columns["x"]):
        raise BadValueError(f"{path} has no Gaussians", "Choose another file.")
    most = np.zeros(len(columns["x"]), np.float32)
    with np.errstate(invalid="ignore"):
        for column in columns.values():
            np.maximum(most, np.abs(column), out=most)  # NaN stays
    length = sum(np.square(columns[f"rot_{i}"], dtype=np.float64) for i in range(4))
    usable = (most <= ABSURD) & (length > 1e-12)
    with np.errstate(over="ignore"):
        for axis in range(3):
            usable &= np.exp(columns[f"scale_{axis}"]) <= FARTHEST
    near = np.ones_like(usable)
    for axis in "xyz":
        near &= np.abs(columns[axis]) <= FARTHEST
    if usable.any() and not (usable & near).any():
        first = int(np.argmax(usable))
        check_position((columns[axis][first] for axis in "xyz"), f"{path}: its first Gaussian")
    usable &= near
    left_out = int(usable.size - np.count_nonzero(usable))
    return (_only(path, columns, usable) if left_out else columns), left_out


def _only(path: Path, columns: dict[str, np.ndarray], usable: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of the Gaussians that are ``usable``, of which there must be one."""
    if not usable.any():
        raise BadValueError(
            f"{path}: every Gaussian has NaN, infinite or absurd values",
            "Training diverged: export an earlier checkpoint.",
        )
    return {name: column[usable] for name, column in columns.items()}


def _shape(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    """Position, rotation, scale and opacity in natural values, from the standard columns."""

    def stack(name: str, count: int) -> np.ndarray:
        return np.stack([columns[f"{name}_{index}"] for index in range(count)], axis=1)

    rotation = stack("rot", 4)
    return {
        "position": np.stack([columns[axis] for axis in "xyz"], axis=1),
        "rotation": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        "scale": np.exp(stack("scale", 3)),
        "opacity": _sigmoid(columns["opacity"]),
    }


def _colour_sh(columns: dict[str, np.ndarray]) -> np.ndarray:
    """``[N, K, 3]``: a view of planes ``[K, 3, N]``, so that working through it reads memory in order."""
    rest = sum(name.startswith("f_rest_") for name in columns) // 3
    planes = np.empty((rest + 1, 3, len(columns["x"])), np.float32)
    for channel in range(3):
        planes[0, channel] = columns[f"f_dc_{channel}"]
        for k in range(rest):
            planes[k + 1, channel] = columns[f"f_rest_{channel * rest + k}"]
    return planes.transpose(2, 0, 1)


def _lossless_sh(path: Path, columns: dict[str, np.ndarray]) -> np.ndarray:
    """``[N, K, 3]`` of our own parameters: ln radiance = ln illumination + ln reflectance(ω)."""
    coefficients = 1 + sum(name.startswith(f"{REFLECTANCE_REST}_") for name in columns) // 3
    wanted = [f"{REFLECTANCE_DC}_{c}" for c in range(3)]
    wanted += [f"{REFLECTANCE_REST}_{k}" for k in range(3 * (coefficients - 1))]
    lacking = [name for name in wanted if name not in columns]
    if lacking or coefficients not in (1, 4, 9, 16):
        raise FileDamagedError(
            f"{path}: the columns of its reflectance are not those of SH degree 0 to 3"
            + (f" (it has no {lacking[0]})" if lacking else ""),
            "Export it again (physhdr export).",
        )
    sh = np.empty((len(columns["x"]), coefficients, 3), np.float32)
    for channel in range(3):
        # One illumination a Gaussian, or one a channel.
        light = columns.get(f"{LOG_ILLUMINATION}_{channel}", columns[f"{LOG_ILLUMINATION}_0"])
        sh[:, 0, channel] = columns[f"{REFLECTANCE_DC}_{channel}"] + light / np.float32(C0)
        for k in range(coefficients - 1):
            sh[:, k + 1, channel] = columns[f"{REFLECTANCE_REST}_{3 * k + channel}"]
    return sh


def _lossless_light(path: Path, columns: dict[str, np.ndarray], comments: Sequence[str]) -> dict[str, Any]:
    """The lights, their shares and the learned response of a lossless PLY, as ``Model`` takes them."""
    lights, share = _lights(path, columns, comments)
    curve = tensors_from_comments(CURVE, comments)
    if set(curve) != {"tone_curve_log_exposure", "tone_curve"}:
        curve = {}
    return {"lights": lights, "light_share": share, **curve}


def _lights(
    path: Path, columns: dict[str, np.ndarray], comments: Sequence[str]
) -> tuple[tuple[str, ...], np.ndarray]:
    """The names of the lights and their shares ``[N, C, 3]`` in the columns; 1 where none are stated."""
    listed = [line.removeprefix(LIGHTS + " ") for line in comments if line.startswith(LIGHTS + " ")]
    if not listed:
        logits = [columns[name] for c in range(3) if (name := f"{AMBIENT_LOGITS}_{c}") in columns]
        if len(logits) < 3:
            return (AMBIENT,), np.ones((len(columns["x"]), 1, 3), np.float32)
        return (AMBIENT,), light_shares(np.stack(logits, axis=1)[:, None])
    try:
        lights = check_lights(json.loads(listed[0]), f"{path}: its {LIGHTS} line")
        logits = [columns[f"{LIGHT_LOGITS}_{index}"] for index in range(3 * len(lights))]
    except (ValueError, RecursionError, KeyError) as error:
        raise BadValueError(
            f"{path}: its {LIGHTS} line and its {LIGHT_LOGITS} columns do not agree ({error})",
            "Export it again (physhdr export).",
        ) from error
    return lights, light_shares(np.stack(logits, axis=1).reshape(-1, len(lights), 3))


def light_shares(logits: np.ndarray) -> np.ndarray:
    """Shares ``[N, C, 3]`` of logits ``[N, C, 3]``: a softmax over the C lights and the fixed part, whose
    logit is 0; with one light a sigmoid."""
    if logits.shape[1] == 1:
        return _sigmoid(logits)
    most = np.maximum(logits.max(axis=1, keepdims=True), 0.0)
    weights = np.exp(logits - most)
    return weights / (weights.sum(axis=1, keepdims=True) + np.exp(-most))


def _form(comments: Sequence[str]) -> tuple[str, str] | None:
    """Composer and modulator of a lossless PLY; ``None`` where its comments are gone."""
    for line in comments:
        words = line.split()
        if len(words) == 3 and words[0] == FORM:
            return words[1], words[2]
    # Files of before there was that line: networks are named after what they are part of.
    networks = [line.split()[1] for line in comments if line.startswith(NETWORK + " ")]
    if not networks:
        return None
    learned = [any(name.startswith(part) for name in networks) for part in ("composer.", "modulator.")]
    return ("learned" if learned[0] else "product"), ("learned" if learned[1] else "additive")


def _provenance(comments: Sequence[str]) -> dict[str, str]:
    found = {}
    for line in comments:
        key, separator, value = line.removeprefix(PROVENANCE).partition(": ")
        if line.startswith(PROVENANCE) and separator:
            found[key] = value
    return found


def _sigmoid(logit: np.ndarray) -> np.ndarray:
    # tanh neither overflows nor needs float64.
    return np.float32(0.5) * (np.float32(1.0) + np.tanh(np.float32(0.5) * logit))
