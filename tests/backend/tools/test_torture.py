# SPDX-License-Identifier: GPL-3.0-or-later
"""The oracles of tests/stress/torture.py find what is wrong: each is shown something broken, and it whole."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

STRESS = Path(__file__).resolve().parents[2] / "stress"

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="process groups are POSIX's")


@pytest.fixture(autouse=True)
def tools(monkeypatch):
    monkeypatch.syspath_prepend(STRESS)


def write_checkpoint(path: Path, value: float = 1.0, seconds: str = "1.0", iteration: str = "10") -> Path:
    from physhdr.backend.train.checkpoint import FORMAT, VERSION

    said = {"format": FORMAT, "version": str(VERSION), "iteration": iteration, "seconds": seconds}
    tensors = {"gaussians.means": torch.full((50, 3), value), "networks.x": torch.arange(4)}
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, path, said)
    return path


def test_checkpoints_are_compared_bit_for_bit(tmp_path):
    from torture_attacks.oracle import different_tensors, whole

    one = write_checkpoint(tmp_path / "one.safetensors")
    assert different_tensors(one, write_checkpoint(tmp_path / "two.safetensors", seconds="2.5")) == []
    nearly = write_checkpoint(tmp_path / "three.safetensors", 1.0 + 2.0**-23)  # one bit of each float
    assert "gaussians.means differs" in different_tensors(one, nearly)[0]
    later = write_checkpoint(tmp_path / "four.safetensors", iteration="11")
    assert "iteration" in different_tensors(one, later)[0]
    assert whole(one) == []
    one.write_bytes(one.read_bytes()[:-1])
    assert "not whole" in whole(one)[0]


def test_half_a_file_under_its_final_name_is_found(tmp_path):
    from torture_attacks.oracle import different_folders, temporaries, unfinished_finals

    made, reference = tmp_path / "made", tmp_path / "reference"
    for folder in (made, reference):
        folder.mkdir()
        (folder / "table.md").write_text("| a | b |\n| 1 | 2 |\n")
        (folder / "numbers.json").write_text(f'{{"x": 1, "seconds": {len(folder.name)}}}')
    assert unfinished_finals(made, reference) == different_folders(made, reference) == []
    (made / ".table-x7.md").write_text("| a |")
    assert unfinished_finals(made, reference) == []  # it has not got its name
    assert [path.name for path in temporaries(made)] == [".table-x7.md"]
    (made / "table.md").write_text("| a | b |\n")
    assert len(unfinished_finals(made, reference)) == 1
    (made / "table.md").unlink()
    assert unfinished_finals(made, reference) == []
    assert "is missing" in different_folders(made, reference)[0]
    (made / "new.json").write_text('{"x": ')  # nobody knows its content, but it is no JSON
    assert "not whole" in unfinished_finals(made, reference)[0]


GOOD = "error: cannot write /small/run/checkpoint: No space left on device\n  Free some space, then resume.\n"


@pytest.mark.parametrize(
    ("status", "said", "complaint"),
    [
        (0, GOOD, "as if all were well"),
        (-9, GOOD, "signal 9"),
        (1, "Traceback (most recent call last):\n  File …\nOSError: full\n", "Traceback"),
        (1, GOOD + "Exception ignored in: <_io.FileIO>\n", "Exception ignored"),
        (1, GOOD + GOOD, "2 lines begin with 'error:'"),
        (1, "OSError\n", "0 lines begin with 'error:'"),
        (1, GOOD.replace("/small", "/other"), "does not name /small"),
        (1, "error: cannot write /small/run\n", "no remedy"),
    ],
)
def test_what_is_no_message_for_a_user(status, said, complaint):
    from torture_attacks.oracle import badly_refused

    assert badly_refused(1, "computing on the CPU\n" + GOOD, "/small") == []
    assert complaint in "; ".join(badly_refused(status, said, "/small"))


def test_a_leak_is_told_from_noise():
    from torture_attacks.oracle import grown, not_given_back

    warm_up = [300.0, 450.0, 500.0, 505.0]
    noise = [500.0 + 30.0 * (i % 3) for i in range(36)]
    assert grown(warm_up + noise) == []
    assert "memory grew" in grown(warm_up + [value + 3.0 * i for i, value in enumerate(noise)])[0]
    assert grown([1.0, 1.0]) != []  # too few to say so
    assert not_given_back("threads", 4, 4) == [] != not_given_back("threads", 4, 5)


def test_what_a_kill_cost():
    """10 s of training, saved at iteration 60 that was reached after 6 s."""
    from torture_attacks.oracle import lost_seconds

    told = [{"event": "started", "time": 100.0, "iteration": 0}]
    told += [{"event": "progress", "time": 100.0 + i / 10, "iteration": i} for i in range(20, 101, 20)]
    assert lost_seconds(told, 60, 110.0) == pytest.approx(4.0)
    assert lost_seconds(told, 0, 110.0) == pytest.approx(10.0)  # no checkpoint at all
    assert lost_seconds([], 0, 110.0) == 0.0  # it had only been starting


def test_a_kill_that_costs_too_much():
    from torture_attacks.kill_training import too_dear

    kills = [{"moment": "random", "lost": lost} for lost in (0.0, 59.0, 61.0)]
    assert too_dear(kills, 60.0) == ["a kill (random) cost 61.0 s"]


def test_what_a_strangers_file_makes_happen_is_told_from_what_blender_does(tmp_path):
    """Lines of strace, and of the script that lives with the file in Blender."""
    from torture_attacks.stranger import reported_events, traced
    from torture_attacks.watch import BEGIN, LIVED, NETWORK, places, watched

    before = [
        '7 execve("/usr/bin/python", ["python"], 0x1 /* 9 vars */) = 0',
        '7 stat("/elsewhere/x", 0x1) = 0',
    ]
    begins = f'7 newfstatat(AT_FDCWD, "{BEGIN}", 0x1, 0) = -1 ENOENT'
    named = places(Path("/elsewhere"))
    own = ['7 openat(AT_FDCWD, "/files/file.blend", O_RDONLY) = 3', "7 --- SIGCHLD {si_signo=SIGCHLD} ---"]
    assert traced([*before, begins, *own], named) == []
    in_network = NETWORK.replace("\\", "\\\\")
    for line in (
        '8 execve("/usr/bin/python", ["python", "launch.py"], 0x1) = 0',
        '7 newfstatat(AT_FDCWD, "/elsewhere/data", 0x1, 0) = -1 ENOENT',
        f'7 lstat("/files/{in_network}\\data", 0x1) = -1 ENOENT',
    ):
        assert traced([*before, begins, *own, line], named) == [line]
    assert traced(before, named) == ["strace did not see the beginning"]

    assert reported_events(f"Read blend: file.blend\n{LIVED}\n") == []
    with watched(str(tmp_path)) as found:
        (tmp_path / "x").exists()
    assert reported_events(f"{found[0]}\n{LIVED}\n") == [f"os.stat {tmp_path / 'x'}"]
    assert "did not come to its end: Segmentation fault" in reported_events("Segmentation fault")[0]


# ---- programs that are killed ----------------------------------------------------------------------------

PYTHON = [sys.executable, "-I", "-S", "-c"]


def test_a_kill_takes_the_children_too_and_only_counts_if_it_came_in_time(tmp_path):
    from torture_attacks.processes import Program, StuckError

    two = "import subprocess, sys; p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True); p.wait()"
    program = Program([*PYTHON, two], tmp_path / "log")
    assert program.until(lambda: program.output().strip() != "", 30.0)
    assert program.kill() and program.poll() == -signal.SIGKILL
    child = int(program.output())
    deadline = time.monotonic() + 10.0
    while is_running(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(child)

    ended = Program([*PYTHON, "raise SystemExit(3)"], tmp_path / "log")
    assert ended.wait(30.0) == 3 and not ended.kill()
    with pytest.raises(StuckError):
        Program(["sleep", "60"], tmp_path / "log").wait(0.2)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux's PR_SET_PDEATHSIG")
def test_what_was_started_ends_with_a_torture_that_is_killed(tmp_path):
    script = f"""
        import sys, time
        from pathlib import Path
        sys.path.insert(0, {str(STRESS)!r})
        from torture_attacks.processes import Program
        print(Program(["sleep", "60"], Path({str(tmp_path / "log")!r})).pid, flush=True)
        time.sleep(60)
    """
    tool = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True
    )
    assert tool.stdout
    started = int(tool.stdout.readline())
    assert is_running(started)
    tool.kill()
    tool.wait()
    deadline = time.monotonic() + 10.0
    while is_running(started) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(started)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


# ---- whole attacks, on programs that are made for it -----------------------------------------------------

SLOW_WRITER = """
import os, sys, time
out = sys.argv[1]
os.makedirs(out, exist_ok=True)
for name in ("first.md", "second.md"):
    path = os.path.join(out, name)
    pending = os.path.join(out, "." + name) if sys.argv[2] == "carefully" else path
    with open(pending, "w") as file:
        for i in range(8):
            file.write("line %d\\n" % i)
            file.flush()
            time.sleep(0.01)
    os.replace(pending, path)
"""


def bench_in(folder: Path):
    from torture_attacks.bench import Bench, Options

    options = Options(
        short=False,
        seed=0,
        data=None,
        trainings=1,
        kills=1,
        threads=1,
        jobs=1,
        tries=8,
        sizes=4,
        soak_seconds=1,
    )
    return Bench("test", folder, options, lambda: pytest.fail("not needed"), None, lambda text: None)


@pytest.mark.long
@pytest.mark.parametrize("how", ["carefully", "in place"])
def test_the_attack_finds_files_that_are_written_in_place(tmp_path, how):
    """The same program killed at the same moments: with a rename at the end, and without."""
    from torture_attacks.commands import Command
    from torture_attacks.kill_commands import kill
    from torture_attacks.processes import Program

    def start(out: Path) -> Program:
        return Program([*PYTHON, SLOW_WRITER, out, how], tmp_path / "log")

    result = kill(lambda bench: Command(how.replace(" ", "-"), start))(bench_in(tmp_path))
    assert result.tries >= 3
    assert bool(result.complaints) == (how == "in place"), result.complaints


def test_a_row_says_what_was_not_borne(tmp_path):
    from torture_attacks.bench import Result, row_of, rows_in, table
    from torture_attacks.oracle import SkipError

    def skipped(bench):
        raise SkipError("there is no Blender")

    def broken(bench):
        raise RuntimeError("no reference")

    attacks = {
        "ok": lambda bench: Result("kills", 3),
        "FAILED": lambda bench: Result("kills", 3, [f"number {i}" for i in range(5)]),
        "skipped": skipped,
    }
    for verdict, attack in attacks.items():
        row = row_of("name", "what", attack, bench_in(tmp_path), "code")
        assert row.verdict == verdict
    assert row_of("name", "what", broken, bench_in(tmp_path), "code").verdict == "FAILED"
    row = row_of("name", "a | b", attacks["FAILED"], bench_in(tmp_path), "code")
    row.write(tmp_path / "test")
    assert rows_in(tmp_path) == [row]
    assert "5 complaints: number 0; number 1; number 2; and 2 more" in table([row]) and r"a \| b" in table(
        [row]
    )
