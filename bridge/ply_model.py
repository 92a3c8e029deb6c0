# SPDX-License-Identifier: GPL-3.0-or-later
"""A file of Gaussians as a model that can be exposed, relit and rendered.

Another program's file is display-referred: its colours are linearised, nothing is known of its light (a level
scales everything) and it has no learned response. Our lossless PLY holds the trained parameters: with the
physical product and the additive modulator the model is what ``physhdr export`` would write, but for
opacities within 1.2e-7 of 0 and 1, which have no finite logit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .axes import Up
from .display import FITTED_COMMENT, ColorSpace, log_radiance_of
from .errors import BadValueError, DataMismatchError, FileDamagedError
from .gaussian_ply import EXTRA_PREFIX, GaussianPly, gaussians_in, is_compressed, open_gaussians
from .lights import AMBIENT, check_lights
from .limits import LOG_RADIANCE_MAX
from .lossless_form import EXPOSURES, LIGHTS, curve_of, exposures_of, form_of, lights_of, says_curve
from .model_file import ADDITIVE_LIGHTS, Model, largest_log_radiance
from .run_folder import MODEL_FILE
from .spherical_harmonics import C0, rotated
from .splat_files.cloud import SplatCloud
from .splat_files.compressed_ply import cloud_of_compressed
from .splat_files.standard_ply import cloud_of_ply, shape_of, sigmoid
from .splat_files.usable import left_out_note, only_usable, require_one, usable

#: What is said of files whose colours are right only where codes are blended, as viewers do.
FITTED = (
    "Its colours were fitted for viewers that blend codes; Blender blends light and shows blobs and flares"
)
BLENDED_AS_CODES = "Viewers blend these codes, Blender blends light: edges and highlights look different"
#: Fitted codes above what their pictures hold flare once they are linear. Clipped, an import of the demo is
#: 24.4 dB from the model's own picture and 6 codes of 255 too bright; as they are, 17.5 dB and 15 codes.
BRIGHTEST_CODE = 1.0
#: Bytes of a file in which our first comments are.
_HEAD = 4096
#: Columns of the lights' logits: 3 of the ambient light alone, or 3 C of several (light by light).
AMBIENT_LOGITS, LIGHT_LOGITS = "phys_ambient_share_logits", "phys_light_share_logits"
#: Comment lines ``PhysHDR KEY: VALUE`` become metadata.
PROVENANCE = "PhysHDR "
#: Columns of ln reflectance: 3 of SH degree 0, and 3 (K − 1) of the others, coefficient by coefficient.
REFLECTANCE_DC, REFLECTANCE_REST = "phys_reflectance_dc", "phys_reflectance_rest"
#: Column of the confidence (``bridge.confidence``), of exports that had the training pictures.
CONFIDENCE = "phys_confidence"
#: Columns of the position as it was trained, in metres.
TRAINED = "phys_means"
#: Positions that differ by this share of the scene's size were moved.
_MOVED = 1e-4
#: Of all Gaussians so many, those nearest to their middle, tell whether they were turned.
_NEAR_PERCENT = 99.0
#: Columns of ln illumination: one, or one a channel.
LOG_ILLUMINATION = "phys_log_illumination"
#: Columns that say how a lossless PLY's radiance is made; without all of them it is a standard PLY.
_RADIANCE = (f"{REFLECTANCE_DC}_0", f"{LOG_ILLUMINATION}_0")
#: Forms whose radiance needs no networks.
_WITHOUT_NETWORKS = (("product", "additive"), ("product", ADDITIVE_LIGHTS))
#: What the columns of a lossless PLY's radiance and light begin with.
_USED = tuple(
    f"{each}_" for each in (REFLECTANCE_DC, REFLECTANCE_REST, LOG_ILLUMINATION, AMBIENT_LOGITS, LIGHT_LOGITS)
)


@dataclass(frozen=True, eq=False)
class PlyModel:
    """What a file of Gaussians holds. ``notes``: sentences for the user about what could not be kept."""

    model: Model
    #: ``[N, K, 3]``: the file's own display-referred colours (Σ sh·Y + ½); ``None`` for what is ours.
    colour_sh: np.ndarray | None
    #: Gaussians that were left out because a value is NaN, infinite or absurd.
    left_out: int
    notes: tuple[str, ...]
    #: Which way is up in the file's axes, by its own word or the format's convention.
    up: Up = "z"


def read_ply_model(path: Path, color_space: ColorSpace = "SRGB") -> PlyModel:
    """Read a PLY of Gaussians of any kind as a model.

    ``color_space`` says what a standard PLY's colours are (``display.log_radiance_of``); a lossless PLY has
    none to guess. Raises what ``read_ply`` raises, and ``BadValueError`` where no Gaussian is usable or a
    lossless PLY's radiance needs networks.
    """
    read, metadata = read_model_or_cloud(path)
    if isinstance(read, PlyModel):
        return read
    return model_of_cloud(Path(path), read, color_space, metadata)


def read_model_or_cloud(path: Path) -> tuple[PlyModel | SplatCloud, dict[str, str]]:
    """A lossless PLY as the model that it is, any other as the Gaussians that it has, damaged ones too.

    And its metadata. Raises what ``read_ply_model`` raises of a PLY's form, before any colour is converted.
    """
    path = Path(path)
    opened = open_gaussians(path)
    if is_compressed(opened):
        return cloud_of_compressed(path, opened), {}
    ply = gaussians_in(path, opened)
    del opened  # the file's pages count as memory
    metadata = _provenance(ply.comments)
    notes: tuple[str, ...] = ()
    if all(name in ply.columns for name in _RADIANCE):
        form = form_of(ply.comments, ply.columns)
        if form in _WITHOUT_NETWORKS:
            return _lossless_model(path, ply), metadata
        if form is not None:
            raise BadValueError(
                f"{path}: its radiance needs networks (composer {form[0]:.80}, modulator {form[1]:.80})",
                "Import the run's model.safetensors (physhdr export), or its baked.ply for one fixed look.",
            )
        notes = ("Its phys_network comments are gone: imported as the look that was baked into it.",)
    cloud = cloud_of_ply(ply)
    return replace(cloud, notes=(*cloud.notes, *notes)), metadata


def model_of_cloud(
    path: Path,
    cloud: SplatCloud,
    color_space: ColorSpace = "SRGB",
    metadata: Mapping[str, str] | None = None,
) -> PlyModel:
    """Display-referred Gaussians as a model: their colours, toward every direction, become radiance.

    Damaged Gaussians are left out, as are those brighter than can be drawn; ``path`` is for messages. Raises
    ``BadValueError`` where none is usable.
    """
    cloud, left_out = only_usable(path, cloud)
    is_clipped = cloud.is_fitted and color_space == "SRGB"
    sh = log_radiance_of(cloud.colour_sh, color_space, BRIGHTEST_CODE if is_clipped else np.inf)
    notes = [*cloud.notes]
    if cloud.is_fitted:
        notes.append(f"{FITTED}: import {_source_of(path)} instead.")
    elif color_space == "SRGB":
        notes.append(f"Its colours are display-referred; they were linearised as sRGB. {BLENDED_AS_CODES}.")
    notes.append("Nothing is known of its light: the lighting level scales everything.")
    share = np.ones((len(sh), 1, 3), np.float32)
    arrays = {name: getattr(cloud, name) for name in ("position", "rotation", "scale", "opacity")}
    return _model(
        path,
        {**arrays, "log_radiance_sh": sh, "light_share": share},
        {"metadata": metadata or {}},
        _Extras(cloud.colour_sh, left_out, tuple(notes), cloud.up),
    )


def warning_of(path: Path) -> str:
    """What an import as sRGB says of the colours of a PLY, by the beginning of its header; cheap."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:  # the import itself says what is wrong
        return ""
    # A lossless PLY is read as the model that it is.
    if FITTED_COMMENT.encode() in head and EXTRA_PREFIX.encode() not in head:
        return f"{FITTED}: import {_source_of(path)} instead."
    return f"{BLENDED_AS_CODES}."


def _source_of(path: Path) -> str:
    """The model file that a baked file was made of, where one lies beside, else what it is."""
    model = path.with_name(MODEL_FILE)
    return str(model) if model.is_file() else "the model file (.safetensors) that it was baked from"


@dataclass(frozen=True, eq=False)
class _Extras:
    """What a ``PlyModel`` has beside its model."""

    colour_sh: np.ndarray | None
    left_out: int
    notes: tuple[str, ...]
    up: Up


def _model(path: Path, arrays: dict[str, np.ndarray], others: dict[str, Any], extras: _Extras) -> PlyModel:
    """The model of ``arrays`` of N Gaussians, by ``Model``'s names, without those too bright to be drawn."""
    drawable = largest_log_radiance(arrays["log_radiance_sh"]) <= LOG_RADIANCE_MAX
    colour_sh, left_out, notes = extras.colour_sh, extras.left_out, extras.notes
    if not drawable.all():
        require_one(path, drawable)
        arrays = {name: array[drawable] for name, array in arrays.items()}
        colour_sh = None if colour_sh is None else colour_sh[drawable]
        left_out += int(np.count_nonzero(~drawable))
    if left_out:
        notes = (left_out_note(left_out), *notes)
    try:
        model = Model(**arrays, **others)
    except (DataMismatchError, BadValueError) as error:  # which know arrays, and not where they are from
        raise type(error)(f"{path}: {error.message}", error.hint) from error
    return PlyModel(model, colour_sh, left_out, notes, extras.up)


def _lossless_model(path: Path, ply: GaussianPly) -> PlyModel:
    """The model itself, of a lossless PLY whose radiance needs no networks."""
    columns = ply.columns
    shape = shape_of(columns)
    names = [name for name in columns if name.startswith(_USED) or name == CONFIDENCE]
    fine = usable(path, **shape, others=(columns[name] for name in names))
    left_out = int(fine.size - np.count_nonzero(fine))
    used = {name: columns[name][fine] if left_out else columns[name] for name in names}
    shape = {name: array[fine] if left_out else array for name, array in shape.items()}
    shape["rotation"] = shape["rotation"] / np.linalg.norm(shape["rotation"], axis=1, keepdims=True)
    lights, share = _lights(path, used, lights_of(ply.comments, columns))
    curve = curve_of(ply.comments, columns)
    notes = []
    if not curve and says_curve(columns):
        notes.append(
            "Its learned response is lost: its comments are gone, and its columns no longer have all of it."
        )
    sh = _lossless_sh(path, used, len(share))
    trained = [columns[f"{TRAINED}_{axis}"][fine] for axis in range(3) if f"{TRAINED}_{axis}" in columns]
    if len(trained) == 3 and (turn := _turn_since(np.stack(trained, axis=1), shape["position"])) is not None:
        sh = rotated(sh, turn)
        notes.append("Another program has turned its Gaussians: their light was turned with them.")
    arrays = {**shape, "log_radiance_sh": sh, "light_share": share}
    if CONFIDENCE in used:
        arrays["confidence"] = used[CONFIDENCE]
    exposures = _exposures(path, exposures_of(ply.comments, columns))
    others = {"lights": lights, **curve, "exposures": exposures, "metadata": _provenance(ply.comments)}
    return _model(path, arrays, others, _Extras(None, left_out, tuple(notes), "z"))


def _turn_since(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """The rotation ``[3, 3]`` by which a program has turned Gaussians ``[N, 3]``, whose own columns of ours
    stayed as they were; ``None`` where there is none, or Gaussians were not moved as one."""
    if not np.isfinite(before).all():
        return None
    # A runaway is so far out that what is close beside it is any turn at all.
    distance = np.abs(before - np.median(before, axis=0)).max(axis=1)
    near = distance <= np.percentile(distance, _NEAR_PERCENT, method="lower")
    before, now = before[near], now[near]
    with np.errstate(over="ignore", invalid="ignore"):
        before = before - before.mean(axis=0, dtype=np.float64)
        now = now - now.mean(axis=0, dtype=np.float64)
        close = _MOVED * float(np.abs(now).max())
        if not np.isfinite(before).all() or np.abs(now - before).max() <= close:
            return None
        left, sizes, right = np.linalg.svd(now.T @ before)
        if sizes[2] <= _MOVED * sizes[0] or np.linalg.det(left @ right) < 0.0:
            return None  # all in one plane, or mirrored
        turn = left @ right
        size = sizes.sum() / np.square(before).sum()
        together = np.abs(now - size * before @ turn.T).max() <= close
    return turn if together and np.abs(turn - np.eye(3)).max() > _MOVED else None


def _lossless_sh(path: Path, columns: Mapping[str, np.ndarray], count: int) -> np.ndarray:
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
    sh = np.empty((count, coefficients, 3), np.float32)
    for channel in range(3):
        # One illumination a Gaussian, or one a channel.
        light = columns.get(f"{LOG_ILLUMINATION}_{channel}", columns[f"{LOG_ILLUMINATION}_0"])
        sh[:, 0, channel] = columns[f"{REFLECTANCE_DC}_{channel}"] + light / np.float32(C0)
        for k in range(coefficients - 1):
            sh[:, k + 1, channel] = columns[f"{REFLECTANCE_REST}_{3 * k + channel}"]
    return sh


def _lights(
    path: Path, columns: Mapping[str, np.ndarray], listed: object
) -> tuple[tuple[str, ...], np.ndarray]:
    """The names of the lights (``listed``, still to be checked) and their shares ``[N, C, 3]``.

    By the columns; 1 where none are stated.
    """
    if listed is None:
        logits = [columns[name] for c in range(3) if (name := f"{AMBIENT_LOGITS}_{c}") in columns]
        if len(logits) < 3:
            return (AMBIENT,), np.ones((len(columns[_RADIANCE[0]]), 1, 3), np.float32)
        return (AMBIENT,), light_shares(np.stack(logits, axis=1)[:, None])
    try:
        lights = check_lights(listed, f"{path}: its {LIGHTS} line")
        logits = [columns[f"{LIGHT_LOGITS}_{index}"] for index in range(3 * len(lights))]
    except KeyError as error:
        raise BadValueError(
            f"{path}: its {LIGHTS} line and its {LIGHT_LOGITS} columns do not agree ({error})",
            "Export it again (physhdr export).",
        ) from error
    return lights, light_shares(np.stack(logits, axis=1).reshape(-1, len(lights), 3))


def _exposures(path: Path, listed: object) -> tuple[float, ...]:
    """The exposures of the training pictures in seconds, still to be checked; none where none are stated."""
    if listed is None:
        return ()
    try:
        if isinstance(listed, list):
            return tuple(map(float, listed))
    except (TypeError, ValueError, OverflowError):
        pass  # null, a word, a whole number of four hundred digits
    raise BadValueError(
        f"{path}: its {EXPOSURES} line is not a list of numbers", "Export it again (physhdr export)."
    )


def light_shares(logits: np.ndarray) -> np.ndarray:
    """Shares ``[N, C, 3]`` of logits ``[N, C, 3]``: a softmax over the C lights and the fixed part, whose
    logit is 0; with one light a sigmoid."""
    if logits.shape[1] == 1:
        return sigmoid(logits)
    most = np.maximum(logits.max(axis=1, keepdims=True), 0.0)
    weights = np.exp(logits - most)
    return weights / (weights.sum(axis=1, keepdims=True) + np.exp(-most))


def _provenance(comments: Sequence[str]) -> dict[str, str]:
    found = {}
    for line in comments:
        key, separator, value = line.removeprefix(PROVENANCE).partition(": ")
        if line.startswith(PROVENANCE) and separator:
            found[key] = value
    return found
