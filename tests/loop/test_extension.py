# SPDX-License-Identifier: GPL-3.0-or-later
"""The real zip in Blender, with a real backend process: training, pause, kill −9, resume, import, relit."""

import hashlib
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from physhdr.backend.evaluate.metrics import hdr_pair, psnr
from physhdr.backend.runs.run import open_run
from physhdr.backend.scene.pictures import read_exr

#: It installs a trainer and trains several times.
pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parent.parent.parent
#: The zip without the wheels that it bundles: ours, compressed. A file that gets in by mistake is larger.
CODE_BYTES = 1_600_000
#: Enough for the pause, the stop and the kill to fall into the middle.
ITERATIONS = 400


@pytest.fixture(scope="module")
def extension():
    """The zip, as ``make extension`` builds it."""
    subprocess.run([sys.executable, ROOT / "tools" / "build_extension.py"], check=True, capture_output=True)
    return max((ROOT / "dist").glob("physhdr-*.zip"), key=lambda path: path.stat().st_mtime)


@pytest.fixture(scope="module")
def used(extension, data, in_blender, tmp_path_factory):
    """The folder with what ``use_extension.py`` saw and made."""
    out = tmp_path_factory.mktemp("extension")
    # The Python behind this environment: the extension makes an environment of its own with it.
    base = Path(sys.base_prefix) / "bin" / f"python3.{sys.version_info.minor}"
    arguments = ["--zip", extension, "--python", base, "--data", data, "--out", out]
    size = json.loads((data / "dataset.json").read_text())["resolution"][0]
    arguments += ["--iterations", ITERATIONS, "--size", size]
    in_blender(
        "tests/loop/use_extension.py", *arguments, BLENDER_USER_RESOURCES=str(out / "blender"), HOME=str(out)
    )
    return out


@pytest.fixture(scope="module")
def seen(used):
    return json.loads((used / "seen.json").read_text())


def installed(used):
    """The extension's folder."""
    return next((used / "blender" / "extensions").rglob("blender_manifest.toml")).parent


def test_the_zip_is_small_and_has_no_compiled_code(extension):
    with zipfile.ZipFile(extension) as archive:
        names = archive.namelist()
        wheels = sum(info.file_size for info in archive.infolist() if info.filename.endswith(".whl"))
    assert extension.stat().st_size - wheels < CODE_BYTES
    assert not [name for name in names if name.endswith((".so", ".pyd", ".dll", ".dylib"))]
    assert all(name.endswith("py3-none-any.whl") for name in names if name.endswith(".whl"))


def test_the_zip_bundles_the_wheels_that_are_pinned_and_the_locks_of_the_trainer(extension):
    pins = (ROOT / "tools" / "wheels.txt").read_text()
    with zipfile.ZipFile(extension) as archive:
        names = archive.namelist()
        digests = [hashlib.sha256(archive.read(n)).hexdigest() for n in names if n.endswith(".whl")]
    assert sorted(digests) == sorted(re.findall(r"--hash=sha256:(\S+)", pins))
    locks = {"backend.txt", "torch.txt", "torch-cuda.txt", "warp.txt"}
    locks |= {"torch-cuda12.txt", "warp12.txt"}  # instead, where a driver or a card is too old for CUDA 13
    assert {Path(name).name for name in names if name.startswith("locks/")} == locks


def test_it_never_imports_torch(seen):
    assert not seen["torch"]


def test_it_registers_and_unregisters_again_and_again(seen):
    assert not seen["off"] and seen["on"]


def test_a_python_without_torch_is_refused_with_the_reason(seen):
    assert "torch" in seen["wrong_python"]
    assert not seen["start_without_backend"]


def test_the_trainer_is_installed_into_an_environment_of_its_own(seen, used):
    assert not seen["install_offline"]  # Blender's own setting is respected
    assert Path(seen["python"]).is_relative_to(used / "blender")
    assert seen["report"]["versions"]["torch"] and seen["report"]["device"]
    assert not list(installed(used).rglob("__pycache__/*.nb*"))  # nothing is written beside the code


def test_missing_data_are_named(seen):
    assert "/no/such/folder" in seen["missing_data"]


def test_the_data_set_is_summarised(seen):
    assert "6 training views, 6 test" in seen["dataset"][0]


def test_a_pause_halts_and_stop_saves(seen):
    assert seen["went_on_while_paused"] <= 1  # the iteration that was under way
    assert seen["poll_while_paused"] == [False, True, False]
    assert seen["stopped"][0] == "stopped" and 40 <= seen["stopped"][1] < ITERATIONS


def test_a_killed_backend_is_noticed_within_five_seconds_and_told(seen):
    assert seen["noticed_after"] < 5.0
    state, message, hint, log = seen["killed"]
    assert state == "failed" and "gone" in message and "checkpoint" in hint and log.endswith("backend.log")


def test_a_hanging_backend_is_noticed_within_five_seconds_and_can_be_ended(seen):
    assert seen["hang_noticed_after"] < 5.0
    assert not seen["hung_is_alive"]


def test_a_new_blender_finds_the_training_again(seen):
    assert seen["found_again"][1] and seen["found_again"][0] in ("training", "finished")


def test_what_was_paused_stopped_killed_and_resumed_is_the_training_itself(seen, used, data):
    """Bit for bit what the command line trains without any of that, in the same environment."""
    assert seen["finished"][:2] == ["finished", ITERATIONS]
    straight = used / "straight"
    launcher = installed(used) / "backend" / "launch.py"
    command = [seen["python"], launcher, "train", data, "--out", straight]
    # The kernels that the extension has compiled.
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(seen["log"]).parent / "cache")}
    command += ["--iterations", str(ITERATIONS)]
    subprocess.run(command, check=True, capture_output=True, env=environment)
    ours = load_file(used / "run" / "checkpoint.safetensors")
    theirs = load_file(straight / "checkpoint.safetensors")
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)
    assert seen["history"] > 2


def test_the_imported_result_relights_as_the_trainer_does(seen, used):
    opened = open_run(used / "run")
    assert seen["imported"] == len(opened.method.gaussians)
    picture = torch.from_numpy(np.ascontiguousarray(read_exr(used / "relit.exr"))).permute(2, 0, 1)
    pair = hdr_pair(picture, opened.method.hdr(opened.scene.test[0].camera, 4.0))
    assert psnr(pair.prediction, pair.truth) > 40


def test_the_backend_ends_when_it_is_told_to(seen):
    assert seen["after_shutdown"] and Path(seen["log"]).is_file()
