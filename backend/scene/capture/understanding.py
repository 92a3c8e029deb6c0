# SPDX-License-Identifier: GPL-3.0-or-later
"""What a folder of photos is: places, exposures, stops, what is odd. Headers are read, no pixels."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ....bridge.errors import BadValueError, DataMismatchError
from .brackets import SAME_EV, Brackets, Grouping, find_brackets, time_in_words
from .choice import thinned
from .exposures import Exposures, exposures_from_exif, exposures_from_file, same_exposures, some_names
from .photos import Found, Photo, Skipped, find_photos
from .structure import CAPTURE_REMEDY, FEWEST_POSES, match_size, pairs_of_places

Kind = Literal["brackets", "single", "handheld", "raw brackets", "raw single", "raw handheld"]

#: Exposures at one step that differ more between poses are worth a word, in EV.
DRIFT_EV = 0.1
#: A wider spread than this between neighbouring steps leaves codes that no two exposures share, in EV.
WIDEST_STEP_EV = 4.0
#: Seconds on two cores of 2026: to decode a million pixels (of a raw file: to develop), to find the features
#: of a million, to match two pictures of a million (it grows with the square), to place one, to straighten
#: and write a million. 11 photos of 6 million take 55 s by these and took 89 CPU seconds.
DECODE, DEVELOP, FEATURES, MATCH, PLACE, WRITE = 0.03, 0.2, 0.6, 0.04, 0.15, 0.5
#: No picture has more features than one of so many million pixels.
MOST_FEATURES = 3.0


@dataclass(frozen=True)
class Understanding:
    """``brackets``: as they are used: of long brackets five steps, hand-held photos each by itself.

    ``lines``, ``warnings``: sentences for people.
    """

    found: Found
    brackets: Brackets
    exposures: Exposures
    kind: Kind
    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def is_raw(self) -> bool:
        return self.kind.startswith("raw")

    @property
    def is_handheld(self) -> bool:
        return self.kind.endswith("handheld")

    @property
    def places(self) -> int:
        return len(set(self.brackets.place_of))

    @property
    def skipped(self) -> list[Skipped]:
        return self.found.skipped

    def pairs(self) -> list[tuple[int, int]] | None:
        """Which photos are matched, where hand-held brackets say more than their order."""
        if not self.is_handheld:
            return None
        steps: Counter[int] = Counter()
        step_of = []
        for place in self.brackets.place_of:  # of one place the shortest exposure comes first
            step_of.append(steps[place])
            steps[place] += 1
        return pairs_of_places(self.brackets.place_of, step_of)

    def seconds(self, max_width: int = 0) -> dict[str, float]:
        """How long each stage of the work takes, roughly, on two cores; ``max_width`` of the pictures."""
        photos = self.brackets.photos
        million = 1e-6 * sum(photo.width * photo.height for photo in photos)
        reading = million * (DEVELOP if self.is_raw else DECODE)
        poses = len(self.brackets.poses)
        width, height = match_size(photos[0])
        seen = 1e-6 * width * height
        pairs = self.pairs()
        count = len(pairs) if pairs is not None else poses * min(poses, 48) / 2
        shrink = min(1.0, max_width / photos[0].width) if max_width else 1.0
        return {
            "looking": reading,
            "copying": reading * poses / len(photos),
            "features": FEATURES * poses * seen,
            "matching": MATCH * count * min(seen, MOST_FEATURES) ** 2,
            "mapping": PLACE * poses,
            "writing": reading + WRITE * million * max(shrink, 0.2) ** 2,
        }

    def described(self) -> dict[str, Any]:
        """For programs, as JSON (docs/photos.md)."""
        photos, places = self.brackets.photos, Counter(self.brackets.place_of)
        length = self.brackets.length
        per_place = length if length > 1 else next(iter(places.values()))
        even = len({*places.values()}) == 1
        size = Counter((photo.width, photo.height) for photo in photos).most_common(1)[0][0]
        return {
            "photos": len(photos),
            "places": self.places,
            "per_place": per_place if even else 0,
            "exposures": self.steps(),
            "stops": round(self.brackets.stops, 2),
            "size": list(size),
            "how": self.brackets.how,
            "kind": self.kind,
            "lines": self.lines,
            "warnings": self.warnings,
            "skipped": [{"name": each.name, "why": each.why} for each in self.skipped],
            "estimate_seconds": round(sum(self.seconds(1600).values())),
        }

    def steps(self) -> list[float]:
        """The exposures in seconds: of each step the median, or, without brackets, all that differ."""
        if self.brackets.length > 1:
            return [2.0**ev for ev in self.brackets.evs]
        distinct: list[float] = []
        for seconds in sorted(each for pose in self.brackets.poses for each in pose.seconds):
            if not distinct or math.log2(seconds / distinct[-1]) >= SAME_EV:
                distinct.append(seconds)
        return distinct

    def without(self, damaged: list[Skipped]) -> "Understanding":
        """The same without photos whose pixels turned out to be damaged, and what belongs to them."""
        names = {each.name for each in damaged}
        numbers = [
            number
            for number, pose in enumerate(self.brackets.poses)
            if not names & {photo.name for photo in pose.photos}
        ]
        brackets = replace(
            self.brackets,
            poses=tuple(self.brackets.poses[number] for number in numbers),
            places=tuple(self.brackets.place_of[number] for number in numbers) if self.is_handheld else (),
        )
        kept = {photo.name for photo in brackets.photos}
        mates = [
            Skipped(photo.name, "is of the same place as a damaged photo")
            for photo in self.brackets.photos
            if photo.name not in kept | names
        ]
        found = replace(self.found, skipped=[*self.skipped, *damaged, *mates])
        return replace(self, found=found, brackets=brackets)


def understand(
    folder: Path,
    exposures: Path | None = None,
    same_exposure: bool = False,
    group: Grouping = "auto",
    bracket: int | None = None,
    handheld: bool = False,
    done: Callable[[int, int], None] = lambda photos, of: None,
) -> Understanding:
    """Look at the photos in ``folder``; the options are those of ``physhdr prepare``.

    ``done`` is told after every photo. Raises what ``find_photos``, ``exposures_from_exif`` and
    ``find_brackets`` raise, and ``DataMismatchError`` where there are too few places.
    """
    found = find_photos(folder, done)
    photos = found.photos
    if exposures is not None:
        known = exposures_from_file(exposures, photos)
    else:
        known = same_exposures(photos) if same_exposure else exposures_from_exif(photos)
    try:
        every = find_brackets([*photos, *found.damaged], known.seconds, group, bracket)
    except (BadValueError, DataMismatchError) as error:
        told = "; ".join((error.message, *_left_out(found.skipped)))
        raise type(error)(told, error.hint) from error
    brackets, steps = thinned(every)
    handheld = handheld and every.length > 1
    kind = "handheld" if handheld else "brackets" if every.length > 1 else "single"
    used = {photo.name for photo in every.photos}
    found.skipped.extend(
        Skipped(photo.name, "is of the same place as a damaged photo")
        for photo in photos
        if photo.name not in used
    )
    if len(brackets.poses) < FEWEST_POSES:
        raise DataMismatchError(
            f"{folder} holds {len(brackets.poses)} poses; at least {FEWEST_POSES} are needed", CAPTURE_REMEDY
        )
    understood = Understanding(
        found,
        brackets.apart() if handheld else brackets,
        known,
        f"raw {kind}" if photos[0].is_raw else kind,  # type: ignore[arg-type]
        _lines(photos, every, known, kind, found.notes),
        _warnings(every, found, same_exposure),
    )
    if len(steps) < every.length:
        numbers = ", ".join(map(str, steps))
        understood.lines.append(f"of the {every.length} exposures steps {numbers} are used")
    return understood


def _lines(
    photos: list[Photo], brackets: Brackets, exposures: Exposures, kind: str, notes: list[str]
) -> list[str]:
    sizes = Counter((photo.width, photo.height) for photo in brackets.photos).most_common()
    of = " and ".join(f"{w}×{h}" for (w, h), _ in sizes[:3]) + (" …" if len(sizes) > 3 else "")
    what = "raw files" if photos[0].is_raw else "photos"
    head = f"{len(brackets.photos)} {what} of {of}: {len(brackets.poses)} poses with {brackets.length} each"
    lines = []
    if kind == "single":
        seconds = sorted(pose.seconds[0] for pose in brackets.poses)
        times = time_in_words(seconds[0])
        if brackets.stops >= SAME_EV:
            times += f" to {time_in_words(seconds[-1])}"
        lines.append(f"{head} ({brackets.how}): {times} ({exposures.meaning})")
        if brackets.stops >= SAME_EV:
            lines.append(
                f"exposures span {brackets.stops:.1f} stops from photo to photo: a bracket over the views"
            )
    else:
        times = ", ".join(time_in_words(2.0**ev) for ev in brackets.evs)
        lines.append(
            f"{head} ({brackets.how}): {times}, {brackets.stops:.1f} stops in all ({exposures.meaning})"
        )
        if kind == "handheld":
            lines.append("hand-held: each photo is placed by itself")
    if photos[0].is_raw:
        lines.append("raw files are developed to linear pictures of 16 bits, whose response is known")
    masks = sum(photo.mask is not None for photo in brackets.photos)
    if masks:
        lines.append(f"{masks} photos have masks: what is black there is not looked at")
    return lines + notes


def _warnings(brackets: Brackets, found: Found, same_exposure: bool) -> list[str]:
    warnings = []
    if brackets.length == 1 and brackets.stops < SAME_EV:
        warnings.append(
            "there is one exposure only: what it clips, black or white, cannot be learned (no HDR)"
        )
    if brackets.length > 1 and (widest := float(np.diff(brackets.evs).max())) > WIDEST_STEP_EV:
        warnings.append(
            f"neighbouring exposures are {widest:.1f} EV apart; {WIDEST_STEP_EV:g} or less are better"
        )
    if brackets.length > 1 and brackets.drift > DRIFT_EV:
        warnings.append(
            f"exposures of one step differ by up to {brackets.drift:.1f} EV between poses; each is used as "
            "it is, but manual exposure is better"
        )
    if same_exposure:
        warnings.append("what the photos' EXIF says of exposures is not looked at, as asked")
    lenses = Counter(photo.lens for photo in brackets.photos)
    for lens, count in lenses.items():
        if len(lenses) > 1 and count < 3 * brackets.length:
            width, height, focal, focal_35mm, zoom = lens
            at = f" at {focal:g} mm" if focal is not None else ""
            at += f" ({focal_35mm:g} mm on 35 mm film)" if focal_35mm is not None else ""
            at += f", zoomed digitally {zoom:g} times" if zoom != 1.0 else ""
            names = some_names([photo.name for photo in brackets.photos if photo.lens == lens])
            warnings.append(f"few photos are {width}×{height}{at}, which tells little of their lens: {names}")
    return warnings + found.warnings + _left_out(found.skipped)


def _left_out(skipped: list[Skipped]) -> list[str]:
    """A sentence for each reason for which files are ignored."""
    by_reason: dict[str, list[str]] = {}
    for each in skipped:
        by_reason.setdefault(each.why, []).append(each.name)
    return [f"ignored: {some_names(names)} {why}" for why, names in by_reason.items()]
