# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view leaves out: nothing of the picture, and nearly all of what is elsewhere."""

import dataclasses

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
import gpu  # noqa: E402

from physhdr.addon.viewport import splat_renderer  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera, object_to_camera  # noqa: E402
from physhdr.addon.viewport.chunks import CHUNK, Chunks, chunks_of, morton_order  # noqa: E402
from physhdr.addon.viewport.splat_data import SplatArrays, SplatTextures  # noqa: E402
from physhdr.addon.viewport.splat_renderer import Item, SplatRenderer  # noqa: E402

SIZE = 64
COUNT = 20 * CHUNK + 77


@pytest.fixture(scope="module")
def renderer():
    gpu.init()
    return SplatRenderer()


def arrays(largest: float = 0.3, count: int = COUNT) -> SplatArrays:
    """Gaussians all around the origin, small and large, thin and round."""
    rng = np.random.default_rng(5)
    return SplatArrays(
        position=rng.uniform(-6.0, 6.0, (count, 3)).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        scale=np.exp(rng.uniform(np.log(0.002), np.log(largest), (count, 3))).astype(np.float32),
        opacity=rng.uniform(0.0, 1.0, count).astype(np.float32),
        log_sh=rng.normal(0.0, 1.0, (4, count, 3)).astype(np.float32),
        light=rng.uniform(0.0, 1.0, (1, count, 3)).astype(np.float32),
    )


def normalised(source: SplatArrays) -> SplatArrays:
    length = np.linalg.norm(source.rotation, axis=1, keepdims=True)
    return dataclasses.replace(source, rotation=source.rotation / length)


def turned(angle: float, place=(0.0, 0.0, 0.0)) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = place
    return pose


#: Angle, place, focal length, principal point, orthographic, the object's scale.
CAMERAS = [
    (0.0, (0.0, 0.0, 0.0), 80.0, 32.0, False, 1.0),
    (1.9, (0.5, -2.0, 1.0), 20.0, 32.0, False, 1.0),
    (0.1, (0.5, 0.0, 4.0), 120.0, 70.0, False, 0.4),
    (2.6, (1.0, 0.0, 3.0), 60.0, -10.0, False, 2.5),
    (0.7, (0.0, 0.0, 3.0), 9.0, 20.0, True, 1.3),
]


@pytest.mark.parametrize("case", CAMERAS)
def test_the_picture_is_the_same(renderer, monkeypatch, case):
    """To the last bit that of all chunks, from inside the Gaussians, with wide and shifted lenses."""
    angle, place, focal, centre, orthographic, scale = case
    camera = ViewCamera(turned(angle, place), SIZE, SIZE, focal, focal, centre, 32.0, orthographic)
    item = Item(SplatTextures(normalised(arrays())), np.diag([scale, scale, scale, 1.0]))
    drawing = renderer.render([item], camera)
    colour, depth = drawing.read()
    monkeypatch.setattr(Chunks, "visible", lambda self, *_: np.arange(len(self.radius)))
    whole_colour, whole_depth = renderer.render([item], camera).read()
    assert colour.any()
    np.testing.assert_array_equal(colour, whole_colour)
    np.testing.assert_array_equal(depth, whole_depth)


def test_most_of_what_is_elsewhere_is_left_out():
    """A lens of 44° from the middle of small Gaussians sees a small part of them."""
    source = arrays(largest=0.02, count=200 * CHUNK)
    order = morton_order(source.position)
    chunks = chunks_of(source.position[order], source.scale[order])
    camera = ViewCamera(np.eye(4), SIZE, SIZE, 80.0, 80.0, 32.0, 32.0)
    visible = chunks.visible(camera, object_to_camera(camera, np.eye(4)))
    pixel, depth = camera.project(source.position[order])
    inside = (depth > 0.01) & (pixel >= 0.0).all(axis=1) & (pixel <= SIZE).all(axis=1)
    needed = np.unique(np.flatnonzero(inside) // CHUNK)
    assert set(needed) <= set(visible)
    assert len(visible) < 0.45 * len(chunks.radius)


def test_neighbours_are_beside_each_other():
    """A chunk in Morton order is a small part of the whole, and the order has everything once."""
    position = np.random.default_rng(6).uniform(-1.0, 1.0, (64 * CHUNK, 3)).astype(np.float32)
    position[0] = 1e6  # one stray Gaussian must not spoil it
    order = morton_order(position)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(position)))
    chunks = chunks_of(position[order], np.zeros_like(position))
    # 64 chunks of a cube of side 2: cubes of side ½ have a ball of 0.43.
    assert np.median(chunks.radius) < 0.75
    assert len(morton_order(position[:0])) == 0 and len(chunks_of(position[:0], position[:0]).radius) == 0


def test_what_is_scaled_to_nothing_shows_nothing(renderer):
    """And does not keep others from being drawn; what is mirrored is drawn."""
    textures = SplatTextures(normalised(arrays(count=600)))
    camera = ViewCamera(turned(0.0, (0.0, 0.0, 12.0)), SIZE, SIZE, 60.0, 60.0, 32.0, 32.0)
    there = Item(textures, np.diag([-0.5, 0.5, 0.5, 1.0]))
    flat = [Item(textures, np.diag([*sides, 1.0])) for sides in [(1, 1, 0), (0, 0, 0), (1, np.nan, 1)]]
    alone = renderer.render([there], camera).read()[0]
    assert alone.any()
    np.testing.assert_array_equal(renderer.render([*flat, there], camera).read()[0], alone)
    assert not renderer.render(flat, camera).read()[0].any()


def test_more_than_a_picture_holds_are_the_nearest(renderer, monkeypatch):
    """Instances may be many; what is out of view takes no room."""
    monkeypatch.setattr(splat_renderer, "ROWS_MAX", 2)
    textures = SplatTextures(normalised(arrays(count=100)))
    camera = ViewCamera(np.eye(4), SIZE, SIZE, 60.0, 60.0, 32.0, 32.0)

    def at(depth: float) -> Item:
        place = np.diag([0.1, 0.1, 0.1, 1.0])
        place[2, 3] = -depth
        return Item(textures, place)

    def picture(*items: Item) -> np.ndarray:
        return renderer.render(items, camera).read()[0]

    wanted = picture(at(3.0), at(2.0))
    np.testing.assert_array_equal(picture(at(9.0), at(-5.0), at(3.0), at(-2.0), at(2.0), at(4.0)), wanted)
    assert (wanted != picture(at(2.0))).any()
    monkeypatch.setattr(splat_renderer, "ROWS_MAX", 0)
    np.testing.assert_array_equal(picture(at(3.0), at(2.0)), picture(at(2.0)))


def test_marks_follow_the_gaussians(renderer):
    """What is not kept is not drawn, what is selected is drawn in the tint, in the cloud's own order."""
    rows = np.arange(3)
    source = SplatArrays(
        position=np.array([(-1.5, 0, -4), (0, 0, -4.5), (1.5, 0, -5)], np.float32),
        rotation=np.tile(np.float32([1, 0, 0, 0]), (3, 1)),
        scale=np.full((3, 3), 0.1, np.float32),
        opacity=np.full(3, 0.9, np.float32),
        log_sh=np.zeros((1, 3, 3), np.float32),
        light=np.ones((1, 3, 3), np.float32),
    )
    textures = SplatTextures(source)
    camera = ViewCamera(np.eye(4), SIZE, SIZE, 60.0, 60.0, 32.0, 32.0)
    at = [tuple(int(value) for value in pixel[::-1]) for pixel in camera.project(source.position)[0]]

    def drawn(**marked) -> np.ndarray:
        marks = {name: textures.marks(np.isin(rows, chosen)) for name, chosen in marked.items()}
        colour, _ = renderer.render([Item(textures, np.eye(4), **marks)], camera).read()
        return np.array([colour[pixel] for pixel in at])

    for index in rows:
        alone = drawn(kept=[index])[:, 3] > 0.5
        assert alone.tolist() == [each == index for each in rows]
        colour = drawn(selected=[index])
        # Radiance 1 everywhere: white where it is not selected, the tint at 0.3 + 0.7 / 2 where it is.
        for each in rows:
            expected = np.array(renderer.selection_colour) * 0.65 if each == index else np.ones(3)
            np.testing.assert_allclose(colour[each, :3] / colour[each, 3], expected, rtol=1e-4, atol=1e-6)
    assert not drawn(kept=[]).any()


def test_the_degree_is_limited(renderer):
    """A limit of 1 draws what a model of degree 1 draws; 0 what is not view dependent."""
    source = normalised(arrays())
    first = dataclasses.replace(source, log_sh=source.log_sh[:1])
    camera = ViewCamera(np.eye(4), SIZE, SIZE, 60.0, 60.0, 32.0, 32.0)
    pictures = [
        renderer.render([item], camera).read()[0]
        for item in (
            Item(SplatTextures(source), np.eye(4), sh_limit=0),
            Item(SplatTextures(first), np.eye(4)),
            Item(SplatTextures(source), np.eye(4), sh_limit=1),
            Item(SplatTextures(source), np.eye(4)),
        )
    ]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(pictures[2], pictures[3])
    assert np.abs(pictures[1] - pictures[3]).max() > 0.1
