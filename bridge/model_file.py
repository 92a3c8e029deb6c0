# SPDX-License-Identifier: GPL-3.0-or-later
"""The model file: what the trainer exports and Blender imports (``docs/formats.md``).

A safetensors container, read and written here with numpy alone, because Blender has no safetensors:
8 bytes of little-endian header length, a JSON header, then the tensors' raw little-endian data.
"""

import json
import math
import mmap
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from . import spherical_harmonics
from .atomic import atomic_path
from .camera_list import ListedCamera, camera_text, cameras_of
from .errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError, OutputError
from .lights import AMBIENT, Levels, as_levels, check_lights
from .limits import EV_MAX, EXPOSURE, FARTHEST, LEVEL, LOG_RADIANCE_MAX, check_position
from .photographed_light import photographed_light, standard_levels
from .regular import LONGEST_HEADER, parse_json, without_waiting

FORMAT = "physhdr-model"
VERSION = 1
#: What the name of a model file ends with.
SUFFIX = ".safetensors"
WORKING_SPACE = "Linear Rec.709"

#: The least that a lighting level leaves of a radiance, where its logarithm is needed.
DARKEST = 1e-6

Modulator = Literal["additive", "baked-levels"]
#: The modulator of a file whose lights are others than the ambient one alone.
ADDITIVE_LIGHTS = "additive-lights"
#: So far may the shares of all lights add up to more than 1: rounding.
SHARE_SLACK = 1e-5

#: Array → its shape in words. N, K, C, L and M must agree over the whole model.
SHAPES: dict[str, tuple[str | int, ...]] = {
    "position": ("N", 3),
    "rotation": ("N", 4),
    "scale": ("N", 3),
    "opacity": ("N",),
    "log_radiance_sh": ("N", "K", 3),
    "light_share": ("N", "C", 3),
    "level_log_gain": ("L", "N", 3),
    "tone_curve_log_exposure": ("M",),
    "tone_curve": ("M", 3),
    "confidence": ("N",),
}
REQUIRED = ("position", "rotation", "scale", "opacity", "log_radiance_sh")
#: What a file may have after its light.
_BESIDE_LIGHT = ("tone_curve_log_exposure", "tone_curve", "confidence")
#: The tensor in a file that only the modulator it belongs to has. Where the ambient light is the only one
#: its share is written without the axis C.
LIGHT_TENSORS = {
    "additive": "ambient_share",
    ADDITIVE_LIGHTS: "light_share",
    "baked-levels": "level_log_gain",
}
FILE_SHAPES = {**SHAPES, "ambient_share": ("N", 3)}
#: Metadata of a model that is where it stood in a scene of Blender, not where its data set has it.
SPACE, WORLD = "space", "world"
#: Metadata of a model of photographs: the EV (log2 of seconds) at which its radiance looks as they do, that
#: of their middle exposure. Without it that is 0: radiance is shown as it is.
PHOTOGRAPHED_EV = "photographed_ev"
#: Metadata that has a field or a fixed value of its own; anything else lands in ``Model.metadata``.
RESERVED_METADATA = (
    *("format", "version", "modulator", "lights", "levels", "sh_degree", "working_space", "exposures"),
    "cameras",
)


@dataclass(frozen=True, eq=False)
class Model:
    """N Gaussians with HDR radiance that can be relit. All arrays float32; see ``docs/formats.md``.

    Exactly one of ``light_share`` (modulator ``additive``) and ``level_log_gain`` with ``levels``
    (modulator ``baked-levels``, one light) is given. Building one checks every shape and value; raises
    ``DataMismatchError`` and ``BadValueError``.
    """

    #: ``[N, 3]`` metres, Blender's world.
    position: np.ndarray
    #: ``[N, 4]`` quaternions, wxyz; readers normalise.
    rotation: np.ndarray
    #: ``[N, 3]`` standard deviations in metres.
    scale: np.ndarray
    #: ``[N]`` in [0, 1].
    opacity: np.ndarray
    #: ``[N, K, 3]``: radiance at level 1 is exp(Σ_k sh_k Y_k(ω)), ω from the camera to the Gaussian.
    log_radiance_sh: np.ndarray
    #: ``[N, C, 3]``: the share of the radiance that each light causes; what is left to 1 is fixed.
    light_share: np.ndarray | None = None
    #: ``[L, N, 3]``: ln(radiance(level) / radiance(1)) at each of ``levels``.
    level_log_gain: np.ndarray | None = None
    #: L lighting levels, positive and rising.
    levels: tuple[float, ...] = ()
    #: ``[M]`` ln(exposure × radiance), rising, and ``[M, 3]`` the learned response there.
    tone_curve_log_exposure: np.ndarray | None = None
    tone_curve: np.ndarray | None = None
    #: Exposure times of the training pictures in seconds.
    exposures: tuple[float, ...] = ()
    #: Free text about where it comes from: ``scene``, ``method``, ``iteration``, …
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    #: Names of the C lights that have levels, in the order of ``light_share``.
    lights: tuple[str, ...] = (AMBIENT,)
    #: ``[N]`` in [0, 1]: how likely each radiance is right (``bridge.confidence``); None: nobody knows.
    confidence: np.ndarray | None = None
    #: Where the training's pictures were taken from, in the model's space; of very many, some.
    cameras: tuple[ListedCamera, ...] = ()

    def __post_init__(self) -> None:
        _check_shapes({name: array.shape for name, array in self.tensors().items()}, "the model")
        _check_values(self)

    @property
    def count(self) -> int:
        """N, the number of Gaussians."""
        return self.position.shape[0]

    @property
    def sh_degree(self) -> int:
        return spherical_harmonics.degree_of(self.log_radiance_sh.shape[1])

    @property
    def modulator(self) -> Modulator:
        return "baked-levels" if self.level_log_gain is not None else "additive"

    @property
    def developed_ev(self) -> float:
        """The EV (log2 of seconds) of pictures of it where nobody says another: of the middle exposure."""
        if PHOTOGRAPHED_EV in self.metadata:
            return photographed_ev(self.metadata)
        known = sorted(self.exposures)
        return math.log2(known[len(known) // 2]) if known else 0.0

    @property
    def standard_levels(self) -> tuple[float, ...]:
        """One for each of ``lights``: those of the standard photographs, at which looking at it begins."""
        return standard_levels(self.metadata, self.lights)

    def known_levels(self, level: Levels) -> tuple[float, ...]:
        """What ``level`` is for each of ``lights``, limited to the range of a baked-levels model.

        Raises ``BadValueError``.
        """
        levels = as_levels(level, self.lights)
        return levels if not self.levels else (min(max(levels[0], self.levels[0]), self.levels[-1]),)

    def tensors(self) -> dict[str, np.ndarray]:
        """The arrays that are there, by the file's tensor names."""
        arrays = {name: getattr(self, name) for name in SHAPES}
        return {name: array for name, array in arrays.items() if array is not None}

    def log_gain(self, level: Levels) -> np.ndarray:
        """``[N, 3]``: ln(radiance(level) / radiance(1)), the same toward every direction.

        ``level`` ≥ 0: one for each of ``lights``, or a number for the first; limited to the range of a
        baked-levels model. What its lights cause alone does not go below a gain of ``DARKEST``. Raises
        ``BadValueError``.
        """
        levels = as_levels(level, self.lights)
        if self.level_log_gain is not None:
            weights = level_weights(self.levels, levels[0]).astype(np.float32)
            return np.einsum("l,lnc->nc", weights, self.level_log_gain)
        assert self.light_share is not None  # checked when the model was made
        change = self.light_share[:, 0] * np.float32(levels[0] - 1.0)
        for k in range(1, len(levels)):
            change += self.light_share[:, k] * np.float32(levels[k] - 1.0)
        return np.log(np.maximum(1.0 + change, np.float32(DARKEST)))

    def radiance(self, directions: np.ndarray, level: Levels = 1.0) -> np.ndarray:
        """Scene-linear radiance ``[N, 3]`` toward cameras seen along ``directions``, in their dtype.

        ``directions``: ``[N, 3]`` unit vectors from the camera to each Gaussian. ``level`` ≥ 0: the
        factor of each light, or a number for the first. A baked-levels model knows nothing outside its
        ``levels``: ``level`` is limited to their range. Raises ``BadValueError``.
        """
        levels = as_levels(level, self.lights)
        Y = spherical_harmonics.basis(directions, self.sh_degree)
        log_radiance = np.einsum("nk,nkc->nc", Y, self.log_radiance_sh.astype(Y.dtype, copy=False))
        if self.level_log_gain is not None:
            weights = level_weights(self.levels, levels[0])
            log_radiance += np.einsum("l,lnc->nc", weights.astype(Y.dtype), self.level_log_gain)
            return np.exp(log_radiance)
        assert self.light_share is not None  # checked when the model was made
        radiance = np.exp(log_radiance)
        # Shares whose sum rounds to above 1 leave no negative rest.
        lit = radiance * np.maximum(1.0 - self.light_share.sum(axis=1), 0.0)
        for k, factor in enumerate(levels):
            lit += factor * (radiance * self.light_share[:, k])
        return lit


def level_weights(levels: tuple[float, ...], level: float) -> np.ndarray:
    """Weights ``[L]`` of linear interpolation over log2(level), held constant outside ``levels``."""
    log_levels = np.log2(levels)
    at = math.log2(min(max(level, levels[0]), levels[-1]))
    return np.array([np.interp(at, log_levels, row) for row in np.eye(len(levels))])


def photographed_ev(metadata: Mapping[str, str]) -> float:
    """What a model's metadata say of ``PHOTOGRAPHED_EV``; 0 where they do not, or it is no exposure."""
    try:
        ev = float(metadata.get(PHOTOGRAPHED_EV, 0.0))
    except ValueError:
        return 0.0
    return ev if abs(ev) <= EV_MAX else 0.0


def largest_log_radiance(log_radiance_sh: np.ndarray) -> np.ndarray:
    """``[N]``: what |ln radiance| of SH ``[N, K, 3]`` cannot exceed toward any direction, in any channel.

    Σ_m Y_lm² is (2l + 1) / 4π in every direction (Unsöld), so that degree l reaches no more than the length
    of its coefficients times the root of that (Cauchy-Schwarz).
    """
    most = np.zeros((log_radiance_sh.shape[0], 3))
    with np.errstate(over="ignore"):  # infinity is too much, too
        for degree in range(spherical_harmonics.degree_of(log_radiance_sh.shape[1]) + 1):
            sh = log_radiance_sh[:, degree**2 : (degree + 1) ** 2]
            most += np.sqrt(np.einsum("nkc,nkc->nc", sh, sh) * ((2 * degree + 1) / (4.0 * math.pi)))
    return most.max(axis=1)


def read_model(path: str | os.PathLike[str]) -> Model:
    """Read a model file; the big arrays stay memory-mapped, read-only.

    Everything is checked: the container's bounds, types, shapes, and that every value is finite and in
    its range. Raises ``FileMissingError``, ``FileDamagedError`` (not a model, truncated),
    ``DataMismatchError`` (shapes) and ``BadValueError`` (NaN, a newer version), all with the path.
    """
    path = Path(path)
    data = _map_file(path)
    header, data_start = _read_header(data, path)
    metadata = _read_metadata(header, path)
    tensors = {
        name: _read_tensor(name, header[name], data, data_start, path)
        for name in FILE_SHAPES
        if name in header
    }
    missing = [name for name in REQUIRED if name not in tensors]
    if missing:
        raise _damaged(path, f"has no {', '.join(missing)}")
    modulator = metadata.get("modulator", "")
    if modulator not in LIGHT_TENSORS:
        raise BadValueError(f"{path}: unknown modulator {modulator!r:.80}", _NEWER_HINT)
    if LIGHT_TENSORS[modulator] not in tensors:
        raise _damaged(path, f"has modulator {modulator!r} but no {LIGHT_TENSORS[modulator]}")
    for other in set(LIGHT_TENSORS.values()) - {LIGHT_TENSORS[modulator]}:
        tensors.pop(other, None)
    lights: tuple[str, ...] = (AMBIENT,)
    if modulator == ADDITIVE_LIGHTS:
        lights = check_lights(_json(metadata, "lights", path), str(path))
    try:
        if "ambient_share" in tensors:
            _check_shapes({name: array.shape for name, array in tensors.items()}, "the model")
            tensors["light_share"] = tensors.pop("ambient_share")[:, None]
        model = Model(
            **tensors,
            lights=lights,
            levels=_numbers(metadata, "levels", path) if modulator == "baked-levels" else (),
            exposures=_numbers(metadata, "exposures", path),
            cameras=cameras_of(_json(metadata, "cameras", path), path, _EXPORT_AGAIN),
            metadata=MappingProxyType({k: v for k, v in metadata.items() if k not in RESERVED_METADATA}),
        )
    except (DataMismatchError, BadValueError) as error:
        raise type(error)(f"{path}: {error.message}", error.hint) from error
    stated = metadata.get("sh_degree", str(model.sh_degree))
    if stated != str(model.sh_degree):
        raise DataMismatchError(
            f"{path}: sh_degree is {stated!r:.80}, but log_radiance_sh has {model.sh_degree}"
        )
    return model


def refuse_what_is_not_ours(path: str | os.PathLike[str]) -> None:
    """Raises ``OutputError`` where ``path`` is anything that a model file must not take the place of.

    Only a model file may be replaced: a regular file whose header says so, whatever its tensors are like, so
    that a damaged or a newer one is no obstacle. Never a link, wherever it leads, since what is at its end is
    not what the caller named; nor a folder, a pipe or a device, which are not even opened. What comes to lie
    there after this has looked is not seen.
    """
    path = Path(path)
    try:
        found = os.lstat(path)
        if stat.S_ISLNK(found.st_mode):
            what = f"a link to {os.readlink(path)} is there"
        elif stat.S_ISDIR(found.st_mode):
            what = "a folder is there"
        elif not stat.S_ISREG(found.st_mode):
            what = "a pipe or a device is there"
        elif not _says_model(path):
            what = "a file is there that is not a PhysHDR model"
        else:
            return
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise OutputError(
            f"cannot write the model file {path}: what is there cannot be read: {error.strerror or error}",
            "Only a model file is replaced: choose another name, or make it readable.",
        ) from error
    raise OutputError(
        f"cannot write the model file {path}: {what}",
        "Only a model file is replaced: choose another name, or delete what is there yourself.",
    )


def _says_model(path: Path) -> bool:
    """Whether the header of the regular file at ``path`` says that it is a model; raises ``OSError``."""
    with open(path, "rb", opener=without_waiting) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            return False
        length = int.from_bytes(file.read(8), "little")
        if length > min(LONGEST_HEADER, found.st_size):
            return False
        header = file.read(length)
    try:
        return json.loads(header.decode("utf-8"))["__metadata__"]["format"] == FORMAT
    except (ValueError, RecursionError, KeyError, TypeError):
        return False


def write_model(path: str | os.PathLike[str], model: Model) -> None:
    """Write a model file in one step: it is there complete or not at all, an older one until then.

    Raises ``OutputError`` where it cannot be written, and where something else than a model file is there
    (``refuse_what_is_not_ours``).
    """
    path = Path(path)
    refuse_what_is_not_ours(path)
    if not os.path.isdir(path.parent):
        raise OutputError(
            f"cannot write the model file {path}: there is no folder {path.parent}",
            "Make that folder, or choose another one.",
        )
    tensors, modulator = model.tensors(), str(model.modulator)
    if modulator == "additive" and model.lights != (AMBIENT,):
        modulator = ADDITIVE_LIGHTS
    metadata = {
        **{str(key): str(value) for key, value in model.metadata.items()},
        "format": FORMAT,
        "version": str(VERSION),
        "modulator": modulator,
        "sh_degree": str(model.sh_degree),
        "working_space": WORKING_SPACE,
        "exposures": json.dumps(list(model.exposures)),
    }
    if model.cameras:
        metadata["cameras"] = camera_text(model.cameras)
    if model.modulator == "baked-levels":
        metadata["levels"] = json.dumps(list(model.levels))
    if modulator == ADDITIVE_LIGHTS:
        metadata["lights"] = json.dumps(list(model.lights))
    elif modulator == "additive":
        tensors = {
            **{name: array for name, array in tensors.items() if name in REQUIRED},
            "ambient_share": tensors["light_share"][:, 0],
            **{name: array for name, array in tensors.items() if name in _BESIDE_LIGHT},
        }
    arrays = {name: np.ascontiguousarray(array, "<f4") for name, array in tensors.items()}
    header: dict[str, Any] = {"__metadata__": metadata}
    end = 0
    for name, array in arrays.items():
        start, end = end, end + array.nbytes
        header[name] = {"dtype": "F32", "shape": list(array.shape), "data_offsets": [start, end]}
    header_bytes = json.dumps(header, separators=(",", ":")).encode()
    header_bytes += b" " * (-len(header_bytes) % 8)  # aligns the data, as the safetensors library does
    if len(header_bytes) > LONGEST_HEADER:
        raise OutputError(
            f"cannot write the model file {path}: its header would have {len(header_bytes)} bytes, of which "
            f"readers take {LONGEST_HEADER}",
            "Its metadata are too long: shorten them.",
        )

    try:
        # Looked at again at the end: writing takes seconds, the rename no time.
        with (
            atomic_path(path, remedy=_WRITE_HINT, check=refuse_what_is_not_ours) as temporary,
            open(temporary, "wb") as file,
        ):
            file.write(len(header_bytes).to_bytes(8, "little"))
            file.write(header_bytes)
            for array in arrays.values():
                file.write(array.data)
    except OutputError as error:
        message = error.message.replace(f"cannot write {path}", f"cannot write the model file {path}", 1)
        raise OutputError(message, error.hint) from error


_WRITE_HINT = "Check that you may write there, that the name is not too long and that the disk has room."
_EXPORT_AGAIN = "Export the model again (physhdr export)."
_NEWER_HINT = "It may come from a newer PhysHDR: update PhysHDR here, or export the model again."


def _damaged(path: Path, what: str) -> FileDamagedError:
    return FileDamagedError(f"{path} {what}", _EXPORT_AGAIN)


def _map_file(path: Path) -> memoryview:
    """The file's bytes, memory-mapped; the map lives as long as an array that uses it."""
    try:
        with open(path, "rb", opener=without_waiting) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise _damaged(path, "is not a PhysHDR model: it is a pipe or a device")
            size = found.st_size
            if size < 8:
                raise _damaged(path, f"is not a PhysHDR model: it has only {size} bytes")
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except FileNotFoundError:
        raise FileMissingError(
            f"there is no model file {path}", "Export one with physhdr export, or choose another file."
        ) from None
    except OSError as error:
        if os.path.isdir(path):  # Windows says that access is denied
            raise FileMissingError(
                f"{path} is a folder, not a model file", "Choose a .safetensors file."
            ) from None
        raise FileDamagedError(
            f"cannot read {path}: {error.strerror or error}", "Check the file's permissions."
        ) from error


def _read_header(data: memoryview, path: Path) -> tuple[dict[str, Any], int]:
    """The JSON header and the offset at which the tensors' data start."""
    length = int.from_bytes(data[:8], "little")
    if bytes(data[8:9]) not in (b"{", b""):
        raise _damaged(path, "is not a PhysHDR model: no safetensors header")
    if length > LONGEST_HEADER:
        raise _damaged(path, f"has a header of {length} bytes: no model has more than {LONGEST_HEADER}")
    if 8 + length > len(data):
        raise _damaged(path, f"is truncated: its header needs {8 + length} bytes, the file has {len(data)}")
    try:
        header = parse_json(bytes(data[8 : 8 + length]).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"is damaged: its header is not JSON ({error})") from error
    if not isinstance(header, dict):
        raise _damaged(path, "is not a PhysHDR model: its header is not an object")
    return header, 8 + length


def _read_metadata(header: dict[str, Any], path: Path) -> dict[str, str]:
    metadata = header.get("__metadata__", {})
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise _damaged(path, "is a safetensors file, but not a PhysHDR model")
    if not all(isinstance(value, str) for value in metadata.values()):
        raise _damaged(path, "is damaged: its metadata are not all text")
    if metadata.get("version") != str(VERSION):
        raise BadValueError(
            f"{path}: version {metadata.get('version')!r:.80} of the model file, not {VERSION}",
            _NEWER_HINT,
        )
    working_space = metadata.get("working_space", WORKING_SPACE)
    if working_space != WORKING_SPACE:
        raise BadValueError(
            f"{path}: working space {working_space!r:.80}, only {WORKING_SPACE!r} is supported"
        )
    return metadata


def _read_tensor(name: str, entry: Any, data: memoryview, data_start: int, path: Path) -> np.ndarray:
    """One tensor as a read-only view of the file, its bounds checked before anything is made."""
    match entry:
        case {"dtype": "F32", "shape": [*shape], "data_offsets": [int(start), int(end)]} if all(
            type(size) is int and size >= 0 for size in shape
        ):
            pass
        case {"dtype": str(dtype)} if dtype != "F32":
            raise _damaged(path, f"has {name} as {dtype!r:.80}; it must be F32")
        case _:
            raise _damaged(path, f"is damaged: the header's entry of {name} is not valid")
    if not 0 <= start <= end or end - start != 4 * math.prod(shape):
        raise _damaged(path, f"is damaged: {name} of shape {shape!r:.80} cannot be {end - start} bytes")
    if data_start + end > len(data):
        raise _damaged(
            path, f"is truncated: {name} ends at byte {data_start + end}, the file has {len(data)}"
        )
    try:
        return np.ndarray(tuple(shape), "<f4", data, data_start + start)
    except (ValueError, OverflowError) as error:  # a hundred axes; one of 0 beside one of 2^70
        raise _damaged(path, f"is damaged: {name} has the shape {shape!r:.80}") from error


def _json(metadata: Mapping[str, str], key: str, path: Path) -> Any:
    """What the metadata have as JSON under ``key``; an empty list where there is nothing."""
    try:
        return parse_json(metadata.get(key, "[]"))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"is damaged: {key} is not JSON") from error


def _numbers(metadata: Mapping[str, str], key: str, path: Path) -> tuple[float, ...]:
    """A JSON list of finite numbers in the metadata; empty where there is none."""
    values = _json(metadata, key, path)
    try:
        if isinstance(values, list) and all(type(value) in (int, float) for value in values):
            numbers = tuple(float(value) for value in values)
            if all(map(math.isfinite, numbers)):
                return numbers
    except OverflowError:
        pass  # a whole number of four hundred digits
    raise _damaged(path, f"is damaged: {key} is not a list of numbers")


def _check_shapes(shapes: dict[str, tuple[int, ...]], whose: str) -> None:
    """Every tensor has its number of axes, and N, K, C, L and M agree."""
    sizes: dict[str, tuple[int, str]] = {}
    for name, shape in shapes.items():
        expected = FILE_SHAPES[name]
        if len(shape) != len(expected):
            raise DataMismatchError(f"{whose}: {name} has shape {list(shape)}, expected {list(expected)}")
        for size, axis in zip(shape, expected, strict=True):
            if isinstance(axis, int):
                if size != axis:
                    raise DataMismatchError(f"{name} has shape {list(shape)}, expected {list(expected)}")
                continue
            known, by = sizes.setdefault(axis, (size, name))
            if known != size:
                raise DataMismatchError(f"{name} has {axis} = {size}, but {by} has {axis} = {known}")


def _check_values(model: Model) -> None:
    if model.count == 0:
        raise BadValueError("there are no Gaussians", "Train longer, or check the pruning settings.")
    try:
        spherical_harmonics.degree_of(model.log_radiance_sh.shape[1])
    except ValueError as error:
        raise DataMismatchError(f"log_radiance_sh: {error}") from error
    for name, array in model.tensors().items():
        if array.dtype != np.dtype("<f4"):
            raise DataMismatchError(f"{name} is {array.dtype}, it must be float32")
        finite = np.isfinite(array)
        if not finite.all():
            wrong = int(array.size - np.count_nonzero(finite))
            raise BadValueError(
                f"{name} has {wrong} values that are NaN or infinite",
                "Training diverged: export an earlier checkpoint.",
            )
    farthest = np.abs(model.position).max(axis=1)
    if farthest.max() > FARTHEST:
        worst = int(farthest.argmax())
        check_position(model.position[worst].tolist(), f"Gaussian {worst}")
    if (np.square(model.rotation).sum(axis=1) < 1e-12).any():
        raise BadValueError("rotation has a quaternion of length 0")
    if (model.scale < 0.0).any():
        raise BadValueError("scale has a negative value", "It must be linear (metres), not a logarithm.")
    if model.scale.max() > FARTHEST:
        raise BadValueError(
            f"scale has the value {model.scale.max():g}: no Gaussian is larger than {FARTHEST:g} metres",
            "Training diverged: export an earlier checkpoint.",
        )
    if (model.opacity < 0.0).any() or (model.opacity > 1.0).any():
        raise BadValueError("opacity has a value outside [0, 1]", "It must be activated, not a logit.")
    if model.confidence is not None and ((model.confidence < 0.0).any() or (model.confidence > 1.0).any()):
        raise BadValueError("confidence has a value outside [0, 1]", "It is a probability.")
    lights = check_lights(model.lights, "the model")
    photographed_light(model.metadata)
    if (model.light_share is None) == (model.level_log_gain is None):
        raise DataMismatchError("exactly one of light_share and level_log_gain must be there")
    if model.light_share is not None:
        if model.light_share.shape[1] != len(lights):
            raise DataMismatchError(
                f"light_share is of {model.light_share.shape[1]} lights, but there are {', '.join(lights)}"
            )
        total = model.light_share[:, 0] if len(lights) == 1 else model.light_share.sum(axis=1)
        if (model.light_share < 0.0).any() or (total > 1.0 + (SHARE_SLACK if len(lights) > 1 else 0.0)).any():
            raise BadValueError(
                "light_share has a value outside [0, 1], or shares that add up to more than 1"
            )
    else:
        if len(lights) != 1:
            raise DataMismatchError(f"baked levels are of one light, but there are {', '.join(lights)}")
        levels = np.array(model.levels)
        if model.level_log_gain is None or len(levels) != model.level_log_gain.shape[0] or len(levels) == 0:
            raise DataMismatchError(f"there are {len(levels)} levels, but level_log_gain has another count")
        if not (np.isfinite(levels).all() and levels[0] > 0.0 and (np.diff(levels) > 0.0).all()):
            raise BadValueError(f"levels must be positive and rising, got {list(model.levels)!r:.200}")
        for level in (model.levels[0], model.levels[-1]):
            LEVEL.check(level, "a level")
    _check_radiance(model)
    for seconds in model.exposures:
        EXPOSURE.check(seconds, "an exposure")
    if (model.tone_curve is None) != (model.tone_curve_log_exposure is None):
        raise DataMismatchError("tone_curve and tone_curve_log_exposure belong together")
    if model.tone_curve_log_exposure is not None and (np.diff(model.tone_curve_log_exposure) <= 0.0).any():
        raise BadValueError("tone_curve_log_exposure must rise")


def _check_radiance(model: Model) -> None:
    """Raises ``BadValueError`` where a radiance could be infinite; the rest of the model is checked."""
    most = largest_log_radiance(model.log_radiance_sh)
    if model.level_log_gain is not None:
        most += np.abs(model.level_log_gain).max(axis=(0, 2))
    too_much = int(np.count_nonzero(most > LOG_RADIANCE_MAX))
    if too_much:
        raise BadValueError(
            f"ln radiance of {too_much} Gaussians may reach {most.max():.3g}: "
            f"no more than {LOG_RADIANCE_MAX:g} can be drawn",
            "Training diverged: export an earlier checkpoint.",
        )
