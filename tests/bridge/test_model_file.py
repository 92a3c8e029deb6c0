# SPDX-License-Identifier: GPL-3.0-or-later
"""The model file: what is written comes back, what is damaged is refused with one clear message."""

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge import limits, spherical_harmonics
from physhdr.bridge.camera_list import ListedCamera
from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    OutputError,
    PhysHDRError,
)
from physhdr.bridge.model_file import (
    Model,
    largest_log_radiance,
    read_model,
    refuse_what_is_not_ours,
    write_model,
)
from physhdr.bridge.regular import LONGEST_HEADER


def make_model(
    count: int = 7,
    degree: int = 1,
    modulator: str = "additive",
    seed: int = 0,
    lights: tuple[str, ...] = ("ambient",),
) -> Model:
    rng = np.random.default_rng(seed)

    def random(*shape: int, low: float = -1.0, high: float = 1.0) -> np.ndarray:
        return rng.uniform(low, high, shape).astype(np.float32)

    light = (
        {"light_share": random(count, len(lights), 3, low=0.0) / np.float32(len(lights)), "lights": lights}
        if modulator == "additive"
        else {"level_log_gain": random(3, count, 3), "levels": (0.25, 1.0, 2.0)}
    )
    return Model(
        position=random(count, 3),
        rotation=random(count, 4),
        scale=random(count, 3, low=0.01),
        opacity=random(count, low=0.0),
        log_radiance_sh=random(count, (degree + 1) ** 2, 3),
        **light,
        tone_curve_log_exposure=np.linspace(-5, 5, 11, dtype=np.float32),
        tone_curve=random(11, 3, low=0.0),
        exposures=(0.125, 0.5, 2.0),
        metadata={"scene": "küche", "method": "physhdr", "iteration": "3000"},
    )


def rewrite(path: Path, change) -> None:
    """Pass the header (a dict) and the data through ``change(header, data) -> data`` and write them back."""
    raw = path.read_bytes()
    length = int.from_bytes(raw[:8], "little")
    header, data = json.loads(raw[8 : 8 + length]), bytearray(raw[8 + length :])
    data = change(header, data) or data
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + bytes(data))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_model(tmp_path / "model.safetensors", make_model())
    return tmp_path / "model.safetensors"


@pytest.mark.parametrize(
    ("modulator", "lights"),
    [
        ("additive", ("ambient",)),
        ("additive", ("pendant",)),
        ("additive", ("ambient", "küche 2")),
        ("additive", ("ambient", "a", "b", "c")),
        ("baked-levels", ("ambient",)),
    ],
)
@pytest.mark.parametrize("degree", [0, 3])
def test_round_trip_is_exact(tmp_path: Path, modulator: str, lights: tuple[str, ...], degree: int):
    model = make_model(degree=degree, modulator=modulator, lights=lights)
    write_model(tmp_path / "m.safetensors", model)
    back = read_model(tmp_path / "m.safetensors")
    assert (back.modulator, back.lights) == (modulator, lights)
    assert back.sh_degree == degree
    assert (back.count, back.levels, back.exposures) == (7, model.levels, model.exposures)
    assert dict(back.metadata) == model.metadata
    assert back.tensors().keys() == model.tensors().keys()
    for name, array in model.tensors().items():
        np.testing.assert_array_equal(getattr(back, name), array)
    assert os.listdir(tmp_path) == ["m.safetensors"]


def test_the_cameras_come_back(tmp_path: Path):
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = (1.0, -4.0, 2.0), (0.1, 0.2, 1.0 / 3.0)
    size = 640, 480, 500.0, 510.0, 322.5, 239.0
    cameras = tuple(
        ListedCamera(f"train_{index}", pose, *size, index == 1) for index, pose in enumerate(poses)
    )
    write_model(tmp_path / "model.safetensors", dataclasses.replace(make_model(), cameras=cameras))
    found = read_model(tmp_path / "model.safetensors")
    assert "cameras" not in found.metadata
    for each, written in zip(found.cameras, cameras, strict=True):
        np.testing.assert_allclose(each.camera_to_world, written.camera_to_world, atol=1e-6)
        of_lens = ("name", "width", "height", "fx", "fy", "cx", "cy", "is_learned")
        assert [getattr(each, name) for name in of_lens] == [getattr(written, name) for name in of_lens]


@pytest.mark.parametrize(
    ("modulator", "lights"),
    [("additive", ("ambient",)), ("additive", ("ambient", "lamp")), ("baked-levels", ("ambient",))],
)
def test_confidence_comes_back_and_may_be_missing(tmp_path: Path, modulator: str, lights: tuple[str, ...]):
    model, path = make_model(modulator=modulator, lights=lights), tmp_path / "m.safetensors"
    write_model(path, model)
    assert read_model(path).confidence is None
    without = path.read_bytes()
    assert b"confidence" not in without
    sure = np.linspace(0.0, 1.0, model.count, dtype=np.float32)
    write_model(path, dataclasses.replace(model, confidence=sure))
    np.testing.assert_array_equal(read_model(path).confidence, sure)
    rewrite(path, lambda header, data: header.pop("confidence") and None)
    assert read_model(path).tensors().keys() == model.tensors().keys()


@pytest.mark.parametrize("wrong", [-0.01, 1.01, float("nan")])
def test_a_confidence_is_a_probability(wrong: float):
    model = make_model()
    sure = np.full(model.count, 0.5, np.float32)
    sure[3] = wrong
    with pytest.raises(BadValueError, match="confidence"):
        dataclasses.replace(model, confidence=sure)
    with pytest.raises(DataMismatchError, match="confidence"):
        dataclasses.replace(model, confidence=np.full(model.count + 1, 0.5, np.float32))


def test_safetensors_library_reads_what_we_write(path: Path):
    safetensors = pytest.importorskip("safetensors")
    from safetensors.numpy import load_file

    tensors, written = load_file(path), make_model().tensors()
    # The ambient light alone has a tensor of its own.
    written["ambient_share"] = written.pop("light_share")[:, 0]
    assert tensors.keys() == written.keys()
    for name, array in written.items():
        np.testing.assert_array_equal(tensors[name], array)
    with safetensors.safe_open(path, "numpy") as file:
        assert file.metadata()["format"] == "physhdr-model"
        assert file.metadata()["scene"] == "küche"
        assert file.metadata()["modulator"] == "additive" and "lights" not in file.metadata()


def test_safetensors_library_reads_several_lights(tmp_path: Path):
    safetensors = pytest.importorskip("safetensors")
    from safetensors.numpy import load_file

    model = make_model(lights=("ambient", "pendant"))
    write_model(tmp_path / "m.safetensors", model)
    tensors = load_file(tmp_path / "m.safetensors")
    assert tensors["light_share"].shape == (7, 2, 3) and "ambient_share" not in tensors
    np.testing.assert_array_equal(tensors["light_share"], model.light_share)
    with safetensors.safe_open(tmp_path / "m.safetensors", "numpy") as file:
        assert file.metadata()["modulator"] == "additive-lights"
        assert json.loads(file.metadata()["lights"]) == ["ambient", "pendant"]


def test_we_read_what_the_safetensors_library_writes(tmp_path: Path):
    pytest.importorskip("safetensors")
    from safetensors.numpy import save_file

    model = make_model(modulator="baked-levels")
    metadata = {"format": "physhdr-model", "version": "1", "modulator": "baked-levels", "sh_degree": "1"}
    metadata |= {"levels": "[0.25, 1, 2]", "working_space": "Linear Rec.709", "exposures": "[1]"}
    save_file(model.tensors(), tmp_path / "m.safetensors", metadata)
    back = read_model(tmp_path / "m.safetensors")
    for name, array in model.tensors().items():
        np.testing.assert_array_equal(getattr(back, name), array)


def test_additive_radiance_by_hand():
    """One Gaussian, degree 0: radiance 2 at level 1, of which 0, ½ and all is ambient."""
    model = dataclasses.replace(
        make_model(count=1, degree=0),
        log_radiance_sh=np.full((1, 1, 3), np.log(2.0) / spherical_harmonics.C0, np.float32),
        light_share=np.array([[[0.0, 0.5, 1.0]]], np.float32),
    )
    direction = np.array([[0.0, 0.0, -1.0]])
    np.testing.assert_allclose(model.radiance(direction, 1.0), [[2.0, 2.0, 2.0]], rtol=1e-6)
    np.testing.assert_allclose(model.radiance(direction, 4.0), [[2.0, 5.0, 8.0]], rtol=1e-6)
    np.testing.assert_allclose(model.radiance(direction, 0.0), [[2.0, 1.0, 0.0]], rtol=1e-6)


def test_radiance_of_several_lights_adds_up():
    """fixed + Σ l_k · light_k, whatever the levels: superposition."""
    model = make_model(count=50, degree=3, lights=("ambient", "pendant", "screen"))
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fixed = model.radiance(directions, (0.0, 0.0, 0.0))
    lights = [model.radiance(directions, row) - fixed for row in np.eye(3)]
    for levels in [(1.0, 1.0, 1.0), (4.0, 0.25, 0.0), (0.0, 30.0, 2.0)]:
        expected = fixed + sum(level * light for level, light in zip(levels, lights, strict=True))
        np.testing.assert_allclose(model.radiance(directions, levels), expected, rtol=1e-6)
        np.testing.assert_allclose(
            np.exp(model.log_gain(levels)) * model.radiance(directions), expected, rtol=1e-5, atol=1e-6
        )
    np.testing.assert_array_equal(
        model.radiance(directions, 2.5), model.radiance(directions, (2.5, 1.0, 1.0))
    )


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ((1.0,), r"1 lighting levels for 2 lights[\s\S]*ambient, pendant"),
        ((1.0, 1.0, 1.0), "3 lighting levels for 2 lights"),
        ((1.0, -0.5), "lighting level of pendant must be 0 or more, got -0.5"),
        ((np.nan, 1.0), "lighting level of ambient"),
        (np.inf, "lighting level of ambient"),
    ],
)
def test_levels_that_do_not_fit_the_lights(levels, message: str):
    model = make_model(lights=("ambient", "pendant"))
    for take in (model.log_gain, lambda level: model.radiance(np.tile([0.0, 0.0, 1.0], (7, 1)), level)):
        with pytest.raises(BadValueError, match=message):
            take(levels)


@pytest.mark.parametrize(
    "lights", [("ambient", "ambient"), ("ambient", ""), ("a=b", "c"), ("a", " b"), (1, 2)]
)
def test_lights_need_names_of_their_own(lights):
    with pytest.raises(BadValueError, match="lights"):
        make_model(lights=lights)


def test_lights_of_a_damaged_file(tmp_path: Path):
    path = tmp_path / "m.safetensors"

    def rewritten(lights: str | None):
        def change(header, data):
            header["__metadata__"].pop("lights")
            header["__metadata__"] |= {} if lights is None else {"lights": lights}

        write_model(path, make_model(lights=("ambient", "pendant")))
        rewrite(path, change)

    for lights, error in [
        (None, BadValueError),
        ('["ambient"]', DataMismatchError),
        ('{"ambient": 1}', BadValueError),
        ("[", FileDamagedError),
    ]:
        rewritten(lights)
        with pytest.raises(error, match=r"m\.safetensors"):
            read_model(path)


def test_shares_must_not_add_up_to_more_than_everything():
    model = make_model(lights=("ambient", "pendant"))
    shares = np.full((7, 2, 3), 0.5, np.float32)
    dataclasses.replace(model, light_share=shares * np.float32(1.0 + 2e-7))  # rounding is taken
    with pytest.raises(BadValueError, match="add up to more than 1"):
        dataclasses.replace(model, light_share=shares * np.float32(1.001))
    with pytest.raises(DataMismatchError, match="2 lights, but there are ambient, pendant, screen"):
        dataclasses.replace(model, lights=("ambient", "pendant", "screen"))
    with pytest.raises(DataMismatchError, match="baked levels are of one light"):
        dataclasses.replace(make_model(modulator="baked-levels"), lights=("ambient", "pendant"))


def test_baked_levels_interpolate_in_stops_and_hold_outside():
    model = dataclasses.replace(
        make_model(count=1, degree=0, modulator="baked-levels"),
        log_radiance_sh=np.zeros((1, 1, 3), np.float32),
        level_log_gain=np.array([[[-1.0] * 3], [[0.0] * 3], [[0.5] * 3]], np.float32),
    )
    direction = np.array([[1.0, 0.0, 0.0]])
    for level, gain in [(0.0, -1.0), (0.25, -1.0), (0.5, -0.5), (1.0, 0.0), (2**0.5, 0.25), (8.0, 0.5)]:
        np.testing.assert_allclose(
            model.radiance(direction, level), np.exp(gain) * np.ones((1, 3)), rtol=1e-6
        )


def test_levels_are_known_as_far_as_they_were_baked():
    """Those outside look as those at the end, and are called so."""
    baked = make_model(modulator="baked-levels")  # at 0.25, 1 and 2
    direction = np.tile([0.0, 0.0, 1.0], (baked.count, 1))
    for asked, known in ((0.0, 0.25), (0.5, 0.5), (5.0, 2.0)):
        assert baked.known_levels(asked) == baked.known_levels((asked,)) == (known,)
        np.testing.assert_array_equal(baked.radiance(direction, asked), baked.radiance(direction, known))
    lamps = make_model(lights=("ambient", "lamp"))
    assert lamps.known_levels(5.0) == (5.0, 1.0) and lamps.known_levels((0.0, 7.0)) == (0.0, 7.0)


def test_radiance_depends_on_the_direction():
    """Only the z coefficient of degree 1: exp(C1 z), brightest seen from below (ω up)."""
    log_radiance_sh = np.zeros((2, 4, 3), np.float32)
    log_radiance_sh[:, 2] = 1.0
    model = dataclasses.replace(make_model(count=2), log_radiance_sh=log_radiance_sh)
    up_and_down = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    expected = np.exp(spherical_harmonics.C1 * np.array([[1.0] * 3, [-1.0] * 3]))
    np.testing.assert_allclose(model.radiance(up_and_down), expected, rtol=1e-6)


def test_missing_file_and_folder(tmp_path: Path):
    with pytest.raises(FileMissingError, match="no model file"):
        read_model(tmp_path / "none.safetensors")
    with pytest.raises(FileMissingError, match="folder"):
        read_model(tmp_path)


@pytest.mark.parametrize("size", [0, 5, 8, 9, 300, -1])
def test_truncated_anywhere(path: Path, size: int):
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(FileDamagedError, match=r"truncated|only|no safetensors"):
        read_model(path)


def test_not_ours(path: Path, tmp_path: Path):
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(FileDamagedError, match="not a PhysHDR model"):
        read_model(tmp_path / "picture.png")
    rewrite(path, lambda header, data: header["__metadata__"].update(format="other"))
    with pytest.raises(FileDamagedError, match="not a PhysHDR model"):
        read_model(path)


@pytest.mark.parametrize("text", ['"opacity":', '"format":', '"__metadata__":'])
def test_a_name_that_stands_twice_is_refused(path: Path, text: str):
    """Python's reader takes the last of them, another program may take the first."""
    content = path.read_bytes()
    size = int.from_bytes(content[:8], "little")
    header, data = content[8 : 8 + size].decode(), content[8 + size :]
    value, _ = json.JSONDecoder().raw_decode(header[(start := header.index(text)) + len(text) :])
    twice = f"{header[:start]}{text}{json.dumps(value)},{header[start:]}".encode()
    assert json.loads(twice) == json.loads(header)
    path.write_bytes(len(twice).to_bytes(8, "little") + twice + data)
    with pytest.raises(FileDamagedError, match=r"m.*\.safetensors.*stands twice"):
        read_model(path)


def test_a_header_is_of_two_megabytes_at_most(path: Path):
    write_model(path, dataclasses.replace(make_model(), metadata={"note": "x" * (LONGEST_HEADER - 2000)}))
    assert len(read_model(path).metadata["note"]) == LONGEST_HEADER - 2000
    with pytest.raises(OutputError, match=r"its header would have \d+ bytes"):
        write_model(path, dataclasses.replace(make_model(), metadata={"note": "x" * LONGEST_HEADER}))
    rewrite(path, lambda header, _: header["__metadata__"].update(note="x" * LONGEST_HEADER))
    with pytest.raises(FileDamagedError, match=r"has a header of \d+ bytes: no model has more"):
        read_model(path)


def test_newer_version(path: Path):
    rewrite(path, lambda header, data: header["__metadata__"].update(version="2"))
    with pytest.raises(BadValueError, match=r"version '2' of the model file, not 1[\s\S]*update PhysHDR"):
        read_model(path)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"dtype": "F16", "shape": [7, 3], "data_offsets": [0, 42]}, "F16"),
        ({"dtype": "F32", "shape": [7, 3], "data_offsets": [0, 80]}, "cannot be 80 bytes"),
        ({"dtype": "F32", "shape": [7, 3], "data_offsets": [-84, 0]}, "cannot be"),
        ({"dtype": "F32", "shape": [2**40, 3], "data_offsets": [0, 12 * 2**40]}, "truncated"),
        ({"dtype": "x" * 5000}, "it must be F32"),
        ({"dtype": "F32", "shape": [1] * 100, "data_offsets": [0, 4]}, r"has the shape \[1, 1"),
        ({"dtype": "F32", "shape": [0, 2**70], "data_offsets": [0, 0]}, r"has the shape \[0, "),
        ({"dtype": "F32", "shape": [7, "3"], "data_offsets": [0, 84]}, "not valid"),
        ({"dtype": "F32", "shape": [-7, -3], "data_offsets": [0, 84]}, "not valid"),
        ({"dtype": "F32"}, "not valid"),
        ("nonsense", "not valid"),
    ],
)
def test_damaged_header_entries(path: Path, entry, message: str):
    rewrite(path, lambda header, data: header.update(position=entry))
    with pytest.raises(FileDamagedError, match=message) as refused:
        read_model(path)
    assert len(refused.value.message) < 400


def test_missing_tensor_and_shapes_that_disagree(path: Path):
    rewrite(path, lambda header, data: header.pop("scale") and None)
    with pytest.raises(FileDamagedError, match="no scale"):
        read_model(path)
    write_model(path, make_model())
    rewrite(path, lambda header, data: header["opacity"].update(shape=[6], data_offsets=[0, 24]))
    with pytest.raises(DataMismatchError, match=r"opacity has N = 6, but position has N = 7"):
        read_model(path)


@pytest.mark.parametrize(
    ("tensor", "value", "message"),
    [
        ("position", np.nan, "position has 1 values that are NaN"),
        ("log_radiance_sh", np.inf, "NaN or infinite"),
        ("opacity", 1.5, "opacity"),
        ("scale", -1.0, "negative"),
        ("scale", 2e6, r"scale has the value 2e\+06"),
        ("position", -2e6, r"Gaussian 0 is at \(-2e\+06.*must be from"),
        ("log_radiance_sh", 1000.0, "ln radiance of 1 Gaussians may reach 28"),
        ("log_radiance_sh", -3e38, "ln radiance of 1 Gaussians"),
        ("ambient_share", 2.0, "light_share"),
    ],
)
def test_bad_values(path: Path, tensor: str, value: float, message: str):
    def spoil(header, data):
        start = header[tensor]["data_offsets"][0]
        data[start : start + 4] = np.float32(value).tobytes()

    rewrite(path, spoil)
    with pytest.raises(BadValueError, match=message):
        read_model(path)


def test_no_radiance_is_infinite_and_what_training_reaches_is_taken(tmp_path: Path):
    """The bound holds toward every direction; nothing that training's clamp lets pass comes near it."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    Y = spherical_harmonics.basis(directions, 3)
    sh = rng.normal(size=(20, 16, 3)).astype(np.float32)
    most = largest_log_radiance(sh)
    reached = np.abs(np.einsum("dk,nkc->dnc", Y, sh)).max(axis=(0, 2))
    assert (reached <= most).all() and (most < 3.0 * reached).all()
    toward = Y[:20, :, None] * np.ones(3, np.float32)  # nowhere larger than in its own direction
    np.testing.assert_allclose(largest_log_radiance(toward), np.square(Y[:20]).sum(axis=1), rtol=1e-5)
    # Between the ends of the trainer's clamp, -12 and 9, and back within a few degrees.
    stripes = 10.5 * np.sign(np.sin(9.0 * directions[:, 2:])) - 1.5
    fitted = np.linalg.lstsq(Y, stripes, rcond=None)[0][None].repeat(3, axis=2).astype(np.float32)
    assert largest_log_radiance(fitted) < 0.6 * limits.LOG_RADIANCE_MAX
    model = make_model(count=20, degree=3)
    bright = sh * np.float32(0.999 * limits.LOG_RADIANCE_MAX) / most[:, None, None].astype(np.float32)
    model = dataclasses.replace(model, log_radiance_sh=bright)
    write_model(tmp_path / "m.safetensors", model)
    lit = read_model(tmp_path / "m.safetensors").radiance(directions[:20], limits.LEVEL.high)
    assert np.isfinite(lit).all()


def test_baked_gains_count_as_radiance():
    model = make_model(modulator="baked-levels", degree=0)
    gain = np.array(model.level_log_gain)
    gain[0, 3, 1] = 80.0
    with pytest.raises(BadValueError, match="ln radiance of 1 Gaussians may reach 8"):
        dataclasses.replace(model, level_log_gain=gain)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("version", "x" * 5000),
        ("modulator", "x" * 5000),
        ("working_space", "x" * 5000),
        ("sh_degree", "x" * 5000),
        ("sh_degree", "\x1b[2J\n"),
        ("lights", json.dumps(["x" * 5000, "x" * 5000])),
        ("lights", json.dumps(["\ud800" * 5000])),
        ("exposures", json.dumps(["x" * 5000])),
        ("exposures", "[1" + "0" * 400 + "]"),
        ("exposures", "[0.0]"),
        ("exposures", "[true]"),
        ("scene", "half \ud800"),
        ("half \ud800", "x"),
        ("version", "half \ud800"),
    ],
)
def test_metadata_that_mean_nothing(tmp_path: Path, key: str, value: str):
    """Told in one line that can be shown anywhere, whatever they hold."""
    path = tmp_path / "m.safetensors"
    write_model(path, make_model(lights=("ambient", "pendant")))
    rewrite(path, lambda header, data: header["__metadata__"].update({key: value}))
    with pytest.raises(PhysHDRError, match=r"m\.safetensors") as refused:
        read_model(path)
    assert len(refused.value.message) < 400 and refused.value.message.isprintable()


@pytest.mark.parametrize("levels", ["[1e-7, 1.0, 2.0]", "[0.25, 1.0, 2e6]", "[0, 1, 2]"])
def test_levels_of_a_file_are_levels(tmp_path: Path, levels: str):
    path = tmp_path / "m.safetensors"
    write_model(path, make_model(modulator="baked-levels"))
    rewrite(path, lambda header, data: header["__metadata__"].update(levels=levels))
    with pytest.raises(BadValueError, match=r"m\.safetensors: (a level is|levels must be positive)"):
        read_model(path)


def test_a_quaternion_of_length_zero():
    with pytest.raises(BadValueError, match="quaternion"):
        dataclasses.replace(make_model(), rotation=np.zeros((7, 4), np.float32))


def test_levels_must_be_there_and_rise():
    model = make_model(modulator="baked-levels")
    with pytest.raises(DataMismatchError, match="2 levels"):
        dataclasses.replace(model, levels=(1.0, 2.0))
    with pytest.raises(BadValueError, match="rising"):
        dataclasses.replace(model, levels=(1.0, 0.5, 2.0))


def test_a_path_that_cannot_be_written_leaves_nothing(tmp_path: Path):
    with pytest.raises(OutputError, match=r"there is no folder .*none[\s\S]*Make that folder"):
        write_model(tmp_path / "none" / "m.safetensors", make_model())
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError):
        write_model(tmp_path / "folder", make_model())
    assert os.listdir(tmp_path) == ["folder"]


def test_writing_replaces_a_file_that_is_being_read(path: Path):
    old = read_model(path)
    write_model(path, make_model(seed=1))
    np.testing.assert_array_equal(old.position, make_model().position)
    np.testing.assert_array_equal(read_model(path).position, make_model(seed=1).position)


def write_header(path: Path, metadata, data: bytes = b"") -> None:
    text = json.dumps({"__metadata__": metadata}).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + data)


def other_files(folder: Path) -> dict[str, Path]:
    """Files of the user's that are no models, by what is said of them."""
    (folder / "notes.safetensors").write_text("what I must not forget")
    (folder / "empty.safetensors").touch()
    write_header(folder / "checkpoint.safetensors", {"format": "physhdr-checkpoint"}, b"months")
    write_header(folder / "list.safetensors", ["physhdr-model"])
    claim = b'{"__metadata__": {"format": "physhdr-model"}}'
    (folder / "claims.safetensors").write_bytes(b"\xff" * 8 + claim)  # behind a length of 2^64 − 1
    (folder / "deep.safetensors").write_bytes((200_000).to_bytes(8, "little") + b"[" * 200_000)
    return {path.name: path for path in sorted(folder.iterdir())}


def test_no_file_of_the_users_is_replaced(tmp_path: Path):
    for path in other_files(tmp_path).values():
        before = path.read_bytes()
        with pytest.raises(OutputError, match=rf"{path}: a file is there that is not[\s\S]*another name"):
            write_model(path, make_model())
        assert path.read_bytes() == before
    assert len(os.listdir(tmp_path)) == 6  # nothing temporary is left, either


def test_a_model_is_replaced_whatever_its_state(path: Path):
    """One that is cut off, or a newer PhysHDR's: it is ours, and its header says so."""
    whole = path.read_bytes()
    for old in (whole[: len(whole) // 2], whole.replace(b'"version":"1"', b'"version":"9"')):
        path.write_bytes(old)
        write_model(path, make_model(seed=2))
        np.testing.assert_array_equal(read_model(path).position, make_model(seed=2).position)
    path.write_bytes(whole[:20])  # nothing says any more what it was
    with pytest.raises(OutputError, match="delete what is there yourself"):
        write_model(path, make_model())


def test_links_are_neither_followed_nor_replaced(path: Path, tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    for name, goal in {"a": "notes.txt", "b": "model.safetensors", "c": "nowhere"}.items():
        link = tmp_path / f"{name}.safetensors"
        link.symlink_to(tmp_path / goal)
        with pytest.raises(OutputError, match=rf"a link to .*{goal} is there"):
            write_model(link, make_model(seed=1))
        assert link.is_symlink()
    assert (tmp_path / "notes.txt").read_text() == "mine" and not (tmp_path / "nowhere").exists()
    np.testing.assert_array_equal(read_model(path).position, make_model().position)


def test_a_pipe_is_not_waited_for(tmp_path: Path):
    pipe = tmp_path / "pipe.safetensors"
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match="a pipe or a device is there"):
        write_model(pipe, make_model())
    assert pipe.is_fifo()
    with pytest.raises(FileDamagedError, match="a pipe or a device"):
        read_model(pipe)
    with pytest.raises(OutputError, match="a pipe or a device"):
        refuse_what_is_not_ours("/dev/null")
    with pytest.raises(OutputError, match="a folder is there"):
        refuse_what_is_not_ours(tmp_path)


def test_what_comes_to_lie_there_while_it_is_written_stays(tmp_path: Path, monkeypatch):
    """The user saves a file of that name in the seconds that a large model takes."""
    path, sync = tmp_path / "m.safetensors", os.fsync

    def save_meanwhile(number: int) -> None:
        sync(number)
        path.write_text("mine")

    monkeypatch.setattr(os, "fsync", save_meanwhile)
    with pytest.raises(OutputError, match="not a PhysHDR model"):
        write_model(path, make_model())
    assert path.read_text() == "mine" and os.listdir(tmp_path) == [path.name]


def test_names_may_be_as_long_as_the_file_system_allows(tmp_path: Path):
    longest = tmp_path / ("ü" * 121 + "a.safetensors")  # 255 bytes
    write_model(longest, make_model())
    assert read_model(longest).count == 7 and len(os.listdir(tmp_path)) == 1
    with pytest.raises(OutputError, match=r"File name too long[\s\S]*choose another name"):
        write_model(tmp_path / ("x" * 300 + ".safetensors"), make_model())
