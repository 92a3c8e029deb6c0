# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things are: the extension's own code, and the folder for what it writes (never beside its code)."""

import os
from collections.abc import Callable
from pathlib import Path

import bpy

from ..bridge.errors import BadValueError

ROOT = Path(__file__).resolve().parent.parent
#: The package's full name: ``bl_ext.<repository>.physhdr`` where it is installed as an extension.
PACKAGE = __name__.removesuffix(".addon.paths")
LAUNCHER = ROOT / "backend" / "launch.py"


def user_folder() -> Path:
    """The extension's own folder, made if needed: Blender's for extensions, else beside its data files."""
    if PACKAGE.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(PACKAGE, create=True))
    return Path(bpy.utils.user_resource("DATAFILES", path="physhdr", create=True))


def backend_folder() -> Path:
    """Where the backend's environment, connection file, log and caches are unless the user says otherwise.

    In the extension's own folder; on Windows in one whose path is short and stays on this machine: torch has
    files whose paths are 170 characters longer, and Windows takes 259 in all.
    """
    local = os.environ.get("LOCALAPPDATA")
    if os.name == "nt" and local:
        return Path(local) / "physhdr" / "{}.{}".format(*bpy.app.version)
    return user_folder() / "backend"


def absolute(chosen: str) -> str:
    """A chosen path as a whole one; empty where none is chosen, or where it is nowhere."""
    return os.path.normpath(bpy.path.abspath(chosen)) if chosen and not is_nowhere(chosen) else ""


def whole(chosen: str) -> str:
    """A path that is to be read or written, from the root on; empty where none is chosen.

    Raises ``BadValueError`` where it is nowhere.
    """
    if is_nowhere(chosen):
        raise BadValueError(
            f"{chosen} is relative to a .blend that is not saved yet",
            "Save it first, or choose a whole path.",
        )
    return os.path.abspath(absolute(chosen)) if chosen.strip() else ""


def is_nowhere(chosen: str) -> bool:
    """Whether a path is relative to the .blend (``//…``), and that is not saved."""
    return chosen.startswith("//") and not bpy.data.filepath


def is_free(path: Path) -> bool:
    """Whether there is nothing, or an empty folder. Panels ask: where nobody may look it says no."""
    try:
        return not path.exists() or (path.is_dir() and not any(path.iterdir()))
    except OSError:
        return False


def first_free(path: Path, suffix: str = "", fits: Callable[[Path], bool] = is_free) -> Path:
    """The path, or the same with a number before its ``suffix``: the first that ``fits``.

    Where the system refuses the path, as one that is too long, no number helps: opening it says so.
    """
    candidate, number = path, 2
    while not fits(candidate) and not _is_refused(candidate):
        candidate = path.with_name(f"{path.name.removesuffix(suffix)}_{number}{suffix}")
        number += 1
    return candidate


def _is_refused(path: Path) -> bool:
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True
    return False


def version() -> str:
    """The extension's version, from its manifest."""
    import tomllib

    with open(ROOT / "blender_manifest.toml", "rb") as file:
        return str(tomllib.load(file)["version"])
