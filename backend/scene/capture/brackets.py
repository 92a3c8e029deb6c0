# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos belong to one pose: by their names, or by their order and the pattern of their exposures."""

import itertools
import math
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from ....bridge.errors import BadValueError, DataMismatchError
from .exposures import some_names
from .photos import Photo, natural_order

Grouping = Literal["auto", "names", "order", "none"]

#: Exposures that differ by less are the same: cameras' nominal times are rounded (1/60 is 1/64: 0.09 EV).
SAME_EV = 0.25
#: No camera's automatic bracketing takes more.
LONGEST_BRACKET = 9
#: A pause inside a bracket that is so much longer than that between brackets, and by so many seconds, shows
#: that brackets begin elsewhere.
PAUSE_RATIO, PAUSE_SECONDS = 2.0, 2.0
#: From photo to photo automatic exposure changes by less (median, EV), bracketing by more; or else exposures
#: again after less regular numbers of photos, less than this share of them alike, and fewer steps between
#: neighbours come again at any distance.
AUTOMATIC_EV, REGULAR, REPEATED = 0.5, 0.6, 0.45
NAMED = re.compile(r"(.+)_(\d{1,2})")
SAY = (
    "Move stray photos and incomplete brackets away, say how many photos a pose has (--bracket N), name "
    "them <pose>_<k>, as in desk_0.jpg desk_1.jpg (--group names), or say that there are no brackets "
    "(--group none)."
)


@dataclass(frozen=True)
class Bracket:
    """The photos of one pose, the shortest exposure first, with their ``seconds``."""

    name: str
    photos: tuple[Photo, ...]
    seconds: tuple[float, ...]

    @property
    def group(self) -> str:
        """Of photos under one light; empty: the standard one."""
        return self.photos[0].group


@dataclass(frozen=True)
class Brackets:
    """All poses in the order in which they were taken, each with as many photos; ``how`` they were found.

    Those of each light follow each other, and may have another number of photos (``of``, ``joined``).

    ``places``: the number of the place that each pose is of, where a hand-held bracket has several poses;
    empty: each is a place of its own.
    """

    poses: tuple[Bracket, ...]
    how: str
    places: tuple[int, ...] = ()

    @property
    def photos(self) -> list[Photo]:
        return [photo for pose in self.poses for photo in pose.photos]

    @property
    def groups(self) -> list[str]:
        """The lights that the poses are under, the standard one first (an empty name)."""
        return list(dict.fromkeys(pose.group for pose in self.poses))

    def of(self, group: str) -> "Brackets":
        """The poses under one light: of these alone all have as many photos."""
        numbers = [number for number, pose in enumerate(self.poses) if pose.group == group]
        return self.only(numbers)

    def only(self, numbers: Sequence[int]) -> "Brackets":
        """Some of the poses."""
        places = tuple(self.places[number] for number in numbers) if self.places else ()
        return Brackets(tuple(self.poses[number] for number in numbers), self.how, places)

    @property
    def place_of(self) -> tuple[int, ...]:
        """The number of each pose's place."""
        return self.places or tuple(range(len(self.poses)))

    @property
    def stops(self) -> float:
        """From the shortest to the longest exposure of all, in EV."""
        seconds = [each for pose in self.poses for each in pose.seconds]
        return math.log2(max(seconds) / min(seconds))

    def apart(self) -> "Brackets":
        """The same photos, hand-held: each a pose by itself."""
        poses, places = [], []
        for place, pose in enumerate(self.poses):
            for photo, seconds in zip(pose.photos, pose.seconds, strict=True):
                poses.append(Bracket(photo.stem, (photo,), (seconds,)))
                places.append(place)
        return Brackets(tuple(poses), f"hand-held; {self.how}", tuple(places))

    @property
    def length(self) -> int:
        return len(self.poses[0].photos)

    @property
    def evs(self) -> list[float]:
        """Each step's median exposure as log2 of seconds."""
        return [
            math.log2(statistics.median(pose.seconds[k] for pose in self.poses)) for k in range(self.length)
        ]

    @property
    def drift(self) -> float:
        """The largest difference in EV between two poses' exposures at the same step."""
        logs = [[math.log2(pose.seconds[k]) for pose in self.poses] for k in range(self.length)]
        return max(max(step) - min(step) for step in logs)


def find_brackets(
    photos: Sequence[Photo],
    seconds: Mapping[str, float],
    by: Grouping = "auto",
    length: int | None = None,
) -> Brackets:
    """Group ``photos`` into poses.

    ``seconds``: exposure by file name; photos without are damaged files, which keep their place in the order,
    and whose brackets are left out. ``by``: ``names`` ``<pose>_<k>``; ``order`` of time, then name, with a
    pattern of exposures that repeats; ``none``, each photo is a pose; ``auto``, the first that is plain, or
    none where the exposure only drifts from photo to photo, as automatic exposure does. ``length``: photos in
    each pose, where the user says so. Raises ``DataMismatchError``, which shows what was found, where it is
    not plain; ``BadValueError`` for a length that cannot be.
    """
    if length is not None and (length < 1 or len(photos) % length):
        raise BadValueError(
            f"{len(photos)} photos cannot be {length} to a pose",
            "Move what does not belong away, or fix it.",
        )
    if by == "none":
        return _without(_in_order(photos, seconds), seconds, "one photo a pose, as asked")
    if by == "names" or (by == "auto" and length is None):
        groups = _by_name(photos)
        if by == "names":
            _require_equal(groups)
        if by == "names" or _is_plain(groups, seconds):
            return _checked(list(groups.values()), seconds, "by name, <pose>_<k>")
    return _by_order(_in_order(photos, seconds), seconds, length, by == "auto")


def joined(parts: Sequence[Brackets]) -> Brackets:
    """Those of several lights as one, places and all; ``how``: the first's."""
    if len(parts) == 1:
        return parts[0]
    places: list[int] = []
    for part in parts:
        before = max(places, default=-1) + 1
        places += [before + place for place in part.place_of]
    has_places = any(part.places for part in parts)
    poses = tuple(pose for part in parts for pose in part.poses)
    return Brackets(poses, parts[0].how, tuple(places) if has_places else ())


def _without(photos: Sequence[Photo], seconds: Mapping[str, float], how: str) -> Brackets:
    """Each photo is a pose."""
    return Brackets(tuple(_bracket([photo], seconds) for photo in photos if photo.name in seconds), how)


def _bracket(photos: Sequence[Photo], seconds: Mapping[str, float], name: str = "") -> Bracket:
    ordered = sorted(photos, key=lambda photo: seconds[photo.name])
    return Bracket(name or photos[0].stem, tuple(ordered), tuple(seconds[photo.name] for photo in ordered))


def _checked(groups: list[list[Photo]], seconds: Mapping[str, float], how: str) -> Brackets:
    whole = [group for group in groups if all(photo.name in seconds for photo in group)]
    if not whole:
        damaged = [photo.name for group in groups for photo in group if photo.name not in seconds]
        raise DataMismatchError(
            f"each pose ({how}) has a damaged photo: {some_names(damaged)}",
            "Copy them again, or take other photos.",
        )
    poses = tuple(_bracket(group, seconds) for group in whole)
    for pose in poses:
        if len({(photo.width, photo.height) for photo in pose.photos}) > 1:
            sizes = ", ".join(f"{photo.name} is {photo.width}×{photo.height}" for photo in pose.photos)
            raise DataMismatchError(f"the photos of one pose ({how}) have several sizes: {sizes}", SAY)
        for k in range(len(pose.photos) - 1):
            if math.log2(pose.seconds[k + 1] / pose.seconds[k]) < SAME_EV:
                first, second = pose.photos[k], pose.photos[k + 1]
                raise DataMismatchError(
                    f"{first.name} and {second.name} ({how}) are of one pose and of the same exposure, "
                    f"{time_in_words(pose.seconds[k])}",
                    SAY,
                )
    return Brackets(poses, how)


# ---- by name -----------------------------------------------------------------------------------------


def _by_name(photos: Sequence[Photo]) -> dict[str, list[Photo]]:
    groups: dict[str, list[Photo]] = {}
    for photo in photos:
        match = NAMED.fullmatch(photo.stem)
        groups.setdefault(match[1] if match else photo.stem, []).append(photo)
    return dict(sorted(groups.items(), key=lambda item: natural_order(item[0])))


def _steps(group: Sequence[Photo]) -> list[int]:
    return sorted(int(match[2]) for photo in group if (match := NAMED.fullmatch(photo.stem)))


def _is_plain(groups: Mapping[str, list[Photo]], seconds: Mapping[str, float]) -> bool:
    """Several poses, each with the same two or more steps: what names that cameras give never look like.

    Not series of single photos, numbered room by room: these are longer, or have an exposure twice.
    """
    steps = [_steps(group) for group in groups.values()]
    if len(groups) < 2 or not 1 < len(steps[0]) <= LONGEST_BRACKET or steps.count(steps[0]) < len(steps):
        return False
    for group in groups.values():
        evs = sorted(math.log2(seconds[photo.name]) for photo in group if photo.name in seconds)
        if any(longer - shorter < SAME_EV for shorter, longer in itertools.pairwise(evs)):
            return False
    return True


def _require_equal(groups: Mapping[str, list[Photo]]) -> None:
    lengths = {name: len(group) for name, group in groups.items()}
    common = statistics.mode(lengths.values())
    for name, count in lengths.items():
        if count != common:
            raise DataMismatchError(
                f"pose '{name}' has {count} photos ({some_names([photo.name for photo in groups[name]])}), "
                f"most poses have {common}",
                "Every pose needs the same exposures: add what is missing, or move that pose's photos away.",
            )


# ---- by order ----------------------------------------------------------------------------------------


def _in_order(photos: Sequence[Photo], seconds: Mapping[str, float]) -> list[Photo]:
    """By time, where every photo that is whole tells it; a damaged one comes after its neighbour by name."""
    by_name = sorted(photos, key=lambda photo: natural_order(photo.name))
    whole = [photo for photo in by_name if photo.name in seconds]
    if not all(photo.taken is not None for photo in whole):
        return by_name
    ordered = sorted(whole, key=lambda photo: photo.taken)  # type: ignore[arg-type, return-value]  # stable
    for k, photo in enumerate(by_name):
        if photo.name not in seconds:
            ordered.insert(ordered.index(by_name[k - 1]) + 1 if k else 0, photo)
    return ordered


def _by_order(
    photos: list[Photo], seconds: Mapping[str, float], length: int | None, automatic: bool
) -> Brackets:
    """``automatic``: whether there may be no brackets."""
    evs = [math.log2(seconds.get(photo.name, math.nan)) for photo in photos]
    if length is None:
        drifts = automatic and _drifts(photos, evs)
        lengths = _lengths(evs, relative=not drifts)
        if not lengths and drifts:
            return _without(
                photos, seconds, "one photo a place: the exposure was automatic, without brackets"
            )
        if not lengths:
            raise DataMismatchError(_confusion(photos, seconds, evs), SAY)
        if len(lengths) > 1:
            raise DataMismatchError(
                f"the photos' exposures fit brackets of {' and of '.join(map(str, lengths))}", SAY
            )
        length = lengths[0]
    if length == 1:
        why = "all of one exposure" if _repeats(evs, 1, relative=False) else "as asked"
        return _without(photos, seconds, f"one photo a place, {why}")
    groups = [photos[k : k + length] for k in range(0, len(photos), length)]
    _check_pauses(groups)
    return _checked(groups, seconds, f"by order: each {length} photos repeat the same exposures")


def _drifts(photos: Sequence[Photo], evs: list[float]) -> bool:
    """Whether exposures change as automatic exposure changes them: little, or without any order.

    Not where a camera says that it was bracketing.
    """
    if any(photo.auto_bracket for photo in photos):
        return False
    evs = [ev for ev in evs if not math.isnan(ev)]
    changes = [second - first for first, second in itertools.pairwise(evs)]
    if not changes or statistics.median(map(abs, changes)) < AUTOMATIC_EV:
        return True
    lengths = [len(run) for run in _runs(evs)]
    if lengths.count(statistics.mode(lengths)) >= max(3, REGULAR * len(lengths)):
        return False
    # Steps that come again n photos later: of brackets all but one in n do, though their exposures drift.
    for n in range(2, min(LONGEST_BRACKET, len(changes) // 2) + 1):
        pairs = [(one, other) for one, other in zip(changes, changes[n:], strict=False)]
        again = sum(abs(one - other) < SAME_EV and abs(one) > AUTOMATIC_EV for one, other in pairs)
        if again >= REPEATED * len(pairs):
            return False
    return True


def _runs(evs: list[float]) -> list[list[int]]:
    """A new run begins where an exposure comes again."""
    runs: list[list[int]] = [[]]
    for k, ev in enumerate(evs):
        if any(abs(ev - evs[other]) < SAME_EV for other in runs[-1]):
            runs.append([])
        runs[-1].append(k)
    return runs


def _lengths(evs: list[float], relative: bool = True) -> list[int]:
    """Every length under which all brackets are alike: absolutely, or else each relative to its first photo.

    A camera whose exposure is automatic between brackets changes them all by the same factor; ``relative``:
    whether that may be.
    """
    if _repeats(evs, 1, relative=False):
        return [1]
    candidates = [n for n in range(2, min(LONGEST_BRACKET, len(evs) // 2) + 1) if len(evs) % n == 0]
    for n in candidates:
        if _repeats(evs, n, relative=False):
            return [n]  # its multiples repeat as well, but hold each exposure several times
    return [n for n in candidates if relative and _repeats(evs, n, relative=True)]


def _repeats(evs: list[float], length: int, relative: bool) -> bool:
    """Whether all groups of ``length`` are alike; of NaN, a damaged photo, nothing is known.

    Not where half of the groups or more would have one: what little is known of them fits too much.
    """
    groups = [evs[k : k + length] for k in range(0, len(evs), length)]
    whole = [group for group in groups if not any(map(math.isnan, group))]
    if not whole or (length > 1 and 2 * len(whole) <= len(groups)):
        return False
    first = whole[0]

    def is_alike(group: list[float]) -> bool:
        changes = [ev - of_first for ev, of_first in zip(group, first, strict=True) if not math.isnan(ev)]
        base = changes[0] if relative and changes else 0.0
        return all(abs(change - base) < SAME_EV for change in changes)

    differ = all(abs(a - b) > SAME_EV for k, a in enumerate(first) for b in first[:k])
    return differ and all(map(is_alike, groups))


def _confusion(photos: Sequence[Photo], seconds: Mapping[str, float], evs: list[float]) -> str:
    """What the order looks like."""
    runs = _runs(evs)
    common = statistics.mode(len(run) for run in runs)
    shown = ", ".join(str(len(run)) for run in runs[:12]) + (" …" if len(runs) > 12 else "")
    odd = next((run for run in runs if len(run) != common), runs[0])
    times = {photo.name: time_in_words(seconds[photo.name]) for photo in photos if photo.name in seconds}
    inside = ", ".join(f"{photos[k].name} {times.get(photos[k].name, 'damaged')}" for k in odd[:6])
    return (
        f"it is not plain which of the {len(photos)} photos belong to one pose: in their order exposures "
        f"come again after {shown} photos; the first that is unlike the others: {inside}"
        + (" …" if odd[6:] else "")
    )


def _check_pauses(groups: list[list[Photo]]) -> None:
    """Refuse brackets inside which the photographer paused longer than between them: a photo is missing."""
    if len(groups) < 2 or any(photo.taken is None for group in groups for photo in group):
        return

    def gap(photo: Photo, following: Photo) -> float:
        assert photo.taken is not None and following.taken is not None
        return (following.taken - photo.taken).total_seconds()

    def pause(photo: Photo, following: Photo) -> float:
        """At least so long: cameras write down either the beginning or the end of an exposure."""
        return gap(photo, following) - max(photo.shutter or 0.0, following.shutter or 0.0)

    length = len(groups[0])
    inside = [statistics.median(pause(group[k], group[k + 1]) for group in groups) for k in range(length - 1)]
    pairs = itertools.pairwise(groups)
    between = statistics.median(gap(group[-1], following[0]) for group, following in pairs)
    longest = max(range(length - 1), key=lambda k: inside[k])
    if inside[longest] > PAUSE_RATIO * between + PAUSE_SECONDS:
        raise DataMismatchError(
            f"brackets of {length} photos from {groups[0][0].name} on are {inside[longest]:.0f} s apart "
            f"inside (before {groups[0][longest + 1].name}) and {between:.0f} s apart between: a photo is "
            "missing or stray at the start",
            SAY,
        )


def time_in_words(seconds: float) -> str:
    """``1/60 s``, ``0.5 s``, ``30 s``."""
    return f"1/{1 / seconds:.0f} s" if seconds < 0.4 else f"{seconds:.3g} s"
