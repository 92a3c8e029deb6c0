#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Validate and build the Blender extension with Blender's own tool: dist/physhdr-VERSION.zip, and beside
it dist/index.json, which makes that folder a repository of extensions on any static server
(docs/contributing/distribution.md).

The wheels that the zip bundles are those of tools/wheels.txt, by their SHA-256: in wheels/, whether they were
there or have been fetched, and again in the zip. What differs is named, and no zip is left.
"""

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: Whose pip fetches wheels: where make never ran, as on Windows, this very Python's.
IN_ENVIRONMENT = ROOT / ".venvs" / "backend" / "bin" / "python"
PYTHON = IN_ENVIRONMENT if IN_ENVIRONMENT.exists() else Path(sys.executable)
SITE_PACKAGES = ROOT / ".venvs" / "blender" / "lib"
#: What Blender asks for of a repository of extensions: what it holds, with sizes and hashes.
INDEX_FILE = "index.json"


def extension_tool() -> list[str] | None:
    """The command of Blender's extension tool: inside the bpy wheel, or the blender on PATH."""
    pattern = "python3.*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    for script in SITE_PACKAGES.glob(pattern):
        return [str(ROOT / ".venvs" / "blender" / "bin" / "python"), str(script)]
    blender = shutil.which("blender")
    return [blender, "--command", "extension"] if blender else None


class BuildError(Exception):
    """What must not be shipped or cannot be built: a message, and what to do."""

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(message)
        self.message, self.remedy = message, remedy


def pinned_wheels(root: Path) -> dict[str, str]:
    """File name → SHA-256 of what is bundled; raises ``BuildError`` where manifest and pins name others."""
    manifest = tomllib.loads((root / "blender_manifest.toml").read_text(encoding="utf-8"))
    named = {Path(name).name for name in manifest["wheels"]}
    text = (root / "tools" / "wheels.txt").read_text(encoding="utf-8")
    pins = dict(re.findall(r"^(\S+==\S+) --hash=sha256:([0-9a-f]{64})$", text, re.MULTILINE))
    wheels = {name: pins.get("==".join(name.split("-")[:2])) for name in named}
    unpinned = sorted(name for name, digest in wheels.items() if digest is None)
    if unpinned or len(pins) != len(named):
        what = f"tools/wheels.txt does not pin {', '.join(unpinned)}" if unpinned else "they differ in number"
        raise BuildError(
            f"blender_manifest.toml and tools/wheels.txt name different wheels: {what}",
            "Let both name the same versions; the hash of a file is listed with it on PyPI.",
        )
    return {name: digest for name, digest in wheels.items() if digest}


def check_wheels(root: Path, pinned: dict[str, str]) -> list[str]:
    """Which of the pinned wheels are not in wheels/ yet; raises ``BuildError`` at a file that is another."""
    for path in sorted(each for each in (root / "wheels").rglob("*") if each.is_file()):
        wanted, found = pinned.get(path.name), hashlib.sha256(path.read_bytes()).hexdigest()
        if found != wanted:
            what = f"its SHA-256 is {found}, {wanted} is pinned" if wanted else "nothing there names it"
            raise BuildError(
                f"{path} is not a file that tools/wheels.txt pins: {what}",
                f"Delete it (rm '{path}'): what is pinned is fetched anew.",
            )
    return sorted(name for name in pinned if not (root / "wheels" / name).exists())


def check_zip(path: Path, pinned: dict[str, str]) -> None:
    """The zip bundles exactly the pinned wheels; raises ``BuildError``."""
    with zipfile.ZipFile(path) as archive:
        inside = [name for name in archive.namelist() if name.endswith(".whl") or name.startswith("wheels/")]
        found = {Path(name).name: hashlib.sha256(archive.read(name)).hexdigest() for name in inside}
    if found != pinned or len(inside) != len(pinned):
        differing = sorted(name for name in {*found, *pinned} if found.get(name) != pinned.get(name))
        raise BuildError(
            f"the zip does not bundle what tools/wheels.txt pins: {', '.join(differing or inside)}",
            "Something changed wheels/ while it was built, or the manifest leaves a wheel out: build again.",
        )


def fetch_wheels(root: Path) -> None:
    """The pinned wheels into wheels/; raises ``BuildError``."""
    # Any platform, no ABI: a wheel with compiled code is not found rather than bundled.
    only_pure = ["--only-binary=:all:", "--platform", "any", "--implementation", "py", "--abi", "none"]
    command = [PYTHON, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += [*only_pure, "--python-version", "3.13", "--require-hashes"]
    command += ["-r", root / "tools" / "wheels.txt", "-d", root / "wheels"]
    if subprocess.call([str(part) for part in command]):
        raise BuildError("the wheels could not be fetched", "See pip's lines above; check the network.")


def write_index(tool: list[str], folder: Path) -> int:
    """Write ``INDEX_FILE`` of the zips in ``folder``; the status of Blender's tool.

    The zips are named relative to the index (``./physhdr-0.1.0.zip``): the folder may lie anywhere.
    """
    return subprocess.call([*tool, "server-generate", "--repo-dir", str(folder)])


def build(root: Path, dist: Path) -> int:
    """Build zip and index into ``dist``; returns the status of Blender's tool, raises ``BuildError``."""
    pinned = pinned_wheels(root)
    if check_wheels(root, pinned):
        fetch_wheels(root)
        if missing := check_wheels(root, pinned):
            raise BuildError(f"pip did not bring {', '.join(missing)}", "Look at tools/wheels.txt.")
    tool = extension_tool()
    if tool is None:
        raise BuildError(
            "Blender's extension tool was not found", "Run make setup first, or put blender's folder on PATH."
        )
    dist.mkdir(parents=True, exist_ok=True)
    # Beside its place, and moved there when it has been looked at.
    with tempfile.TemporaryDirectory(dir=dist) as made:
        for command in (["validate", "."], ["build", "--source-dir", ".", "--output-dir", made]):
            if status := subprocess.call([*tool, *command], cwd=root):
                return status
        zips = list(Path(made).glob("*.zip"))
        for path in zips:
            check_zip(path, pinned)
        # Of this version alone: an older zip may stay beside it for those who want it.
        if status := write_index(tool, Path(made)):
            return status
        # The index last: what it names is there.
        for path in (*zips, Path(made) / INDEX_FILE):
            path.replace(dist / path.name)
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "dist", metavar="DIR", help="where to write both; default: dist/"
    )
    try:
        return build(ROOT, parser.parse_args().out.absolute())
    except BuildError as error:
        print(f"error: {error.message}\n  {error.remedy}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
