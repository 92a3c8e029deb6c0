# SPDX-License-Identifier: GPL-3.0-or-later
"""The repository's own zip, installed in place of a release: Blender says which file to install."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import physhdr  # noqa: E402

ROOT = Path(physhdr.__file__).parent
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
BUNDLED = [Path(wheel).name.split("-")[0] for wheel in MANIFEST["wheels"]]
#: Installs a zip as people do, in a Blender of its own, which has none of the bundled packages.
INSTALL = """
import sys
import bpy

class WithoutBundled:
    def __init__(self, finder):
        self._finder = finder

    def find_spec(self, name, path=None, target=None):
        is_bundled = name.partition(".")[0] in {bundled}
        return None if is_bundled else self._finder.find_spec(name, path, target)

def enable(install, **options):
    try:
        print("ENDED", install(**options))
    except RuntimeError as error:
        print("SHOWN", " ".join(str(error).split()))

bpy.ops.preferences.addon_enable(module="bl_pkg")
sys.meta_path[:] = [WithoutBundled(finder) for finder in sys.meta_path]
"""
WAYS = {
    "extension": "enable(bpy.ops.extensions.package_install_files, filepath={zip!r}, repo='user_default', "
    "enable_on_install=True)",
    "legacy": "bpy.ops.preferences.addon_install(filepath={zip!r})\n"
    "enable(bpy.ops.preferences.addon_enable, module='physhdr-main')",
}


@pytest.fixture(scope="module")
def source_zip(tmp_path_factory) -> Path:
    """As GitHub makes it: one folder, no wheels; of it what Blender reads."""
    folder = tmp_path_factory.mktemp("zip")
    inside = folder / "physhdr-main"
    inside.mkdir()
    for name in ("__init__.py", "blender_manifest.toml"):
        shutil.copy(ROOT / name, inside)
    for room in ("addon", "bridge", "synth"):
        shutil.copytree(ROOT / room, inside / room, ignore=shutil.ignore_patterns("__pycache__"))
    return Path(shutil.make_archive(str(folder / "physhdr-main"), "zip", folder, "physhdr-main"))


@pytest.mark.parametrize("way", WAYS)
def test_blender_names_the_release(way, source_zip, tmp_path):
    script = tmp_path / "install.py"
    script.write_text(INSTALL.format(bundled=BUNDLED) + WAYS[way].format(zip=str(source_zip)))
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    command = [sys.executable, str(script)]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    said = ended.stdout + ended.stderr
    shown = next((line for line in ended.stdout.splitlines() if line.startswith("SHOWN")), said)
    assert "source code" in shown, said
    assert f"physhdr-{MANIFEST['version']}.zip from the project's releases page" in shown
    assert "ModuleNotFoundError" not in said
