# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures on disk, read with suspicion and written atomically.

Integers: PNG and TIFF of 8 or 16 bits, JPEG. Radiance: OpenEXR, Radiance's .hdr, TIFF of floats. OpenImageIO
reads them all. By hand is what it does not do: it tries every format that it has on a damaged file, allocates
what a header of most kinds claims before it looks for the pixels, and ignores EXPOSURE and the order of rows
in a .hdr. Nor does it write: on a full disk its PNG is cut off without an error, and its OpenEXR holds the
time, so that no two are equal.
"""

import dataclasses
import math
import re
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from zlib import compress, crc32

import numpy as np
import OpenEXR
import OpenImageIO
from PIL import Image

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, OutputError
from ...bridge.limits import MAX_PIXELS, RADIANCE_MAX
from ...bridge.regular import damaged_where_it_fails, regular_file
from .color_space import SPACES, Chromaticities

#: Formats that Pillow opens for what stands beside their pixels: EXIF, ICC profiles.
READABLE = ("PNG", "JPEG")
#: Bytes of a .hdr that are looked through for the end of its header.
HDR_HEADER = 65_536
#: A PNG's first bytes, its number for RGB, and for rows that are written as differences to those above.
PNG_SIGNATURE, PNG_RGB, PNG_UP = b"\x89PNG\r\n\x1a\n", 2, 2
#: How files of each kind begin.
Kind = Literal["PNG", "JPEG", "TIFF", "EXR", "HDR"]
MAGIC: dict[bytes, Kind] = {
    PNG_SIGNATURE: "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"II+\0": "TIFF",
    b"MM\0+": "TIFF",
    b"\x76\x2f\x31\x01": "EXR",
    b"#?RADIANCE": "HDR",
    b"#?RGBE": "HDR",
}
#: Brands of the files that phones write, behind ``ftyp``: photos for ``physhdr prepare``, no data set's.
AVIF_BRANDS = {b"avif", b"avis"}
HEIF_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"mif2"}
#: Where a PNG's header has its colour type, and that of a palette (PNG specification, 11.2.2).
PNG_COLOUR_AT, PNG_PALETTE = 25, b"\x03"
#: A codec makes at most so many bytes of one. Deflate: 258 of two bits, a longest match. TIFF: LZW of 12
#: bits. .hdr: a run of 127 values in two bytes. EXR: 4015 values of a constant picture, by DWAB, measured.
MAX_RATIO: dict[Kind, int] = {"PNG": 1032, "TIFF": 4096, "HDR": 64, "EXR": 8192}
#: OpenImageIO's types and those that they are read as, all without loss.
READ_AS = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float", "double": "float"}
#: Channels of a picture that is no OpenEXR, at most.
MOST_CHANNELS = 8
#: Pixels of a tile, which may be larger than its picture: the library goes through all of it.
LARGEST_TILE = 1 << 24

_RESTORE = "Restore the file, or make the data set again: only what is missing is rendered."
_DELETE = "Delete it and make the data set again (only what is missing is rendered), or copy it again."


def kind_of(path: Path) -> Kind:
    """What a picture is, by its first bytes; raises ``FileMissingError``, ``FileDamagedError`` for others."""
    path = Path(path)
    regular_file(path, _RESTORE)
    with damaged_where_it_fails(f"{path} cannot be read", _DELETE), open(path, "rb") as file:
        start = file.read(16)
    for magic, kind in MAGIC.items():
        if start.startswith(magic):
            return kind
    if start[4:8] == b"ftyp" and start[8:12] in AVIF_BRANDS | HEIF_BRANDS:
        raise FileDamagedError(
            f"{path} is HEIC or AVIF, which data sets do not support",
            "Make a data set of such photos with physhdr prepare, or save them as PNG or JPEG.",
        )
    raise FileDamagedError(f"{path} is not a readable PNG or JPEG, nor TIFF, OpenEXR or .hdr", _DELETE)


def is_deep(path: Path) -> bool:
    """Whether a picture holds codes of 16 bits (PNG or TIFF); raises as ``kind_of`` and reading it do."""
    return _look(path).format == "uint16"


def has_alpha(path: Path) -> bool:
    """Whether a PNG, JPEG or TIFF has an alpha channel or transparent colours; raises as ``kind_of``."""
    header = _look(path)
    return header.kind not in ("EXR", "HDR") and header.alpha >= 0


def is_rgb(path: Path) -> bool:
    """Whether a PNG or JPEG stores red, green and blue, with alpha or without; raises as ``kind_of``.

    Not so: grey, a palette.
    """
    header = _look(path)
    with open(path, "rb") as file:  # OpenImageIO does not say that it has resolved a palette
        has_palette = header.kind == "PNG" and file.read(PNG_COLOUR_AT + 1)[PNG_COLOUR_AT:] == PNG_PALETTE
    return len(header.channels) >= 3 and not has_palette


def holds_radiance(path: Path) -> bool:
    """Whether a picture holds radiance (OpenEXR, .hdr, TIFF of floats), not codes; raises as ``kind_of``."""
    kind = kind_of(path)
    return kind in ("EXR", "HDR") or (kind == "TIFF" and _look(path).format == "float")


def picture_size(path: Path) -> tuple[int, int]:
    """``(width, height)`` in pixels of any picture from its header alone; raises as reading it does."""
    header = _look(path)
    return header.frame.width, header.frame.height


def read_codes(path: Path, with_alpha: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
    """``[H, W, 3]`` uint8 or uint16 of a PNG, JPEG or TIFF, as stored; and alpha, ``[H, W]`` in 0…1.

    Alpha is None unless it is asked for and there; nothing is composited, nothing is turned (structure from
    motion ignores EXIF's orientation, too). Raises ``FileMissingError``, ``FileDamagedError`` (another kind,
    truncated, floats, absurdly large).
    """
    path = Path(path)
    header = _look(path)
    if header.kind in ("EXR", "HDR"):
        raise FileDamagedError(
            f"{path} holds radiance instead of codes of 8 or 16 bits", "Save it as PNG or TIFF."
        )
    if header.format == "float":
        raise FileDamagedError(
            f"{path} is a TIFF of floats instead of codes of 8 or 16 bits", "Save it with 16 bits."
        )
    codes, alpha = _colours(_read_pixels(path, header), header)
    return codes, None if alpha is None or not with_alpha else alpha / float(np.iinfo(codes.dtype).max)


@dataclass(frozen=True, eq=False)
class Radiance:
    """``pixels`` ``[H, W, 3]`` float32, linear, as the file has them; ``alpha`` ``[H, W]`` or None.

    ``chromaticities``: of its primaries, where the file says; None: it does not.
    """

    pixels: np.ndarray
    alpha: np.ndarray | None
    chromaticities: Chromaticities | None


def read_radiance(path: Path) -> Radiance:
    """What an OpenEXR, .hdr or TIFF of floats holds.

    Raises ``FileMissingError``; ``FileDamagedError`` for other files, or truncated ones; ``BadValueError``
    for NaN, infinite or absurd values, as ``read_exr``.
    """
    path = Path(path)
    header = _look(path)
    if header.kind == "EXR":
        planes = read_exr_channels(path, _RESTORE, ("R", "G", "B"), optional=("A",))
        pixels = np.stack([planes[name] for name in "RGB"], axis=-1)
        return Radiance(_sound(path, pixels), planes.get("A"), header.chromaticities)
    if header.kind not in ("HDR", "TIFF"):
        raise FileDamagedError(
            f"{path} holds no radiance: it is a {header.kind}", "Give OpenEXR, .hdr or float TIFF."
        )
    if header.format != "float":
        raise FileDamagedError(f"{path} holds no radiance: it is a TIFF of integers", "Save it as floats.")
    pixels, alpha = _colours(_read_pixels(path, header), header)
    if header.kind == "HDR":
        pixels = pixels / np.float32(_exposure_of_hdr(path))
    return Radiance(_sound(path, pixels.astype(np.float32)), alpha, None)


def _exposure_of_hdr(path: Path) -> float:
    """What a .hdr's pixels have been multiplied by, by all ``EXPOSURE=`` lines of its header together.

    OpenImageIO does not undo it. (Ward, "Real Pixels", Graphics Gems II, 1991; Radiance's filefmts.)
    """
    header, _ = _header_of_hdr(path)
    with damaged_where_it_fails(f"{path} is not a readable HDR: its EXPOSURE", _DELETE):
        exposure = math.prod(float(each) for each in re.findall(rb"^EXPOSURE=(.*)$", header, re.MULTILINE))
        if not 1e-30 < exposure < 1e30:
            raise ValueError(f"it is {exposure:g}")
    return exposure


def _header_of_hdr(path: Path) -> tuple[bytes, bytes]:
    """The lines before the empty one, and the line behind it, which tells size and order of the pixels."""
    with path.open("rb") as file:
        header, _, rest = file.read(HDR_HEADER).replace(b"\r\n", b"\n").partition(b"\n\n")
    return header, rest.partition(b"\n")[0]


def _require_upright_hdr(path: Path) -> None:
    """Raises ``FileDamagedError`` where pixels go up, to the left or by columns; OpenImageIO reads on."""
    order = _header_of_hdr(path)[1]
    axes = re.fullmatch(rb"([-+][XY])\s+\d+\s+([-+][XY])\s+\d+\s*", order)
    if axes and axes.groups() != (b"-Y", b"+X"):
        raise FileDamagedError(
            f"{path} is stored upside down, mirrored or on its side ('{order.decode().strip():.40}')",
            "Save it again from the top left, row by row ('-Y height +X width'), as nearly all programs do.",
        )


@dataclass(frozen=True)
class _Frame:
    """The display window: its size in pixels, and where in it the data begin (less than 0: before it)."""

    width: int
    height: int
    left: int
    top: int

    def around(self, plane: np.ndarray) -> np.ndarray:
        """A channel's data ``[h, w]`` in the window: 0 where there are none, and nothing outside of it."""
        height, width = plane.shape
        if (self.left, self.top, width, height) == (0, 0, self.width, self.height):
            return plane
        whole = np.zeros((self.height, self.width), plane.dtype)
        top, bottom = max(self.top, 0), min(self.top + height, self.height)
        left, right = max(self.left, 0), min(self.left + width, self.width)
        if top < bottom and left < right:
            there = plane[top - self.top : bottom - self.top, left - self.left : right - self.left]
            whole[top:bottom, left:right] = there
        return whole


@dataclass(frozen=True)
class _Header:
    """What OpenImageIO says of a file's first picture before its pixels: ``width``, ``height`` of its data.

    ``channels``: their names; ``alpha``: which of them is, or -1. ``format``: as it is read.
    ``is_alone``: whether the file holds no other picture.
    """

    kind: Kind
    width: int
    height: int
    frame: _Frame
    channels: tuple[str, ...]
    alpha: int
    format: str
    chromaticities: Chromaticities | None
    is_alone: bool


@contextmanager
def _opened(path: Path, kind: Kind) -> Iterator[Any]:
    """OpenImageIO's reader, alpha not multiplied in; what fails in the block is ``FileDamagedError``."""
    wanted = OpenImageIO.ImageSpec()
    wanted["oiio:UnassociatedAlpha"] = 1
    name = "OpenEXR picture" if kind == "EXR" else kind
    with damaged_where_it_fails(f"{path} is not a readable {name}", _DELETE):
        reader = OpenImageIO.ImageInput.open(str(path), wanted)
        if reader is None:
            raise ValueError(OpenImageIO.geterror().partition("\n")[0] or "no reader knows it")
        try:
            yield reader
        finally:
            reader.close()


def _look(path: Path) -> _Header:
    """The header of a picture; raises as ``kind_of``, and ``FileDamagedError`` where it is not plausible."""
    path = Path(path)
    kind = kind_of(path)
    if kind == "HDR":
        _require_upright_hdr(path)
    with _opened(path, kind) as reader:
        spec = reader.spec_dimensions(0)
        whole = reader.spec()
        stated = whole.getattribute("chromaticities") if kind == "EXR" else None
        inks = whole.get_string_attribute("jpeg:ColorSpace") if kind == "JPEG" else ""
        header = _Header(
            kind,
            spec.width,
            spec.height,
            _Frame(spec.full_width, spec.full_height, spec.x - spec.full_x, spec.y - spec.full_y),
            tuple(whole.channelnames),
            whole.alpha_channel,
            READ_AS.get(str(spec.format), ""),
            None if stated is None else _chromaticities(stated),
            kind != "EXR" or not reader.seek_subimage(1, 0),
        )
        if whole.deep:
            raise ValueError("it is a deep EXR")
        if spec.tile_width * spec.tile_height > LARGEST_TILE:
            raise ValueError(f"a tile of {spec.tile_width}×{spec.tile_height} pixels")
        if inks in ("CMYK", "YCCK"):
            raise ValueError("its colours are CMYK: save it again as RGB")
        _check_claims(path, header, str(spec.format))
    return header


def _chromaticities(stated: Sequence[float]) -> Chromaticities:
    x = [float(value) for value in np.asarray(stated, np.float64).reshape(8)]
    return Chromaticities((x[0], x[1]), (x[2], x[3]), (x[4], x[5]), (x[6], x[7]))


def _check_claims(path: Path, header: _Header, stored: str) -> None:
    """Raises ``ValueError`` for what is not read, or cannot be in a file of this size."""
    count, size = len(header.channels), path.stat().st_size
    "".join(header.channels).encode()  # a name that is no text, which no message could show
    if header.format == "" or not 1 <= count <= (MOST_CHANNELS if header.kind != "EXR" else count):
        raise ValueError(f"its pixels are {count} × {stored}: 8 or 16 bits or floats are supported")
    claim = f"it claims {header.width}×{header.height} pixels of {count} channels in {size} bytes"
    if not (header.width > 0 and header.height > 0 and header.width * header.height <= MAX_PIXELS):
        raise ValueError(claim)
    # A pixel of "8 bits" may have one, grey or of a palette.
    bits = header.width * header.height * (1 if header.format == "uint8" else 16 * count)
    if bits > 8 * MAX_RATIO.get(header.kind, bits) * size:
        raise ValueError(claim)
    frame = header.frame
    if frame.width < 1 or frame.height < 1 or frame.width * frame.height > MAX_PIXELS:
        raise ValueError(f"its display window has {frame.width}×{frame.height} pixels")


def _read_pixels(path: Path, header: _Header, first: int = 0, end: int | None = None) -> np.ndarray:
    """``[H, W, C]`` of the header's type: its channels from ``first`` to before ``end``."""
    end = len(header.channels) if end is None else end
    with _opened(path, header.kind) as reader:
        pixels = reader.read_image(0, 0, first, end, header.format)
        said = reader.geterror()
        # Of a JPEG there are always pixels; some cameras' have bytes too many, of which libjpeg warns.
        if pixels is None or (said and (header.kind != "JPEG" or "Premature end" in said)):
            raise ValueError(f"truncated or damaged: {said.partition(chr(10))[0] or 'pixels are missing'}")
        pixels = np.asarray(pixels)
        if pixels.shape != (header.height, header.width, end - first):
            raise ValueError(f"its pixels are {pixels.shape}")
    return pixels


def _colours(pixels: np.ndarray, header: _Header) -> tuple[np.ndarray, np.ndarray | None]:
    """``[H, W, 3]`` of colour or grey pixels ``[H, W, C]``, and the alpha ``[H, W]`` if there is one."""
    count = len(header.channels)
    alpha = pixels[..., header.alpha] if 0 <= header.alpha < count else None
    colours = pixels[..., [k for k in range(count) if k != header.alpha][:3]]
    if colours.shape[2] < 3:
        colours = np.repeat(colours[..., :1], 3, axis=2)
    return np.ascontiguousarray(colours), alpha


def open_with_pillow(path: Path, formats: tuple[str, ...]) -> Image.Image:
    """An open picture of which the header is read; raises ``DecompressionBombError`` where Pillow does.

    That is at 179 million pixels. Its warning from half of them on is not shown: it means nothing to their
    photographer.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        return Image.open(path, formats=formats)


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write ``[H, W, 3]`` uint8 or uint16 as PNG, atomically; raises ``OutputError`` or ``BadValueError``."""
    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim != 3 or picture.shape[2] != 3:
        raise BadValueError(
            f"a PNG is written from [H, W, 3] uint8 or uint16, got {picture.shape} {picture.dtype}"
        )
    with atomic_path(path) as temporary:
        if picture.dtype == np.uint16:
            temporary.write_bytes(deep_png(picture))
        else:
            Image.fromarray(picture).save(temporary, format="PNG")


def deep_png(picture: np.ndarray) -> bytes:
    """A PNG of ``[H, W, 3]`` uint16, which Pillow cannot write (PNG specification, third edition)."""
    height, width, _ = picture.shape
    rows = picture.astype(">u2").view(np.uint8).reshape(height, width * 6)
    above = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    filtered = np.full((height, width * 6 + 1), PNG_UP, np.uint8)
    filtered[:, 1:] = rows - above

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 16, PNG_RGB, 0, 0, 0)
    packed = compress(filtered.tobytes(), 4)
    return PNG_SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def read_exr(path: Path) -> np.ndarray:
    """``[H, W, 3]`` float32, scene-linear radiance; channels other than R, G, B are ignored.

    Raises ``FileMissingError``; ``FileDamagedError`` if it is no OpenEXR, truncated, its header claims more
    than the file can hold, or a channel is missing; ``BadValueError`` if a value is NaN, infinite or absurd.
    """
    path = Path(path)
    planes = read_exr_channels(path, _RESTORE, ("R", "G", "B"))
    return _sound(path, np.stack([planes[name] for name in "RGB"], axis=-1))


def _sound(path: Path, radiance: np.ndarray) -> np.ndarray:
    """``radiance`` as it is; raises ``BadValueError`` for NaN, infinite or absurd values."""
    if not np.isfinite(radiance).all():
        row, column = np.argwhere(~np.isfinite(radiance))[0][:2]
        raise BadValueError(
            f"{path} holds NaN or infinity, first at row {row}, column {column}",
            "Render it again; a renderer that writes NaN has a broken material or light.",
        )
    largest = float(np.abs(radiance).max())
    if largest > RADIANCE_MAX:
        raise BadValueError(
            f"{path} holds the radiance {largest:g}: no more than {RADIANCE_MAX:g} is possible",
            "Render it again; the sun's disc has 2e7.",
        )
    return radiance


def read_exr_channels(
    path: Path, remedy: str, wanted: Sequence[str] = (), optional: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Channels of an OpenEXR file by name, each ``[H, W]`` float32, as they are, in its display window.

    A renderer may have cropped empty areas or rendered a region: outside these data there is 0.
    ``wanted``: of its first part, and those of the ``optional`` that it has; without them all channels of its
    only part. ``remedy``: the hint where the file is not there. Raises ``FileMissingError``;
    ``FileDamagedError`` if it is no OpenEXR, truncated, deep, claims more than the file can hold, or lacks a
    channel.
    """
    regular_file(path, remedy)
    header = _look(path)
    if header.kind != "EXR":
        raise _damaged_exr(path, f"it is a {header.kind}")
    if not (header.is_alone or wanted):
        raise _damaged_exr(path, "it holds several pictures")
    if not set(wanted) <= set(header.channels):
        raise _damaged_exr(path, f"it has no channels {', '.join(wanted)} but {sorted(header.channels)}")
    names = (*wanted, *(name for name in optional if name in header.channels)) if wanted else header.channels
    places = [header.channels.index(name) for name in names]
    first = min(places)
    pixels = _read_pixels(path, header, first, max(places) + 1)
    return {
        name: header.frame.around(np.ascontiguousarray(pixels[..., place - first]))
        for name, place in zip(names, places, strict=True)
    }


def exr_chromaticities(path: Path) -> Chromaticities | None:
    """What an OpenEXR's attribute says of the primaries; None where there is none.

    Raises ``FileDamagedError`` where it is no eight numbers.
    """
    return _look(path).chromaticities


def _damaged_exr(path: Path, why: str) -> FileDamagedError:
    return FileDamagedError(f"{path} is not a readable OpenEXR picture: {why}", _DELETE)


#: What says to other programs how RGB is meant: primaries and white, the name that we and Blender give the
#: space, and that of the ASWF's Color Interop Forum, by which OpenImageIO knows it.
COLOR_HEADER: dict[str, Any] = {
    "chromaticities": tuple(
        float(value) for point in dataclasses.astuple(SPACES["rec709"]) for value in point
    ),
    "workingSpace": "Linear Rec.709",
    "colorInteropID": "lin_rec709_scene",
}


def write_exr(path: Path, radiance: np.ndarray, attributes: dict[str, str] | None = None) -> None:
    """Write ``[H, W, 3]`` scene-linear radiance as 32-bit float RGB (ZIP), atomically.

    The header states the colour space; ``attributes`` go into it as strings. Raises ``OutputError`` or
    ``BadValueError``.
    """
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise BadValueError(f"an EXR is written from [H, W, 3], got {radiance.shape}")
    _write_exr(path, {"RGB": np.ascontiguousarray(radiance, dtype=np.float32)}, attributes)


def write_exr_channels(
    path: Path, channels: Mapping[str, np.ndarray], attributes: dict[str, str] | None = None
) -> None:
    """As ``write_exr``, of channels by name (``ViewLayer.Depth.Z``), each ``[H, W]``, in one part."""
    shapes = {plane.shape for plane in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise BadValueError(f"the channels of an EXR have one size, [H, W], got {sorted(shapes)}")
    planes = {name: np.ascontiguousarray(plane, dtype=np.float32) for name, plane in channels.items()}
    _write_exr(path, planes, attributes)


def _write_exr(path: Path, channels: dict[str, np.ndarray], attributes: dict[str, str] | None) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **COLOR_HEADER}
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header | (attributes or {}), channels).write(str(temporary))
        except RuntimeError as error:  # how the binding says that the disk is full
            raise OutputError(f"cannot write {path}: {error}", "Check the disk's free space.") from error
