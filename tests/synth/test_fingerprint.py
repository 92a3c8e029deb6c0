# SPDX-License-Identifier: GPL-3.0-or-later
"""What one may do to a scene between two runs into one folder is noticed; what no picture shows is not."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

from physhdr.synth.fingerprint import fingerprint  # noqa: E402

LENS = (1.0, 0.1, 100.0)


def add(name, data, collection=None):
    item = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(item)
    return item


def cube(name):
    data = bpy.data.meshes.new(name)
    corners = [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    data.from_pydata(corners, [], [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4)])
    return data


@pytest.fixture
def scene():
    """A chair in a collection, a shelf that is an instance, a wire, lights, a sky, a material, a camera."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    chairs, books = bpy.data.collections.new("Chairs"), bpy.data.collections.new("Books")
    scene.collection.children.link(chairs)
    chair = add("chair", cube("chair"), chairs)
    wood = bpy.data.materials.new("wood")
    chair.data.materials.append(wood)
    nodes, links = wood.node_tree.nodes, wood.node_tree.links
    paint, ramp = nodes.new("ShaderNodeRGB"), nodes.new("ShaderNodeValToRGB")
    paint.name, ramp.name = "paint", "ramp"
    links.new(paint.outputs[0], ramp.inputs[0])
    links.new(ramp.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    add("book", cube("book"), books)
    shelf = add("shelf", None)
    shelf.instance_type, shelf.instance_collection = "COLLECTION", books
    for name, kind in (("smooth", "SUBSURF"), ("array", "ARRAY"), ("hair", "PARTICLE_SYSTEM")):
        chair.modifiers.new(name, kind)
    chair.modifiers["array"].show_viewport = False
    hair = chair.particle_systems[0].settings
    hair.name, hair.type, hair.count = "hair", "HAIR", 50
    hair.child_type = "SIMPLE"
    wire = bpy.data.curves.new("wire", "CURVE")
    wire.bevel_depth = 0.1
    wire.splines.new("BEZIER").bezier_points.add(1)
    wire.splines[0].bezier_points[1].co = (1, 1, 1)
    add("wire", wire)
    scene.camera = add("eye", bpy.data.cameras.new("eye"))
    for name, kind in (("spot", "SPOT"), ("area", "AREA")):
        data = bpy.data.lights.new(name, kind)
        data.energy = 100.0
        add(name, data)
    scene.world = bpy.data.worlds.new("sky")
    sky = scene.world.node_tree.nodes.new("ShaderNodeTexSky")
    sky.name = "air"
    scene.world.node_tree.links.new(sky.outputs[0], scene.world.node_tree.nodes["Background"].inputs["Color"])
    return scene


def state(scene, lens=LENS):
    layer = scene.view_layers[0]
    layer.update()
    return fingerprint(scene, layer, [np.eye(4)], lens)


def of(path):
    """Blender's data by a path from ``bpy.data``, and the name of its last part."""
    holder, _, name = path.rpartition(".")
    return eval(f"bpy.data.{holder}", {"bpy": bpy}), name


LAYER = "scenes['Scene'].view_layers[0].layer_collection.children['Chairs']"
SHOWN = (
    ("collections['Chairs'].hide_render", True),
    (f"{LAYER}.exclude", True),
    (f"{LAYER}.holdout", True),
    (f"{LAYER}.indirect_only", True),
    ("objects['chair'].hide_render", True),
    ("objects['chair'].visible_camera", False),
    ("objects['chair'].visible_shadow", False),
    ("objects['book'].location", (1.0, 0.0, 0.0)),
    ("objects['book'].hide_render", True),
    ("objects['shelf'].location", (1.0, 0.0, 0.0)),
    ("lights['spot'].spot_size", 2.1),
    ("lights['spot'].spot_blend", 0.9),
    ("lights['spot'].shadow_soft_size", 3.0),
    ("lights['spot'].exposure", 1.0),
    ("lights['spot'].use_shadow", False),
    ("lights['spot'].cycles.max_bounces", 0),
    ("lights['area'].shape", "DISK"),
    ("lights['area'].size", 4.0),
    ("worlds['sky'].node_tree.nodes['air'].sun_elevation", 0.1),
    ("worlds['sky'].cycles_visibility.camera", False),
    ("materials['wood'].node_tree.nodes['paint'].outputs[0].default_value", (1.0, 0.0, 0.0, 1.0)),
    ("materials['wood'].node_tree.nodes['ramp'].color_ramp.elements[0].color", (1.0, 0.0, 0.0, 1.0)),
    ("materials['wood'].node_tree.nodes['ramp'].color_ramp.interpolation", "CONSTANT"),
    ("materials['wood'].displacement_method", "DISPLACEMENT"),
    ("meshes['chair'].vertices[6].co", (2.0, 2.0, 2.0)),
    ("scenes['Scene'].cycles.max_bounces", 0),
    ("scenes['Scene'].cycles.volume_bounces", 7),
    ("scenes['Scene'].cycles.caustics_reflective", False),
    ("scenes['Scene'].cycles.use_light_tree", False),
    ("scenes['Scene'].render.use_simplify", True),
    ("objects['chair'].modifiers['smooth'].render_levels", 3),
    ("objects['chair'].modifiers['smooth'].show_render", False),
    ("objects['chair'].modifiers['smooth'].boundary_smooth", "PRESERVE_CORNERS"),
    ("objects['chair'].modifiers['array'].count", 5),
    ("objects['chair'].modifiers['array'].show_render", False),
    ("objects['chair'].modifiers['hair'].show_render", False),
    ("objects['chair'].particle_systems[0].seed", 7),
    ("objects['chair'].show_instancer_for_render", False),
    ("particles['hair'].count", 500),
    ("particles['hair'].hair_length", 9.0),
    ("particles['hair'].rendered_child_count", 7),
    ("curves['wire'].render_resolution_u", 40),
    ("curves['wire'].resolution_u", 40),
    ("curves['wire'].bevel_resolution", 1),
)
#: Which only views show, or which the settings for ground truth replace.
NOT_SHOWN = (
    ("objects['chair'].show_name", True),
    ("objects['chair'].display_type", "WIRE"),
    ("objects['chair'].hide_viewport", True),
    ("objects['chair'].show_instancer_for_viewport", False),
    ("objects['chair'].modifiers['smooth'].levels", 3),
    ("objects['chair'].modifiers['smooth'].show_viewport", False),
    ("objects['chair'].modifiers['array'].show_viewport", True),
    ("particles['hair'].display_percentage", 10),
    ("particles['hair'].child_percent", 3),
    ("lights['spot'].show_cone", True),
    ("materials['wood'].diffuse_color", (1.0, 0.0, 0.0, 1.0)),
    ("materials['wood'].node_tree.nodes['paint'].location", (300.0, 300.0)),
    ("scenes['Scene'].cycles.samples", 7),
    ("scenes['Scene'].cycles.preview_samples", 7),
    ("scenes['Scene'].cycles.use_fast_gi", True),
    ("scenes['Scene'].view_settings.exposure", 2.0),
)


def change(path, value):
    """Set it, and give what puts it back."""
    owner, name = of(path)
    former = getattr(owner, name)
    former = former[:] if hasattr(former, "__len__") and not isinstance(former, str) else former
    setattr(owner, name, value)
    assert getattr(owner, name) != former
    return lambda: setattr(owner, name, former)


@pytest.mark.parametrize(("path", "value"), SHOWN)
def test_what_a_picture_shows_is_noticed(scene, path, value):
    before = state(scene)
    put_back = change(path, value)
    assert state(scene) != before
    put_back()
    assert state(scene) == before


@pytest.mark.parametrize(("path", "value"), NOT_SHOWN)
def test_what_no_picture_shows_may_change(scene, path, value):
    before = state(scene)
    change(path, value)
    assert state(scene) == before


def test_the_resolution_of_views_does_not_matter_where_renders_have_their_own(scene):
    bpy.data.curves["wire"].render_resolution_u = 20
    before = state(scene)
    bpy.data.curves["wire"].resolution_u = 40
    assert state(scene) == before


def test_looking_leaves_the_scenes_settings(scene):
    scene.render.engine, scene.render.use_compositing = "BLENDER_WORKBENCH", True
    scene.render.resolution_percentage = 75
    state(scene)
    assert (scene.render.engine, scene.render.resolution_percentage) == ("BLENDER_WORKBENCH", 75)
    assert scene.render.use_compositing and not hasattr(bpy.types, "PHYSHDR_LOOK")


def test_what_is_scattered_is_counted(scene):
    """An array of instances by geometry nodes: the same object more often, and no vertex more."""
    tree = bpy.data.node_groups.new("scatter", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    line, info, on_points, out = (
        tree.nodes.new(kind)
        for kind in (
            "GeometryNodeMeshLine",
            "GeometryNodeObjectInfo",
            "GeometryNodeInstanceOnPoints",
            "NodeGroupOutput",
        )
    )
    info.inputs["As Instance"].default_value = True
    info.inputs["Object"].default_value = bpy.data.objects["book"]
    line.inputs["Count"].default_value = 3
    tree.links.new(line.outputs[0], on_points.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], on_points.inputs["Instance"])
    tree.links.new(on_points.outputs[0], out.inputs[0])
    add("scattered", cube("empty")).modifiers.new("scatter", "NODES").node_group = tree
    before = state(scene)
    line.inputs["Count"].default_value = 4
    bpy.data.objects["scattered"].update_tag()
    assert state(scene) != before


def test_where_the_cameras_begin_to_see_is_noticed(scene):
    assert state(scene) != state(scene, (1.0, 0.5, 100.0))


def test_the_same_file_in_another_folder_is_the_same(scene, tmp_path):
    """A copy is rendered, whose relative paths are made to fit its place."""
    paint = bpy.data.images.new("paint", 4, 4)
    paint.filepath_raw, paint.file_format = str(tmp_path / "paint.png"), "PNG"
    paint.save()
    node = bpy.data.materials["wood"].node_tree.nodes.new("ShaderNodeTexImage")
    node.image = paint
    paint.filepath = str(tmp_path / "paint.png")
    (tmp_path / "deep" / "down").mkdir(parents=True)
    found = []
    for folder in (tmp_path, tmp_path / "deep" / "down"):
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), relative_remap=True)
        bpy.ops.file.make_paths_relative()
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
        found.append((bpy.data.images["paint"].filepath, state(bpy.context.scene)))
    assert found[0][0] != found[1][0] and found[0][1] == found[1][1]
