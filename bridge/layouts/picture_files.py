# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a data set's pictures are and what their names say; none is opened."""

import os
import re
from pathlib import Path

#: What the names of pictures end with, in lower case.
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr")
#: The folder of a COLMAP model's pictures.
PICTURES = "images"
#: Beside it: ``masks/NAME.jpg.png`` of ``images/NAME.jpg``; black is not compared.
MASKS = "masks"


def pictures_in(folder: Path) -> list[str]:
    """Names of the pictures in a folder and its subfolders, with forward slashes, sorted.

    Names that begin with a dot are ignored: macOS leaves ``._a.jpg`` beside ``a.jpg`` on foreign disks.
    """
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return sorted(path.as_posix() for path in found if not any(part.startswith(".") for part in path.parts))


def picture_there(path: Path) -> Path:
    """``path``, or, where it does not exist, the file that differs in ``.JPG`` for ``.jpg`` alone."""
    if os.path.isfile(path):  # Path.is_file raises where a name is too long
        return path
    suffix = path.suffix.upper() if path.suffix == path.suffix.lower() else path.suffix.lower()
    other = path.with_name(path.name.removesuffix(path.suffix) + suffix)
    return other if os.path.isfile(other) else path


def reduced_folder(folder: Path) -> tuple[Path, int] | None:
    """``images_4``, and its 4, where ``images`` is missing: the least reduced; None where there is none.

    Published captures often keep only the small pictures: 3DGS, nerfstudio and Mip-NeRF 360 name their
    folders by the reduction.
    """
    if os.path.isdir(folder) or not os.path.isdir(folder.parent):
        return None
    named = (
        (re.fullmatch(rf"{re.escape(folder.name)}_(\d+)", path.name), path)
        for path in folder.parent.iterdir()
    )
    found = sorted((int(parts.group(1)), path) for parts, path in named if parts and path.is_dir())
    return (found[0][1], found[0][0]) if found and found[0][0] > 0 else None


def folder_there(folder: Path) -> Path | None:
    """A folder of pictures, or that of reduced ones in its place; None where there is neither."""
    if folder.is_dir():
        return folder
    reduced = reduced_folder(folder)
    return reduced[0] if reduced else None


def mask_beside(root: Path, name: str) -> Path | None:
    """The mask of the picture ``images/name``, where ``masks/`` has one: ``name.png``, or by its stem."""
    path = root / MASKS / name
    candidates = (path.with_name(f"{path.name}.png"), path.with_suffix(".png"))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


# ---- names ---------------------------------------------------------------------------------------------


def without_suffix(name: str) -> str:
    """``train/r_0.png`` → ``train/r_0``."""
    return name.rsplit(".", 1)[0] if Path(name).suffix else name


def split_named(name: str) -> str | None:
    """``train`` or ``test``, where a name has one of them as a word (``train_r_0``; ``latest`` has none)."""
    words = {word for word in re.split(r"[^a-z]+", name.lower()) if word in ("train", "test")}
    return words.pop() if len(words) == 1 else None


def bracket_name(name: str) -> tuple[str, int, str] | None:
    """``train_r_0_2.png`` → ``("train_r_0", 2, "png")``: pose, place in the bracket; None for other names.

    One digit without a leading zero is a place; ``frame_00012`` is a pose's number.
    """
    parts = re.fullmatch(r"(.+)_(\d)\.([^./]+)", name)
    return (parts.group(1), int(parts.group(2)), parts.group(3)) if parts else None


def pose_number(name: str) -> int | None:
    """The number at the end of a name (``train_r_12`` → 12); None where there is none."""
    digits = re.search(r"(\d+)$", name)
    return int(digits.group()) if digits else None
