#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Validate and build the Blender extension with Blender's own tool: dist/physhdr-VERSION.zip."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WHEELS = ROOT / "wheels"
PINNED = ROOT / "tools" / "wheels.txt"
PYTHON = ROOT / ".venvs" / "backend" / "bin" / "python"
SITE_PACKAGES = ROOT / ".venvs" / "blender" / "lib"


def extension_tool() -> list[str] | None:
    """The command of Blender's extension tool: inside the bpy wheel, or the blender on PATH."""
    pattern = "python3.*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    for script in SITE_PACKAGES.glob(pattern):
        return [str(ROOT / ".venvs" / "blender" / "bin" / "python"), str(script)]
    blender = shutil.which("blender")
    return [blender, "--command", "extension"] if blender else None


def fetch_wheels() -> int:
    """The wheels that the manifest bundles, as pinned, unless they are there."""
    with open(ROOT / "blender_manifest.toml", "rb") as file:
        wanted = {Path(name).name for name in tomllib.load(file)["wheels"]}
    if wanted <= {path.name for path in WHEELS.glob("*.whl")}:
        return 0
    # Any platform, no ABI: a wheel with compiled code is not found rather than bundled.
    only_pure = ["--only-binary=:all:", "--platform", "any", "--implementation", "py", "--abi", "none"]
    command = [PYTHON, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += [*only_pure, "--python-version", "3.13", "--require-hashes", "-r", PINNED, "-d", WHEELS]
    return subprocess.call([str(part) for part in command])


def main() -> int:
    tool = extension_tool()
    if tool is None:
        print("error: Blender's extension tool was not found\n  Run make setup first.", file=sys.stderr)
        return 1
    if status := fetch_wheels():
        print("error: the wheels could not be fetched\n  Check the network, try again.", file=sys.stderr)
        return status
    dist = ROOT / "dist"
    dist.mkdir(exist_ok=True)
    for command in (["validate", "."], ["build", "--source-dir", ".", "--output-dir", str(dist)]):
        status = subprocess.call([*tool, *command], cwd=ROOT)
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
