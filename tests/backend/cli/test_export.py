# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: what is refused before anything is read or written, and how bright its files are."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.cli.run_files import RunFiles
from physhdr.backend.export.blender_model import to_model
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.pictures import read_exr
from physhdr.backend.serve import preview
from physhdr.bridge import srgb
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.messages import PreviewCamera, PreviewRequest
from physhdr.bridge.model_file import photographed_ev, read_model
from physhdr.bridge.spherical_harmonics import C0
from physhdr.bridge.splat_files import read_splat_file
from physhdr.tests.backend.scene import layouts


@pytest.mark.parametrize("exposure_ev", [2000.0, -31.0, float("inf"), float("nan")])
def test_an_exposure_beyond_all_pictures_is_refused(tmp_path: Path, exposure_ev: float) -> None:
    with pytest.raises(BadValueError, match=r"EV[\s\S]*−30 to 30"):
        RunFiles(source=tmp_path, exposure_ev=exposure_ev).work()


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A run of 20 iterations on photographs of 1/250, 1/60 and 1/15 s."""
    folder = tmp_path_factory.mktemp("photographs")
    data = layouts.write_colmap(folder / "data", exif=False)
    names = sorted((data / "images").iterdir())
    seconds = (1 / 250, 1 / 60, 1 / 15)
    (data / "exposure.json").write_text(
        json.dumps({each.name: seconds[int(each.stem[-1])] for each in names})
    )
    options = [
        "--iterations",
        "20",
        "--preset",
        "fast",
        "--initial-points",
        "random",
        "--set",
        "random_points=200",
    ]
    assert main(["train", str(data), "--out", str(folder / "run"), *options]) == 0
    return folder / "run"


def colours(path: Path) -> np.ndarray:
    return read_splat_file(path).colour_sh[:, 0]


def test_files_for_viewers_are_as_bright_as_the_photographs(photographs: Path, tmp_path: Path) -> None:
    """Of their middle exposure: at the seconds that suit a render all would be white."""
    out, ev = tmp_path / "out", math.log2(1 / 60)
    assert main(["export", str(photographs), str(out), "--quick"]) == 0
    model = read_model(out / "model.safetensors")
    assert model.developed_ev == photographed_ev(model.metadata) == pytest.approx(ev, abs=1e-3)
    for name, given in (("asked.ply", []), ("stated.ply", ["--exposure-ev", str(ev)])):
        assert main(["export", str(photographs), str(tmp_path / name), "--quick", *given]) == 0
    assert main(["export", str(out / "model.safetensors"), str(tmp_path / "file.ply")]) == 0
    expected = colours(tmp_path / "stated.ply")
    for path in (out / "baked.ply", out / "lossless.ply", tmp_path / "asked.ply", tmp_path / "file.ply"):
        np.testing.assert_allclose(colours(path), expected, atol=2e-3)
    assert main(["export", str(photographs), str(tmp_path / "2s.ply"), "--quick", "--exposure-ev", "1"]) == 0
    assert np.abs(colours(tmp_path / "2s.ply") - expected).mean() > 0.1


def test_radiance_of_photographs_is_on_a_display_as_they_are(photographs: Path, tmp_path: Path) -> None:
    """In a render, in a preview and in the model file; and the model's own curve still gives the photo."""
    run = open_run(photographs, pictures=False)
    seconds, camera = run.scene.middle_exposure, run.trained_views()[0].camera
    photo = run.method.ldr(camera, seconds).double()

    rendered = tmp_path / "view.exr"
    assert main(["render", str(photographs), "--view", "train/0", "--out", str(rendered)]) == 0
    radiance = torch.from_numpy(read_exr(rendered)).double().permute(2, 0, 1)
    shown = srgb.to_srgb((seconds * radiance).clamp(0.0, 1.0).numpy())
    assert abs(shown.mean() - float(photo.mean())) < 5.0 / 255.0
    assert abs(math.log2(run.radiance_scale)) > 0.5  # what it would have been wrong by

    pose = tuple(camera.camera_to_world.ravel().tolist())
    lens = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    asked = PreviewCamera(pose=pose, **lens)
    request = PreviewRequest(sequence=1, camera=asked, exposure_ev=math.log2(seconds))
    frame = preview.render(run.method, request, run.iteration, run.radiance_scale)
    np.testing.assert_allclose(
        frame.rgba[..., :3].transpose(2, 0, 1), seconds * radiance, rtol=2e-2, atol=1e-3
    )

    model = run.model(with_confidence=False)
    log_radiance = model.log_radiance_sh[:, 0] * C0
    plain = to_model(run.on_gaussians(), np.zeros(3), (), {})
    np.testing.assert_allclose(
        log_radiance - plain.log_radiance_sh[:, 0] * C0, math.log(run.radiance_scale), atol=1e-4
    )
    at = plain.tone_curve_log_exposure
    np.testing.assert_allclose(model.tone_curve_log_exposure - at, math.log(run.radiance_scale), atol=1e-5)


@pytest.mark.parametrize("name", ["baked.ply", "lossless.ply"])
def test_somebodys_own_file_is_not_replaced(photographs: Path, tmp_path: Path, name: str, capsys) -> None:
    """Before anything is written; a folder of that name is no file of ours either."""
    (out := tmp_path / "out").mkdir()
    theirs = b"ply\nformat ascii 1.0\ncomment PhysHDRs friend\nelement vertex 0\nend_header\n"
    (out / name).write_bytes(theirs)
    assert main(["export", str(photographs), str(out), "--quick"]) == 1
    said = capsys.readouterr().err
    assert f"{name} exists, and 'physhdr export' did not write it" in said and "another folder" in said
    assert (out / name).read_bytes() == theirs and [path.name for path in out.iterdir()] == [name]
    (out / name).unlink()
    (out / name).mkdir()
    assert main(["export", str(photographs), str(out), "--quick"]) == 1
    assert [path.name for path in out.iterdir()] == [name]


def test_nothing_of_an_earlier_export_stays_beside_the_new_model(
    photographs: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    """Neither where it is stopped while colours are fitted, nor where the new run has no lossless file."""
    out, both = tmp_path / "out", ["cameras.json", "model.safetensors"]
    words = ["export", str(photographs), str(out), "--quick"]
    for _ in range(2):
        assert main(words) == 0
        assert sorted(path.name for path in out.iterdir()) == ["baked.ply", both[0], "lossless.ply", both[1]]
    with monkeypatch.context() as patch:
        patch.setattr("physhdr.backend.model.gaussians.Gaussians.is_fixed", False)  # as of anchors
        assert main(words) == 0
    assert "no lossless.ply" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["baked.ply", *both]

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("physhdr.backend.cli.run_files.fitted_colour_sh", stopped)
    with pytest.raises(KeyboardInterrupt):
        RunFiles(source=photographs, out=out).work()
    assert sorted(path.name for path in out.iterdir()) == both
