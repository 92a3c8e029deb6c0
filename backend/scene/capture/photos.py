# SPDX-License-Identifier: GPL-3.0-or-later
"""A user's photos: which there are, what their EXIF says, their pixels. Nothing here writes."""

import itertools
import math
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ExifTags, Image, TiffImagePlugin

from ....bridge.errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError
from ....bridge.regular import damaged_where_it_fails, require_text
from ....bridge.srgb import to_srgb
from ..encoding import LARGEST
from ..exif import LYING, Exif, Tags, exposure_of, orientation_of, positive, tags_of, tags_of_file
from ..icc import Profile, profile_of, profile_of_bytes
from ..pictures import holds_radiance, is_deep, open_with_pillow, picture_size, read_codes
from ..source import is_white, turned
from . import heif, raw
from .noise import Noise
from .remedies import COPY_AGAIN

JPEG_SUFFIXES = (".jpg", ".jpeg")
SUFFIXES = (*JPEG_SUFFIXES, ".png", ".tif", ".tiff", *heif.SUFFIXES)
#: Suffixes in the order in which equally many are preferred: what cameras write, then what programs export.
BEFORE_EXPORTS = (*raw.SUFFIXES, *JPEG_SUFFIXES, ".heic", ".heif", ".hif", ".png", ".tif", ".tiff", ".avif")
#: What Pillow opens for us, whatever a file is called.
PILLOW = ("JPEG", "PNG", "TIFF", "AVIF")
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".m2ts", ".insv", ".360", ".lrv")
#: Pillow's modes of 8 bits a channel that become RGB without loss; alpha is ignored, never composited.
EIGHT_BIT_MODES = ("L", "LA", "P", "RGB", "RGBA", "RGBX")
#: The width of 35 mm film in millimetres, to which FocalLengthIn35mmFilm refers.
FILM_WIDTH = 36.0
#: A picture that is less wide does not show all around: it is a test's, or an icon.
LEAST_AROUND = 1000
#: EXIF's ExposureMode of automatic bracketing.
AUTO_BRACKET = 2
#: Beside or in the folder of photos: NAME.png is black where NAME.jpg is not to be looked at.
MASKS = "masks"
MASK_SUFFIXES = (".png", *JPEG_SUFFIXES, ".tif", ".tiff")

FRAMES_OF_A_VIDEO = (
    "Take single frames of it, two a second: ffmpeg -i {video} -vf fps=2 -qscale:v 2 FOLDER/%04d.jpg, then "
    "physhdr prepare FOLDER --same-exposure."
)
FLAT_VIEWS = (
    "Cut 360° pictures into flat views first, four of 90° each: ffmpeg -i {photo} -vf "
    "v360=e:flat:h_fov=90:v_fov=90:yaw=0 NAME_0.jpg, with yaw 90, 180 and 270 for the others, and prepare "
    "those with --exposures FILE (or --same-exposure)."
)


@dataclass(frozen=True)
class Photo:
    """A photo and what its EXIF says; None where it says nothing.

    ``width, height``: pixels, turned upright. ``taken``: when. ``shutter``: seconds. ``iso``: as is.
    ``f_number``: focal length / aperture. ``focal_35mm``: millimetres on 35 mm film; ``focal``: the lens's.
    ``digital_zoom``: how many times a crop was enlarged (1: not). ``bias``, ``brightness``: as ``exif.Exif``.
    ``camera``: maker and model. ``auto_bracket``: that it was taken by automatic bracketing. ``panorama``:
    that it shows all around. ``mask``: a picture that is black where it is not to be looked at. ``group``: of
    photos under one light, by name; empty: under the standard one.
    ``white_balance``: of a raw file, the factors of red, green and blue that it is developed with; None: a
    picture. ``noise``: what a raw file tells of it. ``deep``: of a picture, that it has more than 8 bits a
    channel. ``orientation``: how the file stores it, 1 to 8 as in EXIF (1: upright; so is every HEIC).
    ``is_heic``: that libheif decodes it. ``profile``: of a picture, from whose primaries it is converted to
    sRGB's; None: it has these, or says nothing, or cannot be converted, and ``unconverted`` says why.
    """

    path: Path
    width: int
    height: int
    taken: datetime | None = None
    shutter: float | None = None
    iso: float | None = None
    f_number: float | None = None
    focal_35mm: float | None = None
    focal: float | None = None
    digital_zoom: float = 1.0
    bias: float | None = None
    brightness: float | None = None
    camera: str | None = None
    auto_bracket: bool = False
    panorama: bool = False
    mask: Path | None = None
    white_balance: tuple[float, float, float] | None = None
    noise: Noise | None = None
    deep: bool = False
    orientation: int = 1
    is_heic: bool = False
    profile: Profile | None = None
    unconverted: str = ""
    group: str = ""

    @property
    def name(self) -> str:
        """Of one photo alone: two folders may have files of one name."""
        return f"{self.group}/{self.path.name}" if self.group else self.path.name

    @property
    def stem(self) -> str:
        """The name without its suffix."""
        return f"{self.group}/{self.path.stem}" if self.group else self.path.stem

    @property
    def is_raw(self) -> bool:
        return self.white_balance is not None

    @property
    def exif(self) -> Exif:
        return Exif(self.shutter, self.iso, self.f_number, self.bias, self.brightness)

    @property
    def lens(self) -> tuple[int, int, float | None, float | None, float]:
        """Photos of one value were taken through the same lens the same way up.

        Width and height, ``focal``, ``focal_35mm``, ``digital_zoom``. A phone crops for its digital zoom and
        enlarges to the same size, with the same ``focal``: some tell it by ``focal_35mm`` alone, others by
        ``digital_zoom`` alone.
        """
        focal = None if self.focal is None else round(self.focal, 1)
        return self.width, self.height, focal, self.focal_35mm, round(self.digital_zoom, 2)

    @property
    def focal_pixels(self) -> float | None:
        """The focal length in pixels that EXIF tells, a first guess for structure from motion."""
        return (
            None if self.focal_35mm is None else self.focal_35mm / FILM_WIDTH * max(self.width, self.height)
        )

    def decode(self) -> Image.Image:
        """The picture as people look at it: RGB, 8 bits, upright; raises ``FileDamagedError``."""
        if self.is_raw:
            return Image.fromarray(_shown(self.developed().picture))
        if self.deep:
            return Image.fromarray(np.rint(self._read_codes() / 257.0).astype(np.uint8))
        if self.is_heic:
            return Image.fromarray(self._read_codes())
        unreadable = damaged_where_it_fails(f"{self.path} is not a readable photo", COPY_AGAIN)
        with unreadable, open_with_pillow(self.path, PILLOW) as picture:
            codes = _upright(picture, "RGB", self.orientation)
        return Image.fromarray(codes if self.profile is None else self.profile.to_srgb(codes))

    def developed(self, half: bool = False) -> raw.Developed:
        """Of a raw file; raises ``FileDamagedError``. ``half``: half the size, in a quarter of the time."""
        assert self.white_balance is not None
        developed = raw.develop(self.path, self.white_balance, half)
        height, width = developed.picture.shape[:2]
        if not half and (width, height) != (self.width, self.height):
            raise FileDamagedError(
                f"{self.path} is {width}×{height}, not {self.width}×{self.height} as its header says",
                COPY_AGAIN,
            )
        return developed

    def codes(self, shorter: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
        """``[H, W, 3]`` as a data set has it, and ``[H, W]`` bool, True where it is to be compared (or None).

        uint8 or uint16 as the camera or a raw converter wrote it, or uint16, linear, of a raw file.
        ``shorter``: whether there is a shorter exposure of the same place, so that nothing is lost where a
        raw file's colour is wrong.
        """
        keep = self.keep()
        if self.deep or self.is_heic:
            return self._read_codes(), keep
        if not self.is_raw:
            return np.asarray(self.decode()), keep
        developed = self.developed()
        if shorter and developed.partly.any():
            keep = ~developed.partly if keep is None else keep & ~developed.partly
        return np.rint(developed.picture * np.float32(raw.FULL)).astype(np.uint16), keep

    def _read_codes(self) -> np.ndarray:
        """Of what Pillow does not decode; uint16 where the photo is ``deep``."""
        with _remedy_of_photos():
            if self.is_heic:
                codes = heif.read_codes(self.path, self.width, self.height)
            else:
                codes = turned(read_codes(self.path)[0], self.orientation)
        if self.deep and codes.dtype == np.uint8:
            codes = codes * np.uint16(257)
        return codes if self.profile is None else self.profile.to_srgb(codes)

    def keep(self) -> np.ndarray | None:
        """``[H, W]`` bool, True where the photo is to be looked at; None without a mask.

        Raises ``FileDamagedError`` and ``DataMismatchError`` (a mask of another size).
        """
        if self.mask is None:
            return None
        if _is_deep(self.mask):  # Pillow's grey clips what is above 255
            with _remedy_of_photos():
                codes = read_codes(self.mask)[0]
            shades = turned(codes, orientation_of(tags_of_file(self.mask))).max(axis=2)
        else:
            unreadable = damaged_where_it_fails(f"{self.mask} is not a readable mask", COPY_AGAIN)
            with unreadable, open_with_pillow(self.mask, PILLOW) as picture:
                shades = _upright(picture, "RGB", orientation_of(tags_of(picture))).max(axis=2)
        self._require_size(shades.shape[1], shades.shape[0])
        return is_white(shades, LARGEST[shades.dtype])

    def check_mask(self) -> None:
        """Raises what ``keep`` does, as far as the mask's header shows it."""
        if self.mask is None:
            return
        with damaged_where_it_fails(f"{self.mask} is not a readable mask", COPY_AGAIN):
            if _is_deep(self.mask):
                (width, height), tags = picture_size(self.mask), tags_of_file(self.mask)
            else:
                with open_with_pillow(self.mask, PILLOW) as picture:
                    (width, height), tags = _stored_size(picture), tags_of(picture)
        lies = orientation_of(tags) in LYING
        self._require_size(*((height, width) if lies else (width, height)))

    def _require_size(self, width: int, height: int) -> None:
        """Of its mask, upright; raises ``DataMismatchError``."""
        if (width, height) != (self.width, self.height):
            raise DataMismatchError(
                f"the mask {self.mask} is {width}×{height}, its photo {self.name} is "
                f"{self.width}×{self.height}",
                "Make it at the photo's size and the same way up, or remove it.",
            )

    def copy(self, side: int) -> Image.Image:
        """``decode`` for structure from motion: of a raw file at least ``side`` wide or high, if it is."""
        if self.is_raw and max(self.width, self.height) >= 2 * side:
            return Image.fromarray(_shown(self.developed(half=True).picture))
        return self.decode()

    def thumbnail(self, side: int = 256) -> np.ndarray:
        """``[h, w, 3]`` uint8 at most ``side`` wide and high, by picking pixels, so that clipping stays."""
        pixels = np.asarray(self.copy(side))
        step = max(1, math.ceil(max(pixels.shape[:2]) / side))
        return pixels[::step, ::step]


@contextmanager
def _remedy_of_photos() -> Iterator[None]:
    """A data set's files are made again where they are damaged, a photo is not."""
    try:
        yield
    except FileDamagedError as error:
        raise FileDamagedError(error.message, COPY_AGAIN) from error


def _upright(picture: Image.Image, mode: str, orientation: int) -> np.ndarray:
    """The pixels in Pillow's ``mode``, turned as EXIF's ``orientation`` says; a TIFF's Pillow turns itself.

    ``ImageOps.exif_transpose`` would write all of EXIF again, which fails where a tag is of an unusual type.
    """
    pixels = np.asarray(picture.convert(mode))
    return pixels if isinstance(picture, TiffImagePlugin.TiffImageFile) else turned(pixels, orientation)


def _shown(linear: np.ndarray) -> np.ndarray:
    return np.rint(to_srgb(linear) * 255.0).astype(np.uint8)


class UnreadKindError(FileDamagedError):
    """A file is sound, but of a kind that no camera's photo is of: no bracket lacks it."""


@dataclass(frozen=True)
class Skipped:
    """A file in the folder that is not used, and why."""

    name: str
    why: str


@dataclass(frozen=True)
class Found:
    """The photos of a folder in the order of names; what is ``skipped``; ``notes`` for people to read, and
    ``warnings``.

    ``damaged``: those of the skipped that should have been photos, of which nothing but the name is known;
    not files of another kind, which have no place in the order of photos.
    """

    photos: list[Photo]
    skipped: list[Skipped]
    notes: list[str]
    damaged: list[Photo]
    warnings: list[str] = field(default_factory=list)


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """A sort key under which ``img_9`` comes before ``img_10``."""
    parts = re.findall(r"\d+|\D+", name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def alike(name: str) -> str:
    """Equal for names that differ only in case, or in how a system spells an accent (macOS: by two)."""
    return unicodedata.normalize("NFC", name).casefold()


def find_photos(
    folder: Path,
    done: Callable[[int, int], None] = lambda photos, of: None,
    lit: Mapping[str, Path] | None = None,
) -> Found:
    """Every photo in ``folder`` (not below it), in the order of names, with its EXIF. Headers only.

    Of several files of the same stem one is taken: the raw file, or the HEIC before the JPEG, or of the kind
    of which there are more. Damaged files, videos, 360° pictures and other cameras' photos are skipped.
    ``done`` is told after every file. ``lit``: folders of photos under other light by the name of their
    group, which follow in this order; the kind, camera and white balance are those of ``folder``'s photos.

    Raises ``FileMissingError`` (no folder, no photos in it, no library for raw files or HEIC),
    ``FileDamagedError`` (no file can be read, a mask cannot), ``DataMismatchError`` (all are 360° pictures, a
    mask is of another size than its photo), ``BadValueError`` (a name that is not UTF-8).
    """
    notes: list[str] = []
    folders = [_Folder(group, place, notes) for group, place in {"": folder, **(lit or {})}.items()]
    total, read = sum(len(each.paths) for each in folders), itertools.count(1)
    photos: list[Photo] = []
    skipped: list[Skipped] = []
    damaged: list[Photo] = []
    for each in folders:
        photos += each.read(skipped, damaged, lambda: done(next(read), total))
        skipped += each.videos(notes)
    photos = _flat(photos, skipped)
    photos = _of_one_kind(photos, skipped)
    photos = _of_one_camera(photos, skipped)
    masks = {each.group: _masks(each.place, beside=not each.group) for each in folders}
    photos = [_with_mask(photo, masks[photo.group]) for photo in photos]
    if photos[0].is_raw:
        photos, note = _one_white_balance(photos)
        notes.append(note)
    told, warnings = _of_profiles(photos)
    notes += told
    for each in folders:
        warnings += _without_photo(masks[each.group], each.paths)
    used = [photo for photo in damaged if (_family(photo.path) == "raw") == photos[0].is_raw]
    return Found(photos, skipped, notes, used, warnings)


class _Folder:
    """A folder of photos, those of a ``group`` (empty: the standard light), and what else is in it.

    Raises ``FileMissingError`` where it does not exist or holds no photos, or for a library that is not
    installed, ``BadValueError`` for a name that is not UTF-8. ``notes`` takes what is said of copies.
    """

    def __init__(self, group: str, place: Path, notes: list[str]) -> None:
        self.group, self.place = group, place
        if not place.is_dir():
            raise FileMissingError(
                f"the folder of photos {place} does not exist", "Give the folder they are in."
            )
        self.files = sorted(
            (path for path in place.iterdir() if path.is_file() and not path.name.startswith(".")),
            key=lambda path: natural_order(path.name),
        )
        paths = [path for path in self.files if is_photo(path)]
        if not paths:
            raise FileMissingError(
                f"{place} holds no photos{_what_else(place, self.files)}", _remedy(self.files)
            )
        videos = (path for path in self.files if path.suffix.lower() in VIDEO_SUFFIXES)
        _require_text_names([*paths, *videos])
        self.paths = _one_of_each(paths, notes)
        _require_libraries(self.paths)

    def read(self, skipped: list[Skipped], damaged: list[Photo], done: Callable[[], None]) -> list[Photo]:
        """The photos that can be read; raises ``FileDamagedError`` where none can."""
        photos: list[Photo] = []
        errors: list[FileDamagedError] = []
        for path in self.paths:
            nothing_known = Photo(path, 0, 0, group=self.group)
            try:
                photos.append(replace(_read_header(path), group=self.group))
            except FileDamagedError as error:
                errors.append(error)
                if not isinstance(error, UnreadKindError):
                    damaged.append(nothing_known)
                skipped.append(Skipped(nothing_known.name, _why(error, path)))
            done()
        if not photos:
            raise errors[0]
        return photos

    def videos(self, notes: list[str]) -> list[Skipped]:
        return _videos(self.files, {path.stem for path in self.paths}, notes)


def is_photo(path: Path) -> bool:
    """By its suffix."""
    return path.suffix.lower() in (*SUFFIXES, *raw.SUFFIXES)


def holds_photos(folder: Path) -> bool:
    """Whether a photo lies in ``folder``, by suffixes; False where it cannot be looked at."""
    try:
        return any(is_photo(path) and not path.name.startswith(".") for path in folder.iterdir())
    except OSError:
        return False


def _standard(photos: list[Photo]) -> list[Photo]:
    """Those of no group, by which all are judged; all where there are none."""
    return [photo for photo in photos if not photo.group] or photos


def _of_profiles(photos: Sequence[Photo]) -> tuple[list[str], list[str]]:
    """What is converted, as notes; and as warnings what cannot be."""
    named = Counter(photo.profile.name for photo in photos if photo.profile is not None)
    reasons = Counter(photo.unconverted for photo in photos if photo.unconverted)
    of = f"of {len(photos)} photos"
    return [
        f"{count} {of} have the colour profile '{name}': converted to sRGB's primaries"
        for name, count in named.most_common()
    ], [f"treating {count} {of} as sRGB: {why}" for why, count in reasons.most_common()]


def _require_text_names(paths: Sequence[Path]) -> None:
    """Raises ``BadValueError`` for names that are not UTF-8: prepare.json could not be read again."""
    bad = []
    for path in paths:
        try:
            require_text(path.name)
        except BadValueError:
            bad.append(path.name)
    if bad:
        named = f"{bad[0]!a} has a name" if len(bad) == 1 else f"{len(bad)} files ({bad[0]!a} …) have names"
        raise BadValueError(
            f"{named} with bytes that are not UTF-8",
            "Rename the files: old archives spell letters such as ü in another encoding.",
        )


def _one_of_each(paths: list[Path], notes: list[str]) -> list[Path]:
    """Without the copies that a camera or a program made of a photo.

    A program makes an AVIF of a JPEG, a camera or a phone a JPEG of a HEIC.
    """
    stems: dict[str, set[str]] = {"raw": set(), "HEIC": set(), "JPEG": set()}
    for path in paths:
        stems.get(_family(path), set()).add(path.stem)
    kept, copies = [], Counter[str]()
    for path in paths:
        family = _family(path)
        if family != "raw" and path.stem in stems["raw"]:
            copies["raw file and as picture: the raw files are used"] += 1
        elif family == "JPEG" and path.stem in stems["HEIC"]:
            copies["HEIC and as JPEG: the HEIC files are used"] += 1
        elif family == "AVIF" and path.stem in stems["HEIC"] | stems["JPEG"]:
            copies["AVIF and as HEIC or JPEG: the latter are used"] += 1
        else:
            kept.append(path)
    kept = _of_one_suffix(kept, copies)
    notes += [f"{count} photos are there as {what}" for what, count in copies.items()]
    return kept


def _of_one_suffix(paths: list[Path], copies: Counter[str]) -> list[Path]:
    """Of files that share a stem, photos and what a program exported of them, those of the commonest suffix.

    Two kinds side by side would have two responses, and as photos of one time would be no brackets. One that
    cannot be read gives way to its twin.
    """
    twins: dict[str, list[Path]] = {}
    for path in paths:
        twins.setdefault(path.stem, []).append(path)
    # What is named as none of the twins, a chart among photos, does not count.
    named = {_without_numbers(stem) for stem, files in twins.items() if len(files) > 1}
    there = Counter(path.suffix.lower() for path in paths if _without_numbers(path.stem) in named)

    def rank(path: Path) -> tuple[int, int]:
        suffix = path.suffix.lower()
        return -there[suffix], BEFORE_EXPORTS.index(suffix)

    used = set()
    for files in twins.values():
        best, *others = sorted(files, key=rank)
        why = ""
        if others and _is_damaged(best) and (sound := [path for path in others if not _is_damaged(path)]):
            others = [path for path in (best, *others) if path is not sound[0]]
            best, why = sound[0], f", for {best.name} cannot be read"
        used.add(best)
        for path in others:
            copies[f"{best.suffix} and as {path.suffix}: the {best.suffix} files are used{why}"] += 1
    return [path for path in paths if path in used]


def _without_numbers(stem: str) -> str:
    return re.sub(r"\d+", "", stem)


def _is_damaged(path: Path) -> bool:
    """Whether a header cannot be read; a library that is not there is not the file's fault."""
    try:
        _read_header(path)
    except FileDamagedError:
        return True
    except FileMissingError:
        return False
    return False


def _family(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix in raw.SUFFIXES:
        return "raw"
    if suffix in heif.SUFFIXES:
        return "AVIF" if suffix == ".avif" else "HEIC"
    return "JPEG" if suffix in JPEG_SUFFIXES else "picture"


def _require_libraries(paths: list[Path]) -> None:
    """Raises ``FileMissingError`` where one is not installed that a file needs, whatever it is called."""
    if any(_family(path) == "raw" for path in paths):
        raw.require_rawpy()
    kinds = {heif.kind_of_heif(path) for path in paths if _family(path) != "raw"}
    if "HEIC" in kinds:
        heif.require_pillow_heif()
    if "AVIF" in kinds:
        heif.require_avif()


def _why(error: FileDamagedError, path: Path) -> str:
    """Why a photo is left out, with the remedy where there is another than to copy it again."""
    why = error.message.removeprefix(f"{path} ")
    return why if error.hint == COPY_AGAIN else f"{why}. {error.hint}"


def _what_else(folder: Path, files: list[Path]) -> str:
    count = sum(path.suffix.lower() in VIDEO_SUFFIXES for path in files)
    if count:
        return f", but {count} videos"
    below = [sub.name for sub in sorted(folder.iterdir()) if sub.is_dir()]
    return f" itself, only folders ({', '.join(below[:3])}{' …' if len(below) > 3 else ''})" if below else ""


def _remedy(files: list[Path]) -> str:
    for path in files:
        if path.suffix.lower() in VIDEO_SUFFIXES:
            return FRAMES_OF_A_VIDEO.format(video=path.name)
    return "Put all photos, JPEG, HEIC, PNG, TIFF or a camera's raw files, into one folder and give that."


def _videos(files: Sequence[Path], stems: set[str], notes: list[str]) -> list[Skipped]:
    """The videos, but for those that a phone takes with each photo, under its name."""
    videos = [path for path in files if path.suffix.lower() in VIDEO_SUFFIXES]
    moving = [path for path in videos if path.stem in stems]
    if moving:
        notes.append(f"{len(moving)} videos have a photo's name (live photos): they are not looked at")
    return [
        Skipped(path.name, f"is a video. {FRAMES_OF_A_VIDEO.format(video=path.name)}")
        for path in videos
        if path.stem not in stems
    ]


def _flat(photos: list[Photo], skipped: list[Skipped]) -> list[Photo]:
    """Without pictures that show all around; raises ``DataMismatchError`` where all do."""
    around = [photo for photo in photos if photo.panorama]
    if len(around) == len(photos):
        raise DataMismatchError(
            f"the {len(photos)} photos are 360° pictures ({photos[0].name} is {photos[0].width}×"
            f"{photos[0].height}), which no lens takes",
            FLAT_VIEWS.format(photo=photos[0].name),
        )
    skipped += [Skipped(photo.name, "is a 360° picture") for photo in around]
    return [photo for photo in photos if not photo.panorama]


def _of_one_kind(photos: list[Photo], skipped: list[Skipped]) -> list[Photo]:
    """Raw files or pictures, whichever are more: their codes mean different things."""
    kinds = Counter(photo.is_raw for photo in _standard(photos))
    kept = kinds[True] >= kinds[False]
    what = "raw files" if kept else "pictures"
    skipped += [
        Skipped(photo.name, f"is a {'picture' if kept else 'raw file'}, most others are {what}")
        for photo in photos
        if photo.is_raw != kept
    ]
    return [photo for photo in photos if photo.is_raw == kept]


def _of_one_camera(photos: list[Photo], skipped: list[Skipped]) -> list[Photo]:
    """Those of the camera that took most: another one has another response, of which nothing is known."""
    if len({photo.camera for photo in photos} - {None}) < 2:
        return photos
    judged = [photo for photo in photos if photo.camera is not None]
    main = Counter(photo.camera for photo in _standard(judged)).most_common(1)[0][0]
    skipped += [
        Skipped(photo.name, f"was taken by {photo.camera}, most others by {main}: prepare them by themselves")
        for photo in photos
        if photo.camera not in (None, main)
    ]
    return [photo for photo in photos if photo.camera in (None, main)]


def _one_white_balance(photos: list[Photo]) -> tuple[list[Photo], str]:
    """All are developed with that of the photo whose own is the middle one."""
    judged = _standard(photos)
    own = [photo.white_balance for photo in judged if photo.white_balance is not None]
    chosen = raw.common_white_balance(own)
    factors = ", ".join(f"{factor:.3f}" for factor in own[chosen])
    others = "" if len(set(own)) == 1 else f", the middle one of {len(set(own))}"
    words = f"white balance (red, green, blue) {factors}: the camera's in {judged[chosen].name}{others}"
    return [replace(photo, white_balance=own[chosen]) for photo in photos], words


def _masks(folder: Path, beside: bool) -> dict[str, list[Path]]:
    """The pictures in ``masks/`` in the photos' folder, also ``beside`` it, by their stems as ``alike``."""
    masks: dict[str, list[Path]] = {}
    whole = Path(os.path.abspath(folder))  # "." has no parent
    for place in (folder / MASKS, whole.parent / MASKS)[: 1 + beside]:
        for path in sorted(place.iterdir()) if place.is_dir() and place != whole else ():
            if path.suffix.lower() in MASK_SUFFIXES and not path.name.startswith(".") and path.is_file():
                masks.setdefault(alike(path.stem), []).append(path)
    return masks


def _mask_of(path: Path, masks: Mapping[str, list[Path]]) -> Path | None:
    """``NAME.png`` or ``NAME.jpg.png``; or else what is called so but for case, accents and its suffix.

    One in the photos' folder goes before one beside it.
    """
    exact = f"{path.stem}.png", f"{path.name}.png"
    fitting = [mask for name in (path.stem, path.name) for mask in masks.get(alike(name), ())]
    return min(
        fitting, key=lambda mask: (mask.name not in exact, mask.parent != path.parent / MASKS), default=None
    )


def _with_mask(photo: Photo, masks: Mapping[str, list[Path]]) -> Photo:
    """Raises what ``Photo.check_mask`` does."""
    photo = replace(photo, mask=_mask_of(photo.path, masks))
    photo.check_mask()
    return photo


def _without_photo(masks: Mapping[str, list[Path]], paths: Sequence[Path]) -> list[str]:
    """A sentence for each folder of masks with some that are called as no photo."""
    names = {alike(name) for path in paths for name in (path.stem, path.name)}
    stray: dict[Path, list[str]] = {}
    for stem, files in masks.items():
        for mask in files if stem not in names else ():
            stray.setdefault(mask.parent, []).append(mask.name)
    return [
        f"{len(strays)} masks in {folder} are called as no photo is, and not used ({min(strays)}"
        f"{' …' if len(strays) > 1 else ''}): NAME.png is the mask of NAME.jpg"
        for folder, strays in stray.items()
    ]


def _read_header(path: Path) -> Photo:
    if path.suffix.lower() in raw.SUFFIXES:
        return _read_raw_header(path)
    kind = heif.kind_of_heif(path)
    if kind == "HEIC":
        return _read_heic_header(path)
    if kind is None and _is_deep(path):
        with _remedy_of_photos():
            return _read_deep_header(path)
    if kind is None and _holds_radiance(path):
        raise UnreadKindError(
            f"{path} holds radiance (floats), as a picture that was merged from a bracket does",
            "Give the photos that it was merged from: this picture is not needed.",
        )
    profile, unconverted = (heif.avif_profile(path), "") if kind == "AVIF" else profile_of(path)
    unreadable = damaged_where_it_fails(f"{path} is not a readable photo", COPY_AGAIN)
    with unreadable, _not_too_large(path), open_with_pillow(path, PILLOW) as picture:
        if picture.mode not in EIGHT_BIT_MODES:
            raise UnreadKindError(
                f"{path} is not an RGB picture of 8 or 16 bits (Pillow's mode {picture.mode})",
                "Save it again as JPEG, PNG or TIFF with 8 or 16 bits a channel, RGB.",
            )
        width, height = _stored_size(picture)
        tags = tags_of(picture)
        xmp = picture.info.get("xmp", b"")
        if kind == "AVIF" and picture.info.get("icc_profile"):
            profile, unconverted = profile_of_bytes(picture.info["icc_profile"])
    orientation = orientation_of(tags)
    if orientation in LYING:
        width, height = height, width
    photo = Photo(path, width, height, orientation=orientation, profile=profile, unconverted=unconverted)
    return _marked_around(_with_tags(photo, tags, exposure_of(tags)), xmp)


def _read_heic_header(path: Path) -> Photo:
    """The way up is the file's own (ISO/IEC 23008-12), by libheif: EXIF's orientation counts for nothing."""
    header = heif.read_header(path)
    photo = Photo(path, header.width, header.height, deep=header.deep, is_heic=True)
    photo = replace(photo, profile=header.profile, unconverted=header.unconverted)
    return _marked_around(_with_tags(photo, header.tags, exposure_of(header.tags)), header.xmp)


def _marked_around(photo: Photo, xmp: Any) -> Photo:
    """With ``panorama``, which XMP tells, or two to one exactly, from nothing that has a focal length."""
    around = isinstance(xmp, bytes) and b"GPano" in xmp and b"equirectangular" in xmp
    around = around or (photo.width == 2 * photo.height and photo.focal_35mm is None and photo.focal is None)
    return replace(photo, panorama=around and photo.width > LEAST_AROUND)


def _is_deep(path: Path) -> bool:
    try:
        return is_deep(path)
    except FileDamagedError:  # it is said of the photo, in a photo's words
        return False


def _holds_radiance(path: Path) -> bool:
    try:
        return holds_radiance(path)
    except FileDamagedError:  # as above
        return False


def _read_deep_header(path: Path) -> Photo:
    """Of 16 bits a channel, as raw converters write them; Pillow knows no such colour, but the tags."""
    width, height = picture_size(path)
    tags = tags_of_file(path)
    orientation = orientation_of(tags)
    if orientation in LYING:
        width, height = height, width
    photo = Photo(path, width, height, deep=True, orientation=orientation)
    profile, unconverted = profile_of(path)
    photo = replace(photo, profile=profile, unconverted=unconverted)
    return _with_tags(photo, tags, exposure_of(tags))


@contextmanager
def _not_too_large(path: Path) -> Iterator[None]:
    """Say what is wrong where Pillow suspects an attack: some phones take 200 million pixels."""
    try:
        yield
    except Image.DecompressionBombError as error:
        most = 2 * (Image.MAX_IMAGE_PIXELS or 0)
        raise FileDamagedError(
            f"{path} has more pixels than are read ({error})",
            f"Take photos of {most // 10**6} million pixels at most, or make them smaller, keeping EXIF.",
        ) from error


def _stored_size(picture: Image.Image) -> tuple[int, int]:
    """Width and height as stored; Pillow has those of a TIFF turned upright already (since version 11)."""
    if isinstance(picture, TiffImagePlugin.TiffImageFile):
        return picture.tag_v2[ExifTags.Base.ImageWidth], picture.tag_v2[ExifTags.Base.ImageLength]
    return picture.size


def _read_raw_header(path: Path) -> Photo:
    header = raw.read_header(path)
    photo = Photo(path, header.width, header.height, orientation=header.orientation)
    photo = replace(photo, white_balance=header.white_balance, noise=header.noise)
    photo = _with_tags(photo, header.tags, header.exif)
    return replace(photo, taken=photo.taken or header.taken, focal=photo.focal or header.focal)


def _with_tags(photo: Photo, tags: Tags, exposure: Exif) -> Photo:
    named = (str(tags.get(tag, "")).strip(" \0") for tag in (ExifTags.Base.Make, ExifTags.Base.Model))
    return replace(
        photo,
        taken=_moment(tags),
        shutter=exposure.time,
        iso=exposure.iso,
        f_number=exposure.f_number,
        bias=exposure.bias,
        brightness=exposure.brightness,
        focal_35mm=positive(tags, ExifTags.Base.FocalLengthIn35mmFilm),
        focal=positive(tags, ExifTags.Base.FocalLength),
        digital_zoom=positive(tags, ExifTags.Base.DigitalZoomRatio) or 1.0,  # 0: it was not used
        camera=" ".join(name for name in named if name) or None,
        auto_bracket=tags.get(ExifTags.Base.ExposureMode) == AUTO_BRACKET,
    )


def _moment(tags: Tags) -> datetime | None:
    try:
        moment = datetime.strptime(
            str(tags[ExifTags.Base.DateTimeOriginal]).strip(" \0"), "%Y:%m:%d %H:%M:%S"
        )
    except (KeyError, ValueError):
        return None
    fraction = str(tags.get(ExifTags.Base.SubsecTimeOriginal, "")).strip(" \0")
    return moment + timedelta(seconds=float(f"0.{fraction}")) if fraction.isdecimal() else moment
