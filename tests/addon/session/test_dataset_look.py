# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set on a drive that is slow, or hangs, holds nobody up."""

import threading
import time
from types import SimpleNamespace

import pytest

from physhdr.addon.session import dataset_look
from physhdr.addon.session.session import DATASET_SECONDS, Session
from physhdr.addon.session.state import Dataset, FileOpened


@pytest.fixture
def drive(monkeypatch):
    """Folders whose look ends once they are let go: an event for each."""
    gates = {name: threading.Event() for name in ("kitchen", "hall")}

    def summarise(folder):
        gates[folder.name].wait(60.0)
        return SimpleNamespace(lines=[f"{folder.name}: 3 views"], warnings=[])

    monkeypatch.setattr(dataset_look, "summarise", summarise)
    yield gates
    for gate in gates.values():
        gate.set()


@pytest.fixture
def session(tmp_path):
    return Session(tmp_path / "home", tmp_path / "launch.py")


def test_a_slow_drive_is_not_waited_for(session, drive):
    began = time.monotonic()
    session.choose_dataset("/nas/kitchen")
    assert time.monotonic() - began < DATASET_SECONDS + 1.0  # and not the drive's minute
    assert session.state.dataset == Dataset("/nas/kitchen") and session.busy
    session.pump()
    assert session.state.dataset == Dataset("/nas/kitchen")
    drive["kitchen"].set()
    assert session.wait(lambda state: state.dataset.lines == ("kitchen: 3 views",), 60.0)
    assert not session.busy


def test_what_is_looked_at_no_more_is_not_told(session, drive):
    session.choose_dataset("/nas/kitchen")
    session.choose_dataset("/nas/hall")
    drive["kitchen"].set()
    session.wait(lambda state: False, 0.2)
    assert session.state.dataset == Dataset("/nas/hall")
    session.dispatch(FileOpened())  # of another data set, or none
    drive["hall"].set()
    assert session.wait(lambda state: not session.busy, 60.0)
    assert session.state.dataset == Dataset()


def test_a_fault_of_ours_is_no_endless_look(session, monkeypatch):
    monkeypatch.setattr(dataset_look, "summarise", lambda folder: 1 / 0)
    told = []
    monkeypatch.setattr(threading, "excepthook", told.append)
    session.choose_dataset("/nas/kitchen")
    assert session.wait(lambda state: state.dataset.problem is not None, 60.0)
    assert told[0].exc_type is ZeroDivisionError and not session.busy


def test_on_a_local_disk_it_is_known_at_once(session, tmp_path, monkeypatch):
    monkeypatch.setattr("physhdr.addon.session.session.DATASET_SECONDS", 60.0)
    session.choose_dataset(str(tmp_path / "none"))
    assert "does not exist" in session.state.dataset.problem.message
