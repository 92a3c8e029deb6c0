# SPDX-License-Identifier: GPL-3.0-or-later
"""A process of its own for OpenUSD: whatever becomes of it, this one is told in one error.

Functions of Python's own stand for an OpenUSD that crashes, waits or takes memory.
"""

import json
import operator
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main
from physhdr.backend.formats import apart as apart_module
from physhdr.backend.formats import usd_stage
from physhdr.backend.formats.apart import apart
from physhdr.backend.formats.usd import read_usd, write_usd
from physhdr.bridge.errors import BadValueError, FileDamagedError

pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")

#: A damaged stage of 1.5 kB (two bytes of one of ours): OpenUSD 26.11 reads where nothing is.
CRASH = Path(__file__).resolve().parents[2] / "fixtures" / "crash.usdc"


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    (tmp_path / "a stage é.usdc").write_bytes(b"PXR-USDC")
    return tmp_path / "a stage é.usdc"


def refused(path: Path, function, *words) -> str:
    with pytest.raises(FileDamagedError) as caught:
        apart(path, function, *words)
    assert str(path) in caught.value.message and caught.value.hint
    return caught.value.message


def test_a_crash_names_the_file(stage: Path) -> None:
    assert "crash" in refused(stage, os.abort)
    assert "crash" in refused(stage, os._exit, 3)


def test_a_stage_that_crashes_openusd_is_refused(capfd) -> None:
    """The command lives, and answers as it does otherwise."""
    with pytest.raises(FileDamagedError, match=r"crash\.usdc .*OpenUSD crash|not a readable USD file"):
        read_usd(CRASH)
    assert main(["export", str(CRASH), "never.ply", "--json"]) == 1
    said = capfd.readouterr()
    assert json.loads(said.out)["error"]["code"] == "file_damaged" and said.err == ""
    assert not Path("never.ply").exists()


def test_who_is_not_done_in_time_is_ended(stage: Path, monkeypatch) -> None:
    monkeypatch.setattr(apart_module, "PATIENCE", 1.5)
    begun = time.monotonic()
    assert "not done after 2 s" in refused(stage, time.sleep, 1000)
    assert time.monotonic() - begun < 20.0


def test_who_takes_too_much_memory_is_ended(stage: Path, monkeypatch) -> None:
    monkeypatch.setattr(apart_module, "_most", lambda: 300_000_000)
    assert "more than 0.3 GB" in refused(stage, operator.mul, "a", 2_000_000_000)


def test_a_lack_of_memory_within_is_told(stage: Path) -> None:
    """No machine has 2⁵⁰ bytes."""
    assert "does not have enough memory" in refused(stage, operator.mul, "a", 1 << 50)


def test_errors_come_back_as_they_were(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    with pytest.raises(BadValueError, match="has no camera") as caught:
        apart(tmp_path / "a.usda", usd_stage.camera_of, str(tmp_path / "a.usda"), None, 10, "")
    assert "Export one" in caught.value.hint


def test_a_fault_of_ours_is_no_damage(stage: Path) -> None:
    """With the other process's traceback."""
    with pytest.raises(RuntimeError, match="TypeError"):
        apart(stage, os.abort, "a word too many")


def test_arrays_arrive_to_the_bit(cloud, tmp_path: Path) -> None:
    """Asked here and there: among them such as are large for a pipe, NaN and nothing."""
    cloud.position[3] = np.nan
    write_usd(tmp_path / "a.usdc", cloud)
    here, there = (
        ask(str(tmp_path / "a.usdc"))
        for ask in (usd_stage.gaussians_of, lambda name: apart(Path(name), usd_stage.gaussians_of, name))
    )
    assert there[0] == here[0] and set(there[1]) == set(here[1])
    for name, array in here[1].items():
        np.testing.assert_array_equal(there[1][name], array)
        assert there[1][name].dtype == array.dtype


def test_what_openusd_prints_is_no_answer(cloud, tmp_path: Path, capfd) -> None:
    """It warns of a file that is not there; on stderr, where people see it."""
    write_usd(tmp_path / "a.usda", cloud)
    text = (tmp_path / "a.usda").read_text()
    (tmp_path / "a.usda").write_text(text + '\ndef "B" (references = @gone.usdc@)\n{\n}\n')
    assert read_usd(tmp_path / "a.usda").cloud.count == cloud.count
    said = capfd.readouterr()
    assert said.out == "" and "gone.usdc" in said.err


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_nothing_stays_behind(stage: Path, tmp_path: Path, monkeypatch) -> None:
    """No process, no file, no open descriptor, whoever interrupts."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    before = sorted(os.listdir("/proc/self/fd"))

    def interrupted(*_) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(apart_module, "_received", interrupted)
    with pytest.raises(KeyboardInterrupt):
        apart(stage, time.sleep, 1000)
    assert sorted(os.listdir("/proc/self/fd")) == before
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    assert not children and list(tmp_path.iterdir()) == [stage]
