# SPDX-License-Identifier: GPL-3.0-or-later
"""Collections and light groups of the user's scene as lights of their own."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from physhdr.synth import dataset, light_choice, passes, user_light
from physhdr.synth.errors import SceneError
from physhdr.synth.light_names import LightChoice
from physhdr.synth.make_scene import main
from physhdr.synth.options import CURRENT
from physhdr.tests.synth import conftest as readers
from physhdr.tests.synth.open_scene.user_scene import SMALL, add, background, light, lights_of, state_of_light


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


@pytest.mark.long
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
