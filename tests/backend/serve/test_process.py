# SPDX-License-Identifier: GPL-3.0-or-later
"""The process: its home, how it is found, how it ends; and how the extension starts it."""

import errno
import json
import os
import runpy
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed

from physhdr.backend.serve.failures import failure_of
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.bridge.connection import CONNECTION_FILE
from physhdr.bridge.messages import Done, Shutdown, TrainStart

ROOT = Path(__file__).resolve().parents[3]


def farewell(peer):
    """(code, reason) of the close."""
    with pytest.raises(ConnectionClosed) as closed:
        peer.until(lambda: False, 30.0)
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.long
def test_one_home_one_backend_and_its_end_when_idle(start):
    """Found by a file for its owner alone; a second one is refused; alone, it ends and tidies up."""
    first = start("--idle-timeout", "2")
    file = first.home / CONNECTION_FILE
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert len(bytes.fromhex(first.connection.token)) == 32
    command = [Path(sys.executable).with_name("physhdr"), "serve", "--home", str(first.home)]
    second = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert second.returncode == 1 and second.stderr.startswith("error: ") and "Traceback" not in second.stderr
    assert f"process {first.process.pid}" in second.stderr
    assert json.loads(file.read_text())["pid"] == first.process.pid  # still its own
    assert first.process.wait(30) == 0
    assert not file.exists() and "nobody was connected for 2 seconds" in first.log.read_text()

    # What a killed backend (or anybody) left there is replaced, whatever it says.
    file.write_text(json.dumps({"pid": os.getpid(), "nonsense": True}))
    third = start(home=first.home)
    assert third.connection.pid == third.process.pid
    assert third.end(signal.SIGINT) == 0 and not file.exists()


@pytest.mark.long
def test_a_connected_client_keeps_it_until_shutdown(start, enter):
    backend = start("--idle-timeout", "0.5")
    peer = enter(backend, "Blender")
    peer.wait_for("idle")
    time.sleep(1.5)
    assert backend.process.poll() is None
    assert peer.ask(Shutdown()) == Done()
    assert farewell(peer) == (1001, "Blender shut the backend down")
    assert backend.process.wait(30) == 0


@pytest.mark.long
def test_a_signal_saves_the_training_and_says_good_bye(start, enter, tiny_data, tmp_path):
    backend = start()
    peer = enter(backend)
    out = tmp_path / "run"
    peer.ask(TrainStart(data=str(tiny_data), out=str(out), iterations=100_000))
    peer.until(lambda: peer.status.iteration > 10)
    backend.process.send_signal(signal.SIGTERM)
    code, reason = farewell(peer)
    assert code == 1001 and "SIGTERM" in reason
    assert peer.status.state == "stopped" and backend.process.wait(30) == 0
    saved = int(load_checkpoint(out / "checkpoint.safetensors")[1]["iteration"])
    assert saved == peer.status.iteration == peer.status.saved_iteration


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("raise ModuleNotFoundError(\"No module named 'sympy'\")", "No module named 'sympy'"),
        ("raise OSError('[WinError 126] Error loading c10.dll')", "Error loading c10.dll"),
        ("raise AttributeError('half a torch')", "half a torch"),
    ],
)
def test_a_backend_that_cannot_start_says_why(start, enter, tmp_path, monkeypatch, line, said):
    """A torch that a client waits for, and that does not load in the end."""
    (tmp_path / "broken").mkdir()
    go = tmp_path / "go"
    waits = f"import os, time\nwhile not os.path.exists({str(go)!r}): time.sleep(0.01)\n"
    (tmp_path / "broken" / "torch.py").write_text(waits + line)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "broken"), prepend=os.pathsep)
    backend = start()
    peer = enter(backend)
    go.touch()
    code, reason = farewell(peer)
    assert code == 1011 and backend.process.wait(30) == 1
    failure = peer.status.failure
    assert peer.status.state == "failed" and peer.status.run == "" and said in failure.message
    assert failure.code == ("internal" if "half" in said else "package_missing") and failure.hint
    assert failure.message.startswith(reason[:60])


@pytest.mark.parametrize("seconds", ["nan", "-5"])
def test_an_idle_time_that_is_none_is_refused(tmp_path, seconds, capsys):
    from physhdr.backend.cli import main

    assert main(["serve", "--home", str(tmp_path / "home"), "--idle-timeout", seconds]) == 1
    assert "--idle-timeout must be 0 or more" in capsys.readouterr().err and not (tmp_path / "home").exists()


@pytest.mark.parametrize(
    "error",
    [MemoryError(), RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried …")],
)
def test_lack_of_memory_has_a_code_and_advice(error):
    failure = failure_of(error)
    assert failure.code == "out_of_memory" and "smaller pictures" in failure.hint
    assert failure_of(ValueError("x"), "/the.log").code == "internal"
    assert "/the.log" in failure_of(ValueError("x"), "/the.log").hint


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_a_disk_that_refuses_is_no_fault_of_ours(number):
    """With the file where the system names it, else with the folder that was worked in, as far as known."""
    words = os.strerror(number)
    named = failure_of(OSError(number, words, "/runs/one/log.jsonl"), "/the.log", "/runs/one")
    assert named.code == "path" and f"/runs/one/log.jsonl: {words}" in named.message and "disk" in named.hint
    placed = failure_of(OSError(number, words), "/the.log", "/runs/one")
    assert placed.code == "path" and f"a file in /runs/one: {words}" in placed.message
    assert words in failure_of(OSError(number, words)).message
    renamed = failure_of(OSError(number, words, "/runs/.tmp-1", None, "/runs/name"))
    assert "/runs/name" in renamed.message and ".tmp" not in renamed.message


def test_other_errors_of_the_system_are_faults_of_ours(tmp_path):
    assert failure_of(ConnectionResetError(errno.ECONNRESET, "reset")).code == "internal"
    assert failure_of(ChildProcessError("x")).code == "internal"
    with pytest.raises(OSError, match="Bad file") as broken:
        os.fstat(10**6)
    assert failure_of(broken.value).code == "internal"


def test_a_path_of_bytes_that_are_no_text_can_be_shown(tmp_path):
    name = os.fsencode(tmp_path) + b"/\xff" + b"x" * 300
    with pytest.raises(OSError, match="too long") as refused:
        os.stat(name)
    failure = failure_of(refused.value)
    assert failure.code == "path" and failure.message.encode("utf-8") and "shorter" in failure.hint


# ---- launch.py -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def extension(tmp_path_factory):
    """The code as the extension has it: not installed, in a folder of another name."""
    folder = tmp_path_factory.mktemp("extensions") / "a name of its own"
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("backend", "bridge", "lab"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in ("__init__.py", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    return folder


def launched(extension, *arguments, python=(sys.executable, "-E")):
    command = [*python, str(extension / "backend" / "launch.py"), *arguments]
    return subprocess.run(command, cwd="/", capture_output=True, text=True, timeout=120)


def test_the_requirements_are_those_of_pyproject(extension):
    done = launched(extension, "requirements", python=(sys.executable, "-I", "-S"))  # nothing is installed
    assert done.returncode == 0, done.stderr
    listed = done.stdout.splitlines()
    pyproject = (ROOT / "pyproject.toml").read_text()
    assert all(f'"{requirement}"' in pyproject for requirement in listed)
    names = {line.partition(">")[0] for line in listed}
    assert {"numpy", "torch", "websockets", "safetensors"} <= names and "pytest" not in names
    assert launched(extension, "requirements", "warp").stdout.splitlines()[-1].startswith("warp-lang")


def test_check_names_the_module_that_is_missing(extension):
    """Where not even numpy is there; and the same in words."""
    bare = (sys.executable, "-I", "-S")
    done = launched(extension, "check", "--json", python=bare)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 1 and lines[0] == {"progress": 0.0, "message": "importing numpy"}
    error = lines[-1]["error"]
    assert error["code"] == "missing_module" and "numpy" in error["message"]
    assert "pip install 'numpy" in error["hint"] and sys.executable in error["message"]
    in_words = launched(extension, "check", python=bare)
    assert in_words.returncode == 1 and in_words.stderr.startswith("error: ")
    for command in (("serve", "--home", "/nonexistent"), ("calibrate",)):
        done = launched(extension, *command, python=bare)
        assert done.returncode == 1 and "physhdr check" in done.stderr and "Traceback" not in done.stderr


def test_nothing_is_written_into_the_extension(extension):
    done = launched(extension, "serve", "--help")
    assert done.returncode == 0 and "--idle-timeout" in done.stdout
    assert not list(extension.rglob("__pycache__"))


def test_processes_that_compile_find_the_package(extension):
    """What ``multiprocessing`` does in a spawned child: run the main file under another name, then import."""
    script = (
        "import runpy, sys\n"
        f"runpy.run_path({str(extension / 'backend' / 'launch.py')!r}, run_name='__mp_main__')\n"
        "import physhdr.bridge.errors as errors\n"
        "sys.stdout.write(errors.__file__)\n"
    )
    done = subprocess.run([sys.executable, "-E", "-c", script], cwd="/", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout).is_relative_to(extension)  # this one, though another is installed here
    assert not list(extension.rglob("__pycache__"))


def test_a_python_that_is_too_old_is_told_so(extension, monkeypatch, capsys):
    monkeypatch.setattr(sys, "version_info", (3, 9, 0, "final", 0))
    monkeypatch.setattr(sys, "argv", ["launch.py", "check", "--json"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(extension / "backend" / "launch.py"), run_name="__main__")
    told = capsys.readouterr()
    assert ended.value.code == 1 and "3.11 or newer" in told.err
    assert json.loads(told.out)["error"]["code"] == "python_too_old"


@pytest.mark.long
def test_check_does_a_training_step(capsys):
    """Where everything is there: progress that never goes back, versions, a finite loss."""
    from physhdr.backend.cli import main

    assert main(["check", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fractions = [line["progress"] for line in lines[:-1]]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    found = lines[-1]["result"]
    assert 0.0 < found["loss"] < 10.0 and found["gaussians"] == 200 and found["device"] in ("cpu", "cuda")
    assert found["versions"]["torch"] and set(found["seconds"]) >= {"imports", "training step"}
    assert found["warnings"] == []
