# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of another program: the same figures as a run gets, figures by hand, and what is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

from physhdr.backend.evaluate import truth
from physhdr.backend.evaluate.picture_folder import PictureFolder, write_pictures
from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.evaluate.report import to_dict
from physhdr.backend.evaluate.results import Evaluation
from physhdr.backend.evaluate.sheets import comparison_sheet, method_sheet
from physhdr.backend.inspect import inspect
from physhdr.backend.scene import Scene, read_scene
from physhdr.backend.scene.color_space import SPACES, Chromaticities
from physhdr.backend.scene.encoding import LogEncoding
from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.atomic import UNFINISHED
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError
from physhdr.bridge.lights import as_levels


class Model(Renderer):
    """Wrong by a few per cent, another amount at each pixel: no two roundings of it agree by chance."""

    lights = ("ambient",)

    def __init__(self, small: ModuleType) -> None:
        self.small = small

    def hdr(self, camera, lighting_level=1.0):
        (level,) = as_levels(lighting_level, self.lights)
        index = round(float(camera.position[0]))
        light = self.small.radiance(index, level, width=camera.width, height=camera.height)
        error = np.random.default_rng(index).normal(1.03, 0.05, light.shape)
        return torch.from_numpy(light * error.astype(np.float32)).permute(2, 0, 1)

    def ldr(self, camera, exposure, lighting_level=1.0):
        return torch.from_numpy(self.small.response((self.hdr(camera, lighting_level) * exposure).numpy()))


@pytest.fixture
def scene(data_set: Path) -> Scene:
    return read_scene(data_set)


@pytest.fixture
def pictures(small: ModuleType, scene: Scene, tmp_path: Path) -> Path:
    """What the model shows of the small data set, so that a test may damage it."""
    write_pictures(Model(small), scene, tmp_path / "theirs")
    return tmp_path / "theirs"


def evaluated(folder: Path, scene: Scene, split: str = "test") -> Evaluation:
    found = PictureFolder(folder, scene, split)
    return evaluate(found, scene, split=split, hdr=found.has_hdr, shows=found.shows)


def files_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def figures(evaluation: Evaluation) -> dict[str, float]:
    """Every number of the means, the relit ones and the scale, by a name."""
    content = to_dict(evaluation)
    parts = content["means"] | {f"relit {k}": v for k, v in content["relit_means"].items()}
    found = {f"{part} {name}": value for part, row in parts.items() for name, value in (row or {}).items()}
    return {name: value for name, value in found.items() if value is not None} | {
        "scale": content["scale_ratio"]
    }


# ---- the same figures ----------------------------------------------------------------------------------


def test_pictures_of_our_own_are_measured_as_the_model_is(small, scene, pictures) -> None:
    itself, written = figures(evaluate(Model(small), scene)), figures(evaluated(pictures, scene))
    assert itself.keys() == written.keys() and len(itself) == 4 * 2 + 3 * 7 + 1
    # Radiance loses nothing in a file, and no rounding to 16 bits leads over half an 8-bit code.
    assert written == pytest.approx(itself, abs=1e-9)
    assert 30 < itself["HDR psnr"] < 50 and 30 < itself["LDR-NE psnr"] < 50


def test_their_evaluation_has_all_that_a_runs_has(small, scene, pictures) -> None:
    ours, theirs = (to_dict(e) for e in (evaluate(Model(small), scene), evaluated(pictures, scene)))
    assert theirs.keys() == ours.keys() and len(theirs["ldr"]) == 10 and len(theirs["relit"]) == 2
    assert theirs["conditions"] == ours["conditions"]
    assert theirs["messages"] == [
        "Pictures that another program made: how it was trained is not known here.",
        "LPIPS left out: no weights were given.",
    ]


def test_every_name_that_is_read_is_written_and_no_other(data_set, pictures) -> None:
    wanted = {f"test/r_{i}_{k}.png" for i in (1, 3) for k in range(5)}
    wanted |= {"test_hdr/hdr_001.exr", "test_hdr/hdr_003.exr"}
    wanted |= {"relit/level_0.25/hdr_003.exr", "relit/level_4/hdr_003.exr"}
    assert files_in(pictures) == wanted <= files_in(data_set)


def test_radiance_in_any_colour_space_is_the_same_radiance(small, data_set, scene, pictures) -> None:
    """Theirs in ACEScg, then our truth, too: an EXR says so by its chromaticities. Rec.709 that says so is as
    it was.
    """
    plain = figures(evaluated(pictures, scene))
    rewrite(pictures, "rec709")
    assert figures(evaluated(pictures, scene)) == plain
    rewrite(pictures, "acescg")
    assert figures(evaluated(pictures, scene)) == pytest.approx(plain, abs=2e-3)
    before = truth.hdr_truth(data_set, "test", 1)
    rewrite(data_set, "acescg")
    assert figures(evaluated(pictures, scene)) == pytest.approx(plain, abs=2e-3)
    assert torch.allclose(truth.hdr_truth(data_set, "test", 1), before, rtol=1e-5, atol=1e-6)
    assert not np.allclose(read_exr(data_set / "test_hdr/hdr_001.exr"), before.permute(1, 2, 0), rtol=0.01)


def test_colours_outside_of_rec709_are_not_clipped_and_impossible_ones_refused(data_set, scene) -> None:
    green = np.zeros((36, 48, 3), np.float32)
    green[..., 1] = 2.0
    write_in(data_set / "test_hdr/hdr_001.exr", green, SPACES["acescg"])
    found = truth.hdr_truth(data_set, "test", 1)[:, 0, 0]
    assert found.tolist() == pytest.approx(2.0 * SPACES["acescg"].to_rec709()[:, 1], rel=1e-5)
    assert found[0] < -1.0
    none = Chromaticities(*[(0.3, 0.3)] * 4)
    write_in(data_set / "test_hdr/hdr_001.exr", green, none)
    with pytest.raises(BadValueError, match=r"hdr_001.exr: the chromaticities .*\n.*remove its attribute"):
        truth.hdr_truth(data_set, "test", 1)
    told = [*map(str, inspect(data_set).errors)]  # before anybody trains
    assert any("hdr_001.exr: the chromaticities" in line for line in told)


def write_in(path: Path, pixels: np.ndarray, space: Chromaticities) -> None:
    header = {"chromaticities": (*space.red, *space.green, *space.blue, *space.white)}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels, np.float32)}).write(str(path))


def rewrite(folder: Path, space: str) -> None:
    """Every EXR's light in the primaries of ``space``, which it says."""
    for path in [*folder.glob("test_hdr/*.exr"), *folder.glob("relit/*/*.exr")]:
        pixels = read_exr(path)
        if space != "rec709":
            pixels = pixels @ np.linalg.inv(SPACES[space].to_rec709()).T
        write_in(path, pixels, SPACES[space])


def test_figures_by_hand_of_files_that_other_programs_wrote(small, data_set, tmp_path) -> None:
    """8 bits, with an alpha that nobody looks at, 5 beside the truth; HDR ¼ too bright in half floats."""
    folder = tmp_path / "theirs"
    for path in sorted((data_set / "test").glob("*.png")):
        codes = np.asarray(Image.open(path).convert("RGB")).astype(int)
        off = np.where(codes > 127, codes - 5, codes + 5).astype(np.uint8)
        (folder / "test").mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.dstack([off, np.full_like(off[..., :1], 9)])).save(folder / "test" / path.name)
    for index in (1, 3):
        bright = (1.25 * small.radiance(index)).astype(np.float16)
        small.write_exr(folder / "test_hdr" / f"hdr_{index:03d}.exr", bright)
    found = evaluated(folder, read_scene(data_set))
    assert found.ldr_oe is not None and found.ldr_ne is not None
    by_hand = -20.0 * np.log10(5.0 / 255.0)
    assert found.ldr_oe.psnr == pytest.approx(by_hand) and found.ldr_ne.psnr == pytest.approx(by_hand)
    assert found.scale_ratio == pytest.approx(1.25, rel=1e-3)
    assert found.hdr_aligned_mean.psnr > 55 > found.hdr_mean.psnr  # type: ignore[union-attr]
    assert any("no pictures of it were given: ambient 0.25, ambient 4" in each for each in found.messages)


def test_validation_views_are_found_and_test_files_never_opened(validation_data, tmp_path) -> None:
    data = shutil.copytree(validation_data, tmp_path / "data")
    scene = read_scene(data)
    theirs = tmp_path / "theirs"
    for name in ("val", "val_hdr"):  # the truth itself
        shutil.copytree(data / name, theirs / name)
    shutil.copytree(data / "test", theirs / "test")
    for path in [*(theirs / "test").iterdir(), *(data / "test").iterdir(), *(data / "relit").rglob("*.exr")]:
        path.write_bytes(b"no picture")
    found = evaluated(theirs, scene, "val")
    assert found.split == "val" and len(found.ldr) == 15
    assert found.ldr_oe.psnr == found.hdr_mean.psnr == 100.0  # type: ignore[union-attr]


def test_pictures_of_a_smaller_data_set(small, data_set, tmp_path) -> None:
    scene = read_scene(data_set, 2.0)
    write_pictures(Model(small), scene, tmp_path / "half")
    assert evaluated(tmp_path / "half", scene).resolution == (24, 18)
    with pytest.raises(DataMismatchError, match=r"r_1_0.png is 24×18, .* at 48×36\n.*--downscale"):
        PictureFolder(tmp_path / "half", read_scene(data_set))


# ---- other layouts and kinds ---------------------------------------------------------------------------


@pytest.fixture
def photos(small: ModuleType, tmp_path: Path) -> Path:
    """A transforms.json of three poses: JPEGs at 1 s, but the radiance itself (OpenEXR) of one test pose."""
    root, frames = tmp_path / "photos", []
    (root / "images").mkdir(parents=True)
    for index in range(4):
        name = f"images/v_{index}.{'exr' if index == 3 else 'jpg'}"
        if index == 3:
            small.write_exr(root / name, small.radiance(index))
        else:
            code = small.to_8_bit(small.response(small.radiance(index)))
            Image.fromarray(code).save(root / name, quality=95)
        pose = small.camera_to_world(index).tolist()
        frames.append({"file_path": name, "transform_matrix": pose, "exposure_time": 1.0})
    content = {"fl_x": 50.0, "fl_y": 50.0, "cx": 24.0, "cy": 18.0, "w": 48, "h": 36, "frames": frames}
    content |= {"train_filenames": [f["file_path"] for f in frames[:2]]}
    content |= {"test_filenames": [f["file_path"] for f in frames[2:]]}
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def test_of_jpegs_a_png_will_do_and_radiance_is_compared_by_the_hdr_picture(small, photos, tmp_path) -> None:
    scene = read_scene(photos)
    assert isinstance(scene.test[1].encodings[0], LogEncoding)
    write_pictures(Model(small), scene, tmp_path / "theirs")
    written = {
        path.relative_to(tmp_path / "theirs").as_posix() for path in (tmp_path / "theirs").rglob("*.*")
    }
    assert written == {"images/v_2.png", "test_hdr/hdr_002.exr", "test_hdr/hdr_003.exr"}
    itself, theirs = evaluate(Model(small), scene), evaluated(tmp_path / "theirs", scene)
    for ours, other in zip(itself.ldr, theirs.ldr, strict=True):
        assert other.metrics.psnr == pytest.approx(ours.metrics.psnr, abs=1e-9)
    (tmp_path / "theirs" / "test_hdr" / "hdr_003.exr").unlink()
    with pytest.raises(FileMissingError, match=r"test_hdr/hdr_003.exr is missing\n.*2 test views"):
        PictureFolder(tmp_path / "theirs", scene)


def test_equal_exposures_of_one_bracket_are_told_apart(small, scene, pictures) -> None:
    view = replace(scene.test[0], exposures=(0.5, 0.5, 2.0, 2.0, 2.0))
    found = PictureFolder(pictures, replace(scene, test=[view]))
    drawn = list(found.ldr_bracket(view.camera, view.exposures))
    for k, picture in enumerate(drawn):
        codes = cv2.imread(str(pictures / f"test/r_1_{k}.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
        assert codes.dtype == np.uint16
        np.testing.assert_array_equal(picture.permute(1, 2, 0).numpy() * 65535, codes)


# ---- what there may be less of -------------------------------------------------------------------------


def test_without_hdr_pictures_their_columns_are_left_out(small, scene, pictures) -> None:
    shutil.rmtree(pictures / "test_hdr")
    shutil.rmtree(pictures / "relit")
    found = evaluated(pictures, scene)
    assert found.ldr_oe is not None and found.hdr_mean is None and found.relit == []
    assert "HDR and relit left out: no HDR pictures were given." in found.messages
    folder = PictureFolder(pictures, scene)
    sheet = comparison_sheet(folder, scene, hdr=folder.has_hdr, shows=folder.shows)
    assert sheet.shape[0] < comparison_sheet(Model(small), scene).shape[0]
    both = {"theirs": folder, "ours": Model(small)}
    assert method_sheet(both, scene, without_hdr=["theirs"]).dtype == np.uint8


def test_a_mixture_of_light_may_be_missing_as_a_whole(scene, pictures) -> None:
    shutil.rmtree(pictures / "relit" / "level_4")
    found = evaluated(pictures, scene)
    assert found.relit_conditions == ["ambient 0.25"]
    assert "Relit left out, because no pictures of it were given: ambient 4." in found.messages


# ---- what is refused, with the file's name -------------------------------------------------------------


def exr(path: Path, value: float = 1.0, shape: tuple[int, int] = (36, 48)) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.full((*shape, 3), value, np.float32)}).write(str(path))


def large(path: Path) -> None:
    Image.new("RGB", (96, 72)).save(path)


DAMAGES = {
    "an exposure is missing": (
        lambda at: (at / "test/r_3_2.png").unlink(),
        FileMissingError,
        r"theirs/test/r_3_2.png is missing\n.*2 test views needs a picture at each of its exposures",
    ),
    "a view is missing": (
        lambda at: [path.unlink() for path in (at / "test").glob("r_1_*")],
        FileMissingError,
        r"test/r_1_0.png is missing \(5 of 10 are\)",
    ),
    "an HDR picture is missing": (
        lambda at: (at / "test_hdr/hdr_003.exr").unlink(),
        FileMissingError,
        r"test_hdr/hdr_003.exr is missing \(1 of 2 HDR pictures are\)\n.*or none of its kind",
    ),
    "HDR pictures alone are missing": (
        lambda at: shutil.rmtree(at / "test_hdr"),
        FileMissingError,
        r"has relit pictures, but no HDR ones",
    ),
    "a picture is large": (
        lambda at: large(at / "test/r_1_4.png"),
        DataMismatchError,
        r"test/r_1_4.png is 96×72, .* at 48×36",
    ),
    "radiance is small": (
        lambda at: exr(at / "test_hdr/hdr_001.exr", shape=(18, 24)),
        DataMismatchError,
        r"hdr_001.exr is 24×18",
    ),
    "NaN": (
        lambda at: exr(at / "test_hdr/hdr_001.exr", np.nan),
        BadValueError,
        r"hdr_001.exr holds NaN or infinity, first at row 0, column 0\n.*Write it again",
    ),
    "relit infinity": (
        lambda at: exr(at / "relit/level_4/hdr_003.exr", np.inf),
        BadValueError,
        r"level_4/hdr_003.exr holds NaN or infinity",
    ),
    "a truncated picture": (
        lambda at: (at / "test/r_1_0.png").write_bytes((at / "test/r_1_0.png").read_bytes()[:900]),
        FileDamagedError,
        r"test/r_1_0.png is not a readable PNG .truncated or damaged",
    ),
    "no picture": (
        lambda at: (at / "test/r_1_0.png").write_text("a picture"),
        FileDamagedError,
        r"test/r_1_0.png is not a readable PNG.*\n.*Write it again",
    ),
    "radiance for a picture": (
        lambda at: exr(at / "test/r_1_0.png"),
        FileDamagedError,
        r"test/r_1_0.png holds radiance instead of codes",
    ),
    "a folder for a picture": (
        lambda at: [(at / "test/r_1_0.png").unlink(), (at / "test/r_1_0.png").mkdir()],
        FileMissingError,
        r"test/r_1_0.png is a folder",
    ),
    "nothing": (lambda at: shutil.rmtree(at), FileMissingError, r"there is no folder of pictures .*theirs\n"),
}


@pytest.mark.parametrize("what", DAMAGES)
def test_what_cannot_be_measured_is_named(what, scene, pictures) -> None:
    damage, error, said = DAMAGES[what]
    damage(pictures)
    with pytest.raises(error, match=said):
        evaluated(pictures, scene)


def test_some_views_of_a_mixture_are_none(small, data_set, tmp_path) -> None:
    small.write_exr(data_set / "relit" / "level_4" / "hdr_001.exr", small.radiance(1, 4.0))
    scene = read_scene(data_set)
    write_pictures(Model(small), scene, tmp_path / "theirs")
    (tmp_path / "theirs" / "relit" / "level_4" / "hdr_001.exr").unlink()
    with pytest.raises(FileMissingError, match=r"hdr_001.exr is missing \(1 of 2 ambient 4 pictures are\)"):
        PictureFolder(tmp_path / "theirs", scene)


def test_a_data_sets_own_pictures_are_never_replaced(small, scene) -> None:
    with pytest.raises(BadValueError, match="is the data set, whose pictures would be replaced"):
        write_pictures(Model(small), scene, scene.root / ".." / scene.root.name)


def test_an_interruption_leaves_the_pictures_that_were_there(small, scene, tmp_path) -> None:
    """Whole: pictures of two models would be measured as if they were one's."""

    class Interrupted(Model):
        def hdr(self, camera, lighting_level=1.0):
            if camera == scene.test[-1].camera:
                raise KeyboardInterrupt
            return 0.5 * super().hdr(camera, lighting_level)

    folder = tmp_path / "theirs"
    write_pictures(Model(small), scene, folder)
    written = {path: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}
    (folder / UNFINISHED).mkdir()
    (folder / UNFINISHED / "0.png").touch()  # of one that was killed
    with pytest.raises(KeyboardInterrupt):
        write_pictures(Interrupted(small), scene, folder)
    assert len(scene.test) > 1
    assert written == {path: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}
    assert not (folder / UNFINISHED).exists()


def test_what_would_stay_among_a_models_pictures_is_refused(small, scene, photos, tmp_path) -> None:
    """The relit pictures of a model with more lights; a JPEG, which is read before a PNG of the same name."""

    class Unlit(Model):
        lights = ()

    lit, folder = Model(small), tmp_path / "theirs"
    write_pictures(lit, scene, folder)
    write_pictures(lit, scene, folder)  # all of it replaced
    written = {path: path.read_bytes() for path in folder.rglob("*_*.*") if path.is_file()}
    with pytest.raises(BadValueError, match=r"relit.*taken for this model.*\n.*another folder"):
        write_pictures(Unlit(small), scene, folder)
    assert written == {path: path.read_bytes() for path in folder.rglob("*_*.*") if path.is_file()}

    theirs = tmp_path / "jpegs" / "images" / "v_2.jpg"
    theirs.parent.mkdir(parents=True)
    theirs.write_bytes(b"theirs")
    with pytest.raises(BadValueError, match=r"v_2\.jpg exists"):
        write_pictures(lit, read_scene(photos), tmp_path / "jpegs")
    assert [*(tmp_path / "jpegs").rglob("*.*")] == [theirs]
