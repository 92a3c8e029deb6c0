# SPDX-License-Identifier: GPL-3.0-or-later
"""What is common to all child processes: each can be cancelled, and its log shown."""

import ast
import os
import sys
from importlib import import_module
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import physhdr  # noqa: E402
from physhdr.addon import runtime  # noqa: E402
from physhdr.addon.session.state import Backend, PythonChosen  # noqa: E402
from physhdr.addon.session.tasks import TASKS  # noqa: E402

ADDON = Path(physhdr.__file__).parent / "addon"


def started_or_drawn() -> set[str]:
    """The names of all tasks that the code starts or draws, as it is written."""
    found = set()
    for path in ADDON.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Call):
                called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
                called = called or (node.func.id if isinstance(node.func, ast.Name) else "")
                place = {"start_task": 0, "draw_task": 2}.get(called)
                named = node.args[place] if place is not None else None
                if isinstance(named, ast.Name) and named.id.isupper():
                    found.add((path, named.id))
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "task":
                found |= {(path, name.id) for name in [node.value] if isinstance(name, ast.Name)}
    names = set()
    for path, name in found:
        module = ".".join(path.relative_to(ADDON.parent).with_suffix("").parts)
        names |= {value for value in [getattr(import_module(f"physhdr.{module}"), name, None)] if value}
    return names


def test_whatever_is_started_can_be_cancelled(registered):
    """The panel's button takes the task's name: one that it does not know breaks every redraw."""
    names = started_or_drawn()
    assert {"install", "dataset", "evaluate", "video", "light", "bake"} <= names
    for name in names:
        assert bpy.ops.physhdr.task_cancel(name=name) == {"FINISHED"}
    assert names <= {name for name, _, _ in TASKS}


@pytest.mark.skipif(os.name == "nt", reason="a program of one line that runs is POSIX's")
def test_a_program_that_is_no_python_does_not_take_the_place_of_a_backend_that_works(registered, tmp_path):
    works = Backend(sys.executable, {"versions": {"torch": "2.13.0"}, "missing": []})
    runtime.session().dispatch(PythonChosen(works.python, works.report))
    wrong = tmp_path / "gimp"
    wrong.write_text('#!/bin/sh\necho "unknown option $1"\nexit 2\n')
    wrong.chmod(0o755)
    with pytest.raises(RuntimeError, match=r"ended with status 2: unknown option .*launch\.py"):
        bpy.ops.physhdr.backend_use(filepath=str(wrong), wait=True)
    assert runtime.session().state.backend == works


def test_a_log_takes_no_text_of_the_users(registered, tmp_path):
    """It is named as the user's own text is, which stays; the same log comes into the same text again."""
    mine = bpy.data.texts.new("install.log")
    mine.from_string("what I wrote")
    log = tmp_path / "install.log"
    log.write_text("one line\n")
    bpy.ops.physhdr.log_open(filepath=str(log))
    assert mine.as_string() == "what I wrote"
    shown = [text for text in bpy.data.texts if text != mine]
    assert [text.as_string() for text in shown] == ["one line\n"]
    log.write_text("one line\ntwo lines\n")
    bpy.ops.physhdr.log_open(filepath=str(log))
    assert [text for text in bpy.data.texts if text != mine] == shown
    assert shown[0].as_string() == "one line\ntwo lines\n"
    # A copy that the user made of it, or what they wrote into it, is theirs.
    shown[0].from_string("notes of mine")
    bpy.ops.physhdr.log_open(filepath=str(log))
    assert shown[0].as_string() == "notes of mine" and len(bpy.data.texts) == 3
