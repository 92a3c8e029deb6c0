#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Validate and build the Blender extension with Blender's own tool: dist/physhdr-VERSION.zip."""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SITE_PACKAGES = ROOT / ".venvs" / "blender" / "lib"


def extension_tool() -> list[str] | None:
    """The command of Blender's extension tool: inside the bpy wheel, or the blender on PATH."""
    pattern = "python3.*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    for script in SITE_PACKAGES.glob(pattern):
        return [str(ROOT / ".venvs" / "blender" / "bin" / "python"), str(script)]
    blender = shutil.which("blender")
    return [blender, "--command", "extension"] if blender else None


def main() -> int:
    tool = extension_tool()
    if tool is None:
        print("error: Blender's extension tool was not found\n  Run make setup first.", file=sys.stderr)
        return 1
    dist = ROOT / "dist"
    dist.mkdir(exist_ok=True)
    for command in (["validate", "."], ["build", "--source-dir", ".", "--output-dir", str(dist)]):
        status = subprocess.call([*tool, *command], cwd=ROOT)
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
