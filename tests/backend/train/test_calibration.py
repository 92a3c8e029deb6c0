# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera's response and lens out of one training, frozen in the next."""

import dataclasses
import json

import pytest
import torch

from physhdr.backend.cli import main
from physhdr.backend.model.tone_mapper import ToneMapper
from physhdr.backend.runs.views import write_views
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.calibration import read_calibration
from physhdr.backend.train.config import write_config
from physhdr.backend.train.nuisances import Nuisances
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.saver import save
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError

SHORT = dataclasses.replace(PRESETS["default"], iterations=12, nuisances="on")


@pytest.fixture(scope="module")
def calibrated(tiny_data, tmp_path_factory):
    """A trained run's trainer, and the file that ``physhdr calibrate`` wrote of it."""
    folder = tmp_path_factory.mktemp("calibrated")
    state = begin(read_scene(tiny_data), SHORT)
    with torch.no_grad():
        state.part(Nuisances).values["vignetting"].copy_(torch.tensor([[0.1, 0.2, 0.3]]))
        state.method.tone_mapper.w2 += 0.01  # as if it had learned
    write_config(folder / "config.json", SHORT, tiny_data, "default")
    state.views_digest = write_views(folder, state.plan.seen.scene)
    save(state, folder)
    path = folder / "camera.json"
    assert main(["calibrate", str(folder), "--out", str(path)]) == 0
    return state, path


def curve(mapper: ToneMapper) -> torch.Tensor:
    return mapper.sampled()[1]


def test_response_and_lens_come_back_whatever_point_of_the_response_was_known(calibrated, tiny_data):
    first, path = calibrated
    anchored = first.method.tone_mapper
    assert anchored.anchor is not None
    config = dataclasses.replace(SHORT, calibration=str(path))
    scene = dataclasses.replace(read_scene(tiny_data), info={}, response_anchor=None)
    second = begin(scene, config)
    assert second.method.tone_mapper.anchor is None
    assert torch.allclose(curve(second.method.tone_mapper), curve(anchored), atol=1e-5)
    assert second.part(Nuisances).values["vignetting"][0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    rows = json.loads(path.read_text())["curve"]
    x, values = anchored.sampled()
    nearest = (x - rows[20][0]).abs().argmin()
    assert rows[20][1:] == pytest.approx(values[nearest].tolist(), abs=1e-4)


def test_they_stay_as_they_are_also_when_the_training_is_resumed_without_the_file(
    calibrated, tiny_data, tmp_path
):
    scene = read_scene(tiny_data)
    copied = tmp_path / "camera.json"
    copied.write_bytes(calibrated[1].read_bytes())
    config = dataclasses.replace(SHORT, calibration=str(copied))
    state = begin(scene, config)
    before = curve(state.method.tone_mapper).clone()
    for _ in range(3):
        step(state)
    save(state, tmp_path)
    copied.unlink()
    resumed = resume(tmp_path, scene, config)
    for _ in range(3):
        step(resumed)
    assert torch.equal(curve(resumed.method.tone_mapper), before)
    assert resumed.part(Nuisances).values["vignetting"][0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert resumed.part(Nuisances).values["log_gain"].abs().max() > 0.0  # what is the photos' own goes on


def test_what_is_no_calibration_of_this_camera_is_refused(calibrated, tiny_data, tmp_path):
    scene, written = read_scene(tiny_data), json.loads(calibrated[1].read_text())
    with pytest.raises(FileMissingError):
        begin(scene, dataclasses.replace(SHORT, calibration=str(tmp_path / "none.json")))
    path = tmp_path / "camera.json"
    for change, why in (
        ({"format": "other"}, "not of the format"),
        ({"vignetting": [1.0, -2.0, 0.0]}, "vignetting is not 3 numbers"),
        ({"reach": 0.0}, "reach is not above 0"),
        ({"response": 3}, "not a calibration"),
    ):
        path.write_text(json.dumps(written | change))
        with pytest.raises(FileDamagedError, match=why):
            read_calibration(path)
    del written["response"]["slope"]
    path.write_text(json.dumps(written))
    with pytest.raises(DataMismatchError, match="another kind of response curve"):
        begin(scene, dataclasses.replace(SHORT, calibration=str(path)))
    path.write_text(json.dumps(written | {"response": None}))
    with pytest.raises(DataMismatchError, match="whose response is known"):
        begin(scene, dataclasses.replace(SHORT, calibration=str(path)))


@pytest.mark.parametrize(
    ("config", "hint"),
    [
        (SHORT, "--nuisances off"),
        (PRESETS["hdr-gs"], "leave out --calibration"),  # it knows of no vignetting
    ],
)
def test_vignetting_that_would_be_dropped_is_refused(config, hint, calibrated, tiny_data, tmp_path):
    scene, written = read_scene(tiny_data), json.loads(calibrated[1].read_text())
    path = tmp_path / "camera.json"
    off = dataclasses.replace(config, iterations=12, calibration=str(path), nuisances="off")
    state = begin(scene, dataclasses.replace(off, calibration=None)).method.tone_mapper.state_dict()
    written["response"] = {name: value.tolist() for name, value in state.items()}
    path.write_text(json.dumps(written))
    with pytest.raises(BadValueError, match="vignetting") as refused:
        begin(scene, off)
    assert hint in refused.value.hint
    for nothing in ({"vignetting": None, "reach": None}, {"vignetting": [0.0, 0.0, 0.0]}):
        path.write_text(json.dumps(written | nothing))
        assert begin(scene, off).part(Nuisances) is None
