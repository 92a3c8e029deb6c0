# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: each format's axes and colours against closed forms, and every kind of bad file."""

import json
import math
import os
import re
import struct
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.cli import main
from physhdr.backend.cli.convert import read_source
from physhdr.backend.runs import run as opening
from physhdr.bridge import ply_model, srgb
from physhdr.bridge.gaussian_ply import read_ply, standard_columns, standard_names, write_standard_ply
from physhdr.bridge.model_file import Model, read_model, write_model
from physhdr.bridge.spherical_harmonics import C0, basis, fibonacci_sphere
from physhdr.bridge.splat_files import SplatCloud, reading

#: Where Blender's X, Y and Z are in a file's axes, by words: right, forward, up.
AXES = {
    "z": np.eye(3),
    "y": np.stack([(1, 0, 0), (0, 0, -1), (0, 1, 0)], axis=1),  # forward is −Z, up is Y
    "colmap": np.stack([(1, 0, 0), (0, 0, 1), (0, -1, 0)], axis=1),  # forward is Z, up is −Y
}
DISPLAY = (".ply", ".spz", ".glb", ".gltf")
DEFAULT_UP = {".ply": "z", ".spz": "y", ".glb": "y", ".gltf": "y", ".usdc": "z", ".usda": "z", ".usdz": "z"}


def a_model(degree: int = 1, **others) -> Model:
    rng = np.random.default_rng(5)
    count = 40
    sh = 0.05 * rng.standard_normal((count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-3.0, 1.0, (count, 3)) / C0
    rotation = rng.standard_normal((count, 4))
    arrays = {
        "position": rng.uniform(-2.0, 2.0, (count, 3)),
        "rotation": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        "scale": np.exp(rng.uniform(-5.0, -1.0, (count, 3))),
        "opacity": rng.uniform(0.05, 0.95, count),
        "log_radiance_sh": sh,
        "light_share": rng.uniform(0.0, 0.5, (count, 2, 3)),
    }
    curve = {
        "tone_curve_log_exposure": np.linspace(-6.0, 4.0, 64),
        "tone_curve": np.linspace(0.0, 1.0, 64)[:, None] ** [1.0, 1.5, 2.0],
    }
    floats = {name: array.astype(np.float32) for name, array in (arrays | curve | others).items()}
    return Model(**floats, lights=("ambient", "lamp"), metadata={"scene": "test"})


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_model(tmp_path / "m.safetensors", a_model(0))
    return tmp_path / "m.safetensors"


def convert(*words: object) -> None:
    assert main(["export", *map(str, words)]) == 0


def fails(capsys, *words: object) -> str:
    assert main(["export", *map(str, words)]) == 1
    told = capsys.readouterr().err
    assert told.startswith("error: ") and "Traceback" not in told
    return " ".join(told.split())


def plain(cloud: SplatCloud) -> np.ndarray:
    """``[N, 3]``: Σ sh·Y + ½ of degree 0, float64."""
    return cloud.colour_sh[:, 0].astype(np.float64) * C0 + 0.5


def words(capsys) -> str:
    """What was said since the last time, in one line."""
    return " ".join(capsys.readouterr().out.split())


def cloud_in(path: Path) -> SplatCloud:
    """What a file holds, in its own axes."""
    source = read_source(path)
    assert source.cloud is not None
    return source.cloud


# ---- axes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", DEFAULT_UP)
@pytest.mark.parametrize("up", [None, "z", "y", "colmap"])
def test_right_forward_and_up_are_where_the_format_has_them(model: Path, suffix: str, up) -> None:
    if up == "colmap" and suffix.startswith(".usd"):
        return
    out = model.with_name(f"out{suffix}")
    convert(model, out, *(["--up", up] if up else []))
    read, turn = cloud_in(out), AXES[up or DEFAULT_UP[suffix]]
    step = 2e-4 if suffix == ".spz" else 1e-6
    np.testing.assert_allclose(read.position, read_model(model).position @ turn.T, atol=step)
    if suffix == ".ply":
        assert read.up == (up or "z")
        assert any("up" in line or "down" in line for line in read_ply(out).comments)


def test_what_a_direction_sees_turns_with_the_axes(tmp_path: Path) -> None:
    """The colour toward a direction of Blender's world is that toward the same direction in the file."""
    write_model(tmp_path / "m.safetensors", a_model(3))
    convert(tmp_path / "m.safetensors", tmp_path / "a.ply", "--tone", "srgb")
    convert(tmp_path / "m.safetensors", tmp_path / "a.glb", "--tone", "srgb")
    directions = fibonacci_sphere(30)
    for one, turn in ((cloud_in(tmp_path / "a.ply"), AXES["z"]), (cloud_in(tmp_path / "a.glb"), AXES["y"])):
        seen = np.einsum("dk,nkc->ndc", basis(directions @ turn.T, 3), one.colour_sh)
        if turn is AXES["z"]:
            expected = seen
    np.testing.assert_allclose(seen, expected, atol=1e-5)


# ---- colours ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", DISPLAY)
@pytest.mark.parametrize("tone", ["learned", "srgb"])
def test_a_model_is_developed_as_its_response_says(model: Path, suffix: str, tone: str) -> None:
    """ln(exposure × radiance) through the sampled curve, worked out here for each Gaussian."""
    out = model.with_name(f"out{suffix}")
    convert(model, out, "--exposure-ev", 2, "--lighting-levels", "ambient=0.5", "lamp=3", "--tone", tone)
    m = read_model(model)
    radiance = np.exp(m.log_radiance_sh[:, 0].astype(np.float64) * C0)
    radiance *= 1.0 + m.light_share[:, 0] * (0.5 - 1.0) + m.light_share[:, 1] * (3.0 - 1.0)
    if tone == "learned":
        x, y = m.tone_curve_log_exposure, m.tone_curve
        expected = np.stack([np.interp(np.log(4.0 * radiance[:, c]), x, y[:, c]) for c in range(3)], axis=1)
    else:
        expected = srgb.to_srgb(4.0 * radiance)
    # SPZ has bytes of ½ + 0.15 sh_0, which end at colours of ½ ± 0.94.
    step = 0.51 / 255.0 * C0 / 0.15 if suffix == ".spz" else 2e-5
    np.testing.assert_allclose(
        plain(cloud_in(out)), expected.clip(-0.44, 1.44) if suffix == ".spz" else expected, atol=step
    )


@pytest.mark.parametrize(
    "suffix, options",
    [(".usdc", []), pytest.param(".usda", [], marks=pytest.mark.long), (".glb", ["--blend-linear"])],
)
def test_usd_has_the_radiance_itself(model: Path, suffix: str, options) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")
    out = model.with_name(f"out{suffix}")
    m = read_model(model)
    ahead = np.tile(np.float32([0, 0, 1]), (m.count, 1))
    for ev, level in ((0.0, 1.0), (-3.0, 4.0)):
        convert(model, out, *options, "--exposure-ev", ev, "--lighting-level", level)
        expected = 2.0**ev * m.radiance(ahead.astype(np.float64), (level, 1.0))
        np.testing.assert_allclose(plain(cloud_in(out)), expected, rtol=1e-4, atol=1e-6)
    assert read_source(out).is_linear
    write_model(model, replace(m, exposures=(0.5, 2.0, 8.0)))
    convert(model, out, *options)
    default = 2.0 if options else 1.0  # glTF is display-referred: a picture's exposure, the middle one
    expected = default * m.radiance(ahead.astype(np.float64), (1.0, 1.0))
    np.testing.assert_allclose(plain(cloud_in(out)), expected, rtol=1e-4, atol=1e-6)


def test_lights_whose_names_begin_with_a_dash_are_given_after_a_space(tmp_path: Path) -> None:
    write_model(tmp_path / "m.safetensors", replace(a_model(0), lights=("-key", "--lamp")))
    write_model(tmp_path / "n.safetensors", a_model(0))
    convert(tmp_path / "m.safetensors", tmp_path / "m.ply", "--lighting-levels", " -key=0.5", " --lamp=3")
    convert(tmp_path / "n.safetensors", tmp_path / "n.ply", "--lighting-levels", "ambient=0.5", "lamp=3")
    one, other = cloud_in(tmp_path / "m.ply"), cloud_in(tmp_path / "n.ply")
    np.testing.assert_array_equal(one.colour_sh, other.colour_sh)


def test_a_level_that_was_not_baked_is_told_as_what_is_written(tmp_path: Path, capsys) -> None:
    """Of baked levels the ends hold outside; message and header name the level that the colours have."""
    arrays = {name: array for name, array in a_model(0).tensors().items() if name != "light_share"}
    gain = np.linspace(-1.0, 1.0, 3, dtype=np.float32)[:, None, None] * np.ones((1, 40, 3), np.float32)
    write_model(tmp_path / "m.safetensors", Model(**arrays, level_log_gain=gain, levels=(0.5, 1.0, 2.0)))
    files = {}
    for asked, known in ((0.0, 0.5), (0.5, 0.5), (2.0, 2.0), (5.0, 2.0)):
        out = tmp_path / f"{asked}.ply"
        convert(tmp_path / "m.safetensors", out, "--lighting-level", asked)
        told = words(capsys)
        assert f"lighting level {known:g}," in told and "lighting level 5" not in told
        assert (f"written at {known:g}, not {asked:g}" in told) == (asked != known)
        assert any(f"lighting level {known:g}," in line for line in read_ply(out).comments)
        files[asked] = out.read_bytes()
    assert files[0.0] == files[0.5] != files[2.0] == files[5.0]


def test_another_programs_colours_pass_through(tmp_path: Path) -> None:
    """Not a bit of them is fitted anew: PLY → glTF → PLY → PLY, and the axes come back."""
    rng = np.random.default_rng(0)
    m = a_model(3)
    colours = rng.normal(size=(m.count, 16, 3)).astype(np.float32)
    write_standard_ply(tmp_path / "a.ply", m.position, m.rotation, m.scale, m.opacity, colours)
    convert(tmp_path / "a.ply", tmp_path / "b.ply")
    np.testing.assert_array_equal(cloud_in(tmp_path / "b.ply").colour_sh, colours)
    convert(tmp_path / "a.ply", tmp_path / "c.glb")
    convert(tmp_path / "c.glb", tmp_path / "d.ply")
    back = cloud_in(tmp_path / "d.ply")
    np.testing.assert_allclose(back.colour_sh, colours, atol=2e-6)
    np.testing.assert_allclose(back.position, m.position, atol=1e-6)


@pytest.mark.long
def test_what_usds_radiance_changes_of_display_colours_is_told(tmp_path: Path, capsys) -> None:
    """As much as codes differ that are worked out here, direction by direction; not a bit where they stay."""
    pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")
    rng = np.random.default_rng(0)
    m = a_model(3)
    colours = (0.2 * rng.normal(size=(m.count, 16, 3))).astype(np.float32)
    write_standard_ply(tmp_path / "a.ply", m.position, m.rotation, m.scale, m.opacity, colours, up="z")
    convert(tmp_path / "a.ply", tmp_path / "b.usdc", "--exposure-ev", 2)
    [told] = re.findall(
        r"differ by (\S+) \(root mean square, white is 1\). Give --display-colors", words(capsys)
    )
    convert(tmp_path / "b.usdc", tmp_path / "c.ply", "--exposure-ev", -2)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shown = [
        np.clip(np.einsum("qk,nkc->nqc", basis(directions, 3), sh) + 0.5, 0.0, 1.0)
        for sh in (colours, cloud_in(tmp_path / "c.ply").colour_sh)
    ]
    rms = np.sqrt(np.square(shown[0] - shown[1]).mean())
    assert rms > 0.01 and float(told) == pytest.approx(rms, rel=0.05)

    convert(tmp_path / "a.ply", tmp_path / "d.usdc", "--display-colors")
    assert "differ" not in words(capsys) and not read_source(tmp_path / "d.usdc").is_linear
    convert(tmp_path / "d.usdc", tmp_path / "e.ply")
    np.testing.assert_array_equal(cloud_in(tmp_path / "e.ply").colour_sh, colours)
    assert "differ" not in words(capsys)


def test_display_colours_of_one_degree_come_back_from_usd(tmp_path: Path, capsys) -> None:
    """SH of degree 0 decode exactly: there is nothing to be told."""
    pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")
    m = a_model(0)
    colours = np.random.default_rng(0).uniform(-1.7, 1.7, (m.count, 1, 3)).astype(np.float32)
    write_standard_ply(tmp_path / "a.ply", m.position, m.rotation, m.scale, m.opacity, colours, up="z")
    convert(tmp_path / "a.ply", tmp_path / "b.usdc")
    assert "differ" not in words(capsys)
    convert(tmp_path / "b.usdc", tmp_path / "c.ply")
    np.testing.assert_allclose(cloud_in(tmp_path / "c.ply").colour_sh, colours, atol=1e-5)


def test_radiance_of_usd_is_exposed_for_a_screen_and_back(model: Path) -> None:
    pytest.importorskip("pxr.UsdVol", reason="needs usd-core: pip install usd-core")
    convert(model, model.with_name("a.usdc"))
    convert(model.with_name("a.usdc"), model.with_name("a.ply"), "--exposure-ev", 1)
    m = read_model(model)
    radiance = np.exp(m.log_radiance_sh[:, 0].astype(np.float64) * C0)
    found = plain(cloud_in(model.with_name("a.ply")))
    np.testing.assert_allclose(found, srgb.to_srgb(2.0 * radiance), atol=1e-4)
    convert(model.with_name("a.ply"), model.with_name("b.usdc"), "--exposure-ev", -1)
    np.testing.assert_allclose(plain(cloud_in(model.with_name("b.usdc"))), radiance, rtol=2e-4, atol=1e-4)
    convert(model.with_name("a.usdc"), model.with_name("b.safetensors"))
    again = read_model(model.with_name("b.safetensors"))
    lit = radiance > 1e-3
    np.testing.assert_allclose(np.exp(again.log_radiance_sh[:, 0] * C0)[lit], radiance[lit], rtol=1e-3)


@pytest.fixture(scope="module")
def run(two_lights_data: Path, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "two_lights"
    assert main(["train", str(two_lights_data), "--out", str(folder), "--iterations", "12"]) == 0
    return folder


def test_a_run_is_converted_as_its_model_file(run: Path, tmp_path: Path) -> None:
    """Bit for bit what the model file has, where colours are not fitted to its cameras."""
    convert(run, tmp_path / "m.safetensors")
    convert(run, tmp_path / "a.ply", "--lighting-level", 2, "--quick")
    convert(tmp_path / "m.safetensors", tmp_path / "b.ply", "--lighting-level", 2)
    one, other = cloud_in(tmp_path / "a.ply"), cloud_in(tmp_path / "b.ply")
    np.testing.assert_array_equal(one.colour_sh, other.colour_sh)
    np.testing.assert_array_equal(one.position, other.position)


def test_a_program_reads_nothing_but_json(run: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    def noticing(*words, report, **options) -> opening.Run:
        report("something was noticed")
        return open_run(*words, report=report, **options)

    open_run = opening.open_run
    monkeypatch.setattr(opening, "open_run", noticing)
    words = [run, tmp_path / "a.ply", "--quick"]
    convert(*words, "--json")
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["result"]["out"] == str(tmp_path / "a.ply")
    convert(*words)
    said = capsys.readouterr().out
    assert "something was noticed" in said and f"wrote {tmp_path / 'a.ply'}: " in said


def test_it_starts_without_torch() -> None:
    script = "import sys, physhdr.backend.cli.convert; print({'torch', 'pxr', 'PIL'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "set()"


def test_a_model_that_lies_on_its_side_is_stood_up(tmp_path: Path) -> None:
    m = a_model(1)
    write_model(tmp_path / "m.safetensors", m)
    convert(tmp_path / "m.safetensors", tmp_path / "b.safetensors", "--from-up", "y")
    turned = read_model(tmp_path / "b.safetensors")
    np.testing.assert_allclose(turned.position @ AXES["y"].T, m.position, atol=1e-6)
    direction = np.tile(np.float64([0.6, 0.0, 0.8]), (m.count, 1))
    one = m.radiance(direction, (2.0, 1.0))
    np.testing.assert_allclose(turned.radiance(direction @ AXES["y"], (2.0, 1.0)), one, rtol=1e-5)


def test_its_result_and_its_error_are_told_as_json(model: Path, capsys) -> None:
    convert(model, model.with_name("a.glb"), "--json")
    [line] = capsys.readouterr().out.splitlines()
    result = json.loads(line)["result"]
    assert result["gaussians"] == 40 and result["up"] == "y" and result["out"].endswith("a.glb")
    assert main(["export", str(model), str(model.with_name("a.xyz")), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "bad_value"


@pytest.mark.parametrize(
    "out, options, told",
    [
        ("a.xyz", [], "is not a format that can be written Its name must end in: .ply"),
        ("a.sog", [], "read, not written Write .spz"),
        ("a.compressed.ply", [], "compressed PLY can be read, not written"),
        ("a.usdc", ["--up", "colmap"], "--up may be z or y"),
        ("a.usdc", ["--tone", "learned"], "without any response"),
        ("a.ply", ["--exposure-ev", "99"], "−30 to 30"),
        ("a.ply", ["--exposure-ev", "nan"], "−30 to 30"),
        ("a.ply", ["--blend-linear"], "only works with glTF"),
        ("a.ply", ["--display-colors"], "--display-colors only works with USD"),
        ("a.usdc", ["--display-colors"], "has radiance already"),
        ("a.ply", ["--lighting-levels", "moon=1"], "ambient, lamp"),
        ("a.safetensors", ["--lighting-level", "2"], "keeps all of its light"),
        ("a.safetensors", ["--up", "y"], "--up may be z"),
        ("a.ply", ["--data", "x"], "--data only applies to a run"),
        ("a.ply", ["--spz-version", "3"], "--spz-version only works with SPZ"),
        ("a.ply", ["--color-space", "srgb"], "--color-space only works with PLY"),
    ],
)
def test_what_does_not_fit_is_refused(model: Path, capsys, out: str, options, told: str) -> None:
    assert told in fails(capsys, model, model.with_name(out), *options)
    assert [path.name for path in model.parent.iterdir()] == ["m.safetensors"]


@pytest.mark.parametrize(
    "options",
    [
        ["--lighting-level", "2"],
        ["--tone", "learned"],
        ["--tone", "srgb"],
        ["--exposure-ev", "0"],
        ["--color-space", "linear"],
        ["--quick"],
    ],
)
def test_another_programs_file_has_no_light_to_change(model: Path, capsys, options) -> None:
    convert(model, model.with_name("a.glb"))
    assert options[0].split("-")[2] in fails(
        capsys, model.with_name("a.glb"), model.with_name("b.ply"), *options
    )


# ---- bad files -------------------------------------------------------------------------------------------


def bad_files(folder: Path) -> dict[str, Path]:
    """A file of each kind of bad for each format; ``nan-…`` hold NaN alone."""
    m = a_model(1)
    write_model(folder / "m.safetensors", m)
    made = {}
    for name in ("a.ply", "a.spz", "a.glb", "a.gltf", "a.usdc"):
        if name == "a.usdc" and not _has_usd():
            continue
        convert(folder / "m.safetensors", folder / name)
        raw = (folder / name).read_bytes()
        made[f"cut-{name}"] = raw[: len(raw) // 2]
        made[f"magic-{name}"] = b"\x00\x01\x02\x03" + raw[4:]
        made[f"empty-{name}"] = b""
    header = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n"
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += [f"rot_{i}" for i in range(4)]
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    made["rows.ply"] = header.format(1 << 62).encode()
    made["nan-a.ply"] = header.format(1_000_000).encode() + b"\xff\xff\xff\x7f" * (14 * 1_000_000)
    made["rows.spz"] = struct.pack("<4sIIBBBB", b"NGSP", 3, 0xFFFFFFFF, 3, 12, 0, 0)
    text = (folder / "a.gltf").read_text()
    made["rows.gltf"] = text.replace('"count":40', f'"count":{1 << 62}').encode()
    made["rows.glb"] = (folder / "a.glb").read_bytes().replace(b'"count":40', b'"count":1e99'[:10])
    paths = {}
    for name, raw in made.items():
        paths[name] = folder / "bad" / name
        paths[name].parent.mkdir(exist_ok=True)
        paths[name].write_bytes(raw)
    with zipfile.ZipFile(folder / "bad" / "bomb.sog", "w", zipfile.ZIP_DEFLATED) as archive:
        plane = {"files": ["a", "a"], "mins": [0.0] * 3, "maxs": [1.0] * 3}
        archive.writestr("meta.json", json.dumps({"version": 2, "count": 1000, "means": plane}))
        with archive.open("a", "w", force_zip64=True) as member:
            for _ in range(300):
                member.write(bytes(1 << 20))
    paths["bomb.sog"] = folder / "bad" / "bomb.sog"
    return paths


def _has_usd() -> bool:
    try:
        import pxr.UsdVol  # noqa: F401
    except ImportError:
        return False
    return True


_READ_ALL = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
from pathlib import Path
from physhdr.backend.cli.convert import read_source
from physhdr.bridge.errors import PhysHDRError
for name in sys.argv[1:]:
    try:
        read_source(Path(name))
        print("READ", name)
    except PhysHDRError as error:
        print("refused" if error.hint and Path(name).name in str(error) else f"UNCLEAR {error}", name)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="addresses are limited as on Linux")
def test_no_bad_file_is_read_or_takes_two_gigabytes(tmp_path: Path) -> None:
    """Cut off, of another kind, empty, 2⁶² rows, a million rows of NaN, a bomb: one clear error each."""
    paths = bad_files(tmp_path)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    words = [sys.executable, "-c", _READ_ALL, *map(str, paths.values())]
    told = subprocess.run(words, capture_output=True, text=True, env=environment)
    lines = told.stdout.splitlines()
    assert told.returncode == 0 and len(lines) == len(paths), told.stderr[-2000:]
    assert not [line for line in lines if not line.startswith("refused")]


def test_damaged_gaussians_are_left_out_and_counted(tmp_path: Path, capsys) -> None:
    m = a_model(0)
    write_standard_ply(tmp_path / "a.ply", m.position, m.rotation, m.scale, m.opacity, m.log_radiance_sh)
    raw = (tmp_path / "a.ply").read_bytes()
    at = raw.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(raw[:at] + struct.pack("<f", math.nan) + raw[at + 4 :])
    convert(tmp_path / "a.ply", tmp_path / "b.glb")
    assert "1 Gaussians with NaN" in capsys.readouterr().out
    assert cloud_in(tmp_path / "b.glb").count == 39


def test_what_is_too_bright_for_a_model_is_left_out_and_counted(tmp_path: Path, capsys) -> None:
    m = a_model(3)
    colours = np.abs(m.log_radiance_sh)
    colours[3:5] = 1e14 * np.random.default_rng(0).choice([-1.0, 1.0], (2, 16, 3))  # their logarithm rings
    position = m.position.copy()
    position[0] = np.nan
    header = "ply\nformat ascii 1.0\nelement vertex 40\n"
    header += "".join(f"property float {name}\n" for name in standard_names(16)) + "end_header\n"
    columns = standard_columns(m.position, m.rotation, m.scale, m.opacity, colours)
    columns["x"] = position[:, 0]
    rows = np.stack([columns[name] for name in standard_names(16)], axis=1)
    text = "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)
    (tmp_path / "a.ply").write_text(header + text)
    convert(tmp_path / "a.ply", tmp_path / "b.safetensors", "--color-space", "linear", "--json")
    result = json.loads(capsys.readouterr().out)["result"]
    assert read_model(tmp_path / "b.safetensors").count == result["gaussians"] == 37
    assert result["notes"] == ["3 Gaussians with NaN, infinite or absurd values were left out."]


def test_a_standard_ply_is_opened_once_and_not_made_a_model(tmp_path: Path, monkeypatch) -> None:
    m = a_model(3)
    colours = np.repeat(m.log_radiance_sh[:, :1], 16, axis=1)
    write_standard_ply(tmp_path / "a.ply", m.position, m.rotation, m.scale, m.opacity, colours)
    opened = []
    original = ply_model.open_gaussians
    monkeypatch.setattr(ply_model, "open_gaussians", lambda path: opened.append(path) or original(path))
    monkeypatch.setattr(reading, "open_gaussians", lambda path: opened.append(path) or original(path))
    monkeypatch.setattr(ply_model, "log_radiance_of", lambda *_: pytest.fail("colours became a logarithm"))
    np.testing.assert_array_equal(cloud_in(tmp_path / "a.ply").colour_sh, colours)
    assert len(opened) == 1


def test_what_an_spz_clips_is_told_in_a_line(tmp_path: Path, capsys) -> None:
    scale = a_model(1).scale.copy()
    scale[:7] = 1e-6
    write_model(tmp_path / "m.safetensors", a_model(1, scale=scale))
    convert(tmp_path / "m.safetensors", tmp_path / "a.spz")
    told = capsys.readouterr().out
    assert "SPZ clipped the σ of 7 Gaussians" in told and "σ of 6 %" in told
    assert abs(math.exp(1 / 16) - 1.06) < 0.005 and abs(C0 / (0.15 * 255) - 1 / 136) < 1e-4  # as it is told
