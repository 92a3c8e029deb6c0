# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user does with a repository of ours, as a script: run inside Blender by test_repository.py.

It is added by its address, the extension is installed from it; then the server has a newer one, and Blender
is asked what can be updated, and updates. What was seen goes to OUT for the test to judge.
"""

import argparse
import importlib
import json
import shutil
import sys
from pathlib import Path

import bpy


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--url", required=True)
    for name in ("served", "newer", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])
    seen: dict = {}

    preferences = bpy.context.preferences
    preferences.system.use_online_access = True
    repositories = preferences.extensions.repos
    for other in list(repositories):  # extensions.blender.org is not to be had here
        other.enabled = other.module == "user_default"
    bpy.ops.preferences.extension_repo_add(name="ours", remote_url=options.url, type="REMOTE")
    [ours] = [each for each in repositories if each.remote_url == options.url]

    before = list(sys.path)
    bpy.ops.extensions.repo_sync(repo_directory=ours.directory)
    seen["listed"] = listed(ours.directory)
    bpy.ops.extensions.package_install(
        repo_directory=ours.directory, pkg_id="physhdr", enable_on_install=True
    )
    seen["installed"] = version(ours.directory)
    seen["outdated"] = outdated(ours.directory)
    seen["operators"] = sorted(dir(bpy.ops.physhdr))
    seen["module"] = sys.modules["bl_ext.ours.physhdr"].__name__
    seen["new_paths"] = [path for path in sys.path if path not in before]
    seen["site_packages"] = site_packages()

    for path in sorted(options.newer.iterdir()):
        shutil.copy(path, options.served)
    bpy.ops.extensions.repo_sync(repo_directory=ours.directory)
    seen["outdated_later"] = outdated(ours.directory)
    bpy.ops.extensions.package_upgrade_all()
    seen["updated"] = version(ours.directory)
    seen["outdated_after"] = outdated(ours.directory)
    seen["enabled"] = "bl_ext.ours.physhdr" in preferences.addons and hasattr(bpy.types.Scene, "physhdr")
    options.out.write_text(json.dumps(seen))


def store():
    """Blender's own extension of extensions, and what it knows of repositories."""
    package = importlib.import_module("bl_pkg")
    return package, package.repo_cache_store_ensure()


def outdated(directory: str) -> int:
    """How many updates Blender's status bar would announce."""
    package, known = store()
    return package.repo_stats_calc_outdated_for_repo_directory(known, directory)


def listed(directory: str) -> dict[str, str]:
    """What the repository offers: versions by id."""
    known = store()[1].refresh_remote_from_directory(directory=directory, error_fn=print, force=True)
    return {name: item.version for name, item in known.items()}


def version(directory: str) -> str:
    """Of the extension that is installed."""
    known = store()[1].refresh_local_from_directory(directory=directory, error_fn=print)
    return known["physhdr"].version


def site_packages() -> str:
    """Where Blender unpacks the wheels that extensions bundle."""
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    return str(Path(bpy.utils.user_resource("EXTENSIONS")) / ".local" / "lib" / python / "site-packages")


main()
