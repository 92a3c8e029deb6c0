# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of cameras, and videos decoded again."""

import sys
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from physhdr.backend.evaluate.camera_path import focus_of, orbit_path, spline_path
from physhdr.backend.evaluate.video import FRAMES_FILE, frames_writer, video_writer
from physhdr.backend.optional import PackageMissingError
from physhdr.backend.scene import Camera
from physhdr.bridge.errors import BadValueError, FileDamagedError, OutputError


def looking_at(position, target) -> Camera:
    """A camera with Z up, written apart from the product's."""
    back = np.subtract(position, target)
    back = back / np.linalg.norm(back)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(back, right), back], axis=1), position
    return Camera(pose, 64, 48, 60.0, 60.0, 32.0, 24.0)


def positions_of(cameras: list[Camera]) -> np.ndarray:
    return np.array([camera.position for camera in cameras])


RING = [
    looking_at((3 * np.cos(a), 3 * np.sin(a), 1.0), (0, 0, 0.5)) for a in np.linspace(0, 2 * np.pi, 12, False)
]
GRID = [looking_at((x, -4.0, z), (x, 0.0, z)) for z in (0.0, 0.5, 1.0) for x in (0.0, 1.0, 2.0, 3.0)]


# ---- paths -------------------------------------------------------------------------------------------


def test_a_spline_passes_through_every_camera_at_an_even_speed() -> None:
    shuffled = [RING[i] for i in (0, 5, 2, 9, 1, 7, 3, 11, 4, 6, 8, 10)]
    path = spline_path(shuffled, 221)
    assert all(isinstance(camera, Camera) for camera in path), "each is a rigid pose"
    for camera in RING:
        gap = np.linalg.norm(positions_of(path) - camera.position, axis=1)
        nearest = path[gap.argmin()]
        assert gap.min() < 0.03
        turn = Rotation.from_matrix(nearest.camera_to_world[:3, :3].T @ camera.camera_to_world[:3, :3])
        assert np.degrees(turn.magnitude()) < 1.0
    speed = np.linalg.norm(np.diff(positions_of(path), axis=0), axis=1)
    assert speed.max() < 1.25 * speed.min(), "the ring's order was found: no way across it"
    assert np.linalg.norm(positions_of(path)[:, :2], axis=1).min() > 2.95


def test_a_spline_through_a_rig_goes_the_shortest_way() -> None:
    """4×3 stops, 1 and 0.5 apart: along columns, 4 × 1 m up and down and 3 × 1 m across."""
    shuffled = [GRID[i] for i in np.random.default_rng(1).permutation(12)]
    path = positions_of(spline_path(shuffled, 400))
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert 7.0 - 0.3 < length < 8.5


def test_a_closed_spline_comes_back() -> None:
    path = positions_of(spline_path(RING, 120, closed=True))
    steps = np.linalg.norm(np.diff(np.vstack([path, path[:1]]), axis=0), axis=1)
    assert steps.max() < 1.1 * steps.min()
    np.testing.assert_allclose(np.linalg.norm(path[:, :2], axis=1), 3.0, atol=0.01)


def test_few_cameras() -> None:
    alone = spline_path(RING[:1], 5)
    assert len(alone) == 5 and (positions_of(alone) == RING[0].position).all()
    pair = positions_of(spline_path([RING[0], RING[0], RING[1]], 3))
    np.testing.assert_allclose(pair, [RING[0].position, pair[1], RING[1].position], atol=1e-12)
    np.testing.assert_allclose(pair[1], (pair[0] + pair[2]) / 2, atol=1e-12)
    with pytest.raises(BadValueError, match="at least one camera"):
        orbit_path([], 5)
    with pytest.raises(BadValueError, match="at least 2 frames"):
        spline_path(RING, 1)


def test_the_focus_is_where_the_axes_meet() -> None:
    np.testing.assert_allclose(focus_of(RING), [0, 0, 0.5], atol=1e-9)
    ahead = focus_of(GRID)  # parallel axes along +Y: straight ahead of their middle
    np.testing.assert_allclose(ahead[[0, 2]], [1.5, 0.5], atol=1e-9)
    assert ahead[1] > -4.0 + 3.0


def test_an_orbit_of_a_ring_is_the_ring() -> None:
    path = orbit_path(RING, 24)
    positions = positions_of(path)
    np.testing.assert_allclose(np.linalg.norm(positions[:, :2], axis=1), 3.0, atol=1e-9)
    np.testing.assert_allclose(positions[:, 2], 1.0, atol=1e-9)
    for camera in path:
        like = looking_at(camera.position, (0, 0, 0.5))
        np.testing.assert_allclose(camera.camera_to_world, like.camera_to_world, atol=1e-9)


def test_an_orbit_before_a_scene_stays_among_the_cameras() -> None:
    positions = positions_of(orbit_path(GRID, 24))
    np.testing.assert_allclose(positions[:, 1], -4.0, atol=1e-9)
    low, high = positions_of(GRID).min(axis=0) - 0.15, positions_of(GRID).max(axis=0) + 0.15
    assert (positions >= low).all() and (positions <= high).all()


# ---- videos ------------------------------------------------------------------------------------------

PATCHES = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255), (0, 0, 0), (200, 120, 40), (90, 90, 90)]


def bt709(rgb) -> tuple[float, float, float]:
    """Limited-range Y′CbCr of R′G′B′ codes 0…255, from the words of ITU-R BT.709."""
    r, g, b = np.array(rgb) / 255.0
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    return 16 + 219 * y, 128 + 224 * (b - y) / 1.8556, 128 + 224 * (r - y) / 1.5748


def test_a_video_shows_its_frames_and_says_what_its_codes_mean(tmp_path: Path) -> None:
    path = tmp_path / "new" / "patches.mp4"
    with video_writer(path, fps=5) as write:
        for patch in PATCHES:
            write(np.full((33, 47, 3), patch, np.uint8))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, context.width, context.height) == ("h264", "yuv420p", 48, 34)
        assert (context.color_primaries, context.color_trc, context.colorspace) == (1, 13, 1)
        assert stream.average_rate == 5
        frames = [frame.to_ndarray() for frame in container.decode(video=0)]
    assert len(frames) == len(PATCHES)
    for frame, patch in zip(frames, PATCHES, strict=True):
        y, cb, cr = frame[:34], frame[34:42], frame[43:]  # planes below each other, chroma two rows a line
        for plane, code in zip((y, cb, cr), bt709(patch), strict=True):
            assert np.abs(plane.astype(float) - code).max() < 4.0, patch


@pytest.mark.parametrize(
    ("fps", "seconds"),
    [(Fraction(24000, 1001), 24 * 1.001 / 24), (Fraction(12, 5), 10.0), (Fraction(6, 25), 100.0)],
)
def test_a_video_lasts_as_long_as_its_frames_a_second_say(tmp_path: Path, fps, seconds) -> None:
    """Television's 24 / 1.001, and what is left where each tenth or hundredth frame of 24 is rendered."""
    for name in ("a.mp4", "a.webp"):
        with video_writer(tmp_path / name, fps) as write:
            for number in range(24):
                write(np.full((16, 16, 3), 10 * number, np.uint8))
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.average_rate == fps and float(stream.duration * stream.time_base) == pytest.approx(
            seconds
        )
    with Image.open(tmp_path / "a.webp") as picture:
        lasts = 0
        for number in range(24):
            picture.seek(number)
            picture.load()
            lasts += picture.info["duration"]
    assert lasts == round(1000 * seconds)


def test_frames_of_a_video_keep_their_place(tmp_path: Path) -> None:
    picture = np.zeros((32, 64, 3), np.uint8)
    picture[:, :32] = 220  # left bright, right dark
    picture[:8] = 128
    path = tmp_path / "a.mkv"
    with video_writer(path, fps=24) as write:
        for _ in range(3):
            write(picture)
    with av.open(str(path)) as container:
        frame = next(container.decode(video=0)).to_ndarray(format="gray").astype(int)
    assert np.abs(frame[10:, :30] - frame[10, 5]).max() < 6 and frame[20, 10] > frame[4, 40] > frame[20, 50]


def test_an_animated_webp_shows_its_frames_for_as_long_as_they_last(tmp_path: Path) -> None:
    path = tmp_path / "new" / "patches.webp"
    with video_writer(path, fps=30) as write:
        for patch in PATCHES:
            write(np.full((33, 47, 3), patch, np.uint8))
    with Image.open(path) as picture:
        assert (picture.format, picture.size, picture.n_frames) == ("WEBP", (47, 33), len(PATCHES))
        assert picture.info["loop"] == 0, "for ever"
        ends = []
        for number, patch in enumerate(PATCHES):
            picture.seek(number)
            shown = np.asarray(picture.convert("RGB")).astype(int)
            assert np.abs(shown - patch).max() <= 6, patch
            ends.append(picture.info["timestamp"] + picture.info["duration"])
    assert ends == [33, 67, 100, 133, 167, 200, 233], "30 a second, without drift"


def test_what_no_webp_can_hold_is_refused(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.webp"
    with pytest.raises(BadValueError, match=r"16384×2[\s\S]*--width"), video_writer(path, fps=5) as write:
        write(np.zeros((2, 16384, 3), np.uint8))
    monkeypatch.setattr("physhdr.backend.evaluate.video.WEBP_BYTES", 700)
    with (
        pytest.raises(BadValueError, match=r"2 frames fill[\s\S]*--fps"),
        video_writer(path, fps=5) as write,
    ):
        for _ in range(3):
            write(np.zeros((10, 10, 3), np.uint8))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.mp4", "a.webp"])
def test_a_video_that_fails_leaves_nothing(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    with pytest.raises(BadValueError, match=r"frame 1 is \(10, 12, 3\)"), video_writer(path, fps=5) as write:
        write(np.zeros((10, 10, 3), np.uint8))
        write(np.zeros((10, 12, 3), np.uint8))
    with pytest.raises(BadValueError, match="at least one frame"), video_writer(path, fps=5):
        pass
    with pytest.raises(BadValueError, match=r"must end in \.mp4.*\.webp, got a\.gif\n"):
        video_writer(tmp_path / "a.gif", 5).__enter__()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        video_writer(tmp_path / "file" / name, 5).__enter__()
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_without_av_there_is_one_clear_message(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(PackageMissingError, match=r"a video needs av[\s\S]*pip install av"):
        video_writer(tmp_path / "a.mp4", 5).__enter__()
    with video_writer(tmp_path / "a.webp", 5) as write:  # needs Pillow alone
        write(np.zeros((4, 6, 3), np.uint8))
    with frames_writer(tmp_path / "frames", 2) as write:
        for value in (10, 20):
            write(np.full((4, 6, 3), value, np.uint8))
    frames = tmp_path / "frames"
    names = sorted(path.name for path in frames.iterdir())
    assert names == ["frame_0000.png", "frame_0001.png", FRAMES_FILE]
    assert np.asarray(Image.open(frames / names[1]).convert("RGB"))[0, 0, 0] == 20


PICTURE = np.zeros((4, 6, 3), np.uint8)


def write_frames(folder: Path, count: int, interrupted: bool = False) -> None:
    with frames_writer(folder, count) as write:
        for _ in range(count):
            write(PICTURE)
            if interrupted:
                raise KeyboardInterrupt


def test_a_shorter_video_leaves_no_frames_of_the_longer_one(tmp_path: Path) -> None:
    write_frames(tmp_path, 4)
    others = {"frame_00003.png", "frame_last.png", "frame_0009.jpg", "frame_0004.png"}
    for name in others:  # not ours
        (tmp_path / name).touch()
    with pytest.raises(KeyboardInterrupt):
        write_frames(tmp_path, 2, interrupted=True)
    assert (tmp_path / "frame_0003.png").is_file(), "removed only once the new ones are complete"
    write_frames(tmp_path, 2)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"frame_0000.png", "frame_0001.png", FRAMES_FILE} | others
    assert (tmp_path / "frame_0004.png").read_bytes() == b""


def test_pictures_of_others_are_neither_overwritten_nor_removed(tmp_path: Path) -> None:
    mine = {tmp_path / f"frame_{number:04d}.png": bytes([number]) for number in range(1, 5)}
    for path, content in mine.items():
        path.write_bytes(content)
    write_frames(tmp_path, 1)
    with pytest.raises(OutputError, match=r"frame_0001\.png exists, and may not be[\s\S]*another folder"):
        write_frames(tmp_path, 2)
    assert {path: path.read_bytes() for path in mine} == mine
    (tmp_path / "frame_0001.png").unlink()
    write_frames(tmp_path, 2)
    write_frames(tmp_path, 1)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"frame_0000.png", FRAMES_FILE} | {path.name for path in list(mine)[1:]}


def test_an_interrupted_video_can_be_made_again(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write_frames(tmp_path, 3, interrupted=True)
    write_frames(tmp_path, 3)
    assert len(list(tmp_path.glob("frame_*.png"))) == 3


@pytest.mark.parametrize("content", ['{"format": "physhdr-frames", "frames": 3}', "{", '{"frames": true}'])
def test_a_file_of_frames_that_is_none_is_told(tmp_path: Path, content: str) -> None:
    (tmp_path / FRAMES_FILE).write_text(content)
    with pytest.raises((OutputError, FileDamagedError), match=r"frames\.json[\s\S]*move that file away"):
        write_frames(tmp_path, 1)
    assert [path.name for path in tmp_path.iterdir()] == [FRAMES_FILE]
