# SPDX-License-Identifier: GPL-3.0-or-later
"""What is selected in Edit Mode, and what is cleaned away, in the 3D view's own drawing."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
import gpu  # noqa: E402
from mathutils import Matrix  # noqa: E402

from physhdr.addon import viewport  # noqa: E402
from physhdr.addon.model import look, model_import, nodes  # noqa: E402
from physhdr.addon.model.point_removal import selection_of  # noqa: E402
from physhdr.addon.viewport import gpu_arrays, splats  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.addon.viewport.edit_points import EditPoints, checksum  # noqa: E402
from physhdr.addon.viewport.splat_renderer import SplatRenderer  # noqa: E402

SIZE, COUNT = 80, 60


@pytest.fixture
def target(scene, make_model, write):
    gpu.init()
    viewport.register()
    target = model_import.import_model(write(make_model(count=COUNT)))
    target.physhdr_viewport = "SPLATS"
    bpy.context.view_layer.objects.active = target
    yield target
    if target.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")
    viewport.unregister()


def item():
    depsgraph = bpy.context.evaluated_depsgraph_get()
    groups = splats.items_by_tone(splats.shown_objects(bpy.context.view_layer, depsgraph))
    ((_, (item,)),) = groups.values()
    return item


def picture(each) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = 3.0
    camera = ViewCamera(pose, SIZE, SIZE, 100.0, 100.0, SIZE / 2, SIZE / 2)
    return SplatRenderer().render([each], camera).read()[0]


def orange(colour: np.ndarray) -> float:
    """How much of what is drawn has the tint's colour (1, 0.2, 0)."""
    drawn = colour[colour[..., 3] > 0.5]
    return float(np.mean(np.abs(drawn[:, 1] / drawn[:, 0] - 0.2) + np.abs(drawn[:, 2] / drawn[:, 0]) < 0.02))


def test_the_selection_is_tinted_and_followed(target):
    plain = picture(item())
    assert item().selected is None and orange(plain) < 0.01
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.pointcloud.select_all(action="SELECT")
    everything = item()
    assert everything.selected.values.all() and orange(picture(everything)) > 0.99
    bpy.ops.pointcloud.select_all(action="DESELECT")
    nothing = item()
    assert not nothing.selected.values.any() and nothing.key != everything.key
    np.testing.assert_array_equal(picture(nothing), plain)
    assert item().key == nothing.key, "no new picture while nothing changes"
    bpy.ops.pointcloud.select_random(seed=3)
    some = item()
    chosen = selection_of(target.data)
    np.testing.assert_array_equal(some.selected.values, chosen[some.splats.source])
    assert 0 < chosen.sum() < COUNT and some.key != nothing.key
    assert orange(plain) < orange(picture(some)) < 0.95
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_array_equal(picture(item()), plain)


def test_deleted_in_edit_mode(target):
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.pointcloud.select_random(seed=3)
    left = COUNT - selection_of(target.data).sum()
    assert item().splats.count == COUNT
    bpy.ops.pointcloud.delete()
    bpy.context.view_layer.update()
    assert item().splats.count == left == len(target.data.points)


def test_the_points_are_drawn_where_they_are(target):
    """Selected ones in the theme's colour on top, the others faint; a pixel at least each."""
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.pointcloud.select_all(action="DESELECT")
    target.data.attributes[".selection"].data[0].value = True
    theme = bpy.context.preferences.themes[0].view_3d
    position = np.array(target.data.points[0].co)
    matrix = np.eye(4)
    matrix[:3, 3] = -position  # the selected one is in the middle
    offscreen = gpu.types.GPUOffScreen(SIZE, SIZE, format="RGBA16F")
    with offscreen.bind():
        framebuffer = gpu.state.active_framebuffer_get()
        framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
        gpu.matrix.load_matrix(Matrix.Identity(4))
        gpu.matrix.load_projection_matrix(Matrix.Identity(4))
        EditPoints(target.data, selection_of(target.data)).draw(matrix, theme)
        drawn = gpu_arrays.read_colour(framebuffer, (SIZE, SIZE))
    middle = drawn[SIZE // 2 - 1 : SIZE // 2 + 1, SIZE // 2 - 1 : SIZE // 2 + 1]
    assert (middle[..., 3] > 0.9).all() and middle[..., 0].min() > 0.9
    others = drawn[..., 3] > 0.0
    assert 100 < others.sum() < 400


def test_without_a_selection_everything_is(target):
    """Where nothing was ever unselected Blender keeps no attribute."""
    assert ".selection" not in target.data.attributes and selection_of(target.data).all()
    values = np.zeros(9, bool)
    values[8] = True
    assert checksum(values) != checksum(np.zeros(9, bool))


def test_what_is_cleaned_away_is_not_drawn_and_nothing_is_uploaded(target):
    modifier = nodes.find_modifier(target)
    whole = item()
    assert whole.kept is None
    opacity = np.array([each.vector[3] for each in target.data.attributes["radiance:base"].data])
    limit = float(np.median(opacity))
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, limit)
    cleaned = item()
    np.testing.assert_array_equal(cleaned.kept.values, (opacity >= np.float32(limit))[cleaned.splats.source])
    assert cleaned.splats is whole.splats and cleaned.key != whole.key
    assert 0.2 < picture(cleaned)[..., 3].sum() / picture(whole)[..., 3].sum() < 0.95
    np.testing.assert_array_equal(
        cleaned.kept.values[np.argsort(cleaned.splats.source)],
        look.kept_of(target.data, look.look_of(target).cleaning),
    )
    nodes.set_input(modifier, nodes.EXPOSURE, 1.0)
    assert item().kept is cleaned.kept, "reckoned once"
    nodes.set_input(modifier, nodes.FARTHEST, 0.001)
    assert item().kept is cleaned.kept, "what only the camera that renders would hide is shown"
    nodes.set_input(modifier, nodes.SMALLEST_OPACITY, 0.0)
    assert item().kept is None


def test_the_limit_of_the_spherical_harmonics(target):
    assert item().degree == 1
    nodes.set_input(nodes.find_modifier(target), nodes.SH_DEGREE, 0)
    assert item().degree == 0
