# SPDX-License-Identifier: GPL-3.0-or-later
"""A stranger's .blend, which names everything that can be named, is opened: nothing may happen by itself.

Python's audit hook watches from within Blender, strace, where there is one, from without.
"""

import re
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from .bench import PATIENCE, Bench, Result
from .oracle import SkipError
from .processes import BLENDER, ROOT, Program
from .watch import ASKED, BEGIN, LIVED, OPENED, STARTED, places

SCRIPT = Path(__file__).with_name("stranger_inside.py")
#: A Blender with a window (tools/gui_test.py), and the test that is run in it.
WINDOW, WINDOW_TEST = ROOT / "tools" / "gui_test.py", "stranger"
#: Of strace: looks at files, and programs that are started.
STRACE = ("strace", "-f", "--seccomp-bpf", "-qq", "-s", "4096", "-e", "trace=%file,execve,execveat")
CALL = re.compile(r"^\d+ +(\w+)\(")


def open_stranger(bench: Bench) -> Result:
    if not BLENDER.exists():
        raise SkipError("there is no Blender here: make setup")
    result = Result("files")
    work, trace = bench.empty("files"), bench.folder / "trace.txt"
    elsewhere, file = work / "elsewhere", work / "file" / "stranger.blend"
    for folder in (elsewhere / "data", elsewhere / "photos", elsewhere / "out", file.parent):
        folder.mkdir(parents=True)
    bench.must(_blender(bench, "make", file, elsewhere))
    strace = [*STRACE, "-o", trace] if shutil.which("strace") else []
    living = _blender(bench, "open", file, elsewhere, before=strace)
    living.wait(PATIENCE)
    result.complain(reported_events(living.output()), "audit hook")
    if strace:
        lines = trace.read_text(encoding="utf-8", errors="replace").splitlines()
        result.complain(traced(lines, places(elsewhere)), "strace")
    result.facts.append("watched by the audit hook" + (" and strace" if strace else ""))
    result.tries += 1
    if not bench.short:
        _open_in_window(bench, result)
    return result


def _open_in_window(bench: Bench, result: Result) -> None:
    """The same in a real window, where there is a Blender that opens one."""
    program = Program([sys.executable, WINDOW, WINDOW_TEST], bench.folder / "window.log")
    status, output = program.wait(PATIENCE), program.output()
    skipped = re.search(r"^gui-test (skipped: .*)$", output, re.MULTILINE)
    if skipped:
        result.facts.append(f"in a window {skipped[1]}")
        return
    result.tries += 1
    result.complain([] if status == 0 else [" ".join(output.split()[-40:])], "window")


def _blender(bench: Bench, what: str, file: Path, elsewhere: Path, before: Sequence[object] = ()) -> Program:
    """Blender with a home of its own: no settings, and no trainer, of the user's."""
    home = f"BLENDER_USER_RESOURCES={bench.folder / 'home'}"
    words = [*before, "env", home, BLENDER, SCRIPT, what, file, elsewhere]
    return Program(words, bench.folder / "blender.log")


def reported_events(output: str) -> list[str]:
    """The lines in which the script reports a look or a process; or that it died before it could."""
    reported = (*OPENED, *STARTED, *(f"os.{name}" for name in ASKED))
    lines = [line for line in output.splitlines() if line.partition(" ")[0] in reported]
    if LIVED not in output.splitlines():
        lines.append(f"Blender did not come to its end: {' '.join(output.splitlines()[-1:])}")
    return lines


def traced(lines: Sequence[str], places: Sequence[str]) -> list[str]:
    """What strace saw, after the file was about to be opened, of the places and of programs."""
    begins = next((number for number, line in enumerate(lines) if BEGIN in line), None)
    if begins is None:
        return ["strace did not see the beginning"]
    calls = [line for line in lines[begins + 1 :] if CALL.match(line)]
    return [
        line
        for line in calls
        if CALL.match(line)[1].startswith("execve") or any(place in line for place in places)  # type: ignore[index]
    ]
