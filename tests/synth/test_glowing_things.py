# SPDX-License-Identifier: GPL-3.0-or-later
"""What geometry nodes and fire make glow is light, and a change of it is a change of the scene."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

from physhdr.synth import exr, light_choice, user_light  # noqa: E402
from physhdr.synth.fingerprint import fingerprint  # noqa: E402


def add(name, data, collection=None):
    item = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(item)
    return item


def cube(name):
    data = bpy.data.meshes.new(name)
    corners = [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    faces = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    data.from_pydata(corners, [], faces)
    return data


def material(name, kind, socket="Surface", **inputs):
    """A material of one node of a kind."""
    made = bpy.data.materials.new(name)
    made.node_tree.nodes.clear()
    node = made.node_tree.nodes.new(kind)
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    end = made.node_tree.nodes.new("ShaderNodeOutputMaterial")
    made.node_tree.links.new(node.outputs[0], end.inputs[socket])
    return made


@pytest.fixture
def scene():
    """A cube before a camera, in the dark."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    add("cube", cube("cube"))
    camera = add("camera", bpy.data.cameras.new("camera"))
    camera.location = (0.5, 0.5, 5.0)
    scene.camera = camera
    return scene


def layer_of(scene):
    layer = scene.view_layers[0]
    layer.update()
    return layer


def state(scene):
    return fingerprint(scene, layer_of(scene), [np.eye(4)], (1.0, 0.1, 100.0))


def sum_of_light(scene, path):
    """Of a picture by Cycles itself."""
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return exr.read(path).sum()


def nodes_of(item, *sockets):
    """A modifier whose nodes pass the geometry on, what these are, and their first and last node."""
    tree = bpy.data.node_groups.new("nodes", "GeometryNodeTree")
    for kind in ("Geometry", *sockets):
        tree.interface.new_socket(kind, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    if item:
        item.modifiers.new("nodes", "NODES").node_group = tree
    return tree, tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")


def through(tree, first, last, node):
    tree.links.new(first.outputs[0], node.inputs[0])
    tree.links.new(node.outputs[0], last.inputs[0])
    return node


def set_directly(item, glow):
    tree, first, last = nodes_of(item)
    through(tree, first, last, tree.nodes.new("GeometryNodeSetMaterial")).inputs[
        "Material"
    ].default_value = glow


def set_in_a_group(item, glow):
    set_directly(None, glow)
    inner = bpy.data.node_groups["nodes"]
    tree, first, last = nodes_of(item)
    user = tree.nodes.new("GeometryNodeGroup")
    user.node_tree = inner
    through(tree, first, last, user)


def set_by_a_node_of_its_own(item, glow):
    tree, first, last = nodes_of(item)
    node = through(tree, first, last, tree.nodes.new("GeometryNodeSetMaterial"))
    source = tree.nodes.new("GeometryNodeInputMaterial")
    source.material = glow
    tree.links.new(source.outputs[0], node.inputs["Material"])


def given_by_the_modifier(item, glow):
    tree, first, last = nodes_of(item, "Material")
    node = through(tree, first, last, tree.nodes.new("GeometryNodeSetMaterial"))
    tree.links.new(first.outputs["Material"], node.inputs["Material"])
    inputs = item.modifiers[0].properties.inputs
    asked = next(each for each in tree.interface.items_tree if each.name == "Material")
    getattr(inputs, asked.identifier).value = glow


def replaced(item, glow):
    plain = bpy.data.materials.new("plain")
    item.data.materials.append(plain)
    tree, first, last = nodes_of(item)
    node = through(tree, first, last, tree.nodes.new("GeometryNodeReplaceMaterial"))
    node.inputs["Old"].default_value, node.inputs["New"].default_value = plain, glow


def on_instances_of_mere_geometry(item, glow):
    tree, first, last = nodes_of(item)
    shape, node, points = (
        tree.nodes.new(f"GeometryNode{kind}") for kind in ("MeshCube", "SetMaterial", "InstanceOnPoints")
    )
    node.inputs["Material"].default_value = glow
    tree.links.new(shape.outputs[0], node.inputs[0])
    tree.links.new(node.outputs[0], points.inputs["Instance"])
    through(tree, first, last, points)


def brought_with_another_object(item, glow):
    """Its geometry becomes the item's own; the other one is not rendered."""
    other = add("other", cube("other"))
    other.data.materials.append(glow)
    other.hide_render = True
    tree, _, last = nodes_of(item)
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = other
    tree.links.new(source.outputs["Geometry"], last.inputs[0])


WAYS = (
    set_directly,
    set_in_a_group,
    set_by_a_node_of_its_own,
    given_by_the_modifier,
    replaced,
    on_instances_of_mere_geometry,
    brought_with_another_object,
)


@pytest.mark.parametrize("way", WAYS)
def test_what_geometry_nodes_make_glow_is_light(scene, tmp_path, way):
    cube_, layer = bpy.data.objects["cube"], scene.view_layers[0]
    layer.lightgroups.add(name="Glow")
    cube_.lightgroup = "Glow"
    glow = material("glow", "ShaderNodeEmission", Strength=0.0)
    strength = glow.node_tree.nodes["Emission"].inputs["Strength"]
    way(cube_, glow)
    layer_of(scene)
    assert not user_light.any_light(scene, layer) and not light_choice.emitters(scene, layer)
    dark = state(scene)
    strength.default_value = 5.0
    assert state(scene) != dark
    assert user_light.any_light(scene, layer)
    assert list(light_choice.emitters(scene, layer)) == [cube_]
    assert [found.in_words for found in light_choice.candidates(scene, layer)] == ["1 glowing object"]
    with user_light.grouped(scene, layer) as lights:
        assert lights.groups["glow"] == "Glow"
    assert sum_of_light(scene, tmp_path / "picture.exr") > 0.0


def test_what_views_hide_glows_all_the_same(scene):
    for way in (set_directly, given_by_the_modifier):
        item = add(way.__name__, cube("hidden"))
        way(item, material("glow", "ShaderNodeEmission"))
        item.hide_viewport = True
    assert len(light_choice.emitters(scene, layer_of(scene))) == 2


def scattered_by_nodes(holder, bulb):
    tree, _, last = nodes_of(holder)
    source, shape, points = (
        tree.nodes.new(f"GeometryNode{kind}") for kind in ("ObjectInfo", "MeshCube", "InstanceOnPoints")
    )
    source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = bulb, True
    tree.links.new(shape.outputs[0], points.inputs["Points"])
    tree.links.new(source.outputs["Geometry"], points.inputs["Instance"])
    tree.links.new(points.outputs[0], last.inputs[0])


def scattered_by_particles(holder, bulb):
    holder.modifiers.new("particles", "PARTICLE_SYSTEM")
    particles = holder.particle_systems[0].settings
    particles.type, particles.count, particles.render_type = "HAIR", 9, "OBJECT"
    particles.instance_object, particles.particle_size = bulb, 1.0


@pytest.mark.parametrize("scatter", [scattered_by_nodes, scattered_by_particles])
def test_what_is_hidden_and_scattered_is_a_light_that_can_be_chosen(scene, tmp_path, scatter):
    """One hides the bulb itself, so that only its instances are in the picture."""
    bulb = add("bulb", cube("bulb"))
    bulb.hide_render = True
    bulb.data.materials.append(material("glow", "ShaderNodeEmission", Strength=5.0))
    garland = bpy.data.collections.new("Garland")
    scene.collection.children.link(garland)
    holder = add("holder", cube("holder"), garland)
    layer = layer_of(scene)
    assert not light_choice.candidates(scene, layer)
    assert sum_of_light(scene, tmp_path / "picture.exr") == 0.0
    scatter(holder, bulb)
    layer = layer_of(scene)
    assert sum_of_light(scene, tmp_path / "picture.exr") > 0.0
    (found,) = light_choice.candidates(scene, layer)
    assert (found.choice.what, found.in_words) == ("Garland", "1 glowing object")
    with user_light.grouped(scene, layer, [found.choice]) as lights:
        assert bulb.lightgroup == lights.groups["garland"]


def test_nodes_that_set_nothing_give_no_light(scene):
    cube_, glow = bpy.data.objects["cube"], material("glow", "ShaderNodeEmission")
    tree, first, last = nodes_of(cube_)
    muted = through(tree, first, last, tree.nodes.new("GeometryNodeSetMaterial"))
    muted.mute = True
    apart = tree.nodes.new("GeometryNodeSetMaterial")
    asks = tree.nodes.new("GeometryNodeMaterialSelection")
    sets = tree.nodes.new("GeometryNodeSetMaterial")
    through(tree, first, last, sets)
    tree.links.new(asks.outputs[0], sets.inputs["Selection"])
    for node in (muted, apart, asks):
        node.inputs["Material"].default_value = glow
    assert not light_choice.emitters(scene, layer_of(scene))
    set_directly(cube_, glow)
    assert light_choice.emitters(scene, layer_of(scene))
    cube_.modifiers[-1].show_render = cube_.modifiers[-1].show_viewport = False
    assert not light_choice.emitters(scene, layer_of(scene))


BLACK = (0.0, 0.0, 0.0, 1.0)
VOLUMES = (
    ({"Blackbody_Intensity": 1.0}, True),
    ({"Blackbody_Intensity": 1.0, "Emission_Color": BLACK, "Color": BLACK}, True),
    ({"Blackbody_Intensity": 1.0, "Blackbody_Tint": BLACK}, False),
    ({"Blackbody_Intensity": 0.0}, False),
    ({"Emission_Strength": 1.0, "Color": BLACK}, True),
    ({"Emission_Strength": 1.0, "Emission_Color": BLACK}, False),
    ({"Emission_Strength": 1.0, "Emission_Color": BLACK, "Blackbody_Intensity": 1.0}, True),
)


@pytest.mark.parametrize(("inputs", "glows"), VOLUMES)
def test_fire_is_light_where_cycles_renders_some(scene, tmp_path, inputs, glows):
    fire = material("fire", "ShaderNodeVolumePrincipled", "Volume", Temperature=1500.0, **inputs)
    bpy.data.objects["cube"].data.materials.append(fire)
    assert (sum_of_light(scene, tmp_path / "picture.exr") > 0.0) == glows
    assert user_light.any_light(scene, layer_of(scene)) == glows
    assert bool(light_choice.emitters(scene, layer_of(scene))) == glows


def test_a_volume_of_coefficients_is_light_where_it_emits(scene):
    haze = material("haze", "ShaderNodeVolumeCoefficients", "Volume")
    bpy.data.objects["cube"].data.materials.append(haze)
    emission = haze.node_tree.nodes[0].inputs["Emission Coefficients"]
    emission.default_value = (0.0, 0.0, 0.0)
    assert not user_light.any_light(scene, layer_of(scene))
    emission.default_value = (0.0, 0.0, 1.0)
    assert user_light.any_light(scene, layer_of(scene))


@pytest.mark.parametrize("name", ["use_sky", "use_solid", "use_volumes", "use_strand"])
def test_what_the_layer_leaves_out_is_noticed(scene, name):
    layer, before = scene.view_layers[0], state(scene)
    setattr(layer, name, not getattr(layer, name))
    assert state(scene) != before
    setattr(layer, name, not getattr(layer, name))
    assert state(scene) == before


def test_a_material_override_is_noticed_and_what_is_in_it(scene):
    states = [state(scene)]
    clay = material("clay", "ShaderNodeBsdfDiffuse")
    scene.view_layers[0].material_override = clay
    states.append(state(scene))
    clay.node_tree.nodes["Diffuse BSDF"].inputs["Color"].default_value = (1.0, 0.0, 0.0, 1.0)
    states.append(state(scene))
    assert len(set(states)) == 3


@pytest.mark.parametrize("name", ["receiver_collection", "blocker_collection"])
def test_what_light_linking_takes_is_noticed(scene, name):
    lamp = add("lamp", bpy.data.lights.new("lamp", "POINT"))
    linked, within = bpy.data.collections.new("linked"), bpy.data.collections.new("within")
    setattr(lamp.light_linking, name, linked)
    states = [state(scene)]
    linked.objects.link(bpy.data.objects["cube"])
    states.append(state(scene))
    linked.collection_objects[0].light_linking.link_state = "EXCLUDE"
    states.append(state(scene))
    linked.children.link(within)
    states.append(state(scene))
    within.objects.link(bpy.data.objects["cube"])
    states.append(state(scene))
    linked.collection_children[0].light_linking.link_state = "EXCLUDE"
    states.append(state(scene))
    assert len(set(states)) == len(states)
    linked.collection_children[0].light_linking.link_state = "INCLUDE"
    assert state(scene) == states[-2]


def test_a_material_set_on_mere_instances_is_told_from_another(scene):
    """No slot names it, and both are in the picture."""
    red, blue = (material(name, "ShaderNodeBsdfDiffuse") for name in ("red", "blue"))
    for name in (red, blue):
        add(name.name, cube(name.name)).data.materials.append(name)
    on_instances_of_mere_geometry(bpy.data.objects["cube"], red)
    before = state(scene)
    node = bpy.data.node_groups["nodes"].nodes["Set Material"]
    node.inputs["Material"].default_value = blue
    assert state(scene) != before
