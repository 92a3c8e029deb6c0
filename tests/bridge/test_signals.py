# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever asks a program to end is heard once, by one table, and where no time is left some is made."""

import os
import signal
import sys

import pytest

from physhdr.bridge.signals import TIME_TO_SAVE, catch, caught, interrupt

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has none of these")


def test_the_end_of_the_terminal_and_of_cpu_time_are_heard_once_and_a_key_again():
    heard = []
    former = signal.getsignal(signal.SIGXCPU)
    with caught(heard.append):
        for number in (signal.SIGXCPU, signal.SIGXCPU, signal.SIGHUP, signal.SIGTERM, signal.SIGINT):
            os.kill(os.getpid(), number)
    assert [each.name for each in heard] == ["SIGXCPU", "SIGTERM", "SIGINT"]
    assert signal.getsignal(signal.SIGXCPU) == former
    with pytest.raises(KeyboardInterrupt), caught(interrupt):
        os.kill(os.getpid(), signal.SIGHUP)


def test_what_nohup_made_deaf_stays_deaf():
    former = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with caught(interrupt):
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, former)


@pytest.mark.parametrize(
    ("limits", "wanted"), [((100, 100), (100 - TIME_TO_SAVE, 100)), ((50, 100), None), ((3, 3), (1, 3))]
)
def test_a_limit_that_kills_at_once_leaves_time_to_save(monkeypatch, limits, wanted):
    import resource

    set_to = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, given: set_to.append(given))
    for number, handler in catch(interrupt).items():
        signal.signal(number, handler)
    assert set_to == ([wanted] if wanted else [])
