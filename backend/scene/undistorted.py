# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted pictures, cached on disk from one process to the next: beside the data, or with the user.

An entry is a file of its own: a ZIP archive without compression (whose checksum tells whether it is
complete) of the codes, the mask if there is one, and what they were made of. Where that is no longer what is
asked for, or the file is damaged, the picture is made again and replaces it. Reading one is faster than
decoding a JPEG.
"""

import hashlib
import json
import logging
import os
import re
import shutil
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.atomic import atomic_path
from ...bridge.errors import OutputError, PhysHDRError
from ...bridge.limits import MAX_PIXELS
from ...bridge.regular import regular_file, resolved
from ...bridge.user_cache import user_cache
from .source import Decoded, PictureSource

log = logging.getLogger(__name__)

#: Raised where pictures come out otherwise than before: entries of other versions are made again.
VERSION = 1
#: In a data set's folder. It may be deleted at any time.
FOLDER = Path(".physhdr") / "undistorted"
#: What each entry has; the mask only where there is one.
ABOUT, CODES, MASK = "about.json", "codes", "mask"
#: Bytes of ``about.json`` at most.
LONGEST_ABOUT = 1 << 16
#: A disk with less than this left, after all the pictures, counts as full: others write to it, too.
SPARE_BYTES = 256 << 20
#: Bytes a channel of pictures of files with these suffixes; of others there may be 16 bits.
EIGHT_BITS = (".jpg", ".jpeg")


class UndistortedPictures:
    """A ``PictureStore`` of the data set in ``root``; ``folders`` are looked in, ``write_to`` is written to.

    Any number of processes may use the same folders at once.
    """

    def __init__(self, root: Path, folders: Iterable[Path], write_to: Path | None) -> None:
        self.root = root
        self.folders = tuple(folders)
        self.write_to = write_to

    def load(self, source: PictureSource) -> Decoded | None:
        """What was saved for this source, if it is complete and made from the present file."""
        about = self._about(source)
        if about is None:
            return None
        for folder in self.folders:
            with suppress(
                PhysHDRError, OSError, ValueError, KeyError, zipfile.BadZipFile, NotImplementedError
            ):
                return _read(folder / self._name(source), about)
        return None

    def save(self, source: PictureSource, decoded: Decoded) -> None:
        """Cache a picture; where that fails, one warning is logged and nothing more is cached."""
        about = self._about(source)
        if self.write_to is None or about is None:
            return
        codes, mask = np.ascontiguousarray(decoded.codes), decoded.mask
        about = json.dumps({"made_of": about, "shape": codes.shape, "type": codes.dtype.name})
        try:
            # After a power cut a missing entry is made again: its name need not be on the disk.
            with (
                atomic_path(self.write_to / self._name(source), sync_name=False) as temporary,
                zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive,
            ):
                archive.writestr(ABOUT, about)
                archive.writestr(CODES, codes.data.cast("B"))
                if mask is not None:
                    archive.writestr(MASK, np.packbits(mask).data)
        except OutputError as error:
            self.write_to = None
            log.warning("%s: pictures are undistorted again at each start", error.message)

    def _about(self, source: PictureSource) -> str | None:
        """All that a picture depends on; None where one of its files cannot be accessed."""
        try:
            files = [_identity(path) for path in (source.path, source.mask_path) if path is not None]
        except OSError:
            return None
        key: Any = source.key
        parts = [self._relative(part) if isinstance(part, Path) else repr(part) for part in key]
        return json.dumps([VERSION, files, parts])

    def _name(self, source: PictureSource) -> str:
        """One for each picture and size: ``0001-1067x1902-5d41402a.picture``, whatever lens it then has."""
        assert source.lens is not None
        width, height = getattr(source.lens, "width", 0), getattr(source.lens, "height", 0)
        key = json.dumps([self._relative(source.path), width, height])
        plain = re.sub(r"[^A-Za-z0-9_-]", "_", source.path.stem)[:64]
        return f"{plain}-{width}x{height}-{hashlib.sha256(key.encode()).hexdigest()[:12]}.picture"

    def _relative(self, path: Path) -> str:
        """Relative to the data set, which may be moved as a whole."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else str(path)


def _identity(path: Path) -> list[int]:
    there = path.stat()
    return [there.st_size, there.st_mtime_ns]


def _read(path: Path, made_of: str) -> Decoded:
    """An entry; raises what libraries raise, ``ValueError`` if it is another picture's."""
    if regular_file(path).stat().st_size > 8 * MAX_PIXELS:
        raise ValueError("no picture is that large")
    with zipfile.ZipFile(path) as archive:
        about = json.loads(_member(archive, ABOUT, range(LONGEST_ABOUT)))
        if about["made_of"] != made_of or about["type"] not in ("uint8", "uint16"):
            raise ValueError("it is of something else")
        height, width, channels = (int(side) for side in about["shape"])
        kind = np.dtype(about["type"])
        size = height * width * channels * kind.itemsize
        codes = np.frombuffer(_member(archive, CODES, range(size, size + 1)), kind)
        mask = None
        if MASK in archive.namelist():
            packed = (height * width + 7) // 8
            bits = np.frombuffer(_member(archive, MASK, range(packed, packed + 1)), np.uint8)
            mask = np.unpackbits(bits, count=height * width).reshape(height, width).astype(bool)
    return Decoded(codes.reshape(height, width, channels), mask)


def _member(archive: zipfile.ZipFile, name: str, sizes: range) -> bytes:
    """Raises ``ValueError`` for another size, ``BadZipFile`` where its checksum is wrong."""
    info = archive.getinfo(name)
    if info.file_size not in sizes or info.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{name} has {info.file_size} bytes")
    return archive.read(info)


# ---- where ---------------------------------------------------------------------------------------------


def store_for(root: Path, pictures: Iterable[tuple[Path, int, int]]) -> tuple[UndistortedPictures, str]:
    """Where pictures of the data set in ``root`` are cached, and a message for ``Scene.messages``.

    ``pictures``: file, width and height without distortion of each. In the data set's folder where that can
    be written and its disk has room, else in the user's cache folder, else nowhere. Nothing is written yet.
    """
    pictures = list(pictures)
    needed = sum(w * h * 3 * (1 if path.suffix.lower() in EIGHT_BITS else 2) for path, w, h in pictures)
    beside = root / FOLDER
    digest = hashlib.sha256(os.fsencode(resolved(root))).hexdigest()[:16]
    with_user = user_cache() / "undistorted" / digest
    size = f"{len(pictures)} pictures, {needed / 1e6:,.0f} MB"
    why: list[str] = []
    for folder, where in ((beside, beside), (with_user, with_user)):
        fault = _fault(folder, needed)
        if fault is None:
            message = f"undistorted pictures are cached in {where} ({size}), which may be deleted"
            return UndistortedPictures(root, (beside, with_user), folder), message
        why.append(f"{where}: {fault}")
    message = f"pictures are undistorted again at each start ({'; '.join(why)})"
    return UndistortedPictures(root, (beside, with_user), None), message


def _fault(folder: Path, needed: int) -> str | None:
    """Why ``needed`` bytes cannot be stored in a folder that may not exist yet; None where they can."""
    there = folder
    while not there.exists() and there != there.parent:
        there = there.parent
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        return "cannot be written"
    try:
        held = sum(entry.stat().st_size for entry in os.scandir(folder)) if there == folder else 0
        free = shutil.disk_usage(there).free
    except OSError as error:
        return error.strerror or str(error)
    missing = needed - held
    return f"the disk has {free / 1e6:,.0f} MB left" if missing > 0 and free < missing + SPARE_BYTES else None
