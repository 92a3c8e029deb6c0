# SPDX-License-Identifier: GPL-3.0-or-later
"""A disk that is full at one write after another: a tmpfs of every size between nothing and enough."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from . import commands
from .bench import PATIENCE, Bench, Result
from .commands import PAGE
from .kill_training import BEGUN, CHECKPOINT
from .oracle import (
    SkipError,
    badly_ended,
    badly_refused,
    checkpoint,
    different_folders,
    different_tensors,
    finals,
    unfinished_finals,
)
from .processes import Program

#: Bytes, more than anything here needs.
PLENTY = 256 << 20


class Tmpfs:
    """A small file system in memory, mounted at ``path``."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def resize(self, size: int) -> None:
        _mount("-o", f"remount,size={max(PAGE, size)}", self.path)

    @property
    def used(self) -> int:
        disk = os.statvfs(self.path)
        return (disk.f_blocks - disk.f_bfree) * disk.f_frsize

    def clear(self) -> None:
        for entry in self.path.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def unmount_all(folder: Path) -> None:
    """What a killed run of the torture has left mounted under the folder."""
    try:
        mounts = [Path(line.split()[1]) for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:  # not Linux: nothing was mounted
        return
    for mount in mounts:
        if folder in mount.parents:
            subprocess.run(["umount", "-l", mount], check=True)


@contextmanager
def tmpfs(path: Path) -> Iterator[Tmpfs]:
    """Raises ``SkipError`` where there can be none."""
    if sys.platform != "linux" or not hasattr(os, "geteuid") or os.geteuid() != 0:
        raise SkipError("mounting a tmpfs needs Linux and root")
    path.mkdir(parents=True, exist_ok=True)
    while os.path.ismount(path):  # left by a killed run of the torture
        subprocess.run(["umount", "-l", path], check=True)
    try:
        _mount("-t", "tmpfs", "-o", f"size={PLENTY}", "torture", path)
    except subprocess.CalledProcessError as error:
        raise SkipError(f"a tmpfs cannot be mounted here: {error.stderr.strip()}") from error
    try:
        yield Tmpfs(path)
    finally:
        subprocess.run(["umount", "-l", path], check=True)


def _mount(*words: object) -> None:
    subprocess.run(["mount", *map(str, words)], check=True, capture_output=True, text=True)


def sweep(
    bench: Bench,
    disk: Tmpfs,
    *,
    fill: Callable[[Path], None],
    start: Callable[[Path], Program],
    differs: Callable[[Path], list[str]],
    sizes: int,
    least: int,
    start_again: Callable[[Path], Program] | None = None,
    damaged: Callable[[Path], list[str]] = lambda out: [],
) -> Result:
    """The command at ``sizes`` free sizes up to what it needs; in a short run at one, half of ``least``.

    ``least``: bytes of the final output. ``fill``: what is there before. ``differs``: whether the
    output is not the undisturbed one's. ``damaged``: what must not be, right after the disk was full.
    ``start_again``: with room again.
    """
    result = Result("sizes")
    out = disk.path / "out"
    start_again = start_again or start

    def begin() -> int:
        disk.resize(PLENTY)
        disk.clear()
        fill(out)
        return disk.used

    held = begin()
    if bench.short:
        peak, frees = least, [least // 2]
    else:
        peak = _peak(disk, start(out)) - held
        frees = np.linspace(0, peak, sizes, endpoint=False).astype(int).tolist()
    refused = 0
    for free in sorted({each // PAGE * PAGE for each in frees}):
        held = begin()
        disk.resize(held + free)
        program = start(out)
        status = program.wait(PATIENCE)
        where = f"{free // 1024} of {peak // 1024} KiB free"
        result.tries += 1
        if status == 0 and not differs(out):  # it needed less than at its peak before
            result.complain(badly_ended(status, program.output()), where)
        else:
            refused += 1
            result.complain(badly_refused(status, program.output(), str(disk.path)), where)
            result.complain(damaged(out), where)
        disk.resize(PLENTY)
        result.complain(bench.done(start_again(out)), f"{where}, then room")
        result.complain(differs(out), f"{where}, then room")
        bench.say(f"{where}: {len(result.complaints)} complaints")
    result.facts.append(f"refused at {refused} of {result.tries} sizes up to {peak // 1024} KiB")
    return result


def _peak(disk: Tmpfs, program: Program) -> int:
    """The most that it held at once."""
    most = disk.used

    def look() -> bool:
        nonlocal most
        most = max(most, disk.used)
        return False

    program.until(look, PATIENCE, 0.0005)
    if complaints := badly_ended(program.wait(PATIENCE), program.output()):
        raise RuntimeError(f"it does not run on an empty disk: {complaints[0]}")
    return max(most, disk.used)


# ---- trainings -------------------------------------------------------------------------------------------


def _words(bench: Bench) -> tuple[object, ...]:
    return ("--iterations", 60 if bench.short else 200, "--threads", 1, "--seed", 5)


def disk_training(bench: Bench) -> Result:
    """From its first iteration; with room again it starts over, or resumes where it had saved."""
    data, words = bench.material.data, _words(bench)
    save = ("--checkpoint-seconds", 0.1)
    reference = bench.empty("reference")
    bench.must(bench.physhdr("train", data, "--out", reference, *words))

    def start(out: Path) -> Program:
        return bench.physhdr("train", data, "--out", out, "--overwrite", *words, *save)

    def again(out: Path) -> Program:
        if (out / CHECKPOINT).exists():
            return bench.physhdr("train", "--resume", out, "--threads", 1)
        return start(out)

    with tmpfs(bench.folder / "disk") as disk:
        return sweep(
            bench,
            disk,
            fill=lambda out: None,
            start=start,
            start_again=again,
            differs=lambda out: _not_trained(out, reference),
            damaged=_damaged,
            sizes=bench.options.sizes,
            least=_size(reference),
        )


def disk_resume(bench: Bench) -> Result:
    """From a stopped run on a full disk: its checkpoint stays whole until there is a newer one."""
    data, words = bench.material.data, _words(bench)
    reference, stopped = bench.empty("reference"), bench.empty("stopped")
    bench.must(bench.physhdr("train", data, "--out", reference, *words))
    # As the disk fills while it trains: stopped somewhere, with everything saved.
    program = bench.physhdr("train", data, "--out", stopped, *words)
    program.until(lambda: BEGUN in program.output(), PATIENCE, 0.001)
    program.interrupt()
    program.wait(PATIENCE)
    saved = int(checkpoint(stopped / CHECKPOINT)[1]["iteration"])
    bench.say(f"resumes from iteration {saved}")

    def start(out: Path) -> Program:
        return bench.physhdr("train", "--resume", out, "--threads", 1, "--checkpoint-seconds", 0.1)

    with tmpfs(bench.folder / "disk") as disk:
        return sweep(
            bench,
            disk,
            fill=lambda out: shutil.copytree(stopped, out) and None,
            start=start,
            differs=lambda out: _not_trained(out, reference),
            damaged=lambda out: _damaged(out, saved),
            sizes=bench.options.sizes,
            least=_size(reference),
        )


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in finals(folder))


def _not_trained(out: Path, reference: Path) -> list[str]:
    if not (out / CHECKPOINT).exists():
        return [f"there is no {out / CHECKPOINT}"]
    return different_tensors(out / CHECKPOINT, reference / CHECKPOINT)


def _damaged(out: Path, at_least: int = 0) -> list[str]:
    """The checkpoint loads, and is no older than the one before; if there was none, there may be none."""
    path = out / CHECKPOINT
    if not path.exists():
        return [f"{path} is missing"] if at_least else []
    try:
        iteration = int(checkpoint(path)[1]["iteration"])
    except Exception as error:  # noqa: BLE001 (whatever it is, a full disk must not damage a checkpoint)
        return [f"{path} is damaged: {error}"]
    return [f"{path} is at {iteration}, it was at {at_least}"] if iteration < at_least else []


# ---- other commands --------------------------------------------------------------------------------------


def _disk(make: Callable[[Bench], commands.Command], slow: bool = False) -> Callable[[Bench], Result]:
    def attack(bench: Bench) -> Result:
        with tmpfs(bench.folder / "disk") as disk:
            command = make(bench)
            made = commands.reference_of(bench, command)
            reference, sizes = made.folder, bench.options.sizes
            return sweep(
                bench,
                disk,
                fill=lambda out: None,
                start=command.start,
                differs=lambda out: different_folders(out, reference, command.varying),
                damaged=lambda out: unfinished_finals(out, reference, command.varying),
                sizes=max(6, sizes // 4) if slow else sizes,
                least=made.size,
            )

    return attack


disk_export = _disk(commands.export)
disk_evaluate = _disk(commands.evaluate)
disk_video = _disk(commands.video)
disk_frames = _disk(commands.frames)
disk_prepare = _disk(commands.prepare, slow=True)
disk_render = _disk(commands.render, slow=True)
