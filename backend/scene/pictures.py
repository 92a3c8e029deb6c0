# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures on disk, read with suspicion and written atomically.

Integers: PNG and TIFF of 8 or 16 bits, JPEG. Radiance: OpenEXR, Radiance's .hdr, TIFF of floats. Pillow
reads PNG and JPEG of 8 bits, OpenEXR's own library its format, OpenImageIO all the rest: Pillow knows no
colour of 16 bits.
"""

import dataclasses
import math
import re
import struct
import sys
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TextIO, TypeVar, cast
from zlib import compress, crc32

import numpy as np
import OpenEXR
from PIL import Image

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, OutputError
from ...bridge.limits import MAX_PIXELS, RADIANCE_MAX
from ...bridge.regular import damaged_where_it_fails, regular_file
from .color_space import SPACES, Chromaticities

#: A file of N bytes can hold at most this many pixels per byte. RLE, the weakest of EXR's codecs, reaches 64
#: on constant data and ZIP about 1000; a real render stays below 1. A 376-byte file that claims 16000×16000
#: makes the OpenEXR library (3.5) allocate 1.5 GB before it notices that the pixels are not there.
MAX_PIXELS_PER_BYTE = 1024
#: Nor more values of all channels. Measured on a constant picture of 2048×2048: DWAB 4015, ZIP 412, RLE 29.
MAX_VALUES_PER_BYTE = 4096
#: Pillow's modes that are 8 bits a channel (or fewer) and become RGB without loss.
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX")
#: Deflate, PNG's only codec, makes at most so many bytes of one: 258 of two bits, a longest match.
MAX_DEFLATE_RATIO = 1032
#: The fewest bits that a PNG's pixel of each mode has before deflate; its rows' filters only add to them, and
#: interlacing does, too. A pixel of "L" has 2 to 8, one of "P" 1 to 8.
PNG_BITS = {"1": 1, "L": 2, "LA": 16, "P": 1, "RGB": 24, "RGBA": 32}
#: Pillow's names of the formats that it reads for us.
READABLE = ("PNG", "JPEG")
#: TIFF's codecs make at most so many bytes of one (LZW, of 12 bits; deflate and PackBits make less).
MAX_TIFF_RATIO = 4096
#: .hdr packs a run of 127 values into two bytes.
MAX_HDR_RATIO = 64
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
#: The byte of a PNG that tells how many bits a channel has (PNG specification, 11.2.2).
PNG_DEPTH_AT = 24

#: Pixels of an EXR's tile, which may be larger than its picture: the library goes through all of it.
LARGEST_TILE = 1 << 24

T = TypeVar("T")

#: ``redirect_stdout`` puts another ``sys.stdout`` in place for all threads, and back what it has found.
_stdout_lock = threading.Lock()


class _OfOtherThreads:
    """A stream without what the thread that made this writes to it; what others write, arrives.

    Pictures are read beside a training (``prefetch``), which tells how far it is meanwhile.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._silent = stream, threading.get_ident()

    def write(self, text: str) -> int:
        return len(text) if threading.get_ident() == self._silent else self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


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
            f"{path} is a HEIC or an AVIF, which no data set holds",
            "Make a data set of such photos with physhdr prepare, or save them as PNG or JPEG.",
        )
    raise FileDamagedError(f"{path} is not a readable PNG or JPEG, nor TIFF, OpenEXR or .hdr", _DELETE)


def is_deep(path: Path) -> bool:
    """Whether a picture holds codes of 16 bits (PNG or TIFF); raises as ``kind_of`` and reading it do."""
    kind = kind_of(path)
    return _is_deep_png(path) if kind == "PNG" else kind == "TIFF" and _look(path, kind).format == "uint16"


def has_alpha(path: Path) -> bool:
    """Whether a PNG, JPEG or TIFF has an alpha channel or transparent colours; raises as ``kind_of``."""
    kind = kind_of(path)
    if kind in ("EXR", "HDR"):
        return False
    if kind == "TIFF" or (kind == "PNG" and _is_deep_png(path)):
        return _look(path, kind).alpha >= 0
    return _open_picture(path, READABLE, lambda picture: picture.has_transparency_data)


def is_rgb(path: Path) -> bool:
    """Whether a PNG or JPEG stores red, green and blue, with alpha or without; raises as ``kind_of``.

    Not so: grey, a palette, the four inks of print.
    """
    kind = kind_of(path)
    if kind == "PNG" and _is_deep_png(path):
        return _look(path, kind).channels >= 3
    return _open_picture(path, READABLE, lambda picture: picture.mode in ("RGB", "RGBA"))


def _is_deep_png(path: Path) -> bool:
    with damaged_where_it_fails(f"{path} cannot be read", _DELETE), open(path, "rb") as file:
        return file.read(PNG_DEPTH_AT + 1)[PNG_DEPTH_AT:] == b"\x10"


def holds_radiance(path: Path) -> bool:
    """Whether a picture holds radiance (OpenEXR, .hdr, TIFF of floats), not codes; raises as ``kind_of``."""
    kind = kind_of(path)
    return kind in ("EXR", "HDR") or (kind == "TIFF" and _look(path, kind).is_float)


def picture_size(path: Path) -> tuple[int, int]:
    """``(width, height)`` in pixels of any picture from its header alone; raises as reading it does."""
    path = Path(path)
    kind = kind_of(path)
    if kind == "EXR":
        return _exr_size(path)
    if kind in ("TIFF", "HDR") or (kind == "PNG" and _is_deep_png(path)):
        header = _look(path, kind)
        return header.width, header.height
    return _open_picture(path, READABLE, lambda picture: picture.size)


def read_codes(path: Path, with_alpha: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
    """``[H, W, 3]`` uint8 or uint16 of a PNG, JPEG or TIFF, as stored; and alpha, ``[H, W]`` in 0…1.

    Alpha is None unless it is asked for and there; nothing is composited, nothing is turned. Raises
    ``FileMissingError``, ``FileDamagedError`` (another kind, truncated, floats, absurdly large).
    """
    path = Path(path)
    kind = kind_of(path)
    if kind in ("EXR", "HDR"):
        raise FileDamagedError(
            f"{path} holds radiance, where codes of 8 or 16 bits are wanted", "Save it as PNG or TIFF."
        )
    if kind == "TIFF" or (kind == "PNG" and _is_deep_png(path)):
        header = _look(path, kind)
        if header.is_float:
            raise FileDamagedError(
                f"{path} is a TIFF of floats, where codes of 8 or 16 bits are wanted", "Save it with 16 bits."
            )
        pixels = _read_pixels(path, header)
        codes, alpha = _colours(pixels, header)
        return codes, None if alpha is None or not with_alpha else alpha / float(np.iinfo(codes.dtype).max)
    if with_alpha:
        return _open_picture(path, READABLE, _as_rgb_and_alpha)
    return read_picture(path), None


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
    kind = kind_of(path)
    if kind == "EXR":
        planes = read_exr_channels(path, _RESTORE, ("R", "G", "B"), optional=("A",))
        pixels = np.stack([planes[name] for name in "RGB"], axis=-1)
        return Radiance(_sound(path, pixels), planes.get("A"), exr_chromaticities(path))
    if kind not in ("HDR", "TIFF"):
        raise FileDamagedError(
            f"{path} holds no radiance: it is a {kind}", "Give OpenEXR, .hdr or float TIFF."
        )
    header = _look(path, kind)
    if not header.is_float:
        raise FileDamagedError(f"{path} holds no radiance: it is a TIFF of integers", "Save it as floats.")
    pixels, alpha = _colours(_read_pixels(path, header), header)
    if kind == "HDR":
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
class _Header:
    """What OpenImageIO says of a file before its pixels; ``format``: a NumPy type's name."""

    width: int
    height: int
    channels: int
    alpha: int
    format: str

    @property
    def is_float(self) -> bool:
        return self.format == "float32"


#: OpenImageIO's types and those that we read them as: all without loss.
_READ_AS = {"uint8": "uint8", "uint16": "uint16", "half": "float32", "float": "float32", "double": "float32"}
_RATIOS = {"PNG": MAX_DEFLATE_RATIO, "TIFF": MAX_TIFF_RATIO, "HDR": MAX_HDR_RATIO}


def _opened(path: Path) -> Any:
    """OpenImageIO's reader of a file; alpha is not multiplied in."""
    import OpenImageIO  # here: most data sets do without, and it takes 0.4 s to load

    wanted = OpenImageIO.ImageSpec()
    wanted["oiio:UnassociatedAlpha"] = 1
    with damaged_where_it_fails(f"{path} is not a readable picture", _DELETE):
        reader = OpenImageIO.ImageInput.open(str(path), wanted)
        if reader is None:
            raise ValueError(OpenImageIO.geterror() or "no reader knows it")
    return reader


def _look(path: Path, kind: Kind) -> _Header:
    """The header of a PNG, TIFF or .hdr; raises ``FileDamagedError`` where it cannot be believed."""
    if kind == "HDR":
        _require_upright_hdr(path)
    reader = _opened(path)
    try:
        spec = reader.spec()
        header = _Header(
            spec.width, spec.height, spec.nchannels, spec.alpha_channel, _READ_AS.get(str(spec.format), "")
        )
    finally:
        reader.close()
    with damaged_where_it_fails(f"{path} is not a readable {kind}", _DELETE):
        size = path.stat().st_size
        if not (header.width > 0 and header.height > 0 and header.width * header.height <= MAX_PIXELS):
            raise ValueError(f"it claims {header.width}×{header.height} pixels")
        if header.format == "" or not 1 <= header.channels <= 8:
            raise ValueError(
                f"its pixels are {header.channels} × {spec.format}: 8 or 16 bits or floats are read"
            )
        bits = {"uint8": 1, "uint16": 16, "float32": 16}[header.format]  # of 8 bits there may be fewer
        if header.width * header.height * header.channels * bits > 8 * _RATIOS[kind] * size:
            raise ValueError(f"it claims {header.width}×{header.height} pixels in {size} bytes")
    return header


def _read_pixels(path: Path, header: _Header) -> np.ndarray:
    """``[H, W, C]`` of the header's type."""
    reader = _opened(path)
    try:
        with damaged_where_it_fails(f"{path} is truncated or damaged", _DELETE):
            wanted = "float" if header.is_float else header.format
            pixels = reader.read_image(0, 0, 0, header.channels, wanted)
            if pixels is None:
                raise ValueError(reader.geterror() or "its pixels cannot be read")
            pixels = np.asarray(pixels)
            if pixels.shape != (header.height, header.width, header.channels):
                raise ValueError(f"its pixels are {pixels.shape}")
    finally:
        reader.close()
    return pixels


def _colours(pixels: np.ndarray, header: _Header) -> tuple[np.ndarray, np.ndarray | None]:
    """``[H, W, 3]`` of colour or grey pixels ``[H, W, C]``, and the alpha ``[H, W]`` if there is one."""
    alpha = pixels[..., header.alpha] if 0 <= header.alpha < header.channels else None
    colours = pixels[..., [k for k in range(header.channels) if k != header.alpha][:3]]
    if colours.shape[2] < 3:
        colours = np.repeat(colours[..., :1], 3, axis=2)
    return np.ascontiguousarray(colours), alpha


def read_picture(path: Path) -> np.ndarray:
    """``[H, W, 3]`` uint8 of a PNG or JPEG, display-referred, as it is stored.

    An alpha channel is ignored, never composited; EXIF's orientation is, too, as structure from motion
    ignores it. Raises ``FileMissingError``, ``FileDamagedError`` (neither of the two, truncated, more than
    8 bits a channel, no RGB, absurdly large).
    """
    return _open_picture(Path(path), READABLE, _as_rgb)


def read_png(path: Path) -> np.ndarray:
    """As ``read_picture``, PNG only."""
    return _open_picture(Path(path), ("PNG",), _as_rgb)


def _as_rgb(picture: Image.Image) -> np.ndarray:
    return np.array(picture.convert("RGB"))


def _as_rgb_and_alpha(picture: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    if not picture.has_transparency_data:
        return _as_rgb(picture), None
    both = np.array(picture.convert("RGBA"))
    return np.ascontiguousarray(both[..., :3]), both[..., 3] / 255.0


def _open_picture(path: Path, formats: tuple[str, ...], look: Callable[[Image.Image], T]) -> T:
    """What ``look`` sees in a picture whose header can be believed."""
    regular_file(path, _RESTORE)
    kinds = " or ".join(formats)
    unreadable = damaged_where_it_fails(f"{path} is not a readable {kinds}", _DELETE)
    with unreadable, open_with_pillow(path, formats) as picture:
        width, height = picture.size
        if width * height > MAX_PIXELS:
            raise ValueError(f"it claims {width}×{height} pixels")
        if picture.mode not in EIGHT_BIT_MODES:
            raise FileDamagedError(
                f"{path} is not an 8-bit colour {kinds} (Pillow's mode {picture.mode})",
                "Save it again as 8-bit RGB or RGBA.",
            )
        size = path.stat().st_size
        if picture.format == "PNG" and width * height * PNG_BITS.get(picture.mode, 1) > (
            8 * MAX_DEFLATE_RATIO * size
        ):
            raise ValueError(f"it claims {width}×{height} pixels in {size} bytes")
        return look(picture)


def open_with_pillow(path: Path, formats: tuple[str, ...]) -> Image.Image:
    """An open picture of which the header is read; raises ``DecompressionBombError`` where Pillow does.

    That is at 179 million pixels. Its warning from half of them on is not shown: it means nothing to who took
    them.
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

    A renderer may have left out what is empty, or rendered a region: around these data there is 0.
    ``wanted``: of its first part, and those of the ``optional`` that it has; without them all channels of its
    only part. ``remedy``: the hint where the file is not there. Raises ``FileMissingError``;
    ``FileDamagedError`` if it is no OpenEXR, truncated, deep, claims more than the file can hold, or lacks a
    channel.
    """
    regular_file(path, remedy)
    headers = _exr_parts(path, header_only=True)
    if len(headers) != 1 and not (headers and wanted):  # none is what a damaged file may come back as
        raise _damaged_exr(path, f"it holds {len(headers)} pictures")
    claims = _exr_claims(path, headers)
    width, height, names = claims[0]
    if not names or not set(wanted) <= set(names):
        raise _damaged_exr(path, f"it has no channels {', '.join(wanted)} but {sorted(names)}")
    parts = _exr_parts(path, header_only=False)
    if len(parts) != len(claims) or set(parts[0].channels) != set(names):
        raise _damaged_exr(path, "it is truncated: channels are missing")
    planes = {}
    for name in (*wanted, *(name for name in optional if name in names)) if wanted else names:
        with damaged_where_it_fails(f"{path} is not a readable OpenEXR picture: channel {name}", _DELETE):
            planes[name] = np.asarray(parts[0].channels[name].pixels).astype(np.float32)
        if planes[name].shape != (height, width):
            shape = planes[name].shape
            raise _damaged_exr(path, f"channel {name} is {shape}, the header says {(height, width)}")
    frame = _exr_frame(path, headers[0].header)
    return {name: frame.around(plane) for name, plane in planes.items()}


@dataclass(frozen=True)
class _ExrFrame:
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


def _exr_frame(path: Path, header: dict[str, Any]) -> _ExrFrame:
    with damaged_where_it_fails(f"{path} is not a readable OpenEXR picture: its windows", _DELETE):
        (x0, y0), (x1, y1) = (np.asarray(corner).tolist() for corner in header["displayWindow"])
        left, top = np.asarray(header["dataWindow"][0]).tolist()
    frame = _ExrFrame(x1 - x0 + 1, y1 - y0 + 1, left - x0, top - y0)
    if frame.width < 1 or frame.height < 1 or frame.width * frame.height > MAX_PIXELS:
        raise _damaged_exr(path, f"its display window has {frame.width}×{frame.height} pixels")
    return frame


def _exr_parts(path: Path, header_only: bool) -> list[Any]:
    """The parts of a file; one that cannot be read is without its channels.

    The binding warns of that in Python's stdout, where what a program tells other programs goes; the error
    that comes of it says as much.
    """
    with (
        damaged_where_it_fails(f"{path} is not a readable OpenEXR picture", _DELETE),
        _stdout_lock,
        redirect_stdout(cast(TextIO, _OfOtherThreads(sys.stdout))),
    ):
        return list(OpenEXR.File(str(path), separate_channels=True, header_only=header_only).parts)


def _exr_claims(path: Path, headers: Sequence[Any]) -> list[tuple[int, int, list[str]]]:
    """``_exr_claim`` of each part; raises ``FileDamagedError`` where the file is too small for it."""
    claims = [_exr_claim(path, part.header) for part in headers]
    size = path.stat().st_size
    for width, height, names in claims:
        most = min(MAX_PIXELS, size * MAX_PIXELS_PER_BYTE, size * MAX_VALUES_PER_BYTE // max(len(names), 1))
        if width < 1 or height < 1 or width * height > most:
            claim = f"it claims {width}×{height} pixels of {len(names)} channels in {size} bytes"
            raise _damaged_exr(path, claim)
    return claims


def _exr_size(path: Path) -> tuple[int, int]:
    headers = _exr_parts(path, header_only=True)
    if not headers:
        raise _damaged_exr(path, "it holds no picture")
    _exr_claims(path, headers)
    frame = _exr_frame(path, headers[0].header)
    return frame.width, frame.height


def exr_chromaticities(path: Path) -> Chromaticities | None:
    """What an OpenEXR's attribute says of the primaries; None where there is none.

    Raises ``FileDamagedError`` where it is no eight numbers.
    """
    told = _exr_parts(path, header_only=True)[0].header.get("chromaticities")
    if told is None:
        return None
    with damaged_where_it_fails(f"{path} is not a readable OpenEXR picture: its chromaticities", _DELETE):
        x = [float(value) for value in np.asarray(told, np.float64).reshape(8)]
        return Chromaticities((x[0], x[1]), (x[2], x[3]), (x[4], x[5]), (x[6], x[7]))


def _exr_claim(path: Path, header: dict[str, Any]) -> tuple[int, int, list[str]]:
    """Width, height and channels that a part's header tells of."""
    with damaged_where_it_fails(
        f"{path} is not a readable OpenEXR picture: its header means nothing", _DELETE
    ):
        if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise ValueError("it is deep, with any number of values a pixel")
        tile = header.get("tiles")
        if tile is not None and tile.xSize * tile.ySize > LARGEST_TILE:
            raise ValueError(f"a tile of {tile.xSize}×{tile.ySize} pixels")
        (x0, y0), (x1, y1) = (np.asarray(corner).tolist() for corner in header["dataWindow"])
        return x1 - x0 + 1, y1 - y0 + 1, [channel.name for channel in header.get("channels", [])]


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

    The header tells the colour space; ``attributes`` go into it as strings. Raises ``OutputError`` or
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
