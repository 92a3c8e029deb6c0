# SPDX-License-Identifier: GPL-3.0-or-later
"""A probe's folder: whole or not there, and never another's."""

import dataclasses
import json

import pytest

from physhdr.bridge import probe
from physhdr.bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError

FOUND = probe.Probe(
    at=(0.1, -2.0, 1.0),
    width=64,
    lights=("ambient", "lamp"),
    unseen=0.25,
    near=0.02,
    left_out=3,
    gaussians=100,
    made_by="test",
    source="model",
)


def test_what_is_written_is_read(tmp_path):
    probe.begin(tmp_path / "new" / "probe")
    probe.finish(tmp_path / "new" / "probe", FOUND)
    assert probe.read_probe(tmp_path / "new" / "probe") == FOUND
    assert FOUND.files == ("fixed.exr", "light_0.exr", "light_1.exr")


def test_a_folder_that_is_begun_is_not_whole_until_it_is_finished(tmp_path):
    probe.begin(tmp_path)
    probe.finish(tmp_path, FOUND)
    probe.begin(tmp_path)
    with pytest.raises(FileMissingError):
        probe.read_probe(tmp_path)


def test_only_a_probes_own_files_are_overwritten(tmp_path):
    for name in ("fixed.exr", "light_0.exr", "light_7.exr", "light_0.tmpabc.exr"):
        (tmp_path / name).write_bytes(b"")
    probe.begin(tmp_path)
    probe.finish(tmp_path, dataclasses.replace(FOUND, lights=("ambient",)))
    assert not (tmp_path / "light_7.exr").exists()  # a former probe's, with more lights
    (tmp_path / "light_of_my_life.exr").write_bytes(b"")
    with pytest.raises(OutputError, match="light_of_my_life"):
        probe.begin(tmp_path)
    assert (tmp_path / probe.PROBE_FILE).exists()


def test_where_a_file_lies_there_is_no_folder(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError):
        probe.begin(tmp_path / "file")


@pytest.mark.parametrize(
    "change",
    [
        {"format": "other"},
        {"version": 2},
        {"at": [0, 0]},
        {"at": [0, 0, "up"]},
        {"width": 100},
        {"lights": ["a", "a"]},
        {"unseen": 1.5},
        {"near": None},
    ],
)
def test_a_damaged_description_is_refused(tmp_path, change):
    probe.finish(tmp_path, FOUND)
    path = tmp_path / probe.PROBE_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FileDamagedError, match=r"probe\.json"):
        probe.read_probe(tmp_path)


@pytest.mark.parametrize("width", [0, 8, 1000, 32768, -1024])
def test_widths_that_cannot_be_filled_are_refused(width):
    with pytest.raises(BadValueError, match="wide"):
        probe.check_width(width)
