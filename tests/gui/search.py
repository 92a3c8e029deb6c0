# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in the menus is found by the search (F3), typed by hand, and done at Return."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive

#: Until Blender has read what was typed.
TYPED_SECONDS = 2.0


def test(window: Window) -> Iterator[float]:
    yield from window.open()
    bpy.ops.physhdr.model_import(filepath=str(window.options.model))
    yield from window.drawn()
    view = window.area.spaces.active.region_3d
    assert view.view_perspective != "CAMERA"
    yield from searched(window, "look through")
    window.screenshot("1_found")
    window.key("Return")
    yield from window.until(lambda: view.view_perspective == "CAMERA", 30, "looked through")
    assert bpy.context.scene.camera is not None
    yield from window.drawn()

    problems = window.module("addon.rendering.render_setup").render_problems
    assert problems(bpy.context.scene)
    yield from searched(window, "set up render")
    window.key("Return")
    yield from window.still()
    window.screenshot("2_set_up")
    window.key("Return")  # its dialog, where it has one
    yield from window.until(lambda: not problems(bpy.context.scene), 30, "set up")
    yield from window.drawn()
    window.screenshot("3_done")


def searched(window: Window, words: str) -> Iterator[float]:
    """``yield from``: the search is open with what is typed."""
    yield from window.point(0.4, 0.5)
    yield from window.pops_up(lambda: bpy.ops.wm.search_menu("INVOKE_DEFAULT"))
    subprocess.run(["xdotool", "type", "--delay", "80", words], check=True)
    yield TYPED_SECONDS
    yield from window.still()


drive(test)
