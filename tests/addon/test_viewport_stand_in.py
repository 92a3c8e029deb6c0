# SPDX-License-Identifier: GPL-3.0-or-later
"""A file that was saved here shows the model's points to who opens it without the extension."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import viewport  # noqa: E402
from physhdr.addon.model import model_import, nodes  # noqa: E402
from physhdr.addon.model.attributes import RADIUS  # noqa: E402
from physhdr.addon.model.point_cloud import read_attribute, write_attribute  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.addon.viewport import stand_in  # noqa: E402

#: What a Blender that knows nothing of us finds in a file, and draws of it, as JSON.
LOOK = """
import json, sys
import bpy, gpu, mathutils, numpy as np
bpy.ops.wm.open_mainfile(filepath=sys.argv[-1])
(target,) = (each for each in bpy.data.objects if each.type == "POINTCLOUD")
radius = np.empty(len(target.data.points), np.float32)
target.data.attributes["radius"].data.foreach_get("value", radius)
gpu.init()
screen = bpy.data.screens[0]
areas = [area for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
space, region = areas[0].spaces.active, areas[0].regions[-1]
space.overlay.show_overlays = False
size = 100
offscreen = gpu.types.GPUOffScreen(size, size, format="RGBA16F")
window = mathutils.Matrix(((2, 0, 0, 0), (0, 2, 0, 0), (0, 0, -1.002, -0.2), (0, 0, -1, 0)))
view = mathutils.Matrix.Translation((0, 0, -3))
pictures = {}
for is_hidden in (True, False):
    target.hide_set(is_hidden)
    bpy.context.view_layer.update()
    offscreen.draw_view3d(bpy.context.scene, bpy.context.view_layer, space, region, view, window)
    with offscreen.bind():
        data = gpu.state.active_framebuffer_get().read_color(0, 0, size, size, 4, 0, "FLOAT")
    data.dimensions = size * size * 4
    pictures[is_hidden] = np.array(data)
print("FOUND", json.dumps({
    "registered": hasattr(bpy.types.Object, "physhdr_viewport"),
    "display": target.display_type,
    "modifier": [target.modifiers[0].show_viewport, target.modifiers[0].show_render],
    "radius": [float(radius.min()), float(radius.max())],
    "material": target.data.materials[0].name,
    "covered": float((np.abs(pictures[True] - pictures[False]).reshape(-1, 4).max(axis=1) > 0.02).mean()),
}))
"""


@pytest.fixture
def target(scene, make_model, write):
    viewport.register()
    target = model_import.import_model(write(make_model(count=60)))
    target.physhdr_viewport = "SPLATS"
    yield target
    viewport.unregister()


def state(target) -> tuple:
    modifier = nodes.find_modifier(target)
    return target.display_type, modifier.show_viewport, stand_in.is_shown(target.data)


HERE, ELSEWHERE = ("BOUNDS", False, False), ("TEXTURED", False, True)


def found_elsewhere(path: Path, tmp_path: Path) -> dict:
    """What a process without the extension finds."""
    (tmp_path / "look.py").write_text(LOOK)
    command = [sys.executable, str(tmp_path / "look.py"), "--", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    told = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
    assert told, done.stdout + done.stderr
    return json.loads(told[0].removeprefix("FOUND "))


def test_elsewhere_the_points_are_drawn(target, tmp_path):
    """By a process of its own without the extension, into a picture; here they are not, before or after."""
    assert state(target) == HERE
    path = tmp_path / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert state(target) == HERE
    there = found_elsewhere(path, tmp_path)
    assert not there["registered"] and there["display"] == "TEXTURED"
    assert there["modifier"] == [False, True] and 0.0 < there["radius"][0] < there["radius"][1] < 1.0
    assert there["material"] == "PhysHDR Points"
    assert there["covered"] > 0.03
    bpy.ops.wm.open_mainfile(filepath=str(path))
    (again,) = (each for each in bpy.data.objects if each.type == "POINTCLOUD")
    assert state(again) == HERE


@pytest.mark.long
def test_what_was_saved_before_is_repaired_by_saving_it(target, tmp_path):
    """An older file has no radius, no material and only bounds."""
    target.data.materials.clear()
    write_attribute(target.data, RADIUS, np.zeros(60))
    viewport.unregister()  # as if an older version saved: no handlers
    try:
        target.display_type = "BOUNDS"
        write_attribute(target.data, RADIUS, np.zeros(60))
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    finally:
        viewport.register()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    (old,) = (each for each in bpy.data.objects if each.type == "POINTCLOUD")
    assert state(old) == HERE
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "new.blend"))
    assert found_elsewhere(tmp_path / "new.blend", tmp_path)["covered"] > 0.03


def test_a_file_that_cannot_be_saved_leaves_all_as_it_is(target, tmp_path):
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "no such folder" / "saved.blend"))
    assert state(target) == HERE


def test_renders_are_the_same(target, tmp_path, scene, look_at):
    """With the points hidden and shown: the modifier puts out instances of its own."""
    render.add_camera(scene, look_at(0.0, -3.0, 1.0), 0.8)
    render.set_resolution(scene, 24, 24)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 2
    pictures = []
    for arrange in (stand_in.hide, stand_in.show):
        arrange(target)
        render.render_exr(scene, tmp_path / "render.exr")
        pictures.append(render.read_exr(tmp_path / "render.exr"))
    assert pictures[0].max() > 0.1
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_without_the_extension_from_now_on(target):
    """Whoever disables it sees the points; enabled again it draws them itself."""
    viewport.unregister()
    try:
        assert state(target) == ELSEWHERE
    finally:
        viewport.register()
    assert state(target) == HERE


def test_what_the_artist_chose_stays(target, tmp_path):
    """A material of the cloud's own, wires instead of bounds, and a model that is drawn by its nodes."""
    own = bpy.data.materials.new("own")
    target.data.materials.append(own)
    target.display_type = "WIRE"
    other = target.copy()
    other.data = target.data.copy()
    bpy.context.scene.collection.objects.link(other)
    other.physhdr_viewport = "NODES"
    kept = state(other), read_attribute(other.data, RADIUS.name).tolist()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert target.display_type == "WIRE" and list(target.data.materials) == [own]
    assert (state(other), read_attribute(other.data, RADIUS.name).tolist()) == kept


def test_radii_of_the_artists_own_come_back(target, tmp_path):
    """In what is saved, when it is opened again, when the nodes draw, and without the extension."""
    own = np.linspace(0.5, 1.0, 60, dtype=np.float32)
    target.physhdr_viewport = "NODES"
    write_attribute(target.data, RADIUS, own)

    def radius() -> np.ndarray:
        (model,) = (each for each in bpy.data.objects if each.type == "POINTCLOUD")
        return read_attribute(model.data, RADIUS.name)

    target.physhdr_viewport = "SPLATS"
    assert state(target) == HERE and not radius().any()
    target.physhdr_viewport = "NODES"
    np.testing.assert_array_equal(radius(), own)
    target.physhdr_viewport = "SPLATS"
    for _ in range(2):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
        assert not radius().any()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert not radius().any()
    viewport.unregister()
    try:
        np.testing.assert_array_equal(radius(), own)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
        np.testing.assert_array_equal(radius(), own)
    finally:
        viewport.register()


def test_a_linked_models_file_is_not_touched(target, tmp_path):
    """An object of this file on another file's points: no material is put on them, and saving works."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (there, here):
        here.pointclouds = there.pointclouds[:1]
    (cloud,) = bpy.data.pointclouds
    local = bpy.data.objects.new("local", cloud)
    bpy.context.scene.collection.objects.link(local)
    local.physhdr_viewport = "SPLATS"
    materials = list(cloud.materials)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert list(cloud.materials) == materials and not any(each.library is None for each in bpy.data.materials)


def test_the_radius():
    """2 √(σ₂ σ₃ o) of the larger two, at most four times the median, never 0."""
    scale = np.array([(0.01, 0.04, 0.09), (0.04, 0.09, 0.01), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0)], np.float32)
    radius = stand_in.shown_radius(scale, np.array([1.0, 0.25, 1.0, 1.0], np.float32))
    np.testing.assert_allclose(radius, [0.12, 0.06, stand_in.SMALLEST, 4.0 * 0.09], rtol=1e-6)
    assert len(stand_in.shown_radius(scale[:0], scale[:0, 0])) == 0
