# SPDX-License-Identifier: GPL-3.0-or-later
"""A configuration that cannot be trained is refused when it is made: no data are opened for it."""

import re

import pytest
from PIL import Image

from physhdr.backend.cli import main
from physhdr.tests.backend.scene import layouts

#: Options → what is said of them, with the remedy.
REFUSED = {
    "--preset paper --set supervision=bracket": r"bracket[\s\S]*--set supervision=one",
    "--preset gausshdr-short --set supervision=bracket": r"bracket[\s\S]*--set supervision=one",
    "--preset hdr-gs-short --set method.hdr_supervision=true --set method.hdr_truth=T": (
        r"half their size[\s\S]*--set half_size_until=0"
    ),
    "--preset paper --set method.illumination_branch=false": r"f_mix[\s\S]*mix=false",
    "--preset default --set method.sh_degree=4": "--set method.sh_degree must be from 0 to 3",
    "--preset default --set optimiser.tone_mapper=-1": "optimiser.tone_mapper must be 0 or more",
    "--preset default-scaffold --set backbone.rates.colour_final=-1": "backbone.rates.colour_final must be",
    "--preset paper --set method.loss.blur_size=4": "odd",
    "--preset hdr-nerf-small --set method.coarse_samples=2": r"coarse samples[\s\S]*3 or more",
    "--preset hdr-nerf-small --set method.learning_rate=-1": "method.learning_rate must be",
}


@pytest.mark.parametrize("options", REFUSED)
def test_it_is_refused_before_the_data_are_opened(options, tmp_path, capsys, monkeypatch):
    def opened(*_):
        raise AssertionError("the data were opened")

    monkeypatch.setattr("physhdr.backend.runs.begin.read_scene", opened)
    out = tmp_path / "run"
    assert main(["train", str(tmp_path), "--out", str(out), *options.split()]) == 1
    said = capsys.readouterr().err
    assert re.search(REFUSED[options], said), said
    assert not out.exists()


@pytest.mark.parametrize("seen", ["--exposure-mode exp1", "--training-exposures 2"])
def test_a_bracket_of_one_exposure_is_one_drawing(seen, tiny_data, tmp_path):
    """Earlier versions trained it: runs of theirs say so in their configuration."""
    options = f"--preset gausshdr-short --set supervision=bracket {seen} --iterations 2"
    assert main(["train", str(tiny_data), "--out", str(tmp_path / "run"), *options.split()]) == 0


def test_pictures_of_which_all_is_hidden_are_not_trained(tmp_path, capsys):
    """Nothing would be compared, and that without any error."""
    layouts.write_nerfstudio(tmp_path / "data")
    for path in (tmp_path / "data" / "images").iterdir():
        picture = Image.open(path).convert("RGB")
        picture.putalpha(0)
        picture.save(path)
    assert main(["train", str(tmp_path / "data"), "--out", str(tmp_path / "run"), "--iterations", "2"]) == 1
    assert "masks or alpha hide all pixels of all training pictures" in capsys.readouterr().err
