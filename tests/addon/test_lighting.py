# SPDX-License-Identifier: GPL-3.0-or-later
"""The world that a capture lights: what Cycles makes of it, against numbers known beforehand."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import mathutils
import numpy as np
import pytest

from physhdr.addon.light import lighting, probe_checks, probes
from physhdr.addon.model import nodes
from physhdr.addon.model.attributes import BASE, LIGHT_SHARE, LOG_SH, POSITION, ROTATION, SCALE
from physhdr.addon.model.drawn import drawn_of
from physhdr.addon.model.model_import import import_model
from physhdr.addon.model.point_cloud import read_attribute, write_attribute
from physhdr.addon.operators import lighting as operators
from physhdr.addon.rendering.render import add_camera, prepare_cycles, read_exr, render_exr, set_resolution
from physhdr.addon.runtime import session
from physhdr.addon.session.state import CHECK, INSTALL, Backend, Link, Running, State
from physhdr.addon.session.task import TaskEnded
from physhdr.bridge.messages import JobStatus
from physhdr.bridge.panorama import PANORAMIC_CAMERA_TURN, directions
from physhdr.bridge.probe import Probe, begin, finish
from physhdr.synth import exr

WIDTH = 64
LIGHTS = ("ambient", "lamp")


@pytest.fixture(scope="module", autouse=True)
def registered(factory_settings):
    import physhdr

    physhdr.register()
    yield
    physhdr.unregister()


@pytest.fixture
def model(scene, make_model, write):
    """A model that no ray meets, so that only its light counts: two lights, SH of degree 1."""
    target = import_model(write(make_model(lights=LIGHTS)))
    target.location = (0.0, 0.0, -500.0)
    bpy.context.view_layer.objects.active = target
    bpy.context.view_layer.update()
    return target


def write_probe(folder: Path, *pictures, at=(0.0, 0.0, 500.0), lights=LIGHTS) -> Path:
    """A probe of given panoramas: a colour for all directions, or ``[H, W, 3]``."""
    begin(folder)
    found = Probe(at, WIDTH, lights, 0.25, 0.01, 0, 40, "test")
    for name, picture in zip(found.files, pictures, strict=True):
        pixels = np.broadcast_to(np.asarray(picture, np.float32), (WIDTH // 2, WIDTH, 3))
        (folder / name).write_bytes(exr.encode_rgb(pixels))
    finish(folder, found)
    return folder


def light(folder: Path, **options) -> bpy.types.World:
    assert bpy.ops.physhdr.light_from_here(folder=str(folder), **options) == {"FINISHED"}
    return bpy.context.scene.world


def mirror_ball(scene) -> None:
    """Nothing but what a mirror sees: the camera stands before a large chrome ball."""
    bpy.ops.mesh.primitive_plane_add(size=20.0, location=(0.0, 5.0, 0.0), rotation=(np.pi / 2, 0.0, 0.0))
    material = bpy.data.materials.new("mirror")
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeBsdfAnisotropic")
    shader.inputs["Roughness"].default_value = 0.0
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)


def reflected(scene, tmp_path: Path) -> np.ndarray:
    """What a mirror that faces −Y reflects to a camera that looks along +Y, in the middle: ``[3]``."""
    if scene.camera is None:
        pose = np.eye(4)
        pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
        add_camera(scene, pose, 0.02)
        mirror_ball(scene)
    return rendered(scene, tmp_path)[2, 2, :3]


def rendered(scene, tmp_path: Path, width: int = 4, height: int = 4) -> np.ndarray:
    prepare_cycles(scene, 4)
    scene.cycles.max_bounces = 4
    set_resolution(scene, width, height)
    render_exr(scene, tmp_path / "render.exr")
    return read_exr(tmp_path / "render.exr")


def test_directions_are_cycles_own(scene, tmp_path):
    """An environment texture and the panoramic camera, which know nothing of our formulas."""
    width = 64
    pixels = (directions(width) + 2.0).astype(np.float32)
    (tmp_path / "directions.exr").write_bytes(exr.encode_rgb(pixels))
    image = bpy.data.images.load(str(tmp_path / "directions.exr"))
    image.colorspace_settings.name = "Non-Color"
    scene.world = bpy.data.worlds.new("test")
    scene.world.cycles.sampling_method = "NONE"
    tree = scene.world.node_tree
    tree.nodes.clear()
    texture, shader, output = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "OutputWorld")
    )
    texture.image = image
    tree.links.new(texture.outputs["Color"], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    lens = bpy.data.cameras.new("all round")
    lens.type, lens.panorama_type = "PANO", "EQUIRECTANGULAR"
    camera = bpy.data.objects.new("all round", lens)
    camera.rotation_euler = PANORAMIC_CAMERA_TURN
    scene.collection.objects.link(camera)
    scene.camera = camera
    prepare_cycles(scene, 1)
    scene.render.film_transparent = False
    set_resolution(scene, width, width // 2)
    render_exr(scene, tmp_path / "out.exr")
    # Half a pixel's turn is 0.05: a shift or a flip would be seen, an interpolation not.
    assert np.abs(read_exr(tmp_path / "out.exr")[..., :3] - pixels).max() < 5e-3
    # And without a panoramic camera: the middle of an ordinary picture, whatever it looks along.
    lens.type, lens.angle = "PERSP", 0.01
    for axis in ((0, 1, 0), (0, -1, 0), (1, 0, 0), (0.3, -0.4, 0.86)):
        vector = mathutils.Vector(axis).normalized()
        camera.rotation_euler = vector.to_track_quat("-Z", "Y").to_euler()
        set_resolution(scene, 2, 2)
        render_exr(scene, tmp_path / "out.exr")
        assert read_exr(tmp_path / "out.exr")[..., :3].mean((0, 1)) - 2.0 == pytest.approx(vector, abs=5e-3)


def test_cg_is_lit_by_the_fixed_part_and_each_light_at_its_level(scene, model, tmp_path):
    light(write_probe(tmp_path / "probe", (1.0, 2.0, 3.0), (0.5, 0.25, 0.125), (10.0, 0.0, 7e4)))
    modifier = nodes.find_modifier(model)
    assert reflected(scene, tmp_path) == pytest.approx([11.5, 2.25, 70003.125], rel=1e-4)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 4.0)
    nodes.set_input(modifier, nodes.level_input(LIGHTS, 1), 0.25)
    nodes.set_input(modifier, nodes.EXPOSURE, -1.0)
    expected = 0.5 * np.array([1.0 + 2.0 + 2.5, 2.0 + 1.0, 3.0 + 0.5 + 17500.0])
    assert reflected(scene, tmp_path) == pytest.approx(expected, rel=1e-4)


def test_keyframes_of_the_model_relight_also_after_saving(scene, model, tmp_path):
    blend = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    light(write_probe(tmp_path / "probe", (1.0,) * 3, (2.0,) * 3, (4.0,) * 3))
    path = nodes.input_data_path(nodes.find_modifier(model), nodes.LIGHTING_LEVEL)
    for frame, level in ((1, 0.0), (21, 10.0)):
        nodes.set_input(nodes.find_modifier(model), nodes.LIGHTING_LEVEL, level)
        model.keyframe_insert(path, frame=frame)
    reflected(scene, tmp_path)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    for frame, expected in ((1, 5.0), (21, 25.0)):
        scene.frame_set(frame)
        assert reflected(scene, tmp_path) == pytest.approx([expected] * 3, rel=1e-4)


def test_the_light_turns_with_the_model(scene, model, tmp_path):
    """The mirror shows −Y. A model that is turned by 90° has its own −X there."""
    towards = directions(WIDTH)
    light(write_probe(tmp_path / "probe", 2.0 + towards, (0,) * 3, (0,) * 3))
    assert reflected(scene, tmp_path) - 2.0 == pytest.approx([0.0, -1.0, 0.0], abs=0.01)
    turn = mathutils.Euler((0.3, -0.5, 1.1))
    model.rotation_euler = turn
    model.scale = (2.5,) * 3
    expected = turn.to_matrix().inverted() @ mathutils.Vector((0.0, -1.0, 0.0))
    assert reflected(scene, tmp_path) - 2.0 == pytest.approx(expected, abs=0.01)


def test_the_camera_sees_what_the_former_world_showed(scene, model, tmp_path):
    former = bpy.data.worlds.new("mine")
    former.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.3, 0.4, 1.0)
    scene.world = former
    world = light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    assert world != former and reflected(scene, tmp_path) == pytest.approx([5.0] * 3, rel=1e-4)
    scene.camera.rotation_euler.z += np.pi  # past the mirror
    prepare_cycles(scene, 1)
    scene.render.film_transparent = False
    render_exr(scene, tmp_path / "render.exr")
    assert read_exr(tmp_path / "render.exr")[1, 1, :3] == pytest.approx([0.2, 0.3, 0.4], rel=1e-4)


def test_light_as_before_leaves_nothing_behind(scene, model, tmp_path):
    former = bpy.data.worlds.new("mine")
    scene.world = former
    model.visible_glossy = False
    before = [getattr(model, name) for name in (*lighting.LIGHTING_RAYS, *lighting.MIRROR_RAYS)]
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3), mirrors="SPLATS")
    rays = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_shadow")
    assert [getattr(model, name) for name in rays] == [False, True, True, False]
    assert model.visible_camera and not model.visible_volume_scatter
    light(tmp_path / "probe")  # again, and otherwise
    assert [getattr(model, name) for name in rays] == [False, False, False, False]
    assert bpy.ops.physhdr.light_reset() == {"FINISHED"}
    assert scene.world == former and list(bpy.data.worlds) == [former]
    assert [getattr(model, name) for name in (*lighting.LIGHTING_RAYS, *lighting.MIRROR_RAYS)] == before
    assert not bpy.ops.physhdr.light_reset.poll()


def test_a_copy_of_the_scene_gives_back_no_light_that_another_has(scene, model, tmp_path):
    """*Linked Copy*: both scenes have the world and the model."""
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    copy = scene.copy()
    assert copy.world == scene.world
    lighting.reset(copy)
    assert copy.world != scene.world and not model.visible_diffuse
    lighting.reset(scene)
    assert model.visible_diffuse


@pytest.mark.parametrize("first", [0, 1])
def test_a_model_that_lights_two_scenes_is_seen_by_rays_again_after_both(scene, model, tmp_path, first):
    """The second scene has a world of its own, which is lit while the model is hidden from rays already."""
    model.visible_glossy = False
    before, folder = visibility(model), write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3)
    light(folder)
    scenes = [scene, bpy.data.scenes.new("second")]
    scenes[1].collection.objects.link(model)
    bpy.context.window.scene = scenes[1]
    bpy.context.view_layer.objects.active = model
    light(folder)
    hidden = visibility(model)
    assert scenes[0].world != scenes[1].world and not any(hidden.values())
    lighting.reset(scenes[first])
    assert visibility(model) == hidden and lighting.is_lit(scenes[1 - first].world)
    lighting.reset(scenes[1 - first])
    assert visibility(model) == before


@pytest.mark.parametrize("kept", [True, False])
def test_copies_of_a_hidden_model_are_seen_again_with_it(scene, model, tmp_path, kept):
    """Shift D gives a copy the visibility that the model has then; the model may be gone by the end."""
    model.visible_glossy = False
    before, folder = visibility(model), write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3)
    light(folder)
    other = bpy.data.scenes.new("other")
    other.collection.objects.link(model)
    for each in scene.objects:
        each.select_set(each == model)
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    assert copy != model and not any(visibility(copy).values())
    # The copy lights the other scene: it is hidden until that is as before.
    other.collection.objects.link(copy)
    lighting.light(other, copy, probes.probes_of(scene, model))
    bpy.ops.object.duplicate()
    second = bpy.context.object
    if not kept:
        bpy.data.objects.remove(model)
    lighting.reset(scene)
    assert visibility(second) == before and not any(visibility(copy).values())
    lighting.reset(other)
    assert visibility(copy) == before
    left = [copy, second, *([model] if kept else [])]
    assert all(visibility(each) == before and lighting.HIDDEN not in each for each in left)


@pytest.mark.parametrize("lit", [True, False])
def test_a_deleted_model_is_saved_for_its_light_alone(scene, model, tmp_path, lit):
    """Its sliders are what the light of a lit world follows; a probe alone keeps no million Gaussians."""
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    if not lit:
        bpy.ops.physhdr.light_reset()
    [probe] = probes.probes_of(scene, model)
    for each in scene.objects:
        each.select_set(each == model)
    bpy.ops.object.delete()
    blend = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    assert probe[probes.MODEL] == model, "an undo brings the model back, and it has its probe"
    bpy.ops.wm.open_mainfile(filepath=blend)
    assert any(each.type == "POINTCLOUD" for each in bpy.data.objects) == lit
    assert [each.users for each in bpy.data.pointclouds] == [int(lit)]
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=blend)
    assert len(bpy.data.pointclouds) == lit
    assert [probes.is_probe(each) for each in bpy.context.scene.objects] == [True]


def hang(item: bpy.types.Object, model: bpy.types.Object, how: str) -> None:
    """Let an object stand by a model."""
    if how == "parent":
        item.parent = model
    elif how == "constraint":
        item.constraints.new("COPY_LOCATION").target = model
    elif how == "driver":
        variable = item.driver_add("location", 2).driver.variables.new()
        variable.name, variable.type = "z", "TRANSFORMS"
        variable.targets[0].id, variable.targets[0].transform_type = model, "LOC_Z"
        item.animation_data.drivers[0].driver.expression = "z"


@pytest.mark.parametrize(
    "how", ["nothing", "parent", "constraint", "driver", "probe's constraint", "keyframes"]
)
def test_nothing_jumps_in_a_file_whose_model_was_deleted(scene, model, tmp_path, how):
    """What stands by the model keeps it; its probes alone do not, and stay where they are."""
    model.location, model.rotation_euler, model.scale = (3.0, 4.0, -500.0), (0.5, 0.0, 1.0), (2.0,) * 3
    bpy.context.view_layer.update()
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3, at=(0.0, 0.5, 1.0)))
    bpy.ops.physhdr.light_reset()
    [probe] = probes.probes_of(scene, model)
    probe.rotation_euler = (0.25, 7.0, 0.5)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location.x = 1.0
    hang(probe if how.startswith("probe") else camera, model, how.removeprefix("probe's "))
    if how == "keyframes":
        model.keyframe_insert("location", frame=1)
    for each in scene.objects:
        each.select_set(each == model)
    bpy.ops.object.delete()
    bpy.context.view_layer.update()

    def stands() -> dict[str, np.ndarray]:
        return {each.name: np.array(each.matrix_world) for each in bpy.context.scene.objects}

    before, own, turn = stands(), probe.matrix_basis.copy(), tuple(probe.rotation_euler)
    blend = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.context.view_layer.update()
    assert (probe.parent, probe.matrix_basis, tuple(probe.rotation_euler)) == (model, own, turn)
    assert probe[probes.MODEL] == model and stands().keys() == before.keys()
    assert all(np.array_equal(there, before[name]) for name, there in stands().items())
    bpy.ops.wm.open_mainfile(filepath=blend)
    bpy.context.view_layer.update()
    assert any(each.type == "POINTCLOUD" for each in bpy.data.objects) == (how != "nothing")
    for name, there in stands().items():
        assert there == pytest.approx(before[name], abs=1e-4)


def test_a_scene_without_a_world_has_none_again(scene, model, tmp_path):
    scene.world = None
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    assert reflected(scene, tmp_path) == pytest.approx([5.0] * 3, rel=1e-4)
    bpy.ops.physhdr.light_reset()
    assert scene.world is None


def test_taking_light_again_replaces_nodes_and_probe(scene, model, tmp_path):
    world = light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    nodes_before, drivers = len(world.node_tree.nodes), len(world.node_tree.animation_data.drivers)
    # By hand: a user's own node stays.
    world.node_tree.nodes.new("ShaderNodeValue").name = "mine"
    write_probe(tmp_path / "probe", (7.0,) * 3, (0,) * 3, (0,) * 3)
    assert light(tmp_path / "probe") == world
    assert len(world.node_tree.nodes) == nodes_before + 1 and "mine" in world.node_tree.nodes
    assert len(world.node_tree.animation_data.drivers) == drivers
    assert len(probes.probes_of(scene, model)) == 1 and len(bpy.data.images) == 3
    assert reflected(scene, tmp_path) == pytest.approx([7.0] * 3, rel=1e-4)


def test_several_probes_blend_by_how_near_they_are(scene, model, tmp_path):
    dark = (0,) * 3
    places = {"a": (0.0, 0.0, 500.0), "b": (4.0, 0.0, 500.0), "c": (0.0, 4.0, 500.0)}
    values = {"a": (1.0, 0.0, 0.0), "b": (0.0, 1.0, 0.0), "c": (0.0, 0.0, 1.0)}
    subject = bpy.data.objects.new("subject", None)
    scene.collection.objects.link(subject)
    for name, at in places.items():
        light(write_probe(tmp_path / name, values[name], dark, dark, at=at), subject="subject")
    # At a probe of its own light alone; elsewhere by the inverse squares of the distances.
    for place, weights in (
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((4.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((2.0, 0.0, 0.0), (1 / 4, 1 / 4, 1 / 20)),
        ((1.0, 2.0, 3.0), (1 / 14, 1 / 22, 1 / 14)),
    ):
        subject.location = place
        got = reflected(scene, tmp_path)
        assert got == pytest.approx(np.array(weights) / sum(weights), abs=1e-4)
        assert got.sum() == pytest.approx(1.0, rel=1e-4)


def test_cycles_looks_for_bright_places_no_finer_than_there_are_pixels(scene, model, tmp_path):
    """By itself it takes a map of 4096, and ten CPU seconds for it. What the user chose stays."""
    scene.world = bpy.data.worlds.new("theirs")
    folder = write_probe(tmp_path / "probe", (1.0,) * 3, (0,) * 3, (0,) * 3)
    world = light(folder)
    assert (world.cycles.sampling_method, world.cycles.sample_map_resolution) == ("MANUAL", WIDTH)
    world[lighting.SAMPLED] = world.cycles.sample_map_resolution = WIDTH // 2  # as of a smaller probe
    assert light(folder).cycles.sample_map_resolution == WIDTH
    world.cycles.sample_map_resolution = 2048
    assert light(folder).cycles.sample_map_resolution == 2048
    world.cycles.sampling_method = "NONE"
    assert light(folder).cycles.sampling_method == "NONE"
    bpy.ops.physhdr.light_reset()
    assert scene.world.name == "theirs" and scene.world.cycles.sampling_method == "AUTOMATIC"


@pytest.mark.parametrize("measured", [True, False])
def test_a_deleted_probe_weighs_nothing(scene, model, tmp_path, measured):
    """Whether there is something to measure distances from, or all count alike."""
    dark = (0,) * 3
    values = {"a": (1.0, 0.0, 0.0), "b": (0.0, 1.0, 0.0), "c": (0.0, 0.0, 1.0)}
    subject = bpy.data.objects.new("subject", None)
    scene.collection.objects.link(subject)
    subject.location = (4.0, 0.0, 0.0)
    for x, (name, value) in enumerate(values.items()):
        folder = write_probe(tmp_path / name, value, dark, dark, at=(2.0 * x, 0.0, 500.0))
        light(folder, subject="subject" if measured else "")
    reflected(scene, tmp_path)
    assert not lighting.lost_probes(scene)
    gone = probes.probes_of(scene, model)[2]
    for each in scene.objects:
        each.select_set(each == gone)
    bpy.ops.object.delete()
    weights = np.array([1 / 16, 1 / 4, 0.0]) if measured else np.array([1.0, 1.0, 0.0])
    assert reflected(scene, tmp_path) == pytest.approx(weights / weights.sum(), abs=1e-4)
    assert lighting.lost_probes(scene)
    bpy.context.view_layer.objects.active = model
    light(tmp_path / "a", subject="subject" if measured else "")
    assert not lighting.lost_probes(scene)
    assert len([each for each in bpy.data.images if probes.KNOWN in each]) == 6


def test_of_a_world_whose_only_probe_was_deleted_the_panel_knows(scene, model, tmp_path):
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    assert not lighting.lost_probes(scene)
    bpy.data.objects.remove(probes.probes_of(scene, model)[0])
    assert lighting.lost_probes(scene)
    bpy.ops.physhdr.light_reset()
    assert not lighting.lost_probes(scene)


def test_a_probe_hangs_on_its_model_and_says_when_it_has_moved(scene, model, tmp_path):
    model.scale = (2.0,) * 3
    model.rotation_euler.z = 1.0
    bpy.context.view_layer.update()
    at = (0.25, -0.5, 1.0)
    light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3, at=at))
    (probe,) = probes.probes_of(scene, model)
    bpy.context.view_layer.update()
    there = tuple(model.matrix_world @ mathutils.Vector(at))
    assert tuple(probe.matrix_world.translation) == pytest.approx(there, abs=1e-4)
    assert not probes.has_moved(probe)
    model.location.x += 3.0
    bpy.context.view_layer.update()
    assert not probes.has_moved(probe)
    probe.location.x += 0.1
    bpy.context.view_layer.update()
    assert probes.has_moved(probe)


def test_pictures_are_packed_until_the_file_is_saved_and_relative_then(scene, model, tmp_path):
    light(write_probe(tmp_path / "elsewhere", (5.0,) * 3, (0,) * 3, (0,) * 3))
    assert all(image.packed_file for image in bpy.data.images)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    beside = f"//{probes.ROOT}/Light_Probe"  # where versions put it that knew no other names
    write_probe(tmp_path / probes.ROOT / "Light_Probe", (6.0,) * 3, (0,) * 3, (0,) * 3)
    light(beside)
    found = [image for image in bpy.data.images if image.users]
    assert [image.packed_file for image in found] == [None] * 3
    assert all(image.filepath.startswith(beside) for image in found)
    assert reflected(scene, tmp_path) == pytest.approx([6.0] * 3, rel=1e-4)


def test_what_cannot_be_is_said(scene, model, tmp_path):
    with pytest.raises(RuntimeError, match="is not a model of ours"):
        bpy.ops.object.empty_add()
        bpy.ops.physhdr.light_from_here(model=bpy.context.object.name)
    bpy.context.view_layer.objects.active = model
    with pytest.raises(RuntimeError, match=r"missing|there is no|is not there"):
        bpy.ops.physhdr.light_from_here(folder=str(tmp_path / "nowhere"))
    write_probe(tmp_path / "other", (5.0,) * 3, (0,) * 3, lights=("sun",))
    with pytest.raises(RuntimeError, match="has the lights sun"):
        bpy.ops.physhdr.light_from_here(folder=str(tmp_path / "other"))
    model.scale = (1.0, 2.0, 1.0)
    write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3)
    with pytest.raises(RuntimeError, match="scaled differently"):
        bpy.ops.physhdr.light_from_here(at=(0.0, 0.0, 0.0), by="BLENDER", width=16)
    assert not lighting.is_lit(scene.world)


def test_no_taking_writes_over_another(scene, model, tmp_path):
    """Neither of a renamed probe, nor of its own before, nor of another .blend in the same folder."""
    take = {"by": "BLENDER", "width": 16}

    def pictures() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in (tmp_path / probes.ROOT).rglob("*.exr")}

    def of(probe) -> set[Path]:
        folder = Path(bpy.path.abspath(probe[probes.FOLDER]))
        return {folder / name for name in probes.known(probe).files}

    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert bpy.ops.physhdr.light_from_here(at=(0.0, 0.0, -498.0), **take) == {"FINISHED"}
    (kitchen,) = probes.probes_of(scene, model)
    kitchen.name = "Kitchen"
    before = pictures()
    assert of(kitchen) == set(before)
    bpy.ops.physhdr.light_from_here(at=(0.0, 3.0, -499.5), **take)
    (other,) = set(probes.probes_of(scene, model)) - {kitchen}
    assert not of(kitchen) & of(other)
    shown = [node for node in scene.world.node_tree.nodes if node.type == "TEX_ENVIRONMENT"]
    seen = {Path(bpy.path.abspath(node.image.filepath)) for node in shown}
    assert seen == of(kitchen) | of(other)
    # Taken again at the same place: what an undo brings back is still there.
    with_other, old = pictures(), of(other)
    bpy.ops.physhdr.light_from_here(at=(0.0, 3.0, -499.5), **take)
    assert len(probes.probes_of(scene, model)) == 2 and not of(other) & old
    # A copy of the file, in the same folder, and the same names.
    again = pictures()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"))
    bpy.ops.physhdr.light_from_here(at=(0.0, 0.0, -498.0), **take)
    for kept in (before, with_other, again):
        assert kept.items() <= pictures().items()
    ours = [image.name for image in bpy.data.images if probes.KNOWN in image]
    assert len(ours) == 2 * len(of(kitchen)), "what nobody shows is not kept in the file"


def linked_from(folder: Path, model) -> bpy.types.Object:
    """The model in a new scene, linked from another file."""
    name = model.name
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "theirs.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(folder / "theirs.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    (found,) = wanted.objects
    bpy.context.scene.collection.objects.link(found)
    bpy.context.view_layer.objects.active = found
    return found


def visibility(model) -> dict[str, bool]:
    return {name: getattr(model, name) for name in lighting.LIGHTING_RAYS + lighting.MIRROR_RAYS}


def test_a_linked_model_lights_nothing_until_it_is_overridden(scene, model, make_model, write, tmp_path):
    """What its light needs of it would be gone when the file is opened again."""
    before = visibility(model)
    found = linked_from(tmp_path, model)
    folder = write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3)
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.physhdr.light_from_here(folder=str(folder))
    bpy.context.view_layer.objects.active = own = import_model(write(make_model(lights=LIGHTS)), "own")
    with pytest.raises(RuntimeError, match="linked from another file"):
        bpy.ops.physhdr.light_from_here(folder=str(folder), model=found.name)
    assert visibility(found) == before and not lighting.is_lit(bpy.context.scene.world)
    bpy.data.objects.remove(own)
    found = found.override_create(remap_local_usages=True)
    bpy.context.view_layer.objects.active = found
    light(folder)
    path = str(tmp_path / "mine.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    (found,) = [each for each in bpy.context.scene.objects if each.type == "POINTCLOUD"]
    assert lighting.is_lit(bpy.context.scene.world)
    assert not any(getattr(found, name) for name in lighting.LIGHTING_RAYS)
    bpy.ops.physhdr.light_reset()
    assert visibility(found) == before


def test_a_file_of_before_gives_the_model_its_visibility_back(scene, model, tmp_path):
    """Older versions kept it on the model."""
    before = visibility(model)
    world = light(write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3))
    model[lighting.VISIBILITY] = world.pop(lighting.VISIBILITY)
    light(write_probe(tmp_path / "probe", (6.0,) * 3, (0,) * 3, (0,) * 3))
    assert not model.visible_diffuse
    bpy.ops.physhdr.light_reset()
    assert visibility(model) == before and lighting.VISIBILITY not in model


def test_of_two_models_the_one_that_lights_no_more_is_seen_again(scene, model, make_model, write, tmp_path):
    other = import_model(write(make_model(lights=LIGHTS)), "other")
    folder = write_probe(tmp_path / "probe", (5.0,) * 3, (0,) * 3, (0,) * 3)
    light(folder, model=model.name)
    light(folder, model=other.name)
    assert model.visible_diffuse and not other.visible_diffuse
    bpy.data.objects.remove(other)
    light(folder, model=model.name)
    bpy.ops.physhdr.light_reset()
    assert model.visible_diffuse


@pytest.mark.parametrize(
    ("now", "told"),
    [
        ({}, ""),
        ({"link": Link(status="connected"), "job": JobStatus(state="training", run="run")}, ""),
        ({"tasks": (Running(CHECK, ""),)}, "the backend is being worked on"),
        ({"tasks": (Running(INSTALL, ""),)}, "the backend is being worked on"),
    ],
)
def test_a_training_does_not_keep_the_backend_from_drawing(scene, model, monkeypatch, now, told):
    """Automatic is the backend, in a process of its own, but while it is installed or checked."""
    state = State(backend=Backend(python="python", report={"versions": {}}), **now)
    assert state.backend.ready and state.active == ("job" in now)
    monkeypatch.setattr(session(), "state", state)
    assert operators.why_not_backend(model) == told


@pytest.mark.parametrize("attribute", [POSITION, ROTATION, SCALE, BASE, LOG_SH[3], LIGHT_SHARE[1]])
def test_an_edited_model_is_not_drawn_from_its_file(scene, model, monkeypatch, tmp_path, attribute):
    """One number of one Gaussian is enough; a probe of before tells it, and is right again with an undo."""
    state = State(backend=Backend(python="python", report={"versions": {}}))
    monkeypatch.setattr(session(), "state", state)
    light(write_probe(tmp_path / "probe", 1.0, 1.0, 1.0))
    [probe] = probes.probes_of(scene, model)

    def told() -> tuple[str, list[str]]:
        model.data.update_tag()
        bpy.context.view_layer.update()
        return operators.why_not_backend(model), probe_checks.warnings_of(probe, model)

    assert told() == ("", [])
    before = read_attribute(model.data, attribute.name)
    after = before.copy()
    after[7, -1] *= 0.9
    write_attribute(model.data, attribute, after)
    assert told() == ("the model was edited", ["The model was edited since: take its light again"])
    write_attribute(model.data, attribute, before)
    assert told() == ("", [])


def test_a_step_of_a_slider_sums_up_no_gaussians_for_the_panel(scene, model, monkeypatch, tmp_path):
    """Blender tells of it as of a change of the Gaussians; their checksum takes 0.2 s a million."""
    light(write_probe(tmp_path / "probe", 1.0, 1.0, 1.0))
    [probe] = probes.probes_of(scene, model)
    looked = []

    def look(cloud: bpy.types.PointCloud) -> str:
        looked.append(cloud.name)
        return drawn_of(cloud)

    monkeypatch.setattr(probe_checks, "drawn_of", look)
    assert probe_checks.warnings_of(probe, model) == [] and len(looked) == 1
    uid = model.data.session_uid
    for step in range(3):
        nodes.set_input(nodes.find_modifier(model), nodes.EXPOSURE, 0.1 * step)
        bpy.context.view_layer.update()
        assert uid in probe_checks._suspects  # Blender has told of it
        assert probe_checks.warnings_of(probe, model) == []
    assert len(looked) == 1


def test_a_file_that_was_trained_on_is_not_the_model_here(scene, model, make_model, write, monkeypatch):
    """A training writes its model where the last one was imported from."""
    state = State(backend=Backend(python="python", report={"versions": {}}))
    monkeypatch.setattr(session(), "state", state)
    write(make_model(lights=LIGHTS, seed=1))
    assert operators.why_not_backend(model) == "the model was edited"


def test_taking_light_again_changes_nothing_else(scene, model):
    """Reflections, the subject, and each probe's own width."""
    subject = bpy.data.objects.new("subject", None)
    scene.collection.objects.link(subject)
    for width, z in ((16, -498.0), (32, -502.0)):
        given = {"mirrors": "SPLATS", "subject": "subject", "by": "BLENDER"}
        bpy.ops.physhdr.light_from_here(at=(0.0, 0.0, z), width=width, **given)
    found = probes.probes_of(scene, model)
    folders, rays = [each[probes.FOLDER] for each in found], visibility(model)
    assert bpy.ops.physhdr.light_refresh() == {"FINISHED"}
    assert not {each[probes.FOLDER] for each in found} & set(folders)
    assert [probes.known(each).width for each in found] == [16, 32]
    assert visibility(model) == rays and rays["visible_glossy"]
    assert scene.world[lighting.SUBJECT] == subject


def test_new_names_and_several_widths_while_the_backend_draws(scene, model, monkeypatch, tmp_path):
    """The backend draws one width at a time; all of it lights the scene, whatever is called how by then."""
    subject = bpy.data.objects.new("subject", None)
    scene.collection.objects.link(subject)
    light(write_probe(tmp_path / "first", 1.0, 1.0, 1.0))
    [empty] = probes.probes_of(scene, model)
    started = []

    def draw(source: str, tasks) -> None:
        started.append([task.width for task in tasks])
        for task in tasks:
            write_probe(Path(task.folder), 1.0, 1.0, 1.0, at=task.at)
        scene.name, model.name = f"Scene {len(started)}", f"Model {len(started)}"
        empty.name, subject.name = f"Probe {len(started)}", f"Subject {len(started)}"

    taken = []
    monkeypatch.setattr(operators, "_start", draw)
    monkeypatch.setattr(operators, "take_when_ended", lambda task, take, message: taken.append(take()))
    ids = {"scene": scene, "model": model, "subject": subject}
    after = operators.After(
        **{key: each.session_uid for key, each in ids.items()}, name="", mirrors="SPLATS", drawn=""
    )
    tasks = [
        operators.Task(uid, (x, 0.0, 0.0), (x, 0.0, 500.0), str(tmp_path / f"at {x:g}"), width)
        for x, uid, width in ((0.0, empty.session_uid, 64), (1.0, 0, 32), (2.0, 0, 64))
    ]
    operators._draw_all("model.safetensors", after, tasks, operators.of_one_width(tasks))
    assert started == [[64, 64], [32]] and sorted(taken) == [False, True]
    assert len(probes.probes_of(scene, model)) == 3 and empty[probes.FOLDER] == str(tmp_path / "at 0")
    assert scene.world[lighting.SUBJECT] == subject and model.visible_glossy


@pytest.fixture
def drawn_meanwhile(scene, model, monkeypatch, tmp_path):
    """Light is asked for beside a saved file: two probes, of two widths. Returns what to call for it.

    ``meanwhile`` is called while each of them is drawn, with what was drawn; the session's problem is told.
    """
    monkeypatch.setattr(session(), "state", State())
    monkeypatch.setattr(session(), "ended", lambda name: TaskEnded(name, ok=True))
    monkeypatch.setattr(operators, "take_when_ended", lambda task, take, message: take())
    (tmp_path / "first").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "first/mine.blend"))
    after = operators.After(scene.session_uid, model.session_uid, "", "ENVIRONMENT", 0, "")
    tasks = [
        operators.Task(0, (x, 0.0, 0.0), (x, 0.0, 500.0), f"//PhysHDR_light/at {x:g}", width)
        for x, width in ((0.0, 64), (1.0, 32))
    ]

    def take(meanwhile) -> str:
        def draw(source: str, tasks) -> None:
            meanwhile(
                [write_probe(operators._absolute(task.folder), 1.0, 1.0, 1.0, at=task.at) for task in tasks]
            )

        monkeypatch.setattr(operators, "_start", draw)
        operators._draw_all("model.safetensors", after, tasks, operators.of_one_width(tasks))
        problem = session().state.problem
        return problem.message if problem else ""

    return take


def test_the_file_may_be_saved_elsewhere_while_the_backend_draws(scene, model, drawn_meanwhile, tmp_path):
    """What is drawn stays beside the file as it was, and is found from where that is now."""
    folders = iter([tmp_path / "second", tmp_path / "third/deep"])

    def save_as(drawn) -> None:
        (folder := next(folders)).mkdir(parents=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "mine.blend"))

    assert drawn_meanwhile(save_as) == ""
    found = probes.probes_of(scene, model)
    assert [each[probes.FOLDER] for each in found] == [
        "//../../first/PhysHDR_light/at 0",
        "//../../first/PhysHDR_light/at 1",
    ]
    assert lighting.is_lit(scene.world)
    assert all(Path(bpy.path.abspath(each.filepath)).is_file() for each in bpy.data.images if each.filepath)


def test_light_that_is_drawn_and_then_not_there_is_told(scene, drawn_meanwhile, tmp_path):
    problem = drawn_meanwhile(lambda drawn: [shutil.rmtree(folder) for folder in drawn])
    assert f"not in {tmp_path / 'first/PhysHDR_light'} any more" in problem
    assert not lighting.is_lit(scene.world)


def test_a_model_that_was_edited_while_it_was_drawn(scene, model, tmp_path):
    """The probe's light is of the file, and says so."""
    folder = write_probe(tmp_path / "probe", 1.0, 1.0, 1.0)
    after = operators.After(scene.session_uid, model.session_uid, "", "SPLATS", 0, drawn_of(model.data))
    model.data.points[3].co.x += 0.5
    after.apply([operators.Task(0, (0.0,) * 3, (0.0, 0.0, 500.0), str(folder), WIDTH)])
    [probe] = probes.probes_of(scene, model)
    assert "edited" in probe_checks.warnings_of(probe, model)[0]


def test_whatever_keeps_the_light_out_of_the_scene_leaves_no_empty(scene, model, monkeypatch, tmp_path):
    folder = write_probe(tmp_path / "probe", 1.0, 1.0, 1.0)
    before = set(bpy.data.objects)
    monkeypatch.setattr(lighting, "light", lambda *_: 1 / 0)
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        light(folder)
    assert set(bpy.data.objects) == before


def test_without_cycles_the_remedy_is_told(scene, model):
    import addon_utils  # known once bpy is

    scenes = list(bpy.data.scenes)
    addon_utils.disable("cycles")
    try:
        with pytest.raises(RuntimeError, match=r"Cycles add-on is switched off\s+Enable it in Preferences"):
            bpy.ops.physhdr.light_from_here(width=16, by="BLENDER")
    finally:
        addon_utils.enable("cycles")
    assert list(bpy.data.scenes) == scenes and not probes.probes_of(scene, model)


#: Colours as a film studio has them: no space is named as in Blender's own configuration.
STUDIO = """\
ocio_profile_version: 1
roles:
  {scene_linear: Film, default: Film, data: Raw Numbers, color_picking: Screen, texture_paint: Film,
   matte_paint: Film, default_byte: Screen, default_float: Film, aces_interchange: Interchange}
displays:
  Studio:
    - !<View> {name: Film, colorspace: Screen}
active_displays: [Studio]
active_views: [Film]
colorspaces:
  - !<ColorSpace> {name: Film, isdata: false}
  - !<ColorSpace>
    name: Interchange
    to_reference: !<MatrixTransform> {matrix: [1.45, -0.24, -0.21, 0, -0.08, 1.18, -0.1, 0, 0.01, -0.01, 1, 0,
                                               0, 0, 0, 1]}
  - !<ColorSpace>
    name: Screen
    from_reference: !<ExponentTransform> {value: [2.2, 2.2, 2.2, 1], direction: inverse}
  - !<ColorSpace> {name: Raw Numbers, isdata: true}
"""

IN_A_STUDIO = """
import sys
from pathlib import Path
import bpy
import physhdr
from physhdr.addon.model.model_import import import_model
from physhdr.addon.rendering.render import read_exr
bpy.ops.wm.read_factory_settings(use_empty=True)
physhdr.register()
model, folder = sys.argv[1:]
bpy.context.view_layer.objects.active = import_model(model)
assert bpy.ops.physhdr.light_from_here(folder=folder) == {"FINISHED"}
images = [node.image for node in bpy.context.scene.world.node_tree.nodes if node.type == "TEX_ENVIRONMENT"]
assert {image.colorspace_settings.name for image in images} == {"Raw Numbers"}, images
print("numbers", *read_exr(Path(folder) / "fixed.exr")[0, 0, :3])
"""


@pytest.mark.long
def test_where_colours_have_other_names(make_model, write, tmp_path):
    (tmp_path / "config.ocio").write_text(STUDIO)
    folder = write_probe(tmp_path / "probe", (0.5, 2.0, 30.0), (1.0,) * 3, (1.0,) * 3)
    arguments = [sys.executable, "-c", IN_A_STUDIO, str(write(make_model(lights=LIGHTS))), str(folder)]
    environment = {**os.environ, "OCIO": str(tmp_path / "config.ocio")}
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "numbers 0.5 2.0 30.0" in done.stdout


def test_a_second_probe_after_the_file_was_saved_elsewhere(model, tmp_path):
    """Blender leads an image's path back to the folder of before; the probe's own cannot know that."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here/a.blend"))
    first = probes.new_folder("first")
    write_probe(Path(bpy.path.abspath(first)), 1.0, 1.0, 1.0)
    light(first)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "there/a.blend"))
    second = probes.new_folder("second")
    write_probe(Path(bpy.path.abspath(second)), 1.0, 1.0, 1.0, at=(1.0, 0.0, 500.0))
    light(second)
    images = [each for each in bpy.data.images if each.get(probes.KNOWN)]
    assert len(images) == 6 and all(Path(bpy.path.abspath(each.filepath)).is_file() for each in images)


def test_a_probe_that_cannot_light_leaves_no_empty(model, tmp_path):
    light(write_probe(tmp_path / "first", 1.0, 1.0, 1.0))
    [image, *_] = [each for each in bpy.data.images if each.get(probes.KNOWN)]
    bpy.data.images.remove(image)  # a tidy user, and the panoramas with it
    shutil.rmtree(tmp_path / "first")
    before = set(bpy.data.objects)
    with pytest.raises(RuntimeError, match=r"is missing\s+Take the light at Light Probe again"):
        light(write_probe(tmp_path / "second", 1.0, 1.0, 1.0, at=(1.0, 0.0, 500.0)))
    assert set(bpy.data.objects) == before


def test_of_a_flattened_model_no_probe_has_moved(model, tmp_path):
    light(write_probe(tmp_path / "probe", 1.0, 1.0, 1.0))
    [probe] = probes.probes_of(bpy.context.scene, model)
    model.scale = (1.0, 1.0, 0.0)
    bpy.context.view_layer.update()
    assert not probes.has_moved(probe)
