# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own scene: rigs around their camera, their light at other levels, nothing of theirs changed."""

import importlib.util
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from physhdr.bridge import data_set
from physhdr.bridge.blend_file import MODEL_IDENTITY
from physhdr.synth import dataset, light_choice, open_scene, passes, renderer, rig, user_camera, user_light
from physhdr.synth.errors import ConflictError, OptionError, RenderError, SceneError
from physhdr.synth.light_names import LightChoice
from physhdr.synth.make_scene import main
from physhdr.synth.options import CURRENT, FOLLOW, Options
from physhdr.synth.progress import Report

_spec = importlib.util.spec_from_file_location("synth_readers", Path(__file__).with_name("conftest.py"))
readers = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(readers)

ROOT = Path(__file__).parents[2]
CAMERA = (0.5, -5.0, 2.0)
PITCH = math.radians(70)

SMALL = Options(
    from_file=CURRENT,
    resolution=(32, FOLLOW),
    samples=4,
    views=6,
    lit_views=2,
    relit_views=1,
    ambient_levels=(4.0,),
    denoise=False,
)


def add(name, data, location=(0, 0, 0), rotation=(0, 0, 0)):
    item = bpy.data.objects.new(name, data)
    item.location, item.rotation_euler = location, rotation
    bpy.context.scene.collection.objects.link(item)
    return item


def mesh(name, corners, faces, material):
    made = bpy.data.meshes.new(name)
    made.from_pydata(corners, [], faces)
    made.materials.append(material)
    return made


def light(name, kind, energy, location, rotation=(0.6, 0.2, 0)):
    data = bpy.data.lights.new(name, kind)
    data.energy = energy
    return add(name, data, location, rotation)


def background():
    return next(node for node in bpy.context.scene.world.node_tree.nodes if node.type == "BACKGROUND")


@pytest.fixture
def scene():
    """A cube on a plane, world, sun and lamp, a camera whose render is 16:9; not as our settings are."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = bpy.data.materials.new("grey")
    floor = [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)]
    add("floor", mesh("floor", floor, [(0, 1, 2, 3)], grey))
    cube = [(x, y, z) for z in (0, 1) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
    faces = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    add("cube", mesh("cube", cube, faces, grey))
    scene.world = bpy.data.worlds.new("sky")
    background().inputs["Color"].default_value = (0.3, 0.5, 1.0, 1.0)
    background().inputs["Strength"].default_value = 0.5
    light("sun", "SUN", 2.0, (0, 0, 5))
    light("lamp", "POINT", 60.0, (1.5, -1.5, 1.5))
    scene.camera = add("mine", bpy.data.cameras.new("mine"), CAMERA, (PITCH, 0, 0))
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    scene.render.engine = "BLENDER_EEVEE"
    scene.view_settings.exposure = 1.5
    scene.cycles.samples = 333
    scene.cycles.max_bounces = 9
    return scene


def state_of_everything():
    """Every value of every property of the scene and of all data, as far as it can be written down."""

    def value_of(owner, each):
        value = getattr(owner, each.identifier)
        if each.type == "POINTER":
            if isinstance(value, bpy.types.ID):
                return value.name_full
            inside = (
                "render",
                "image_settings",
                "view_settings",
                "display_settings",
                "cycles",
                "eevee",
                "dof",
            )
            return rows(value) if value is not None and each.identifier in inside else value is None
        if each.type == "COLLECTION":
            return [getattr(item, "name", "") for item in value]
        if getattr(each, "is_array", False):
            return [round(number, 6) for number in np.ravel(value).tolist()]
        return value if isinstance(value, str | int | float | bool) else str(value)

    # Of no meaning, or made by Blender itself when it first needs it (the curve: where it is not in use).
    unstable = {"rna_type", "session_uid", "preview", "linear_colorspace_settings", "users", "is_evaluated"}
    unstable |= {"curve_mapping", "use_nodes"}

    def rows(owner):
        return {
            p.identifier: value_of(owner, p) for p in owner.bl_rna.properties if p.identifier not in unstable
        }

    kinds = (
        "scenes",
        "objects",
        "lights",
        "cameras",
        "worlds",
        "materials",
        "meshes",
        "node_groups",
        "actions",
    )
    state = {kind: {block.name_full: rows(block) for block in getattr(bpy.data, kind)} for kind in kinds}
    state["layers"] = [
        rows(layer) | {"cycles": rows(layer.cycles)} for s in bpy.data.scenes for layer in s.view_layers
    ]
    trees = [world.node_tree for world in bpy.data.worlds if world.node_tree]
    state["sockets"] = [
        [
            (node.name, s.name, value_of(s, s.bl_rna.properties["default_value"]), s.is_linked)
            for node in tree.nodes
            for s in node.inputs
            if hasattr(s, "default_value")
        ]
        for tree in [*trees, *bpy.data.node_groups]
    ]
    state["space"] = bpy.data.colorspace.working_space
    state["markers"] = [marker.camera and marker.camera.name for marker in bpy.context.scene.timeline_markers]
    return state


def poses_of(out, split):
    frames = readers.read_json(out / f"transforms_{split}.json")["frames"]
    return [np.array(frame["transform_matrix"]) for frame in frames]


def in_front(distance):
    """The point so many metres before the user's camera."""
    return np.array(CAMERA) + distance * np.array([0, math.sin(PITCH), -math.cos(PITCH)])


@pytest.mark.parametrize("name", ["grid", "orbit", "hemisphere"])
def test_rigs_stand_around_the_users_camera_and_look_where_it_looks(scene, tmp_path, name):
    options = replace(SMALL, camera_rig=name, rig_distance=5.0)
    dataset.make(tmp_path, options)
    target = in_front(5.0)
    places = [pose[:3, 3] for split in ("train", "test") for pose in poses_of(tmp_path, split)]
    for pose in [pose for split in ("train", "test", "lit") for pose in poses_of(tmp_path, split)]:
        away = target - pose[:3, 3]
        assert np.allclose(-pose[:3, 2], away / np.linalg.norm(away), atol=1e-6)
    if name == "grid":
        assert np.allclose(np.mean(places, 0), CAMERA, atol=1e-6)
        assert np.ptp(np.array(places)[:, 0]) == pytest.approx(0.5 * 5.0)
        assert np.ptp(np.array(places)[:, 2]) == pytest.approx(0.3 * 5.0)
    else:
        assert np.allclose(np.linalg.norm(places - target, axis=1), 5.0)
        height = np.array(places)[:, 2]
        assert np.allclose(height, CAMERA[2]) if name == "orbit" else np.ptp(height) > 1.0
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["resolution"] == [32, 18] and told["splits"] == {"train": 3, "test": 3, "lit": 2}
    assert told["source"]["camera"] == "mine" and told["source"]["rig_distance"] == 5.0
    radiance = readers.read_exr(tmp_path / "test_hdr/hdr_001.exr").astype(np.float64)
    for k, t in enumerate(told["exposures"]):
        code = np.floor(255 * (radiance * t / (1 + radiance * t)) ** (1 / 2.2) + 0.5)
        np.testing.assert_array_equal(readers.read_png(tmp_path / f"test/r_1_{k}.png")[..., :3], code)
    points = readers.read_ply(tmp_path / "points3d.ply")
    place = np.stack([points[k] for k in "xyz"], -1)
    on_cube = (np.abs(np.abs(place[:, :2]).max(1) - 0.5) < 1e-4) | (np.abs(place[:, 2] - 1) < 1e-4)
    assert ((np.abs(place[:, 2]) < 1e-4) | on_cube).all() and on_cube.sum() > 50


def test_the_path_is_the_cameras_own_however_it_moves(scene, tmp_path):
    """A camera on a turning parent that is scaled: the poses are those that Blender itself gives, rigid."""
    mine = scene.camera
    arm = add("arm", None)
    arm.scale = (2.0, 2.0, 2.0)
    mine.parent = arm
    scene.frame_start, scene.frame_end = 10, 60
    for frame, angle in ((10, 0.0), (60, 1.0)):
        arm.rotation_euler.z = angle
        arm.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(17)
    dataset.make(tmp_path, replace(SMALL, camera_rig="path"))
    assert scene.frame_current == 17
    given = {"train": (0, 2, 4), "test": (1, 3, 5)}
    for split, at in given.items():
        for pose, k in zip(poses_of(tmp_path, split), at, strict=True):
            scene.frame_set(10 + 10 * k)
            expected = np.array(mine.matrix_world)
            expected[:3, :3] /= 2.0
            np.testing.assert_allclose(pose, expected, atol=1e-5)
    assert readers.read_json(tmp_path / "dataset.json")["source"]["frames"] == [10, 60]


def test_validation_views_keep_off_the_others_of_a_path(scene):
    """A camera that moves by 34 m, a metre a view: they lie a quarter of a metre or more from each view."""
    mine = scene.camera
    scene.frame_start, scene.frame_end = 1, 100
    for frame, x in ((1, 0.0), (100, 34.0)):
        mine.location.x = x
        mine.keyframe_insert("location", index=0, frame=frame)
    for curve in mine.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    poses = user_camera.path(scene, mine, replace(SMALL, views=35, validation_views=12, camera_rig="path"))
    at = [np.array([pose[0, 3] for pose in each]) for each in (poses.train + poses.test, poses.validation)]
    assert sorted(at[0] - at[0].min()) == pytest.approx(range(35), abs=1e-3)
    assert len(at[1]) == 12 and np.abs(at[1][:, None] - at[0][None]).min() > 0.249


def test_a_path_that_stands_still_is_refused(scene, tmp_path):
    with pytest.raises(OptionError, match="'mine' stands still over the frames 1 … 250"):
        dataset.make(tmp_path / "d", replace(SMALL, camera_rig="path"))
    assert not (tmp_path / "d").exists()


def test_a_full_circle_has_no_camera_twice(scene):
    with open_scene.opened(
        replace(SMALL, camera_rig="orbit", rig_arc=360.0, rig_distance=4.0, views=8), Report()
    ) as (stage, _):
        poses = rig.poses("orbit", stage.cameras, 8, 0)
    places = np.array([pose[:3, 3] for pose in [*poses.train, *poses.test]])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1)[~np.eye(8, dtype=bool)]
    assert gaps.min() > 1.0


@pytest.mark.parametrize("up", [0.0, 0.4])
def test_a_camera_that_looks_straight_down_keeps_its_own_up(scene, tmp_path, up):
    scene.camera.location, scene.camera.rotation_euler = (0, 0, 5), (0, 0, up)
    dataset.make(tmp_path, replace(SMALL, relit_views=0, lit_views=0))
    for pose in [*poses_of(tmp_path, "train"), *poses_of(tmp_path, "test")]:
        assert pose[:3, 1] @ [-math.sin(up), math.cos(up), 0] > 0.9


class TestLens:
    """The picture's horizontal angle, against the corners that Blender itself gives the camera."""

    @pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
    @pytest.mark.parametrize("size", [(64, 36), (36, 64), (40, 40)])
    def test_angle(self, scene, fit, size):
        lens = scene.camera.data
        lens.sensor_fit, lens.lens, lens.sensor_width, lens.sensor_height = fit, 28.0, 36.0, 20.0
        scene.render.resolution_x, scene.render.resolution_y = size
        right = max(corner.x / -corner.z for corner in lens.view_frame(scene=scene))
        assert math.tan(user_camera.angle_x(lens, size) / 2) == pytest.approx(right, rel=1e-5)

    @pytest.mark.parametrize("kind", ["ORTHO", "PANO"])
    def test_cameras_that_are_no_pinholes_are_refused(self, scene, tmp_path, kind):
        scene.camera.data.type = kind
        with pytest.raises(SceneError, match="perspective camera"):
            dataset.make(tmp_path / "d", SMALL)

    def test_a_shift_is_left_out_and_told(self, scene, capsys):
        scene.camera.data.shift_x = 0.1
        report = Report()
        with open_scene.opened(SMALL, report):
            pass
        assert "lens shift" in report.warnings[0] and "lens shift" in capsys.readouterr().err

    def test_the_picture_is_what_the_users_camera_sees(self, scene, tmp_path):
        """The middle of an odd grid is the user's own view: against a render with their camera."""
        size = (48, FOLLOW)
        scene.camera.data.lens = 35.0
        options = replace(SMALL, resolution=size, views=35, lit_views=0, relit_views=0, samples=16)
        dataset.make(tmp_path, options)
        middle = next(
            k
            for k, pose in enumerate(poses_of(tmp_path, "test"))
            if np.allclose(pose[:3, 3], CAMERA, atol=1e-5)
        )
        ours = readers.read_exr(tmp_path / f"test_hdr/hdr_{middle:03d}.exr")
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_denoising = 16, False
        scene.cycles.use_adaptive_sampling = False
        scene.cycles.sample_clamp_indirect = 0.0
        scene.render.resolution_x, scene.render.resolution_y = 48, 27
        picture = scene.render.image_settings
        picture.file_format, picture.color_depth, picture.color_mode = "OPEN_EXR", "32", "RGB"
        scene.render.filepath = str(tmp_path / "theirs.exr")
        bpy.ops.render.render(write_still=True)
        theirs = readers.read_exr(tmp_path / "theirs.exr")
        assert np.median(np.abs(ours - theirs) / theirs) < 0.02


class TestTarget:
    """What the rig looks at."""

    def distance(self, scene, **changes):
        with open_scene.opened(replace(SMALL, **changes), Report()) as (stage, _):
            return stage.source["rig_distance"]

    def test_the_focus(self, scene):
        scene.camera.data.dof.use_dof, scene.camera.data.dof.focus_distance = True, 3.25
        assert self.distance(scene) == pytest.approx(3.25)
        scene.camera.data.dof.focus_object = add("focus", None, tuple(in_front(2.5) + [0.7, 0, 0]))
        assert self.distance(scene) == pytest.approx(2.5, rel=1e-5)

    def test_what_the_camera_sees(self, scene):
        """Straight down onto the floor, past a cutter that is not rendered."""
        scene.camera.location, scene.camera.rotation_euler = (3, 3, 4), (0, 0, 0)
        scene.camera.data.lens = 200.0
        assert self.distance(scene) == pytest.approx(4.0, rel=1e-4)
        blocker = add("cutter", bpy.data.meshes["cube"], (3, 3, 2))
        assert self.distance(scene) == pytest.approx(1.0, rel=1e-4)
        blocker.hide_viewport = True  # and rendered all the same
        assert self.distance(scene) == pytest.approx(1.0, rel=1e-4)
        blocker.hide_render = True
        assert self.distance(scene) == pytest.approx(4.0, rel=1e-4)

    def test_the_middle_of_the_scene_where_it_sees_nothing(self, scene):
        scene.camera.rotation_euler = (math.pi / 2 + 0.5, 0, 0)  # up into the sky
        low, high = np.array([-6, -6, 0]), np.array([6, 6, 1])
        forward = np.array([0, math.cos(0.5), math.sin(0.5)])
        expected = ((low + high) / 2 - CAMERA) @ forward
        assert self.distance(scene) == pytest.approx(expected, rel=1e-3)

    def test_what_is_asked(self, scene):
        assert self.distance(scene, rig_distance=7.5) == 7.5

    def test_walls_in_the_way_are_told(self, scene, tmp_path):
        for x in (-1, 1):
            add("wall", bpy.data.meshes["cube"], (0.5 + x, -5, 1)).scale = (0.2, 20, 20)
        report = Report()
        with open_scene.opened(replace(SMALL, rig_extent=(8.0, 1.0), rig_distance=4.0), report):
            pass
        assert any("behind or within things" in line and "--rig-extent" in line for line in report.warnings)


def linked_strength(scene):
    """A world of nested groups whose strengths are linked, keyframed and driven."""
    tree = scene.world.node_tree
    group = bpy.data.node_groups.new("sky group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inner, end = group.nodes.new("ShaderNodeBackground"), group.nodes.new("NodeGroupOutput")
    inner.inputs["Color"].default_value = (1.0, 0.6, 0.3, 1.0)
    value = group.nodes.new("ShaderNodeValue")
    group.links.new(value.outputs[0], inner.inputs["Strength"])
    group.links.new(inner.outputs[0], end.inputs[0])
    value.outputs[0].default_value = 0.4
    user = tree.nodes.new("ShaderNodeGroup")
    user.node_tree = group
    mixed = tree.nodes.new("ShaderNodeAddShader")
    end = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    tree.links.new(background().outputs[0], mixed.inputs[0])
    tree.links.new(user.outputs[0], mixed.inputs[1])
    tree.links.new(mixed.outputs[0], end.inputs["Surface"])
    strength = background().inputs["Strength"]
    for frame, value in ((1, 0.0), (11, 1.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    driver = bpy.data.lights["sun"].driver_add("energy").driver
    driver.expression = "frame / 3"
    scene.frame_set(6)


@pytest.mark.parametrize("prepare", [lambda scene: None, linked_strength])
def test_a_level_scales_the_world_and_the_suns_alone(scene, tmp_path, prepare):
    """The relit truth at level 4 is lamps + 4 × ambient, both rendered apart with the light deleted."""
    prepare(scene)
    options = replace(SMALL, samples=64, lit_views=0, views=4)
    dataset.make(tmp_path / "both", options)
    relit = readers.read_exr(tmp_path / "both/relit/level_4/hdr_001.exr")
    normal = readers.read_exr(tmp_path / "both/test_hdr/hdr_001.exr")
    lamp = bpy.data.objects["lamp"]
    lamp.hide_render = True
    dataset.make(tmp_path / "ambient", replace(options, relit_views=0))
    ambient = readers.read_exr(tmp_path / "ambient/test_hdr/hdr_001.exr")
    lamp.hide_render = False
    bpy.data.objects["sun"].hide_render = True
    scene.world = None
    dataset.make(tmp_path / "lamps", replace(options, relit_views=0))
    lamps = readers.read_exr(tmp_path / "lamps/test_hdr/hdr_001.exr")
    assert ambient.mean() > 0.05 and lamps.mean() > 0.05  # both matter

    def noise(a, b):
        return float(np.mean(np.abs(a - b)) / np.mean(a))

    assert noise(normal, lamps + ambient) < 0.03
    assert noise(relit, lamps + 4.0 * ambient) < 0.03
    assert noise(relit, 4.0 * (lamps + ambient)) > 0.1  # the lamps did not follow
    assert abs(np.mean(relit - lamps - 4.0 * ambient)) < 0.01 * np.mean(relit)


def test_an_animated_sun_in_a_collection_instance_is_ambient_too(scene, tmp_path):
    """The sun is nobody's in the scene itself: only an instance brings it, and its energy is keyframed."""
    sun = bpy.data.objects["sun"]
    sun.data.keyframe_insert("energy", frame=1)
    hidden = bpy.data.collections.new("sky things")
    hidden.objects.link(sun)
    scene.collection.objects.unlink(sun)
    holder = add("instance", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", hidden
    scene.world = None
    ambient, lamps = lights_of(tmp_path / "d", replace(SMALL, samples=16))
    bpy.data.objects["lamp"].hide_render = True
    (alone, dark) = lights_of(tmp_path / "alone", replace(SMALL, samples=16))
    assert ambient.mean() > 0.05 and lamps.mean() > 0.05
    assert alone.mean() == pytest.approx(ambient.mean(), rel=0.02) and dark.max() < 1e-4
    assert sun.lightgroup == "" and sun.data.animation_data.action and len(bpy.data.lights) == 2


def state_of_light(scene):
    layer = scene.view_layers[0]
    groups = [group.name for group in layer.lightgroups], layer.active_lightgroup_index
    of_objects = {item.name: item.lightgroup for item in scene.objects}
    return groups, of_objects, scene.world.name, scene.world.lightgroup, len(bpy.data.worlds)


def lights_of(out, options, name="test_001", lights=("ambient", "lamps")):
    """Radiance of each light alone in one pose."""
    dataset.make(out, options)
    size = tuple(readers.read_json(out / "dataset.json")["resolution"])
    return list(passes.read(out / f"passes/{name}.exr", lights, size).lights.values())


def test_the_users_light_groups_are_further_lights(scene, tmp_path):
    """A group with a lamp and one with a glowing cube; empty ones, and suns in one, are none."""
    layer = scene.view_layers[0]
    groups = [
        layer.lightgroups.add(name=name).name for name in ("Key Light 001", "nothing", "glow", "theirs")
    ]
    layer.active_lightgroup_index = 1
    key = light("key", "POINT", 40.0, (-2, -2, 2))
    key.lightgroup = groups[0]
    glow = bpy.data.materials.new("glow")
    glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 2.0
    cube = bpy.data.objects["cube"]
    cube.data.materials[0] = glow
    cube.lightgroup = "glow"
    bpy.data.objects["sun"].lightgroup = "theirs"
    scene.world.lightgroup = "theirs"
    before = state_of_light(scene)
    options = replace(SMALL, samples=64, lit_views=4, lit_lights=("key_light_001", "ambient"), views=4)
    names = ["ambient", "key_light_001", "glow", "lamps"]
    parts = dict(zip(names, lights_of(tmp_path / "d", options, lights=names), strict=True))
    told = readers.read_json(tmp_path / "d/dataset.json")
    assert told["lights"] == names and told["lit_lights"] == names[:2]
    assert {"folder": "relit/key_light_001_4", "levels": {"key_light_001": 4.0}} in told["relit"]
    assert state_of_light(scene) == before
    for light_name, items in (("key_light_001", ["key"]), ("glow", ["cube"]), ("lamps", ["lamp"])):
        assert parts[light_name].mean() > 0.01, items
    key.hide_render = True
    without = lights_of(
        tmp_path / "without", replace(options, lit_lights=("ambient",)), lights=[names[0], *names[2:]]
    )
    whole = sum(light.astype(np.float64) for light in parts.values())
    rest = sum(light.astype(np.float64) for light in without)
    assert np.mean(np.abs(whole - rest - parts["key_light_001"])) < 0.05 * whole.mean()


def test_a_light_group_called_level_leaves_the_ambient_lights_folders_alone(scene, tmp_path):
    bpy.data.objects["lamp"].lightgroup = scene.view_layers[0].lightgroups.add(name="Level").name
    options = replace(SMALL, views=2, lit_views=4, lit_lights=("ambient", "level_2"))
    dataset.make(tmp_path, options)
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["lights"] == ["ambient", "level_2", "lamps"]
    relit = {entry["folder"]: entry["levels"] for entry in told["relit"]}
    assert relit["relit/level_4"] == {"ambient": 4.0} and relit["relit/level_2_4"] == {"level_2": 4.0}
    assert all(data_set.mixture_levels(folder) == levels for folder, levels in relit.items())


def complicated(scene):
    """Whatever might be left behind: a second layer, markers, animation, another kind of output."""
    linked_strength(scene)
    scene.view_layers.new("second")
    other = add("other", bpy.data.cameras.new("other"), (0, -4, 2), (1.3, 0, 0))
    scene.timeline_markers.new("cut", frame=1).camera = scene.camera
    scene.timeline_markers.new("cut 2", frame=40).camera = other
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_management = "OVERRIDE"
    scene.render.image_settings.view_settings.view_transform = "Filmic"
    scene.render.image_settings.view_settings.exposure = 0.75
    scene.render.use_border = scene.render.use_motion_blur = True
    scene.cycles.use_camera_cull = scene.cycles.use_fast_gi = True
    scene.view_layers[0].samples = 7
    theirs = bpy.data.node_groups.new("their compositor", "CompositorNodeTree")
    theirs.nodes.new("CompositorNodeRLayers")
    scene.compositing_node_group = theirs
    scene.render.compositor_precision = "AUTO"
    scene.view_layers[0].use_pass_normal = True
    scene.view_layers[0].lightgroups.add(name="warm")
    bpy.data.objects["lamp"].lightgroup = "warm"
    bpy.data.objects["sun"].lightgroup = "warm"
    bpy.data.objects["cube"].pass_index = 12
    bpy.data.objects["cube"].hide_viewport = True
    scene.frame_set(6)


@pytest.mark.parametrize("ends", ["well", "error", "interrupt"])
@pytest.mark.parametrize("name", ["grid", "path"])
def test_nothing_of_the_users_is_changed(scene, tmp_path, monkeypatch, name, ends):
    complicated(scene)
    for frame, x in ((1, 0.0), (200, 1.0)):
        scene.camera.location.x = x
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_set(6)
    before, file = state_of_everything(), bpy.data.filepath
    raised = {"well": None, "error": RenderError("no"), "interrupt": KeyboardInterrupt()}[ends]
    real, calls = renderer.Renderer.render, []

    def render(self, *arguments):
        calls.append(arguments)
        if raised is not None and len(calls) == 8:
            raise raised
        return real(self, *arguments)

    monkeypatch.setattr(renderer.Renderer, "render", render)
    if raised is None:
        dataset.make(tmp_path, replace(SMALL, camera_rig=name))
    else:
        with pytest.raises(type(raised)):
            dataset.make(tmp_path, replace(SMALL, camera_rig=name))
    assert len(calls) >= 8
    after = state_of_everything()
    assert json.dumps(after, indent=1).splitlines() == json.dumps(before, indent=1).splitlines()
    assert bpy.data.filepath == file


def test_the_dump_would_see_a_change(scene):
    before = state_of_everything()
    for change, undo in (
        (lambda: setattr(scene.cycles, "samples", 5), lambda: setattr(scene.cycles, "samples", 333)),
        (
            lambda: setattr(bpy.data.lights["sun"], "energy", 3),
            lambda: setattr(bpy.data.lights["sun"], "energy", 2),
        ),
        (lambda: setattr(scene.render.image_settings, "color_depth", "16"), lambda: None),
    ):
        change()
        assert state_of_everything() != before
        undo()


def test_markers_do_not_take_the_camera_away(scene, tmp_path):
    """A camera bound to a marker is the active one at its frame, also against ours."""
    scene.timeline_markers.new("cut", frame=scene.frame_current).camera = scene.camera
    dataset.make(tmp_path, replace(SMALL, views=4, lit_views=0, relit_views=0, rig_extent=(3.0, 2.0)))
    pictures = [
        readers.read_exr(tmp_path / f"{split}_hdr/hdr_{k:03d}.exr")
        for split in ("train", "test")
        for k in (0, 1)
    ]
    for a in range(4):
        for b in range(a):
            assert np.abs(pictures[a] - pictures[b]).mean() > 0.01


def test_only_what_is_rendered_is_the_same_again(scene, tmp_path):
    """The same scene and seed: the same bytes, also from a file, whatever is its view transform."""
    dataset.make(tmp_path / "a", SMALL)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "untitled.blend"))
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Filmic"
    dataset.make(tmp_path / "b", SMALL)
    assert (
        main(["--from-file", str(tmp_path / "untitled.blend"), "--out", str(tmp_path / "c"), *ARGUMENTS]) == 0
    )
    names = sorted(
        p.relative_to(tmp_path / "a")
        for p in (tmp_path / "a").rglob("*")
        if p.suffix in {".exr", ".png", ".ply"}
    )
    assert len(names) == 8 + 8 + 1 + 5 * 8 + 1
    for name in names:
        first = (tmp_path / "a" / name).read_bytes()
        assert (tmp_path / "b" / name).read_bytes() == first, name
        assert (tmp_path / "c" / name).read_bytes() == first, name


ARGUMENTS = [
    *("--resolution", "32", "--samples", "4", "--views", "6", "--lit-views", "2", "--relit-views", "1"),
    *("--ambient-levels", "4", "--no-denoise"),
]


def test_another_working_space_is_converted_on_the_way_out(scene, tmp_path):
    """The file's colours are ACEScg: pixels are Rec.709 all the same, and the file's space stays."""
    options = replace(SMALL, samples=16, views=2, lit_views=0, relit_views=0)
    dataset.make(tmp_path / "a", options)
    bpy.ops.wm.set_working_color_space(working_space="ACEScg", convert_colors=True)
    try:
        dataset.make(tmp_path / "b", options)
        assert bpy.data.colorspace.working_space == "ACEScg"
    finally:
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=True)
    a, b = (readers.read_exr(tmp_path / name / "test_hdr/hdr_000.exr") for name in "ab")
    # Light between surfaces is not quite the same with other primaries; unconverted, blue would be far off.
    assert np.abs(a.mean((0, 1)) / b.mean((0, 1)) - 1).max() < 0.02
    assert readers.read_json(tmp_path / "b/dataset.json")["working_space"] == "Linear Rec.709"


@pytest.mark.parametrize("called", ["Linear Rec.709 (sRGB)", "Utility - Linear - sRGB", "Something Else"])
def test_another_configuration_of_colours(scene, tmp_path, monkeypatch, called):
    """Blender's own, in which Rec.709 has another name: the same radiance, or an error with a remedy."""
    own = Path(bpy.utils.resource_path("LOCAL"), "datafiles/colormanagement")
    text = (own / "config.ocio").read_text(encoding="utf-8").replace("Linear Rec.709", called)
    text = text.replace("icc:luts:filmic", ":".join(str(own / part) for part in ("icc", "luts", "filmic")))
    (tmp_path / "config.ocio").write_text(text, encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
    command += ["--out", tmp_path / "d", *ARGUMENTS, "--views", "2", "--lit-views", "0", "--relit-views", "0"]
    monkeypatch.setenv("OCIO", str(tmp_path / "config.ocio"))
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if called == "Something Else":
        assert done.returncode == 1 and "Traceback" not in done.stderr
        assert "error: the configuration of colours (OCIO) has no space 'Linear Rec.709'" in done.stderr
        assert "without the variable OCIO" in done.stderr
        return
    assert done.returncode == 0, done.stderr
    dataset.make(tmp_path / "own", replace(SMALL, views=2, lit_views=0, relit_views=0))
    ours, own_ones = (readers.read_exr(tmp_path / name / "test_hdr/hdr_000.exr") for name in ("d", "own"))
    np.testing.assert_allclose(ours, own_ones, rtol=1e-4)
    assert readers.read_json(tmp_path / "d/dataset.json")["working_space"] == "Linear Rec.709"


def test_the_users_light_paths_are_kept_and_told(scene, tmp_path):
    dataset.make(tmp_path, replace(SMALL, views=2, lit_views=0, relit_views=0))
    told = readers.read_json(tmp_path / "dataset.json")["render_settings"]
    assert told["scene.cycles.max_bounces"] == 9 and told["scene.cycles.use_light_tree"] is True
    assert told["scene.cycles.sample_clamp_indirect"] == 0.0


def test_resume_renders_what_is_missing_and_refuses_a_changed_scene(scene, tmp_path):
    dataset.make(tmp_path, SMALL)
    lost = tmp_path / "passes/test_001.exr"
    radiance = lost.read_bytes()
    lost.unlink()
    dataset.make(tmp_path, SMALL)
    assert lost.read_bytes() == radiance
    bpy.data.objects["cube"].location.x += 0.25
    lost.unlink()
    with pytest.raises(ConflictError, match="the scene, its lights or its camera have changed"):
        dataset.make(tmp_path, SMALL)
    bpy.data.objects["cube"].location.x -= 0.25
    bpy.data.materials["grey"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.1
    with pytest.raises(ConflictError):
        dataset.make(tmp_path, SMALL)
    assert not lost.exists()


def test_resume_refuses_cameras_that_stand_elsewhere(scene, tmp_path):
    """Nothing has moved, but the rig looks at another distance, or the animation goes elsewhere."""
    scene.camera.data.dof.use_dof, scene.camera.data.dof.focus_distance = True, 4.0
    dataset.make(tmp_path / "grid", SMALL)
    scene.camera.data.dof.focus_distance = 4.5
    with pytest.raises(ConflictError, match="its camera have changed"):
        dataset.make(tmp_path / "grid", SMALL)
    mine = scene.camera
    for frame, x in ((1, 0.5), (250, 1.0)):
        mine.location.x = x
        mine.keyframe_insert("location", frame=frame)
    dataset.make(tmp_path / "path", replace(SMALL, camera_rig="path"))
    mine.location.x = 2.0
    mine.keyframe_insert("location", frame=250)
    with pytest.raises(ConflictError, match="its camera have changed"):
        dataset.make(tmp_path / "path", replace(SMALL, camera_rig="path"))


def test_light_from_a_linked_library(scene, tmp_path):
    """World and an animated sun of another file follow the level, and stay linked and as they were."""
    sun = bpy.data.objects["sun"]
    sun.data.keyframe_insert("energy", frame=1)
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {sun, scene.world}, fake_user=True)
    bpy.data.objects.remove(sun)
    bpy.data.worlds.remove(scene.world)
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects, target.worlds = ["sun"], ["sky"]
    linked = bpy.data.objects["sun"]
    scene.collection.objects.link(linked)
    scene.world = bpy.data.worlds["sky"]
    assert linked.library and scene.world.library
    options = replace(SMALL, samples=32, lit_views=0)
    dataset.make(tmp_path / "d", options)
    normal = readers.read_exr(tmp_path / "d/test_hdr/hdr_001.exr").mean()
    relit = readers.read_exr(tmp_path / "d/relit/level_4/hdr_001.exr").mean()
    bpy.data.objects["lamp"].hide_render = True
    dataset.make(tmp_path / "ambient", replace(options, relit_views=0))
    ambient = readers.read_exr(tmp_path / "ambient/test_hdr/hdr_001.exr").mean()
    assert relit - normal == pytest.approx(3.0 * ambient, rel=0.02)
    assert linked.data.library and linked.data.energy == pytest.approx(2.0)
    assert scene.world.library and background().inputs["Strength"].default_value == 0.5


def test_only_lamps_leave_nothing_to_relight(scene, tmp_path):
    scene.world = None
    bpy.data.objects["sun"].hide_render = True
    dataset.make(tmp_path, SMALL)
    told = readers.read_json(tmp_path / "dataset.json")
    assert "no ambient light" in told["source"]["warnings"][0]
    assert told["splits"] == {"train": 3, "test": 3, "lit": 0} and not (tmp_path / "relit").exists()


def test_dark_scenes_are_refused_and_emission_is_light(scene, tmp_path):
    scene.world = None
    for name in ("sun", "lamp"):
        bpy.data.objects[name].hide_render = True
    with pytest.raises(SceneError, match="has no light"):
        dataset.make(tmp_path / "d", SMALL)
    shader = bpy.data.materials["grey"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Strength"].default_value = 2.0
    with open_scene.opened(SMALL, Report()):
        pass


def test_exposures_that_lose_the_picture_are_told(scene, tmp_path):
    dataset.make(tmp_path, replace(SMALL, exposures=(512.0, 1024.0), crf="srgb", lit_views=0, relit_views=0))
    (told,) = readers.read_json(tmp_path / "dataset.json")["source"]["warnings"]
    assert "white even at the shortest exposure" in told and "shorter" in told


def test_simulations_that_are_not_baked_are_told(scene):
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    bpy.ops.rigidbody.object_add()
    scene.frame_set(5)
    report = Report()
    with open_scene.opened(SMALL, report):
        pass
    assert "simulations that are not baked may look otherwise: cube" in report.warnings


def test_a_picture_that_the_system_refuses_is_told_as_missing(scene, tmp_path):
    """As Blender, which cannot read it either: a name that is too long is refused to everybody."""
    there = tmp_path / "there.png"
    there.write_bytes(b"")
    for name, path in (("bark", there), ("leaves", tmp_path / "gone.png"), ("moss", tmp_path / ("m" * 300))):
        image = bpy.data.images.new(name, 4, 4)
        image.source, image.filepath, image.use_fake_user = "FILE", str(path), True
    report = Report()
    with open_scene.opened(SMALL, report):
        pass
    assert "missing files (File > External Data): leaves, moss" in report.warnings


def test_a_material_that_gives_no_number_is_named(scene, tmp_path):
    nodes = bpy.data.materials["grey"].node_tree
    glow, end = nodes.nodes.new("ShaderNodeEmission"), nodes.nodes["Material Output"]
    power = nodes.nodes.new("ShaderNodeMath")
    power.operation, power.inputs[0].default_value, power.inputs[1].default_value = "POWER", 1e30, 9.0
    nodes.links.new(power.outputs[0], glow.inputs["Strength"])
    nodes.links.new(glow.outputs[0], end.inputs["Surface"])
    try:
        dataset.make(tmp_path, SMALL)
    except RenderError as error:
        assert "NaN or infinity" in error.message and "material" in error.hint
    else:  # Cycles itself may refuse such light: then the picture is finite, and whole
        assert np.isfinite(readers.read_exr(tmp_path / "test_hdr/hdr_000.exr")).all()


def test_a_material_that_reads_the_index_is_rendered_as_the_user_sees_it(scene, tmp_path):
    """A cube that shines as brightly as its number; the floor has none."""
    nodes = bpy.data.materials["grey"].node_tree
    glow, info = nodes.nodes.new("ShaderNodeEmission"), nodes.nodes.new("ShaderNodeObjectInfo")
    nodes.links.new(info.outputs["Object Index"], glow.inputs["Strength"])
    nodes.links.new(glow.outputs[0], nodes.nodes["Material Output"].inputs["Surface"])
    bpy.data.objects["cube"].pass_index = 5
    dataset.make(tmp_path, SMALL)
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["objects"] == {"cube": 5}
    assert any("keep the numbers" in warning for warning in told["source"]["warnings"])
    assert readers.read_exr(tmp_path / "test_hdr/hdr_000.exr").max() == pytest.approx(5.0, rel=0.01)


class TestCommandLine:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ("--from-file no/such.blend", "there is no file 'no/such.blend'"),
            (
                "--from-file current --scene-name Nowhere",
                "the file has no scene 'Nowhere': choose one of Scene",
            ),
            ("--from-file current --rig-arc 0", "--rig-arc (degrees): 0 is not within"),
            ("--from-file current --rig-extent 3", "two numbers are needed"),
            ("--from-file current --rig-elevation 50,10", "the lower one first"),
            ("--from-file current --camera-rig spiral", "choose one of grid, hemisphere, orbit, path"),
            ("--from-file current --device TPU", "unknown device 'TPU': choose one of CPU, GPU"),
            ("--scene ball --camera-rig path", "unknown camera rig 'path'"),
            ("--scene ball --rig-distance 3", "--rig-distance is for --from-file"),
        ],
    )
    def test_bad_input(self, scene, tmp_path, capsys, arguments, message):
        assert main(["--out", str(tmp_path / "d"), *arguments.split()]) == 1
        told = capsys.readouterr().err
        assert message in told and told.startswith("error: ") and told.count("\n") == 1
        assert not (tmp_path / "d").exists()

    def test_damaged_files(self, tmp_path, capsys):
        bad = tmp_path / "bad.blend"
        for content in (b"", b"not a blend file", b"BLENDER17-01v0502" + b"\0" * 500):
            bad.write_bytes(content)
            assert main(["--from-file", str(bad), "--out", str(tmp_path / "d")]) == 1
            told = capsys.readouterr().err
            assert "Blender cannot open" in told and "bad.blend" in told
        assert not (tmp_path / "d").exists()

    def test_no_camera(self, scene, tmp_path, capsys):
        scene.camera = None
        assert main(["--from-file", CURRENT, "--out", str(tmp_path / "d")]) == 1
        assert "has no camera: add one and make it the active camera" in capsys.readouterr().err

    def test_progress_for_programs(self, scene, tmp_path):
        """Beside Blender's own lines: objects, fractions that rise from 0 to 1, and the result."""
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
        command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
        command += ["--out", tmp_path / "d", "--progress-json", *ARGUMENTS]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        fractions = [line["progress"] for line in lines if "progress" in line]
        assert fractions[0] == 0.0 and fractions[-1] == 1.0 and fractions == sorted(fractions)
        assert lines[0]["message"] == "rendering train_000" and lines[1]["seconds_left"] >= 0.0
        result = lines[-1]["result"]
        assert result["folder"] == str(tmp_path / "d") and result["splits"] == {
            "train": 3,
            "test": 3,
            "lit": 2,
        }
        assert result["scene"] == "room"
        again = subprocess.run([*map(str, command), "--seed", "3"], capture_output=True, text=True)
        assert again.returncode == 1
        error = json.loads(again.stdout.splitlines()[-1])["error"]
        assert error["code"] == "conflict" and "seed is 0 there, 3 asked" in error["message"]
        assert "another folder" in error["hint"]

    def test_ctrl_c_in_the_middle_of_a_frame(self, scene, tmp_path):
        """It ends with 130 after the frame, and the same command makes the rest."""
        import signal
        import time

        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
        command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
        command += [
            "--out",
            tmp_path / "d",
            "--progress-json",
            *ARGUMENTS,
            "--resolution",
            "112",
            "--samples",
            "64",
        ]
        running = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for line in running.stdout:
            if "train_001" in line:
                break
        time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        told = running.communicate(timeout=120)
        assert running.returncode == 130 and "Traceback" not in told[1], told
        kept = {path.name: path.read_bytes() for path in (tmp_path / "d/passes").glob("*.exr")}
        assert kept and len(kept) < 4 and not (tmp_path / "d/dataset.json").exists()
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert all((tmp_path / "d/passes" / name).read_bytes() == data for name, data in kept.items())
        assert (tmp_path / "d/dataset.json").exists()


def test_every_second_scene_of_a_file_can_be_asked_for(scene, tmp_path):
    other = bpy.data.scenes.new("other")
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    camera.matrix_world = Matrix.Translation((0, 0, 3))
    lamp = bpy.data.objects.new("lamp 2", bpy.data.lights.new("lamp 2", "POINT"))
    lamp.data.energy = 10.0
    for item in (camera, lamp, bpy.data.objects["floor"]):
        other.collection.objects.link(item)
    other.camera = camera
    with open_scene.opened(replace(SMALL, scene_name="other"), Report()) as (stage, options):
        assert stage.scene == other and stage.source["camera"] == "eye"
        assert options.relit_views == 0  # only a lamp there
        assert bpy.context.window.scene == other
    assert bpy.context.window.scene == scene


def glowing_street(scene):
    """A collection with a lamp and, within it, one with a glowing cube; another of an instanced lamp."""
    street, sign = (bpy.data.collections.new(name) for name in ("Street Lamps", "Sign"))
    scene.collection.children.link(street)
    street.children.link(sign)
    glow = bpy.data.materials.new("glow")
    glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 3.0
    cube = bpy.data.objects["cube"]
    cube.data.materials[0] = glow
    lantern = bpy.data.objects.new("lantern", bpy.data.lights.new("lantern", "POINT"))
    lantern.data.energy, lantern.location = 50.0, (-2, -2, 2)
    street.objects.link(lantern)
    sign.objects.link(cube)
    post = bpy.data.collections.new("post")  # nobody's but the instance's
    bulb = bpy.data.objects.new("bulb", bpy.data.lights.new("bulb", "POINT"))
    bulb.data.energy, bulb.location = 40.0, (0, -2, 1)
    post.objects.link(bulb)
    posts = bpy.data.collections.new("Posts")
    scene.collection.children.link(posts)
    holder = bpy.data.objects.new("holder", None)
    holder.instance_type, holder.instance_collection, holder.location = "COLLECTION", post, (2, 1, 0)
    posts.objects.link(holder)
    bpy.context.view_layer.update()
    return {"lantern": ["lantern"], "sign": ["cube"], "posts": ["bulb"], "lamps": ["lamp"]}


CHOSEN = (
    LightChoice("lantern", "collection", "Street Lamps"),
    LightChoice("sign", "collection", "Sign"),
    LightChoice("posts", "collection", "Posts"),
)


def test_collections_are_lights_of_their_own(scene, tmp_path):
    """Each light's pass is what a render with that light alone shows, and the picture at any levels is their
    sum times the levels: against a render by Cycles with the strengths themselves turned."""
    belong = glowing_street(scene)
    before = state_of_light(scene)
    options = replace(
        SMALL, samples=256, views=2, lit_views=1, relit_views=1, light_choices=CHOSEN, ambient_levels=(4.0,)
    )
    options = replace(options, lit_lights=("ambient", "lantern", "sign"))
    names = ["ambient", "lantern", "sign", "posts", "lamps"]
    size = (32, 18)
    dataset.make(tmp_path / "d", options)
    assert state_of_light(scene) == before
    told = readers.read_json(tmp_path / "d/dataset.json")
    assert told["lights"] == names and told["lit_lights"] == names[:3]
    assert readers.read_json(tmp_path / "d/transforms_lit.json")["lights"] == names[:3]
    assert told["options"]["light_choices"][0] == "lantern=collection:Street Lamps"
    got = passes.read(tmp_path / "d/passes/test_000.exr", names, size)
    for name in names:
        assert got.lights[name].mean() > 0.005, name
    levels = {"ambient": 0.5, "lantern": 4.0, "sign": 2.0, "posts": 3.0, "lamps": 0.25}
    background().inputs["Strength"].default_value *= levels["ambient"]
    bpy.data.lights["sun"].energy *= levels["ambient"]
    for name, (item,) in belong.items():
        if item in bpy.data.lights:
            bpy.data.lights[item].energy *= levels[name]
    glow = bpy.data.materials["glow"].node_tree.nodes["Principled BSDF"].inputs["Emission Strength"]
    glow.default_value *= levels["sign"]
    dataset.make(tmp_path / "turned", replace(options, light_choices=(), lit_lights=("ambient",)))
    truth = readers.read_exr(tmp_path / "turned/test_hdr/hdr_000.exr")
    error = np.abs(got.radiance(levels) - truth)
    assert error.mean() < 0.02 * truth.mean()
    parts = sum(light.astype(np.float64) * levels[name] for name, light in got.lights.items())
    np.testing.assert_allclose(got.radiance(levels), parts, rtol=1e-6)
    relit = {entry["folder"]: entry["levels"] for entry in told["relit"]}
    assert relit["relit/lantern_4"] == {"lantern": 4.0}
    np.testing.assert_array_equal(
        readers.read_exr(tmp_path / "d/relit/lantern_4/hdr_000.exr"), got.radiance({"lantern": 4.0})
    )


@pytest.mark.parametrize("name", ["L" * 63, "客厅天花板筒灯暖光带开关组一层北侧"])
@pytest.mark.parametrize("kind", ["group", "collection", ""])
def test_lights_may_have_the_longest_names(scene, tmp_path, kind, name):
    """Blender cuts names of passes off; what was chosen, and groups that nobody chose, have theirs whole."""
    street = bpy.data.collections.new(name)
    scene.collection.children.link(street)
    key = light("key", "POINT", 40.0, (-2, -2, 2))
    scene.collection.objects.unlink(key)
    street.objects.link(key)
    if kind != "collection":
        bpy.data.objects["key"].lightgroup = scene.view_layers[0].lightgroups.add(name=name).name
    before = state_of_light(scene)
    chosen = (LightChoice(name.lower(), kind, name),) if kind else ()
    options = replace(SMALL, views=2, lit_views=0, relit_views=0, light_choices=chosen)
    names = ["ambient", name.lower(), "lamps"]
    lit = lights_of(tmp_path / "d", options, name="test_000", lights=names)
    assert min(each.mean() for each in lit) > 0.01
    assert readers.read_json(tmp_path / "d/dataset.json")["lights"] == names
    assert state_of_light(scene) == before


def test_what_can_be_chosen(scene):
    glowing_street(scene)
    layer = scene.view_layers[0]
    layer.lightgroups.add(name="Key Light")
    layer.lightgroups.add(name="nothing")
    bpy.data.objects["lamp"].lightgroup = "Key Light"
    found = {str(each.choice): each.in_words for each in light_choice.candidates(scene, layer)}
    assert found == {
        "key_light=group:Key Light": "1 lamp",
        "street_lamps=collection:Street Lamps": "1 lamp, 1 glowing object",
        "sign=collection:Sign": "1 glowing object",
        "posts=collection:Posts": "1 lamp",
    }


def hide_item(away, within, holder):
    bpy.data.objects["lamp"].hide_render = True


def hide_collection(away, within, holder):
    away.hide_render = True


def exclude(away, within, holder):
    bpy.context.view_layer.layer_collection.children["Away"].exclude = True


def exclude_and_instance(away, within, holder):
    exclude(away, within, holder)
    holder.instance_type, holder.instance_collection = "COLLECTION", away


def hide_instance(away, within, holder):
    exclude_and_instance(away, within, holder)
    holder.hide_render = True


def hide_what_is_instanced(away, within, holder):
    exclude_and_instance(away, within, holder)
    away.hide_render = True


def hide_within_what_is_instanced(away, within, holder):
    exclude_and_instance(away, within, holder)
    within.hide_render = True


def show_instance_in_renders_alone(away, within, holder):
    exclude_and_instance(away, within, holder)
    holder.hide_viewport = True


def show_nested_instance_in_renders_alone(away, within, holder):
    outer, nested = add("outer", None), bpy.data.collections.new("nested")
    nested.objects.link(holder)
    bpy.context.scene.collection.objects.unlink(holder)
    exclude_and_instance(away, within, holder)
    outer.instance_type, outer.instance_collection = "COLLECTION", nested
    outer.hide_set(True)


def show_in_renders_alone_within_what_is_instanced(away, within, holder):
    exclude_and_instance(away, within, holder)
    bpy.data.objects["lamp"].hide_viewport = True


LIT = (
    lambda *_: None,
    exclude_and_instance,
    show_instance_in_renders_alone,
    show_nested_instance_in_renders_alone,
    show_in_renders_alone_within_what_is_instanced,
)
DARK = (
    hide_item,
    hide_collection,
    exclude,
    hide_instance,
    hide_what_is_instanced,
    hide_within_what_is_instanced,
)


@pytest.mark.parametrize("hide", LIT + DARK)
def test_a_lamp_is_offered_where_its_light_is_in_the_picture(scene, tmp_path, hide):
    """Against a render by Cycles in which nothing else shines."""
    background().inputs["Strength"].default_value = 0.0
    bpy.data.objects.remove(bpy.data.objects["sun"])
    away, within = (bpy.data.collections.new(name) for name in ("Away", "Within"))
    scene.collection.children.link(away)
    away.children.link(within)
    within.objects.link(bpy.data.objects["lamp"])
    scene.collection.objects.unlink(bpy.data.objects["lamp"])
    hide(away, within, add("holder", None))
    layer = scene.view_layers[0]
    layer.update()
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x, scene.render.resolution_y = 16, 9
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(tmp_path / "picture.exr")
    bpy.ops.render.render(write_still=True)
    is_lit = readers.read_exr(tmp_path / "picture.exr").max() > 0.0
    assert is_lit == (hide in LIT)
    shining = [item.name for item in light_choice.emitters(scene, layer)]
    assert shining == (["lamp"] if is_lit else [])
    assert bool(light_choice.candidates(scene, layer)) == is_lit


def test_a_chosen_sun_is_ambient_no_more(scene):
    sky = bpy.data.collections.new("Sky")
    scene.collection.children.link(sky)
    sky.objects.link(bpy.data.objects["sun"])
    choice = LightChoice("sky", "collection", "Sky")
    layer = scene.view_layers[0]
    with user_light.grouped(scene, layer, [choice]) as lights:
        assert list(lights.groups) == ["ambient", "sky", "lamps"] and lights.has_ambient
        assert bpy.data.objects["sun"].lightgroup == lights.groups["sky"]
        assert bpy.data.objects["lamp"].lightgroup == ""
    assert bpy.data.objects["sun"].lightgroup == "" and not layer.lightgroups
    background().inputs["Strength"].default_value = 0.0
    with user_light.grouped(scene, layer, [choice]) as lights:
        assert not lights.has_ambient


@pytest.mark.parametrize(
    ("choice", "told"),
    [
        ("a=collection:Nowhere", "unknown collection of this file 'Nowhere'"),
        ("a=group:Street Lamps", "unknown light group of this view layer 'Street Lamps'"),
        ("a=collection:Dark", "nothing that is rendered shines in the collection 'Dark'"),
        ("Key Light=collection:Sign", "'Key Light' cannot be a light's name"),
        ("lamps=collection:Sign", "'lamps' cannot be a light's name"),
        ("depth=collection:Sign", "'depth' cannot be a light's name"),
        ("level=collection:Sign", "'level' cannot be a light's name"),
        ("Sign", "write NAME=group:"),
    ],
)
def test_lights_that_cannot_be(scene, tmp_path, capsys, choice, told):
    glowing_street(scene)
    scene.collection.children.link(bpy.data.collections.new("Dark"))
    assert main(["--out", str(tmp_path / "d"), "--from-file", CURRENT, "--light", choice]) == 1
    assert told in capsys.readouterr().err and not (tmp_path / "d").exists()


def test_two_collections_that_share_a_lamp(scene):
    """Neither is within the other: the smaller one has it, and that is told. One left with nothing errs."""
    many, few = (bpy.data.collections.new(name) for name in ("Many", "Few"))
    for each in (many, few):
        scene.collection.children.link(each)
        each.objects.link(bpy.data.objects["lamp"])
    for name in ("one", "two"):
        many.objects.link(light(name, "POINT", 5.0, (0, 0, 2)))
    few.objects.link(light("three", "POINT", 5.0, (0, 0, 2)))
    choices = [LightChoice(each.name.lower(), "collection", each.name) for each in (many, few)]
    layer = scene.view_layers[0]
    layer.update()
    taken, notes = light_choice.shares(scene, layer, choices)
    assert {name: sorted(item.name for item in items) for name, items in taken.items()} == {
        "many": ["one", "two"],
        "few": ["lamp", "three"],
    }
    assert notes == ["'lamp' is in 'Few' and in 'Many': it counts as the first"]
    twice = [LightChoice("few", "collection", "Few"), LightChoice("again", "collection", "Few")]
    with pytest.raises(SceneError, match="all that shines in the collection 'Few' is in others"):
        light_choice.shares(scene, layer, twice)


def test_trained_models_are_left_out_and_told(scene, tmp_path, capsys):
    """A model stands before the camera, another is instanced: the same bytes as without, and both named."""
    dataset.make(tmp_path / "without", SMALL)
    cloud = bpy.data.pointclouds.new("splats")
    cloud.resize(1)
    cloud.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.array([0.6], np.float32))
    cloud[MODEL_IDENTITY] = "some model"
    add("splats", cloud, (0.3, -2, 1))
    hidden = bpy.data.collections.new("hidden")
    hidden.objects.link(bpy.data.objects.new("more splats", cloud))
    holder = add("holder", None, (-1, -2, 1))
    holder.instance_type, holder.instance_collection = "COLLECTION", hidden
    bpy.context.view_layer.update()
    dataset.make(tmp_path / "with", SMALL)
    assert "trained models: splats, more splats" in capsys.readouterr().out
    told = readers.read_json(tmp_path / "with/dataset.json")["source"]
    assert told["left_out"] == ["splats", "more splats"] and told["warnings"] == []
    name = "test_hdr/hdr_001.exr"
    assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
    assert not bpy.data.objects["splats"].hide_render and not bpy.data.objects["more splats"].hide_render
    del cloud[MODEL_IDENTITY]  # any other point cloud is a part of the scene
    dataset.make(tmp_path / "cloud", SMALL)
    assert (tmp_path / "cloud" / name).read_bytes() != (tmp_path / "without" / name).read_bytes()
