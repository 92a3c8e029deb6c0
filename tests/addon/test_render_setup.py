# SPDX-License-Identifier: GPL-3.0-or-later
"""Set Up Render: what it sets, what it keeps, how it is undone, and what would render wrong without it."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.blender import render_size  # noqa: E402
from physhdr.addon.light import cg  # noqa: E402
from physhdr.addon.model import look, material, model_import, nodes  # noqa: E402
from physhdr.addon.rendering import render, render_setup  # noqa: E402

SIZE = 64


@pytest.fixture
def room(registered, make_model, write, look_at):
    """Blender's own startup scene as far as rendering goes: a camera, a lamp, Cycles, and a model."""
    target = model_import.import_model(write(make_model(count=20, seed=5)))
    render.add_camera(registered, look_at(2.0, -3.0, 1.5), 0.7)
    registered.render.engine = "CYCLES"
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
    registered.collection.objects.link(lamp)
    return target


def kinds(scene) -> list[str]:
    return [problem.kind for problem in render_setup.render_problems(scene)]


def value(target, name: str):
    modifier = nodes.find_modifier(target)
    return getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, name)).value


def evaluated_width(target) -> int:
    """What the modifier is evaluated with: of the copy that renders."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return value(target.evaluated_get(depsgraph), nodes.IMAGE_WIDTH)


def test_an_import_tells_what_comes_next_where_it_is_needed(registered, make_model, write, look_at, capfd):
    path = str(write(make_model(count=5)))
    render.add_camera(registered, look_at(2.0, -3.0, 1.5), 0.7)
    bpy.ops.physhdr.model_import(filepath=path)
    assert "Set Up Render" in capfd.readouterr().out
    assert not bpy.data.objects["model"].visible_shadow
    bpy.ops.physhdr.render_setup()
    capfd.readouterr()
    bpy.data.objects["model"].hide_render = True
    bpy.ops.physhdr.model_import(filepath=path, name="other")
    assert "Set Up Render" in capfd.readouterr().out  # the new one is no camera splat yet
    bpy.data.objects["other"].hide_render = True
    apart = bpy.data.collections.new("apart")
    registered.collection.children.link(apart)
    apart.hide_render = True
    layer = registered.view_layers[0]
    layer.active_layer_collection = layer.layer_collection.children["apart"]
    bpy.ops.physhdr.model_import(filepath=path, name="hidden")
    told = capfd.readouterr().out
    assert "Imported 5 Gaussians" in told and "Set Up Render" not in told


def test_set_up_leaves_nothing_wrong(room, registered):
    assert kinds(registered) == ["BOUNCES", "SPLATS", "WIDTH"]
    assert bpy.ops.physhdr.render_setup() == {"FINISHED"}
    assert kinds(registered) == []
    registered.render.engine = "BLENDER_EEVEE"
    assert kinds(registered) == []


def settings(scene) -> dict[str, object]:
    """Every setting of the render, of Cycles and of EEVEE that can be read as a number, a text or a flag."""
    found = {}
    for name, group in {"render": scene.render, "cycles": scene.cycles, "eevee": scene.eevee}.items():
        for each in group.bl_rna.properties:
            if each.type in ("INT", "FLOAT", "BOOLEAN", "ENUM", "STRING") and not each.is_readonly:
                found[f"{name}.{each.identifier}"] = getattr(group, each.identifier)
    return {
        key: each if isinstance(each, str | set) else np.array(each).tolist() for key, each in found.items()
    }


def changed(before: dict[str, object], after: dict[str, object]) -> set[str]:
    return {key for key in before if before[key] != after[key]}


def test_set_up_changes_transparent_bounces_alone_and_for_ellipsoids_eevees_samples(room, registered):
    """Of all settings that a scene of Cycles and EEVEE has."""
    before = settings(registered)
    assert len(before) > 150
    bpy.ops.physhdr.render_setup()
    after = settings(registered)
    assert {key: after[key] for key in changed(before, after)} == {
        "cycles.transparent_max_bounces": 1024,
        "cycles.min_transparent_bounces": 256,
    }
    bpy.ops.physhdr.render_setup(camera_splats=False)
    assert changed(after, settings(registered)) == {"eevee.taa_render_samples"}
    assert registered.eevee.taa_render_samples == render_setup.EEVEE_SAMPLES


def test_wishes_change_what_they_name(room, registered):
    bpy.ops.physhdr.render_setup()
    before = settings(registered)
    bpy.ops.physhdr.render_setup(film_transparent=True)
    assert changed(before, settings(registered)) == {"render.film_transparent"}
    before = settings(registered)
    bpy.ops.physhdr.render_setup(exact=True)
    exact = {"cycles.pixel_filter_type", "cycles.filter_width", "cycles.use_denoising", "render.filter_size"}
    # Blender itself links Cycles' older name of the width to it.
    assert changed(before, settings(registered)) == exact
    assert registered.cycles.filter_width == pytest.approx(0.01)
    bpy.ops.physhdr.render_setup()  # neither wish takes anything back
    assert registered.render.film_transparent and registered.cycles.filter_width == pytest.approx(0.01)


def test_each_instanced_collection_is_gone_through_once(room, registered, monkeypatch):
    """Each of 20 has two instances of the next, the last one the model: a million ways to it."""
    last = bpy.data.collections.new("last")
    last.objects.link(room)
    for index in range(20):
        outer = bpy.data.collections.new(f"outer {index}")
        for _ in range(2):
            empty = bpy.data.objects.new("instance", None)
            empty.instance_type, empty.instance_collection = "COLLECTION", last
            outer.objects.link(empty)
        last = outer
    registered.collection.objects.unlink(room)
    for empty in list(last.objects):
        registered.collection.objects.link(empty)
    gone_through = []
    real = render_setup.in_collection

    def counted(collection, types):
        gone_through.append(collection.name)
        return real(collection, types)

    monkeypatch.setattr(render_setup, "in_collection", counted)
    assert render_setup.models_in_render(registered) == [room]
    assert len(gone_through) == len(set(gone_through)) == 20


def test_panels_look_at_no_object_where_the_file_has_no_model(scene, monkeypatch):
    """They ask at every redraw, however many objects there are."""

    def looked(*_):
        raise AssertionError("an object was looked at")
        yield

    scene.collection.objects.link(bpy.data.objects.new("other", None))
    monkeypatch.setattr(render_setup, "in_layer", looked)
    monkeypatch.setattr(cg, "shows_model", looked)
    assert not any(look.models_among(looked()))
    assert not render_setup.has_model(scene) and not render_setup.models_in_render(scene)
    assert not cg.models_of(scene)


def test_of_many_objects_panels_look_closely_at_few(room, registered, monkeypatch):
    mesh = bpy.data.meshes.new("mesh")
    for _ in range(50):
        registered.collection.objects.link(bpy.data.objects.new("other", mesh))
    seen = []
    is_model = look.is_model
    monkeypatch.setattr(look, "is_model", lambda target: seen.append(target) or is_model(target))
    assert render_setup.models_in_render(registered) == [room]
    assert list(look.models_among(registered.objects)) == [room] and render_setup.has_model(registered)
    assert set(seen) == {room}


def steps(work) -> int:
    """How many steps Python takes for ``work``: what time would tell, whatever else the machine does."""
    count = 0

    def trace(frame, event, _):
        nonlocal count
        frame.f_trace_opcodes = True
        count += event == "opcode"
        return trace

    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(None)
    return count


@pytest.mark.parametrize(("engine", "most"), [("CYCLES", 1.5), ("BLENDER_EEVEE", 2.5)])
def test_problems_of_many_objects_take_little_more_than_their_types(room, registered, engine, most):
    """A panel asks at every redraw. EEVEE's shadows are looked for as well: of no lamp that is rendered."""
    registered.render.engine = engine
    room.visible_shadow = True
    registered.objects["Lamp"].hide_render = True
    of_few = steps(lambda: render_setup.render_problems(registered))
    mesh = bpy.data.meshes.new("mesh")
    for index in range(500):
        registered.collection.objects.link(bpy.data.objects.new(f"other {index}", mesh))
    types = steps(lambda: [each for each in registered.collection.objects if each.type == "LIGHT"])
    of_many = steps(lambda: render_setup.render_problems(registered))
    assert of_many - of_few < most * types


def test_empties_alone_are_instances_of_collections(registered):
    """What ``MODEL_OR_INSTANCE`` builds on."""
    item = bpy.data.objects.new("item", bpy.data.meshes.new("mesh"))
    with pytest.raises(TypeError):
        item.instance_type = "COLLECTION"


def test_set_up_lowers_nothing(room, registered):
    cycles, eevee = registered.cycles, registered.eevee
    cycles.transparent_max_bounces, cycles.min_transparent_bounces = 1024, 900
    eevee.taa_render_samples = 333
    before = settings(registered)
    for splats in (True, False):
        bpy.ops.physhdr.render_setup(camera_splats=splats)
        assert changed(before, settings(registered)) == set()
    eevee.taa_render_samples = 8
    bpy.ops.physhdr.render_setup()
    assert eevee.taa_render_samples == 8
    bpy.ops.physhdr.render_setup(camera_splats=False)
    assert eevee.taa_render_samples == render_setup.EEVEE_SAMPLES


def test_set_up_can_be_undone(room, registered):
    name = room.name
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.physhdr.render_setup(film_transparent=True)
    bpy.ops.ed.undo_push(message="after")
    assert kinds(bpy.context.scene) == []
    bpy.ops.ed.undo()
    scene, target = bpy.context.scene, bpy.data.objects[name]
    assert kinds(scene) == ["BOUNCES", "SPLATS", "WIDTH"]
    assert not scene.render.film_transparent
    assert not render_setup.follows_render_width(target)
    bpy.ops.ed.redo()
    assert kinds(bpy.context.scene) == []


def test_the_image_width_follows_the_render(room, registered):
    bpy.ops.physhdr.render_setup()
    for wide, percent, expected in ((640, 100, 640), (1920, 50, 960), (333, 10, 33)):
        registered.render.resolution_x, registered.render.resolution_percentage = wide, percent
        assert evaluated_width(room) == expected == render_size(registered)[0]


def test_the_image_width_is_of_the_scene_that_is_rendered(room, registered):
    """A model that two scenes show, at two sizes."""
    bpy.ops.physhdr.render_setup()
    registered.render.resolution_x = 640
    other = bpy.data.scenes.new("other")
    other.collection.objects.link(room)
    other.render.resolution_x, other.render.resolution_percentage = 400, 50
    widths = {}
    for scene in (registered, other):
        layer = scene.view_layers[0]
        layer.update()
        widths[scene.name] = value(room.evaluated_get(layer.depsgraph), nodes.IMAGE_WIDTH)
    assert widths == {registered.name: 640, "other": 200}


def test_a_driver_or_keyframes_of_the_users_stay(room, registered):
    path = nodes.input_data_path(nodes.find_modifier(room), nodes.IMAGE_WIDTH)
    nodes.set_input(nodes.find_modifier(room), nodes.IMAGE_WIDTH, 77)
    room.keyframe_insert(path, frame=1)
    bpy.ops.physhdr.render_setup()
    assert evaluated_width(room) == 77
    assert kinds(registered) == ["WIDTH"]
    assert not render_setup.render_problems(registered)[0].fixable
    room.animation_data_clear()
    room.driver_add(path).driver.expression = "55"
    bpy.ops.physhdr.render_setup()
    assert evaluated_width(room) == 55
    assert room.animation_data.drivers[0].driver.expression == "55"


SAVED = """
import sys
import time
import bpy
from physhdr.addon.model import nodes  # for a name alone: nothing is registered

bpy.context.preferences.filepaths.use_scripts_auto_execute = False
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
assert not hasattr(bpy.types, "PHYSHDR_OT_render_setup")
bpy.context.scene.render.resolution_x = 808
bpy.context.scene.render.resolution_percentage = 25
target = bpy.data.objects[sys.argv[2]]
modifier = target.modifiers[0]
copy = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).modifiers[0]
print("width", getattr(nodes.inputs_of(copy), nodes.input_identifier(modifier, nodes.IMAGE_WIDTH)).value)
"""


def test_a_saved_file_needs_neither_the_extension_nor_leave_to_run_scripts(room, registered, tmp_path):
    bpy.ops.physhdr.render_setup()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    arguments = [sys.executable, "-c", SAVED, str(tmp_path / "saved.blend"), room.name]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert "width 202" in done.stdout.splitlines(), done.stdout + done.stderr


# ---- problems, one by one ----------------------------------------------------------------------------------


def few_bounces(scene, target):
    scene.cycles.transparent_max_bounces = 128


def few_certain_bounces(scene, target):
    scene.cycles.min_transparent_bounces = 0


def materials(target, shape: str):
    return material.materials_in(nodes.find_modifier(target).node_group, shape)


def by_lot(scene, target):
    """As before version 2 of the material's recipe."""
    scene.render.engine = "BLENDER_EEVEE"
    scene.eevee.taa_render_samples = 16
    (splat,) = materials(target, "splat")
    splat.surface_render_method = "DITHERED"


def depth_of_field(scene, target):
    scene.render.engine = "BLENDER_EEVEE"
    scene.camera.data.dof.use_dof = True


def shadows(scene, target):
    scene.render.engine = "BLENDER_EEVEE"
    target.visible_shadow = True


def ellipsoids(scene, target):
    nodes.set_input(nodes.find_modifier(target), nodes.CAMERA_SPLATS, False)


def no_driver(scene, target):
    target.animation_data_clear()
    nodes.set_input(nodes.find_modifier(target), nodes.IMAGE_WIDTH, 100)


def no_modifier_in_renders(scene, target):
    nodes.find_modifier(target).show_render = False


def panorama(scene, target):
    scene.camera.data.type = "PANO"


@pytest.mark.parametrize(
    ("spoil", "kind", "says"),
    [
        (few_bounces, "BOUNCES", "passes 128 Gaussians"),
        (few_certain_bounces, "BOUNCES", "noisy"),
        (by_lot, "SAMPLES", "with 16 samples"),
        (depth_of_field, "DEPTH", "lies behind it"),
        (shadows, "SHADOWS", "may not finish"),
        (ellipsoids, "SPLATS", "drawn as ellipsoids"),
        (no_driver, "WIDTH", "for a picture 100 pixels wide, and this one has 1920"),
        (no_modifier_in_renders, "MODIFIER", "switched off"),
        (panorama, "SPLATS", "panorama"),
    ],
)
def test_each_problem_is_told_alone_and_mended(room, registered, spoil, kind, says):
    bpy.ops.physhdr.render_setup()
    spoil(registered, room)
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == (kind, True)
    assert says in problem.text
    bpy.ops.physhdr.render_setup()
    assert kinds(registered) == []


def test_what_is_wrong_of_several_models_alike_is_said_once(room, registered, make_model, write):
    for name in ("garden", "hall"):
        other = model_import.import_model(write(make_model(count=20, seed=6)), name)
        nodes.set_input(nodes.find_modifier(other), nodes.IMAGE_WIDTH, 100)
    widths = [each for each in render_setup.render_problems(registered) if each.kind == "WIDTH"]
    assert len(widths) == 2  # the room's own is another one
    assert [each.text.partition(":")[0] for each in widths] == [room.name, "garden and hall"]


def test_splats_are_blended_unless_depth_of_field_needs_their_depth(room, registered):
    (splat,), (ellipsoid,) = materials(room, "splat"), materials(room, "ellipsoid")
    registered.render.engine = "BLENDER_EEVEE"
    bpy.ops.physhdr.render_setup()
    assert (splat.surface_render_method, ellipsoid.surface_render_method) == ("BLENDED", "DITHERED")
    registered.camera.data.dof.use_dof = True
    bpy.ops.physhdr.render_setup()
    assert splat.surface_render_method == "DITHERED"
    assert registered.eevee.taa_render_samples == render_setup.EEVEE_SAMPLES
    assert kinds(registered) == []
    registered.camera.data.dof.use_dof = False
    bpy.ops.physhdr.render_setup()
    assert splat.surface_render_method == "BLENDED"


def test_grain_is_told_of_ellipsoids_alone(room, registered):
    registered.render.engine = "BLENDER_EEVEE"
    bpy.ops.physhdr.render_setup()
    registered.eevee.taa_render_samples = 1
    assert kinds(registered) == []
    room[render_setup.ELLIPSOIDS] = True
    nodes.set_input(nodes.find_modifier(room), nodes.CAMERA_SPLATS, False)
    assert kinds(registered) == ["SAMPLES"]


def test_shadows_are_no_problem_where_nothing_casts_them(room, registered):
    bpy.ops.physhdr.render_setup()
    shadows(registered, room)
    assert kinds(registered) == ["SHADOWS"]
    bpy.data.objects["Lamp"].data.use_shadow = False
    assert kinds(registered) == []
    registered.world = bpy.data.worlds.new("sky")
    registered.world.node_tree.nodes.new("ShaderNodeTexSky")
    assert kinds(registered) == ["SHADOWS"]
    registered.render.engine = "CYCLES"
    assert kinds(registered) == []


def test_a_scene_without_a_camera_says_so(room, registered):
    bpy.ops.physhdr.render_setup()
    bpy.data.objects.remove(registered.camera)
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == ("CAMERA", False)


def test_a_model_without_its_modifier_cannot_be_mended(room, registered):
    bpy.ops.physhdr.render_setup()
    room.modifiers.clear()
    bpy.ops.physhdr.render_setup()
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == ("MODIFIER", False)


def test_ellipsoids_on_purpose_are_no_problem(room, registered):
    bpy.ops.physhdr.render_setup(camera_splats=False)
    assert not value(room, nodes.CAMERA_SPLATS)
    assert kinds(registered) == []
    bpy.ops.physhdr.render_setup()
    assert value(room, nodes.CAMERA_SPLATS)
    ellipsoids(registered, room)
    assert kinds(registered) == ["SPLATS"]  # the purpose was forgotten with the next wish


def test_hidden_models_are_no_problem_and_instances_are_one(room, registered):
    assert kinds(registered)
    room.hide_render = True
    assert kinds(registered) == []
    room.hide_render = False
    apart = bpy.data.collections.new("apart")
    registered.collection.children.link(apart)
    apart.objects.link(room)
    registered.collection.objects.unlink(room)
    assert kinds(registered)
    apart.hide_render = True
    assert kinds(registered) == []
    apart.hide_render = False
    registered.view_layers[0].layer_collection.children["apart"].exclude = True
    assert kinds(registered) == []
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", apart
    registered.collection.objects.link(instance)
    assert render_setup.models_in_render(registered) == [room]
    bpy.ops.physhdr.render_setup()
    assert kinds(registered) == []


@pytest.mark.parametrize("nested", [False, True])
def test_models_that_an_instance_shows_elsewhere_are_told_and_get_no_cards(room, registered, nested):
    """Nodes are evaluated where the model itself stands: its cards face the camera as seen from there."""
    bpy.ops.physhdr.render_setup()
    kept = bpy.data.collections.new("kept")
    kept.objects.link(room)
    registered.collection.objects.unlink(room)
    if nested:
        inner = bpy.data.objects.new("inner", None)
        inner.instance_type, inner.instance_collection = "COLLECTION", kept
        kept = bpy.data.collections.new("outer")
        kept.objects.link(inner)
    kept.instance_offset = (1.0, 2.0, 0.0)
    holder = bpy.data.objects.new("holder", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", kept
    registered.collection.objects.link(holder)
    holder.rotation_euler.z = math.pi
    holder.location = (-1.0, -2.0, 0.0)  # where the offset is turned to
    bpy.context.view_layer.update()
    first, second = render_setup.render_problems(registered)
    assert "Make Instances Real" in first.text and not first.fixable
    assert "do not face the camera" in second.text and second.fixable
    bpy.ops.physhdr.render_setup()
    assert not value(room, nodes.CAMERA_SPLATS)
    (left,) = render_setup.render_problems(registered)
    assert left == first
    holder.rotation_euler.z, holder.location = 0.0, (1.0, 2.0, 0.0)  # where the model stands
    bpy.context.view_layer.update()
    bpy.ops.physhdr.render_setup()
    assert kinds(registered) == [] and value(room, nodes.CAMERA_SPLATS)


def test_a_stretched_model_is_told(room, registered):
    bpy.ops.physhdr.render_setup()
    room.scale = (1.0, -1.0, 1.0)
    bpy.context.view_layer.update()
    assert kinds(registered) == []
    room.scale.z = 1.1
    bpy.context.view_layer.update()
    (problem,) = render_setup.render_problems(registered)
    assert "stretched" in problem.text and not problem.fixable


def test_older_imports_cast_no_shadow_after_set_up_unless_it_is_wished(room, registered):
    room.visible_shadow = True
    bpy.ops.physhdr.render_setup(cast_shadows=True)
    assert room.visible_shadow
    bpy.ops.physhdr.render_setup()
    assert not room.visible_shadow


def test_the_picture_after_set_up_is_the_exact_one(room, registered, tmp_path):
    """From Blender's defaults to what ``prepare_cycles`` renders, whose picture is proven elsewhere."""
    render.set_resolution(registered, SIZE, SIZE)
    registered.cycles.samples = 1
    bpy.ops.physhdr.render_setup(film_transparent=True, exact=True)
    render.render_exr(registered, tmp_path / "set_up.exr")
    nodes.set_input(nodes.find_modifier(room), nodes.IMAGE_WIDTH, SIZE)
    render.prepare_cycles(registered)
    render.render_exr(registered, tmp_path / "exact.exr")
    given, wanted = (render.read_exr(tmp_path / f"{name}.exr").astype(float) for name in ("set_up", "exact"))
    assert wanted[..., 3].max() > 0.5
    error = np.square(given - wanted).mean()
    assert error == 0.0 or 10.0 * math.log10(wanted.max() ** 2 / error) > 80.0


ENGINES = """
import sys
import time
from pathlib import Path
import bpy, gpu
try:
    gpu.init()
except (RuntimeError, SystemError) as error:
    sys.exit(f"no EEVEE here: {error}")
import numpy as np
from physhdr.addon.model import model_import
from physhdr.addon.rendering import render, render_setup

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
model_import.import_model(sys.argv[1])
render.add_camera(scene, np.array(eval(sys.argv[3])), 0.7)
render.set_resolution(scene, 40, 40)
sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
scene.collection.objects.link(sun)
scene.cycles.samples = scene.eevee.taa_render_samples = 1
render_setup.set_up(scene, render_setup.Wishes(film_transparent=True, exact=True))
for engine in (render_setup.CYCLES, render_setup.EEVEE):
    scene.render.engine = engine
    assert render_setup.render_problems(scene) == []
    render.render_exr(scene, Path(sys.argv[2]) / f"{engine}.exr")
"""


def both_engines(program: str, model, out, *more: str) -> list[np.ndarray]:
    """What the program rendered with Cycles and with EEVEE, ``[H, W, 4]`` each."""
    arguments = [sys.executable, "-c", program, str(model), str(out), *more]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if "no EEVEE here" in done.stderr:
        pytest.skip(done.stderr.strip())
    assert done.returncode == 0, done.stderr
    names = (render_setup.CYCLES, render_setup.EEVEE)
    return [render.read_exr(out / f"{name}.exr").astype(float) for name in names]


def srgb(linear: np.ndarray) -> np.ndarray:
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


@pytest.mark.long
def test_both_engines_agree_after_set_up_beside_a_sun(make_model, write, look_at, tmp_path):
    """60 overlapping Gaussians over six stops, one sample: what is left are EEVEE's 16 bit."""
    pose = repr(look_at(2.0, -3.0, 1.5).tolist())
    cycles, eevee = both_engines(ENGINES, write(make_model(count=60, seed=5)), tmp_path, pose)
    assert cycles[..., 3].max() > 0.5
    for shown in (srgb, lambda x: x / cycles.max()):
        error = np.square(shown(cycles) - shown(eevee)).mean()
        assert -10.0 * math.log10(error) > 50.0
    np.testing.assert_allclose(eevee.mean(axis=(0, 1)), cycles.mean(axis=(0, 1)), rtol=5e-3)
