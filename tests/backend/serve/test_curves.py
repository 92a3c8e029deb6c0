# SPDX-License-Identifier: GPL-3.0-or-later
"""The curves of an earlier part of a run: whatever its log holds, the run can be opened."""

import json
import os
import time
from pathlib import Path
from types import ModuleType

import pytest

from physhdr.backend.serve.curves import Curves

GOOD = {
    "event": "progress",
    "iteration": 3,
    "losses": {"l1": 0.25, "consistency": 0.5},
    "monitor": {"PSNR": 20.0},
}


def history_of(log: Path):
    curves = Curves()
    curves.read(log, until=100)
    return curves.history()


def test_any_value_in_a_line(tmp_path: Path, fuzzing: ModuleType) -> None:
    damaged = [*fuzzing.JSON_TEXTS, *map(fuzzing.json_bytes, fuzzing.json_mutations(GOOD, 600, 1))]
    last = fuzzing.json_bytes(GOOD | {"iteration": 7})
    for case, line in enumerate(damaged):
        (tmp_path / "log.jsonl").write_bytes(line.replace(b"\n", b" ") + b"\n" + last + b"\n")
        history = history_of(tmp_path / "log.jsonl")
        assert all(isinstance(value, float) for value in (*history.losses, *history.psnr)), f"case {case}"
        if history.iterations[:1] <= (7,):  # else a greater number came first, and later ones are done twice
            assert (history.iterations[-1], history.losses[-1], history.psnr[-1]) == (7, 0.75, 20.0), (
                f"case {case}"
            )


@pytest.mark.parametrize("monitor", [{"PSNR": None}, {"PSNR": "high"}, {"PSNR": 10**400}, [1], 7, True])
def test_a_monitor_that_means_nothing_leaves_its_line_out(tmp_path: Path, monitor: object) -> None:
    lines = [json.dumps(GOOD | {"monitor": monitor}), json.dumps(GOOD | {"iteration": 4}), '{"event": "prog']
    (tmp_path / "log.jsonl").write_text("\n".join(lines))
    assert history_of(tmp_path / "log.jsonl").iterations == (4,)


@pytest.mark.usefixtures("never_waits")
def test_a_log_that_is_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.jsonl")
    for path in (tmp_path / "log.jsonl", tmp_path, tmp_path / "gone"):
        assert history_of(path).iterations == ()


def test_a_log_of_line_ends_takes_no_time(tmp_path: Path) -> None:
    """5 s a megabyte, each of which was the error of a line that is no JSON."""
    lines = [json.dumps(GOOD | {"iteration": iteration}) for iteration in (1, 2)]
    (tmp_path / "log.jsonl").write_text(("\n" * 2_000_000).join(lines))
    begun = time.process_time()
    assert history_of(tmp_path / "log.jsonl").iterations == (1, 2)
    assert time.process_time() - begun < 3.0
