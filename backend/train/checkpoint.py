# SPDX-License-Identifier: GPL-3.0-or-later
"""One file that holds everything a run needs to go on bit-identically, replaced atomically.

A safetensors file: parameters, Adam's moments, densification statistics; in its metadata the iteration and
which configuration and which views it belongs to. Random numbers are drawn from (seed, iteration), so there
is no generator state to keep.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from ...bridge.atomic import atomic_path
from ...bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, OutputError
from ...bridge.lights import as_levels, check_lights
from ...bridge.limits import LOG_RADIANCE_MAX
from ...bridge.regular import LONGEST_HEADER, parse_json
from ...bridge.run_folder import CHECKPOINT_FILE
from ..methods.base import Responses

FORMAT = "physhdr-checkpoint"
VERSION = 1
#: How often a checkpoint is read that is replaced meanwhile; a training replaces it twice a minute.
READS = 20
#: In the metadata: ``config.fingerprint`` of the run, and the SHA-256 of its ``views.json``.
CONFIGURATION, VIEWS = "configuration", "views"
#: Names of the lights that the model has levels for, and bounds of the ln radiance that it draws; both JSON.
LIGHTS, RANGE = "lights", "log_radiance_range"
#: Which responses its training pictures had (``methods.base.Responses``).
RESPONSES = "responses"
#: SHA-256 of everything else that the file holds.
DIGEST = "digest"
#: Levels of the lights in the standard pictures, JSON; missing where all are 1.
STANDARD = "standard_levels"
METADATA = ("iteration", "seconds", "cpu_seconds", CONFIGURATION, VIEWS, LIGHTS, RANGE, RESPONSES)


@dataclass(frozen=True)
class Reached:
    """How far a checkpoint's training was: ``iteration``, and the seconds that it took."""

    iteration: int
    seconds: float
    cpu_seconds: float


def how_to_go_on(folder: Path) -> str:
    """What to do with the training in ``folder`` once it can be written: resume it, where it was saved."""
    if (folder / CHECKPOINT_FILE).exists():
        return "resume the training: what was saved before is untouched"
    return "start the training again: nothing of it was saved yet"


def save_checkpoint(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> None:
    """Write the tensors; an older file at ``path`` survives until the new one is whole.

    ``metadata``: a value for each name of ``METADATA``. Raises ``OutputError`` where it cannot be written (a
    full disk, no permission).
    """
    metadata = {"format": FORMAT, "version": str(VERSION), **metadata}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    metadata[DIGEST] = digest_of(tensors, metadata)
    remedy = f"Free some space, then {how_to_go_on(path.parent)}."
    try:
        with atomic_path(path, remedy=remedy) as temporary:
            try:
                save_file(tensors, temporary, metadata)
            except SafetensorError as error:  # how the library tells of a full disk
                raise OSError(str(error)) from error
    except OutputError as error:
        message = error.message.replace("cannot write", "cannot write the checkpoint", 1)
        raise OutputError(message, error.hint) from error


def load_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors, in memory of their own, and metadata of a checkpoint; errors name the file and what to do.

    Raises ``FileMissingError``, ``FileDamagedError`` for whatever is wrong with the container, and
    ``DataMismatchError`` for another version. What the tensors hold is for ``check_tensors``.
    """
    if not path.is_file():
        raise FileMissingError(
            f"there is no checkpoint {path}",
            "Train first: physhdr train DATA --out RUN, or name another run.",
        )
    tensors, metadata = _read(path)
    _check_metadata(metadata, path)
    if metadata[DIGEST] != digest_of(tensors, metadata):
        raise damaged(path, "its content is not what was written")
    return tensors, metadata


def read_metadata(path: Path) -> dict[str, str] | None:
    """A checkpoint's metadata alone, which are not compared with its digest; None where there is no file.

    Raises as ``load_checkpoint``.
    """
    if not path.is_file():
        return None
    try:
        metadata = _header(path)["__metadata__"]
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise damaged(path, f"its header cannot be read: {str(error)[:200]}") from error
    _check_metadata(metadata, path)
    return metadata


def _check_metadata(metadata: dict[str, str], path: Path) -> None:
    """Whether a PhysHDR checkpoint of this version can have them; raises as ``load_checkpoint``."""
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise FileDamagedError(f"{path} is not a PhysHDR checkpoint", "Name a folder that 'train' wrote.")
    if metadata.get("version") != str(VERSION):
        raise DataMismatchError(
            f"{path} has checkpoint version {metadata.get('version')!s:.20}, this program reads {VERSION}",
            "Use the version of PhysHDR that wrote it.",
        )
    for name in (*METADATA, DIGEST):
        if not isinstance(metadata.get(name), str):
            raise damaged(path, f"its metadata do not say its {name}")


def _read(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """What the container holds, of one moment; raises ``FileDamagedError``.

    The library opens the file twice, by its name: first for the header, then for the numbers. In between a
    training may have replaced it, and then it is read again.
    """
    for attempt in range(READS):
        before = _identity(path)
        try:
            _header(path)  # the library takes a name that stands twice, and a header of any length
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                # Copies: the library's are the mapped file, which Windows does not let anybody replace.
                tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118 (no dict)
            if _identity(path) == before or attempt == READS - 1:
                return tensors, metadata
        except MemoryError:
            raise
        except Exception as error:  # the library documents no classes, and passes torch's on
            if _identity(path) == before or attempt == READS - 1:
                raise damaged(path, f"it cannot be read: {str(error)[:200]}") from error
    raise AssertionError("the last attempt returns or raises")


def _header(path: Path) -> Any:
    """The file's JSON header; raises ``OSError`` and what ``parse_json`` raises."""
    with open(path, "rb") as file:
        length = int.from_bytes(file.read(8), "little")
        if length > LONGEST_HEADER:
            raise ValueError(f"it claims {length} bytes, and none has more than {LONGEST_HEADER}")
        return parse_json(file.read(length).decode("utf-8"))


def _identity(path: Path) -> tuple[int, int, int]:
    """Of the file that has this name now; zeros where there is none."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0, 0
    return found.st_ino, found.st_mtime_ns, found.st_size


def require_configuration(metadata: Mapping[str, str], fingerprint: str, path: Path) -> None:
    """Raises ``DataMismatchError`` where the checkpoint belongs to another configuration."""
    if metadata[CONFIGURATION] != fingerprint:
        raise DataMismatchError(
            f"{path} was trained with another configuration than the one that lies beside it",
            "Restore the config.json that it was trained with, or train again with --overwrite.",
        )


def progress_of(metadata: Mapping[str, str], iterations: int, path: Path) -> Reached:
    """How far the training was, of ``iterations`` in all; raises ``FileDamagedError``."""
    written = metadata["iteration"]
    # int() takes underscores, blanks and other scripts' digits.
    if not (written.isascii() and written.isdigit() and int(written[:20]) <= iterations):
        raise damaged(path, f"its iteration is {written[:20]!r}, of {iterations} in all")
    seconds = []
    for name in ("seconds", "cpu_seconds"):
        try:
            value = float(metadata[name])
        except ValueError:
            value = math.nan
        if not 0.0 <= value < math.inf:
            raise damaged(path, f"its {name} are {metadata[name][:20]!r}")
        seconds.append(value)
    return Reached(int(written), *seconds)


def check_tensors(
    tensors: Mapping[str, torch.Tensor], wanted: Mapping[str, torch.Tensor], path: Path
) -> None:
    """Raises ``FileDamagedError`` unless every tensor of ``wanted`` is there, alike in shape and type.

    Every value must be finite. What is in ``tensors`` beside these is not looked at.
    """
    for name, like in wanted.items():
        tensor = tensors.get(name)
        if tensor is None:
            raise damaged(path, f"it has no {name}")
        if (tensor.shape, tensor.dtype) != (like.shape, like.dtype):
            raise damaged(path, f"{name} is {_words(tensor)}; it must be {_words(like)}")
        if tensor.is_floating_point() and not tensor.isfinite().all():
            raise damaged(path, f"{name} has values that are NaN or infinite")


def refuse_others(tensors: Mapping[str, torch.Tensor], known: Mapping[str, object], path: Path) -> None:
    """Raises ``FileDamagedError`` where there is a tensor that the run does not have."""
    for name in tensors:
        if name not in known:
            raise damaged(path, f"it has {name}, which a run of this configuration has not")


def damaged(path: Path, why: str) -> FileDamagedError:
    """What to say of a checkpoint that cannot be used."""
    return FileDamagedError(
        f"the checkpoint {path} is damaged: {why}", "Restore a copy, or train again with --overwrite."
    )


def digest_of(tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]) -> str:
    """SHA-256 of the metadata, and of the tensors' names and bytes.

    A bit that has flipped would be trained from unnoticed.
    """
    said = sorted((name, value) for name, value in metadata.items() if name != DIGEST)
    digest = hashlib.sha256(json.dumps(said).encode())
    for name in sorted(tensors):
        digest.update(name.encode())
        flat = tensors[name].contiguous().reshape(-1)
        if len(flat):  # as bytes: NumPy does not know every type that a file may name
            digest.update(flat.view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _words(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def lights_of(metadata: Mapping[str, str], path: Path) -> tuple[str, ...]:
    """The lights of a checkpoint's model, from its metadata; raises ``BadValueError``."""
    return check_lights(_json(metadata, LIGHTS, path), str(path))


def standard_levels_of(metadata: Mapping[str, str], path: Path) -> tuple[float, ...]:
    """The levels of a checkpoint's lights in the standard pictures; raises ``BadValueError``."""
    lights = lights_of(metadata, path)
    return as_levels(_json(metadata, STANDARD, path) if STANDARD in metadata else [1.0] * len(lights), lights)


def responses_in(metadata: Mapping[str, str], path: Path) -> Responses:
    """Whether a checkpoint's model learned a response, from its metadata; raises ``FileDamagedError``."""
    match metadata[RESPONSES]:
        case "learned" | "mixed" | "known" as responses:
            return responses
        case other:
            raise damaged(path, f"its responses are {other!r:.80}")


def log_radiance_range_in(metadata: Mapping[str, str], path: Path) -> tuple[float, float]:
    """Bounds of the ln radiance of a checkpoint's model, from its metadata; raises ``FileDamagedError``."""
    try:
        low, high = (float(bound) for bound in _json(metadata, RANGE, path))
    except (ValueError, TypeError, OverflowError) as error:
        raise damaged(path, f"its range of radiance is {metadata[RANGE]!r:.80}") from error
    if not -LOG_RADIANCE_MAX <= low < high <= LOG_RADIANCE_MAX:  # NaN is refused, too
        raise damaged(path, f"its range of radiance is {metadata[RANGE]!r:.80}")
    return low, high


def _json(metadata: Mapping[str, str], name: str, path: Path) -> Any:
    try:
        return parse_json(metadata[name])
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"its {name} is not JSON: {error!s:.200}") from error
