# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare`` as a user calls it: photos of a room whose cameras are known, and what can go wrong."""

import importlib.util
import json
import shutil
import sys
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import tyro
from PIL import Image

from physhdr.backend.cli.prepare import Prepare
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.capture import structure
from physhdr.bridge.errors import PhysHDRError

POSES = 9
#: What similarity alignment may leave: millimetres in a room of 6 m, degrees.
MILLIMETRES, DEGREES = 5.0, 0.2


@pytest.fixture(scope="module")
def room():
    path = Path(__file__).parents[1] / "scene" / "capture" / "room.py"
    spec = importlib.util.spec_from_file_location("room", path)
    module = sys.modules["room"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def capture(room):
    return room.photograph(POSES)


@pytest.fixture(scope="module")
def photos(room, capture, tmp_path_factory):
    """As a camera leaves them: three exposures of each pose in the order 0, −, +."""
    folder = tmp_path_factory.mktemp("capture") / "photos"
    room.write_brackets(folder, capture)
    return folder


@pytest.fixture(scope="module")
def prepared(photos, tmp_path_factory):
    out = tmp_path_factory.mktemp("prepared") / "room"
    assert prepare(photos, "--out", out, "--test-every", 4) == 0
    return out


def prepare(*words):
    return tyro.cli(Prepare, args=[str(word) for word in (*words, "--threads", 1)]).run()


def refused(*words):
    """A run that must fail; its message, which names a remedy."""
    with pytest.raises(PhysHDRError) as caught:
        prepare(*words)
    assert caught.value.hint
    return str(caught.value)


def umeyama(found, true):
    """Scale, rotation and translation that bring points nearest to others (Umeyama 1991)."""
    a, b = found - found.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    rotation = u @ sign @ vt
    scale = (s * np.diag(sign)).sum() / (a**2).sum()
    return scale, rotation, true.mean(0) - scale * rotation @ found.mean(0)


def assert_poses(scene, capture, room):
    """The scene's cameras are the true ones but for a similarity, whose rotation keeps +Z up."""
    views = sorted([*scene.train, *scene.test], key=lambda view: view.index)
    true = [capture.poses[view.index] for view in views]
    places = np.array([-pose[:, :3].T @ pose[:, 3] for pose in true])
    found = np.array([view.camera.camera_to_world for view in views])
    scale, rotation, shift = umeyama(found[:, :3, 3], places)
    apart = np.linalg.norm(scale * found[:, :3, 3] @ rotation.T + shift - places, axis=1)
    assert apart.max() * 1000.0 < MILLIMETRES
    for pose, view in zip(true, views, strict=True):
        turned = rotation @ view.camera.camera_to_world[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        cosine = (np.trace(turned @ pose[:, :3]) - 1.0) / 2.0
        assert np.degrees(np.arccos(min(cosine, 1.0))) < DEGREES
    assert np.degrees(np.arccos(rotation[2, 2])) < 0.5
    return scale, rotation, shift


def test_cameras_lens_and_points_are_the_true_ones(prepared, capture, room):
    """All exposures, read back by our reader of GaussHDR's packaging, which knows nothing of this command."""
    scene = read_scene(prepared)
    assert [view.index for view in scene.test] == [2, 6] and len(scene.train) == POSES - 2  # no ends
    assert all(view.exposures == pytest.approx(room.EXPOSURES) for view in scene.train)
    scale, rotation, shift = assert_poses(scene, capture, room)
    camera = scene.train[0].camera
    assert (camera.fx, camera.fy) == pytest.approx((room.FOCAL, room.FOCAL), rel=0.005)
    # Every point lies on a wall or a box: metres from the nearest face.
    points = scale * scene.points.positions.astype(float) @ rotation.T + shift
    distance = np.min([np.abs(outside(points, *box)) for box in room.BOXES], axis=0)
    assert len(points) > 500 and np.quantile(distance, 0.95) < 0.02


def outside(points, low, high):
    """Signed distance to the surface of a box."""
    beyond = np.maximum(np.array(low) - points, points - np.array(high))
    return np.where(beyond.max(1) > 0, np.linalg.norm(np.maximum(beyond, 0), axis=1), beyond.max(1))


def test_pictures_are_what_pinhole_cameras_would_have_taken(prepared, capture, room):
    """Every step, in the order of its exposure, at its own pose, against the room ray cast anew."""
    for view in [read_scene(prepared).train[2]]:
        camera = view.camera
        rays = room.rays_of_pinhole(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        seen = room.picture(capture.poses[view.index], rays, camera.width, camera.height)
        for k, exposure in enumerate(room.EXPOSURES):
            difference = view.image(k) / 255.0 - room.codes(seen, exposure) / 255.0
            assert -10.0 * np.log10(np.mean(difference**2)) > 26.0
            assert abs(difference.mean()) < 0.003


def test_colmap_reads_what_we_wrote(prepared):
    model = pycolmap.Reconstruction(str(prepared / "sparse" / "0"))
    assert model.is_valid() and model.num_reg_images() == POSES
    assert {model.image(k).name for k in model.reg_image_ids()} == {
        path.name for path in (prepared / "images").glob("*_0.png")
    }
    assert model.camera(1).model_name == "PINHOLE"
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 0.5


def test_it_says_where_everything_came_from(prepared, photos):
    origin = json.loads((prepared / "prepare.json").read_text())
    assert origin["sources"]["train_000_0.png"] == "DSC_9998.jpg"  # −, then 0, then +
    assert origin["sources"]["train_000_2.png"] == "DSC_9997.jpg"
    assert origin["sources"]["train_001_4.png"] == "DSC_0002.jpg"
    assert set(origin["sources"]) == {path.name for path in (prepared / "images").iterdir()}
    assert origin["left_out"] == [] and "ISO 100" in origin["exposures"]
    assert (origin["kind"], origin["encoding"]) == ("brackets", "camera")
    assert sorted(path.name for path in prepared.parent.iterdir()) == ["room"]
    assert len(list(photos.iterdir())) == 3 * POSES


def test_a_reconstruction_that_exists_is_used(prepared, capture, room, tmp_path, capsys, monkeypatch):
    """Its pictures are the photos here; half the size, and COLMAP is not run."""
    monkeypatch.setattr(structure, "run_colmap", None)
    exposures = prepared / "exposure.json"
    words = ["--poses", prepared, "--exposures", exposures, "--downscale", 2, "--test-every", 0]
    assert prepare(prepared / "images", "--out", tmp_path / "half", *words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{POSES} of {POSES} poses placed" in said and "exposures EV -3.0, -1.0, +1.0" in said
    before, half = read_scene(prepared), read_scene(tmp_path / "half")
    assert not half.test and len(half.train) == POSES
    assert half.train[0].camera.fx == pytest.approx(before.train[0].camera.fx / 2)
    # Poses are numbered in the order of names here: tests first.
    order = [view.index for view in (*before.test, *before.train)]
    for view in half.train:
        view.__dict__["index"] = order[view.index]
    assert_poses(half, capture, room)


def test_poses_that_cannot_be_placed_are_named_and_left_out(room, capture, tmp_path, capsys):
    """Five of the room, three of something else, one exposure each."""
    random, folder = np.random.default_rng(5), tmp_path / "mixed"
    folder.mkdir()
    for k, seen in enumerate(capture.radiance[:5]):
        room.write_photo(folder / f"a{k}.png", room.codes(seen, 0.5), 0.5)
    for k in range(3):
        noise = random.integers(0, 256, (room.HEIGHT, room.WIDTH, 3), np.uint8)
        room.write_photo(folder / f"noise{k}.png", noise, 0.5)
    assert prepare(folder, "--out", tmp_path / "out", "--camera", "SIMPLE_RADIAL") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "one exposure only" in said and "5 of 8 poses placed" in said
    assert "left out, for they could not be placed: noise0, noise1, noise2" in said
    assert json.loads((tmp_path / "out" / "prepare.json").read_text())["left_out"][0] == "noise0"
    assert len(list((tmp_path / "out" / "images").iterdir())) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mixed", "out"]


def reconstruction(prepared, folder, name_of):
    """A copy of the prepared one in which each image, in the order of poses, has another name."""
    model = pycolmap.Reconstruction(str(prepared / "sparse" / "0"))
    for number, image_id in enumerate(sorted(model.reg_image_ids())):
        image = model.image(image_id)
        image.name = name_of(number, image.name)
    (folder / "sparse" / "0").mkdir(parents=True)
    model.write(str(folder / "sparse" / "0"))
    return folder


def test_fewer_than_half_of_the_poses_need_a_word(prepared, tmp_path):
    poses = reconstruction(prepared, tmp_path / "four", lambda k, name: name if k < 4 else f"other{k}.png")
    words = [prepared / "images", "--exposures", prepared / "exposure.json", "--poses", poses]
    message = refused(*words, "--out", tmp_path / "out")
    assert f"only 4 of {POSES} poses could be placed" in message and "--partial" in message
    assert not (tmp_path / "out").exists()
    assert prepare(*words, "--out", tmp_path / "out", "--partial") == 0
    assert len(list((tmp_path / "out" / "images").iterdir())) == 4 * len((0, 2, 4))


def test_a_reconstruction_of_other_pictures(prepared, photos, tmp_path):
    """The photos' names, but the pictures were cropped when their distortion was taken out."""
    sources = json.loads((prepared / "prepare.json").read_text())["sources"]
    poses = reconstruction(prepared, tmp_path / "named", lambda k, name: sources[name])
    message = refused(photos, "--out", tmp_path / "out", "--poses", poses)
    assert "the photos are 400×300" in message and "not cropped" in message
    poses = reconstruction(prepared, tmp_path / "nobody", lambda k, name: f"x{k}.jpg")
    message = refused(photos, "--out", tmp_path / "out", "--poses", poses)
    assert f"places 0 of the {POSES} poses" in message and "DSC_9998.jpg" in message


def tiny(room, folder, count=6, evs=(0, 2)):
    """Grey photos that only the first steps look at."""
    folder.mkdir()
    moment = datetime(2026, 1, 1)
    for k in range(count):
        pixels = np.full((12, 16, 3), 90, np.uint8)
        room.write_photo(folder / f"IMG_{k}.jpg", pixels, 2.0 ** evs[k % len(evs)], moment, 100, 8.0)
        moment += timedelta(seconds=2)
    return folder


def test_what_can_be_wrong_with_photos_and_options(room, tmp_path):
    photos, out = tiny(room, tmp_path / "photos"), tmp_path / "out"
    before = {path.name: path.read_bytes() for path in photos.iterdir()}
    assert "does not exist" in refused(tmp_path / "nowhere", "--out", out)
    assert "3 are the least" in refused(tiny(room, tmp_path / "four", 4), "--out", out)
    assert "not plain which of the 5" in refused(tiny(room, tmp_path / "five", 5), "--out", out)
    assert "holds the photos" in refused(photos, "--out", photos)
    assert "holds the photos" in refused(photos, "--out", tmp_path, "--overwrite")
    assert "0.5" in refused(photos, "--out", out, "--downscale", 0.5)
    assert "1-th pose" in refused(photos, "--out", out, "--test-every", 1)
    assert "no step 2" in refused(photos, "--out", out, "--match", 2)
    assert "no reconstruction of COLMAP" in refused(photos, "--out", out, "--poses", tmp_path)
    Image.new("RGB", (16, 12)).save(photos / "IMG_9.png")
    assert "1 of 7 photos do not tell its exposure time in EXIF: IMG_9.png" in refused(photos, "--out", out)
    (photos / "IMG_9.png").unlink()
    assert {path.name: path.read_bytes() for path in photos.iterdir()} == before
    assert not out.exists() and not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_what_is_there_is_not_replaced_unasked(room, tmp_path):
    photos, out = tiny(room, tmp_path / "photos"), tmp_path / "out"
    out.mkdir()
    (out / "letter.txt").write_text("mine")
    assert "not empty" in refused(photos, "--out", out)
    assert "not made by 'physhdr prepare'" in refused(photos, "--out", out, "--overwrite")
    # Made by us: replaced only by what succeeds, and this fails, for grey has no features.
    (out / "prepare.json").write_text("{}")
    message = refused(photos, "--out", out, "--overwrite")
    assert "did not write: letter.txt" in message and (out / "letter.txt").read_text() == "mine"
    (out / "letter.txt").unlink()
    assert "0 could be placed" in refused(photos, "--out", out, "--overwrite")
    assert (out / "prepare.json").read_text() == "{}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "photos"]


def test_a_damaged_reconstruction(room, prepared, tmp_path):
    photos = tiny(room, tmp_path / "photos")
    shutil.copytree(prepared / "sparse", tmp_path / "sparse")
    images = tmp_path / "sparse" / "0" / "images.bin"
    images.write_bytes(images.read_bytes()[:100])
    assert "not a readable reconstruction" in refused(photos, "--out", tmp_path / "out", "--poses", tmp_path)


def test_without_pycolmap_the_message_says_how_to_get_it(room, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    message = refused(tiny(room, tmp_path / "photos"), "--out", tmp_path / "out")
    assert "pip install pycolmap" in message and not (tmp_path / "out").exists()


def test_colmap_that_crashes_is_one_message(room, tmp_path, monkeypatch):
    """Its process is killed by its own library's check: here by a script that says so."""
    script = tmp_path / "colmap_process.py"
    script.write_text("import os, sys\nsys.stderr.write('Check failed: x')\nsys.stderr.flush()\nos.abort()\n")
    monkeypatch.setattr(structure, "__file__", str(tmp_path / "structure.py"))
    message = refused(tiny(room, tmp_path / "photos"), "--out", tmp_path / "out")
    assert "COLMAP failed" in message and "Check failed: x" in message
    assert not (tmp_path / "out").exists()
