# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialog of *Render from This Scene* in a real window: what it shows, and that it comes and goes well."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive
from mathutils import Euler


def room() -> None:
    """A floor, a cube, a sun, two lamps in a collection, a glowing ball in a light group, a camera."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=8.0)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0, 0, 0.5))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.2, location=(-1, -0.5, 0.2))
    ball = bpy.context.object
    glow = bpy.data.materials.new("glow")
    glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 5.0
    ball.data.materials.append(glow)
    bpy.context.view_layer.lightgroups.add(name="Neon")
    ball.lightgroup = "Neon"
    lamps = bpy.data.collections.new("Ceiling Lamps")
    scene.collection.children.link(lamps)
    for x in (-1.5, 1.5):
        lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
        lamp.location, lamp.data.energy = (x, 0, 2.5), 50.0
        lamps.objects.link(lamp)
    bpy.ops.object.light_add(type="SUN", rotation=(0.9, 0.2, 0.3))
    bpy.ops.object.camera_add(location=(0, -6, 2.2), rotation=(1.25, 0, 0))
    scene.camera = bpy.context.object
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.update()


def again(window: Window) -> Iterator[float]:
    """*Render* is pressed, and the dialog opens anew."""
    preview, opened = window.module("addon.dataset.rig_preview"), []
    real = preview.dialog_opened

    def told(context: bpy.types.Context) -> None:
        opened.append(True)
        real(context)

    preview.dialog_opened = told
    window.key("Return")
    yield from window.until(lambda: opened, 20, "open again")
    preview.dialog_opened = real
    yield from window.still()


def opens(window: Window) -> Iterator[float]:
    """The dialog is open, with the mouse in it."""
    yield from window.point(0.35, 0.45)
    yield from window.pops_up(lambda: bpy.ops.physhdr.dataset_render("INVOKE_DEFAULT"))


def test(window: Window) -> Iterator[float]:
    yield from window.open()
    room()
    space = window.area.spaces.active
    view = space.region_3d
    view.view_distance, view.view_location = 13.0, (-3.0, -5.0, 0.5)  # the cameras right of the dialog
    view.view_rotation = Euler((1.15, 0.0, 0.5)).to_quaternion()
    scene = bpy.context.scene
    shown = window.module("addon.dataset.rig_preview")._shown
    settings = window.module("addon.dataset.dataset_settings").settings_of(scene)
    yield from opens(window)
    window.screenshot("1_dialog")
    assert [each.light for each in settings.lights] == ["neon", "collection", "ceiling_lamps"]
    assert len(shown.lines["train"]) == 18 and len(shown.lines["lit"]) == 12
    assert Path(settings.out).name == "untitled_dataset"
    denoiser = window.module("addon.dataset.denoiser").can_denoise()
    assert settings.denoise == denoiser

    settings.rig, settings.views = "HEMISPHERE", 60
    settings.lights[2].vary = True
    settings.ambient_levels = "1 2"  # cannot be
    yield from window.point(0.35, 0.46)
    yield from window.still()
    window.screenshot("2_mistake")
    assert len(shown.lines["train"]) == 30
    window.key("Escape")
    yield from window.until(lambda: not shown.lines and not shown.in_dialog, 20, "closed")
    assert settings.views == 60 and settings.ambient_levels == "1 2"
    yield from window.redrawn()
    window.screenshot("3_closed")

    yield from opens(window)
    yield from again(window)  # its mistake is told, and it opens again
    window.screenshot("4_open_again")
    assert shown.in_dialog and settings.views == 60
    assert not window.module("addon.runtime").session().state.tasks
    window.key("Escape")
    yield from window.until(lambda: not shown.in_dialog, 20, "closed")

    bpy.ops.physhdr.rig_show()
    yield from window.redrawn()
    window.screenshot("5_pinned")
    bpy.ops.physhdr.rig_show()

    settings.ambient_levels, settings.views, settings.lit_views, settings.relit_views = "2", 2, 1, 1
    settings.resolution_x, settings.samples, settings.rig = 64, 4, "GRID"
    settings.out = str(window.options.out / "data")
    yield from opens(window)
    window.key("Return")
    session = window.module("addon.runtime").session()
    yield from window.until(lambda: len(session.state.tasks) > 0, 20, "begun")
    assert not shown.in_dialog
    yield from window.until(lambda: not session.state.tasks, 120, "rendered")
    yield from window.until(lambda: scene.physhdr.data != "", 10, "chosen")
    assert session.state.problem is None and settings.rate > 0.0
    # Undoing what came next does not take away what was remembered.
    bpy.ops.object.empty_add()
    with window.override():
        bpy.ops.ed.undo_push(message="empty")
        bpy.ops.ed.undo()
    assert "Empty" not in bpy.data.objects
    scene = bpy.context.scene
    originals = window.module("addon.capture.originals")
    assert len(originals.originals_of(scene).datasets) == 1
    scene.physhdr.preview = True
    yield from window.redrawn()
    window.screenshot("6_rendered")
    with window.override():
        bpy.ops.physhdr.originals_hide()
    yield from window.redrawn()
    window.screenshot("7_hidden")
    assert all(item.hide_render for item in scene.objects if item.type in ("MESH", "LIGHT"))


drive(test)
