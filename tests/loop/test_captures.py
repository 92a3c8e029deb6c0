# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos of a capture as other programs read them: Pillow, LibRaw and COLMAP. Nothing is rendered here."""

import contextlib
import io
import json
import shutil
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from PIL import Image

from physhdr.lab.tools import take_photos
from physhdr.synth import passes
from physhdr.synth.capture import Capture, Place, opened
from physhdr.synth.lens import OPENCV, Lens
from physhdr.synth.passes import Passes

WIDTH, HEIGHT, PATCH = 80, 60, 20
LENS = Lens(
    model=OPENCV,
    coefficients=(-0.12, 0.03, 0.001, -0.0008),
    width=WIDTH,
    height=HEIGHT,
    fx=66.0,
    fy=66.0,
    cx=40.0,
    cy=30.0,
)
FULL = 0.18 * 78 / 10  # exposure × radiance that fills the sensor, as docs/photos.md says
RAW_CODES = 16383 - 512


def pose_on_an_arc(angle: float) -> np.ndarray:
    """Camera to world, 3 m from the origin, turned by ``angle`` and tilted, with Blender's axes."""
    a, b = np.cos([angle, 0.2]), np.sin([angle, 0.2])
    turned = np.array([[a[0], -b[0], 0], [b[0], a[0], 0], [0, 0, 1]])
    upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    tilted = np.array([[1, 0, 0], [0, a[1], -b[1]], [0, b[1], a[1]]])
    pose = np.eye(4)
    pose[:3, :3] = turned @ upright @ tilted
    pose[:3, 3] = 3.0 * pose[:3, 2]
    return pose


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    """Nine places of patches in various colours, a wall 2 m away; a pendant lights the left half."""
    root = tmp_path_factory.mktemp("capture") / "patches"
    places = tuple(Place(k, pose_on_an_arc(0.1 * (k - 4)), k == 4) for k in range(9))
    made = Capture(root, {"scene": "patches"}, LENS, LENS.straight, ("ambient", "pendant"), places)
    made.enter()
    dice = np.random.default_rng(3)
    for place in places:
        colours = np.exp2(dice.uniform(-5.0, 3.0, (HEIGHT // PATCH, WIDTH // PATCH, 3)))
        radiance = colours.repeat(PATCH, 0).repeat(PATCH, 1).astype(np.float32)
        flat = np.ones((HEIGHT, WIDTH), np.float32)
        pendant = 0.75 * radiance * (np.arange(WIDTH) < WIDTH / 2)[None, :, None]
        shown = Passes(
            {"ambient": radiance - pendant, "pendant": pendant},
            depth=2.0 * flat,
            normal=np.zeros_like(radiance),
            index=flat,
            samples=flat,
            facts={},
        )
        passes.write(made.file(place), shown)
    return opened(root)


def run(tool, *words) -> tuple[int, str]:
    """The tool's exit status, and what it writes to the standard error output."""
    command = mock.patch.object(sys, "argv", [tool.__name__, *map(str, words)])
    with command, contextlib.redirect_stderr(io.StringIO()) as said:
        return tool.main(), said.getvalue()


def take(capture: Capture, out: Path, *options: str) -> list[dict]:
    """Runs the tool; the truth about the photos."""
    assert run(take_photos, capture.root, "--out", out, *options) == (0, "")
    return json.loads((out / "truth" / "photos.json").read_text())["photos"]


def radiance(capture: Capture, photo: dict) -> np.ndarray:
    place = next(place for place in capture.places if place.name == photo["place"])
    return capture.passes(place).radiance({}).astype(np.float64)


def exif(path: Path) -> dict:
    with Image.open(path) as picture:
        return dict(picture.getexif().get_ifd(34665))


def test_a_bracket_says_in_exif_what_it_was_taken_with(capture, tmp_path):
    told = take(capture, tmp_path / "out", "--bracket=-2,0,2", "--iso", "800", "--crf", "srgb")
    assert len(told) == 27
    first, second, third, other = (tmp_path / "out" / "photos" / photo["file"] for photo in told[:4])
    assert exif(second)[33434] == pytest.approx(told[1]["exposure"] * 100 / 800, rel=1e-6)
    assert exif(first)[33434] * 16 == pytest.approx(exif(third)[33434], rel=1e-6)
    assert [exif(path)[37380] for path in (first, second, third)] == [-2.0, 0.0, 2.0]
    assert exif(first)[34855] == 800 and exif(first)[33437] == 8.0
    assert exif(first)[41989] == round(66 / 80 * 36)
    assert exif(first)[36867] < exif(third)[36867] < exif(other)[36867]
    with Image.open(first) as picture:
        assert (picture.getexif()[271], picture.getexif()[272]) == ("PhysHDR", "Synthetic")
    # Middle grey is where the meter puts it: half of all pixels are about as bright as that.
    with Image.open(second) as picture:
        assert 60 < np.median(np.asarray(picture)) < 190


def test_faults_are_in_training_photos_and_not_in_those_for_testing(capture, tmp_path):
    faults = ("--exposure-jitter", "0.5", "--white-balance-jitter", "0.4", "--vignetting", "2")
    told = take(capture, tmp_path / "out", "--auto-exposure", "--quality", "100", "--crf", "srgb", *faults)
    assert [photo["test"] for photo in told] == [k == 4 for k in range(9)]
    for photo in told:
        x = radiance(capture, photo) * photo["true_exposure"] * photo["white_balance"]
        with Image.open(tmp_path / "out" / "photos" / photo["file"]) as picture:
            code = np.asarray(picture).astype(np.float64)
        ideal = 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.minimum(x, 1) ** (1 / 2.4) - 0.055)
        inside = (slice(8, 12), slice(8, 12))  # of the upper left patch, where JPEG has no edge
        if photo["test"]:
            assert photo["true_exposure"] == photo["exposure"] and photo["white_balance"] == [1, 1, 1]
            assert code[inside].mean((0, 1)) == pytest.approx(ideal[inside].mean((0, 1)), abs=2.5)
        else:
            assert photo["true_exposure"] != photo["exposure"]
            dark = code[inside].mean() < 0.97 * ideal[inside].mean()
            assert dark or ideal[inside].min() > 250  # two stops are lost in the corner


def test_photos_of_a_group_are_under_its_light_and_metered_there(capture, tmp_path):
    group = (
        "--group",
        "pendant off",
        "pendant=0",
        "3",
        "--auto-exposure",
        "--crf",
        "srgb",
        "--quality",
        "100",
    )
    told = take(capture, tmp_path / "out", *group)
    of_group = [photo for photo in told if photo["folder"] == "pendant off"]
    assert len(told) == 9 + 3 and len({photo["file"] for photo in told}) == len(told)
    assert len({photo["place"] for photo in of_group}) == 3 and not any(p["test"] for p in of_group)
    for photo in of_group:
        assert photo["levels"] == {"pendant": 0.0}
        place = next(place for place in capture.places if place.name == photo["place"])
        light = capture.passes(place).lights["ambient"].astype(np.float64) * photo["exposure"]
        ideal = 255 * np.where(
            light <= 0.0031308, 12.92 * light, 1.055 * np.minimum(light, 1) ** (1 / 2.4) - 0.055
        )
        with Image.open(tmp_path / "out" / "pendant off" / photo["file"]) as picture:
            code = np.asarray(picture).astype(np.float64)
        for x in (8, 68):
            inside = (slice(8, 12), slice(x, x + 4))  # of a patch, where JPEG has no edge
            assert code[inside].mean((0, 1)) == pytest.approx(ideal[inside].mean((0, 1)), abs=2.5)
        standard = next(p for p in told if p["place"] == photo["place"] and p["folder"] == "photos")
        assert photo["exposure"] > standard["exposure"]  # the camera sees that it is darker
    placed = (tmp_path / "out" / "truth" / "sparse" / "0" / "images.txt").read_text()
    assert all(photo["file"] in placed for photo in told)  # one exposure a place: each is the middle one
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert [frame.get("lighting_levels") for frame in frames][-4:] == [None, *[{"pendant": 0.0}] * 3]


@pytest.mark.parametrize("mosaic", [False, True])
def test_libraw_reads_what_the_sensor_counted(capture, tmp_path, mosaic):
    """Developed with the camera's white balance and no look, it is the light itself, to a code of the raw."""
    rawpy = pytest.importorskip("rawpy")
    told = take(capture, tmp_path / "out", "--auto-exposure", "--format", "cfa" if mosaic else "dng")
    for photo in told[:3]:
        with rawpy.imread(str(tmp_path / "out" / "photos" / photo["file"])) as raw:
            assert list(raw.black_level_per_channel)[:3] == [512] * 3 and raw.white_level == 16383
            found = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                adjust_maximum_thr=0.0,  # else LibRaw takes the brightest pixel for a full one
                output_color=rawpy.ColorSpace.sRGB,
            )
        light = radiance(capture, photo) * photo["exposure"] / FULL
        middles = (np.arange(HEIGHT) % PATCH // 4 == 2)[:, None] & (np.arange(WIDTH) % PATCH // 4 == 2)[None]
        where = middles if mosaic else np.full_like(middles, True)
        # Of a linear DNG LibRaw takes the black level off, but divides by the white level alone.
        share = 1.0 if mosaic else RAW_CODES / 16383
        off = np.abs(found / 65535.0 / share - np.minimum(light, 1.0)) * RAW_CODES
        where &= (light < share).all(-1)
        # Red and blue count less than green, so a code of theirs is two, or one and a half, of light.
        assert (off[where] <= [2.0, 1.0, 1.0 / 0.65]).mean() == 1.0


def test_a_raw_files_white_balance_is_as_wrong_as_the_camera_thought(capture, tmp_path):
    rawpy = pytest.importorskip("rawpy")
    told = take(
        capture, tmp_path / "out", "--auto-exposure", "--format", "dng", "--white-balance-jitter", "0.3"
    )
    with rawpy.imread(str(tmp_path / "out" / "photos" / told[0]["file"])) as raw:
        red, green, blue, _ = raw.camera_whitebalance
    gains = told[0]["white_balance"]
    assert [red / green, blue / green] == pytest.approx([gains[0] / 0.5, gains[2] / 0.65], rel=1e-4)


def test_sixteen_bits_are_as_exact_as_the_response(capture, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    told = take(capture, tmp_path / "out", "--auto-exposure", "--format", "tiff16", "--crf", "reinhard-gamma")
    found = tifffile.imread(tmp_path / "out" / "photos" / told[2]["file"])
    x = radiance(capture, told[2]) * told[2]["exposure"]
    assert found.dtype == np.uint16
    assert np.abs(found - 65535 * (x / (1 + x)) ** (1 / 2.2)).max() <= 0.5 + 1e-6


def test_colmap_reads_the_true_lens_and_cameras(capture, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    told = take(capture, tmp_path / "out", "--bracket=-2,2")
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "truth" / "sparse" / "0"))
    (camera,) = model.cameras.values()
    assert camera.model_name == "OPENCV"
    assert camera.params == pytest.approx([66.0, 66.0, 40.0, 30.0, -0.12, 0.03, 0.001, -0.0008])
    place_of = {photo["file"]: photo["place"] for photo in told}
    assert len(model.images) == 9
    for image in model.images.values():
        place = next(place for place in capture.places if place.name == place_of[image.name])
        assert image.projection_center() == pytest.approx(place.pose[:3, 3], abs=1e-9)
        for seen in image.points2D[:50]:
            position = model.points3D[seen.point3D_id].xyz
            assert image.project_point(position) == pytest.approx(seen.xy, abs=1e-6)
            assert (image.cam_from_world() * position)[2] == pytest.approx(2.0, abs=1e-6)


def test_the_same_command_goes_on_and_another_is_refused(capture, tmp_path):
    told = take(capture, tmp_path / "out", "--auto-exposure")
    files = sorted((tmp_path / "out" / "photos").iterdir())
    before = [path.read_bytes() for path in files]
    files[3].unlink()
    assert take(capture, tmp_path / "out", "--auto-exposure") == told
    assert [path.read_bytes() for path in files] == before
    status, said = run(take_photos, capture.root, "--out", tmp_path / "out", "--bracket=-2,0,2")
    assert status == 1 and "has photos with other options" in said


def test_photos_of_other_places_are_not_mixed_with_those_that_are_there(capture, tmp_path):
    """They are numbered through, so that with one place more each number would mean another."""
    copied = tmp_path / "patches"
    shutil.copytree(capture.root, copied)
    late = opened(copied)
    rendered = late.file(late.places[1])
    rendered.rename(tmp_path / "later")
    take(late, tmp_path / "out", "--auto-exposure", "--partial")
    (tmp_path / "later").rename(rendered)
    status, said = run(take_photos, copied, "--out", tmp_path / "out", "--auto-exposure")
    assert status == 1 and "or of other places: choose another folder" in said


def test_truth_is_bent_back_as_the_pictures_were(capture, tmp_path):
    """The test view of a data set that ``physhdr prepare`` left has the radiance that its picture shows."""
    pycolmap = pytest.importorskip("pycolmap")
    take(capture, tmp_path / "out", "--auto-exposure")
    data, told = (
        tmp_path / "data",
        json.loads((tmp_path / "out" / "truth" / "photos.json").read_text())["photos"],
    )
    found = pycolmap.Reconstruction()
    pinhole = pycolmap.Camera(
        model="PINHOLE", width=60, height=40, params=[66.0, 66.0, 30.0, 20.0], camera_id=1
    )
    found.add_camera_with_trivial_rig(pinhole)
    image = pycolmap.Image(name="test_004_0.png", camera_id=1, image_id=1)
    found.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    (data / "sparse" / "0").mkdir(parents=True)
    found.write(str(data / "sparse" / "0"))
    lens = "OPENCV 66, 66, 40, 30, -0.12, 0.03, 0.001, -0.0008"
    sources = {"test_004_0.png": told[4]["file"]}
    (data / "prepare.json").write_text(json.dumps({"lens": [lens], "sources": sources}))
    from physhdr.lab.tools import capture_truth  # needs pycolmap

    relit = ("--relit", "lamp=0", "--called", "lamp=pendant")
    status, said = run(capture_truth, data, capture.root, tmp_path / "out", *relit)
    assert status == 0, said

    import OpenEXR

    def shown(name: str) -> np.ndarray:
        channels = OpenEXR.File(str(data / name / "hdr_004.exr")).channels()
        return np.asarray(channels["RGB"].pixels)

    truth, relit = shown("test_hdr"), shown("relit/lamp_0")
    assert truth.shape == relit.shape == (40, 60, 3)
    light = radiance(capture, told[4])
    assert relit[:, :24] == pytest.approx(0.25 * truth[:, :24], rel=1e-4)
    assert relit[:, 36:] == pytest.approx(truth[:, 36:], rel=1e-5)
    for x, y in ((4, 4), (24, 24), (55, 36), (55, 4)):
        a, b = (x + 0.5 - 30) / 66, (y + 0.5 - 20) / 66
        r2 = a * a + b * b
        s = 1 - 0.12 * r2 + 0.03 * r2**2
        u = 66 * (a * s + 2 * 0.001 * a * b - 0.0008 * (r2 + 2 * a * a)) + 40
        v = 66 * (b * s + 0.001 * (r2 + 2 * b * b) - 2 * 0.0008 * a * b) + 30
        assert truth[y, x] == pytest.approx(light[int(v), int(u)], rel=1e-5), (u, v)
