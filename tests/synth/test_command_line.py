# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input: one clear message on stderr, exit code 1 (2 for usage), no traceback, nothing written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from physhdr.synth.make_scene import main
from physhdr.synth.options import parse_numbers, parse_resolution

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--scene kitchen", "unknown scene 'kitchen': choose one of ball, interior"),
        ("--crf agx", "unknown response"),
        ("--crf no/such.json", "cannot read the response file 'no/such.json'"),
        ("--camera-rig spiral", "unknown camera rig 'spiral'"),
        ("--exposures 0.5,0.125", "must rise"),
        ("--exposures 1,1", "must rise"),
        ("--exposures 0,1", "--exposures"),
        ("--exposures=-3,-1,1", "seconds"),
        ("--exposures 1,two", "'two' is not a number"),
        ("--exposures nan,1", "'nan' is not a number"),
        ("--exposures ,", "at least one"),
        ("--ambient-levels 1,2", "leave it out"),
        ("--ambient-levels 1/0", "'1/0' is not a number"),
        ("--lit-levels=-1,2", "--lit-levels: -1 is not within"),
        ("--lit-levels 2,2", "each level once"),
        ("--resolution 0", "--resolution: 0 is not within"),
        ("--resolution 20x20x3", "write 200 or 320x240"),
        ("--samples 0", "--samples: 0 is not within"),
        ("--views 1", "--views: 1 is not within"),
        ("--seed=-1", "--seed"),
        ("--views 6 --relit-views 4", "--relit-views: 4 is not within"),
    ],
)
def test_bad_options(tmp_path, capsys, arguments, message):
    out = tmp_path / "data"
    assert main(["--out", str(out), *arguments.split()]) == 1
    told = capsys.readouterr().err
    assert message in told and told.startswith("error: ") and told.count("\n") == 1
    assert not out.exists()


def test_usage_errors_exit_with_2(capsys):
    for arguments in ([], ["--out", "x", "--samples", "many"], ["--out", "x", "--colour"]):
        with pytest.raises(SystemExit) as error:
            main(arguments)
        assert error.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_a_broken_dataset_json_is_named(tmp_path, capsys):
    (tmp_path / "dataset.json").write_text("{")
    assert main(["--out", str(tmp_path)]) == 1
    assert "dataset.json' is damaged" in capsys.readouterr().err
    assert (tmp_path / "dataset.json").read_text() == "{"


def test_a_full_disk_is_reported(tmp_path, capsys, monkeypatch):
    from physhdr.synth import folder

    def full(path, data):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(folder, "write", full)
    assert main(["--out", str(tmp_path / "d"), "--scene", "ball", "--views", "2", "--lit-views", "0"]) == 1
    told = capsys.readouterr().err
    assert "No space left on device" in told and told.count("\n") == 1


def test_the_script_in_a_process_of_its_own():
    """The exit code and the streams as a shell sees them, with Blender's '--' before our arguments."""
    command = [sys.executable, str(ROOT / "synth/make_scene.py"), "--", "--out", "/proc/nowhere"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "cannot write to the output folder '/proc/nowhere'" in done.stderr
    done = subprocess.run([*command[:2], "--help"], capture_output=True, text=True)
    assert (
        done.returncode == 0
        and "--ambient-levels" in done.stdout
        and "lamps stay" in " ".join(done.stdout.split())
    )


def test_numbers_and_sizes():
    assert parse_numbers("--x", "1/4,0.5 2") == (0.25, 0.5, 2.0)
    assert parse_resolution("320x240") == (320, 240) and parse_resolution("64") == (64, 64)
