# SPDX-License-Identifier: GPL-3.0-or-later
"""What is timed inside Blender, in a process of its own."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

from measure import Row

ROOT = Path(__file__).resolve().parent.parent
BLENDER = ROOT / ".venvs" / "run-blender"
#: Seconds that a million Gaussians may take on two cores.
AT_MOST = 5.0


def import_rows(quick: bool) -> Iterator[Row]:
    """Import of a million Gaussians as a model file and as a PLY; nothing where there is no Blender side."""
    del quick
    if not BLENDER.exists():
        return
    command = [str(BLENDER), str(ROOT / "benchmarks" / "blender_import.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    for kind, seconds in result["seconds"].items():
        work = f"{result['count'] / 1e6:g} M Gaussians of degree 3 from a {kind}"
        yield Row(work=work, value=seconds, unit="s", at_most=AT_MOST)


def view_rows(quick: bool) -> Iterator[Row]:
    """The 3D view's own drawing of a million Gaussians from the middle of a room, culled or not."""
    if not BLENDER.exists():
        return
    command = [str(BLENDER), str(ROOT / "benchmarks" / "blender_view.py"), "--"]
    command += ["--count", "100000"] if quick else []
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    count = result.pop("count")
    for name, value in result.items():
        work, _, unit = name.rpartition(", ")
        yield Row(work=f"{work}, {count / 1e6:g} M", value=value, unit=unit)
