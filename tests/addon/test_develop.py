# SPDX-License-Identifier: GPL-3.0-or-later
"""Develop as Photographed: the response of what was blended, before the compositor's output and taken out."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np
import pytest

from physhdr.bridge import srgb
from physhdr.bridge.errors import BadValueError

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import model_import, nodes, response_nodes  # noqa: E402
from physhdr.addon.rendering import (  # noqa: E402
    cg_compositor,
    develop,
    render,
    render_setup,
)

SIZE = 48
#: ln(radiance) of the response's first and last entry.
LOW, HIGH = -12.0, 8.0
SLOPES = np.array([0.7, 1.0, 1.3])


def code(radiance: np.ndarray, shift: float = 0.0) -> np.ndarray:
    """The camera's response in closed form: what the models' samples are taken from."""
    x = np.clip(np.log(np.maximum(radiance, 1e-30)), LOW, HIGH)
    return 1.0 / (1.0 + np.exp(-SLOPES * x - shift))


def response(shift: float = 0.0) -> dict[str, np.ndarray]:
    """Fields of a model with that response."""
    x = np.linspace(LOW, HIGH, 256, dtype=np.float32)
    return {
        "tone_curve_log_exposure": x,
        "tone_curve": code(np.exp(x.astype(float))[:, None], shift).astype(np.float32),
    }


@pytest.fixture
def add(make_model, write):
    """Imports a model with a response: of 40 overlapping Gaussians, or the one that is given."""

    def add(model=None, shift: float = 0.0, **fields):
        model = dataclasses.replace(model or make_model(), **response(shift), **fields)
        return model_import.import_model(write(model))

    return add


@pytest.fixture
def room(registered, add, look_at):
    """A camera before a model with a response, set up to render it exactly."""
    target = add()
    render.add_camera(registered, look_at(2.0, -3.0, 1.5), 0.7)
    ready(registered)
    return target


def ready(scene) -> None:
    render.set_resolution(scene, SIZE, SIZE)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    bpy.ops.physhdr.render_setup(film_transparent=True, exact=True)


@pytest.fixture
def picture(registered, tmp_path):
    """Renders: ``[H, W, 4]`` of a float EXR, of the compositor where there is one."""

    def picture() -> np.ndarray:
        render.render_exr(registered, tmp_path / "picture.exr")
        return render.read_exr(tmp_path / "picture.exr").astype(float)

    return picture


def expected(plain: np.ndarray, exposure: float = 1.0, over_black: bool = False) -> np.ndarray:
    """The developed picture of an undeveloped one, premultiplied and scene-linear, in numpy."""
    alpha = plain[..., 3:]
    if over_black:
        return np.concatenate([srgb.to_linear(code(plain[..., :3] * exposure)), np.ones_like(alpha)], -1)
    straight = plain[..., :3] / np.maximum(alpha, 1e-6)
    return np.concatenate([alpha * srgb.to_linear(code(straight * exposure)), alpha], axis=-1)


def difference(given: np.ndarray, wanted: np.ndarray) -> float:
    """The greatest of colours, in sRGB codes of the premultiplied picture, and of alpha."""
    codes = np.abs(srgb.to_srgb(given[..., :3]) - srgb.to_srgb(wanted[..., :3]))
    return max(codes.max(), np.abs(given[..., 3] - wanted[..., 3]).max())


def inputs_of(scene):
    return develop.node_of(scene).inputs


def tree_of(scene) -> list[tuple[str, ...]]:
    """The scene's compositor: its nodes with their places, and its links."""
    tree = scene.compositing_node_group
    if tree is None:
        return []
    links = sorted(
        (x.from_node.name, x.from_socket.name, x.to_node.name, x.to_socket.name) for x in tree.links
    )
    return [*sorted((node.name, node.type, str(tuple(node.location))) for node in tree.nodes), *links]


def kinds(scene) -> list[str]:
    return [problem.kind for problem in render_setup.render_problems(scene)]


def toned(target) -> bool:
    return nodes.get_input(nodes.find_modifier(target), nodes.TONE_MAPPER)


def users_tree(scene):
    """A compositor of the user's own: the picture, twice as bright, and another output beside."""
    tree = bpy.data.node_groups.new("mine", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layer, gain = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeExposure")
    output, viewer = tree.nodes.new("NodeGroupOutput"), tree.nodes.new("CompositorNodeViewer")
    gain.inputs["Exposure"].default_value = 1.0
    output.location = (400.0, 10.0)
    tree.links.new(layer.outputs["Image"], gain.inputs["Image"])
    tree.links.new(gain.outputs["Image"], output.inputs[0])
    tree.links.new(gain.outputs["Image"], viewer.inputs[0])
    scene.compositing_node_group = tree
    return tree


# ---- the picture -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("over_black", [False, True])
def test_the_picture_is_the_response_of_what_was_blended(room, registered, picture, over_black):
    """Six stops of overlapping Gaussians, and pixels where nothing is, at three exposures."""
    plain = picture()
    assert plain[..., 3].max() > 0.9 and plain[..., 3].min() == 0.0
    bpy.ops.physhdr.develop_render()
    inputs_of(registered)["Over Black"].default_value = over_black
    for stops in (0.0, -4.0, 3.5):
        inputs_of(registered)["Exposure (EV)"].default_value = stops
        assert difference(picture(), expected(plain, 2.0**stops, over_black)) < 1e-3


def test_a_picture_file_has_the_codes(room, registered, picture, tmp_path):
    """An 8-bit PNG in the view that the button sets: the response itself, rounded."""
    plain = picture()
    assert registered.view_settings.view_transform == "AgX"
    bpy.ops.physhdr.develop_render()
    inputs_of(registered)["Over Black"].default_value = True
    settings = registered.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGB", "8"
    registered.render.dither_intensity = 0.0
    registered.render.filepath = str(tmp_path / "picture.png")
    bpy.ops.render.render(write_still=True)
    shown = render.read_exr(tmp_path / "picture.png")[..., :3].astype(float)
    assert np.abs(shown - code(plain[..., :3])).max() < 0.5 / 255 + 1e-3


@pytest.fixture
def two(registered, add, make_model, look_at):
    """A dim red veil before a bright blue wall, 9 stops apart, in the middle of the picture."""
    sh = np.zeros((2, 4, 3), np.float32)
    sh[:, 0] = np.log([[0.5, 0.02, 0.02], [2.0, 4.0, 10.0]]) / 0.28209479
    model = dataclasses.replace(
        make_model(count=2),
        position=np.array([[0.0, -0.5, 0.0], [0.0, 0.5, 0.0]], np.float32),
        rotation=np.array([[1.0, 0.0, 0.0, 0.0]] * 2, np.float32),
        scale=np.full((2, 3), 0.4, np.float32),
        opacity=np.array([0.6, 0.99], np.float32),
        log_radiance_sh=sh,
    )
    target = add(model)
    render.add_camera(registered, look_at(0.0, -4.0, 0.0), 0.5)
    ready(registered)
    return target


def test_two_gaussians_are_blended_first(two, registered, picture):
    """In the middle: 0.6 of the veil and 0.4 · 0.99 of the wall, in numpy. Learned Tones blends codes."""
    veil, wall = np.array([0.5, 0.02, 0.02]), np.array([2.0, 4.0, 10.0])
    wanted = code(0.6 * veil + 0.4 * 0.99 * wall)
    blended = srgb.to_srgb(0.6 * srgb.to_linear(code(veil)) + 0.4 * 0.99 * srgb.to_linear(code(wall)))
    assert np.abs(wanted - blended).max() > 0.1  # else this tells nothing
    middle = SIZE // 2

    def colour() -> np.ndarray:
        return srgb.to_srgb(picture()[middle, middle, :3])

    nodes.set_input(nodes.find_modifier(two), nodes.TONE_MAPPER, True)
    np.testing.assert_allclose(colour(), blended, atol=0.01)  # the pixel's centre is half a pixel aside
    bpy.ops.physhdr.develop_render()
    inputs_of(registered)["Over Black"].default_value = True
    np.testing.assert_allclose(colour(), wanted, atol=0.01)


def test_the_exposure_can_be_keyframed(room, registered, picture):
    """From 0 to 2 stops in two frames: between them 1 stop."""
    plain = picture()
    bpy.ops.physhdr.develop_render()
    socket = inputs_of(registered)["Exposure (EV)"]
    for frame, stops in ((1, 0.0), (3, 2.0)):
        socket.default_value = stops
        socket.keyframe_insert("default_value", frame=frame)
    for frame, stops in ((1, 0.0), (2, 1.0), (3, 2.0)):
        registered.frame_set(frame)
        assert difference(picture(), expected(plain, 2.0**stops)) < 1e-3
    bpy.ops.physhdr.develop_render(remove=True)
    assert difference(picture(), plain) == 0.0


def test_users_nodes_come_before_the_response(room, registered, picture):
    """Twice as bright by a node of theirs, then developed; their viewer keeps what it had."""
    plain = picture()
    tree = users_tree(registered)
    before = tree_of(registered)
    bpy.ops.physhdr.develop_render()
    assert difference(picture(), expected(plain, 2.0)) < 1e-3
    viewer = next(node for node in tree.nodes if node.type == "VIEWER")
    assert viewer.inputs[0].links[0].from_node.type == "EXPOSURE"
    bpy.ops.physhdr.develop_render(remove=True)
    assert registered.compositing_node_group == tree
    assert tree_of(registered) == before


def test_other_objects_are_developed_alike(room, registered, picture):
    """A glowing plate beside the model."""
    bpy.ops.mesh.primitive_plane_add(size=0.5, location=(0.8, 0.3, 0.0), rotation=(1.2, 0.0, 0.6))
    glow = bpy.data.materials.new("glow")
    shader, surface = glow.node_tree.nodes.new("ShaderNodeEmission"), glow.node_tree.nodes["Material Output"]
    shader.inputs["Color"].default_value, shader.inputs["Strength"].default_value = (0.2, 0.5, 1.0, 1.0), 3.0
    glow.node_tree.links.new(shader.outputs[0], surface.inputs[0])
    bpy.context.object.data.materials.append(glow)
    bpy.context.view_layer.objects.active = room
    plain = picture()
    plate = np.abs(plain[..., :3] - [0.6, 1.5, 3.0]).max(axis=-1) < 1e-4
    assert plate.sum() > 20
    bpy.ops.physhdr.develop_render()
    developed = picture()
    assert difference(developed, expected(plain)) < 1e-3
    np.testing.assert_allclose(
        srgb.to_srgb(developed[plate][:, :3]),
        np.tile(code(np.array([0.6, 1.5, 3.0])), (plate.sum(), 1)),
        atol=1e-3,
    )


# ---- in and out --------------------------------------------------------------------------------------------


def test_run_twice_is_the_same_as_once(room, registered):
    bpy.ops.physhdr.develop_render()
    inputs_of(registered)["Exposure (EV)"].default_value = 1.5
    once, groups = tree_of(registered), len(bpy.data.node_groups)
    bpy.ops.physhdr.develop_render()
    assert (tree_of(registered), len(bpy.data.node_groups)) == (once, groups)
    assert inputs_of(registered)["Exposure (EV)"].default_value == 1.5


@pytest.mark.parametrize("compositing", [True, False])
def test_removal_restores(room, registered, compositing):
    """The compositor, the view, the switch of the model, and nothing of ours is left in the file."""
    view = registered.view_settings
    view.view_transform, view.look = "AgX", "AgX - Punchy"
    view.exposure, view.use_curve_mapping = 0.5, True
    registered.render.use_compositing = compositing
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    groups = set(bpy.data.node_groups)
    bpy.ops.physhdr.develop_render()
    assert (view.view_transform, view.look, view.exposure, view.use_curve_mapping) == (
        "Standard",
        "None",
        0.0,
        False,
    )
    assert not toned(room) and registered.render.use_compositing
    assert kinds(registered) == []
    bpy.ops.physhdr.develop_render()  # what is remembered is from before the first
    bpy.ops.physhdr.develop_render(remove=True)
    assert (view.view_transform, view.look, view.use_curve_mapping) == ("AgX", "AgX - Punchy", True)
    assert view.exposure == pytest.approx(0.5) and view.gamma == 1.0
    assert toned(room) and registered.render.use_compositing == compositing
    assert registered.compositing_node_group is None
    assert set(bpy.data.node_groups) == groups
    assert develop.SWITCHED_OFF not in room


def test_a_view_that_was_chosen_since_stays(room, registered):
    bpy.ops.physhdr.develop_render()
    registered.view_settings.view_transform = "Filmic"
    bpy.ops.physhdr.develop_render(remove=True)
    assert registered.view_settings.view_transform == "Filmic"


def test_it_can_be_undone(room, registered):
    name = room.name
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    bpy.context.preferences.edit.use_global_undo = True
    users_tree(registered)
    before = tree_of(registered)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.physhdr.develop_render()
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert develop.node_of(scene) is None and tree_of(scene) == before
    assert toned(bpy.data.objects[name]) and scene.view_settings.view_transform == "AgX"
    bpy.ops.ed.redo()
    assert develop.node_of(bpy.context.scene) is not None and not toned(bpy.data.objects[name])


def test_one_response_for_the_picture_the_active_models(room, registered, add, picture):
    """Of two models with different responses; the node keeps its exposure and its keyframes."""
    other = add(shift=1.0)
    other.location = (0.5, 0.0, 0.0)
    bpy.ops.physhdr.render_setup()
    plain = picture()
    bpy.context.view_layer.objects.active = room
    bpy.ops.physhdr.develop_render()
    socket = inputs_of(registered)["Exposure (EV)"]
    socket.default_value = 1.0
    socket.keyframe_insert("default_value", frame=1)
    assert difference(picture(), expected(plain, 2.0)) < 1e-3
    node = develop.node_of(registered)
    assert develop.has_response_of(node, room) and not develop.has_response_of(node, other)
    bpy.context.view_layer.objects.active = other
    bpy.ops.physhdr.develop_render()
    assert develop.has_response_of(node, other) and not develop.has_response_of(node, room)
    straight = plain[..., :3] / np.maximum(plain[..., 3:], 1e-6)
    wanted = plain[..., 3:] * srgb.to_linear(code(2.0 * straight, 1.0))
    assert difference(picture(), np.concatenate([wanted, plain[..., 3:]], axis=-1)) < 1e-3
    groups = [each for each in bpy.data.node_groups if response_nodes.MARK in each]
    assert [each.name for each in groups] == [f"PhysHDR Response of {other.name}"]


def test_a_model_without_a_response_is_no_camera(registered, make_model, write, look_at):
    target = model_import.import_model(write(make_model()))
    assert not bpy.ops.physhdr.develop_render.poll()
    with pytest.raises(Exception, match="no learned response") as caught:
        develop.develop(registered, target, [target])
    assert caught.value.hint
    assert registered.compositing_node_group is None


def test_a_compositor_that_puts_nothing_out_is_left_alone(room, registered):
    tree = users_tree(registered)
    output = next(node for node in tree.nodes if node.type == "GROUP_OUTPUT")
    tree.links.remove(output.inputs[0].links[0])
    before, groups = tree_of(registered), len(bpy.data.node_groups)
    with pytest.raises(RuntimeError, match=r"'mine' put no picture out[\s\S]*Link a picture"):
        bpy.ops.physhdr.develop_render()
    assert (tree_of(registered), len(bpy.data.node_groups)) == (before, groups)


def state_of(scene, target) -> list:
    """What a refused development must leave: nodes, their labels and groups, the view, size and switches."""
    tree, view = scene.compositing_node_group, develop.view_of(scene)
    return [
        tree_of(scene),
        [] if tree is None else [(each.label, getattr(each, "node_tree", None)) for each in tree.nodes],
        set(bpy.data.node_groups),
        [getattr(view, name) for name in develop.NEUTRAL],
        (scene.render.use_compositing, scene.render.film_transparent, scene.cycles.transparent_max_bounces),
        toned(target),
    ]


def test_a_node_that_takes_no_picture_is_left_alone(room, registered, add):
    other = add(shift=1.0)
    bpy.context.view_layer.objects.active = room
    bpy.ops.physhdr.develop_render()
    inputs = inputs_of(registered)
    registered.compositing_node_group.links.remove(inputs["Image"].links[0])
    before = state_of(registered, room)
    with pytest.raises(BadValueError, match="takes no picture"):
        develop.develop(registered, other, [room, other])
    assert state_of(registered, room) == before


@pytest.mark.parametrize("developed", [False, True])
def test_without_the_standard_view_nothing_is_changed_and_the_remedy_told(
    room, registered, monkeypatch, developed
):
    """As in a configuration of colours without it: a name that Blender takes no more than any unknown."""
    if developed:
        bpy.ops.physhdr.develop_render()
    registered.view_settings.view_transform, registered.render.use_compositing = "AgX", False
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    registered.render.film_transparent, registered.cycles.transparent_max_bounces = False, 9
    monkeypatch.setitem(develop.NEUTRAL, "view_transform", "Not There")
    before = state_of(registered, room)
    for operator in (bpy.ops.physhdr.develop_render, bpy.ops.physhdr.render_setup)[: 1 + developed]:
        with pytest.raises(
            RuntimeError, match=r"no view transform 'Not There'[\s\S]*without the variable OCIO"
        ):
            operator()
        assert state_of(registered, room) == before
    with pytest.raises(BadValueError) if developed else contextlib.nullcontext():
        develop.settle(registered, [room])
    assert state_of(registered, room) == before


def test_a_view_that_is_there_no_more_is_not_given_back(room, registered):
    bpy.ops.physhdr.develop_render()
    develop.node_of(registered)["view"]["view_transform"] = "Not There"
    bpy.ops.physhdr.develop_render(remove=True)
    assert develop.node_of(registered) is None
    assert registered.view_settings.view_transform == "Standard"


# ---- beside the shadow of Put CG Here ----------------------------------------------------------------------


@pytest.mark.parametrize("order", ["cg first", "cg last"])
@pytest.mark.parametrize("leaves", ["cg first", "cg last"])
def test_the_shadow_of_cg_comes_before_it_and_either_goes_first(room, registered, order, leaves):
    layers = [registered.view_layers[0].name, "shadow", "front"]
    for name in layers[1:]:
        registered.view_layers.new(name)
    steps = {
        "cg": lambda: cg_compositor.connect(registered, layers[0], layers[1], layers[2]),
        "ours": bpy.ops.physhdr.develop_render,
    }
    for step in ("cg", "ours") if order == "cg first" else ("ours", "cg"):
        steps[step]()
    node = develop.node_of(registered)
    assert node.inputs["Image"].links[0].from_node.get(cg_compositor.MARK) == cg_compositor.NODE
    assert node.outputs[0].links[0].to_node.type == "GROUP_OUTPUT"
    steps = {
        "cg": lambda: cg_compositor.disconnect(registered),
        "ours": lambda: bpy.ops.physhdr.develop_render(remove=True),
    }
    for step in ("cg", "ours") if leaves == "cg first" else ("ours", "cg"):
        steps[step]()
    assert registered.compositing_node_group is None
    assert not [each for each in bpy.data.node_groups if each.bl_idname == "CompositorNodeTree"]


# ---- what the panel warns of -------------------------------------------------------------------------------


def test_learned_tones_are_told_and_by_whom_they_are_mended(room, registered):
    assert kinds(registered) == []
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == ("TONES", False)
    assert "before blending" in problem.text and develop.LABEL in problem.text
    bpy.ops.physhdr.develop_render()
    assert kinds(registered) == []
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == ("TONES", True)
    assert "twice" in problem.text
    bpy.ops.physhdr.render_setup()
    assert kinds(registered) == [] and not toned(room)


@pytest.mark.parametrize("first", [0, 1])
def test_a_linked_copy_of_the_scene_stays_developed_once(room, registered, first):
    """It has a compositor of its own, and the same model: its switch comes back with the last of the two."""
    nodes.set_input(nodes.find_modifier(room), nodes.TONE_MAPPER, True)
    bpy.ops.physhdr.develop_render()
    bpy.ops.scene.new(type="LINK_COPY")
    scenes = [registered, bpy.context.scene]
    assert scenes[0].compositing_node_group != scenes[1].compositing_node_group and not toned(room)
    bpy.context.window.scene = scenes[first]
    bpy.ops.physhdr.develop_render(remove=True)
    assert not toned(room) and kinds(scenes[1 - first]) == [] and develop.node_of(scenes[1 - first])
    bpy.context.window.scene = scenes[1 - first]
    bpy.ops.physhdr.develop_render(remove=True)
    assert toned(room)


def test_keyframes_of_the_switch_stay_and_are_told(room, registered):
    modifier = nodes.find_modifier(room)
    nodes.set_input(modifier, nodes.TONE_MAPPER, True)
    room.keyframe_insert(nodes.input_data_path(modifier, nodes.TONE_MAPPER), frame=1)
    bpy.ops.physhdr.develop_render()
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable, toned(room)) == ("TONES", False, True)


@pytest.mark.parametrize(
    ("spoil", "kind", "says"),
    [
        (lambda scene: setattr(scene.view_settings, "view_transform", "AgX"), "VIEW", "view transform AgX"),
        (lambda scene: setattr(scene.view_settings, "exposure", 1.0), "VIEW", "exposure 1"),
        (lambda scene: setattr(scene.render, "use_compositing", False), "DEVELOP", "switched off"),
        (lambda scene: setattr(develop.node_of(scene), "mute", True), "DEVELOP", "switched off"),
    ],
)
def test_what_spoils_a_developed_picture_is_told_and_mended(room, registered, spoil, kind, says):
    bpy.ops.physhdr.develop_render()
    spoil(registered)
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == (kind, True) and says in problem.text
    bpy.ops.physhdr.render_setup()
    assert render_setup.render_problems(registered) == []


def test_a_node_that_lost_its_links_is_put_back(room, registered, picture):
    plain = picture()
    bpy.ops.physhdr.develop_render()
    tree, node = registered.compositing_node_group, develop.node_of(registered)
    layer = next(each for each in tree.nodes if each.type == "R_LAYERS")
    output = next(each for each in tree.nodes if each.type == "GROUP_OUTPUT")
    tree.links.new(layer.outputs["Image"], output.inputs[0])
    (problem,) = render_setup.render_problems(registered)
    assert (problem.kind, problem.fixable) == ("DEVELOP", False)
    bpy.ops.physhdr.develop_render()
    assert develop.node_of(registered) == node and kinds(registered) == []
    assert difference(picture(), expected(plain)) < 1e-3
