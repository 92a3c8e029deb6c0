# SPDX-License-Identifier: GPL-3.0-or-later
"""The overlay's compositing, drawn without a window into a framebuffer like a 3D view's."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
import gpu  # noqa: E402

from physhdr.addon.model.tone_curve import ToneCurve  # noqa: E402
from physhdr.addon.viewport import gpu_arrays, overlay, seen  # noqa: E402
from physhdr.addon.viewport.camera import ViewCamera, from_matrices  # noqa: E402
from physhdr.addon.viewport.overlay import Compositor, Layer, RenderedView, upload  # noqa: E402
from physhdr.bridge.camera_list import ListedCamera  # noqa: E402
from physhdr.bridge.errors import DataMismatchError  # noqa: E402
from physhdr.bridge.srgb import to_linear  # noqa: E402

WIDTH, HEIGHT = 60, 40
NEAR, FAR = 0.1, 100.0
#: A perspective window matrix as Blender makes it, with lens shift.
WINDOW = np.array(
    [
        [2.0, 0.0, 0.1, 0.0],
        [0.0, 3.0, -0.2, 0.0],
        [0.0, 0.0, -(FAR + NEAR) / (FAR - NEAR), -2.0 * FAR * NEAR / (FAR - NEAR)],
        [0.0, 0.0, -1.0, 0.0],
    ]
)


def camera_at(x: float) -> ViewCamera:
    view = np.eye(4)
    view[0, 3] = -x
    return from_matrices(view, WINDOW, WIDTH, HEIGHT)


def in_depth_buffer(depth: float) -> float:
    clip = WINDOW @ (0.0, 0.0, -depth, 1.0)
    return 0.5 * (1.0 + clip[2] / clip[3])


class View:
    """What a 3D view draws into: half float colours and a depth buffer, with one object at 5 m."""

    def __init__(self, colour=(0.25, 0.25, 0.25, 1.0), object_depth: float = 5.0) -> None:
        self.colour = gpu.types.GPUTexture((WIDTH, HEIGHT), format="RGBA16F")
        self.depth = gpu.types.GPUTexture((WIDTH, HEIGHT), format="DEPTH_COMPONENT32F")
        self.framebuffer = gpu.types.GPUFrameBuffer(depth_slot=self.depth, color_slots=(self.colour,))
        with self.framebuffer.bind():
            # A depth test that is off lets clears through.
            gpu.state.depth_mask_set(True)
            self.framebuffer.clear(color=colour, depth=in_depth_buffer(object_depth))

    def draw(self, compositor: Compositor, layer: Layer, camera: ViewCamera, **options) -> np.ndarray:
        with self.framebuffer.bind():
            compositor.draw(layer, camera, WINDOW, **options)
        return gpu_arrays.read_colour(self.framebuffer, (WIDTH, HEIGHT))


@pytest.fixture(scope="module")
def compositor():
    gpu.init()
    return Compositor()


def picture(depth: float | np.ndarray = 3.0, tone=None, camera: ViewCamera | None = None) -> RenderedView:
    """Noise, premultiplied, half covered, HDR; the top left pixel shows nothing."""
    camera = camera or camera_at(0.0)
    rgba = np.random.default_rng(0).uniform(0.0, 30.0, (camera.height, camera.width, 4)).astype(np.float32)
    rgba[..., 3] = 0.5
    rgba[0, 0] = 0.0
    return RenderedView(rgba, np.broadcast_to(np.float32(depth), rgba.shape[:2]).copy(), camera, tone)


def test_in_front_of_the_scene_it_covers_with_its_alpha(compositor):
    shown = picture(3.0)
    got = View().draw(compositor, upload(shown), shown.camera)
    np.testing.assert_allclose(
        got[..., :3], shown.rgba[..., :3] + (1.0 - shown.rgba[..., 3:]) * 0.25, rtol=2e-3
    )
    np.testing.assert_allclose(got[..., 3], 1.0, rtol=1e-3)


def test_behind_the_scene_it_is_hidden(compositor):
    shown = picture(5.01)
    got = View().draw(compositor, upload(shown), shown.camera)
    np.testing.assert_array_equal(got, np.broadcast_to([0.25, 0.25, 0.25, 1.0], got.shape))


def test_each_pixel_by_its_own_depth(compositor):
    """Left half in front of the object, right half behind it."""
    depth = np.full((HEIGHT, WIDTH), 4.9, np.float32)
    depth[:, WIDTH // 2 :] = 5.1
    shown = picture(depth)
    got = View().draw(compositor, upload(shown), shown.camera)
    changed = np.abs(got[..., :3] - 0.25).max(axis=2) > 1e-3
    expected = depth < 5.0
    expected[0, 0] = False
    np.testing.assert_array_equal(changed, expected)


def test_what_is_behind_it_is_erased_from_the_overlay(compositor):
    shown = picture(3.0)
    view = View(colour=(0.6, 0.4, 0.2, 0.8))
    got = view.draw(compositor, upload(shown), shown.camera, erase=True)
    np.testing.assert_allclose(
        got[5:, 5:], np.broadcast_to([0.3, 0.2, 0.1, 0.4], got[5:, 5:].shape), rtol=2e-3
    )
    np.testing.assert_allclose(got[0, 0], [0.6, 0.4, 0.2, 0.8], rtol=1e-3)


def test_half_as_many_pixels_are_stretched_over_the_same_view(compositor):
    """A ramp at half size comes out as the same ramp, and where it was."""
    small = camera_at(0.0).resized(WIDTH // 2, HEIGHT // 2)
    rgba = np.ones((HEIGHT // 2, WIDTH // 2, 4), np.float32)
    rgba[..., :3] = (np.arange(WIDTH // 2)[None, :, None] + 0.5) * 2.0
    shown = RenderedView(rgba, np.full(rgba.shape[:2], 3.0, np.float32), small)
    got = View().draw(compositor, upload(shown), camera_at(0.0))
    np.testing.assert_allclose(
        got[:, 1:-1, 0], np.broadcast_to(np.arange(1, WIDTH - 1) + 0.5, (HEIGHT, WIDTH - 2)), rtol=2e-3
    )


def test_an_older_picture_moves_with_the_view(compositor):
    """Rendered at x = 0, seen from x = 0.1: what is 3 m away moves by fx · 0.1 / 3 pixels to the left."""
    old, now = camera_at(0.0), camera_at(0.1)
    rgba = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    rgba[10:30, 30:40] = (4.0, 4.0, 4.0, 1.0)
    shown = RenderedView(rgba, np.full(rgba.shape[:2], 3.0, np.float32), old)
    got = View().draw(compositor, upload(shown), now)
    weight = np.clip(got[..., 0] - 0.25, 0.0, None)
    centre = (weight.sum(axis=0) * (np.arange(WIDTH) + 0.5)).sum() / weight.sum()
    assert centre == pytest.approx(35.0 - old.fx * 0.1 / 3.0, abs=0.1)


def test_the_learned_response_reaches_the_screen_under_standard(compositor):
    """Linear = the sRGB decoding of the code value, which Standard encodes again; of the colour itself, not
    of the premultiplied one."""
    places = np.linspace(-8.0, 8.0, 300).astype(np.float32)
    curve = np.stack([1.0 / (1.0 + np.exp(-places * rate)) for rate in (0.5, 0.8, 1.0)], axis=1).astype(
        np.float32
    )
    shown = picture(3.0, ToneCurve(places, curve))
    got = View(colour=(0.0, 0.0, 0.0, 0.0)).draw(compositor, upload(shown), shown.camera)
    colour = shown.rgba[5:, 5:, :3] / 0.5
    codes = np.stack([np.interp(np.log(colour[..., c]), places, curve[:, c]) for c in range(3)], axis=-1)
    np.testing.assert_allclose(got[5:, 5:, :3], 0.5 * to_linear(codes), rtol=3e-3, atol=2e-5)


def test_infinite_radiance_does_not_spoil_the_view(compositor):
    shown = picture(3.0)
    shown.rgba[..., :3] = np.inf
    got = View().draw(compositor, upload(shown), shown.camera)
    assert np.isfinite(got).all()


def test_sizes_must_agree():
    with pytest.raises(DataMismatchError, match=r"60×40 pixels.*\[10, 10, 4\]"):
        RenderedView(np.zeros((10, 10, 4)), np.zeros((10, 10)), camera_at(0.0))


def test_a_picture_of_before_a_jump_is_not_shown(compositor, monkeypatch):
    shown = picture(3.0)
    layer = upload(shown)
    context = SimpleNamespace(region=None)
    monkeypatch.setattr(overlay, "region_key", lambda _: 7)
    monkeypatch.setattr(overlay._runtime, "sources", [lambda context, view: [layer]])
    monkeypatch.setattr(overlay._runtime, "pictures", {7: shown})
    monkeypatch.setattr(overlay._runtime, "layers", {})
    # What is half covered is taken to be a metre away.
    assert len(overlay._layers(context, camera_at(0.4))) == 2
    assert overlay._layers(context, camera_at(0.6)) == []


def listed(camera: ViewCamera) -> ListedCamera:
    size = camera.width, camera.height
    return ListedCamera("one", camera.camera_to_world, *size, camera.fx, camera.fy, camera.cx, camera.cy)


def test_what_no_training_camera_has_seen_is_dimmed_and_nothing_else(compositor):
    shown = picture(3.0)
    plain, view = upload(shown), View(colour=(0.0, 0.0, 0.0, 0.0))
    expected = view.draw(compositor, plain, shown.camera)

    def drawn(*cameras: ViewCamera) -> np.ndarray:
        rows = seen.frustums([listed(each) for each in cameras])
        layer = replace(plain, frustums=rows)
        return View(colour=(0.0, 0.0, 0.0, 0.0)).draw(compositor, layer, shown.camera)

    behind = ViewCamera(np.diag([-1.0, 1.0, -1.0, 1.0]), WIDTH, HEIGHT, 60.0, 60.0, 30.0, 20.0)
    np.testing.assert_array_equal(drawn(shown.camera), expected)
    np.testing.assert_array_equal(drawn(behind, camera_at(9.0), shown.camera), expected)
    np.testing.assert_allclose(drawn(behind), seen.LEAST * expected, rtol=2e-3, atol=1e-3)
    # One 3 m away that stood 1.5 m aside: 30 pixels of the 60 are outside, 6 of them more than a fifth.
    aside = drawn(camera_at(1.5))
    share = aside[20, :, 3] / np.maximum(expected[20, :, 3], 1e-6)
    place = (np.arange(WIDTH) + 0.5 - 27.0) / 60.0 * 3.0 - 1.5  # metres beside the other camera
    across = np.abs(place / 3.0 * 60.0 + 27.0 - 30.0) / 30.0
    np.testing.assert_allclose(share[across < seen.INSIDE], 1.0, atol=2e-3)
    np.testing.assert_allclose(share[across > seen.OUTSIDE], seen.LEAST, atol=2e-3)
    between = share[(across > seen.INSIDE) & (across < seen.OUTSIDE)]
    assert np.all(np.diff(between) > 0.0) or np.all(np.diff(between) < 0.0)


def test_of_many_cameras_those_are_asked_that_look_as_the_view_does():
    camera = camera_at(0.0)
    others = [camera_at(5.0 + number) for number in range(2 * seen.MOST)]
    rows = seen.texels(seen.frustums([listed(each) for each in (*others, camera)]), camera)
    assert rows.shape == (seen.MOST, 3, 4)
    # The view's own comes first: the middle of what it sees is the middle of that picture.
    np.testing.assert_allclose(rows[0][2], [0.0, 0.0, 1.0, 0.0], atol=1e-6)
