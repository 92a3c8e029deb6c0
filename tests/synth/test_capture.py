# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures: a walk with a camera in hand, its renders, and how its photos are exposed."""

import importlib.util
import json
import math
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs Blender: run with .venvs/run-blender")

from physhdr.synth import camera_model, photos, walk
from physhdr.synth.camera_model import CameraModel
from physhdr.synth.capture import Capture, Place, opened
from physhdr.synth.errors import ConflictError, DamagedFileError, OutputFolderError
from physhdr.synth.lens import OPENCV, Lens
from physhdr.synth.stage import CameraHints

TOOL = Path(__file__).resolve().parents[2] / "lab" / "tools" / "render_capture.py"
LENS = Lens(
    model=OPENCV, coefficients=(-0.1, 0.02, 0.0, 0.0), width=32, height=24, fx=26.0, fy=26.0, cx=16.0, cy=12.0
)
HINTS = CameraHints(
    centre=(0, -3, 1),
    target=(0, 0, 1),
    extent=(1, 1),
    angle_x=1.0,
    orbit_radius=3.0,
    orbit_arc=1.0,
    elevation=(0.0, 0.4),
)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(math.acos(float(np.clip(a @ b, -1.0, 1.0))))


# ---- the walk ----------------------------------------------------------------------------------------


def test_a_walk_stays_in_reach_and_every_place_sees_what_its_neighbours_see():
    poses = walk.places(HINTS, 40, 7)
    target, angles = np.array(HINTS.target), []
    for pose in poses:
        assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        offset = pose[:3, 3] - target
        distance = np.linalg.norm(offset)
        assert (1.0 - walk.NEARER) * 3.0 <= distance <= 3.0 + 1e-9
        assert -1e-9 <= math.asin(offset[2] / distance) <= 0.4 + 1e-9
        assert abs(math.atan2(offset[0], -offset[1])) <= 0.5 + 1e-9
        angles.append(angle(-pose[:3, 2], -offset / distance))
    assert 1.0 < np.mean(angles) < 8.0 and max(angles) < 16.0  # nearly at the target, and never quite
    steps = [angle(a[:3, 2], b[:3, 2]) for a, b in pairwise(poses)]
    assert max(steps) < 20.0
    heights = [pose[2, 3] for pose in poses]
    assert np.ptp(heights) > 0.8 and np.mean(heights[:10]) > np.mean(heights[-10:])


def test_a_seed_is_a_walk():
    first, again, other = (np.stack(walk.places(HINTS, 9, seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


# ---- the folder --------------------------------------------------------------------------------------


def a_capture(root: Path) -> Capture:
    places = tuple(Place(k, pose, k == 1) for k, pose in enumerate(walk.places(HINTS, 3, 0)))
    return Capture(root, {"samples": 4}, LENS, LENS.straight, ("ambient", "lamp"), places)


def test_a_folder_is_of_one_capture(tmp_path):
    made = a_capture(tmp_path / "capture")
    made.enter()
    made.enter()  # once more
    there = opened(tmp_path / "capture")
    assert there.lens == LENS and there.lights == ("ambient", "lamp")
    assert [place.test for place in there.places] == [False, True, False]
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(there.places, made.places, strict=True))
    with pytest.raises(ConflictError, match="other options \\(samples\\)"):
        replace(made, options={"samples": 8}).enter()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "mine.jpg").write_bytes(b"")
    with pytest.raises(OutputFolderError, match="holds files but no"):
        a_capture(tmp_path / "photos").enter()


@pytest.mark.parametrize("damage", [{"format": "other"}, {"lens": {}}, {"places": [{"test": True}]}])
def test_a_damaged_description_is_named(tmp_path, damage):
    a_capture(tmp_path).enter()
    path = tmp_path / "capture.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | damage))
    with pytest.raises(DamagedFileError, match="capture\\.json"):
        opened(tmp_path)


@pytest.fixture
def tool():
    """lab/tools/render_capture.py, which no package holds."""
    spec = importlib.util.spec_from_file_location("render_capture", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_renders_every_place_once_and_test_places_as_a_pinhole_too(tmp_path, tool, monkeypatch, capsys):
    asked = "ball --places 3 --size 32x24 --lens opencv:-0.1,0.02,0,0 --test-every 2 --no-denoise"
    command = ["render_capture.py", *asked.split(), "--out", str(tmp_path / "out")]

    def run(*more: str) -> int:
        monkeypatch.setattr(sys, "argv", [*command, *more])
        return tool.main()

    assert run("--samples", "1") == 0
    capture = opened(tmp_path / "out")
    files = [capture.file(place) for place in capture.places]
    files += [capture.file(place, pinhole=True) for place in capture.places if place.test]
    assert len(files) == 4 and all(path.exists() for path in files)
    bent, straight = (capture.passes(capture.places[1], pinhole) for pinhole in (False, True))
    # The same camera, so the same wall in the middle, and not the same in the corners.
    assert bent.depth[12, 16] == pytest.approx(straight.depth[12, 16], rel=0.1)
    assert np.abs(np.log(bent.depth[::23, ::31] / straight.depth[::23, ::31])).max() > 0.01
    kept = files[0].stat().st_mtime_ns
    files[1].unlink()
    capsys.readouterr()
    assert run("--samples", "1") == 0
    again = capsys.readouterr().out
    assert files[1].exists() and files[0].stat().st_mtime_ns == kept
    assert "passes_place_001" in again and "passes_place_000" not in again
    assert run("--samples", "2") == 1
    assert "rendered with other options (samples)" in capsys.readouterr().err


# ---- how photos are exposed --------------------------------------------------------------------------


def test_an_even_picture_is_metered_to_middle_grey():
    grey = np.full((24, 32, 3), 0.02)
    assert photos.metered(grey) * 0.02 == pytest.approx(0.18)
    # The middle counts: four times the light in the corners alone is less than half a stop.
    corners = grey.copy()
    corners[:6, :8] = corners[-6:, -8:] = 0.08
    assert 0.0 < math.log2(photos.metered(grey) / photos.metered(corners)) < 0.5
    assert photos.metered(corners, 0.08) * 0.02 == pytest.approx(0.18, rel=1e-3)  # a spot meter sees none


def test_exposures_are_thirds_of_stops():
    for exposure in (0.003, 0.7, 1.0, 9.3):
        stops = math.log2(photos.on_the_dial(exposure))
        assert stops * 3 == pytest.approx(round(stops * 3))
        assert abs(stops - math.log2(exposure)) <= 1 / 6 + 1e-9


def test_a_bracket_is_the_same_everywhere_and_automatic_exposure_follows_the_light():
    places = a_capture(Path()).places
    meters = [0.5, 1.0, 4.0]
    model = CameraModel(iso=800.0, vignetting=1.0, exposure_jitter=0.2)
    bracketed = photos.plan(places, meters, [-2.0, 0.0, 2.0], model, 0)
    assert [photo.exposure for photo in bracketed] == [0.25, 1.0, 4.0] * 3
    assert [photo.name for photo in bracketed][:2] == ["IMG_0001", "IMG_0002"]
    automatic = photos.plan(places, meters, None, model, 0)
    assert [photo.exposure for photo in automatic] == meters
    # A place for testing is photographed by an ideal camera.
    assert [photo.camera.model for photo in automatic] == [model, CameraModel(), model]
    # Within a bracket no pause is as long as the walk to the next place.
    taken = [photo.taken for photo in bracketed]
    gaps = [(b - a).total_seconds() for a, b in pairwise(taken)]
    assert min(gaps[2::3]) > max(gap for k, gap in enumerate(gaps) if k % 3 != 2)


def test_a_raw_files_noise_is_what_the_file_says():
    """The variance of a flat raw is a n + b of the signal n that DNG's NoiseProfile tells."""
    place = Place(0, np.eye(4), test=False)
    (photo,) = photos.plan([place], [1.0], None, CameraModel(iso=800.0), 0)
    light = np.full((200, 200, 3), 0.3)
    told = photo.camera.sensed(light, photo.exposure) / camera_model.SATURATION
    electrons = 68_000 / 8
    n = 0.3 / camera_model.SATURATION
    assert told.mean() == pytest.approx(n, rel=2e-3)
    expected = n / electrons + (camera_model.read_noise(800.0) / electrons) ** 2
    assert told.var() == pytest.approx(expected, rel=0.02)
