# SPDX-License-Identifier: GPL-3.0-or-later
"""Judges whether an attack was withstood: every function returns complaints, none if all is well."""

import json
import re
import statistics
from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np

#: Fields that say how long something took: they differ between two equal runs.
TIMES = ("seconds", "cpu_seconds")
#: The fewest words that an error message must have beside its first line.
REMEDY_WORDS = 3
#: Memory may end this much above where it was after the warm-up.
GROWTH = 0.10


class SkipError(Exception):
    """The attack cannot be run here; says why."""


# ---- files -----------------------------------------------------------------------------------------------


def temporaries(folder: Path) -> list[Path]:
    """Files without their final name: hidden ones and ``*.partial``, but not locks."""
    found = [path for path in _walk(folder) if path.name.startswith(".") or ".partial" in path.suffixes]
    return [path for path in found if "lock" not in path.name and path.name != "dataset.partial.json"]


def finals(folder: Path) -> list[Path]:
    """Files under their final names; none in a missing folder, or in hidden ones."""
    unfinished = set(temporaries(folder))
    return [
        path
        for path in _walk(folder)
        if path not in unfinished
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]


def _walk(folder: Path) -> Iterator[Path]:
    """Everything in the folder, though other processes remove things meanwhile."""
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return
    for entry in entries:
        yield entry
        if entry.is_dir() and not entry.is_symlink():
            yield from _walk(entry)


def checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Tensors and metadata, as PhysHDR itself reads them; raises what it raises."""
    from physhdr.backend.train.checkpoint import load_checkpoint

    return load_checkpoint(path)


def whole(path: Path) -> list[str]:
    """Whether the file can be read to its end by a reader of its kind."""
    try:
        _read(path)
    except Exception as error:  # noqa: BLE001 (every reader has its own way to say that a file is damaged)
        return [f"{path} is not whole: {type(error).__name__}: {str(error).splitlines()[:1]}"]
    return []


def _read(path: Path) -> None:
    kind = path.suffix.lower()
    if kind == ".json":
        json.loads(path.read_text(encoding="utf-8"))
    elif kind == ".safetensors":
        _tensors(path)
    elif kind in (".png", ".jpg"):
        from PIL import Image

        with Image.open(path) as image:
            image.load()
    elif kind == ".exr":
        import OpenEXR

        with OpenEXR.File(str(path)) as file:
            if not file.channels():
                raise ValueError("no channels")
    elif kind == ".ply":
        from plyfile import PlyData

        PlyData.read(str(path))
    elif kind in (".mp4", ".mov", ".mkv"):
        import av

        with av.open(str(path)) as container:
            if not sum(1 for _ in container.decode(video=0)):
                raise ValueError("no frames")
    elif not path.stat().st_size:
        raise ValueError("it is empty")


def _tensors(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118


def different_tensors(one: Path, other: Path) -> list[str]:
    """Bit for bit: names, types, shapes, bits; and metadata except times."""
    (first, ours), (second, theirs) = _tensors(one), _tensors(other)
    complaints = [f"tensor {name} is in one of them alone" for name in sorted(first.keys() ^ second.keys())]
    for name in sorted(first.keys() & second.keys()):
        a, b = first[name].contiguous(), second[name].contiguous()
        if (a.dtype, a.shape) != (b.dtype, b.shape):
            complaints.append(f"tensor {name}: {tuple(a.shape)} {a.dtype} and {tuple(b.shape)} {b.dtype}")
        elif not np.array_equal(_bytes(a), _bytes(b)):
            complaints.append(f"tensor {name} differs")
    for key in sorted((ours.keys() | theirs.keys()) - {*TIMES, "digest"}):  # which includes the times
        if ours.get(key) != theirs.get(key):
            complaints.append(f"metadata {key}: {ours.get(key)} and {theirs.get(key)}")
    return [f"{one} and {other}: {complaint}" for complaint in complaints[:4]]


def _bytes(tensor: Any) -> np.ndarray:
    return tensor.reshape(-1).numpy().view(np.uint8)


def different_files(one: Path, other: Path) -> list[str]:
    """Whether two files differ: byte for byte, or for kinds that contain times, in all the rest."""
    try:
        if one.read_bytes() == other.read_bytes():
            return []
        if one.suffix == ".json":
            first, second = (json.loads(path.read_text(encoding="utf-8")) for path in (one, other))
            return [] if _timeless(first) == _timeless(second) else [f"{one} differs from {other}"]
        if one.suffix == ".safetensors":
            return different_tensors(one, other)
        if one.suffix == ".png":
            from PIL import Image

            first, second = (np.asarray(Image.open(path)) for path in (one, other))
            return [] if np.array_equal(first, second) else [f"the pixels of {one} and {other} differ"]
    except Exception as error:  # noqa: BLE001 (as in whole)
        return [f"{one} and {other} cannot be compared: {type(error).__name__}: {error}"]
    return [f"{one} differs from {other}"]


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(inner) for key, inner in value.items() if key not in TIMES}
    return [_timeless(inner) for inner in value] if isinstance(value, list) else value


def different_folders(made: Path, reference: Path, varying: Sequence[str] = ()) -> list[str]:
    """Whether ``made`` holds what ``reference`` does; ``varying`` names need only be whole."""
    there, wanted = ({path.relative_to(root): path for path in finals(root)} for root in (made, reference))
    there, wanted = (
        {inside: path for inside, path in files.items() if not _varies(inside, varying)}
        for files in (there, wanted)
    )
    complaints = [f"{made / name} is missing" for name in sorted(wanted.keys() - there.keys())]
    complaints += [f"{made / name} should not exist" for name in sorted(there.keys() - wanted.keys())]
    for name in sorted(there.keys() & wanted.keys()):
        complaints += different_files(there[name], wanted[name])
    for path in finals(made):
        if _varies(path.relative_to(made), varying):
            complaints += whole(path)
    return complaints


def unfinished_finals(made: Path, reference: Path, varying: Sequence[str] = ()) -> list[str]:
    """After a kill: files with their final names are whole, and have the known content if there is one."""
    complaints = []
    for path in finals(made):
        inside = path.relative_to(made)
        if (reference / inside).is_file() and not _varies(inside, varying):
            complaints += different_files(path, reference / inside)
        elif not _varies(inside, varying):
            complaints += whole(path)
    return complaints


def _varies(inside: Path, varying: Sequence[str]) -> bool:
    return any(fnmatch(inside.as_posix(), pattern) for pattern in varying)


# ---- a program's output ----------------------------------------------------------------------------------


def tracebacks(output: str) -> list[str]:
    """A traceback, wherever it comes from, is not a message for a user."""
    for word in ("Traceback (most recent call last)", "Exception ignored", "Fatal Python error"):
        if word in output:
            last = output[output.index(word) :].strip().splitlines()
            return [f"it printed '{word}': {' … '.join(line.strip() for line in last[-2:])}"]
    return []


def badly_refused(status: int, output: str, *names: str) -> list[str]:
    """A refusal ends with another status than 0 and one message: what, where (``names``), the remedy."""
    complaints = tracebacks(output)
    if status == 0:
        complaints.append("it ended with 0, as if all were well")
    elif status < 0:
        complaints.append(f"it was ended by signal {-status}")
    lines = output.splitlines()
    errors = [i for i, line in enumerate(lines) if line.startswith("error:")]
    if len(errors) != 1:
        last = lines[-1] if lines else "nothing"
        return [*complaints, f"{len(errors)} lines begin with 'error:', not one; the last line: {last}"]
    message = "\n".join(lines[errors[0] :])
    shown = " ".join(lines[errors[0] : errors[0] + 2])
    complaints += [f"the message does not name {name}: {shown}" for name in names if name not in message]
    first, *rest = lines[errors[0] :]
    # After "error" and what is wrong; Blender's side continues in the same line.
    after = re.split(r"[?:;.] ", first)[2:]
    if len(" ".join([*after, *rest]).split()) < REMEDY_WORDS:
        complaints.append(f"the message has no remedy: {shown}")
    return complaints


def badly_ended(status: int, output: str) -> list[str]:
    """An undisturbed program ends with 0 and prints no error."""
    complaints = tracebacks(output)
    if status:
        last = [line for line in output.splitlines() if line.strip()][-2:]
        complaints.append(f"it ended with {status}: {' '.join(line.strip() for line in last)}")
    return complaints


# ---- trainings -------------------------------------------------------------------------------------------


def events(log: Path) -> list[dict[str, Any]]:
    """The events in a run's log, without a last line that a kill cut off."""
    found = []
    try:
        lines = log.read_bytes().decode("utf-8", "replace").splitlines()
    except OSError:
        return []
    for line in lines:
        try:
            event = json.loads(line)
        except ValueError:
            continue
        if isinstance(event, dict) and "event" in event:
            found.append(event)
    return found


def lost_seconds(logged: Iterable[dict[str, Any]], saved: int, killed: float) -> float:
    """Seconds of training that a kill at the time ``killed`` cost, if iteration ``saved`` is on disk.

    ``logged``: the log's events since the process began. 0 if training had not begun.
    """
    logged = list(logged)
    begun = next((event for event in logged if event["event"] == "started"), None)
    if begun is None:
        return 0.0
    reached = begun["time"]
    if saved > begun["iteration"]:
        after = [e["time"] for e in logged if e["event"] in ("progress", "saved") and e["iteration"] >= saved]
        reached = after[0] if after else killed  # it was written, and its event was not
    return max(0.0, killed - reached)


# ---- a soak ----------------------------------------------------------------------------------------------


def grown(values: Sequence[float], bound: float = GROWTH) -> list[str]:
    """Whether the median of the last quarter is above that of the second (the first is the warm-up)."""
    quarter = len(values) // 4
    if quarter < 1:
        return [f"{len(values)} samples are too few to distinguish growth from noise"]
    early = statistics.median(values[quarter : 2 * quarter])
    late = statistics.median(values[-quarter:])
    if late > early * (1.0 + bound):
        return [f"memory grew from {early:.0f} to {late:.0f} MB (second and last quarter's medians)"]
    return []


def not_given_back(what: str, before: int, after: int) -> list[str]:
    """Threads, descriptors: as many at rest as before."""
    return [f"{what}: {before} at rest after the first round, {after} at the end"] if after > before else []
