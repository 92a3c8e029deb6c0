# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare`` of photos under several lights: folders, words, one reconstruction, lights.json."""

import json
from datetime import timedelta
from importlib import import_module

import numpy as np
import pycolmap
import pytest
import tyro
from PIL import Image

from physhdr.backend.cli.prepare import Prepare
from physhdr.backend.inspect import inspect
from physhdr.backend.scene.capture import structure
from physhdr.backend.scene.capture.structure import pairs_of_lights
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.light_groups import read_light_groups

room = import_module("physhdr.tests.backend.scene.capture.room")

PLACES, LIT = 9, (1, 2, 4, 5, 6, 7)


def prepare(*words):
    return tyro.cli(Prepare, args=[str(word) for word in (*words, "--threads", 1)]).run()


def refused(*words):
    """A run that must fail; its message, which names a remedy."""
    with pytest.raises(PhysHDRError) as caught:
        prepare(*words)
    assert caught.value.hint
    return str(caught.value)


@pytest.fixture(scope="module")
def shoot(tmp_path_factory):
    """Brackets of two and three exposures: with the pendant, and without it."""
    folder, rays = tmp_path_factory.mktemp("lights"), room.rays_of_lens()
    for number, pose in enumerate(room.arc(PLACES)):
        corner, pendant = room.pictures(pose, rays, room.WIDTH, room.HEIGHT, (room.LAMP, room.PENDANT))
        room.write_bracket(folder / "room", number, corner + 1.5 * pendant, (0.1, 0.4))
        if number in LIT:
            room.write_bracket(folder / "room" / "pendant off", LIT.index(number), corner, (0.25, 1.0, 4.0))
    return folder


@pytest.fixture(scope="module")
def prepared(shoot, tmp_path_factory):
    out = tmp_path_factory.mktemp("prepared") / "room"
    assert prepare(shoot / "room", out, "--test-every", 4) == 0
    return out


def test_all_lights_are_placed_in_one_reconstruction(prepared):
    """Photos without the pendant stand where those with it stand, though files have the same names."""
    model = pycolmap.Reconstruction(str(prepared / "sparse" / "0"))
    by_number = {int(image.name.split("_")[1]): image for image in model.images.values()}
    assert sorted(by_number) == list(range(PLACES + len(LIT)))
    places = {k: image.projection_center() for k, image in by_number.items()}
    step = np.linalg.norm(places[1] - places[0])
    for k, place in enumerate(LIT):
        assert np.linalg.norm(places[PLACES + k] - places[place]) < 0.02 * step
    sources = json.loads((prepared / "prepare.json").read_text())["sources"]
    assert sum(name.startswith("pendant off/") for name in sources.values()) == 3 * len(LIT)
    assert {"IMG_0000.jpg", "pendant off/IMG_0000.jpg"} <= set(sources.values())


def test_lights_json_names_the_photos_of_each_light(prepared):
    lights = read_light_groups(prepared)
    assert lights is not None and lights.lights == ("ambient", "pendant") and not lights.standard
    (group,) = lights.groups
    assert group.name == "pendant off" and group.levels == {"pendant": 0.0}
    stems = {path.name.rsplit("_", 1)[0] for path in (prepared / "images").iterdir()}
    assert {*group.pictures} == {stem for stem in stems if int(stem[-3:]) >= PLACES}
    tested = [stem for stem in stems if stem.startswith("test")]
    assert sum(stem in group.pictures for stem in tested) == 1 < len(tested)


def test_exposures_are_on_one_scale_and_show_that_the_pendant_is_off(prepared):
    """Radiance of both lights by the true response: without the pendant no pixel is brighter."""
    exposures = json.loads((prepared / "exposure.json").read_text())

    def radiance(stem, k):
        code = np.asarray(Image.open(prepared / "images" / f"{stem}_{k}.png"), float) / 255.0
        x = np.clip(code, 0.0, 0.98) ** 2.2
        return np.where((code > 0.1) & (code < 0.9), x / (1.0 - x) / exposures[f"{stem}_{k}.png"], np.nan)

    lit = f"train_{PLACES:03d}" if (prepared / "images" / f"train_{PLACES:03d}_0.png").exists() else None
    lit = lit or f"test_{PLACES:03d}"
    assert {f"{lit}_{k}.png" for k in (0, 2, 4)} <= set(exposures)  # three exposures, the others have two
    both = next(radiance(f"{word}_001", 2) for word in ("train", "test") if f"{word}_001_2.png" in exposures)
    ratio = radiance(lit, 2) / both
    assert np.nanpercentile(ratio, 95) < 1.1 and np.nanmedian(ratio) < 0.8


def test_inspect_says_which_lights_can_be_turned(prepared):
    found = inspect(prepared)
    assert not found.errors and found.lights == ["ambient", "pendant"]
    assert found.turnable == [f"pendant can be turned afterwards: off from {len(LIT)} places"]
    assert [exposure.seconds for exposure in found.exposures] == [0.1, 0.4]
    assert not any("differ from view to view" in warning for warning in found.warnings)
    assert {name: split.poses for name, split in found.splits.items()}["lit_test"] == 1


def test_other_programs_get_the_standard_light_alone(prepared, tmp_path, capsys):
    words = [str(prepared), str(tmp_path / "out"), "--layout", "nerfstudio"]
    assert tyro.cli(Prepare, args=words).run() == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{len(LIT)} views under other light were ignored" in said
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert len(frames) == PLACES


# ---- without COLMAP ------------------------------------------------------------------------------------


def tiny(folder, count=6, seconds=(1.0, 4.0), size=(16, 12), make="Room", first=0):
    """Grey photos that only headers are read of."""
    folder.mkdir(parents=True)
    for k in range(count):
        moment = room.MOMENT + timedelta(seconds=20 * (k // len(seconds)) + 5 * (k % len(seconds)))
        pixels = np.full((size[1], size[0], 3), 90, np.uint8)
        path = folder / f"IMG_{first + k}.jpg"
        room.write_photo(path, pixels, seconds[k % len(seconds)], moment, 100, 8.0)
        if make != "Room":
            with Image.open(path) as picture:
                exif = picture.getexif()
                exif[271] = make
                picture.save(path, exif=exif)
    return folder


def look(capsys, *words):
    assert prepare(*words, "--look", "--json") == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])["result"]


def test_a_look_says_which_lights_can_be_turned(tmp_path, capsys):
    photos, off = tiny(tmp_path / "photos"), tiny(tmp_path / "elsewhere" / "a", 2, (0.5, 2.0))
    evening = tiny(tmp_path / "elsewhere" / "b", 4, size=(12, 16))
    words = (
        f"--light=pendant={off}:off",
        f"--light=daylight={evening}:evening",
        f"--light=lamp={evening}:on",
    )
    found = look(capsys, photos, *words)
    assert (found["photos"], found["places"], found["per_place"]) == (6, 3, 2)
    assert found["lights"] == [
        {"group": "pendant off", "levels": {"pendant": 0.0}, "places": 1},
        {"group": "daylight evening + lamp on", "levels": {"daylight": None, "lamp": 1.0}, "places": 2},
    ]
    assert "pendant can be turned afterwards: off from 1 place" in found["lines"]
    assert any("daylight and lamp always change together" in each for each in found["warnings"])
    assert any("12×16" in each for each in found["warnings"])  # few photos of another size
    assert look(capsys, photos)["lights"] == []
    held = look(capsys, photos, *words, "--handheld")
    assert (held["kind"], held["places"]) == ("handheld", 3)
    assert [each["places"] for each in held["lights"]] == [1, 2]


def test_a_file_of_exposures_names_photos_with_their_folder(tmp_path, capsys):
    """Both folders have an IMG_0.jpg; only one has an IMG_9.jpg, which needs no folder."""
    photos, off = tiny(tmp_path / "photos", 4, (1.0,)), tiny(tmp_path / "pendant off", 2, (1.0,))
    (off / "IMG_1.jpg").rename(off / "IMG_9.jpg")
    rows = [f"IMG_{k}.jpg,{k + 1}" for k in range(4)]
    (tmp_path / "t.csv").write_text("\n".join([*rows, "pendant off/IMG_0.jpg,8", "IMG_9.jpg,16"]))
    words = [photos, "--exposures", tmp_path / "t.csv", "--group", "none"]
    lines = look(capsys, *words)["lines"]
    assert any(line.startswith("pendant off: 2 photos") and line.endswith(": 8 s to 16 s") for line in lines)
    (tmp_path / "t.csv").write_text("\n".join([*rows, "IMG_9.jpg,16"]))
    assert "no exposure for 1 of 6 photos: pendant off/IMG_0.jpg" in refused(*words, "--look")


def test_folders_in_or_beside_that_say_it_themselves(tmp_path, capsys):
    photos = tiny(tmp_path / "photos")
    tiny(photos / "Pendant off", 4)
    tiny(tmp_path / "pendant_2x", 4)
    tiny(tmp_path / "desk_lamp_off", 4)
    (tmp_path / "flash on").mkdir()  # no photos
    found = look(capsys, photos)
    assert [each["levels"] for each in found["lights"]] == [
        {"Pendant": 0.0},
        {"desk_lamp": 0.0},
        {"Pendant": 2.0},
    ]
    assert look(capsys, photos, "--light", "none")["lights"] == []
    only = look(capsys, photos, "--light", photos / "Pendant off", "--light", "none")
    assert [each["group"] for each in only["lights"]] == ["Pendant off"]
    more = look(capsys, photos, f"--light=flash={tmp_path / 'pendant_2x'}:on")
    assert [each["group"] for each in more["lights"]] == ["flash on", "Pendant off", "desk_lamp off"]


def with_cameras(folder):
    """Photos under two lights and a model of their cameras, from which the same is written as by COLMAP."""
    photos = tiny(folder / "photos", 12)
    tiny(folder / "flash on", 12)
    poses, model = room.arc(6), pycolmap.Reconstruction()
    camera = pycolmap.Camera(camera_id=1, model="PINHOLE", width=16, height=12, params=[15, 15, 8, 6])
    model.add_camera_with_trivial_rig(camera)
    for light in ("", "flash on/"):
        for number, pose in enumerate(poses):
            name, image_id = f"{light}IMG_{2 * number}.jpg", model.num_images() + 1
            image = pycolmap.Image(name=name, camera_id=1, image_id=image_id)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    (folder / "model").mkdir()
    model.write(str(folder / "model"))
    return photos, folder / "model"


def test_a_light_that_is_on_in_its_group_alone_is_off_in_the_standard(tmp_path):
    photos, model = with_cameras(tmp_path)
    out = tmp_path / "out"
    assert prepare(photos, out, "--poses", model, "--test-every", 3) == 0
    lights = read_light_groups(out)
    assert lights is not None and lights.standard == {"flash": 0.0}
    assert lights.groups[0].levels == {"flash": 1.0} and len(lights.groups[0].pictures) == 6
    assert sum(name.startswith("test") for name in lights.groups[0].pictures) >= 1


def test_what_is_left_out_is_named(tmp_path, capsys):
    photos, model = with_cameras(tmp_path)
    tiny(tmp_path / "lamp_dim", 4)
    tiny(photos / "pictures of us", 1)
    out = tmp_path / "out"
    assert prepare(photos, out, "--poses", model) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "folders whose names say which light differs: 'flash on', 'lamp_dim'" in said
    assert "ignoring folders of photos whose names say no light: pictures of us" in said
    assert "ignoring 'lamp dim': none of its photos could be placed" in said
    assert "flash can be turned afterwards: on from 6 places" in said
    assert "lamp can be turned" not in said.split(f"wrote {out}")[1]
    assert json.loads((out / "prepare.json").read_text())["lights"] == {"flash on": "flash on"}
    assert prepare(photos, out, "--overwrite", "--look", "--light", "none") == 0


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        (["pendant=nowhere:off"], "does not exist"),
        (["pendant=empty:off"], "holds no photos"),
        (["pendant=a:blue"], "'blue' does not say what pendant does"),
        (["pendant=a"], "does not say what pendant does in the folder"),
        (["7=a:off"], "'7' is no name of a light"),
        (["a"], "the folder's name does not say which light"),
        (["pendant=a:off", "pendant=a:on"], "for 'pendant off' and for 'pendant on'"),
        (["pendant=a:off", "Pendant=b:off"], "two folders are 'pendant off'"),
        (["pendant=a:on", "pendant=b:off"], "pendant is off in the other photos already"),
        (["pendant=a:1"], "which is the light of the other photos, too"),
        (["pendant=photos:off"], "is the folder of the standard light"),
    ],
)
def test_what_can_be_wrong_with_lights(tmp_path, monkeypatch, lights, message):
    monkeypatch.chdir(tmp_path)
    for name in ("photos", "a", "b"):
        tiny(tmp_path / name)
    (tmp_path / "empty").mkdir()
    options = [f"--light={light}" for light in lights]
    assert message in refused("photos", "out", *options)
    assert not (tmp_path / "out").exists()


def test_photos_of_another_camera_leave_their_light_out(tmp_path, monkeypatch, capsys):
    photos = tiny(tmp_path / "photos")
    tiny(tmp_path / "pendant off", make="Phone")
    found = look(capsys, photos)
    assert any("was taken by Phone" in each for each in found["warnings"])
    assert "ignoring 'pendant off': none of its photos can be used" in found["warnings"]
    monkeypatch.setattr("physhdr.backend.cli.photos.recover", lambda *_: pytest.fail("hours of COLMAP"))
    assert "no photo under other light could be placed" in refused(photos, tmp_path / "out")


def test_the_data_set_may_not_take_the_place_of_a_lights_photos(tmp_path):
    photos, off = tiny(tmp_path / "photos"), tiny(tmp_path / "pendant off")
    assert "holds the photos" in refused(photos, off, "--overwrite")


def test_if_no_light_can_be_placed_it_says_so(tmp_path, monkeypatch):
    """The other photos alone would be a data set that nobody asked for."""
    photos = tiny(tmp_path / "photos")
    tiny(tmp_path / "pendant off")
    pose = structure.RegisteredPose(1, np.eye(3), np.zeros(3), np.zeros((0, 2)), np.zeros(0, np.int64))
    nothing = np.zeros((0, 3))
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 15.0, 16, 12)
    found = structure.Structure({1: camera}, dict.fromkeys(range(3), pose), nothing, nothing, nothing[:, 0])
    monkeypatch.setattr("physhdr.backend.cli.photos.recover", lambda *_: found)
    assert "no photo under other light could be placed: pendant off" in refused(photos, tmp_path / "out")
    monkeypatch.setattr("physhdr.backend.cli.photos.existing", lambda *_: found)
    message = refused(photos, tmp_path / "out", "--poses", tmp_path)
    assert f"The reconstruction in {tmp_path} must have them" in message and "texture" not in message


def test_many_photos_are_matched_within_a_light_and_with_the_standard_one():
    standard, lit, other = range(300), range(300, 308), range(308, 316)
    chain = [(k, k + 1) for k in range(299)]
    pairs = pairs_of_lights({"": (standard, chain), "a": (lit, [(300, 301)]), "b": (other, [])})
    assert len(pairs) == len(set(pairs)) == 299 + 1 + 100 * 16
    assert {one for one, number in pairs if number == 305} == set(range(0, 300, 3))
    few = pairs_of_lights({"": (range(4), []), "a": (range(4, 6), [])})
    assert len(few) == 15
