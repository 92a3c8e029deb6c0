# SPDX-License-Identifier: GPL-3.0-or-later
"""One render of one pose: lights that add up, geometry in its place, settings that come back."""

import math
from contextlib import contextmanager

import bpy
import numpy as np
import pytest

from physhdr.synth import animation, noise, objects, settings
from physhdr.synth.built_in import built
from physhdr.synth.png import quantise
from physhdr.synth.progress import Report
from physhdr.synth.renderer import renderer, view_seed
from physhdr.synth.response import srgb
from physhdr.synth.rig import look_at
from physhdr.synth.stage import Stage

SIZE = (64, 48)
FOV = math.radians(50)  # the ball's, conftest


@contextmanager
def scene_of(name):
    """A built-in scene, its sky on a coarse map: that of a fine one takes Cycles longer than all pictures."""
    with built(name) as stage:
        if world := stage.scene.world:
            world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
        yield stage


def pose_of(stage):
    return look_at(np.array(stage.cameras.centre), np.array(stage.cameras.target))


def plain_render(stage, path, file_format="OPEN_EXR"):
    """What Blender itself saves of the scene as it stands, by its own camera and without our compositor."""
    scene = stage.scene
    group, scene.compositing_node_group = scene.compositing_node_group, None
    picture = scene.render.image_settings
    picture.file_format, picture.color_mode, picture.color_depth = file_format, "RGB", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=scene.name, layer=stage.view_layer.name)
    scene.compositing_node_group = group


def difference(a, b):
    """μ-law PSNR, as the noise floor is told."""
    maximum = float(b.max())
    error = np.mean((noise.mu_law(a, maximum) - noise.mu_law(b, maximum)) ** 2)
    return -10.0 * math.log10(error)


@pytest.mark.parametrize("name", ["ball", "interior"])
def test_lights_add_up_to_the_picture_that_blender_renders(tmp_path, readers, name):
    """The same seed and samples without denoising: the sum of the passes is Combined but for rounding."""
    with (
        scene_of(name) as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 8)),
        renderer(stage, denoise=False) as camera,
    ):
        passes = camera.render(pose_of(stage), 5, tmp_path / "passes.exr")
        plain_render(stage, tmp_path / "plain.exr")
        whole = readers.exr(tmp_path / "plain.exr")
    total = passes.radiance({})
    assert list(passes.lights) == list(stage.lights) and len(passes.lights) > 1
    assert all(light.max() > 0.1 for light in passes.lights.values())
    np.testing.assert_allclose(total, whole, rtol=2e-4, atol=1e-5)
    assert not list(tmp_path.glob("passes*"))


@pytest.mark.long
def test_denoised_lights_add_up_within_the_noise(tmp_path):
    """Each light is denoised apart: their sum is as near to the truth as the noise allows."""
    with (
        scene_of("interior") as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 32)),
    ):
        with renderer(stage, denoise=True) as camera:
            first = camera.render(pose_of(stage), 5, tmp_path / "a.exr").radiance({})
            again = camera.render(pose_of(stage), 6, tmp_path / "a.exr").radiance({})
        with renderer(stage, denoise=False) as camera:
            raw = camera.render(pose_of(stage), 5, tmp_path / "a.exr")
    assert difference(first, again) > difference(raw.radiance({}), again) + 3.0  # it denoises
    assert first.mean() == pytest.approx(raw.radiance({}).mean(), rel=0.03)  # and keeps the light
    assert raw.facts["samples"] == 32.0 and (raw.samples == 32.0).all()


def turn(stage, levels):
    """Set what each of these lights is linear in to its level times what it was."""
    for name, level in levels.items():
        for knob in stage.lights[name]:
            setattr(knob.owner, knob.attribute, level * knob.base)


def test_derived_light_is_that_of_a_relit_render(tmp_path):
    """The knobs turned and rendered directly, against the passes of one render weighted by numpy."""
    levels = {"ambient": 0.25, "pendant": 3.0, "standing": 0.0}
    with (
        scene_of("interior") as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 64)),
        renderer(stage, denoise=False) as camera,
    ):
        pose = pose_of(stage)
        passes = camera.render(pose, 5, tmp_path / "a.exr")
        again = camera.render(pose, 6, tmp_path / "a.exr")
        turn(stage, levels)
        found = camera.render(pose, 7, tmp_path / "a.exr").radiance({})
    derived, other = passes.radiance(levels), again.radiance(levels)
    floor = difference(derived, other)  # two renders of one thing
    assert difference(derived, found) > floor - 1.0
    assert derived.mean() == pytest.approx(found.mean(), rel=0.03)
    assert difference(passes.radiance({}), found) < floor - 4.0  # the levels matter


def test_brackets_are_what_blender_saves_at_that_exposure(tmp_path, readers):
    """Blender's Standard view at ``exposure`` EV is our response ``srgb`` at 2^EV seconds, to one code."""
    with (
        scene_of("interior") as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 4)),
        renderer(stage, denoise=False) as camera,
    ):
        radiance = camera.render(pose_of(stage), 5, tmp_path / "a.exr").radiance({}).astype(np.float64)
        for ev in (-3.0, 0.0, 3.0):
            stage.scene.view_settings.exposure = ev
            stage.scene.render.image_settings.file_format = "PNG"
            stage.scene.render.image_settings.color_depth = "8"
            image = bpy.data.images.new("hdr", *SIZE, float_buffer=True)
            image.colorspace_settings.name = "Linear Rec.709"
            rgba = np.dstack([radiance, np.ones(radiance.shape[:2])])[::-1]
            image.pixels.foreach_set(rgba.astype(np.float32).ravel())
            image.save_render(str(tmp_path / "theirs.png"), scene=stage.scene)
            bpy.data.images.remove(image)
            theirs = bpy.data.images.load(str(tmp_path / "theirs.png"))
            theirs.colorspace_settings.name = "Non-Color"
            codes = np.empty(SIZE[0] * SIZE[1] * 4, np.float32)
            theirs.pixels.foreach_get(codes)
            bpy.data.images.remove(theirs)
            codes = np.round(codes * 255.0).reshape(SIZE[1], SIZE[0], 4)[::-1, :, :3]
            ours = quantise(srgb(radiance * 2.0**ev)).astype(np.float64)
            assert np.abs(ours - codes).max() <= 1.0, ev
            assert 20.0 < ours.mean() < 240.0


def test_geometry_is_where_the_ball_is(tmp_path):
    """Depth, normal and object number against the closed form of a sphere, a floor and a camera."""
    with (
        built("ball") as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 64)),
        objects.numbered(stage, Report()) as numbers,
        renderer(stage, denoise=False) as camera,
    ):
        pose = pose_of(stage)
        passes = camera.render(pose, 5, tmp_path / "a.exr")
    assert numbers == {"ball": 1, "floor": 2, "bulb": 3}
    width, height = SIZE
    half = math.tan(FOV / 2)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ray = np.stack(
        [(2 * x / width - 1) * half, (1 - 2 * y / height) * half * height / width, -np.ones_like(x)], -1
    )
    ray = ray @ pose[:3, :3].T  # its part along the camera's axis is 1: its length is the depth
    origin = pose[:3, 3]

    def sphere(centre, radius):
        b, c = (ray * (origin - centre)).sum(-1), (origin - centre) @ (origin - centre) - radius**2
        a = (ray**2).sum(-1)
        root = b**2 - a * c
        return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)

    ball, bulb = sphere(np.zeros(3), 1.0), sphere(np.array([1.6, -1.5, 0.2]), 0.35)
    floor = (-1.0 - origin[2]) / np.where(ray[..., 2] < 0, ray[..., 2], -np.inf)
    place = origin + np.nan_to_num(floor, posinf=0.0)[..., None] * ray
    on_floor = (ray[..., 2] < 0) & (np.abs(place[..., :2]).max(-1) < 6.0)
    floor = np.where(on_floor, floor, np.inf)
    depth = np.minimum(np.minimum(ball, bulb), floor)
    index = np.select([~np.isfinite(depth), depth == ball, depth == floor], [0, 1, 2], 3)
    same = np.ones(index.shape, bool)  # pixels whose neighbours show the same: there a sample cannot miss it
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            same &= np.roll(index, (dy, dx), (0, 1)) == index
    same[[0, -1]] = same[:, [0, -1]] = False
    assert all((same & (index == k)).sum() > 10 for k in range(4))
    np.testing.assert_array_equal(passes.index[same], index[same])
    assert (passes.depth[same & (index == 0)] > 1e9).all()
    # The depth is that of one sample within a pixel and a half: as much as it changes there.
    slope = sum(np.abs(d) for d in np.gradient(np.where(np.isfinite(depth), depth, 0.0)))
    on_ball = same & (index == 1) & (slope < 0.05)
    for where in (on_ball, same & (index == 2)):
        assert where.sum() > 50
        error = np.abs(passes.depth - depth)[where]
        assert (error < 1.5 * slope[where] + 0.01).all() and error.mean() < 0.05
    normal = (origin + ball[..., None] * ray)[on_ball]
    assert (np.sum(passes.normal[on_ball] * normal, -1) > 0.99).all()
    upward = passes.normal[same & (index == 2)][:, 2]
    assert (
        np.median(upward) == pytest.approx(1.0, abs=1e-5) and upward.min() > 0.9
    )  # at its rim others mix in


def test_object_numbers_are_put_back():
    with built("ball") as stage:
        items = list(stage.scene.collection.all_objects)
        items[0].pass_index = 7
        with pytest.raises(ZeroDivisionError), objects.numbered(stage, Report()) as numbers:
            assert items[0].pass_index == numbers["ball"] == 1
            raise ZeroDivisionError
        assert [item.pass_index for item in items] == [7, *[0] * (len(items) - 1)]


@pytest.mark.long
def test_adaptive_sampling_spends_fewer_samples_where_there_is_no_noise(tmp_path):
    with built("ball") as stage, objects.numbered(stage, Report()):
        taken = {}
        for threshold in (0.0, 0.05):
            wanted = settings.ground_truth(SIZE, 256, noise_threshold=threshold)
            with settings.applied(stage.scene, wanted), renderer(stage, denoise=False) as camera:
                taken[threshold] = camera.render(pose_of(stage), 5, tmp_path / "a.exr")
    assert (taken[0.0].samples == 256.0).all()
    fewer = taken[0.05]
    assert fewer.samples.max() <= 256.0 and fewer.facts["samples"] < 128.0
    assert fewer.facts["samples"] == pytest.approx(fewer.samples.mean(), abs=0.01)
    assert fewer.samples.max() > fewer.samples.min() >= 1.0
    assert fewer.samples[fewer.index == 2].mean() > 1.5 * fewer.samples[fewer.index == 0].mean()


def test_samples_are_told_where_all_pixels_end_early(tmp_path):
    """Cycles' own pass tells only shares: 1 everywhere when it ends before the most that it may take."""
    with built("ball") as stage:
        wanted = settings.ground_truth(SIZE, 256, noise_threshold=0.9)
        with settings.applied(stage.scene, wanted), renderer(stage, denoise=False) as camera:
            taken = camera.render(pose_of(stage), 5, tmp_path / "a.exr")
    assert taken.samples.max() <= 64.0 and (taken.samples == np.round(taken.samples)).all()
    assert not bpy.app.handlers.render_stats


@pytest.mark.parametrize("sigma", [0.005, 0.02])
def test_the_noise_estimate_finds_known_noise(sigma):
    """Gaussian noise on the μ-law of a smooth picture: both ways to estimate it find its PSNR."""
    x, y = np.meshgrid(np.linspace(0, 1, 128), np.linspace(0, 1, 96))
    smooth = np.repeat((0.3 + 0.4 * x * y + 0.2 * np.sin(3 * x))[..., None], 3, -1)
    noisy = smooth + np.random.default_rng(1).normal(0.0, sigma, smooth.shape)
    radiance, clean = (np.expm1(value * np.log1p(noise.MU)) / noise.MU for value in (noisy, smooth))
    for image in (radiance, clean):
        image[0, 0] = 1.0  # the maximum, over which μ-law is taken
    truth = -20.0 * math.log10(sigma)
    assert noise.estimate(radiance, clean) == pytest.approx(truth, abs=0.2)
    assert noise.estimate(radiance, None) == pytest.approx(truth, abs=0.5)


def test_settings_come_back_after_an_error():
    scene = bpy.data.scenes.new("mine")
    try:
        wanted = settings.ground_truth((64, 48), 7, noise_threshold=0.1)
        scene.cycles.samples, scene.render.dither_intensity = 123, 0.75
        scene.view_settings.view_transform = "AgX"
        before = {path: _get(scene, path) for path, _ in wanted}
        with pytest.raises(ZeroDivisionError), settings.applied(scene, wanted) as record:
            assert (scene.cycles.samples, scene.view_settings.view_transform) == (7, "Standard")
            assert record["scene.cycles.samples"] == 7
            assert {f"scene.{path}" for path, _ in wanted} <= record.keys()
            raise ZeroDivisionError
        assert {path: _get(scene, path) for path, _ in wanted} == before
    finally:
        bpy.data.scenes.remove(scene)


def animated(scene):
    """Keyframes, drivers and an NLA strip that would spoil every picture; returns all F-curves."""
    scene.cycles.film_exposure = 4.0
    scene.keyframe_insert("cycles.film_exposure", frame=1)
    scene.keyframe_insert("cycles.max_bounces", frame=1)
    data = scene.animation_data
    strip = data.nla_tracks.new().strips.new("keys", 1, data.action)
    below, slot = strip.action, data.action_slot
    data.action = bpy.data.actions.new("above")
    layer = scene.view_layers[0]
    layer.samples, layer.cycles.pass_debug_sample_count = 1, False
    for name in ("samples", "use_pass_z", "cycles.pass_debug_sample_count"):
        scene.keyframe_insert(f"{layer.path_from_id()}.{name}", frame=1)
    scene.cycles.sample_clamp_indirect = 0.01
    scene.keyframe_insert("cycles.sample_clamp_indirect", frame=1)
    scene.driver_add("cycles.seed").driver.expression = "frame"
    scene.driver_add("cycles.samples").driver.expression = "2"
    layer.samples = 0  # as open_scene sets it
    bags = [
        below.layers[0].strips[0].channelbag(slot),
        data.action.layers[0].strips[0].channelbag(data.action_slot),
    ]
    return [*data.drivers, *(curve for bag in bags for curve in bag.fcurves)]


def test_the_scenes_animation_does_not_win_over_our_settings(tmp_path):
    """Every pass, bit for bit, is that of a scene without animation, which is as before afterwards."""
    seeds = 1759223375, 1411851497  # more bits than a float has

    def rendered(stage):
        with (
            settings.applied(stage.scene, settings.ground_truth((16, 12), 4)),
            renderer(stage, denoise=False) as camera,
        ):
            return [camera.render(pose_of(stage), seed, tmp_path / "a.exr") for seed in seeds]

    with built("ball") as stage:
        expected = rendered(stage)
        curves = animated(stage.scene)
        next(curve for curve in curves if curve.data_path == "cycles.max_bounces").mute = True
        before = [(curve.data_path, curve.mute, curve.is_valid) for curve in curves]
        found = rendered(stage)
        assert [(curve.data_path, curve.mute, curve.is_valid) for curve in curves] == before
    assert len(curves) == 8 and (expected[0].raw != expected[1].raw).any()
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours.raw, theirs.raw)
        np.testing.assert_array_equal(ours.depth, theirs.depth)
        np.testing.assert_array_equal(ours.samples, theirs.samples)


def test_only_what_is_set_is_muted_also_before_an_error():
    scene = bpy.data.scenes.new("mine")
    try:
        curves = animated(scene)
        before = [(curve.data_path, curve.mute) for curve in curves]
        with (
            pytest.raises(ZeroDivisionError),
            animation.muted(scene, {"cycles.seed", "cycles.film_exposure"}),
        ):
            muted = {path for curve, (path, _) in zip(curves, before, strict=True) if curve.mute}
            assert muted == {"cycles.seed", "cycles.film_exposure"}
            raise ZeroDivisionError
        assert [(curve.data_path, curve.mute) for curve in curves] == before
    finally:
        bpy.data.scenes.remove(scene)


@pytest.mark.parametrize("name", ["a{b}c", "}{{"])
def test_a_path_may_have_braces(tmp_path, name):
    """Which Blender takes for the names of variables to fill in."""
    with (
        built("ball") as stage,
        settings.applied(stage.scene, settings.ground_truth((16, 12), 1)),
        renderer(stage, denoise=False) as camera,
    ):
        picture = camera.render(pose_of(stage), 5, tmp_path / name / f"{name}.exr")
    assert picture.depth.shape == (12, 16)


def test_settings_come_back_when_one_is_refused():
    scene = bpy.data.scenes.new("mine")
    try:
        samples = scene.cycles.samples
        with (
            pytest.raises(TypeError),
            settings.applied(scene, [("cycles.samples", 3), ("render.engine", "NONE")]),
        ):
            pass
        assert scene.cycles.samples == samples
    finally:
        bpy.data.scenes.remove(scene)


def test_passes_and_compositor_come_back_after_an_error():
    scene = bpy.data.scenes.new("mine")
    tree = bpy.data.node_groups.new("mine", "CompositorNodeTree")
    try:
        scene.compositing_node_group = tree
        layer = scene.view_layers[0]
        layer.use_pass_normal = True
        before = set(bpy.data.node_groups)
        stage = Stage(scene=scene, cameras=None, lights={}, layer=layer)
        with pytest.raises(ZeroDivisionError), settings.applied(scene, settings.ground_truth(SIZE, 1)):
            from physhdr.synth import compositor

            with compositor.connected(stage, denoise=True):
                assert scene.compositing_node_group != tree and layer.use_pass_z
                raise ZeroDivisionError
        assert scene.compositing_node_group == tree and set(bpy.data.node_groups) == before
        assert layer.use_pass_normal and not layer.use_pass_object_index
        assert not layer.cycles.denoising_store_passes and not layer.cycles.pass_debug_sample_count
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.node_groups.remove(tree)


def _get(scene, path):
    return scene.path_resolve(path)


def test_no_two_pictures_share_a_seed():
    names = [f"{split}_{i:03d}" for split in ("train", "test", "lit") for i in range(500)]
    assert len({view_seed(0, name) for name in names}) == len(names)
    assert view_seed(0, names[0]) != view_seed(1, names[0])


def test_another_seed_is_other_noise_and_the_same_seed_the_same(tmp_path):
    """Also with persistent data, where Cycles does not notice a new seed by itself."""
    with (
        built("ball") as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, 2)),
        renderer(stage, denoise=False) as camera,
    ):
        shots = [camera.render(pose_of(stage), seed, tmp_path / "a.exr").radiance({}) for seed in (1, 2, 1)]
    assert np.abs(shots[0] - shots[1]).mean() > 1e-4
    np.testing.assert_array_equal(shots[0], shots[2])
