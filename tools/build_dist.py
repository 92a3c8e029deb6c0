#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build what pip installs: dist/physhdr-VERSION.tar.gz and the wheel made from it. Needs no network.

    .venvs/backend/bin/python tools/build_dist.py [--out FOLDER]

Both are made of a copy of the files that git knows, as they are now: nothing that was built earlier, and no
file of the user's, can slip in. The source distribution holds all of them, the wheel the four rooms.
"""

import argparse
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("addon", "backend", "bridge", "lab", "synth")
#: In the wheel beside the rooms: what they read when they run.
READ = {
    "py.typed",
    "pyproject.toml",
    "blender_manifest.toml",
    "locks/backend.txt",
    "locks/torch.txt",
    "locks/torch-cuda.txt",
    "locks/torch-cuda12.txt",
    "locks/warp.txt",
    "locks/warp12.txt",
}
#: The hooks that any builder calls (PEP 517), without the environment that it would fetch for them.
HOOK = "import sys; from setuptools import build_meta; build_meta.build_{}(sys.argv[1])"


class BuildError(Exception):
    """What was not built, and why."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="the folder for both files")
    out = parser.parse_args().out
    try:
        for path in build(ROOT, out.resolve()):
            print(f"built {path} ({path.stat().st_size / 1e6:.1f} MB)")
    except BuildError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def build(root: Path, out: Path) -> tuple[Path, Path]:
    """The source distribution and the wheel of the checkout ``root``, in ``out``; raises ``BuildError``."""
    names = tracked(root)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        copy, made, unpacked = (Path(folder) / name for name in ("copy", "made", "unpacked"))
        made.mkdir()
        for name in names:
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, copy / name)
        call("sdist", copy, made)
        [source] = made.glob("*.tar.gz")
        with tarfile.open(source) as archive:
            inside = {name.partition("/")[2] for name in archive.getnames()}
            archive.extractall(unpacked, filter="data")
        require(names, inside, "the source distribution", "MANIFEST.in")
        [tree] = unpacked.iterdir()
        call("wheel", tree, made)
        [wheel] = made.glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            inside = {name.partition("/")[2] for name in archive.namelist() if name.startswith("physhdr/")}
        require(in_wheel(names), inside, "the wheel", "pyproject.toml, [tool.setuptools]")
        if more := sorted(inside - in_wheel(names)):
            raise BuildError(f"the wheel holds what no room reads: {', '.join(more[:5])}")
        return (Path(shutil.move(source, out / source.name)), Path(shutil.move(wheel, out / wheel.name)))


def tracked(root: Path) -> set[str]:
    """The files that git knows in ``root`` and that are there.

    Raises ``BuildError`` outside a checkout, and where there is no git.
    """
    command = ["git", "-C", root, "ls-files", "-z"]
    try:
        listed = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        what = f"git, which says what belongs to the project, cannot be run: {error.strerror or error}"
        raise BuildError(f"{what}\n  Install it (Debian: apt install git).") from error
    if listed.returncode:
        raise BuildError(f"git lists no files in {root}: {listed.stderr.strip()}")
    return {name for name in listed.stdout.split("\0") if name and (root / name).is_file()}


def in_wheel(names: set[str]) -> set[str]:
    """Which of ``names`` the wheel must hold, and nothing beside them."""
    in_rooms = {name for name in names if name.partition("/")[0] in ROOMS}
    # Of the lab its packages alone: programs, plans, tables and kept truth are for checkouts.
    code = {name for name in in_rooms if not name.startswith("lab/") or name.endswith(".py")}
    code = {name for name in code if not name.startswith("lab/tools/")}
    return code | {"__init__.py"} | READ


def call(kind: str, folder: Path, out: Path) -> None:
    command = [sys.executable, "-c", HOOK.format(kind), str(out)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise BuildError(f"setuptools could not build the {kind}:\n{(done.stderr or done.stdout).strip()}")


def require(wanted: set[str], found: set[str], where: str, remedy: str) -> None:
    if missing := sorted(wanted - found):
        names = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise BuildError(f"{where} lacks {names}\n  Name them in {remedy}.")


if __name__ == "__main__":
    sys.exit(main())
