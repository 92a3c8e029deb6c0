# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry nodes' radiance, read back from Blender's evaluation, against the model file's formula."""

import dataclasses
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.blender import to_matrix  # noqa: E402
from physhdr.addon.model import attributes, look, model_import, nodes, point_cloud  # noqa: E402
from physhdr.addon.model.node_builder import GeometryBuilder  # noqa: E402
from physhdr.addon.model.radiance_tree import radiance_tree  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.bridge.lights import Levels  # noqa: E402
from physhdr.bridge.splatting import NEAR_PLANE  # noqa: E402

LIGHTS = ("ambient", "pendant", "desk lamp, Küche")


def evaluated(target, name: str = "physhdr:radiance") -> np.ndarray:
    """``[N, 4]`` values that the instances carry after evaluation."""
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    return point_cloud.read_attribute(geometry.instances_pointcloud(), name)


def expected_radiance(model, target, camera, level: Levels = 1.0, exposure: float = 0.0) -> np.ndarray:
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
        evaluated(target, name)[:, :3] for name in (attributes.FIXED_PART.name, attributes.FIRST_PART.name)
    )
    np.testing.assert_allclose(ambient / (fixed + ambient), model.light_share[:, 0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(evaluated(target)[:, :3], fixed + 3.0 * ambient, rtol=1e-5)


def set_levels(modifier, levels) -> None:
    for index, level in enumerate(levels):
        nodes.set_input(modifier, nodes.level_input(LIGHTS, index), level)


@pytest.mark.parametrize("degree", [0, 3])
def test_several_lights_have_a_level_each(add, degree: int):
    """fixed + Σ level · share · radiance is the model file's formula, all off and all different."""
    model, target, modifier, camera = add(degree=degree, lights=LIGHTS)
    assert [name for name in nodes.identifiers(modifier) if "evel" in name] == [
        "Lighting level",
        "Level of pendant",
        "Level of desk lamp, Küche",
    ]
    for levels in [(1, 1, 1), (0.25, 1, 1), (1, 3, 0), (0.5, 0.125, 7.5), (0, 0, 0), (0, 0, 1e-3)]:
        set_levels(modifier, levels)
        nodes.set_input(modifier, nodes.EXPOSURE, -1.5)
        expected = expected_radiance(model, target, camera, levels, -1.5)
        np.testing.assert_allclose(evaluated(target)[:, :3], expected, rtol=1e-5, atol=1e-7)
    parts = [evaluated(target, attributes.light_part(index).name)[:, :3] for index in range(3)]
    at_1 = evaluated(target, attributes.FIXED_PART.name)[:, :3] + sum(parts)
    np.testing.assert_allclose(at_1, expected_radiance(model, target, camera), rtol=1e-5)
    np.testing.assert_allclose(np.stack(parts, 1) / at_1[:, None], model.light_share, rtol=1e-4, atol=1e-6)


def test_models_with_other_lights_keep_their_own_trees(scene, make_model, write, look_at):
    camera = render.add_camera(scene, look_at(2.0, -3.0, 1.5), 0.8)
    some = [("ambient",), LIGHTS, ("ambient", "screen"), LIGHTS, ("sun", "screen")]
    models = [make_model(seed=seed, lights=lights) for seed, lights in enumerate(some)]
    targets = [model_import.import_model(write(model)) for model in models]
    trees = [target.modifiers[0].node_group for target in targets]
    assert trees[1] == trees[3] and len(set(trees)) == 4
    for target, model in zip(targets, models, strict=True):
        last = nodes.level_input(model.lights, len(model.lights) - 1)
        nodes.set_input(target.modifiers[0], last, 3.0)
        levels = [1.0] * (len(model.lights) - 1) + [3.0]
        expected = expected_radiance(model, target, camera, levels)
        np.testing.assert_allclose(evaluated(target)[:, :3], expected, rtol=1e-5, atol=1e-7)


def test_a_second_light_is_keyframed_and_a_third_driven(add, scene):
    model, target, modifier, camera = add(lights=LIGHTS)
    path = nodes.input_data_path(modifier, "Level of pendant")
    for frame, level in [(1, 1.0), (11, 3.0)]:
        nodes.set_input(modifier, "Level of pendant", level)
        target.keyframe_insert(path, frame=frame)
    target["strength"] = 0.5
    driver = target.driver_add(nodes.input_data_path(modifier, nodes.level_input(LIGHTS, 2))).driver
    driver.type, variable = "SUM", driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = target, '["strength"]'
    for frame, level in [(1, 1.0), (11, 3.0)]:
        scene.frame_set(frame)
        expected = expected_radiance(model, target, camera, (1.0, level, 0.5))
        np.testing.assert_allclose(evaluated(target)[:, :3], expected, rtol=1e-5, atol=1e-7)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        assert look.look_of(target, depsgraph).lighting_levels == pytest.approx((1.0, level, 0.5))


def test_the_direction_follows_camera_and_object(add, look_at):
    """ω is in the object's space: moving, turning and scaling either must agree with the formula."""
    model, target, _, camera = add(degree=3)
    camera.matrix_world = to_matrix(look_at(-1.0, 2.0, 0.4))
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
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    target = bpy.data.objects[name]
    np.testing.assert_array_equal(evaluated(target), before)
    assert look.look_of(target).lighting_levels == (2.5,)
    assert all(material.users for material in bpy.data.materials)


@pytest.mark.parametrize("link", [False, True])
@pytest.mark.parametrize("lights", [("ambient",), LIGHTS])
def test_appended_or_linked_into_another_file_it_still_works(add, tmp_path, link: bool, lights):
    model, target, modifier, _ = add(lights=lights)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    nodes.set_input(modifier, nodes.level_input(lights, len(lights) - 1), 2.5)
    before, name = evaluated(target), target.name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bring = bpy.ops.wm.link if link else bpy.ops.wm.append
    bring(directory=str(tmp_path / "library.blend" / "Object"), filename=name)
    target = bpy.data.objects[name]
    np.testing.assert_array_equal(evaluated(target), before)
    levels = (*(1.0 for _ in lights[1:]), 2.5)
    assert look.look_of(target).lighting_levels == levels
    # The attributes alone say the same as the modifier.
    constant = dataclasses.replace(
        point_cloud.model_of(target.data), log_radiance_sh=model.log_radiance_sh[:, :1]
    )
    along_z = np.tile([0.0, 0.0, 1.0], (model.count, 1))
    np.testing.assert_allclose(constant.radiance(along_z, levels), before[:, :3], rtol=1e-5, atol=1e-7)


def proxies(target) -> list[np.ndarray]:
    """``[4, 4]``: the instances that are drawn."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return [
        np.array(each.matrix_world)
        for each in depsgraph.object_instances
        if each.is_instance and each.parent.original == target
    ]


def test_a_stretched_model_is_drawn_as_ellipsoids(add):
    """A card would be sheared with the object, and lie in no camera's plane."""
    _, target, modifier, _ = add()
    drawn = {}
    for scale in ((1.0, 1.0, 1.0), (2.0, 0.5, 1.0)):
        target.scale = scale
        for cards in (False, True):
            nodes.set_input(modifier, nodes.CAMERA_SPLATS, cards)
            bpy.context.view_layer.update()
            drawn[scale[0], cards] = np.array(proxies(target))
    assert not np.allclose(drawn[1.0, True], drawn[1.0, False])
    np.testing.assert_array_equal(drawn[2.0, True], drawn[2.0, False])


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_the_nearest_that_is_drawn_is_in_the_scenes_metres(add, scene, scale):
    """As in the 3D view and in the trainer: whatever the object's scale is."""
    _, target, modifier, camera = add(count=2)
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, True)
    forward = -np.array(camera.matrix_world.col[2])[:3]
    eye = np.array(camera.matrix_world.translation)
    places = eye + forward * np.array([[0.9], [1.1]]) * NEAR_PLANE
    point_cloud.write_attribute(target.data, attributes.POSITION, places / scale)
    target.data.update_tag()
    target.scale = (scale,) * 3
    bpy.context.view_layer.update()
    (drawn,) = proxies(target)
    np.testing.assert_allclose(drawn[:3, 3], places[1], atol=1e-5)


def test_every_node_has_a_frame_or_a_place_of_its_own(scene):
    """The tree can be read in the editor: no two nodes lie upon each other."""
    radiance_tree(3, (0.5, 1.0, 2.0))
    radiance_tree(1, lights=LIGHTS)
    assert len(bpy.data.node_groups) > 2
    for tree in bpy.data.node_groups:
        places = [tuple(node.location) for node in tree.nodes if node.type != "FRAME"]
        assert len(places) == len(set(places))
        assert all(node.label for node in tree.nodes if node.type == "FRAME")


def test_groups_are_wired_by_name(scene):
    """What goes into a group is what it is called, and nothing of it is left to a default."""
    radiance_tree(2)
    wired = [node for tree in bpy.data.node_groups for node in tree.nodes if node.type == "GROUP"]
    assert len(wired) == len(bpy.data.node_groups) - 1
    for node in wired:
        assert all(socket.is_linked for socket in [*node.inputs, *node.outputs]), node.node_tree.name
        names = [socket.name for socket in node.inputs], [socket.name for socket in node.outputs]
        assert all(len(set(each)) == len(each) for each in names)
        assert not {"Value", "Vector", "Output"} & {name for each in names for name in each}
        assert all(tree.users == 1 for tree in bpy.data.node_groups if not tree.is_modifier)


def test_a_group_inside_of_a_group_is_reached_by_the_fields_of_another(scene):
    """Nodes of any tree may be joined: the number that comes out went in and out of three groups."""
    tree = bpy.data.node_groups.new("whole", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    make = GeometryBuilder(tree)
    five = make.field("ShaderNodeValue")
    five.socket.default_value = 5.0
    with make.group("outer"):
        doubled = five * 2.0
        with make.group("inner"):
            deep = doubled + five
    with make.group("other"), make.group("another"):
        last = deep * doubled - five
    geometry = make.field("GeometryNodePoints", 1)
    stored = make.store(geometry, attributes.CONFIDENCE, last)
    make.node("NodeGroupOutput", stored)
    target = bpy.data.objects.new("target", bpy.data.meshes.new("target"))
    scene.collection.objects.link(target)
    target.modifiers.new("nodes", "NODES").node_group = tree
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    assert (
        geometry.pointcloud.attributes[attributes.CONFIDENCE.name].data[0].value == (5 * 2 + 5) * (5 * 2) - 5
    )
