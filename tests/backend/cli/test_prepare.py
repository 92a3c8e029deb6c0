# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare`` as a user calls it: photos of a room whose cameras are known, and what can go wrong."""

import errno
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import OpenImageIO
import psutil
import pycolmap
import pytest
import tyro
from PIL import Image

from physhdr.backend.cli import main
from physhdr.backend.cli.prepare import Prepare
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.capture import data_set, structure
from physhdr.backend.scene.capture.data_set import new_folder
from physhdr.backend.scene.encoding import SRGB
from physhdr.bridge.errors import BadValueError, PhysHDRError

POSES = 9
#: What similarity alignment may leave: millimetres in a room of 6 m, degrees.
MILLIMETRES, DEGREES = 5.0, 0.2


def of_captures(name):
    path = Path(__file__).parents[1] / "scene" / "capture" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def room():
    return of_captures("room")


@pytest.fixture(scope="module")
def dng():
    return of_captures("dng")


@pytest.fixture(scope="module")
def heic():
    return of_captures("heic")


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


def assert_poses(scene, capture, room, millimetres=MILLIMETRES):
    """The scene's cameras are the true ones but for a similarity, whose rotation keeps +Z up."""
    views = sorted([*scene.train, *scene.test], key=lambda view: view.index)
    true = [capture.poses[view.index] for view in views]
    places = np.array([-pose[:, :3].T @ pose[:, 3] for pose in true])
    found = np.array([view.camera.camera_to_world for view in views])
    scale, rotation, shift = umeyama(found[:, :3, 3], places)
    apart = np.linalg.norm(scale * found[:, :3, 3] @ rotation.T + shift - places, axis=1)
    assert apart.max() * 1000.0 < millimetres
    for pose, view in zip(true, views, strict=True):
        turned = rotation @ view.camera.camera_to_world[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        cosine = (np.trace(turned @ pose[:, :3]) - 1.0) / 2.0
        assert np.degrees(np.arccos(min(cosine, 1.0))) < DEGREES
    assert np.degrees(np.arccos(rotation[2, 2])) < 0.1 * millimetres
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


@pytest.mark.long
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
    assert "ignoring photos that could not be placed: noise0, noise1, noise2" in said
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


def stopped(*_):
    """In COLMAP's place."""
    raise structure.StructureError("COLMAP would run", "It need not.")


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
    assert "at least 3 are needed" in refused(tiny(room, tmp_path / "four", 4), "--out", out)
    assert "not plain which of the 5" in refused(tiny(room, tmp_path / "five", 5), "--out", out)
    assert "holds the photos" in refused(photos, "--out", photos)
    assert "holds the photos" in refused(photos, "--out", tmp_path, "--overwrite")
    assert "0.5" in refused(photos, "--out", out, "--downscale", 0.5)
    assert "1-th pose" in refused(photos, "--out", out, "--test-every", 1)
    assert "no step 2" in refused(photos, "--out", out, "--match", 2)
    assert "no reconstruction of COLMAP" in refused(photos, "--out", out, "--poses", tmp_path)
    Image.new("RGB", (16, 12)).save(photos / "IMG_9.png")
    assert "1 of 7 photos do not state its exposure time in EXIF: IMG_9.png" in refused(photos, "--out", out)
    (photos / "IMG_9.png").unlink()
    assert {path.name: path.read_bytes() for path in photos.iterdir()} == before
    assert not out.exists() and not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--exposures", "a.csv", "--same-exposure"],
            "--exposures and --same-exposure contradict each other",
        ),
        (["--group", "none", "--bracket", 3], "--bracket 3 has no effect with --group none"),
        (["--group", "names", "--bracket", 2], "--bracket 2 has no effect with --group names"),
        (["--poses", "model", "--match", "each"], "--match is for finding cameras"),
        (["--poses", "model", "--camera", "RADIAL"], "--camera is for finding cameras"),
    ],
)
@pytest.mark.parametrize("look", [[], ["--look"]])
def test_options_that_say_nothing_together(tmp_path, words, message, look):
    """Said before a photo is looked for, and at a look as well."""
    assert message in refused(tmp_path / "nowhere", tmp_path / "out", *words, *look)


def test_what_the_panel_sends_together_is_no_error(room, tmp_path, monkeypatch, capsys):
    """It sends the lens always, and its settings stay as they were: Borrow Places without Hand-Held."""
    monkeypatch.setattr("physhdr.backend.cli.photos.recover", stopped)
    photos = tiny(room, tmp_path / "photos")
    words = ["--bracket", 2, "--max-width", 1600, "--camera", "OPENCV", "--borrow-poses", "--partial"]
    assert "COLMAP would run" in refused(photos, tmp_path / "out", *words)
    assert "--borrow-poses has no effect without --handheld" in " ".join(capsys.readouterr().out.split())


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


# ---- raw files, no brackets, hand-held -----------------------------------------------------------------


def true_model(folder, room, capture, names):
    """COLMAP's model of the room's own cameras, its lens's distortion among them, without points."""
    model = pycolmap.Reconstruction()
    params = [room.FOCAL, room.FOCAL, room.CX, room.CY, *room.DISTORTION]
    camera = pycolmap.Camera(camera_id=1, model="OPENCV", width=room.WIDTH, height=room.HEIGHT, params=params)
    model.add_camera_with_trivial_rig(camera)
    for number, (name, pose) in enumerate(zip(names, capture.poses, strict=False)):
        image = pycolmap.Image(name=name, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    (folder / "sparse" / "0").mkdir(parents=True)
    model.write(str(folder / "sparse" / "0"))
    return folder


def test_raw_brackets_become_linear_pictures_that_clip_at_one(room, dng, capture, tmp_path, capsys):
    """Mosaics of the room by a sensor with a black level and a red that sees half: against the room anew."""
    black, white, red, gain = 256, 4095, 0.5, 0.25
    photos, moment = tmp_path / "photos", datetime(2026, 5, 1)
    photos.mkdir()
    for number, seen in enumerate(capture.radiance[:3]):
        for k, seconds in enumerate(room.EXPOSURES):
            full = black + (white - black) * np.minimum(gain * seconds * seen * (red, 1.0, 1.0), 1.0)
            taken = f"{moment + timedelta(seconds=60 * number + 3 * k):%Y:%m:%d %H:%M:%S}"
            codes = dng.mosaic(np.rint(full).astype(np.uint16))
            path = photos / f"R{number}{k}.dng"
            dng.write_dng(path, codes, black, white, (red, 1.0, 1.0), seconds, 200, taken=taken)
    poses = true_model(tmp_path / "true", room, capture, [f"R{number}0.dng" for number in range(3)])
    out = tmp_path / "out"
    assert prepare(photos, out, "--poses", poses, "--downscale", 2, "--test-every", 0, "--json") == 0
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert said[-1]["result"]["placed"] == 3
    origin = json.loads((out / "prepare.json").read_text())
    assert (origin["kind"], origin["encoding"], origin["clip"]) == ("raw brackets", "linear", 1.0)
    assert origin["white_balance"] == pytest.approx([2.0, 1.0, 1.0])

    scene = read_scene(out)
    view = scene.train[1]
    assert all(encoding == SRGB for encoding in view.encodings)
    assert view.exposures == pytest.approx([2.0 * seconds for seconds in room.EXPOSURES])  # ISO 200
    camera = view.camera
    rays = room.rays_of_pinhole(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    seen = room.picture(capture.poses[view.index], rays, camera.width, camera.height)
    for k, seconds in enumerate(room.EXPOSURES):
        found = SRGB.exposed(view.image(k))
        true = np.minimum(gain * seconds * seen, 1.0)
        keep = view.mask(k)
        keep = np.ones(true.shape[:2], bool) if keep is None else keep
        assert keep.mean() > 0.9
        difference = (found - true)[keep]
        # The room is papered with coloured noise, of which a mosaic sees a third.
        assert np.abs(difference.mean(axis=0)).max() < 4e-3 and np.sqrt((difference**2).mean()) < 0.06
        clipped = (true == 1.0).all(axis=2) & keep
        assert np.median(found[clipped], initial=1.0) == 1.0 if clipped.any() else True


@pytest.mark.long
def test_heic_and_jpeg_of_a_phone_are_one_capture(room, heic, capture, tmp_path, capsys):
    """Each photo's HEIC is exact, a third of them are JPEG, one has both, one was not copied to its end."""
    folder = tmp_path / "phone"
    room.write_brackets(folder, capture)
    names = sorted(path.name for path in folder.iterdir())
    codes = {}
    for k, path in enumerate(sorted(folder.iterdir())):
        if k % 3 == 0:
            continue
        with Image.open(path) as picture:
            codes[path.stem], exif = np.asarray(picture), picture.info["exif"]
        heic.write_heic(path.with_suffix(".heic"), codes[path.stem], exif=exif, tile_size=128)
        if k != 1:
            path.unlink()
    broken = folder / Path(names[-1]).with_suffix(".heic")  # of the first place: the counter ran over
    broken.write_bytes(broken.read_bytes()[:-100])
    out = tmp_path / "out"
    assert prepare(folder, out, "--test-every", 0) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 photos are there as HEIC and as JPEG: the HEIC files are used" in said
    assert f"ignored: {broken.name} is not a readable photo (it ends after" in said
    assert f"{POSES - 1} of {POSES - 1} poses placed" in said and "exposures EV -3.0, -1.0, +1.0" in said
    origin = json.loads((out / "prepare.json").read_text())
    suffixes = [Path(source).suffix for source in origin["sources"].values()]
    assert suffixes.count(".heic") == 2 * suffixes.count(".jpg") == 2 * (POSES - 1)
    scene = read_scene(out)  # PNG: nothing that needs a HEIC's reader
    assert_poses(scene, replace(capture, poses=capture.poses[1:]), room)
    assert all(view.exposures == pytest.approx(room.EXPOSURES) for view in scene.train)
    for name, source in origin["sources"].items():
        before = codes.get(Path(source).stem)
        if before is not None:
            with Image.open(out / "images" / name) as picture:
                assert abs(np.asarray(picture).mean() - before.mean()) < 6.0  # but for the crop


@pytest.mark.long
def test_automatic_exposure_both_ways_up_and_masks(room, tmp_path, capsys):
    """No brackets, a third of the photos turned by a quarter: each way up has its own lens and size."""
    capture, folder, rays = room.Capture(), tmp_path / "photos", room.rays_of_lens()
    (folder / "masks").mkdir(parents=True)
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for k, pose in enumerate(room.arc(POSES)):
        turned = k % 3 == 2
        seen = room.picture(quarter @ pose if turned else pose, rays, room.WIDTH, room.HEIGHT)
        capture.poses.append(pose)
        seconds = 0.3 * 2.0 ** (0.4 * np.sin(1.3 * k))
        path = folder / f"P{k}.jpg"
        room.write_photo(path, room.codes(seen, seconds), seconds, iso=100, Orientation=6 if turned else 1)
    mask = np.full((room.HEIGHT, room.WIDTH), 255, np.uint8)
    mask[:100, :150] = 0
    Image.fromarray(mask).save(folder / "masks" / "P1.png")
    out = tmp_path / "out"
    words = ["--test-every", 4, "--camera", "RADIAL", "--max-width", room.WIDTH]
    assert prepare(folder, out, *words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{POSES} of {POSES} poses placed" in said and "without brackets" in said
    assert "stops from photo to photo" in said and "no HDR" not in said
    scene = read_scene(out)
    sizes = {view.camera.width > view.camera.height for view in scene.train}
    assert sizes == {True, False} and len(scene.train[0].exposures) == 1
    # A barrel's pictures would be 413 wide: the photos' width is not the pictures'.
    assert max(view.camera.width for view in (*scene.train, *scene.test)) == room.WIDTH
    assert_poses(scene, capture, room, 15.0)  # three photos tell little of their lens
    masked = next(view for view in [*scene.train, *scene.test] if view.index == 1)
    hidden = ~masked.mask(0)
    assert hidden[:80, :120].all() and not hidden[130:].any() and not hidden[:, 180:].any()


@pytest.mark.long
def test_hand_held_brackets_and_black_photos_that_borrow(room, tmp_path, capsys):
    """Six places, two exposures of each from a hand that moves by centimetres; two dark ones are black."""
    capture, folder, random = room.Capture(), tmp_path / "photos", np.random.default_rng(1)
    rays, moment = room.rays_of_lens(), datetime(2026, 5, 1)
    folder.mkdir()
    for place, level in enumerate(room.arc(6)):
        for k, seconds in enumerate((0.15, 1.0)):
            centre = -level[:, :3].T @ level[:, 3] + random.normal(0.0, 0.03, 3)
            pose = room.look_from(tuple(centre), tuple(random.normal((0.0, 0.0, 0.6), 0.05)))
            capture.poses.append(pose)
            pixels = room.codes(room.picture(pose, rays, room.WIDTH, room.HEIGHT), seconds)
            if place in (1, 4) and k == 0:
                pixels[:] = 0
            taken = moment + timedelta(seconds=30 * place + 2 * k)
            room.write_photo(folder / f"H{place}{k}.png", pixels, seconds, taken, 100, 8.0)
    out = tmp_path / "out"
    words = ["--handheld", "--borrow-poses", "--test-every", 3, "--camera", "RADIAL"]
    assert prepare(folder, out, *words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "2 photos took the pose of the next in their bracket: H10, H40" in said
    origin = json.loads((out / "prepare.json").read_text())
    assert origin["kind"] == "handheld" and origin["borrowed"] == {"H10": "H11", "H40": "H41"}
    scene = read_scene(out)
    views = {view.index: view for view in [*scene.train, *scene.test]}
    assert len(views) == 12 and all(len(view.exposures) == 1 for view in views.values())
    # Both photos of a place are for the test, or neither is, and no place of a borrowed pose.
    tested = {view.index for view in scene.test}
    assert tested and tested == {index ^ 1 for index in tested} and not tested & {2, 3, 8, 9}
    for borrower, owner in ((2, 3), (8, 9)):
        mine, other = views[borrower].camera, views[owner].camera
        np.testing.assert_allclose(mine.camera_to_world, other.camera_to_world, atol=1e-6)
        capture.poses[borrower] = capture.poses[owner]
    assert_poses(scene, capture, room, 15.0)


# ---- what programs are told ----------------------------------------------------------------------------


def look(capsys, *words):
    assert prepare(*words, "--look", "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(set(line) <= {"progress", "message", "seconds_left"} for line in lines[:-1])
    return lines[-1]["result"]


def test_a_look_says_what_photos_are_and_makes_nothing(room, tmp_path, capsys):
    photos = tiny(room, tmp_path / "photos", 9, (0, -2, 2))
    (photos / "clip.mp4").write_bytes(b"video")
    found = look(capsys, photos)
    assert (found["kind"], found["photos"], found["places"], found["per_place"]) == ("brackets", 9, 3, 3)
    assert found["exposures"] == pytest.approx([0.25, 1.0, 4.0]) and found["stops"] == 4.0
    assert found["size"] == [16, 12] and found["how"].startswith("by order")
    assert [each["name"] for each in found["skipped"]] == ["clip.mp4"]
    assert any("clip.mp4 is a video" in warning for warning in found["warnings"])
    assert found["lines"] and found["estimate_seconds"] >= 0
    assert look(capsys, photos, "--handheld")["kind"] == "handheld"
    single = look(capsys, photos, "--same-exposure")
    assert single["kind"] == "single" and single["stops"] == 0.0
    assert any("no HDR" in warning for warning in single["warnings"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos"]


def test_a_look_at_automatic_exposure(room, tmp_path, capsys):
    """1/500 to 1/1250 s: 1.3 stops over the views, and no word of a lack of HDR."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for k, time in enumerate((800, 640, 640, 500, 640, 800, 1000, 1250, 1000, 1000, 800)):
        room.write_photo(folder / f"{k}.jpg", np.full((12, 16, 3), 90, np.uint8), 1 / time, iso=100)
    found = look(capsys, folder)
    assert (found["kind"], found["places"], found["per_place"]) == ("single", 11, 1)
    assert found["stops"] == pytest.approx(np.log2(2.5), abs=0.01) and not found["warnings"]
    assert any("span 1.3 stops" in line for line in found["lines"])


def test_a_look_names_the_few_photos_of_a_digital_zoom(room, tmp_path, capsys):
    folder, pixels = tmp_path / "photos", np.full((12, 16, 3), 90, np.uint8)
    folder.mkdir()
    for k in range(6):
        zoom = (
            {"FocalLengthIn35mmFilm": 48, "DigitalZoomRatio": 2} if k > 3 else {"FocalLengthIn35mmFilm": 24}
        )
        room.write_photo(folder / f"{k}.jpg", pixels, 0.01, FocalLength=6.8, **zoom)
    few = [line for line in look(capsys, folder)["warnings"] if "little of their lens" in line]
    words = "few photos are 16×12 at 6.8 mm (48 mm on 35 mm film), zoomed digitally 2 times"
    assert len(few) == 1 and few[0].startswith(words) and few[0].endswith("4.jpg, 5.jpg")


def merged(path):
    """A TIFF of floats, as programs write what they merge from a bracket."""
    spec = OpenImageIO.ImageSpec(16, 12, 3, "float")
    writer = OpenImageIO.ImageOutput.create(str(path))
    assert writer.open(str(path), spec) and writer.write_image(np.ones((12, 16, 3), np.float32))
    writer.close()


def test_what_is_not_of_the_photos_costs_no_bracket(room, tmp_path, capsys):
    """A merged picture beside each bracket, a picture for printers, another program's .raw."""
    photos = tiny(room, tmp_path / "photos", 12, (0, -4, 4))
    for k in range(0, 12, 3):
        merged(photos / f"IMG_{k}_HDR.tif")
    Image.new("CMYK", (16, 12)).save(photos / "poster.jpg")
    (photos / "notes.raw").write_bytes(b"mine")
    found = look(capsys, photos)
    assert (found["places"], found["per_place"]) == (4, 3)
    why = {each["name"]: each["why"] for each in found["skipped"]}
    assert "holds radiance" in why["IMG_0_HDR.tif"] and "CMYK" in why["poster.jpg"] and len(why) == 6
    assert all(any(name in warning for warning in found["warnings"]) for name in ("IMG_9_HDR", "notes.raw"))
    (photos / "IMG_7.jpg").unlink()
    said = refused(photos, "--look")  # and says what may be behind it
    assert "not plain which of the 11" in said and "ignored: poster.jpg is not an RGB picture" in said


def test_a_mask_that_does_not_fit_or_is_damaged_costs_no_hours(room, tmp_path, monkeypatch):
    """Of any photo of a bracket, and before COLMAP has begun; what a header shows a look tells."""
    photos, mask = tiny(room, tmp_path / "photos"), tmp_path / "photos" / "masks" / "IMG_0.png"
    monkeypatch.setattr("physhdr.backend.cli.photos.recover", lambda *_: pytest.fail("COLMAP ran"))
    mask.parent.mkdir()
    random = np.random.default_rng(0).integers(0, 256, (12, 16), np.uint8)
    Image.fromarray(random[:6]).save(mask)
    assert "IMG_0.png is 16×6, its photo IMG_0.jpg is 16×12" in refused(photos, "--look")
    Image.fromarray(random).save(mask)
    mask.write_bytes(mask.read_bytes()[:150])
    assert "IMG_0.png is not a readable mask" in refused(photos, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_masks_that_hide_everything_are_told(room, tmp_path, monkeypatch, capsys):
    """COLMAP finds nothing there, and would speak of texture."""
    photos = tiny(room, tmp_path / "photos")
    (photos / "masks").mkdir()
    for name, shade in (("IMG_0", 127), ("IMG_1", 0), ("IMG_2", 255)):
        Image.new("L", (16, 12), shade).save(photos / "masks" / f"{name}.png")
    monkeypatch.setattr("physhdr.backend.cli.photos.recover", stopped)
    refused(photos, "--out", tmp_path / "out")
    said = " ".join(capsys.readouterr().out.split())
    assert "ignoring photos whose masks are entirely black: IMG_0.jpg, IMG_1.jpg" in said
    assert "IMG_2.jpg" not in said


def test_where_each_place_has_a_damaged_photo_they_are_named(room, tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for place in "abc":
        for k in range(2):
            room.write_photo(photos / f"{place}_{k}.jpg", np.full((12, 16, 3), 90, np.uint8), 2.0**k)
        (photos / f"{place}_1.jpg").write_bytes(b"no picture")
    assert "a damaged photo: a_1.jpg, b_1.jpg, c_1.jpg" in refused(photos, "--look")


def test_errors_are_json_too(room, tmp_path, capsys):
    assert main(["prepare", str(tmp_path / "nowhere"), str(tmp_path / "out"), "--json"]) == 1
    error = json.loads(capsys.readouterr().out.splitlines()[-1])["error"]
    assert error["code"] == "file_missing" and "nowhere" in error["message"] and error["hint"]
    photos = tiny(room, tmp_path / "photos")
    assert "no folder was given" in refused(photos)
    assert "two places" in refused(photos, tmp_path / "a", "--out", tmp_path / "b")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--triangulate", "--layout", "colmap"], "exclude each other"),
        (["--triangulate", "--handheld"], "--handheld has no effect on the points of a data set"),
        (["--layout", "colmap", "--overwrite"], "--overwrite has no effect on a data set for other programs"),
        (["--link"], "--link has no effect on a data set of photos"),
        (["--training-exposures", "0"], "--training-exposures has no effect on a data set of photos"),
    ],
)
def test_an_option_of_another_kind_of_data_set_is_refused(options, message, tmp_path):
    with pytest.raises(BadValueError, match=message):
        tyro.cli(Prepare, args=[str(tmp_path), str(tmp_path / "out"), *options]).run()


START = "import sys; from physhdr.backend.cli import main; sys.exit(main())"


def started(photos, out):
    """``physhdr prepare`` in a group of its own, as the panel starts it, with COLMAP at work; COLMAP's."""
    words = ["prepare", str(photos), str(out), "--json", "--threads", "1"]
    process = subprocess.Popen(
        [sys.executable, "-c", START, *words], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    for line in process.stdout:
        if "COLMAP: features" in line:
            break
    (child,) = psutil.Process(process.pid).children()
    return process, child


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_cancelled_it_leaves_nothing(photos, tmp_path, number):
    process, child = started(photos, tmp_path / "out")
    if number == signal.SIGINT:
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    rest = process.stdout.read().splitlines()
    assert process.wait() == 130 and json.loads(rest[-1])["error"]["code"] == "cancelled"
    psutil.wait_procs([child], timeout=10)
    assert not child.is_running() and not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_killed_it_leaves_no_data_set_and_no_process_and_the_next_one_tidies(photos, tmp_path):
    process, child = started(photos, tmp_path / "out")
    process.kill()
    process.wait()
    psutil.wait_procs([child], timeout=30)
    assert not child.is_running()
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".out-")
    with new_folder(tmp_path / "out", False) as folder:
        (folder / "prepare.json").write_text("{}")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_disk_that_fills_up(prepared, tmp_path, monkeypatch):
    """While the pictures are written: nothing is left, and one message."""
    write, written = data_set._write_picture, []

    def full(*arguments, **options):
        written.append(arguments)
        if len(written) > 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(*arguments, **options)

    monkeypatch.setattr(data_set, "_write_picture", full)
    words = ["--poses", prepared, "--exposures", prepared / "exposure.json"]
    message = refused(prepared / "images", tmp_path / "out", *words)
    assert "cannot write" in message and "No space left" in message and "free space" in message
    assert not list(tmp_path.iterdir())


def test_a_damaged_photo_costs_its_bracket_and_nothing_else(room, prepared, tmp_path, capsys):
    """One that cannot be opened, one that ends too early: of two places of nine."""
    images = tmp_path / "images"
    shutil.copytree(prepared / "images", images)
    names = sorted(path.name for path in images.iterdir())
    (images / names[4]).write_bytes(b"no picture")
    whole = (images / names[9]).read_bytes()
    (images / names[9]).write_bytes(whole[: len(whole) // 2])
    words = ["--poses", prepared, "--exposures", prepared / "exposure.json"]
    assert prepare(images, tmp_path / "out", *words) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{POSES - 2} of {POSES - 2} poses placed" in said
    assert f"ignored: {names[4]} is not a readable photo" in said and f"ignored: {names[9]}" in said
    skipped = json.loads((tmp_path / "out" / "prepare.json").read_text())["skipped"]
    assert set(skipped) == {*names[3:6], *names[9:12]}
