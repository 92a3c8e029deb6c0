# SPDX-License-Identifier: GPL-3.0-or-later
"""SOG, PlayCanvas's compressed Gaussians: lossless pictures as planes, in a zip or beside a ``meta.json``.

Pixel i of each plane, row by row, belongs to Gaussian i; channels are bytes.

* ``means``: two planes, low and high bytes of 16 bits between ``mins`` and ``maxs``; x = sign(n)(e^|n| − 1).
* ``quats``: three smallest components × √2, and in alpha 252 + the index of the omitted one (w, x, y, z).
* ``scales``: ln of the standard deviations; ``sh0``: f_dc, and in alpha the opacity.
* ``shN``: the higher SH as a palette. ``labels`` has each Gaussian's entry (R low, G high byte), and
  ``centroids`` 64 entries a row, a pixel a coefficient.

Version 2 has a ``codebook`` of 256 numbers for each of scales, sh0 and shN, version 1 (which names no
version) a range ``mins`` … ``maxs`` for each channel, and its opacity is a logit.

A file that claims more Gaussians than so few bytes can hold is refused before memory is allocated.
"""

import io
import math
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from PIL import Image

from ...bridge.errors import FileDamagedError, FileMissingError
from ...bridge.limits import MAX_PIXELS, is_number
from ...bridge.regular import damaged_where_it_fails, parse_json, read_bytes, regular_file
from ...bridge.splat_files import UP, SplatCloud
from ...bridge.splat_files.usable import ANTIALIASED_NOTE

META = "meta.json"
#: Bytes of the meta.json; three codebooks have 15,000.
LARGEST_META = 1 << 22
#: So many Gaussians may be packed into nothing at all; of more each has this many bytes at least.
FREE, FEWEST_BYTES = 1_000_000, 0.25
#: Coefficients beyond the first, by SH degree; entries in a row of the palette.
REST = (0, 3, 8, 15)
ENTRIES_A_ROW = 64
#: Pixels of a palette of 65,536 entries, which is what a label can name, of degree 3.
LARGEST_PALETTE = 65536 * REST[3]
REMEDY = "Copy or export it again: it may be cut off, or of a newer version of SOG."

#: Gives a file of the set by its name, of no more than so many bytes.
Fetch = Callable[[str, int], bytes]


def read_sog(path: Path) -> SplatCloud:
    """Read a ``.sog`` file, or a set of pictures by its ``meta.json`` or its folder.

    In the file's own axes: those of the PLY that it was made from. Raises ``FileMissingError`` and
    ``FileDamagedError``.
    """
    path = Path(path)
    if path.is_dir():
        path = path / META
    regular_file(path, "Check the path, or choose another file.")
    if path.name.lower().endswith(".json"):
        return _Sog(path, _from_folder(path), _bytes_beside(path)).cloud()
    with damaged_where_it_fails(f"{path} is not a readable SOG", REMEDY):
        archive = zipfile.ZipFile(path)
    with archive:
        return _Sog(path, _from_archive(path, archive), path.stat().st_size).cloud()


class _Sog:
    """A set that is being read. ``size``: bytes of all of its files."""

    def __init__(self, path: Path, fetch: Fetch, size: int) -> None:
        self.path, self.fetch = path, fetch
        self.meta = self._meta(fetch(META, LARGEST_META))
        version = self.meta.get("version", 1)
        if version not in (1, 2):
            raise self.damaged(f"it is of version {version!r:.40}, known are 1 and 2")
        self.has_codebooks = version == 2
        self.count = self._count()
        if self.count > FREE and self.count * FEWEST_BYTES > size:
            raise self.damaged(f"it claims {self.count} Gaussians in {size} bytes")

    def cloud(self) -> SplatCloud:
        notes = []
        if self.meta.get("antialias") or self.meta.get("model") == "antialiased":
            notes.append(ANTIALIASED_NOTE)
        opacity, dc = self._colours()
        colour_sh = np.concatenate([dc[:, None], *self._rest()], axis=1)
        return SplatCloud(
            position=self._positions(),
            rotation=self._rotations(),
            scale=np.exp(self._looked_up("scales", 3)).astype(np.float32),
            opacity=opacity,
            colour_sh=colour_sh,
            notes=tuple(notes),
            up=UP["sog"],
        )

    def damaged(self, what: str) -> FileDamagedError:
        return FileDamagedError(f"{self.path} is not a readable SOG: {what}", REMEDY)

    # -- meta.json -------------------------------------------------------------------------------------------

    def _meta(self, raw: bytes) -> dict[str, Any]:
        try:
            meta = parse_json(raw.decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise self.damaged(f"its {META} is no JSON ({error!s:.100})") from error
        if not isinstance(meta, dict) or not isinstance(meta.get("means"), dict):
            raise self.damaged(f"its {META} describes no Gaussians")
        return meta

    def _count(self) -> int:
        count = self.meta.get("count")
        if not self.has_codebooks:
            shape = self.meta["means"].get("shape")
            count = shape[0] if isinstance(shape, list) and shape else None
        if not isinstance(count, int) or isinstance(count, bool) or not 0 < count <= MAX_PIXELS:
            raise self.damaged(f"it claims {count!r:.40} Gaussians")
        return count

    def _part(self, name: str) -> dict[str, Any]:
        part = self.meta.get(name)
        if not isinstance(part, dict):
            raise self.damaged(f"its {META} has no {name}")
        return part

    def _numbers(self, part: str, key: str, count: int) -> np.ndarray:
        values = self._part(part).get(key)
        values = [values] if is_number(values) else values
        if key == "codebook" and isinstance(values, list) and len(values) == count and values[0] is None:
            _, *others = values  # some exporters leave the first one out: it is a step before the second
            if all(map(is_number, others)):
                values = [others[0] + (others[0] - others[-1]) / (count - 1), *others]
        if not isinstance(values, list) or len(values) != count or not all(map(is_number, values)):
            raise self.damaged(f"{part}.{key} is not a list of {count} numbers")
        return np.array(values, np.float64)

    # -- planes ----------------------------------------------------------------------------------------------

    def _plane(self, part: str, index: int, least: int, most: int) -> np.ndarray:
        """``[H, W, 4]`` uint8, of ``least`` to ``most`` pixels."""
        files = self._part(part).get("files")
        if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
            raise self.damaged(f"{part}.files names no picture {index + 1}")
        name = files[index]
        raw = self.fetch(name, 8 * most)
        with damaged_where_it_fails(f"{self.path}: {name!r:.80} is not a readable picture", REMEDY):
            width, height = _claimed_size(raw)
            if not least <= width * height <= most:
                raise self.damaged(f"{name!r:.80} has {width}×{height} pixels, not {least} to {most}")
            with Image.open(io.BytesIO(raw)) as picture:
                if picture.size != (width, height):
                    raise ValueError("two sizes")
                return np.asarray(picture.convert("RGBA"))

    def _pixels(self, part: str, index: int = 0) -> np.ndarray:
        """``[count, 4]`` uint8."""
        most = 2 * self.count + (1 << 16)  # whole rows, and what an encoder rounds up to
        return self._plane(part, index, self.count, most).reshape(-1, 4)[: self.count]

    def _looked_up(self, part: str, channels: int) -> np.ndarray:
        """``[count, channels]`` float32: bytes through the codebook, or each channel in its range."""
        codes = self._pixels(part)[:, :channels]
        if self.has_codebooks:
            return self._numbers(part, "codebook", 256).astype(np.float32)[codes]
        low, high = (self._numbers(part, key, 4 if part == "sh0" else channels) for key in ("mins", "maxs"))
        low, high = low[:channels], high[:channels]
        return (low + (high - low) * (codes / 255.0)).astype(np.float32)

    def _positions(self) -> np.ndarray:
        low, high = (self._numbers("means", key, 3) for key in ("mins", "maxs"))
        codes = self._pixels("means", 0)[:, :3].astype(np.uint16)
        codes |= self._pixels("means", 1)[:, :3].astype(np.uint16) << 8
        logarithm = low + (high - low) * (codes / 65535.0)
        with np.errstate(over="ignore"):
            return (np.sign(logarithm) * np.expm1(np.abs(logarithm))).astype(np.float32)

    def _rotations(self) -> np.ndarray:
        codes = self._pixels("quats")
        others = (codes[:, :3] / 255.0 - 0.5) * math.sqrt(2.0)
        largest_index = codes[:, 3].astype(np.int64) - 252
        rotation = np.zeros((self.count, 4))
        rotation[:, 0] = 1.0
        for largest in range(4):
            rows = np.flatnonzero(largest_index == largest)
            smaller = [axis for axis in range(4) if axis != largest]
            rotation[rows[:, None], smaller] = others[rows]
            rest = 1.0 - np.square(others[rows]).sum(axis=1)
            rotation[rows, largest] = np.sqrt(np.maximum(rest, 0.0))
        rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
        return rotation.astype(np.float32)

    def _colours(self) -> tuple[np.ndarray, np.ndarray]:
        """Opacities ``[count]`` and f_dc ``[count, 3]``."""
        if self.has_codebooks:
            return self._pixels("sh0")[:, 3].astype(np.float32) / np.float32(255.0), self._looked_up("sh0", 3)
        both = self._looked_up("sh0", 4)
        with np.errstate(over="ignore"):
            return 1.0 / (1.0 + np.exp(-both[:, 3])), both[:, :3]

    def _rest(self) -> list[np.ndarray]:
        """The higher coefficients ``[count, 3 | 8 | 15, 3]``, if there are any."""
        if not self.meta.get("shN"):
            return []
        labels = self._pixels("shN", 1).astype(np.int64)
        labels = labels[:, 0] | labels[:, 1] << 8
        degree = self._part("shN").get("bands")
        if not self.has_codebooks:  # the width alone tells
            width = self._centroids(1, 1).shape[1]
            degree = next((n for n in (1, 2, 3) if ENTRIES_A_ROW * REST[n] == width), None)
        if degree not in (0, 1, 2, 3) or isinstance(degree, bool):
            raise self.damaged(f"its palette has SH of degree {degree!r:.40}")
        if degree == 0:
            return []
        count = REST[degree]
        entries = int(labels.max()) + 1
        palette = self._centroids(count, -(-entries // ENTRIES_A_ROW))
        if palette.shape[1] != ENTRIES_A_ROW * count:
            raise self.damaged(f"its palette is {palette.shape[1]} pixels wide for degree {degree}")
        codes = palette.reshape(-1, count, 4)[:, :, :3]
        if self.has_codebooks:
            values = self._numbers("shN", "codebook", 256).astype(np.float32)[codes]
        else:
            low, high = (float(self._numbers("shN", key, 1)[0]) for key in ("mins", "maxs"))
            values = (low + (high - low) * (codes / 255.0)).astype(np.float32)
        return [values[labels]]

    def _centroids(self, coefficients: int, rows: int) -> np.ndarray:
        return self._plane("shN", 0, ENTRIES_A_ROW * coefficients * rows, 2 * LARGEST_PALETTE)


def _claimed_size(raw: bytes) -> tuple[int, int]:
    """Width and height in a picture's header, before a decoder takes memory for them."""
    if raw[:4] == b"RIFF" and raw[8:12] == b"WEBP":
        kind, body = raw[12:16], raw[20:30]
        if kind == b"VP8L" and body[:1] == b"\x2f":
            bits = int.from_bytes(body[1:5], "little")
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        if kind == b"VP8X" and len(body) == 10:
            return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
        raise ValueError("a WebP that is not lossless")
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with Image.open(io.BytesIO(raw), formats=("PNG",)) as picture:
            return picture.size


def _from_archive(path: Path, archive: zipfile.ZipFile) -> Fetch:
    def fetch(name: str, limit: int) -> bytes:
        try:
            member = archive.getinfo(name)
        except KeyError:
            raise FileDamagedError(f"{path} is not a readable SOG: it has no {name!r:.80}", REMEDY) from None
        if member.file_size > limit:
            raise FileDamagedError(
                f"{path}: {name!r:.80} claims {member.file_size} bytes instead of at most {limit}", REMEDY
            )
        with damaged_where_it_fails(f"{path} is not a readable SOG", REMEDY), archive.open(member) as file:
            raw = file.read(limit + 1)
        if len(raw) > limit:
            raise FileDamagedError(f"{path}: {name!r:.80} is larger than it claims", REMEDY)
        return raw

    return fetch


def _from_folder(path: Path) -> Fetch:
    def fetch(name: str, limit: int) -> bytes:
        if name == META:
            return read_bytes(path, REMEDY, limit)
        if PurePosixPath(name).name != name or "\\" in name or ":" in name or name in ("", ".", ".."):
            raise FileDamagedError(f"{path}: {name!r:.80} does not name a file beside it", REMEDY)
        try:
            return read_bytes(path.parent / name, REMEDY, limit)
        except FileMissingError as error:
            raise FileMissingError(f"{path} names {name!r:.80}, which is not beside it", REMEDY) from error

    return fetch


def _bytes_beside(path: Path) -> int:
    """Bytes of all files in the folder."""
    try:
        return sum(entry.stat().st_size for entry in path.parent.iterdir() if entry.is_file())
    except OSError as error:
        raise FileDamagedError(
            f"{path.parent} cannot be listed: {error.strerror or error}", REMEDY
        ) from error
