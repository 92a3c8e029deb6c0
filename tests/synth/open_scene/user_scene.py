# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene that stands for a user's own, and what tests do with it."""

import math
from pathlib import Path

import bpy
import numpy as np

from physhdr.synth import dataset, passes
from physhdr.synth.options import CURRENT, FOLLOW, Options
from physhdr.tests.synth import conftest as readers

ROOT = Path(__file__).parents[3]
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

ARGUMENTS = [
    *("--resolution", "32", "--samples", "4", "--views", "6", "--lit-views", "2", "--relit-views", "1"),
    *("--ambient-levels", "4", "--no-denoise"),
]


def opened():
    """A cube on a plane, world, sun and lamp, a camera whose render is 16:9; not as our settings are."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
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


def saved(path):
    """The same in a file."""
    opened()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return path


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


def poses_of(out, split):
    frames = readers.read_json(out / f"transforms_{split}.json")["frames"]
    return [np.array(frame["transform_matrix"]) for frame in frames]


def in_front(distance):
    """The point so many metres before the user's camera."""
    return np.array(CAMERA) + distance * np.array([0, math.sin(PITCH), -math.cos(PITCH)])


def lights_of(out, options, name="test_001", lights=("ambient", "lamps")):
    """Radiance of each light alone in one pose."""
    dataset.make(out, options)
    size = tuple(readers.read_json(out / "dataset.json")["resolution"])
    return list(passes.read(out / f"passes/{name}.exr", lights, size).lights.values())


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


def state_of_light(scene):
    layer = scene.view_layers[0]
    groups = [group.name for group in layer.lightgroups], layer.active_lightgroup_index
    of_objects = {item.name: item.lightgroup for item in scene.objects}
    return groups, of_objects, scene.world.name, scene.world.lightgroup, len(bpy.data.worlds)
