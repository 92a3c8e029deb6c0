# SPDX-License-Identifier: GPL-3.0-or-later
"""A lack of memory, or of disk, ends a command in one clear message, whoever notices it and wherever."""

import errno
import json
import os
import subprocess
import sys

import pytest

from physhdr.backend import cli, memory
from physhdr.backend.cli import main
from physhdr.bridge.errors import FileDamagedError, OutputError

resource = pytest.importorskip("resource", reason="limits of a process are POSIX's")


def under_limit(megabytes: int, *argv: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own that may have so many megabytes of addresses."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({megabytes}_000_000,) * 2)"
    call = "import sys; from physhdr.backend.cli import main; sys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", f"{limit}\n{call}", *argv], capture_output=True, text=True, timeout=120
    )


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere ulimit -v binds nothing")
@pytest.mark.parametrize(("megabytes", "command"), [(300, "inspect"), (600, "train"), (1000, "evaluate")])
def test_under_ulimit_a_command_says_what_to_do(megabytes, command, tmp_path):
    done = under_limit(megabytes, command, str(tmp_path))
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("error: there is not enough memory") and done.stderr.count("error:") == 1
    assert "ulimit -v unlimited" in done.stderr and "Traceback" not in done.stderr


class Failing:
    """A command that ends in an error."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def run(self) -> int:
        raise self.error


def told(monkeypatch, capsys, error: BaseException, *argv: str) -> str:
    """What the command line tells of an error, which must be one message."""
    monkeypatch.setattr(cli, "_command", lambda _: Failing(error))
    assert main(list(argv) or ["render"]) == 1
    message = capsys.readouterr().err
    assert message.startswith("error: ") and message.count("error: ") == 1
    return message


def caused(error: BaseException, cause: BaseException) -> BaseException:
    error.__cause__ = cause
    return error


class PagingFileError(OSError):
    """As Windows numbers it, whose ``errno`` is that of a bad argument."""

    winerror = 1455


LINKER = "libtorch_cpu.so: failed to map segment from shared object"
LACKS = [
    MemoryError(),
    OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
    RuntimeError("[enforce fail at alloc_cpu.cpp:124] DefaultCPUAllocator: can't allocate memory: 8 bytes"),
    RuntimeError("CUDA out of memory. Tried to allocate 2.00 GiB"),
    RuntimeError("can't start new thread"),
    ImportError(LINKER),
    caused(OSError("Could not find/load shared object file 'libllvmlite.so'"), OSError(LINKER)),
    PagingFileError(errno.EINVAL, "Die Auslagerungsdatei ist zu klein, um diesen Vorgang durchzuführen"),
    ImportError(
        "DLL load failed while importing _C: The paging file is too small for this operation to complete."
    ),
    caused(FileDamagedError("points3d.ply is not a point cloud", "Restore a copy."), MemoryError()),
]


@pytest.mark.parametrize("error", LACKS, ids=lambda error: f"{type(error).__name__} {error}"[:40])
def test_every_lack_of_memory_is_told_as_one(monkeypatch, capsys, error):
    message = told(monkeypatch, capsys, error)
    assert "there is not enough memory" in message and "Close other programs" in message


def test_a_training_that_lacks_memory_names_its_options_and_what_was_saved(monkeypatch, capsys, tmp_path):
    told_of_nothing = told(monkeypatch, capsys, MemoryError(), "train", "data", "--out", str(tmp_path))
    assert "--downscale" in told_of_nothing and "--resume" not in told_of_nothing
    (tmp_path / "checkpoint.safetensors").touch()
    for argv in (["data", "--out", str(tmp_path)], [f"--resume={tmp_path}"]):
        message = told(monkeypatch, capsys, MemoryError(), "train", *argv)
        assert f"physhdr train --resume {tmp_path}" in message


def test_a_fault_of_ours_keeps_its_traceback(monkeypatch):
    monkeypatch.setattr(cli, "_command", lambda _: Failing(RuntimeError("shapes do not match")))
    with pytest.raises(RuntimeError, match="shapes"):
        main(["render"])


def test_an_error_of_the_system_names_the_file_where_there_is_one(monkeypatch, capsys, tmp_path):
    denied = OSError(errno.EACCES, "Permission denied", str(tmp_path / "picture.png"))
    message = told(monkeypatch, capsys, denied)
    assert f"{tmp_path / 'picture.png'}: Permission denied" in message and "permissions" in message


def test_a_full_disk_is_told_as_one_and_names_the_run(monkeypatch, capsys, tmp_path):
    full = OSError(errno.ENOSPC, "No space left on device")
    (tmp_path / "checkpoint.safetensors").touch()
    message = told(monkeypatch, capsys, full, "train", "--resume", str(tmp_path))
    assert "No space left on device" in message and "that path" not in message
    assert "Free some space" in message and f"physhdr train --resume {tmp_path}" in message


def test_a_training_that_could_not_write_says_how_it_is_resumed(monkeypatch, capsys, tmp_path):
    refused = OutputError("cannot write the checkpoint", "Free some space, then resume the training.")
    (tmp_path / "checkpoint.safetensors").touch()
    resume = f"resume the training. Resume from the checkpoint: physhdr train --resume {tmp_path}"
    assert resume in told(monkeypatch, capsys, refused, "train", "data", "--out", str(tmp_path))
    assert "--resume" not in told(monkeypatch, capsys, refused, "render", str(tmp_path))


# -- what there is -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [1, 2])
def test_the_nearest_limit_of_the_control_groups_counts(tmp_path, version):
    """A group is limited by those that hold it, and what it has of unused files counts as free."""
    membership, mount = tmp_path / "cgroup", tmp_path / "fs"
    root = mount if version == 2 else mount / "memory"
    names = ("memory.max", "memory.current", "inactive_file")
    if version == 1:
        names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
    membership.write_text("0::/outer/inner\n" if version == 2 else "5:cpu:/x\n4:memory:/outer/inner\n")
    for folder, limit, used in (("outer", "1000", 700), ("outer/inner", "5000", 600)):
        (root / folder).mkdir(parents=True)
        (root / folder / names[0]).write_text(f"{limit}\n")
        (root / folder / names[1]).write_text(f"{used}\n")
        (root / folder / "memory.stat").write_text(f"anon 1\n{names[2]} 50\n")
    assert memory.cgroup_left(membership, mount) == 1000 - 700 + 50
    (root / "outer" / names[0]).write_text("max\n")
    assert memory.cgroup_left(membership, mount) == 5000 - 600 + 50
    assert memory.cgroup_left(tmp_path / "none", mount) is None


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere ulimit -v binds nothing")
def test_room_is_what_ulimit_leaves_where_that_is_least():
    code = (
        "import json, resource; from physhdr.backend import memory; free = memory.room();"
        "resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000,) * 2); left = memory.room();"
        "print(json.dumps([free.bound, left.bytes, left.bound]))"
    )
    told = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout)
    assert told[0] != "addresses" and told[2] == "addresses"
    assert told[1] < 2_000_000_000 - memory.UNTOUCHED_ADDRESSES
