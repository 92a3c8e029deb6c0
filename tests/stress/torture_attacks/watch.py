# SPDX-License-Identifier: GPL-3.0-or-later
"""What a program does with files that a stranger names: watched from within, by Python's audit hook and by
calls that it does not report. The standard library alone: it is used inside Blender, too.
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: A computer that nobody has, as Windows names it.
COMPUTER = "nobodys-computer"
NETWORK = f"\\\\{COMPUTER}\\share"
#: Asked for as the file is about to be opened: who follows the system's calls begins here.
BEGIN = "/physhdr-begins"
LIVED = "LIVED"
#: What Python's audit hooks report, and what they do not.
OPENED = ("open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename", "shutil.copyfile")
STARTED = (
    "subprocess.Popen",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.system",
    "os.startfile",
    "os.fork",
)
ASKED = ("stat", "lstat", "access", "readlink")

_listeners: list[Callable[[str, object], None]] = []


def _audited(event: str, arguments: tuple[Any, ...]) -> None:
    if _listeners and event in OPENED + STARTED:
        _listeners[-1](event, arguments[0] if arguments else "")


@contextmanager
def watched(*places: str) -> Iterator[list[str]]:
    """Within it, each look at a path with one of ``places`` in it is listed, and each start of a process."""
    found: list[str] = []

    def report(what: str, path: object) -> None:
        named = os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else str(path)
        if what in STARTED or any(place in named for place in places):
            found.append(f"{what} {named}")

    def reporting(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def reported(path: Any, *arguments: Any, **more: Any) -> Any:
            report(f"os.{name}", path)
            return call(path, *arguments, **more)

        return reported

    if not hasattr(sys, "physhdr_audited"):  # a hook stays for good
        sys.addaudithook(_audited)
        setattr(sys, "physhdr_audited", True)  # noqa: B010
    before = {name: getattr(os, name) for name in ASKED}
    _listeners.append(report)
    try:
        for name, call in before.items():
            setattr(os, name, reporting(name, call))
        yield found
    finally:
        for name, call in before.items():
            setattr(os, name, call)
        _listeners.remove(report)


def places(elsewhere: Path) -> tuple[str, ...]:
    """What is in each path that the file leads to, those included that are proposed for its data sets."""
    return str(elsewhere), COMPUTER, "data_run"
