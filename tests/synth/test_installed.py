# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip that users install: the open scene is rendered from it, and it leaves the built-in scenes out."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")

ROOT = Path(__file__).parents[2]
NAME = "bl_ext.user_default.physhdr"
#: What is not of the extension, and is large: the manifest's own list is what the zip is held to.
BULK = (".*", "__pycache__", "data", "dist", "runs", "wheels")

#: What *Render from This Scene* does, in a Blender where the extension is installed and switched on.
RENDER_THE_OPEN_SCENE = f"""
import sys
import bpy
import addon_utils
assert addon_utils.enable("{NAME}")
bpy.ops.object.light_add(type="SUN", location=(0, 0, 3))
poses = dict(views=2, lit_views=0, relit_views=0)
pictures = dict(exposures="0", resolution_x=16, resolution_y=16, samples=1, denoise=False)
print(bpy.ops.physhdr.dataset_render(out=sys.argv[1], **poses, **pictures))
addon_utils.disable("{NAME}")
"""


def built_zip(folder: Path) -> Path:
    """The extension's zip as Blender's own tool makes it of this tree, but for the bundled wheels."""
    path = ROOT / "tools" / "build_extension.py"
    spec = importlib.util.spec_from_file_location("build_extension", path)
    assert spec and spec.loader
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*BULK))
    # Wheels are fetched by the build; this environment has what they bring.
    manifest = source / "blender_manifest.toml"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(re.sub(r"^wheels = \[.*?\]$", "", text, flags=re.M | re.S), encoding="utf-8")
    command = [*tool.extension_tool(), "build", "--source-dir", source, "--output-dir", folder]
    subprocess.run(command, check=True, capture_output=True)
    [made] = folder.glob("*.zip")
    return made


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder of extensions with ours in it, as Blender unpacks it."""
    folder = tmp_path_factory.mktemp("installed")
    extension = folder / "extensions" / "user_default" / "physhdr"
    with zipfile.ZipFile(built_zip(folder)) as archive:
        archive.extractall(extension)
    return extension


@pytest.mark.long
def test_no_built_in_scene_is_installed_and_one_that_is_asked_for_is_refused(installed, tmp_path):
    assert (installed / "synth" / "stage.py").is_file() and not (installed / "synth" / "scenes").exists()
    command = [sys.executable, installed / "synth" / "make_scene.py", "--", "--out", tmp_path / "data"]
    done = subprocess.run([*command, "--scene", "desk"], capture_output=True, text=True)
    assert done.returncode == 1 and not (tmp_path / "data").exists()
    told = "error: --scene desk: the built-in scenes come with the project's repository"
    assert done.stderr.startswith(told) and "--from-file" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.long
def test_the_open_scene_is_rendered_from_the_installed_zip(installed, tmp_path):
    out = tmp_path / "data"
    environment = {
        **os.environ,
        "BLENDER_USER_EXTENSIONS": str(installed.parents[1]),
        "BLENDER_USER_RESOURCES": str(tmp_path / "user"),
    }
    command = [sys.executable, "-c", RENDER_THE_OPEN_SCENE, out]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0 and "{'FINISHED'}" in done.stdout, done.stdout + done.stderr
    told = json.loads((out / "dataset.json").read_text())
    assert told["resolution"] == [16, 16] and told["splits"] == {"train": 1, "test": 1, "lit": 0}
    assert told["source"]["camera"] == "Camera"  # of Blender's own first scene, which is open
    picture = bpy.data.images.load(str(out / "test_hdr" / "hdr_000.exr"))
    assert np.ptp(np.array(picture.pixels[:]).reshape(16, 16, 4)[..., :3]) > 0.01
    bpy.data.images.remove(picture)
