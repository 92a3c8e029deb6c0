# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprints of pictures, which distinguish different ones with the same names and sizes.

They consist of size and checksum of every picture's and mask's file, and of its treatment before comparing
(undistortion, orientation, colours), which data sets state elsewhere. Nothing is decoded.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...bridge.errors import PhysHDRError
from ...bridge.regular import regular_file
from ..scene import View
from ..scene.source import PictureSource

#: Bytes of a checksum (BLAKE2b): enough against accidental collisions.
CHECKSUM_BYTES = 16
PICTURE, MASK, TREATMENT = "picture", "mask", "treatment"
#: Fingerprint of one picture in ``views.json``: texts by these names, None if there is no file.
Contents = Mapping[str, str | None]


def contents_of(views: Sequence[View]) -> list[list[Contents]]:
    """The ``Contents`` of each view's pictures. Each file is read once, several at a time."""
    sources = [source for view in views for source in view.sources]
    paths = list(dict.fromkeys(path for source in sources for path in _files(source).values()))
    with ThreadPoolExecutor() as pool:
        known = dict(zip(paths, pool.map(_fingerprint, paths), strict=True))
    return [
        [
            {**{name: known[path] for name, path in _files(source).items()}, TREATMENT: _treatment(source)}
            for source in view.sources
        ]
        for view in views
    ]


def first_difference(views: Sequence[View], stored: Sequence[Sequence[Contents]]) -> str:
    """A description of the first picture of ``views`` that differs from ``stored``; empty if none does."""
    for view, now, before in zip(views, contents_of(views), stored, strict=True):
        for source, here, there in zip(view.sources, now, before, strict=True):
            if here.get(PICTURE) != there.get(PICTURE):
                return f"{source.path} is a different picture"
            if here.get(MASK) != there.get(MASK):
                return f"{source.path} has a different mask"
            if here != there:
                return f"{source.path} has a different lens, orientation or colour space"
    return ""


def _files(source: PictureSource) -> dict[str, Path]:
    return {PICTURE: source.path} | ({} if source.mask_path is None else {MASK: source.mask_path})


def _fingerprint(path: Path) -> str | None:
    """Size in bytes and checksum of a file; None if it cannot be read."""
    try:
        found = regular_file(path).stat()
        return _read(path, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
    except (OSError, PhysHDRError):
        return None


@lru_cache(maxsize=1 << 16)
def _read(path: Path, *_: int) -> str:
    """Read once for each state of a file, because runs are opened and resumed, or rendered repeatedly."""
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=CHECKSUM_BYTES))
        return f"{file.tell()} {digest.hexdigest()}"


def _treatment(source: PictureSource) -> str:
    """Equal for equal treatment; numbers are rounded, because machines differ in their last digits."""
    key: Any = source.key
    text = _words(part for part in key if not isinstance(part, Path))
    return hashlib.blake2b(text.encode(), digest_size=CHECKSUM_BYTES).hexdigest()


def _words(parts: Iterable[object]) -> str:
    return " ".join(
        f"({_words(part)})"
        if isinstance(part, tuple)
        else f"{part:.6g}"
        if isinstance(part, float)
        else repr(part)
        for part in parts
    )
