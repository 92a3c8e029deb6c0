# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenUSD in a separate process with limited time and memory, whose crash is only an error here.

Damaged binary files make OpenUSD crash (SIGSEGV) or take all memory; text can make it wait for ever. What it
is asked for is in ``usd_stage.py``. The answer comes through a pipe: a line of JSON,
then the bytes of arrays. Nothing is unpickled.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
import psutil

from ...bridge.errors import BadValueError, FileDamagedError, PhysHDRError
from ..child import child_command
from ..memory import gigabytes, room
from ..optional import PackageMissingError

#: What was found, as JSON has it, and arrays by name.
Answer = tuple[dict[str, Any], dict[str, np.ndarray]]

#: Seconds that a file may take, and more for each MB: text takes 0.07 s (one core that others use).
PATIENCE, PATIENCE_A_MB = 120.0, 1.0
#: How much of the memory that is free it may take.
SHARE = 0.75
#: Seconds between looks at how much that is.
LOOK_EVERY = 0.05
#: Bytes of the answer's first line, and of what OpenUSD says beside.
LONGEST_LINE, LONGEST_WORDS = 1 << 26, 10_000
REMEDY = "It is damaged, or not meant to be read: export it again."
#: What arrays may be of.
_TYPES = ("<f4", "<f8")
#: Errors that the process may answer with.
_ERRORS = {each.__name__: each for each in (BadValueError, FileDamagedError, PackageMissingError)}


def apart(path: Path, function: Callable[..., Answer], *words: Any) -> Answer:
    """``function(*words)`` in a separate process; ``path`` is the file that it is about, for the errors.

    The function is a module's own, the words are JSON's. Raises what it raises of ``_ERRORS``, and
    ``FileDamagedError`` where the process ends without an answer, or has to be stopped.
    """
    seconds = PATIENCE + PATIENCE_A_MB * path.stat().st_size / 1e6
    most = _most()
    job = json.dumps([function.__module__, function.__qualname__, words, seconds])
    command = child_command(__name__, job)
    over: list[str] = []
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said) as process,
    ):
        assert process.stdout is not None
        ended = threading.Event()
        watch = threading.Thread(target=_watch, args=(process, seconds, most, ended, over))
        watch.start()
        try:
            answer = _received(process.stdout, most)
            if answer is None:
                process.wait()
        finally:
            ended.set()
            watch.join()
            process.kill()
        said.seek(0)
        words_beside = said.read(LONGEST_WORDS).decode("utf-8", "replace")
    if over:
        raise FileDamagedError(f"{path}: OpenUSD was stopped because it {over[0]}", REMEDY)
    if answer is None:
        _raise_end(path, process.returncode, words_beside)
    values, arrays = answer
    if "error" in values:
        if values["error"] is None:
            raise FileDamagedError(f"{path}: OpenUSD does not have enough memory to read it", REMEDY)
        kind, message, hint = values["error"]
        raise _ERRORS[kind](message, hint)
    sys.stderr.write(words_beside)
    return values, arrays


def _most() -> int:
    """Bytes of memory that the process may take."""
    return int(SHARE * room().bytes)


def _watch(
    process: "subprocess.Popen[bytes]", seconds: float, most: int, ended: threading.Event, over: list[str]
) -> None:
    """Stop the process where it exceeds its limits; ``over`` gets the reason."""
    until = time.monotonic() + seconds
    with suppress(psutil.Error):  # it is gone
        child = psutil.Process(process.pid)
        while not ended.wait(LOOK_EVERY):
            if _memory_of(child) > most:
                over.append(f"took more than {gigabytes(most)} of memory")
            elif time.monotonic() > until:
                over.append(f"was not done after {seconds:.0f} s")
            if over:
                process.kill()
                return


def _memory_of(child: psutil.Process) -> int:
    """Bytes that it has; raises ``psutil.Error``."""
    taken = child.memory_info().rss
    if sys.platform == "win32":  # an environment's python.exe only starts another one
        taken += sum(each.memory_info().rss for each in child.children(recursive=True))
    return taken


def _received(stream: IO[bytes], most: int) -> Answer | None:
    """The answer, or None where it is incomplete or invalid."""
    line = stream.readline(LONGEST_LINE)
    if not line.endswith(b"\n"):
        return None
    values, kinds = json.loads(line)
    arrays = {}
    for name, kind, shape in kinds:
        if kind not in _TYPES or np.dtype(kind).itemsize * np.prod(shape, dtype=np.float64) > most:
            return None
        arrays[name] = np.empty(shape, kind)
        into = memoryview(arrays[name].reshape(-1).view(np.uint8))
        while len(into):
            count = stream.readinto(into)  # type: ignore[attr-defined]
            if not count:
                return None
            into = into[count:]
    return values, arrays


def _raise_end(path: Path, status: int, said: str) -> NoReturn:
    if status == 1:  # Python's own: a fault of ours
        raise RuntimeError(f"reading {path} failed:\n{said}")
    with suppress(ValueError):
        name = signal.Signals(-status).name
        raise FileDamagedError(f"{path} makes OpenUSD crash ({name})", REMEDY)
    raise FileDamagedError(f"{path} makes OpenUSD crash (status {status:#x})", REMEDY)


# ---- the other process ---------------------------------------------------------------------------------


def main(argv: list[str]) -> None:
    """Answer on stdout, which nothing else reaches, and end."""
    module, name, words, seconds = json.loads(argv[0])
    _without_traces(seconds)
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what OpenUSD prints
        try:
            values, arrays = getattr(importlib.import_module(module), name)(*words)
        except PhysHDRError as error:
            values, arrays = {"error": [type(error).__name__, error.message, error.hint]}, {}
        except MemoryError:
            values, arrays = {"error": None}, {}
        kinds = [[key, array.dtype.newbyteorder("<").str, array.shape] for key, array in arrays.items()]
        out.write(json.dumps([values, kinds]).encode() + b"\n")
        for array in arrays.values():
            out.write(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).data)
    os._exit(0)  # without OpenUSD's own end, which damaged stages could crash


def _without_traces(seconds: float) -> None:
    """A crash leaves no file and no window; the process ends in time, whoever is left to end it."""
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetErrorMode(0x0001 | 0x0002)  # SEM_FAILCRITICALERRORS, SEM_NOGPFAULTERRORBOX
    else:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
        signal.alarm(int(seconds) + 2)
