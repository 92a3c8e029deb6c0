# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``make fuzz`` has found stays mended: every case in ``tests/fixtures/fuzz`` is tried again."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FINDINGS = sorted((ROOT / "tests" / "fixtures" / "fuzz").glob("*.json"))
#: Large ones are made small before they are kept.
LARGEST = 50_000


@pytest.fixture(scope="module")
def told() -> dict[str, str]:
    """What the tool says of each case: one process tries them all, for any of them may kill it."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "fuzz.py"), "--replay", *map(str, FINDINGS)],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    lines = [line.partition(".json: ") for line in done.stdout.splitlines() if ".json: " in line]
    return {f"{name}.json": outcome for name, separator, outcome in lines if separator}


@pytest.mark.parametrize("path", FINDINGS, ids=[path.stem for path in FINDINGS])
def test_a_case_that_was_found_is_answered(path: Path, told: dict[str, str]) -> None:
    """In one clear error, or it is understood: no crash, no hang, nothing that is none of ours."""
    assert path.stat().st_size < LARGEST
    assert told[path.name].startswith("right"), told[path.name]
