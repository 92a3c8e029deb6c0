# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad input: one clear message on stderr, exit code 1 (2 for usage), no traceback, nothing written."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from physhdr.synth.errors import OptionError
from physhdr.synth.make_scene import main
from physhdr.synth.options import Options, evs
from physhdr.synth.parse import parse_evs, parse_mixtures, parse_numbers, parse_resolution, parse_scenes
from physhdr.tests.synth.open_scene import user_scene

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--scene kitchen", "unknown scene 'kitchen': choose one of ball, bathroom"),
        ("--scene ball,kitchen", "unknown scene 'kitchen'"),
        ("--scene ball,ball", "each scene once"),
        ("--scene ,", "name at least one, or 'all'"),
        ("--scene all --from-file current", "several built-in scenes, and --from-file asks for your own"),
        ("--assets no/such", "there is no folder of models 'no/such'"),
        ("--crf agx", "unknown response"),
        ("--crf no/such.json", "cannot read the response file 'no/such.json'"),
        ("--camera-rig spiral", "unknown camera rig 'spiral'"),
        ("--exposures 0.5,0.125", "must rise"),
        ("--exposures 1,1", "must rise"),
        ("--exposures 0,1", "--exposures"),
        ("--exposures=-3,-1,1", "seconds: EV −3 is 0.125; --evs takes EV"),
        ("--evs=-3,-3", "--evs -3,-3: must rise"),
        ("--evs=3,1", "must rise"),
        ("--evs=", "--evs: at least one is needed"),
        ("--evs=1,40", "--evs (EV 0 is one second): 40 is not within -19 … 19"),
        ("--evs=1,dark", "--evs '1,dark': 'dark' is not a number"),
        ("--exposures 1,two", "'two' is not a number"),
        ("--exposures nan,1", "'nan' is not a number"),
        ("--exposures ,", "at least one"),
        ("--ambient-levels 1,2", "leave it out"),
        ("--ambient-levels 1/0", "'1/0' is not a number"),
        ("--train-ambient-levels=-1,2", "--train-ambient-levels: -1 is not within"),
        ("--lit-levels 2,2", "each level once"),
        ("--resolution 0", "--resolution: 0 is not within"),
        ("--resolution 20x20x3", "write 200 or 320x240"),
        ("--samples 0", "--samples: 0 is not within"),
        ("--views 1", "--views: 1 is not within"),
        ("--seed=-1", "--seed"),
        ("--views 6 --relit-views 4", "--relit-views: 4 is not within"),
        ("--noise-threshold 2", "--noise-threshold: 2 is not within"),
        ("--lit-lights ,", "--lit-views: needs at least one of --lit-lights"),
        ("--lit-lights ambient,ambient", "each light once"),
        ("--scene ball --lit-lights moon", "unknown light of this scene 'moon': choose one of ambient, lamp"),
        ("--scene ball --mixed-levels ambient=2,moon=1", "unknown light of this scene 'moon'"),
        ("--mixed-levels ambient", "write ambient=4,pendant=0.25"),
        ("--mixed-levels ambient=2,ambient=4", "named twice"),
        ("--mixed-levels ambient=-2", "--mixed-levels: ambient: -2 is not within"),
        ("--part 2", "--part '2': write 2/8 for the second of eight parts"),
        ("--part 3/2", "--part: of 2 parts: 3 is not within 1 … 2"),
        ("--part 0/2", "--part: of 2 parts: 0 is not within 1 … 2"),
        ("--part 1/0", "--part: the number of parts: 0 is not within"),
        ("--threads=-1", "--threads: -1 is not within"),
        ("--iso 1", "--iso: 1 is not within"),
    ],
)
def test_bad_options(tmp_path, capsys, arguments, message):
    out = tmp_path / "data"
    assert main(["--out", str(out), *arguments.split()]) == 1
    told = capsys.readouterr().err
    assert message in told and told.startswith("error: ") and told.count("\n") == 1
    assert not out.exists()


def test_usage_errors_exit_with_2(capsys):
    both = ["--out", "x", "--exposures", "1", "--evs", "0"]
    for arguments in ([], ["--out", "x", "--samples", "many"], ["--out", "x", "--colour"], both):
        with pytest.raises(SystemExit) as error:
            main(arguments)
        assert error.value.code == 2
    assert "usage:" in capsys.readouterr().err


def test_a_broken_dataset_json_is_named(tmp_path, capsys):
    (tmp_path / "dataset.json").write_text("{")
    assert main(["--out", str(tmp_path)]) == 1
    assert "dataset.json' is damaged" in capsys.readouterr().err
    assert (tmp_path / "dataset.json").read_text() == "{"


@pytest.mark.long
def test_a_full_disk_in_the_middle(tmp_path):
    """No file may grow beyond 20 kB, which the passes do: a clear error, and no half file under its name."""
    out = tmp_path / "d"
    room = user_scene.saved(tmp_path / "room.blend")
    command = f"ulimit -f 20; exec {sys.executable} {ROOT / 'synth/make_scene.py'} -- --out {out}"
    command += f" --from-file {room}"
    command += " --resolution 64 --samples 1 --views 2 --lit-views 0 --no-denoise"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "is the disk full?" in done.stderr, done.stderr
    assert not list(out.rglob("*.exr")) and not (out / "dataset.json").exists()
    done = subprocess.run(["bash", "-c", command.partition("; ")[2]], capture_output=True, text=True)
    assert done.returncode == 0 and (out / "dataset.json").exists(), done.stderr


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, ": make room, and give the same command again"),
        (errno.EDQUOT, ": make room, and give the same command again"),
        (errno.EACCES, ""),
        (errno.ENAMETOOLONG, ""),
    ],
)
def test_only_a_full_disk_asks_for_room(tmp_path, monkeypatch, capsys, code, remedy):
    def refuse(*_):
        raise OSError(code, os.strerror(code), "bark.png")

    monkeypatch.setattr("physhdr.synth.several.make_all", refuse)
    assert main(["--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"error: {os.strerror(code)}: 'bark.png'{remedy}\n"


@pytest.mark.long
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


def test_numbers_sizes_and_names():
    assert parse_evs("-3 -1,1") == (0.125, 0.5, 2.0) and evs((0.125, 0.5, 2.0)) == [-3.0, -1.0, 1.0]
    assert parse_mixtures("ambient=4,pendant=1/4; ambient=2") == (
        (("ambient", 4.0), ("pendant", 0.25)),
        (("ambient", 2.0),),
    )
    assert parse_scenes("bathroom, desk") == ("bathroom", "desk") and "sponza" in parse_scenes("all")
    with pytest.raises(OptionError, match="too many"):
        Options(exposures=tuple(range(1, 100))).check()
    assert parse_numbers("--x", "1/4,0.5 2") == (0.25, 0.5, 2.0)
    assert parse_resolution("320x240") == (320, 240) and parse_resolution("64") == (64, 64)
