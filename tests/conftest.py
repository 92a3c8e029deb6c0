# SPDX-License-Identifier: GPL-3.0-or-later
import importlib.util
import signal
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

_spec = importlib.util.spec_from_file_location("fuzzing", Path(__file__).parent / "fuzzing.py")
_fuzzing = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_fuzzing)

#: Seconds that a read may take where a reader that opens a FIFO would wait for ever.
PATIENCE = 20


@pytest.fixture(scope="session")
def fuzzing() -> ModuleType:
    """``tests/fuzzing.py``: ``mutations``, ``json_mutations`` and the values that they put in."""
    return _fuzzing


@pytest.fixture
def never_waits() -> Iterator[None]:
    """Fails a test that waits for ever, as a read of a FIFO does, instead of hanging the suite."""

    def too_long(*_: object) -> None:
        # No OSError, which the readers turn into their own errors.
        pytest.fail(f"it has waited for {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)
