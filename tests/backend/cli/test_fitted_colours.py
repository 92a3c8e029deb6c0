# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export`` fits display colours: to a run's pictures, or to a model's from given cameras."""

import json

import pytest
from plyfile import PlyData

from physhdr.backend.cli import main
from physhdr.backend.scene import read_scene


@pytest.fixture(scope="module")
def run(tiny_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    assert main(["train", str(tiny_data), "--out", str(folder), "--iterations", "30"]) == 0
    assert main(["export", str(folder), "--exposure-ev", "0"]) == 0
    return folder


def test_a_run_a_model_with_its_cameras_and_the_export_agree(run, tiny_data, tmp_path, viewer):
    """The preset's response is global: the model file's picture is the run's, and so is what is fitted to it.

    (Coefficients that pictures hardly tell differ by more than what one sees of them.)
    """
    camera = read_scene(tiny_data).test[0].camera

    def seen(path):
        return viewer.viewed(PlyData.read(str(path))["vertex"], camera)

    model, ev = str(run / "model.safetensors"), ["--exposure-ev", "0"]
    expected = seen(run / "baked.ply")
    sources = [[str(run)], [model, "--cameras", str(run)], [model, "--cameras", str(tiny_data)]]
    for index, (source, *cameras) in enumerate(sources):
        out = tmp_path / f"{index}.ply"
        assert main(["export", source, str(out), *cameras, *ev]) == 0
        assert rms(seen(out) - expected) < 0.003
    quick = []
    for index, (source, *words) in enumerate([[str(run), "--quick"], [model]]):
        out = tmp_path / f"quick_{index}.ply"
        assert main(["export", source, str(out), *words, *ev]) == 0
        quick.append(seen(out))
    assert rms(quick[0] - quick[1]) < 1e-6 and rms(quick[0] - expected) > 0.03


def rms(difference):
    return float(difference.square().mean().sqrt())


def test_a_program_is_told_how_far_it_is(run, tmp_path, capsys):
    capsys.readouterr()
    model = str(run / "model.safetensors")
    out = tmp_path / "a.ply"
    assert main(["export", model, str(out), "--cameras", str(run), "--tone", "srgb", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["result"]["gaussians"] > 60 and "fitted" in lines[-1]["result"]["told"]
    assert lines[-2]["progress"] == 1.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.ply", "--cameras", "nowhere"], "nowhere"),
        (["a.ply", "--cameras", "RUN", "--quick"], "--quick does not fit"),
        (["a.glb", "--cameras", "RUN", "--blend-linear", "--tone", "srgb"], "needs display colours"),
        (["a.safetensors", "--quick"], "needs display colours"),
    ],
)
def test_what_does_not_fit_is_refused(run, tmp_path, capsys, words, message):
    out, *options = [str(run) if word == "RUN" else word for word in words]
    assert main(["export", str(run / "model.safetensors"), str(tmp_path / out), *options]) == 1
    assert message in capsys.readouterr().err and not (tmp_path / out).exists()


def test_a_run_has_its_own_cameras(run, tmp_path, capsys):
    assert main(["export", str(run), str(tmp_path / "a.ply"), "--cameras", str(run)]) == 1
    assert "a run has its own cameras" in capsys.readouterr().err
