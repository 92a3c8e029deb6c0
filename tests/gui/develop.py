# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Render* while renders are developed: what it warns of before, shows then, and after removal."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive


def test(window: Window) -> Iterator[float]:
    yield from window.open()
    scene = bpy.context.scene
    bpy.ops.physhdr.model_import(filepath=str(window.options.model))
    bpy.ops.physhdr.cameras_import()
    bpy.ops.physhdr.render_setup()
    nodes, develop = window.module("addon.model.nodes"), window.module("addon.rendering.develop")
    nodes.set_input(nodes.find_modifier(bpy.context.object), nodes.TONE_MAPPER, True)
    yield from window.show_panels("render")
    yield from window.redrawn()
    window.screenshot("1_learned_tones")
    bpy.ops.physhdr.develop_render()
    yield from window.redrawn()
    window.screenshot("2_developed")
    scene.view_settings.view_transform = "AgX"
    nodes.set_input(nodes.find_modifier(bpy.context.object), nodes.TONE_MAPPER, True)
    yield from window.redrawn()
    window.screenshot("3_spoilt")
    bpy.ops.physhdr.render_setup()
    assert not develop.faults_of_view(scene)
    bpy.ops.physhdr.develop_render(remove=True)
    yield from window.redrawn()
    window.screenshot("4_removed")
    assert develop.node_of(scene) is None


drive(test)
