# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of a bracket's photos structure from motion sees, and by which numbers the data set knows them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ....bridge.errors import BadValueError
from .brackets import Bracket, Brackets
from .photos import Photo

Choice = Literal["same", "each"] | int

#: Codes up to the first and from the second on say nothing of what is there.
BLACK, WHITE = 5, 250
#: Steps that clip so little more than the best are as good: the one nearest to a middling code is taken, for
#: features in dark pictures are noise.
AS_GOOD, MIDDLE = 0.01, 118.0
#: The number k in the data set of each step of a bracket of so many. Where 1 and 3 are held out, as published
#: comparisons do, short brackets still are trained on whole, and the darkest and the brightest always.
NUMBERS = {1: (0,), 2: (0, 2), 3: (0, 2, 4), 4: (0, 1, 2, 4), 5: (0, 1, 2, 3, 4)}


def thinned(brackets: Brackets) -> tuple[Brackets, tuple[int, ...]]:
    """At most five exposures of each pose, spread evenly, the first and last among them; and which steps."""
    most = max(NUMBERS)
    steps = tuple(round(k) for k in np.linspace(0, brackets.length - 1, min(most, brackets.length)))
    poses = tuple(
        Bracket(pose.name, tuple(pose.photos[k] for k in steps), tuple(pose.seconds[k] for k in steps))
        for pose in brackets.poses
    )
    return Brackets(poses, brackets.how, brackets.places), steps


def clipped_share(pixels: np.ndarray) -> float:
    """The share of pixels of ``[h, w, 3]`` uint8 that are black in all channels or white in one."""
    return float(((pixels.max(axis=2) <= BLACK) | (pixels.max(axis=2) >= WHITE)).mean())


@dataclass(frozen=True)
class Quality:
    """Of one photo: the share of clipped pixels, and the median code."""

    clipped: float
    median: float


def quality(photo: Photo) -> Quality:
    """By a small copy; raises ``FileDamagedError`` where the photo cannot be decoded."""
    pixels = photo.thumbnail()
    return Quality(clipped_share(pixels), float(np.median(pixels)))


def photos_to_match(
    poses: Sequence[Bracket], choice: Choice, qualities: Mapping[str, Quality]
) -> tuple[dict[int, Photo], str]:
    """One photo for each pose's number, and in words which.

    ``choice``: ``same``, the step that is best exposed over all poses of one light, with the fewest clipped
    pixels; ``each``, that of each pose; or a step, 0 the darkest. ``qualities``: by file name. Raises
    ``BadValueError`` where the step is not there.
    """
    chosen: dict[int, Photo] = {}
    words = []
    for group in dict.fromkeys(pose.group for pose in poses):
        numbers = [number for number, pose in enumerate(poses) if pose.group == group]
        steps, which = _steps_to_match([poses[number] for number in numbers], choice, qualities)
        chosen |= {number: poses[number].photos[step] for number, step in zip(numbers, steps, strict=True)}
        words.append(f"{group}: {which}" if group else which)
    return chosen, "; ".join(words)


def _steps_to_match(
    poses: Sequence[Bracket], choice: Choice, qualities: Mapping[str, Quality]
) -> tuple[list[int], str]:
    """The same for poses of one light: the step of each."""
    length = len(poses[0].photos)
    if isinstance(choice, int):
        if not 0 <= choice < length:
            of = f" in '{poses[0].group}'" if poses[0].group else ""
            raise BadValueError(
                f"there is no step {choice}{of}", f"Steps are 0 (the darkest) to {length - 1}."
            )
        return [choice] * len(poses), f"step {choice}, as asked"
    if length == 1:
        return [0] * len(poses), "the only exposure"
    found = [[qualities[photo.name] for photo in pose.photos] for pose in poses]
    measured = np.array([[(each.clipped, each.median) for each in pose] for pose in found])
    if choice == "each":
        best = [best_step(pose) for pose in measured]
        clipped = np.mean([pose[k, 0] for pose, k in zip(measured, best, strict=True)])
        words = f"each pose's best exposed photo ({clipped:.1%} clipped)"
    else:
        step = best_step(measured.mean(axis=0))
        best = [step] * len(poses)
        words = f"step {step} of 0…{length - 1}, the best exposed ({measured[:, step, 0].mean():.1%} clipped)"
    return best, words


def best_step(measured: np.ndarray) -> int:
    """The best exposed of ``[K, 2]``: share of clipped pixels, median code."""
    clipped, median = measured.T
    good = clipped <= clipped.min() + AS_GOOD
    return int(np.where(good, np.abs(median - MIDDLE), np.inf).argmin())
