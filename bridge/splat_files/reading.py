# SPDX-License-Identifier: GPL-3.0-or-later
"""Which format a file of Gaussians is, by its first bytes and then its suffix, and reading it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import BadValueError, FileDamagedError
from ..gaussian_ply import EXTRA_PREFIX, gaussians_in, is_compressed, open_gaussians
from ..regular import regular_file
from . import ksplat, spz
from .cloud import SplatCloud
from .compressed_ply import cloud_of_compressed
from .splat import read_splat
from .standard_ply import cloud_of_ply
from .usable import left_out_note, only_usable

#: Bytes that tell a format, and what a zip begins with.
_START, ZIP = 128, b"PK\3\4"
#: What a user does with a format that needs the backend.
CONVERT = "Convert it with the trainer's command line: physhdr export IN OUT.ply"


def _read_ply(path: Path) -> SplatCloud:
    opened = open_gaussians(path)
    if is_compressed(opened):
        return cloud_of_compressed(path, opened)
    ply = gaussians_in(path, opened)
    cloud = cloud_of_ply(ply)
    if any(name.startswith(EXTRA_PREFIX) for name in ply.columns):
        note = "It is a lossless PLY of PhysHDR: of it the look was read that is baked into it."
        return replace(cloud, notes=(*cloud.notes, note))
    return cloud


@dataclass(frozen=True)
class Format:
    """A format of files of Gaussians."""

    #: As the user knows it.
    name: str
    #: In lower case, with dots; the first is the one to write.
    suffixes: tuple[str, ...]
    #: Whether a file that begins with these bytes is one.
    begins: Callable[[bytes], bool]
    #: Reads it; ``None``: Python alone does not.
    read: Callable[[Path], SplatCloud] | None = None
    #: What to do with what is not read.
    remedy: str = CONVERT


def _never(_: bytes) -> bool:
    """Of formats without a mark: their suffix tells."""
    return False


#: Every format that is known, those with a mark first; ``.safetensors`` are PhysHDR's own models.
FORMATS = (
    Format("PLY", (".ply",), lambda start: start[:4] in (b"ply\n", b"ply\r"), _read_ply),
    Format("SPZ", (".spz",), lambda start: start.startswith((spz.MAGIC, spz.GZIP)), spz.read_spz),
    Format("SOG", (".sog", "meta.json"), lambda start: start.startswith(ZIP)),
    Format("glTF", (".glb", ".gltf"), lambda start: start.startswith(b"glTF")),
    Format(
        "USD",
        (".usdc", ".usda", ".usd", ".usdz"),
        lambda start: start.startswith((b"PXR-USDC", b"#usda", ZIP)),
    ),
    Format("KSPLAT", (".ksplat",), _never, ksplat.read_ksplat),
    Format("splat", (".splat",), _never, read_splat),
    Format(
        "LCC",
        (".lcc", ".lcc2"),
        _never,
        remedy="Convert it with splat-transform (PlayCanvas): splat-transform IN.lcc OUT.ply",
    ),
    Format(
        "CSV",
        (".csv",),
        _never,
        remedy="It is a list for people, which no program reads back: take the file that it was made of.",
    ),
)
#: Suffixes of what Python alone reads.
SUFFIXES = tuple(suffix for each in FORMATS if each.read for suffix in each.suffixes)


def format_of(path: Path) -> Format:
    """The format of a file; raises what ``regular_file`` raises, and ``BadValueError`` where it is none of
    ``FORMATS``."""
    regular_file(path, "Check the path, or choose another file.")
    try:
        with path.open("rb") as file:
            start = file.read(_START)
    except OSError as error:
        raise FileDamagedError(f"{path} cannot be read: {error.strerror or error}") from error
    begun = [each for each in FORMATS if each.begins(start)]
    named = [each for each in FORMATS if path.name.lower().endswith(each.suffixes)]
    for each in [*(both for both in begun if both in named), *begun, *named]:
        return each
    known = ", ".join(suffix for each in FORMATS for suffix in each.suffixes)
    raise BadValueError(
        f"{path} is not a known kind of file of Gaussians", f"Known are: .safetensors, {known}."
    )


def read_any(path: Path) -> SplatCloud:
    """As ``read_splat_file``, with damaged Gaussians and quaternions of any length."""
    path = Path(path)
    found = format_of(path)
    if found.read is None:
        raise BadValueError(f"{path}: {found.name} is not read here", found.remedy)
    return found.read(path)


def read_splat_file(path: Path) -> SplatCloud:
    """Read a file of Gaussians of any kind that Python alone can read, in its own axes.

    Gaussians that cannot be drawn are left out, and a note says how many. Raises ``FileMissingError``,
    ``FileDamagedError`` and ``BadValueError``, also for the formats that need the backend, with the way to
    convert them.
    """
    cloud, left_out = only_usable(Path(path), read_any(path))
    return replace(cloud, notes=(left_out_note(left_out), *cloud.notes)) if left_out else cloud
