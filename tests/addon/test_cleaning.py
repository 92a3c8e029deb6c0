# SPDX-License-Identifier: GPL-3.0-or-later
"""What is hidden of a model: the nodes and numpy agree on every Gaussian, and both with the definitions."""

import dataclasses
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.blender import render_size  # noqa: E402
from physhdr.addon.model import attributes, cleaning, look, model_import, nodes, point_cloud  # noqa: E402
from physhdr.addon.model.cleaning import EVEN, Cleaning, RenderCamera  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402

COUNT = 4000


@pytest.fixture
def add(scene, make_model, write, look_at):
    """A model whose Gaussians have their own numbers as opacity's last bits, its modifier and a camera."""

    def add(count: int = COUNT, **options):
        model = make_model(count=count, **options)
        target = model_import.import_model(write(model))
        camera = render.add_camera(scene, look_at(2.0, -3.0, 1.5), 0.4)
        # A point tells which it is.
        point_cloud.write_attribute(target.data, attributes.Attribute("index", "FLOAT"), np.arange(count))
        return model, target, target.modifiers[0], camera

    return add


def drawn(target) -> np.ndarray:
    """Which Gaussians the evaluated instances are, by number."""
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    instances = geometry.instances_pointcloud()
    if instances is None:
        return np.zeros(0, int)
    return point_cloud.read_attribute(instances, "index").astype(int)


def agreed(target, with_camera: bool = False) -> np.ndarray:
    """Which Gaussians are kept, after checking that nodes and numpy say the same."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    wanted = look.cleaning_of(target, depsgraph)
    assert wanted == look.look_of(target, depsgraph).cleaning == look.cleaning_of(target)
    camera = render_camera(target, depsgraph) if with_camera else None
    keep = look.kept_of(target.data, wanted, camera)
    np.testing.assert_array_equal(drawn(target), np.flatnonzero(keep))
    return keep


def render_camera(target, depsgraph) -> RenderCamera | None:
    """The scene's active camera in the space of the model ``target``; None where the scene has none."""
    scene = depsgraph.scene
    if scene is None or scene.camera is None:
        return None
    camera = scene.camera.evaluated_get(depsgraph)
    lens = camera.data
    if not isinstance(lens, bpy.types.Camera):
        return None
    placed = target.evaluated_get(depsgraph).matrix_world
    pose = placed.inverted_safe() @ camera.matrix_world
    axes = pose.to_3x3().transposed()
    right, up, back = (place_of(axis.normalized()) for axis in axes)
    sides = sorted(abs(side) for side in placed.to_scale())
    render, (width, height) = scene.render, render_size(scene)
    projection = camera.calc_matrix_camera(
        depsgraph,
        x=width,
        y=height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    return RenderCamera(
        place=place_of(pose.translation),
        right=right,
        up=up,
        back=back,
        projection=tuple(np.array(projection).reshape(-1).tolist()),
        is_orthographic=lens.type == "ORTHO",
        unit=axes[0].length / camera.matrix_world.to_3x3().transposed()[0].length,
        is_even=sides[2] <= sides[0] * EVEN,
    )


def place_of(vector) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def box(scene, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> "bpy.types.Object":
    empty = bpy.data.objects.new("box", None)
    empty.location = x, y, z
    scene.collection.objects.link(empty)
    return empty


def test_by_default_nothing_is_hidden(add):
    _, target, modifier, _ = add()
    assert agreed(target).all()
    assert look.cleaning_of(target) == Cleaning() and look.cleaning_of(target).keeps_everything
    assert set(nodes.CLEANING + nodes.CULLING) <= set(nodes.identifiers(modifier))


def test_the_tree_with_nothing_hidden_gives_the_bits_of_the_one_before(add):
    """The sum over the bands is switched at every degree; its order is that of ``spherical_harmonics``."""
    model, target, modifier, _ = add(degree=3)
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    before = point_cloud.read_attribute(geometry.instances_pointcloud(), "physhdr:radiance")
    # What hides nothing must change nothing, though the points now go through the separation.
    nodes.set_input(modifier, nodes.LARGEST_SIZE, 1e3)
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    after = point_cloud.read_attribute(geometry.instances_pointcloud(), "physhdr:radiance")
    np.testing.assert_array_equal(before, after)
    assert before.shape == (model.count, 4)


@pytest.mark.parametrize(
    ("name", "value", "values"),
    [
        (nodes.LARGEST_SIZE, "at", lambda m: -m.scale.max(axis=1)),
        (nodes.SMALLEST_OPACITY, "at", lambda m: m.opacity),
        (nodes.LARGEST_ELONGATION, 2.5, lambda m: -np.sort(m.scale)[:, 2] / np.sort(m.scale)[:, 1]),
        (nodes.LARGEST_DISTANCE, "at", lambda m: -np.linalg.norm(m.position, axis=1)),
        (nodes.SMALLEST_CONFIDENCE, "at", lambda m: m.confidence),
    ],
)
def test_a_limit_keeps_what_is_on_its_right_side(add, name, value, values):
    """Also a Gaussian that lies on the limit, to the bit: it is kept."""
    model, target, modifier, _ = add(confidence=True)
    measured = values(model).astype(np.float32)
    limit = float(np.sort(measured)[COUNT // 3]) if value == "at" else -value
    nodes.set_input(modifier, name, abs(limit))
    keep = agreed(target)
    exact = measured >= np.float32(limit)
    near = np.abs(measured - limit) < 1e-6 * abs(limit)
    np.testing.assert_array_equal(keep[~near], exact[~near])
    assert 0.2 < keep.mean() < 0.9
    if value == "at" and name != nodes.LARGEST_DISTANCE:
        assert keep.sum() == COUNT - COUNT // 3 and near.sum() >= 1


def test_a_model_of_an_older_file_has_no_confidence_and_keeps_everything(add):
    _, target, modifier, _ = add()
    assert attributes.CONFIDENCE.name not in target.data.attributes
    nodes.set_input(modifier, nodes.SMALLEST_CONFIDENCE, 0.9)
    assert agreed(target).all()


@pytest.mark.parametrize("keep_outside", [False, True])
def test_the_crop_box_is_the_cube_of_its_object(add, scene, keep_outside: bool):
    model, target, modifier, _ = add()
    target.location, target.rotation_euler, target.scale = (1.0, -2.0, 0.5), (0.3, -0.8, 1.9), (2.0,) * 3
    crop = box(scene, 1.2, -2.1, 0.3)
    crop.rotation_euler, crop.scale = (0.4, 0.1, -0.7), (0.5, 0.9, 0.7)
    nodes.set_input(modifier, nodes.CROP_BOX, crop)
    nodes.set_input(modifier, nodes.KEEP_OUTSIDE, keep_outside)
    assert agreed(target).all()  # not yet switched on
    nodes.set_input(modifier, nodes.CROP, True)
    keep = agreed(target)
    matrix = np.array(crop.matrix_world.inverted()) @ np.array(target.matrix_world)
    inside = np.abs(model.position @ matrix[:3, :3].T + matrix[:3, 3]).max(axis=1) <= 1.0
    assert (keep != (inside ^ keep_outside)).sum() <= 1  # one on a face, by rounding
    assert 0.1 < inside.mean() < 0.9
    crop.location.x = 50.0
    assert agreed(target).all() if keep_outside else not agreed(target).any()


def test_gaussians_on_the_faces_of_the_box_are_inside(add, scene):
    """Coordinates that are exact in binary, on all faces, edges and corners, and just beyond."""
    _, target, modifier, _ = add(count=125)
    grid = np.stack(np.meshgrid(*[[-2.0, -1.0, 0.0, 1.0, 2.0]] * 3), axis=-1).reshape(-1, 3)
    beyond = np.where(np.abs(grid) == 2.0, np.sign(grid) * np.nextafter(np.float32(1.5), 2), grid)
    point_cloud.write_attribute(target.data, attributes.POSITION, beyond)
    crop = box(scene)
    crop.scale = (1.5, 1.0, 1.0)
    nodes.set_input(modifier, nodes.CROP, True)
    nodes.set_input(modifier, nodes.CROP_BOX, crop)
    keep = agreed(target)
    np.testing.assert_array_equal(keep, (np.abs(beyond) <= [1.5, 1.0, 1.0]).all(axis=1))
    assert keep.sum() == 27


def test_a_box_that_is_none_or_flat_crops_nothing(add, scene):
    _, target, modifier, _ = add(count=50)
    nodes.set_input(modifier, nodes.CROP, True)
    assert agreed(target).all()
    crop = box(scene, x=9.0)
    nodes.set_input(modifier, nodes.CROP_BOX, crop)
    assert not agreed(target).any()
    crop.scale.y = 0.0
    assert agreed(target).all()
    crop.scale = (1e-3, 1e-3, 1e-3)  # small, not flat
    assert not agreed(target).any()


def test_distance_is_from_an_object_wherever_it_hangs(add, scene):
    model, target, modifier, _ = add()
    target.scale, target.location = (4.0,) * 3, (0.0, 0.0, 3.0)
    centre = box(scene, 0.5, 0.25, -0.125)
    centre.parent = target
    nodes.set_input(modifier, nodes.LARGEST_DISTANCE, 0.5)
    nodes.set_input(modifier, nodes.DISTANCE_FROM, centre)
    keep = agreed(target)
    distance = np.linalg.norm(model.position - [0.5, 0.25, -0.125], axis=1)
    near = np.abs(distance - 0.5) < 1e-6
    np.testing.assert_array_equal(keep[~near], distance[~near] < 0.5)
    assert 0.05 < keep.mean() < 0.9


def test_photos_clear_only_what_was_measured(add):
    _, target, modifier, _ = add()
    nodes.set_input(modifier, nodes.CLEAR_OF_PHOTOS, 0.5)
    assert agreed(target).all()
    distance = np.linspace(0.0, 1.0, COUNT, dtype=np.float32)
    point_cloud.write_attribute(target.data, attributes.CAMERA_DISTANCE, distance)
    target.data.update_tag()
    np.testing.assert_array_equal(agreed(target), distance >= np.float32(0.5))


def test_keyframes_hide_and_show(add, scene):
    model, target, modifier, _ = add()
    path = nodes.input_data_path(modifier, nodes.SMALLEST_OPACITY)
    for frame, value in [(1, 0.0), (11, 1.0)]:
        nodes.set_input(modifier, nodes.SMALLEST_OPACITY, value)
        target.keyframe_insert(path, frame=frame)
    counts = []
    for frame in (1, 6, 11):
        scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        keep = look.kept_of(target.data, look.cleaning_of(target, depsgraph))
        np.testing.assert_array_equal(drawn(target), np.flatnonzero(keep))
        counts.append(keep.sum())
    assert counts[0] == COUNT and 0 < counts[1] < COUNT and counts[2] == (model.opacity == 1.0).sum()


@pytest.mark.parametrize("scale", [3.0, 0.4, -0.8])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_only_in_view_keeps_what_reaches_into_the_picture(add, scene, kind: str, scale: float):
    _, target, modifier, camera = add()
    target.scale = (scale,) * 3
    target.rotation_euler = (0.2, 0.5, -0.4)
    camera.data.type, camera.data.ortho_scale = kind, abs(scale) / 2.0
    camera.data.lens /= min(1.0, abs(scale) / 2.0)
    camera.data.shift_x, camera.data.shift_y = 0.3, -0.1
    render.set_resolution(scene, 300, 200)
    nodes.set_input(modifier, nodes.ONLY_IN_VIEW, True)
    nodes.set_input(modifier, nodes.VIEW_MARGIN, 0.0)
    keep = agreed(target, with_camera=True)
    # Those whose centre is in the picture must be there.
    from bpy_extras.object_utils import world_to_camera_view

    centres = [target.matrix_world @ point.co for point in target.data.points]
    seen = np.array([world_to_camera_view(scene, camera, centre)[:] for centre in centres])
    in_picture = (seen[:, :2] > 1e-4).all(axis=1) & (seen[:, :2] < 0.9999).all(axis=1) & (seen[:, 2] > 0.0)
    assert keep[in_picture].all()
    assert in_picture.sum() < keep.sum() < 0.95 * COUNT
    # And without a camera nobody is left out.
    scene.camera = None
    assert agreed(target, with_camera=True).all()


def test_nobody_is_out_of_view_of_a_model_that_is_stretched(add):
    _, target, modifier, _ = add()
    target.scale = (3.0, 3.0, 3.0001)
    nodes.set_input(modifier, nodes.ONLY_IN_VIEW, True)
    assert 0.1 < agreed(target, with_camera=True).mean() < 0.9
    target.scale.z = 2.0
    assert agreed(target, with_camera=True).all()


@pytest.mark.long
def test_what_is_out_of_view_is_not_missed(add, scene, tmp_path):
    """The picture is the same with and without what the camera does not see, also through its low-pass."""
    _, target, modifier, _ = add(count=500)
    target.scale = (3.0,) * 3
    render.prepare_cycles(scene)
    render.set_resolution(scene, 48, 32)
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, True)
    nodes.set_input(modifier, nodes.IMAGE_WIDTH, 48)
    pictures = []
    for only_in_view in (False, True):
        nodes.set_input(modifier, nodes.ONLY_IN_VIEW, only_in_view)
        render.render_exr(scene, tmp_path / "a.exr")
        pictures.append(render.read_exr(tmp_path / "a.exr"))
    assert agreed_count(target) < 466
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-5, atol=1e-6)
    assert pictures[0].max() > 0.1


def agreed_count(target) -> int:
    return int(agreed(target, with_camera=True).sum())


def test_a_margin_keeps_more(add, scene):
    _, target, modifier, _ = add()
    target.scale = (3.0,) * 3
    nodes.set_input(modifier, nodes.ONLY_IN_VIEW, True)
    counts = []
    for margin in (0.0, 0.25, 1.0):
        nodes.set_input(modifier, nodes.VIEW_MARGIN, margin)
        counts.append(agreed_count(target))
    assert counts[0] < counts[1] < counts[2] <= COUNT


def test_near_and_far_of_the_camera(add, scene):
    model, target, modifier, camera = add()
    bpy.context.view_layer.update()
    distance = np.linalg.norm(model.position - np.array(camera.matrix_world.translation), axis=1)
    low, high = (float(value) for value in np.quantile(distance, [0.2, 0.7]))
    nodes.set_input(modifier, nodes.CLEAR_OF_CAMERA, low)
    nodes.set_input(modifier, nodes.FARTHEST, high)
    keep = agreed(target, with_camera=True)
    assert abs(keep.mean() - 0.5) < 1e-3
    # From elsewhere (the 3D view, a bake) it hides nothing.
    assert look.kept_of(target.data, look.cleaning_of(target)).all()
    assert look.cleaning_of(target).without_camera().keeps_everything


@pytest.mark.parametrize("limit", [0, 1, 2, 3])
def test_an_sh_limit_is_the_model_without_the_higher_degrees(add, limit: int):
    model, target, modifier, camera = add(count=60, degree=3)
    nodes.set_input(modifier, nodes.SH_DEGREE, limit)
    assert look.look_of(target).sh_limit == limit
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    got = point_cloud.read_attribute(geometry.instances_pointcloud(), "physhdr:radiance")[:, :3]
    directions = model.position - np.array(camera.matrix_world.translation)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lower = dataclasses.replace(model, log_radiance_sh=model.log_radiance_sh[:, : (limit + 1) ** 2])
    np.testing.assert_allclose(got, lower.radiance(directions), rtol=2e-5)


def test_every_limit_at_once_is_all_of_them(add, scene):
    """Random clouds, random limits: nodes and numpy draw the same Gaussians."""
    _, target, modifier, _ = add(confidence=True)
    rng = np.random.default_rng(3)
    point_cloud.write_attribute(target.data, attributes.CAMERA_DISTANCE, rng.uniform(0, 1, COUNT))
    crop, centre = box(scene), box(scene)
    for name, value in [(nodes.CROP, True), (nodes.CROP_BOX, crop), (nodes.DISTANCE_FROM, centre)]:
        nodes.set_input(modifier, name, value)
    nodes.set_input(modifier, nodes.ONLY_IN_VIEW, True)
    kept = []
    for _ in range(6):
        for each in (target, crop, centre):
            each.location = rng.normal(size=3) * 0.1
            each.rotation_euler = rng.uniform(-3, 3, 3)
            each.scale = np.full(3, rng.uniform(0.8, 1.6))
        limits = {
            nodes.LARGEST_SIZE: rng.uniform(0.15, 0.3),
            nodes.SMALLEST_OPACITY: rng.uniform(0.0, 0.3),
            nodes.LARGEST_ELONGATION: rng.uniform(2.0, 8.0),
            nodes.LARGEST_DISTANCE: rng.uniform(0.8, 1.2),
            nodes.CLEAR_OF_PHOTOS: rng.uniform(0.0, 0.2),
            nodes.SMALLEST_CONFIDENCE: rng.uniform(0.0, 0.2),
            nodes.CLEAR_OF_CAMERA: rng.uniform(0.0, 2.0),
            nodes.FARTHEST: rng.uniform(4.0, 6.0),
        }
        for name, value in limits.items():
            nodes.set_input(modifier, name, float(value))
        kept.append(agreed(target, with_camera=True).mean())
    assert min(kept) > 0.0 and max(kept) < 0.9


def test_elongation_is_of_a_needle_not_of_a_plate():
    scale = np.array([[1.0, 1.0, 8.0], [8.0, 8.0, 0.01], [4.0, 2.0, 1.0], [0.0, 0.0, 0.0]], np.float32)
    np.testing.assert_array_equal(cleaning.middle_of(scale), [1.0, 8.0, 2.0, 0.0])
    np.testing.assert_array_equal(cleaning.elongation_of(scale), [8.0, 1.0, 2.0, 1.0])
    np.testing.assert_allclose(cleaning.REACH, math.sqrt(2.0 * math.log(255.0)), rtol=1e-6)
