# SPDX-License-Identifier: GPL-3.0-or-later
"""What a folder of photos is: places, exposures, stops, what is odd. Headers are read, no pixels."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ....bridge.errors import BadValueError, DataMismatchError
from ....bridge.light_groups import LightGroups
from ....bridge.light_report import group_words, light_report
from .brackets import SAME_EV, Brackets, Grouping, find_brackets, joined, time_in_words
from .choice import thinned
from .exposures import Exposures, exposures_from_exif, exposures_from_file, same_exposures, some_names
from .light_folders import LightFolder, groups_of
from .photos import Found, Photo, Skipped, find_photos
from .structure import (
    CAPTURE_REMEDY,
    FEWEST_POSES,
    match_size,
    pairs_in_time,
    pairs_of_lights,
    pairs_of_places,
)

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

    ``lines``, ``warnings``: sentences for people. ``lights``: where some photos are under other light, in
    groups whose pictures are yet to be named.
    """

    found: Found
    brackets: Brackets
    exposures: Exposures
    kind: Kind
    lines: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    lights: LightGroups | None = None

    @property
    def standard(self) -> Brackets:
        """The poses under the standard light."""
        return self.brackets.of("")

    @property
    def is_raw(self) -> bool:
        return self.kind.startswith("raw")

    @property
    def is_handheld(self) -> bool:
        return self.kind.endswith("handheld")

    @property
    def places(self) -> int:
        """Of all lights; each place counts under each light that it was photographed under."""
        return len(set(self.brackets.place_of))

    def places_by_group(self, numbers: Iterable[int]) -> dict[str, int]:
        """From how many places some of the poses are, by the group of photos under one light."""
        poses, place_of = self.brackets.poses, self.brackets.place_of
        return dict(Counter(group for group, _ in {(poses[k].group, place_of[k]) for k in numbers}))

    @property
    def skipped(self) -> list[Skipped]:
        return self.found.skipped

    def pairs(self) -> list[tuple[int, int]] | None:
        """Which photos are matched, where hand-held brackets or several lights say more than their order."""
        groups = self.brackets.groups
        if len(groups) == 1 and not self.is_handheld:
            return None
        numbers = {
            group: [k for k, pose in enumerate(self.brackets.poses) if pose.group == group]
            for group in groups
        }
        return pairs_of_lights({group: (some, self._pairs_of(some)) for group, some in numbers.items()})

    def _pairs_of(self, numbers: list[int]) -> list[tuple[int, int]]:
        """The same among the poses of one light."""
        if not self.is_handheld:
            return pairs_in_time(numbers)
        places = [self.brackets.place_of[k] for k in numbers]
        steps: Counter[int] = Counter()
        step_of = []
        for place in places:  # of one place the shortest exposure comes first
            step_of.append(steps[place])
            steps[place] += 1
        return [(numbers[one], numbers[other]) for one, other in pairs_of_places(places, step_of)]

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
        brackets = self.standard
        photos, places = brackets.photos, Counter(brackets.place_of)
        length = brackets.length
        per_place = length if length > 1 else next(iter(places.values()))
        even = len({*places.values()}) == 1
        size = Counter((photo.width, photo.height) for photo in photos).most_common(1)[0][0]
        return {
            "photos": len(photos),
            "places": len(places),
            "per_place": per_place if even else 0,
            "exposures": self.steps(),
            "stops": round(brackets.stops, 2),
            "size": list(size),
            "how": brackets.how,
            "kind": self.kind,
            "lines": self.lines,
            "warnings": self.warnings,
            "skipped": [{"name": each.name, "why": each.why} for each in self.skipped],
            "estimate_seconds": round(sum(self.seconds(1600).values())),
            "lights": self._lights(),
        }

    def say_lights(
        self, numbers: Iterable[int], say: Callable[[str], None], warn: Callable[[str], None]
    ) -> None:
        """Which lights can be turned afterwards, by some of the poses."""
        places = self.places_by_group(numbers)
        if self.lights is None or (groups := self.lights.of_pictures({g: [g] for g in places})) is None:
            return
        lines, warnings = light_report(groups, places)
        for line in lines:
            say(line)
        for line in warnings:
            warn(line)

    def lights_in_words(self, without: Collection[str]) -> dict[str, str]:
        """What each group's light is, but for some groups."""
        groups = self.lights.groups if self.lights is not None else ()
        return {group.name: group_words(group) for group in groups if group.name not in without}

    def _lights(self) -> list[dict[str, Any]]:
        """Each group under other light, for programs."""
        places = self.places_by_group(range(len(self.brackets.poses)))
        groups = self.lights.groups if self.lights is not None else ()
        return [
            {"group": group.name, "levels": dict(group.levels), "places": places.get(group.name, 0)}
            for group in groups
        ]

    def steps(self) -> list[float]:
        """The exposures in seconds under the standard light.

        Of each step the median, or, without brackets, all that differ.
        """
        brackets = self.standard
        if brackets.length > 1:
            return [2.0**ev for ev in brackets.evs]
        distinct: list[float] = []
        for seconds in sorted(each for pose in brackets.poses for each in pose.seconds):
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
        brackets = self.brackets.only(numbers)
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
    lit: Sequence[LightFolder] = (),
) -> Understanding:
    """Look at the photos in ``folder``; the options are those of ``physhdr prepare``.

    ``done`` is told after every photo. ``lit``: folders of photos under other light. Raises what
    ``find_photos``, ``exposures_from_exif`` and ``find_brackets`` raise, and ``DataMismatchError`` where
    there are too few places.
    """
    found = find_photos(folder, done, {each.name: each.folder for each in lit})
    photos = found.photos
    if exposures is not None:
        known = exposures_from_file(exposures, photos)
    else:
        known = same_exposures(photos) if same_exposure else exposures_from_exif(photos)
    parts = _by_light(found, known, group, bracket)
    every = parts[""]
    if len(every.poses) < FEWEST_POSES:
        raise DataMismatchError(
            f"{folder} holds {len(every.poses)} poses; at least {FEWEST_POSES} are needed", CAPTURE_REMEDY
        )
    thin = [thinned(part) for part in parts.values()]
    used = {photo.name for part in parts.values() for photo in part.photos}
    found.skipped.extend(
        Skipped(photo.name, "is of the same place as a damaged photo")
        for photo in photos
        if photo.name not in used
    )
    handheld = handheld and any(part.length > 1 for part in parts.values())
    kind = "handheld" if handheld else "brackets" if every.length > 1 else "single"
    understood = Understanding(
        found,
        joined([part.apart() if handheld and part.length > 1 else part for part, _ in thin]),
        known,
        f"raw {kind}" if photos[0].is_raw else kind,  # type: ignore[arg-type]
        _lines(every, known, kind),
        _warnings(every, joined(list(parts.values())).photos, found, same_exposure),
        groups_of(lit) if lit else None,
    )
    understood.lines.extend(found.notes)
    steps = thin[0][1]
    if len(steps) < every.length:
        numbers = ", ".join(map(str, steps))
        understood.lines.append(f"of the {every.length} exposures steps {numbers} are used")
    _say_lights(understood, parts)
    return understood


def _by_light(found: Found, known: Exposures, group: Grouping, bracket: int | None) -> dict[str, Brackets]:
    """The brackets of the photos under each light, the standard one (an empty name) first.

    Photos under another light may have more or fewer exposures. Those that repeat the steps of the standard
    ones are brackets, be they of one place alone, where no pattern shows.
    """
    parts: dict[str, Brackets] = {}
    for light in dict.fromkeys(("", *(photo.group for photo in found.photos))):
        photos = [photo for photo in (*found.photos, *found.damaged) if photo.group == light]
        if not photos:
            raise DataMismatchError("no photo under the standard light can be used", CAPTURE_REMEDY)
        alike = _with_steps_of(parts[""], photos, known) if light and group in ("auto", "order") else None
        length = None if light and len(photos) % (bracket or 1) else bracket
        try:
            parts[light] = alike or find_brackets(photos, known.seconds, group, length)
        except (BadValueError, DataMismatchError) as error:
            what = f"{light}: {error.message}" if light else error.message
            raise type(error)("; ".join((what, *_left_out(found.skipped))), error.hint) from error
    return parts


def _with_steps_of(standard: Brackets, photos: Sequence[Photo], known: Exposures) -> Brackets | None:
    """The brackets with as many exposures, the same number of stops apart; None where these are none."""
    if standard.length == 1:
        return None
    try:
        found = find_brackets(photos, known.seconds, "order", standard.length)
    except (BadValueError, DataMismatchError):
        return None
    wanted = np.subtract(standard.evs, standard.evs[0])
    steps = np.log2([pose.seconds for pose in found.poses])
    return found if (np.abs(steps - steps[:, :1] - wanted) < SAME_EV).all() else None


def _say_lights(understood: Understanding, parts: dict[str, Brackets]) -> None:
    """Lines and warnings about the photos under other light."""
    if understood.lights is None:
        return
    for light, brackets in parts.items():
        if light:
            understood.lines.append(
                f"{light}: {len(brackets.photos)} photos, {len(brackets.poses)} poses with {brackets.length} "
                f"each ({brackets.how}): {_times(brackets)}"
            )
    empty = [group.name for group in understood.lights.groups if group.name not in parts]
    understood.warnings.extend(f"ignoring '{name}': none of its photos can be used" for name in empty)
    every = range(len(understood.brackets.poses))
    understood.say_lights(every, understood.lines.append, understood.warnings.append)


def _lines(brackets: Brackets, exposures: Exposures, kind: str) -> list[str]:
    photos = brackets.photos
    sizes = Counter((photo.width, photo.height) for photo in brackets.photos).most_common()
    of = " and ".join(f"{w}×{h}" for (w, h), _ in sizes[:3]) + (" …" if len(sizes) > 3 else "")
    what = "raw files" if photos[0].is_raw else "photos"
    head = f"{len(brackets.photos)} {what} of {of}: {len(brackets.poses)} poses with {brackets.length} each"
    lines = []
    if kind == "single":
        lines.append(f"{head} ({brackets.how}): {_times(brackets)} ({exposures.meaning})")
        if brackets.stops >= SAME_EV:
            lines.append(
                f"exposures span {brackets.stops:.1f} stops from photo to photo: a bracket over the views"
            )
    else:
        times = f"{_times(brackets)}, {brackets.stops:.1f} stops in all"
        lines.append(f"{head} ({brackets.how}): {times} ({exposures.meaning})")
        if kind == "handheld":
            lines.append("hand-held: each photo is placed by itself")
    if photos[0].is_raw:
        lines.append("raw files are developed to linear pictures of 16 bits, whose response is known")
    masks = sum(photo.mask is not None for photo in brackets.photos)
    if masks:
        lines.append(f"{masks} photos have masks: what is black there is not looked at")
    return lines


def _times(brackets: Brackets) -> str:
    """The exposures in words: of each step the median, or, without brackets, the shortest and longest."""
    if brackets.length > 1:
        return ", ".join(time_in_words(2.0**ev) for ev in brackets.evs)
    seconds = sorted(pose.seconds[0] for pose in brackets.poses)
    longest = f" to {time_in_words(seconds[-1])}" if brackets.stops >= SAME_EV else ""
    return time_in_words(seconds[0]) + longest


def _warnings(brackets: Brackets, photos: Sequence[Photo], found: Found, same_exposure: bool) -> list[str]:
    """Of the ``brackets`` under the standard light, and of the lenses of all ``photos``."""
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
    lenses = Counter(photo.lens for photo in photos)
    for lens, count in lenses.items():
        if len(lenses) > 1 and count < 3 * brackets.length:
            width, height, focal, focal_35mm, zoom = lens
            at = f" at {focal:g} mm" if focal is not None else ""
            at += f" ({focal_35mm:g} mm on 35 mm film)" if focal_35mm is not None else ""
            at += f", zoomed digitally {zoom:g} times" if zoom != 1.0 else ""
            names = some_names([photo.name for photo in photos if photo.lens == lens])
            warnings.append(f"few photos are {width}×{height}{at}, which tells little of their lens: {names}")
    return warnings + found.warnings + _left_out(found.skipped)


def _left_out(skipped: list[Skipped]) -> list[str]:
    """A sentence for each reason for which files are ignored."""
    by_reason: dict[str, list[str]] = {}
    for each in skipped:
        by_reason.setdefault(each.why, []).append(each.name)
    return [f"ignored: {some_names(names)} {why}" for why, names in by_reason.items()]
