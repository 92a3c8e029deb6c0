# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry nodes' radiance, read back from Blender's evaluation, against the model file's formula."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import model_import, nodes, point_cloud, render  # noqa: E402


def evaluated(target, name: str = "physhdr:radiance") -> np.ndarray:
    """``[N, 4]`` values that the instances carry after evaluation."""
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    return point_cloud.read_attribute(geometry.instances_pointcloud(), name)


def expected_radiance(model, target, camera, level: float = 1.0, exposure: float = 0.0) -> np.ndarray:
    bpy.context.view_layer.update()
    eye = np.array(target.matrix_world.inverted() @ camera.matrix_world.translation)
    directions = model.position.astype(np.float64) - eye
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return 2.0**exposure * model.radiance(directions, level)


@pytest.fixture
def add(scene, make_model, write, look_at):
    """Makes model, object, its modifier and a camera."""

    def add(**options):
        model = make_model(**options)
        target = model_import.import_model(write(model))
        camera = render.add_camera(scene, look_at(2.0, -3.0, 1.5), 0.8)
        return model, target, target.modifiers[0], camera

    return add


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("modulator", ["additive", "baked-levels"])
def test_radiance_is_the_models_at_every_level_and_exposure(add, degree: int, modulator: str):
    model, target, modifier, camera = add(degree=degree, modulator=modulator)
    for level, exposure in [(1.0, 0.0), (0.25, 2.0), (0.7, -3.5), (4.0, 0.0), (9.0, 1.0), (0.0, 0.0)]:
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        nodes.set_input(modifier, nodes.EXPOSURE, exposure)
        expected = expected_radiance(model, target, camera, level, exposure)
        got = evaluated(target)
        np.testing.assert_allclose(got[:, :3], expected, rtol=1e-5, atol=1e-7)
        np.testing.assert_array_equal(got[:, 3], model.opacity)


def test_fixed_and_ambient_parts_add_up(add):
    model, target, modifier, _ = add()
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 3.0)
    fixed, ambient = (
        evaluated(target, name)[:, :3] for name in (nodes.FIXED_ATTRIBUTE, nodes.AMBIENT_ATTRIBUTE)
    )
    np.testing.assert_allclose(ambient / (fixed + ambient), model.ambient_share, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(evaluated(target)[:, :3], fixed + 3.0 * ambient, rtol=1e-5)


def test_the_direction_follows_camera_and_object(add, look_at):
    """ω is in the object's space: moving, turning and scaling either must agree with the formula."""
    model, target, _, camera = add(degree=3)
    camera.matrix_world = render.to_matrix(look_at(-1.0, 2.0, 0.4))
    np.testing.assert_allclose(evaluated(target)[:, :3], expected_radiance(model, target, camera), rtol=1e-5)
    target.location = (0.5, -1.0, 2.0)
    target.rotation_euler = (0.4, -1.1, 2.5)
    target.scale = (2.0, 2.0, 2.0)
    np.testing.assert_allclose(evaluated(target)[:, :3], expected_radiance(model, target, camera), rtol=1e-5)
    parent = bpy.data.objects.new("parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.rotation_euler = (1.0, 0.2, -0.3)
    target.parent = parent
    np.testing.assert_allclose(evaluated(target)[:, :3], expected_radiance(model, target, camera), rtol=1e-5)


def test_another_active_camera_is_noticed(add, scene, look_at):
    model, target, _, _ = add()
    evaluated(target)
    other = render.add_camera(scene, look_at(-3.0, 0.5, -1.0), 0.5)
    np.testing.assert_allclose(evaluated(target)[:, :3], expected_radiance(model, target, other), rtol=1e-5)


def test_orthographic_camera_sees_along_one_direction(add):
    model, target, _, camera = add()
    camera.data.type = "ORTHO"
    forward = -np.array(camera.matrix_world.col[2])[:3]
    expected = model.radiance(np.broadcast_to(forward, (model.count, 3)))
    np.testing.assert_allclose(evaluated(target)[:, :3], expected, rtol=1e-5)


@pytest.mark.parametrize("splats", [False, True])
def test_without_view_or_camera_only_the_constant_term_counts(add, scene, splats: bool):
    model, target, modifier, _ = add()
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, splats)
    constant = np.exp(0.5 / math.sqrt(math.pi) * model.log_radiance_sh[:, 0])
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    np.testing.assert_allclose(evaluated(target)[:, :3], constant, rtol=1e-5)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, True)
    scene.camera = None
    np.testing.assert_allclose(evaluated(target)[:, :3], constant, rtol=1e-5)


def test_keyframes_on_the_sliders_play(add, scene):
    model, target, modifier, camera = add()
    path = nodes.input_data_path(modifier, nodes.LIGHTING_LEVEL)
    for frame, level in [(1, 1.0), (11, 3.0)]:
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        target.keyframe_insert(path, frame=frame)
    scene.frame_set(11)
    np.testing.assert_allclose(
        evaluated(target)[:, :3], expected_radiance(model, target, camera, 3.0), rtol=1e-5
    )


def test_saved_and_reopened_it_gives_the_same(add, tmp_path):
    _, target, modifier, _ = add(degree=2)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 2.5)
    nodes.set_input(modifier, nodes.EXPOSURE, 1.0)
    before, name = evaluated(target), target.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    target = bpy.data.objects[name]
    np.testing.assert_array_equal(evaluated(target), before)
    assert nodes.get_input(target.modifiers[0], nodes.LIGHTING_LEVEL) == 2.5
    assert all(material.users for material in bpy.data.materials)


def test_appended_into_another_file_it_still_works(add, tmp_path):
    _, target, modifier, _ = add()
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    before, name = evaluated(target), target.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.append(directory=str(tmp_path / "library.blend" / "Object"), filename=name)
    np.testing.assert_array_equal(evaluated(bpy.data.objects[name]), before)


def test_every_node_has_a_frame_or_a_place_of_its_own(scene):
    """The tree can be read in the editor: no two nodes lie upon each other."""
    tree = nodes.radiance_tree(3, (0.5, 1.0, 2.0))
    places = [tuple(node.location) for node in tree.nodes if node.type != "FRAME"]
    assert len(places) == len(set(places))
    assert all(node.label for node in tree.nodes if node.type == "FRAME")
