# SPDX-License-Identifier: GPL-3.0-or-later
"""What works on Linux alone, and nobody would notice there. Read from the sources."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("addon", "backend", "bridge", "lab", "synth")
PROCESSES = {"run", "Popen", "check_output"}


def faults_in(source: str) -> Iterator[tuple[int, str]]:
    """Lines of a module, and what is amiss there."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        named = {word.arg: word.value for word in node.keywords}
        if None in named:  # **options, which are looked at where they are made
            continue
        mode = named.get("mode", node.args[1] if name == "open" and len(node.args) > 1 else None)
        if (
            name in PROCESSES
            and ("text" in named or "universal_newlines" in named)
            and "encoding" not in named
        ):
            yield node.lineno, "a child's words are read in Windows' code page: name the encoding"
        elif name == "read_text" and not node.args and "encoding" not in named:
            yield node.lineno, "a text is read in Windows' code page: name the encoding"
        elif name == "write_text" and len(node.args) == 1 and "encoding" not in named:
            yield node.lineno, "a text is written in Windows' code page: name the encoding"
        elif name == "open" and isinstance(node.func, ast.Name) and "encoding" not in named:
            if not (isinstance(mode, ast.Constant) and "b" in str(mode.value)):
                yield node.lineno, "a text is opened in Windows' code page: name the encoding"
        elif name == "TemporaryDirectory" and "ignore_cleanup_errors" not in named:
            yield (
                node.lineno,
                "it fails where an antivirus program holds a file: ignore_cleanup_errors",
            )


@pytest.mark.parametrize("room", ROOMS)
def test_nothing_is_left_to_the_code_page_or_to_who_holds_a_temporary_file(room):
    found = [
        f"{path.relative_to(ROOT).as_posix()}:{line}: {fault}"
        for path in sorted((ROOT / room).rglob("*.py"))
        for line, fault in faults_in(path.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "source",
    [
        "subprocess.run(['a'], text=True)",
        "path.read_text()",
        "path.write_text('a')",
        "open(path)",
        "open(path, 'w')",
        "tempfile.TemporaryDirectory()",
    ],
)
def test_each_fault_is_found(source):
    assert len(list(faults_in(source))) == 1


def test_a_process_is_asked_by_signal_on_other_systems_alone():
    """``os.kill(pid, 0)`` ends the process on Windows: both places stand where that is not."""
    places = {
        path.relative_to(ROOT).as_posix()
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if "os.kill(" in path.read_text(encoding="utf-8")
    }
    assert places == {"addon/scripts/run_task.py", "addon/session/process.py"}
