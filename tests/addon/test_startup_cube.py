# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own cube makes room for a capture; anything that somebody made stays."""

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.capture import originals, startup_cube  # noqa: E402


@pytest.fixture
def cube(extension):
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield bpy.data.objects["Cube"]
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def hidden(item):
    return item.hide_render and not item.visible_get()


def test_the_cube_that_blender_starts_with_is_hidden_once(cube):
    bpy.context.view_layer.update()
    assert startup_cube.hide(bpy.context.scene) == "Cube" and hidden(cube)
    assert startup_cube.hide(bpy.context.scene) == ""


@pytest.mark.parametrize(
    "touch",
    [
        lambda cube: setattr(cube, "location", (1.0, 0.0, 0.0)),
        lambda cube: setattr(cube, "scale", (2.0, 2.0, 2.0)),
        lambda cube: setattr(cube, "name", "House"),
        lambda cube: setattr(cube.data.vertices[0], "co", (-3.0, -1.0, -1.0)),
        lambda cube: cube.modifiers.new("bevel", "BEVEL"),
        lambda cube: cube.keyframe_insert("location"),
        lambda cube: setattr(bpy.data.objects["Light"], "parent", cube),
    ],
    ids=["moved", "scaled", "named", "edited", "modified", "keyframed", "parent"],
)
def test_a_cube_that_was_touched_stays(cube, touch):
    touch(cube)
    bpy.context.view_layer.update()
    assert startup_cube.hide(bpy.context.scene) == "" and not hidden(cube)


def test_a_cube_that_was_photographed_stays(cube, tmp_path):
    scene = bpy.context.scene
    originals.remember(scene, [cube], tmp_path / "data")
    scene.physhdr.data = str(tmp_path / "data")
    scene.physhdr.preview = True
    assert startup_cube.hide(scene) == "" and not hidden(cube)
