# SPDX-License-Identifier: GPL-3.0-or-later
"""*Put CG Here*: the shadow on splats against integrals of the sky, order by depth, and nothing left behind.

A black ball hangs over a floor that is one Gaussian, under a sky that is even in red and rises with the
height in green; a Gaussian hangs before the shadow, another one behind the ball. Then under a probe of a
small bright lamp. And the tool that measures a shadow takes no noise for one.
"""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from mathutils import Vector  # noqa: E402

from physhdr.addon.light import cg  # noqa: E402
from physhdr.addon.model import attributes, model_import, nodes  # noqa: E402
from physhdr.addon.model.look import is_model  # noqa: E402
from physhdr.addon.model.point_cloud import write_attribute  # noqa: E402
from physhdr.addon.operators import cg as operators  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402
from physhdr.bridge.errors import DataMismatchError  # noqa: E402
from physhdr.bridge.model_file import Model  # noqa: E402
from physhdr.bridge.panorama import directions as panorama_directions  # noqa: E402
from physhdr.bridge.panorama import solid_angles  # noqa: E402
from physhdr.bridge.probe import Probe, begin, finish  # noqa: E402
from physhdr.synth import exr  # noqa: E402

SIZE, ANGLE = 40, 0.7
BALL, RADIUS = np.array([0.0, 0.0, 0.55]), 0.4
#: x, y, z, deviations, opacity, radiance: the floor, one before its shadow, one behind the ball.
SPLATS = (
    ((0.0, 0.0, 0.0), (60.0, 60.0, 5e-4), 0.995, (0.6, 0.3, 0.2)),
    ((0.2, -0.9, 0.78), (0.12, 0.12, 0.12), 0.8, (0.1, 0.9, 0.4)),
    ((-0.1, 1.2, 0.5), (0.25, 0.25, 0.25), 0.9, (5.0, 5.0, 5.0)),
)


@pytest.fixture
def extension(scene):
    """The extension's classes, registered."""
    from physhdr import addon

    addon.register()
    yield scene
    addon.unregister()


@pytest.fixture
def capture(scene, write):
    """The three Gaussians, imported, and a camera; gives the scene."""
    position, scale, opacity, radiance = (np.array(each, np.float32) for each in zip(*SPLATS, strict=True))
    model = Model(
        position=position,
        rotation=np.tile(np.float32([1.0, 0.0, 0.0, 0.0]), (len(SPLATS), 1)),
        scale=scale,
        opacity=opacity,
        log_radiance_sh=np.log(radiance)[:, None] * np.float32(2.0 * math.sqrt(math.pi)),
        light_share=np.full((len(SPLATS), 1, 3), 0.5, np.float32),
        lights=("ambient",),
        exposures=(1.0,),
        metadata={},
    )
    target = model_import.import_model(str(write(model)))
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(target, f"visible_{ray}", False)
    return scene


def pose(look_at) -> np.ndarray:
    placed = look_at(0.0, -4.0, 2.4)
    return placed


@pytest.fixture
def draw(look_at, tmp_path):
    """Renders the scene: ``[SIZE, SIZE, 4]`` float64."""

    def draw(scene) -> np.ndarray:
        render.prepare_cycles(scene)
        render.set_resolution(scene, SIZE, SIZE)
        scene.render.compositor_device = "CPU"
        if scene.camera is None:
            render.add_camera(scene, pose(look_at), ANGLE)
        render.render_exr(scene, tmp_path / "picture.exr")
        return render.read_exr(tmp_path / "picture.exr").astype(np.float64)

    return draw


def add_sky(scene) -> None:
    """Radiance 1 in red, the sine of the elevation in green, blue 0.25; below the horizon nothing."""
    world = bpy.data.worlds.new("sky")
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 128
    scene.world = world
    tree = world.node_tree
    tree.nodes.clear()
    add, link = tree.nodes.new, tree.links.new
    direction, split = add("ShaderNodeTexCoord"), add("ShaderNodeSeparateXYZ")
    colour, background = add("ShaderNodeCombineColor"), add("ShaderNodeBackground")
    link(direction.outputs["Generated"], split.inputs[0])
    link(split.outputs["Z"], colour.inputs["Green"])
    colour.inputs["Red"].default_value, colour.inputs["Blue"].default_value = 1.0, 0.25
    link(colour.outputs[0], background.inputs["Color"])
    path, mix = add("ShaderNodeLightPath"), add("ShaderNodeMixShader")
    link(path.outputs["Is Camera Ray"], mix.inputs[0])
    link(background.outputs[0], mix.inputs[1])
    link(mix.outputs[0], add("ShaderNodeOutputWorld").inputs["Surface"])


def add_ball(scene):
    mesh = bpy.data.meshes.new("ball")
    import bmesh

    made = bmesh.new()
    bmesh.ops.create_icosphere(made, subdivisions=6, radius=RADIUS)
    made.to_mesh(mesh)
    made.free()
    black = bpy.data.materials.new("black")
    black.node_tree.nodes.clear()
    emission = black.node_tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 0.0
    output = black.node_tree.nodes.new("ShaderNodeOutputMaterial")
    black.node_tree.links.new(emission.outputs[0], output.inputs[0])
    mesh.materials.append(black)
    ball = bpy.data.objects.new("ball", mesh)
    ball.location = BALL
    scene.collection.objects.link(ball)
    return ball


def rays(look_at) -> tuple[np.ndarray, np.ndarray]:
    """The camera's place [3] and unit directions [SIZE, SIZE, 3] through the middles of pixels."""
    placed = pose(look_at)
    half = math.tan(ANGLE / 2.0)
    x, y = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0, 1.0 - (np.arange(SIZE) + 0.5) / SIZE * 2.0)
    local = np.stack([x * half, y * half, -np.ones_like(x)], -1)
    directions = local @ placed[:3, :3].T
    return placed[:3, 3], directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def alpha_of(index: int, eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Of a Gaussian for rays, at its densest along each: [SIZE, SIZE]."""
    centre, deviations, opacity, _ = SPLATS[index]
    offset, heading = (np.array(centre) - eye) / deviations, directions / np.array(deviations)
    along = heading @ offset / np.square(heading).sum(-1)
    nearest = offset - along[..., None] * heading
    alpha = opacity * np.exp(-0.5 * np.square(nearest).sum(-1))
    return np.where(alpha > 1.0 / 255.0, alpha, 0.0)


def light_ratio(points: np.ndarray) -> np.ndarray:
    """[N, 3]: the irradiance on a floor at points [N, 3] with the ball over that without: sums over the sky.

    Directions are spread by a Fibonacci lattice with density ∝ cosine, so that red is a mere count.
    """
    count = 20_000
    k = np.arange(count) + 0.5
    sine = np.sqrt(k / count)
    azimuth = k * math.pi * (3.0 - math.sqrt(5.0))
    sky = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.sqrt(1.0 - sine**2)], -1)
    return left_by_ball(points, sky, np.stack([np.ones(count), sky[:, 2], np.ones(count)], -1))


def left_by_ball(points: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[N, C]: the share of the light from directions [K, 3] with weights [K, C] that passes the ball."""
    ratios = []
    for point in points:
        offset = BALL - point
        along = sky @ offset
        free = (along <= 0.0) | (offset @ offset - along**2 > RADIUS**2)
        ratios.append(weights[free].sum(0) / weights.sum(0))
    return np.array(ratios)


def expected(look_at) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The picture, S, where the ball or its edge is, and where the ball is all: [SIZE, SIZE, …]."""
    eye, directions = rays(look_at)
    flat = directions.reshape(-1, 3)
    down = flat[:, 2] < -1e-3
    points = eye + flat * np.where(down, -eye[2] / np.where(down, flat[:, 2], -1.0), 0.0)[:, None]
    ratio = np.where(down[:, None], light_ratio(points), 1.0).reshape(SIZE, SIZE, 3)
    offset = BALL - eye
    beside = np.sqrt(np.maximum(offset @ offset - (directions @ offset) ** 2, 0.0))
    ball = beside < RADIUS
    edge = np.abs(beside - RADIUS) < 0.012 * np.linalg.norm(offset)
    floor, front, behind = (alpha_of(k, eye, directions)[..., None] for k in range(3))
    radiance = [np.array(splat[3]) for splat in SPLATS]
    back = np.where(ball[..., None], 0.0, behind * radiance[2] + (1.0 - behind) * floor * ratio * radiance[0])
    return front * radiance[1] + (1.0 - front) * back, ratio, ball | edge, ball & ~edge


def decibels(picture: np.ndarray, truth: np.ndarray) -> float:
    return 10.0 * math.log10(1.0 / np.square(picture - truth).mean())


def test_shadow_and_order_are_right_by_numbers(capture, draw, look_at):
    """Of every pixel: the floor under the sky that the ball leaves, through what is in front."""
    add_sky(capture)
    without = draw(capture)
    add_ball(capture)
    plain = draw(capture)
    cg.put(capture, bpy.context.view_layer, Vector((0.0, 0.0, 0.0)), size=8.0)
    capture.view_layers[cg.SHADOW_LAYER].samples = 512
    picture = draw(capture)

    truth, ratio, ball, inside = expected(look_at)
    eye, directions = rays(look_at)
    behind = alpha_of(2, eye, directions)
    floor = ~ball & (behind == 0.0)
    shaded = floor & (ratio.min(-1) < 0.9)
    assert shaded.sum() > 40 and ratio.min() < 0.4
    assert decibels(picture[shaded][:, :3], truth[shaded]) > 42.0
    assert decibels(plain[shaded][:, :3], truth[shaded]) < 22.0  # without the ground: no shadow at all
    # Colours of the shadow: green, which comes from above, is darker under the ball than red is.
    seen = picture[..., :3] / np.maximum(without[..., :3], 1e-6)
    bare = floor & (alpha_of(1, eye, directions) == 0.0)
    deepest = np.unravel_index(np.where(bare, ratio[..., 1], 2.0).argmin(), ratio.shape[:2])
    np.testing.assert_allclose(seen[deepest], ratio[deepest], atol=0.03)
    # The ball is black: what is seen where it is, is what hangs before it.
    front = alpha_of(1, eye, directions)
    covered = inside & (front > 0.3)
    hidden = inside & (behind > 0.5) & (front == 0.0)
    assert covered.sum() > 3 and hidden.sum() > 3
    assert decibels(picture[covered][:, :3], truth[covered]) > 40.0
    np.testing.assert_allclose(picture[hidden][:, :3], 0.0, atol=1e-4)
    # And far from ball and shadow nothing changes.
    elsewhere = ~ball & (ratio.min(-1) > 0.995)
    assert elsewhere.sum() > 100
    assert decibels(picture[elsewhere][:, :3], without[elsewhere][:, :3]) > 50.0
    np.testing.assert_array_equal(picture[..., 3], plain[..., 3])


#: A probe's lamp: towards it, how narrow (its deviation is some 5°), how bright; and all else.
LAMP, NARROW, BRIGHT, DIM = np.array([0.48, 0.36, 0.8]), 130.0, 60.0, 0.2
PROBE_WIDTH = 256


def write_lamp_probe(folder: Path) -> Path:
    """A probe whose one light is the lamp; what no light turns is dim and even."""
    begin(folder)
    lobe = BRIGHT * np.exp(NARROW * (panorama_directions(PROBE_WIDTH) @ LAMP - 1.0))
    for name, light in (("fixed.exr", np.full_like(lobe, DIM)), ("light_0.exr", lobe)):
        (folder / name).write_bytes(exr.encode_rgb(np.repeat(light[..., None], 3, 2).astype(np.float32)))
    finish(folder, Probe((0.0, 0.0, 0.5), PROBE_WIDTH, ("ambient",), 0.0, 0.01, 0, len(SPLATS), "test"))
    return folder


@pytest.mark.long
@pytest.mark.parametrize("level", [0.25, pytest.param(1.0, marks=pytest.mark.long)])
def test_shadow_of_a_small_bright_lamp_in_a_probe(extension, capture, draw, look_at, tmp_path, level):
    """*Light From Here* and the ground together: the ratio that the panorama's own pixels add up to."""
    target = next(each for each in capture.objects if each.type == "POINTCLOUD")
    bpy.context.view_layer.objects.active = target
    probe = write_lamp_probe(tmp_path / "probe")
    assert bpy.ops.physhdr.light_from_here(folder=str(probe)) == {"FINISHED"}
    nodes.set_input(nodes.find_modifier(target), nodes.level_input(("ambient",), 0), level)
    add_ball(capture)
    plain = draw(capture)
    cg.put(capture, bpy.context.view_layer, Vector((0.0, 0.0, 0.0)), size=8.0)
    capture.view_layers[cg.SHADOW_LAYER].samples = 256
    picture = draw(capture)

    eye, directions = rays(look_at)
    _, _, ball, _ = expected(look_at)
    splats = alpha_of(1, eye, directions) + alpha_of(2, eye, directions)
    bare = ~ball & (splats == 0.0) & (directions[..., 2] < -1e-3)
    points = eye + directions[bare] * (-eye[2] / directions[bare][:, 2])[:, None]
    sky = panorama_directions(PROBE_WIDTH)[: PROBE_WIDTH // 4].reshape(-1, 3)
    angles = np.repeat(solid_angles(PROBE_WIDTH)[: PROBE_WIDTH // 4], PROBE_WIDTH)
    light = angles * sky[:, 2] * (DIM + level * BRIGHT * np.exp(NARROW * (sky @ LAMP - 1.0)))
    truth = left_by_ball(points, sky, light[:, None])[:, 0]
    seen = picture[bare][:, :3].sum(-1) / plain[bare][:, :3].sum(-1)
    shaded = truth < 0.9
    assert shaded.sum() > 40 and truth.min() < (0.6 if level < 1.0 else 0.3)
    assert abs(np.mean(seen[shaded] - truth[shaded])) < 0.01
    assert np.sqrt(np.square(seen - truth)[shaded].mean()) < 0.03
    assert np.abs(seen - truth)[truth > 0.995].max() < 0.02


def shown(collection) -> set[str]:
    """The objects that a layer shows of a collection. Its own list of them is as old as its last drawing."""
    if collection.exclude:
        return set()
    below = (shown(each) for each in collection.children)
    return {each.name for each in collection.collection.objects}.union(*below)


def state_of(scene) -> dict:
    """What *Put CG Here* may not change for good: who is in which collection, layers, what is composed."""
    tree = scene.compositing_node_group
    links = (
        [(each.from_node.name, each.from_socket.name, each.to_node.name) for each in tree.links]
        if tree
        else []
    )
    return {
        "objects": {each.name: sorted(one.name for one in each.users_collection) for each in scene.objects},
        "layers": [each.name for each in scene.view_layers],
        "collections": sorted(each.name for each in bpy.data.collections),
        "shown": {each.name: sorted(shown(each.layer_collection)) for each in scene.view_layers},
        "tree": tree.name if tree else None,
        "links": sorted(links),
        "groups": sorted(each.name for each in bpy.data.node_groups if each.type == "COMPOSITING"),
        "meshes": sorted(each.name for each in bpy.data.meshes),
    }


def compose(scene, layer: str) -> None:
    """A user's own compositor: the picture, blurred, beside what another layer shows."""
    tree = bpy.data.node_groups.new("Mine", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    source, blur = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeBlur")
    source.scene, source.layer = scene, layer
    tree.links.new(source.outputs["Image"], blur.inputs["Image"])
    tree.links.new(source.outputs["Alpha"], tree.nodes.new("CompositorNodeSetAlpha").inputs["Alpha"])
    tree.links.new(blur.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    scene.compositing_node_group = tree


@pytest.mark.parametrize("composed", [False, True])
def test_reset_leaves_the_scene_as_it_was(extension, capture, composed):
    scene, operators = capture, bpy.ops.physhdr
    own = bpy.data.collections.new("Mine")
    scene.collection.children.link(own)
    model = next(each for each in scene.objects if each.type == "POINTCLOUD")
    own.objects.link(model)
    scene.collection.objects.unlink(model) if model.name in scene.collection.objects else None
    ball = add_ball(scene)
    scene.view_layers.new("Other").layer_collection.children["Mine"].exclude = True
    if composed:
        compose(scene, "ViewLayer")
    scene.render.engine = "CYCLES"
    before = state_of(scene)
    assert not operators.cg_reset.poll()
    for _ in range(2):  # the second time it moves what is there
        assert operators.cg_here(location=(0.3, -0.2, 0.05)) == {"FINISHED"}
    during = state_of(scene)
    assert during["layers"] == ["ViewLayer", "Other", cg.SHADOW_LAYER, cg.FRONT_LAYER]
    # No layer of the user's shows anything else than before; ours show what they are for.
    assert {name: during["shown"][name] for name in before["shown"]} == before["shown"]
    assert during["shown"][cg.SHADOW_LAYER] == sorted([ball.name, "PhysHDR Ground"])
    assert during["shown"][cg.FRONT_LAYER] == sorted([ball.name, model.name, "PhysHDR Ground Top"])
    assert cg.hindrances(scene) == []
    # On the floor that the splats are, not on the height that was given.
    assert cg.ground_of(scene).location.z == pytest.approx(0.0, abs=2e-3)
    if composed:
        shown = scene.compositing_node_group.nodes["Blur"].inputs["Image"].links[0].from_node
        assert shown.type == "GROUP" and during["tree"] == "Mine"
    assert operators.cg_reset() == {"FINISHED"}
    assert state_of(scene) == before


@pytest.mark.parametrize("in_collection", [False, True])
def test_a_linked_copy_of_the_scene_keeps_its_ground(extension, capture, in_collection):
    """Scenes share collections then: removed from one, what is in them stands in both, and in the end where
    it stood. An object of the user's that lies in the ground's collection goes along."""
    first = capture
    [model] = cg.models_of(first)
    own = bpy.data.collections.new("Mine")
    first.collection.children.link(own)
    if in_collection:
        own.objects.link(model)
        first.collection.objects.unlink(model)
    before = set(first.objects)
    assert bpy.ops.physhdr.cg_here(location=(0, 0, 0), stand=False) == {"FINISHED"}
    ball = add_ball(first)
    first.collection.children["PhysHDR Ground"].objects.link(ball)
    first.collection.objects.unlink(ball)
    with_ground = set(first.objects)
    bpy.ops.scene.new(type="LINK_COPY")
    second = bpy.context.scene
    assert set(second.objects) == with_ground and cg.hindrances(second) == cg.hindrances(first)
    told = cg.hindrances(first)
    assert bpy.ops.physhdr.cg_reset() == {"FINISHED"}
    assert set(second.objects) == before | {ball} and not cg.is_there(second)
    assert set(first.objects) == with_ground and cg.hindrances(first) == told
    bpy.context.window.scene = first
    assert bpy.ops.physhdr.cg_reset() == {"FINISHED"}
    assert set(first.objects) == set(second.objects) == before | {ball}
    stands_in = {own} if in_collection else {first.collection, second.collection}
    assert set(model.users_collection) == stands_in
    assert not [each for each in bpy.data.collections if cg.MARK in each]


def test_a_ground_in_a_collection_of_another_file_hinders_no_reset(extension, capture, tmp_path):
    """What a linked collection holds cannot be taken out of it."""
    theirs, ground = bpy.data.collections.new("Set"), bpy.data.collections.new("Theirs")
    plane = bpy.data.objects.new("plane", bpy.data.meshes.new("plane"))
    ground[cg.MARK] = plane[cg.MARK] = cg.GROUND
    theirs.children.link(ground)
    ground.objects.link(plane)
    bpy.data.libraries.write(str(tmp_path / "set.blend"), {theirs})
    for each in (theirs, ground):
        bpy.data.collections.remove(each)
    bpy.data.objects.remove(plane)
    before = set(capture.objects)
    assert bpy.ops.physhdr.cg_here(location=(0, 0, 0), stand=False) == {"FINISHED"}
    with bpy.data.libraries.load(str(tmp_path / "set.blend"), link=True) as (_, here):
        here.collections = ["Set"]
    capture.collection.children.link(here.collections[0])
    assert bpy.ops.physhdr.cg_reset() == {"FINISHED"}
    assert before <= set(capture.objects) and not cg.is_there(capture)


def test_what_would_hinder_the_shadow_is_told(extension, capture, write, make_model):
    scene = capture
    scene.render.engine = "CYCLES"
    bpy.ops.physhdr.cg_here()
    assert cg.hindrances(scene) == []
    for spoil, told in [
        (lambda: setattr(scene.render, "engine", "BLENDER_EEVEE"), "Only Cycles"),
        (lambda: setattr(scene.view_layers[cg.SHADOW_LAYER], "use", False), "missing or off"),
        (lambda: setattr(scene.render, "use_compositing", False), "compositor"),
        (lambda: model_import.import_model(str(write(make_model(count=3)))), "hides the ground"),
    ]:
        spoil()
        assert any(told in each for each in cg.hindrances(scene)), told
        scene.render.engine = "CYCLES"
        assert bpy.ops.physhdr.cg_here() == {"FINISHED"}
        assert cg.hindrances(scene) == []


def planes_of(scene, kind: str) -> list:
    return [each for each in scene.objects if each.get(cg.MARK) == kind]


def where(top) -> np.ndarray:
    """``[4, 4]``: a ground's top in the world; no layer that is looked at evaluates them."""
    return np.array(top.parent.matrix_basis @ top.matrix_parent_inverse @ top.matrix_basis)


@pytest.mark.parametrize("gone", [cg.GROUND, cg.FRONT, "both"])
def test_what_was_deleted_of_the_ground_is_made_again(extension, capture, gone):
    scene = capture
    scene.render.engine = "CYCLES"
    before = state_of(scene)
    bpy.ops.physhdr.cg_here(location=(0.0, 0.0, 0.3), floor="PLACE", thickness=0.1)
    for kind in (cg.GROUND, cg.FRONT):
        if gone in (kind, "both"):
            bpy.data.objects.remove(*planes_of(scene, kind))
    assert any("missing or off" in each for each in cg.hindrances(scene))
    bpy.ops.physhdr.cg_here(location=(0.5, 0.0, 0.2), floor="PLACE", thickness=0.1)
    (ground,), (top,) = planes_of(scene, cg.GROUND), planes_of(scene, cg.FRONT)
    assert ground.is_shadow_catcher and top.is_holdout and not top.visible_shadow
    assert tuple(ground.location) == pytest.approx((0.5, 0.0, 0.2))
    expected = ((8, 0, 0, 0.5), (0, 8, 0, 0), (0, 0, 2, 0.3), (0, 0, 0, 1))
    np.testing.assert_allclose(where(top), expected, atol=1e-6)
    assert cg.hindrances(scene) == []
    bpy.ops.physhdr.cg_reset()
    assert {**state_of(scene), "meshes": []} == {**before, "meshes": []}


def test_a_top_that_an_older_version_left_behind_is_told_and_removed(extension, capture):
    scene = capture
    scene.render.engine = "CYCLES"
    bpy.ops.physhdr.cg_here()
    (top,) = planes_of(scene, cg.FRONT)
    stray = top.copy()
    stray.parent = None
    top.users_collection[0].objects.link(stray)
    assert any("Put CG Here again" in each for each in cg.hindrances(scene))
    bpy.ops.physhdr.cg_here()
    assert planes_of(scene, cg.FRONT) == [top] and cg.hindrances(scene) == []


def test_a_ground_under_a_model_of_uneven_scale(extension, capture):
    """Stretched upward its floor is as thick as it is there; nothing else of the shadow minds the scale."""
    scene = capture
    target = next(each for each in scene.objects if is_model(each))
    cube = add_ball(scene)
    scale = np.exp(np.random.default_rng(0).uniform(-9.0, -3.0, (200, 3)))
    cloud = target.data
    cloud.resize(200)
    write_attribute(cloud, attributes.SCALE, scale)
    write_attribute(cloud, attributes.POSITION, np.zeros((200, 3)))
    write_attribute(cloud, attributes.ROTATION, np.tile([1.0, 0.0, 0.0, 0.0], (200, 1)))
    write_attribute(cloud, attributes.BASE, np.ones((200, 4)))
    target.scale = (1.0, 1.0, 3.0)
    cube.select_set(True)
    assert bpy.ops.physhdr.cg_here(location=(0.0, 0.0, 0.0), floor="PLACE") == {"FINISHED"}
    stretched = scale * (1.0, 1.0, 3.0)
    largest = stretched.max(axis=1)
    size, weight = np.maximum(largest / 2.0, stretched[:, 2]), largest**2
    order = np.argsort(size)
    within = size[order][np.searchsorted(np.cumsum(weight[order]), 0.9 * weight.sum())]
    assert cg.THINNEST < within < cg.THICKEST
    (top,) = planes_of(scene, cg.FRONT)
    assert where(top)[2, 3] == pytest.approx(within, rel=1e-4)
    assert cube.matrix_world.translation.z == pytest.approx(RADIUS, abs=1e-4)


def test_the_floor_is_what_is_shown_of_the_model(extension, capture):
    """Half of the Gaussians hang above the others, and are hidden by *Clean*."""
    target = next(each for each in capture.objects if is_model(each))
    cloud, places = target.data, np.random.default_rng(0).uniform(-1.0, 1.0, (400, 3))
    places[:, 2] = np.repeat([0.0, 0.6], 200)
    cloud.resize(400)
    write_attribute(cloud, attributes.POSITION, places)
    write_attribute(cloud, attributes.SCALE, np.tile([0.2, 0.2, 0.01], (400, 1)))
    write_attribute(cloud, attributes.ROTATION, np.tile([1.0, 0.0, 0.0, 0.0], (400, 1)))
    write_attribute(cloud, attributes.BASE, np.tile([0.0, 0.0, 0.0, 0.9], (400, 1)))
    cloud.update_tag()
    place = Vector((0.0, 0.0, 1.0))
    assert cg.floor_below(capture, place) == pytest.approx(0.6, abs=0.05)
    box = bpy.data.objects.new("box", None)
    capture.collection.objects.link(box)
    box.scale = (3.0, 3.0, 0.3)
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.CROP_BOX, box)
    nodes.set_input(modifier, nodes.CROP, True)
    bpy.context.view_layer.update()
    assert cg.floor_below(capture, place) == pytest.approx(0.0, abs=0.05)
    target.scale.z = 0.0
    bpy.context.view_layer.update()
    assert cg.floor_below(capture, place) is None, "what is flat has no surface"


def test_nothing_is_moved_where_no_ground_is_laid(extension, capture, monkeypatch):
    """Whatever the reason: what fails pushes no undo, so it must leave all where it was."""
    cube = add_ball(capture)
    cube.select_set(True)
    bpy.context.view_layer.update()
    before = cube.matrix_world.copy()

    def refuse(*_):
        raise DataMismatchError("this floor has no thickness")

    monkeypatch.setattr(cg, "floor_thickness", refuse)
    with pytest.raises(RuntimeError, match="no thickness"):
        bpy.ops.physhdr.cg_here(location=(0.0, 0.0, 0.0), floor="PLACE")
    assert cube.matrix_world == before and not cg.is_there(capture)


def test_selected_objects_stand_at_the_cursor(extension, capture):
    scene = capture
    ball, hat = add_ball(scene), add_ball(scene)
    hat.parent = ball  # moves with it, once
    hat.location = (0.0, 0.0, 0.5)
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    scene.collection.objects.link(lamp)
    for each in scene.objects:
        each.select_set(True)
    scene.cursor.location = (0.7, -0.3, 0.04)
    assert bpy.ops.physhdr.cg_here(floor="PLACE") == {"FINISHED"}
    np.testing.assert_allclose(ball.matrix_world.translation, (0.7, -0.3, 0.04 + RADIUS), atol=1e-4)
    np.testing.assert_allclose(hat.matrix_world.translation, (0.7, -0.3, 0.54 + RADIUS), atol=1e-4)
    assert tuple(lamp.location) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(cg.ground_of(scene).location, (0.7, -0.3, 0.04), atol=1e-6)


def test_what_would_not_stay_is_named_and_not_moved(extension, capture, tmp_path):
    """The next frame gives an object its keyed place; that of a linked one is the other file's."""
    scene = capture
    theirs = add_ball(scene)
    theirs.name = "theirs"
    bpy.data.libraries.write(str(tmp_path / "theirs.blend"), {theirs})
    bpy.data.objects.remove(theirs)
    with bpy.data.libraries.load(str(tmp_path / "theirs.blend"), link=True) as (_, wanted):
        wanted.objects = ["theirs"]
    free, keyed, turning, linked = add_ball(scene), add_ball(scene), add_ball(scene), wanted.objects[0]
    scene.collection.objects.link(linked)
    keyed.name = "keyed"
    keyed.location.x = free.location.x + 9.0
    keyed.keyframe_insert("location", frame=1)
    turning.keyframe_insert("rotation_euler", frame=1)
    hat = add_ball(scene)
    hat.parent = keyed
    for each in (free, keyed, turning, linked, hat):
        each.select_set(True)
    before = [tuple(each.location) for each in (keyed, linked, hat)]
    reports: list[tuple[set[str], str]] = []
    asking = SimpleNamespace(
        properties=SimpleNamespace(is_property_set=lambda _: True),
        report=lambda kind, told: reports.append((kind, told)),
        **{"location": (0.7, -0.3, 0.04), "floor": "PLACE", "size": 4.0, "thickness": 0.0, "stand": True},
    )
    assert operators.PHYSHDR_OT_cg_here.execute(asking, bpy.context) == {"FINISHED"}
    scene.frame_set(2)
    for each in (free, turning):
        np.testing.assert_allclose(each.matrix_world.translation, (0.7, -0.3, 0.04 + RADIUS), atol=1e-4)
    assert [tuple(each.location) for each in (keyed, linked, hat)] == before
    ((kind, told),) = reports
    assert kind == {"WARNING"} and "2 objects put onto it" in told
    assert "keyed is animated and was not moved: move an empty that is its parent" in told
    assert "theirs is linked from another file and was not moved" in told


def test_without_a_model_nothing_is_set_up(extension):
    scene = extension
    assert not bpy.ops.physhdr.cg_here.poll()
    with pytest.raises(RuntimeError):
        bpy.ops.physhdr.cg_here()
    assert len(scene.view_layers) == 1


def test_where_a_model_cannot_be_set_apart_nothing_is_moved(extension, capture, tmp_path):
    """The model's collection is another file's: said before the cube is put onto the floor."""
    target = next(each for each in capture.objects if is_model(each))
    theirs = bpy.data.collections.new("Theirs")
    theirs.objects.link(target)
    bpy.data.libraries.write(str(tmp_path / "theirs.blend"), {theirs})
    bpy.data.objects.remove(target)
    bpy.data.collections.remove(theirs)
    with bpy.data.libraries.load(str(tmp_path / "theirs.blend"), link=True) as (_, wanted):
        wanted.collections = ["Theirs"]
    capture.collection.children.link(wanted.collections[0])
    bpy.ops.mesh.primitive_cube_add(location=(0.1, 0.2, 3.0))
    cube = bpy.context.object
    with pytest.raises(RuntimeError, match="of another file"):
        bpy.ops.physhdr.cg_here(location=(0.0, 0.0, 0.0))
    assert tuple(cube.matrix_world.translation) == pytest.approx((0.1, 0.2, 3.0)) and not cg.is_there(capture)


@pytest.fixture
def library(extension, make_model, write, tmp_path):
    """A file with a collection that holds one model."""
    holder = bpy.data.collections.new("Capture")
    extension.collection.children.link(holder)
    model_import.import_model(str(write(make_model())), "room", holder)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return str(tmp_path / "library.blend"), str(tmp_path / "model.safetensors")


def test_a_linked_model_of_the_same_name_stays_in_the_scene(library):
    path, model = library
    own = model_import.import_model(model, "room")
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["room"]
    [theirs] = wanted.objects
    scene = bpy.context.scene
    scene.collection.objects.link(theirs)
    assert bpy.ops.physhdr.cg_here(location=(0, 0, -1), stand=False) == {"FINISHED"}
    assert {own, theirs} <= set(scene.objects)
    assert bpy.ops.physhdr.cg_reset() == {"FINISHED"}
    assert {own, theirs} == set(scene.objects)


def test_in_an_overridden_collection_nothing_is_put(library):
    """Blender lets no object be linked into one: each finds another place, or says what to do."""
    path, model = library
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = ["Capture"]
    scene, layer = bpy.context.scene, bpy.context.view_layer
    wanted.collections[0].override_hierarchy_create(scene, layer, do_fully_editable=True)
    for each in [each for each in scene.collection.children if each.library]:
        scene.collection.children.unlink(each)
    layer.update()
    target = next(each for each in scene.objects if is_model(each))
    assert target.users_collection[0].override_library
    layer.objects.active = target
    assert bpy.ops.physhdr.cleaning_box() == {"FINISHED"}
    layer.active_layer_collection = layer.layer_collection.children[0]
    assert bpy.ops.physhdr.model_import(filepath=model, name="second") == {"FINISHED"}
    assert all(each in set(scene.objects) for each in bpy.data.objects if each.library is None)
    assert scene.collection in bpy.data.objects["second"].users_collection
    with pytest.raises(
        RuntimeError, match=r"is in the collection Capture of another file\s+Append the model"
    ):
        bpy.ops.physhdr.cg_here(location=(0, 0, -1), stand=False)
