# SPDX-License-Identifier: GPL-3.0-or-later
"""Sharing a folder: one owner a picture, the dead are followed, the living are not robbed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from physhdr.synth import claims
from physhdr.synth.claims import Claims


def test_only_one_of_many_gets_a_picture(tmp_path):
    """Sixteen owners race for each of forty pictures."""
    owners = [Claims(tmp_path, host=f"host{k}", pid=os.getpid()) for k in range(16)]
    for owner in owners:
        owner.__enter__()
    with ThreadPoolExecutor(16) as pool:
        for picture in range(40):
            taken = list(pool.map(lambda owner, name=f"train_{picture:03d}": owner.take(name), owners))
            assert sum(taken) == 1
    for owner in owners:
        owner.__exit__()
    assert not (tmp_path / claims.FOLDER).exists()  # nothing is left behind


def test_a_released_picture_can_be_taken_again(tmp_path):
    with Claims(tmp_path) as first, Claims(tmp_path) as second:
        assert first.take("test_001") and not second.take("test_001")
        assert second.others() == ["test_001"] and first.others() == []
        second.release("test_001")  # not its own: nothing happens
        assert not second.take("test_001")
        first.release("test_001")
        assert second.take("test_001")


def test_a_dead_process_of_this_machine_is_followed_at_once(tmp_path):
    (tmp_path / "dies.py").write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "sys.path.insert(0, sys.argv[1])\n"
        "from synth.claims import Claims\n"
        "claims = Claims(Path(sys.argv[2]))\n"
        "claims.__enter__()\n"
        "assert claims.take('train_000')\n"
        "os._exit(9)\n"
    )
    root = Path(claims.__file__).parent.parent
    ended = subprocess.run([sys.executable, tmp_path / "dies.py", root, tmp_path], check=False)
    assert ended.returncode == 9
    held = tmp_path / claims.FOLDER / "train_000"
    assert json.loads(held.read_text())["pid"] != os.getpid()
    with Claims(tmp_path) as heir:
        assert heir.others() == []
        assert heir.take("train_000")
        assert json.loads(held.read_text())["pid"] == os.getpid()


def test_another_machine_is_followed_when_it_stays_silent(tmp_path):
    with Claims(tmp_path, host="far", pid=1, touch_every=0.05, stale_after=1.0) as far:
        assert far.take("lit_004")
        with Claims(tmp_path, stale_after=1.0) as near:
            time.sleep(1.3)
            assert not near.take("lit_004")  # it gives signs of life
            far._end.set()
            far._thread.join()
            time.sleep(1.3)
            assert near.take("lit_004")
            far.release("lit_004")  # it wakes up too late: the claim is not its own any more
            assert (tmp_path / claims.FOLDER / "lit_004").exists()


def test_without_hard_links_it_works_too(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError("no links here")

    monkeypatch.setattr(os, "link", refuse)
    with Claims(tmp_path) as first, Claims(tmp_path) as second:
        assert first.take("a") and not second.take("a")


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / claims.FOLDER).write_text("a file in the way")
    with pytest.raises(OSError), Claims(tmp_path):
        pass
