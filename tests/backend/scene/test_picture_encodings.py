# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set's pictures mean, whatever wrote them: radiance and its scale, linear integers, alpha."""

import json
import math

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from physhdr.backend.scene import read_scene
from physhdr.backend.scene.color_space import SPACES
from physhdr.backend.scene.encoding import CAMERA, SRGB, LogEncoding
from physhdr.backend.scene.picture_encodings import with_encodings
from physhdr.bridge.errors import BadValueError

WIDTH, HEIGHT, FRAMES = 16, 12, 5


def light(k: int, brightest: float = 50.0) -> np.ndarray:
    """Radiance of frame ``k``, from brightest / 3000 up, no two pixels alike."""
    rng = np.random.default_rng(k)
    return np.exp(rng.uniform(math.log(brightest / 3000.0), math.log(brightest), (HEIGHT, WIDTH, 3)))


def exr(path, pixels, space="rec709"):
    s = SPACES[space]
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "chromaticities": (*s.red, *s.green, *s.blue, *s.white),
    }
    channels = {
        name: np.ascontiguousarray(pixels[..., k], np.float32)
        for k, name in enumerate("RGBA"[: pixels.shape[2]])
    }
    OpenEXR.File(header, channels).write(str(path))


def nerfstudio(root, write, suffix, **frame):
    """A data set of ``FRAMES`` frames beside each other; ``write(path, k)`` makes their pictures."""
    (root / "images").mkdir(parents=True)
    frames = []
    for k in range(FRAMES):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * k
        write(root / "images" / f"{k}{suffix}", k)
        frames.append({"file_path": f"images/{k}{suffix}", "transform_matrix": pose.tolist(), **frame})
    content = {"fl_x": 20.0, "w": WIDTH, "h": HEIGHT, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def test_radiance_gets_one_scale_which_the_messages_tell(tmp_path):
    root = nerfstudio(tmp_path, lambda path, k: exr(path, light(k, 50.0 * (1 + k))), ".exr")
    scene = read_scene(root)
    views = [*scene.train, *scene.test]
    (encoding,) = {e for view in views for e in view.encodings}
    assert isinstance(encoding, LogEncoding)
    brightest = [light(v.index, 50.0 * (1 + v.index)).max(axis=2) for v in scene.train]
    assert encoding.scale == pytest.approx(np.quantile(brightest, 0.99), rel=0.01)
    for view in views:
        expected = light(view.index, 50.0 * (1 + view.index))
        assert (
            np.abs(encoding.exposed(view.image(0)) - expected) < 2e-4 * expected + 1e-6 * encoding.scale
        ).all()
    told = " ".join(scene.messages)
    assert "5 pictures hold radiance" in told and "rec709" in told and "outside" not in told


@pytest.mark.parametrize("space", ["acescg", "aces2065-1"])
def test_the_same_light_in_other_primaries_is_the_same_training_picture(tmp_path, space):
    """By the files' own word, and by the option where they say nothing right."""
    to_space = np.linalg.inv(SPACES[space].to_rec709()).T
    plain = read_scene(nerfstudio(tmp_path / "a", lambda path, k: exr(path, light(k)), ".exr"))
    told = read_scene(
        nerfstudio(tmp_path / "b", lambda path, k: exr(path, light(k) @ to_space, space), ".exr")
    )
    silent = nerfstudio(tmp_path / "c", lambda path, k: exr(path, light(k) @ to_space), ".exr")
    for scene in (told, read_scene(silent, color_space=space)):
        for one, other in zip(plain.train, scene.train, strict=True):
            assert np.abs(one.image(0).astype(int) - other.image(0)).max() <= 1
        assert any(space in message for message in scene.messages)
    with pytest.raises(BadValueError, match="acescg"):
        read_scene(silent, color_space="srgb")


def test_colours_outside_of_rec709_are_told_of(tmp_path):
    """A pure green of ACES has a red and a blue below 0 in Rec.709; what is below counts as 0."""

    def write(path, k):
        pixels = light(k)
        pixels[:3] = (0.0, 5.0, 0.0)
        exr(path, pixels, "aces2065-1")

    scene = read_scene(nerfstudio(tmp_path, write, ".exr"))
    (message,) = (m for m in scene.messages if "outside Rec.709" in m)
    share = float(message.split("%")[0])
    assert 25.0 <= share < 100.0
    view = scene.train[0]
    assert (view.image(0)[:3, :, 0] == 0).all() and (view.image(0)[:3, :, 1] > 0).all()


def test_exposures_say_in_which_unit_radiance_is(tmp_path):
    """Candela and more are trained as they are; only what no number of ours holds needs another unit."""

    def write(path, k):
        exr(path, light(k, 4e9))

    scene = read_scene(nerfstudio(tmp_path / "a", write, ".exr"))
    assert scene.train[0].exposures == (1.0,)
    with pytest.raises(BadValueError, match="radiance of") as error:
        read_scene(nerfstudio(tmp_path / "b", write, ".exr", exposure_time=1e-3))
    assert "exposure_time" in error.value.hint


def test_kinds_may_be_mixed_and_alpha_hides(tmp_path):
    """An .hdr, a TIFF of floats, an EXR with alpha, a PNG with alpha and one of 16 bits in one folder."""
    alpha = np.zeros((HEIGHT, WIDTH))
    alpha[2:] = 1.0
    suffixes = (".hdr", ".tif", ".exr", ".png", ".png")

    def write(path, k):
        path = path.with_suffix(suffixes[k])
        if k < 2:
            cv2.imwrite(str(path), light(k)[..., ::-1].astype(np.float32))
        elif k == 2:
            exr(path, np.dstack([light(k), alpha]))
        elif k == 3:
            codes = np.clip(light(k) * 5, 0, 255).astype(np.uint8)
            Image.fromarray(np.dstack([codes, (alpha * 255).astype(np.uint8)])).save(path)
        else:
            cv2.imwrite(str(path), (light(k) * 1000).astype(np.uint16))

    root = nerfstudio(tmp_path, write, "")
    content = json.loads((root / "transforms.json").read_text())
    for k, frame in enumerate(content["frames"]):
        frame["file_path"] += suffixes[k]
    (root / "transforms.json").write_text(json.dumps(content))
    scene = read_scene(root)
    views = {view.index: view for view in (*scene.train, *scene.test)}
    by_name = {view.image_paths[0].name: view for view in views.values()}
    kinds = {name: type(view.encodings[0]).__name__ for name, view in by_name.items()}
    assert [kinds[name] for name in sorted(kinds)] == ["LogEncoding"] * 3 + ["CameraEncoding"] * 2
    for name in ("2.exr", "3.png"):
        assert np.array_equal(by_name[name].mask(0), alpha > 0.5)
    assert by_name["4.png"].image(0).dtype == np.uint16 and by_name["4.png"].mask(0) is None
    assert any("3 pictures hold radiance, 2 are a camera's" in message for message in scene.messages)


def test_what_prepare_wrote_of_raw_files_is_linear(tmp_path):
    def write(path, k):
        linear = (light(k) / 25.0).clip(0.0, 1.0)
        cv2.imwrite(str(path), np.rint(linear[..., ::-1] * 65535).astype(np.uint16))

    root = nerfstudio(tmp_path, write, ".png")
    about = {"format": "physhdr-capture", "encoding": "linear"}
    (root / "prepare.json").write_text(json.dumps(about))
    scene = read_scene(root)
    view = scene.train[0]
    assert view.encodings == (SRGB,) and scene.photographs
    expected = (light(view.index) / 25.0).clip(0.0, 1.0)
    assert np.abs(SRGB.exposed(view.image(0)) - expected).max() < 3e-5
    assert any("linear" in message for message in scene.messages)
    (root / "prepare.json").write_text(json.dumps(about | {"encoding": "log-c"}))
    with pytest.raises(BadValueError, match="log-c"):
        read_scene(root)


def test_rendered_data_sets_of_ours_are_not_touched(tiny_data):
    """Not one source is another object: trainings are bit-identical to what they were."""
    scene = read_scene(tiny_data)
    assert with_encodings(scene) is scene and not scene.photographs
    assert all(e == CAMERA for view in scene.train for e in view.encodings)
    assert not any(source.alpha for view in scene.train for source in view.sources)
