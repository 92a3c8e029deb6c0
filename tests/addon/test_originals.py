# SPDX-License-Identifier: GPL-3.0-or-later
"""Hide Originals: what was photographed is hidden and shown again, and nothing else is touched."""

from __future__ import annotations

from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.capture import originals  # noqa: E402
from physhdr.addon.operators import dataset  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.bridge.blend_file import MODEL_IDENTITY  # noqa: E402

DATA = "/data/kitchen"


def link(name, data=None, collection=None):
    item = bpy.data.objects.new(name, data)
    (collection or bpy.context.scene.collection).objects.link(item)
    return item


def collection(name, parent=None):
    made = bpy.data.collections.new(name)
    (parent or bpy.context.scene.collection).children.link(made)
    return made


def layer_collection(name):
    return next(
        each for each in bpy.context.view_layer.layer_collection.children if each.collection.name == name
    )


@pytest.fixture
def room(registered):
    """A table, a lamp, an instance, things that are not photographed; remembered as of ``DATA``."""
    scene = bpy.context.scene
    link("table", bpy.data.meshes.new("table"))
    link("cutter", bpy.data.meshes.new("cutter")).hide_render = True
    link("ghost", bpy.data.meshes.new("ghost")).hide_viewport = True
    link("lamp", bpy.data.lights.new("lamp", "POINT"))
    scene.camera = link("camera", bpy.data.cameras.new("camera"))
    link("bone")
    tree = bpy.data.collections.new("tree")
    link("leaf", bpy.data.meshes.new("leaf"), tree)
    holder = link("holder")
    holder.instance_type, holder.instance_collection = "COLLECTION", tree
    link("away", bpy.data.meshes.new("away"), collection("Excluded"))
    layer_collection("Excluded").exclude = True
    dark = collection("Not Rendered")
    dark.hide_render = True
    link("within", bpy.data.meshes.new("within"), collection("Within", dark))
    link("shelf", bpy.data.meshes.new("shelf"), collection("Furniture"))
    remember(scene, Path(DATA))
    scene.physhdr.data = DATA
    return scene


def add_model(capture=DATA):
    cloud = bpy.data.pointclouds.new("model")
    cloud[MODEL_IDENTITY], cloud["physhdr_capture"] = "some model", capture
    return link("model", cloud)


PHOTOGRAPHED = {"table", "ghost", "lamp", "holder", "shelf"}


def remember(scene, data):
    """As a data set that is rendered now."""
    originals.remember(scene, originals.photographed(scene, bpy.context.view_layer), data)


def hidden(where):
    return {item.name for item in bpy.data.objects if getattr(item, where)}


def test_what_is_photographed(room):
    found = originals.photographed(room, bpy.context.view_layer)
    assert {item.name for item in found} == PHOTOGRAPHED
    (entry,) = originals.originals_of(room).datasets
    assert {each.target.name for each in entry.objects} == PHOTOGRAPHED


def test_it_is_a_toggle_and_what_was_hidden_stays_so(room):
    model = add_model()
    added = link("chair", bpy.data.meshes.new("chair"))
    before = hidden("hide_viewport"), hidden("hide_render")
    assert before == ({"ghost"}, {"cutter"})
    assert bpy.ops.physhdr.originals_hide() == {"FINISHED"}
    assert hidden("hide_viewport") == PHOTOGRAPHED
    assert hidden("hide_render") == PHOTOGRAPHED | {"cutter"}
    assert not model.hide_viewport and not added.hide_render
    assert originals.are_hidden(room)
    assert bpy.ops.physhdr.originals_hide(action="HIDE") == {"FINISHED"}  # twice is once
    assert bpy.ops.physhdr.originals_hide() == {"FINISHED"}
    assert (hidden("hide_viewport"), hidden("hide_render")) == before and not originals.are_hidden(room)


def test_lights_are_a_choice(room):
    add_model()
    bpy.ops.physhdr.originals_hide(lights=False)
    assert hidden("hide_render") == PHOTOGRAPHED - {"lamp"} | {"cutter"}


def test_renamed_and_replaced(room):
    """A new object of a deleted original's name is none; one that has another name now still is."""
    add_model()
    bpy.data.objects["shelf"].name = "bookcase"
    bpy.data.objects.remove(bpy.data.objects["table"])
    link("table", bpy.data.meshes.new("new table"))
    twin = bpy.data.objects["bookcase"].copy()
    room.collection.objects.link(twin)
    bpy.ops.physhdr.originals_hide()
    assert hidden("hide_render") == (PHOTOGRAPHED - {"table", "shelf"}) | {"bookcase", "cutter"}
    assert not twin.hide_render


def test_saved_and_opened(room, tmp_path):
    """Hidden in the file, shown again in another session; what was deleted is not kept for that."""
    add_model()
    bpy.ops.physhdr.originals_hide()
    room.collection.objects.unlink(bpy.data.objects["table"])  # as Blender's own Delete does
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    assert originals.are_hidden(scene) and "table" not in bpy.data.objects
    assert hidden("hide_render") == PHOTOGRAPHED - {"table"} | {"cutter"}
    bpy.ops.physhdr.originals_hide(action="SHOW")
    assert hidden("hide_viewport") == {"ghost"} and hidden("hide_render") == {"cutter"}
    (entry,) = originals.originals_of(scene).datasets
    assert {each.target.name for each in entry.objects} == PHOTOGRAPHED - {"table"}


def test_undone(room):
    add_model()
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.physhdr.originals_hide()
    bpy.ops.ed.undo_push(message="hidden")
    assert hidden("hide_render") == PHOTOGRAPHED | {"cutter"}
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert hidden("hide_render") == {"cutter"} and not originals.are_hidden(scene)
    bpy.ops.ed.redo()
    scene = bpy.context.scene
    assert originals.are_hidden(scene)
    bpy.ops.physhdr.originals_hide()
    assert hidden("hide_viewport") == {"ghost"} and hidden("hide_render") == {"cutter"}


def test_it_is_offered_once_there_is_a_model_of_this_scene(room):
    assert not originals.is_offered(room)
    other = add_model("/data/another place")
    assert not originals.is_offered(room)
    bpy.data.objects.remove(other)
    room.physhdr.preview = True
    assert originals.is_offered(room)
    room.physhdr.preview = False
    add_model()
    assert originals.is_offered(room)


def test_each_data_set_has_its_own(room):
    """A chair that came after the first data set is no original of the first's model, but of the second's."""
    chair = link("chair", bpy.data.meshes.new("chair"))
    remember(room, Path("/data/second"))
    first = add_model()
    bpy.ops.physhdr.originals_hide()
    assert not chair.hide_render
    bpy.ops.physhdr.originals_hide()
    bpy.data.objects.remove(first)
    add_model("/data/second")
    bpy.ops.physhdr.originals_hide()
    assert chair.hide_render


@pytest.mark.parametrize("how", ["keyframes", "driver", "none", "muted"])
def test_what_its_animation_shows_again_is_told(room, how, tmp_path, capsys):
    """Against a render by Cycles, in which there is nothing but the shelf or nothing at all."""
    add_model().hide_render = True
    shelf = bpy.data.objects["shelf"]
    shelf.data.from_pydata([(-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1)], [], [(0, 1, 2, 3)])
    if how == "driver":
        shelf.driver_add("hide_render").driver.expression = "0"
    elif how != "none":
        shelf.keyframe_insert("hide_render", frame=1)
        (bag,) = (bag for layer in shelf.animation_data.action.layers for bag in layer.strips[0].channelbags)
        bag.fcurves[0].mute = how == "muted"
    bpy.ops.physhdr.originals_hide()
    render.set_resolution(room, 8, 8)
    room.render.engine, room.cycles.samples, room.render.film_transparent = "CYCLES", 1, True
    render.render_exr(room, tmp_path / "picture.exr")
    is_seen = render.read_exr(tmp_path / "picture.exr")[..., 3].max() > 0.0
    assert is_seen == (how in ("keyframes", "driver"))
    assert originals.shown_by_animation(room) == ([shelf] if is_seen else [])
    assert ("shelf: shown again by keyframes" in capsys.readouterr().out) == is_seen


def test_nothing_remembered_greys_the_button(registered):
    assert not bpy.ops.physhdr.originals_hide.poll()
    with pytest.raises(RuntimeError, match="Nothing is remembered"):
        bpy.ops.physhdr.originals_hide()


def test_what_is_linked_is_hidden_too(room, tmp_path):
    """What comes from another file is hidden, too, and again after this one is opened."""
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {bpy.data.objects["shelf"]}, fake_user=True)
    bpy.data.objects.remove(bpy.data.objects["shelf"])
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects = ["shelf"]
    room.collection.objects.link(bpy.data.objects["shelf"])
    remember(room, Path(DATA))
    add_model()
    bpy.ops.physhdr.originals_hide()
    assert bpy.data.objects["shelf"].library and hidden("hide_render") == PHOTOGRAPHED | {"cutter"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert bpy.data.objects["shelf"].library and hidden("hide_render") == PHOTOGRAPHED | {"cutter"}
    bpy.ops.physhdr.originals_hide()
    assert hidden("hide_viewport") == {"ghost"} and hidden("hide_render") == {"cutter"}


@pytest.fixture
def linked(registered, tmp_path):
    """A chair of another file, photographed, and hidden in that file's viewports."""
    link("chair", bpy.data.meshes.new("chair")).hide_viewport = True
    library = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(library, link=True) as (_, wanted):
        wanted.objects = ["chair"]
    scene = bpy.context.scene
    scene.collection.objects.link(bpy.data.objects["chair"])
    remember(scene, Path(DATA))
    scene.physhdr.data, scene.physhdr.preview = DATA, True
    bpy.ops.ed.undo_push(message="before")


def chair():
    item = bpy.data.objects["chair"]
    return item.hide_viewport, item.hide_render


def test_what_is_linked_follows_undo_and_redo(linked):
    """Blender's undo leaves other files' objects as they are, and takes back what we remember of them."""
    bpy.ops.physhdr.originals_hide(action="HIDE")
    bpy.ops.ed.undo_push(message="hidden")
    bpy.ops.ed.undo()
    assert chair() == (True, False) and not originals.are_hidden(bpy.context.scene)
    bpy.ops.ed.redo()
    assert chair() == (True, True) and originals.are_hidden(bpy.context.scene)
    bpy.ops.physhdr.originals_hide(action="SHOW")
    bpy.ops.ed.undo_push(message="shown")
    assert chair() == (True, False)
    bpy.ops.ed.undo()
    assert chair() == (True, True)


def test_what_is_linked_is_shown_as_it_was_in_another_session(linked, tmp_path):
    for _ in range(2):  # the second time after an undo
        bpy.ops.physhdr.originals_hide(action="HIDE")
        bpy.ops.ed.undo_push(message="hidden")
        bpy.ops.ed.undo()
    bpy.ops.physhdr.originals_hide(action="HIDE")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert chair() == (True, True)
    bpy.ops.physhdr.originals_hide(action="SHOW")
    assert chair() == (True, False)


def test_what_is_linked_is_shown_in_the_copy_that_is_photographed(linked, tmp_path):
    """Another Blender with the extension opens the copy; in the open file all stays hidden."""
    scene = bpy.context.scene
    link("table", bpy.data.meshes.new("table")).hide_viewport = True
    remember(scene, Path(DATA))
    bpy.ops.physhdr.originals_hide(action="HIDE")
    before = [
        (each.target.name, each.was_hidden_in_viewports, each.was_hidden_in_renders)
        for each in originals.originals_of(scene).hidden
    ]
    assert len(before) == 2
    with originals.shown(scene), dataset._copy_of_file() as copy:
        photographed = originals.photographed(scene, bpy.context.view_layer)
    assert {each.name for each in photographed} == {"chair", "table"}
    assert originals.are_hidden(scene) and hidden("hide_render") == {"chair", "table"}
    assert before == [
        (each.target.name, each.was_hidden_in_viewports, each.was_hidden_in_renders)
        for each in originals.originals_of(scene).hidden
    ]
    bpy.ops.wm.open_mainfile(filepath=str(copy))
    assert bpy.data.objects["chair"].library and not originals.are_hidden(bpy.context.scene)
    assert hidden("hide_viewport") == {"chair", "table"} and not hidden("hide_render")
