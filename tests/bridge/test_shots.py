# SPDX-License-Identifier: GPL-3.0-or-later
"""The file of a video's frames: it comes back as it was written, and what is damaged is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError
from physhdr.bridge.shots import Shot, Shots, read_shots, write_shots


def shots(count: int = 3) -> Shots:
    frames = []
    for index in range(count):
        pose = np.eye(4)
        pose[:3, 3] = index, -4.0, 1.0 / 3.0
        frames.append(Shot(pose, 60.0, 61.0, 32.0, 24.5, 0.5 * index, (1.0, 0.25 * index)))
    return Shots(64, 48, 23.976, frames)


def test_it_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    write_shots(tmp_path / "shots.json", shots())
    found = read_shots(tmp_path / "shots.json")
    assert (found.width, found.height, found.fps) == (64, 48, 23.976)
    for one, other in zip(found.frames, shots().frames, strict=True):
        np.testing.assert_array_equal(one.camera_to_world, other.camera_to_world)
        assert one.is_like(other) and one.levels == other.levels and one.exposure_ev == other.exposure_ev
    assert not found.frames[0].is_like(found.frames[1])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda c: c.update(format="other"), FileDamagedError, "not a physhdr-shots"),
        (lambda c: c.update(w=0), BadValueError, "w, h and fps"),
        (lambda c: c.update(fps=1000.0), BadValueError, "fps"),
        (lambda c: c.update(frames=[]), BadValueError, "from 2 to"),
        (lambda c: c["frames"].__setitem__(1, 7), BadValueError, "frame 1"),
        (lambda c: c["frames"][2].pop("fl_x"), BadValueError, "frame 2"),
        (lambda c: c["frames"][2].update(levels=[-1.0]), BadValueError, "below 0"),
        (lambda c: c["frames"][1].update(exposure_ev=5000.0), BadValueError, "frame 1 .* 5000 EV"),
        (lambda c: c["frames"][0].update(cx="left"), BadValueError, "frame 0"),
        (lambda c: c["frames"][0].update(transform_matrix=[[1.0]]), BadValueError, "frame 0"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change, error, message) -> None:
    path = tmp_path / "shots.json"
    write_shots(path, shots())
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(error, match=message) as raised:
        read_shots(path)
    assert "shots.json" in str(raised.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError):
        read_shots(tmp_path / "none.json")
