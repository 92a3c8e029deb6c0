# SPDX-License-Identifier: GPL-3.0-or-later
"""The splat shader against closed forms, drawn without a window. (All of it against the CPU rasteriser:
tests/loop/test_viewport.py.)"""

import dataclasses
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
import gpu  # noqa: E402

from physhdr.addon import viewport  # noqa: E402
from physhdr.addon.model import attributes, model_import, nodes, point_cloud  # noqa: E402
from physhdr.addon.model.drawn import fingerprint  # noqa: E402
from physhdr.addon.panels import model as model_panel  # noqa: E402
from physhdr.addon.viewport import splats  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera  # noqa: E402
from physhdr.addon.viewport.splat_data import LIGHTS_MAX, SplatArrays, SplatTextures  # noqa: E402
from physhdr.addon.viewport.splat_renderer import Item, SplatRenderer, Target, level_place  # noqa: E402
from physhdr.bridge import confidence  # noqa: E402
from physhdr.bridge.camera_list import ListedCamera  # noqa: E402
from physhdr.bridge.errors import DataMismatchError  # noqa: E402
from physhdr.bridge.spherical_harmonics import C0, C1  # noqa: E402
from physhdr.bridge.srgb import to_linear  # noqa: E402

SIZE, FOCAL = 65, 80.0
CENTRE = SIZE // 2
LOW_PASS = 0.3


@pytest.fixture(scope="module")
def renderer():
    gpu.init()
    return SplatRenderer()


@pytest.fixture
def registered(scene):
    viewport.register()
    yield
    viewport.unregister()


#: At the origin, looking down −Z; the axis through the centre of the middle pixel.
CAMERA = ViewCamera(np.eye(4), SIZE, SIZE, FOCAL, FOCAL, CENTRE + 0.5, CENTRE + 0.5)


def gaussians(*rows: dict) -> SplatTextures:
    """Gaussians from ``position``, ``scale``, ``opacity``, ``radiance`` and perhaps ``sh`` (more terms)."""
    first = rows[0]
    constant = np.array([[np.log(row["radiance"]) / C0 for row in rows]])
    more = np.array([row["sh"] for row in rows]).transpose(1, 0, 2) if "sh" in first else np.empty((0, 1, 3))
    arrays = SplatArrays(
        position=np.array([row["position"] for row in rows], np.float32),
        rotation=np.array([row.get("rotation", (1.0, 0.0, 0.0, 0.0)) for row in rows], np.float32),
        scale=np.array([row["scale"] for row in rows], np.float32),
        opacity=np.array([row["opacity"] for row in rows], np.float32),
        log_sh=np.concatenate([constant, more] if len(more) else [constant]).astype(np.float32),
        light=np.array([row.get("shares", [(1.0, 1.0, 1.0)]) for row in rows], np.float32).transpose(1, 0, 2),
    )
    return SplatTextures(arrays)


def draw(renderer, textures, camera=CAMERA, matrix=None, **lit):
    item = Item(textures, np.eye(4) if matrix is None else matrix, **lit)
    return renderer.render([item], camera).read()


def test_one_gaussian_on_the_axis(renderer):
    """alpha = opacity · exp(−d²/2σ²), σ² = (f s/z)² + 0.3; zero below 1/255; premultiplied; HDR."""
    radiance = np.array([700.0, 0.02, 3.0])
    textures = gaussians(
        {"position": (0, 0, -4), "scale": (0.3, 0.3, 0.3), "opacity": 0.8, "radiance": radiance}
    )
    colour, depth = draw(renderer, textures)
    sigma2 = (FOCAL * 0.3 / 4.0) ** 2 + LOW_PASS
    y, x = np.mgrid[:SIZE, :SIZE] - CENTRE
    alpha = 0.8 * np.exp(-0.5 * (x**2 + y**2) / sigma2)
    alpha[alpha < 1.0 / 255.0] = 0.0
    np.testing.assert_allclose(colour[..., 3], alpha, atol=2e-6)
    np.testing.assert_allclose(colour[..., :3], alpha[..., None] * radiance, rtol=1e-4)
    np.testing.assert_allclose(depth, np.where(alpha > 0.0, 4.0, 0.0), rtol=1e-6)


def test_a_long_turned_gaussian(renderer):
    """Axes 0.5 and 0.05 at 30° in the image plane: the covariance R diag(σ²) Rᵀ (f/z)² + 0.3 I."""
    half = math.radians(30.0) / 2.0
    textures = gaussians(
        {
            "position": (0, 0, -4),
            "rotation": (math.cos(half), 0.0, 0.0, math.sin(half)),
            "scale": (0.5, 0.05, 0.2),
            "opacity": 1.0,
            "radiance": (1.0, 1.0, 1.0),
        }
    )
    colour, _ = draw(renderer, textures)
    c, s = math.cos(2.0 * half), math.sin(2.0 * half)
    turn = np.array([[c, -s], [s, c]])
    covariance = turn @ np.diag([0.5**2, 0.05**2]) @ turn.T * (FOCAL / 4.0) ** 2 + LOW_PASS * np.eye(2)
    y, x = np.mgrid[:SIZE, :SIZE] - CENTRE
    offset = np.stack([x, -y], axis=-1)  # rows go down, Blender's Y goes up
    power = -0.5 * np.einsum("...i,ij,...j", offset, np.linalg.inv(covariance), offset)
    alpha = np.minimum(0.999, np.exp(power))
    alpha[alpha < 1.0 / 255.0] = 0.0
    np.testing.assert_allclose(colour[..., 3], alpha, atol=1e-5)


def test_the_nearer_covers_the_farther(renderer):
    """Whatever their order in memory: near + (1 − alpha) far; mean depth weighted the same."""
    near = {"position": (0, 0, -2), "scale": (1, 1, 1), "opacity": 0.5, "radiance": (8.0, 8.0, 8.0)}
    far = {"position": (0, 0, -5), "scale": (1, 1, 1), "opacity": 0.6, "radiance": (1.0, 2.0, 4.0)}
    for rows in [(near, far), (far, near)]:
        colour, depth = draw(renderer, gaussians(*rows))
        expected = 0.5 * 8.0 + 0.5 * 0.6 * np.array([1.0, 2.0, 4.0])
        np.testing.assert_allclose(colour[CENTRE, CENTRE, :3], expected, rtol=1e-4)
        assert colour[CENTRE, CENTRE, 3] == pytest.approx(0.8, rel=1e-5)
        assert depth[CENTRE, CENTRE] == pytest.approx((0.5 * 2 + 0.3 * 5) / 0.8, rel=1e-4)


def test_two_objects_are_sorted_together(renderer):
    """Two objects whose Gaussians interleave in depth draw as one object with all of them."""
    rng = np.random.default_rng(0)
    rows = [
        {
            "position": (*rng.uniform(-0.5, 0.5, 2), -2.0 - 0.1 * index),
            "scale": (0.3, 0.3, 0.3),
            "opacity": 0.5,
            "radiance": rng.uniform(0.1, 5.0, 3),
        }
        for index in range(20)
    ]
    together, depth = draw(renderer, gaussians(*rows))
    items = [Item(gaussians(*rows[start::2]), np.eye(4)) for start in (0, 1)]
    apart = renderer.render(items, CAMERA)
    np.testing.assert_allclose(apart.read()[0], together, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(apart.read()[1], depth, rtol=1e-5)


def test_portions_give_the_same_picture(renderer):
    rng = np.random.default_rng(1)
    rows = [
        {
            "position": (*rng.uniform(-1.0, 1.0, 2), -rng.uniform(2.0, 6.0)),
            "scale": rng.uniform(0.05, 0.4, 3),
            "opacity": 0.6,
            "radiance": (1.0, 1.0, 1.0),
        }
        for _ in range(100)
    ]
    item = Item(gaussians(*rows), np.eye(4))
    target = Target(SIZE, SIZE)
    drawing = renderer.begin([item], CAMERA, target)
    while not drawing.is_complete:
        drawing.draw(7)
    np.testing.assert_array_equal(target.read()[0], renderer.render([item], CAMERA).read()[0])


def test_level_exposure_and_view_dependence(renderer):
    """radiance · (1 − s + level · s) · 2^EV, times exp(sh · Y) unless that is off."""
    row = {
        "position": (0, 0, -4),
        "scale": (0.5, 0.5, 0.5),
        "opacity": 0.5,
        "radiance": (2.0, 2.0, 2.0),
        "shares": [(0.0, 0.25, 1.0)],
        "sh": np.array([[0, 0, 0], [0.5, 0.5, 0.5], [0, 0, 0]]),  # the term of z
    }
    textures = gaussians(row)
    colour, _ = draw(renderer, textures, levels=(4.0,), exposure=-2.0)
    toward_minus_z = math.exp(-0.5 * C1)
    expected = 0.5 * 2.0 * toward_minus_z * np.array([1.0, 0.75 + 1.0, 4.0]) / 4.0
    np.testing.assert_allclose(colour[CENTRE, CENTRE, :3], expected, rtol=1e-3)
    colour, _ = draw(renderer, textures, levels=(4.0,), exposure=-2.0, view_dependent=False)
    np.testing.assert_allclose(colour[CENTRE, CENTRE, :3], expected / toward_minus_z, rtol=1e-3)


def test_several_lights_have_a_level_each(renderer):
    """radiance · (1 − Σ s + Σ level · s); a light whose level is not given is at 1."""
    shares = np.array([(0.0, 0.25, 0.7), (0.5, 0.25, 0.2), (0.125, 0.25, 0.1)])
    row = {"position": (0, 0, -4), "scale": (0.5, 0.5, 0.5), "opacity": 0.5, "radiance": (2.0, 2.0, 2.0)}
    textures = gaussians({**row, "shares": shares})
    for levels in [(4.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.001, 0.001, 0.002), (0.25, 3.0), ()]:
        colour, _ = draw(renderer, textures, levels=levels)
        weights = np.array([*levels, 1.0, 1.0, 1.0])[:3]
        expected = 0.5 * 2.0 * (1.0 - shares.sum(axis=0) + weights @ shares)
        np.testing.assert_allclose(colour[CENTRE, CENTRE, :3], expected, rtol=1e-3, atol=1e-6)


def test_more_lights_than_any_scene_has(renderer):
    """As many as there are layers of a texture (LIGHTS_MAX), the last one turned up."""
    shares = np.full((LIGHTS_MAX, 3), 0.5 / LIGHTS_MAX)
    row = {"position": (0, 0, -4), "scale": (0.5, 0.5, 0.5), "opacity": 0.5, "radiance": (2.0, 2.0, 2.0)}
    levels = (*(0.0 for _ in shares[1:]), 2.0 * LIGHTS_MAX)
    colour, _ = draw(renderer, gaussians({**row, "shares": shares}), levels=levels)
    np.testing.assert_allclose(colour[CENTRE, CENTRE, :3], 0.5 * 2.0 * (0.5 + 1.0), rtol=1e-3)


def test_behind_the_camera_or_nearly_nothing_is_not_drawn(renderer):
    shape = {"scale": (0.5, 0.5, 0.5), "radiance": (1.0, 1.0, 1.0)}
    rows = [
        {"position": (0, 0, 4), "opacity": 1.0, **shape},
        {"position": (0, 0, -0.009), "opacity": 1.0, **shape},
        {"position": (0, 0, -4), "opacity": 0.0039, **shape},
    ]
    colour, depth = draw(renderer, gaussians(*rows))
    assert not colour.any() and not depth.any()


def test_orthographic(renderer):
    """The same size at any depth, ``fx`` pixels a metre; drawn behind the view's origin, too."""
    camera = ViewCamera(np.eye(4), SIZE, SIZE, 20.0, 20.0, CENTRE + 0.5, CENTRE + 0.5, is_orthographic=True)
    shape = {"scale": (0.2, 0.2, 0.2), "opacity": 0.7, "radiance": (1.0, 1.0, 1.0)}
    for z in (-50.0, 3.0):
        colour, depth = draw(renderer, gaussians({"position": (0.5, 0, z), **shape}), camera)
        sigma2 = (20.0 * 0.2) ** 2 + LOW_PASS
        row = 0.7 * np.exp(-0.5 * (np.arange(SIZE) - CENTRE - 10) ** 2 / sigma2)
        row[row < 1.0 / 255.0] = 0.0
        np.testing.assert_allclose(colour[CENTRE, :, 3], row, atol=1e-5)
        assert depth[CENTRE, CENTRE + 10] == pytest.approx(-z, rel=1e-5)


def test_levels_are_a_log2_apart():
    levels = (0.25, 0.5, 1.0, 4.0)
    assert level_place(levels, 0.5) == pytest.approx((1, 0.0))
    assert level_place(levels, 2.0) == pytest.approx((2, 0.5))
    assert level_place(levels, 0.0) == (0, 0.0)
    assert level_place(levels, 99.0) == pytest.approx((2, 1.0))
    assert level_place((2.0,), 1.0) == (0, 0.0)


def groups():
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return splats.items_by_tone(splats.shown_objects(bpy.context.view_layer, depsgraph))


@pytest.fixture
def target(registered, renderer, make_model, write):
    target = model_import.import_model(write(make_model(count=60, degree=2)))
    target.physhdr_viewport = "SPLATS"
    return target


def test_splats_or_nodes_never_both(target):
    modifier = nodes.find_modifier(target)
    assert not modifier.show_viewport and modifier.show_render and target.display_type == "BOUNDS"
    assert len(groups()) == 1
    target.physhdr_viewport = "NODES"
    assert modifier.show_viewport and target.display_type == "TEXTURED"
    assert not groups()


def test_confidence_is_drawn_in_its_colours(registered, renderer, make_model, write):
    """Whatever the exposure, the level and the light are; what is cleaned away is not drawn."""
    model = make_model(count=3, degree=2)
    sure = np.array([0.0, 0.6, 1.0], np.float32)
    place = np.array([(-0.3, 0.0, -3.0), (0.0, 0.0, -3.0), (0.3, 0.0, -3.0)], np.float32)
    scale = np.full((3, 3), 0.05, np.float32)
    opacity = np.full(3, 0.9, np.float32)
    model = dataclasses.replace(model, confidence=sure, position=place, scale=scale, opacity=opacity)
    target = model_import.import_model(write(model))
    target.physhdr_viewport = "CONFIDENCE"
    modifier = nodes.find_modifier(target)
    assert not modifier.show_viewport and modifier.show_render
    nodes.set_input(modifier, nodes.EXPOSURE, 5.0)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 0.1)
    ((tone, items),) = groups().values()
    picture = renderer.render(items, CAMERA).read()[0]
    assert tone is None
    for x, colour in zip((CENTRE - 8, CENTRE, CENTRE + 8), confidence.colours(sure), strict=True):
        red, green, blue, alpha = picture[CENTRE, x]
        np.testing.assert_allclose(
            np.array([red, green, blue]) / alpha, to_linear(colour), rtol=2e-3, atol=2e-4
        )
    nodes.set_input(modifier, nodes.SMALLEST_CONFIDENCE, 0.5)
    ((_, items),) = groups().values()
    shown = renderer.render(items, CAMERA).read()[0][CENTRE, [CENTRE - 8, CENTRE, CENTRE + 8], 3]
    assert shown[0] == 0.0 and (shown[1:] > 0.5).all()


def test_a_model_without_confidence_is_drawn_as_it_shines(target):
    ((_, (before,)),) = groups().values()
    assert model_panel.confidence_note(target) == ""
    target.physhdr_viewport = "CONFIDENCE"
    ((_, (after,)),) = groups().values()
    assert after.splats is before.splats
    assert "export it again" in model_panel.confidence_note(target)


def test_hidden_objects_are_not_drawn(target):
    target.hide_set(True)
    assert not groups()
    target.hide_set(False)
    splats.set_hidden([target.data["physhdr_uuid"]])
    assert not groups()
    splats.set_hidden([])
    assert groups()


def test_keyframes_reach_the_picture(target, scene):
    """Inputs are read as evaluated: animation counts, and so does the object's place."""
    modifier = nodes.find_modifier(target)
    path = nodes.input_data_path(modifier, nodes.LIGHTING_LEVEL)
    for frame, level in [(1, 1.0), (11, 3.0)]:
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        target.keyframe_insert(path, frame=frame)
        target.location.x = frame
        target.keyframe_insert("location", frame=frame)
    found = []
    for frame in (1, 11):
        scene.frame_set(frame)
        ((_, (item,)),) = groups().values()
        found.append((item.levels[0], item.matrix_world[0, 3]))
    np.testing.assert_allclose(found, [(1.0, 1.0), (3.0, 11.0)])


def test_sliders_of_several_lights_reach_the_picture(registered, renderer, make_model, write):
    """What is drawn at these levels is what is drawn of a model that was captured at them."""
    lights = ("ambient", "pendant", "screen")
    model = make_model(count=60, degree=2, lights=lights)
    levels = (0.25, 3.0, 0.0)
    captured = np.array(model.log_radiance_sh)
    captured[:, 0] += model.log_gain(levels) / np.float32(C0)
    camera = ViewCamera(np.eye(4), SIZE, SIZE, FOCAL, FOCAL, CENTRE + 0.5, CENTRE + 0.5)
    camera.camera_to_world[2, 3] = 4.0
    pictures = []
    for source in (model, dataclasses.replace(model, log_radiance_sh=captured)):
        target = model_import.import_model(write(source))
        target.physhdr_viewport = "SPLATS"
        if source is model:
            for index, level in enumerate(levels):
                nodes.set_input(nodes.find_modifier(target), nodes.level_input(lights, index), level)
        ((_, items),) = groups().values()
        pictures.append(renderer.render(items, camera).read()[0])
        target.hide_set(True)
    top = pictures[1].max()
    assert np.abs(pictures[0] - pictures[1]).max() < 2e-3 * top
    assert np.sqrt(np.mean((pictures[0] - pictures[1]) ** 2)) < 2e-4 * top


@pytest.mark.parametrize("stated", ["pendant", '["a", "a"]', 3, '{"a": 1}'])
def test_lights_that_were_edited_to_nonsense(registered, renderer, make_model, write, stated):
    """The 3D view draws nothing; whoever reads the model is told what is wrong."""
    target = model_import.import_model(write(make_model(count=20)))
    target.physhdr_viewport = "SPLATS"
    target.data[attributes.LIGHTS] = stated
    assert not groups()
    with pytest.raises(DataMismatchError, match="not a list of lights"):
        point_cloud.model_of(target.data)


def test_textures_are_made_once_and_again_when_the_points_change(target):
    def serial():
        ((_, (item,)),) = groups().values()
        return item.splats.serial

    first = serial()
    nodes.set_input(nodes.find_modifier(target), nodes.EXPOSURE, 2.0)
    nodes.set_input(nodes.find_modifier(target), nodes.LIGHTING_LEVEL, 0.5)
    target.location.x = 1.0
    bpy.context.view_layer.update()
    assert serial() == first, "relighting and moving need no upload"
    target.data.attributes["position"].data[0].vector = (9.0, 0.0, 0.0)
    target.data.update_tag()
    bpy.context.view_layer.update()
    second = serial()
    assert second != first
    bpy.ops.ed.undo_push(message="test")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not splats._runtime.held, "nothing is kept over loading a file"


@pytest.mark.parametrize("modulator", ["additive", "levels"])
def test_an_edit_of_whatever_is_drawn_is_seen(scene, make_model, write, modulator):
    """The last number of the last Gaussian, of every attribute that an upload holds; of others none."""
    lights = ("ambient", "lamp") if modulator == "additive" else ("ambient",)
    model = make_model(count=41, degree=1, modulator=modulator, lights=lights, confidence=True)
    cloud = model_import.import_model(write(model)).data
    drawn = {"position", "rotation", "scale", "radiance:base", "physhdr:confidence"}
    drawn |= {f"physhdr:log_sh_{k}" for k in range(4)}
    lit = "light_share" if modulator == "additive" else "level_log_gain"
    drawn |= {f"physhdr:{lit}_{k}" for k in range(2 if modulator == "additive" else 4)}
    assert drawn <= set(cloud.attributes.keys())
    for name in [*drawn, "radius"]:
        before = fingerprint(cloud)
        assert fingerprint(cloud) == before
        if name == "radius":
            cloud.points[40].radius += 0.1
        else:
            values = point_cloud.read_attribute(cloud, name)
            values.reshape(-1)[-1] *= np.float32(1.0 + 2e-7)
            attribute = attributes.Attribute(name, cloud.attributes[name].data_type)
            point_cloud.write_attribute(cloud, attribute, values)
        assert (fingerprint(cloud) != before) == (name in drawn), name


def test_colours_that_two_gaussians_exchange_are_seen(scene, make_model, write):
    """No number is another then but by its place."""
    cloud = model_import.import_model(write(make_model(count=20_000, degree=0))).data
    before = fingerprint(cloud)
    for one, other in ((3, 4), (0, 19_999), (10, 10_000)):
        values = point_cloud.read_attribute(cloud, "physhdr:log_sh_0")
        values[[one, other]] = values[[other, one]]
        point_cloud.write_attribute(cloud, attributes.LOG_SH[0], values)
        assert fingerprint(cloud) != before, (one, other)
        values[[one, other]] = values[[other, one]]
        point_cloud.write_attribute(cloud, attributes.LOG_SH[0], values)
        assert fingerprint(cloud) == before


def test_the_learned_tone_mapper_makes_a_group_of_its_own(registered, renderer, make_model, write):
    model = make_model(count=10, degree=0)
    places = np.linspace(-4.0, 4.0, 9, dtype=np.float32)
    curve = np.repeat(1.0 / (1.0 + np.exp(-places))[:, None], 3, axis=1).astype(np.float32)
    model = dataclasses.replace(model, tone_curve_log_exposure=places, tone_curve=curve)
    path = write(model)
    linear, learned = (model_import.import_model(path) for _ in range(2))
    for target in (linear, learned):
        target.physhdr_viewport = "SPLATS"
    nodes.set_input(nodes.find_modifier(learned), nodes.TONE_MAPPER, True)
    tones = [tone for tone, _ in groups().values()]
    assert sorted(tone is None for tone in tones) == [False, True]
    (tone,) = [tone for tone in tones if tone is not None]
    np.testing.assert_array_equal(tone.values, curve)
    values, start, step = tone.resampled(17)
    assert (start, step) == (-4.0, 0.5)
    np.testing.assert_allclose(values[::2], curve, atol=1e-7)


def test_a_slow_gpu_shows_the_last_picture_and_ends_sharp(renderer, monkeypatch):
    """With no time at all each redraw draws one portion; a moved view keeps what it had until then."""
    monkeypatch.setattr(splats, "BUDGET_SECONDS", 1e-9)
    monkeypatch.setattr(splats, "REST_SECONDS", 0.0)
    rng = np.random.default_rng(2)
    count = 3 * splats.PORTION
    arrays = SplatArrays(
        position=np.column_stack([rng.uniform(-1, 1, (count, 2)), -rng.uniform(2, 6, count)]).astype(
            np.float32
        ),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        scale=np.full((count, 3), 0.01, np.float32),
        opacity=np.full(count, 0.5, np.float32),
        log_sh=np.zeros((1, count, 3), np.float32),
        light=np.ones((1, count, 3), np.float32),
    )
    items = [Item(SplatTextures(arrays), np.eye(4))]
    view = splats._GroupView()

    def redraw(camera, until) -> tuple:
        for redraws in range(1, 40):
            drawing, wake_in = view.update(items, camera)
            if until(drawing):
                return drawing, wake_in, redraws
        raise AssertionError("it never came")

    small, wake_in, redraws = redraw(CAMERA, lambda drawing: drawing is not None)
    assert redraws > 1 and small.camera.width < SIZE and wake_in == 0.0
    sharp, wake_in, redraws = redraw(CAMERA, lambda drawing: view.is_sharp)
    assert redraws > 1 and sharp.camera.width == SIZE and wake_in is None
    np.testing.assert_array_equal(sharp.target.read()[0], renderer.render(items, CAMERA).read()[0])

    moved = ViewCamera(np.eye(4), SIZE, SIZE, FOCAL, FOCAL, 30.0, 30.0)
    drawing, wake_in = view.update(items, moved)
    assert drawing is sharp and wake_in == 0.0, "the one before, until the next is done"
    again, _, _ = redraw(moved, lambda drawing: view.is_sharp)
    assert again.camera.key == moved.key

    # A view that jumps gets a coarse picture of where it is now, however little time there is.
    monkeypatch.setattr(splats, "JUMP_SECONDS", 60.0)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[:3, 3] = 0.0, 0.0, -8.0
    behind = ViewCamera(turned, SIZE, SIZE, FOCAL, FOCAL, 30.0, 30.0)
    drawing, wake_in = view.update(items, behind)
    assert drawing is not again and drawing.camera.width < SIZE / 3 and drawing.is_complete
    np.testing.assert_array_equal(drawing.camera.camera_to_world, behind.camera_to_world)


def test_what_the_models_cameras_saw_is_known_where_it_stands_in_the_world(
    registered, renderer, make_model, write, look_at
):
    camera = ListedCamera("one", look_at(0.0, -3.0, 1.0), 60, 40, 70.0, 70.0, 30.0, 20.0)
    target = model_import.import_model(write(dataclasses.replace(make_model(count=60), cameras=(camera,))))
    target.physhdr_viewport = "SPLATS"
    target.location, target.scale = (1.0, 2.0, 3.0), (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()

    def shown():
        return list(splats.shown_objects(bpy.context.view_layer, bpy.context.evaluated_depsgraph_get()))

    (rows,) = splats.seen_of(shown())
    place = np.array(target.matrix_world) @ camera.camera_to_world @ (0.3, 0.1, -2.0, 1.0)
    across, down, ahead = rows @ place
    assert (across / ahead, down / ahead) == pytest.approx(
        (0.3 / 2.0 * 70.0 / 30.0, -0.1 / 2.0 * 70.0 / 20.0)
    )
    # Beside a model that brought none nothing is dimmed, nor is a confidence.
    other = model_import.import_model(write(make_model(count=60)))
    other.physhdr_viewport = "SPLATS"
    assert splats.seen_of(shown()) is None
    bpy.data.objects.remove(other)
    assert splats.seen_of(shown()) is not None
    target.data["physhdr_cameras"] = "nonsense"
    assert splats.seen_of(shown()) is None
