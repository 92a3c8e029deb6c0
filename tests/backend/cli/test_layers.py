# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render --layers``, and what its EXRs say of themselves, read by OpenImageIO."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.cli.layers import (
    LONGEST_PASS,
    NOTHING,
    Layers,
    pass_names,
    render_layers,
    write_layers,
)
from physhdr.backend.rasterize import median_depth, rasterize
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.pictures import read_radiance

FIXTURE = Path(__file__).resolve().parents[2] / "fixtures" / "layers.exr"


@pytest.fixture(scope="module")
def run(two_lights_data: Path, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "two"
    short = ["--iterations", "30", "--set", "sh_degree_every=5", "--preset", "default"]
    assert main(["train", str(two_lights_data), "--out", str(folder), *short]) == 0
    return folder


def opened(path: Path) -> tuple[dict[str, np.ndarray], OpenImageIO.ImageSpec]:
    """Channels by name, ``[H, W]``, and the header, as OpenImageIO has them."""
    picture = OpenImageIO.ImageBuf(str(path))
    pixels, spec = picture.get_pixels(), picture.spec()
    return {name: pixels[..., k] for k, name in enumerate(spec.channelnames)}, spec


def colour(planes: dict[str, np.ndarray], name: str) -> np.ndarray:
    return np.stack([planes[f"ViewLayer.{name}.{channel}"] for channel in "RGB"], axis=-1)


def require_rec709(spec: OpenImageIO.ImageSpec) -> None:
    """ITU-R BT.709's primaries and D65."""
    assert spec.getattribute("chromaticities") == pytest.approx(
        (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290), abs=1e-6
    )
    assert spec.get_string_attribute("workingSpace") == "Linear Rec.709"
    assert spec.get_string_attribute("oiio:ColorSpace") == "lin_rec709_scene"


def test_every_exr_of_radiance_says_its_space(run: Path, tmp_path: Path) -> None:
    assert main(["render", str(run), "--out", str(tmp_path / "a.exr")]) == 0
    require_rec709(opened(tmp_path / "a.exr")[1])
    found = read_radiance(tmp_path / "a.exr").chromaticities
    assert found is not None and found.white == pytest.approx((0.3127, 0.3290))
    at = ["--at", "0", "-3", "0", "--width", "32"]
    assert main(["render", str(run), *at, "--out", str(tmp_path / "probe")]) == 0
    for path in (tmp_path / "probe").glob("*.exr"):
        require_rec709(opened(path)[1])
    assert main(["render", str(run), "--out", str(tmp_path / "sure.exr"), "--confidence"]) == 0
    assert opened(tmp_path / "sure.exr")[1].get_string_attribute("colorInteropID") == "data"


def test_lights_add_up_to_the_radiance(run: Path, tmp_path: Path) -> None:
    out, levels = tmp_path / "layers.exr", ["--lighting-levels", "ambient=0.5", "pendant=3"]
    assert main(["render", str(run), "--out", str(out), "--layers", *levels]) == 0
    assert main(["render", str(run), "--out", str(tmp_path / "plain.exr"), *levels]) == 0
    planes, spec = opened(out)
    require_rec709(spec)
    assert spec.get_string_attribute("physhdr:levels") == "ambient=0.5, pendant=3"
    plain, _ = opened(tmp_path / "plain.exr")
    radiance = colour(planes, "Combined")
    np.testing.assert_allclose(radiance, np.stack([plain[c] for c in "RGB"], -1), rtol=1e-5, atol=1e-6)
    parts = [colour(planes, name).astype(np.float64) for name in ("Fixed", "Light ambient", "Light pendant")]
    total = parts[0] + 0.5 * parts[1] + 3.0 * parts[2]
    np.testing.assert_allclose(total, radiance, rtol=2e-5, atol=1e-5)
    assert all(part.max() > 0.01 for part in parts), "each light causes something"
    assert np.abs(parts[1] - parts[2]).max() > 0.01


def test_alpha_and_depth_are_the_references_in_float64(run: Path, tmp_path: Path) -> None:
    whole = open_run(run)
    method, seen = whole.method, whole.scene.test[0].camera
    camera = Camera.from_field_of_view(seen.camera_to_world, 48, 40, 2.4)  # so wide that nothing is round it
    write_layers(tmp_path / "a.exr", render_layers(method, camera, (1.0, 1.0)))
    planes, _ = opened(tmp_path / "a.exr")
    splats = method.backbone.splats(camera, method.active_sh_degree)
    shape = (splats.means, splats.quaternions, splats.scales, splats.opacities)
    in_float64 = [each.detach().double() for each in shape]
    nothing = torch.zeros(len(splats.means), 1, dtype=torch.float64)
    alpha = rasterize(*in_float64, nothing, camera, implementation="reference").alpha.numpy()
    expected = median_depth(*in_float64, camera, implementation="reference").numpy()
    np.testing.assert_allclose(planes["ViewLayer.Combined.A"], alpha, atol=1e-4)
    found = planes["ViewLayer.Depth.Z"]
    # Where rounding decides which Gaussian brings a pixel to a half, either is right.
    covered = expected > 0.0
    assert covered.any() and not covered.all()
    assert np.isclose(found[covered], expected[covered], rtol=1e-4).mean() > 0.98
    np.testing.assert_array_equal(found[alpha < 0.499], np.float32(NOTHING))


def test_confidence_is_that_of_its_own_picture(run: Path, tmp_path: Path) -> None:
    for words in (["a.exr", "--layers"], ["sure.exr", "--confidence"]):
        assert main(["render", str(run), "--out", str(tmp_path / words[0]), *words[1:]]) == 0
    layer = opened(tmp_path / "a.exr")[0]["ViewLayer.Confidence.X"]
    np.testing.assert_array_equal(layer, opened(tmp_path / "sure.exr")[0]["R"])
    assert 0.05 < layer.max() <= 1.0


def test_without_the_pictures_it_is_left_out_and_said(run: Path, tmp_path: Path, capsys) -> None:
    moved = shutil.copytree(run, tmp_path / "run")
    written = json.loads((moved / "config.json").read_text())
    text = json.dumps(written).replace(str(open_run(run).scene.root), str(tmp_path / "gone"))
    (moved / "config.json").write_text(text)
    assert main(["render", str(moved), "--out", str(tmp_path / "a.exr"), "--layers"]) == 0
    assert "without the layer Confidence" in capsys.readouterr().out
    names = opened(tmp_path / "a.exr")[0]
    assert "ViewLayer.Confidence.X" not in names and "ViewLayer.Fixed.R" in names


def test_names_that_programs_part(tmp_path: Path) -> None:
    """Dots part names; Blender cuts them off: two lights never become one layer."""
    lights = ("lamp.001", "lamp_001", "ü" * 70, "ü" * 71)
    names = pass_names(lights)
    assert names["lamp.001"] == "Light lamp_001" and len(set(names.values())) == 4
    assert all("." not in name and len(name.encode()) <= LONGEST_PASS + 3 for name in names.values())


def test_the_file_that_blenders_test_opens(tmp_path: Path) -> None:
    """Written anew it is the same: what is shown of it in ``tests/addon`` is of today's layers."""
    planes, spec = opened(FIXTURE)

    def plane(name: str) -> torch.Tensor:
        return torch.tensor(planes[f"ViewLayer.{name}"])

    def rgb(name: str) -> torch.Tensor:
        return torch.stack([plane(f"{name}.{channel}") for channel in "RGB"])

    depth = plane("Depth.Z")
    lights = {"sun": rgb("Light sun"), "lamp.001": rgb("Light lamp_001")}
    layers = Layers(
        rgb("Combined"),
        plane("Combined.A"),
        torch.where(depth < NOTHING, depth, 0.0),
        rgb("Fixed"),
        lights,
        plane("Confidence.X"),
    )
    write_layers(tmp_path / "again.exr", layers, (0.5, 2.0))
    again, spec_again = opened(tmp_path / "again.exr")
    assert set(again) == set(planes)
    for name, pixels in planes.items():
        np.testing.assert_array_equal(again[name], pixels)
    names = ("physhdr:levels", "workingSpace", "colorInteropID")
    told, told_again = ([each.get_string_attribute(name) for name in names] for each in (spec, spec_again))
    assert told == told_again


def test_oiiotool_takes_a_light_out(tmp_path: Path) -> None:
    """As docs/other-programs.md has it."""
    tool = shutil.which("oiiotool", path=str(Path(sys.executable).parent)) or shutil.which("oiiotool")
    if tool is None:
        pytest.skip("oiiotool is not installed")
    channels = ",".join(f"{c}=ViewLayer.Light sun.{c}" for c in "RGB")
    subprocess.run([tool, str(FIXTURE), "--ch", channels, "-o", str(tmp_path / "sun.exr")], check=True)
    planes, spec = opened(tmp_path / "sun.exr")
    require_rec709(spec)
    light = np.stack([planes[channel] for channel in "RGB"], axis=-1)
    np.testing.assert_array_equal(light, colour(opened(FIXTURE)[0], "Light sun"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "a.png", "--layers"], "--layers writes radiance"),
        (["--out", "a.exr", "--layers", "--exposure", "2"], "--layers writes radiance"),
        (
            ["--out", "a.exr", "--layers", "--confidence"],
            "--layers has no effect on a picture of the confidence",
        ),
        (["--out", "a", "--split", "test", "--layers"], "--layers has no effect on all views of a --split"),
        (["--out", "a.exr", "--exposure", "2"], "--exposure has no effect on a.exr, which is radiance"),
        (["--out", "a_#.exr", "--camera", "x.json", "--exposure", "2"], "--exposure has no effect"),
        (["--out", "a.png", "--exposure", "inf"], "--exposure is inf s: it must be from"),
        (["--out", "a.exr", "--workers", "2"], "--workers only works with --camera"),
        (["--out", "a.exr", "--camera", "x.json", "--view", "test/0"], "--view is one camera"),
    ],
)
def test_options_that_mean_nothing(options: list[str], message: str, capsys) -> None:
    """Said before the run is opened."""
    assert main(["render", "none", *options]) == 1
    assert message in capsys.readouterr().err
