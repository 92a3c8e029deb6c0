# SPDX-License-Identifier: GPL-3.0-or-later
"""make_scene.py --from-file: bad input, progress for programs, Ctrl+C."""

import json
import subprocess
import sys

import bpy
import pytest

from physhdr.synth.make_scene import main
from physhdr.synth.options import CURRENT
from physhdr.tests.synth.open_scene.user_scene import ARGUMENTS, ROOT


class TestCommandLine:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ("--from-file no/such.blend", "there is no file 'no/such.blend'"),
            (
                "--from-file current --scene-name Nowhere",
                "the file has no scene 'Nowhere': choose one of Scene",
            ),
            ("--from-file current --rig-arc 0", "--rig-arc (degrees): 0 is not within"),
            ("--from-file current --rig-extent 3", "two numbers are needed"),
            ("--from-file current --rig-elevation 50,10", "the lower one first"),
            ("--from-file current --camera-rig spiral", "choose one of grid, hemisphere, orbit, path"),
            ("--from-file current --device TPU", "unknown device 'TPU': choose one of CPU, GPU"),
            ("--scene ball --camera-rig path", "unknown camera rig 'path'"),
            ("--scene ball --rig-distance 3", "--rig-distance is for --from-file"),
        ],
    )
    def test_bad_input(self, scene, tmp_path, capsys, arguments, message):
        assert main(["--out", str(tmp_path / "d"), *arguments.split()]) == 1
        told = capsys.readouterr().err
        assert message in told and told.startswith("error: ") and told.count("\n") == 1
        assert not (tmp_path / "d").exists()

    def test_damaged_files(self, tmp_path, capsys):
        bad = tmp_path / "bad.blend"
        for content in (b"", b"not a blend file", b"BLENDER17-01v0502" + b"\0" * 500):
            bad.write_bytes(content)
            assert main(["--from-file", str(bad), "--out", str(tmp_path / "d")]) == 1
            told = capsys.readouterr().err
            assert "Blender cannot open" in told and "bad.blend" in told
        assert not (tmp_path / "d").exists()

    def test_no_camera(self, scene, tmp_path, capsys):
        scene.camera = None
        assert main(["--from-file", CURRENT, "--out", str(tmp_path / "d")]) == 1
        assert "has no camera: add one and make it the active camera" in capsys.readouterr().err

    def test_progress_for_programs(self, scene, tmp_path):
        """Beside Blender's own lines: objects, fractions that rise from 0 to 1, and the result."""
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
        command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
        command += ["--out", tmp_path / "d", "--progress-json", *ARGUMENTS]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
        fractions = [line["progress"] for line in lines if "progress" in line]
        assert fractions[0] == 0.0 and fractions[-1] == 1.0 and fractions == sorted(fractions)
        assert lines[0]["message"] == "rendering train_000" and lines[1]["seconds_left"] >= 0.0
        result = lines[-1]["result"]
        assert result["folder"] == str(tmp_path / "d") and result["splits"] == {
            "train": 3,
            "test": 3,
            "lit": 2,
        }
        assert result["scene"] == "room"
        again = subprocess.run([*map(str, command), "--seed", "3"], capture_output=True, text=True)
        assert again.returncode == 1
        error = json.loads(again.stdout.splitlines()[-1])["error"]
        assert error["code"] == "conflict" and "seed is 0 there, 3 asked" in error["message"]
        assert "another folder" in error["hint"]

    @pytest.mark.long
    def test_ctrl_c_in_the_middle_of_a_frame(self, scene, tmp_path):
        """It ends with 130 after the frame, and the same command makes the rest."""
        import signal
        import time

        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
        command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
        command += ["--out", tmp_path / "d", "--progress-json", *ARGUMENTS]
        command += ["--resolution", "112", "--samples", "32"]
        command += ["--views", "4", "--lit-views", "0", "--relit-views", "0"]
        running = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for line in running.stdout:
            if "train_001" in line:
                break
        time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        told = running.communicate(timeout=120)
        assert running.returncode == 130 and "Traceback" not in told[1], told
        kept = {path.name: path.read_bytes() for path in (tmp_path / "d/passes").glob("*.exr")}
        assert kept and len(kept) < 4 and not (tmp_path / "d/dataset.json").exists()
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert all((tmp_path / "d/passes" / name).read_bytes() == data for name, data in kept.items())
        assert (tmp_path / "d/dataset.json").exists()
