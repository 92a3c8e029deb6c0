# SPDX-License-Identifier: GPL-3.0-or-later
"""How the pictures of a data set encode light, in any layout: a camera's codes, linear values, radiance.

A reader finds files and cameras; this looks at what the files hold. Radiance (OpenEXR, .hdr, TIFF of floats)
is exposure × radiance of the exposure that the layout states, 1 s where it states none; its scale is one for
the whole data set. What ``physhdr prepare`` developed from raw files is linear, as its prepare.json says.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...bridge.data_set import CAPTURE_FILE, CAPTURE_FORMAT
from ...bridge.errors import BadValueError, PhysHDRError
from ...bridge.limits import RADIANCE_MAX
from ...bridge.regular import read_json_object
from .color_space import space_named
from .encoding import CAMERA, SRGB, Encoding, LogEncoding
from .icc import Profile, profile_by_exif, profile_bytes, read_profile
from .pictures import holds_radiance
from .scene import Scene, View
from .source import PictureSource, radiance_rec709

#: Only files of these suffixes may hold radiance: pictures of codes need not be opened for it.
SUFFIXES = (".exr", ".hdr", ".pic", ".rgbe", ".tif", ".tiff")
#: The scale of radiance is this share of the values, of so many of the pictures, looked at so densely.
SCALE_QUANTILE, SCALE_PICTURES, SCALE_PIXELS = 0.99, 24, 1 << 16
#: Layouts whose published convention ignores alpha and ICC profiles: codes as stored.
WITHOUT_ALPHA = ("PhysHDR", "HDR-NeRF-Syn", "HDR-NeRF-Real", "GaussHDR", "HDR-GS")
#: Of radiance: training renders no more than ``RADIANCE_MAX``, and what is bright needs room above it.
LARGEST_SCALE = RADIANCE_MAX / 16.0
#: The share of values below 0 that is reported.
WORTH_A_WORD = 1e-4


def with_encodings(scene: Scene, color_space: str | None = None) -> Scene:
    """The scene with the encoding of every picture source, and messages on what was found.

    ``color_space``: of radiance, by its name in ``color_space.NAMES``; None: as each file says, Linear
    Rec.709 where it says nothing. Sources whose encoding a reader has set stay as they are. Raises
    ``BadValueError`` for an unknown name, and for invalid radiance.
    """
    if color_space is not None:
        space_named(color_space)
    views = [view for views in scene.splits.values() for view in views]
    files = [s.path for view in views for s in view.sources if s.encoding == CAMERA]
    radiance = {path for path in dict.fromkeys(files) if _may_hold_radiance(path)}
    plain = _of_integers(scene.root)
    messages: list[str] = []
    log = CAMERA
    if radiance:
        log, messages = _scale(scene, radiance, color_space or "")
        counts = Counter(s.path in radiance for view in views for s in view.sources)
        mixed = f", {counts[False]} are a camera's" if counts[False] and plain == CAMERA else ""
        messages.insert(0, f"{counts[True]} pictures hold radiance{mixed}: {log}")
    elif color_space is not None:
        messages.append(f"--color-space {color_space} changes nothing: no picture holds radiance")
    if plain.is_known and len(radiance) < len(set(files)):
        messages.append("pictures are linear (developed raw files): the response is known, white is 1")
    alpha = scene.layout not in WITHOUT_ALPHA
    profiles: dict[Path, Profile] = {}
    if alpha and not plain.is_known:
        profiles, profile_messages = _profiles(
            [path for path in dict.fromkeys(files) if path not in radiance]
        )
        messages += profile_messages

    def meant(source: PictureSource) -> PictureSource:
        encoding = source.encoding
        if encoding == CAMERA:
            encoding = log if source.path in radiance else plain
        if encoding == source.encoding and not alpha:
            return source
        space = color_space or "" if source.path in radiance else ""
        profile = profiles.get(source.path)
        return replace(source, encoding=encoding, alpha=alpha, color_space=space, profile=profile)

    def made(views: Sequence[View]) -> list[View]:
        return [replace(view, sources=tuple(map(meant, view.sources))) for view in views]

    if not (radiance or plain.is_known or alpha or messages):
        return scene
    return replace(
        scene,
        train=made(scene.train),
        test=made(scene.test),
        lit=made(scene.lit),
        validation=made(scene.validation),
        lit_test=made(scene.lit_test),
        messages=(*scene.messages, *messages),
    )


def _profiles(files: Sequence[Path]) -> tuple[dict[Path, Profile], list[str]]:
    """The profiles of pictures that do not have sRGB's primaries, and messages on them."""
    raw = {path: found for path in files if (found := profile_bytes(path)) is not None}
    profiles, messages = {}, []
    for each, count in Counter(raw.values()).most_common():
        have = f"{count} of {len(files)} pictures have the ICC profile"
        try:
            profile = read_profile(each)
        except BadValueError as error:
            messages.append(f"{error.message} ({count} of {len(files)} pictures): treating them as sRGB")
            continue
        if not profile.is_srgb:
            profiles |= {path: profile for path, found in raw.items() if found == each}
            messages.append(f"{have} '{profile.name}': converted to sRGB's primaries")
    by_exif = {path: found for path in files if path not in raw and (found := profile_by_exif(path))}
    for name, count in Counter(profile.name for profile in by_exif.values()).items():
        messages.append(
            f"{count} of {len(files)} pictures are in {name} according to EXIF: converted to sRGB's"
        )
    return profiles | by_exif, messages


def _may_hold_radiance(path: Path) -> bool:
    try:
        return path.suffix.lower() in SUFFIXES and holds_radiance(path)
    except PhysHDRError:
        return False  # its reader reports what is wrong


def _of_integers(root: Path) -> Encoding:
    """How integers encode light: linear values where ``physhdr prepare`` says so, else a camera's codes."""
    path = root / CAPTURE_FILE
    if not path.is_file():
        return CAMERA
    content = read_json_object(path, "Prepare the data set again.")
    if content.get("format") != CAPTURE_FORMAT:
        return CAMERA
    match content.get("encoding", "camera"):
        case "camera":
            return CAMERA
        case "linear":
            return SRGB
        case other:
            raise BadValueError(
                f"{path}: 'encoding' is {other!r:.80}, which is neither 'camera' nor 'linear'",
                "Update PhysHDR, or prepare the data set again.",
            )


def _scale(scene: Scene, radiance: set[Path], color_space: str) -> tuple[Encoding, list[str]]:
    """The encoding of all radiance, and messages on its colours.

    From training pictures alone where they hold any.
    """

    def of(views: Sequence[View]) -> list[tuple[Path, float]]:
        each = (pair for view in views for pair in zip(view.image_paths, view.exposures, strict=True))
        return [(path, seconds) for path, seconds in each if path in radiance]

    pictures = of([*scene.train, *scene.lit]) or of([*scene.test, *scene.validation])
    some = [pictures[k] for k in np.unique(np.linspace(0, len(pictures) - 1, SCALE_PICTURES).astype(int))]
    values, outside, pixels, spaces = [], 0, 0, Counter()
    for path, _ in some:
        linear, words = radiance_rec709(path, color_space)
        spaces[words] += 1
        flat = linear.reshape(-1, 3)
        outside += int((flat < 0.0).any(axis=1).sum())
        pixels += len(flat)
        values.append(flat[:: max(1, len(flat) // SCALE_PIXELS)].max(axis=1))
    scale = float(np.quantile(np.concatenate(values), SCALE_QUANTILE))
    if not scale > 0.0:
        raise BadValueError(
            f"{some[0][0]} and the other pictures of radiance are black", "Check how they were written."
        )
    scale = float(f"{scale:.3g}")
    longest = max(seconds for _, seconds in pictures)
    if scale / longest > LARGEST_SCALE:
        raise BadValueError(
            f"the pictures hold radiance of {scale / longest:.3g} and more: training renders no more than "
            f"{RADIANCE_MAX:g}",
            f"Give each an exposure that many times as long as what it has, such as {scale:.3g} s "
            "('exposure_time' in transforms.json, or exposure.json): radiance then is in that unit.",
        )
    messages = [f"colours: {'; '.join(spaces)}"]
    if outside > WORTH_A_WORD * pixels:
        messages.append(
            f"{outside / pixels:.2%} of the pixels have colours outside Rec.709: negative channels count as 0"
        )
    return LogEncoding(scale), messages
