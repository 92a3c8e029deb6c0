# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set consists of: its poses, the levels of the lights in each, and all their files."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..bridge import data_set
from ..bridge.data_set import LIT, TEST, TRAIN, VALIDATION
from ..bridge.lights import AMBIENT
from . import rig
from .errors import UnknownNameError
from .options import Options
from .stage import RigPoses

#: Exponents on the outermost trained levels: the default mixtures lie between and beyond those trained.
BETWEEN, BEYOND = 0.5, 1.5
DIGITS = 4


@dataclass(frozen=True)
class Relighting:
    """One setting of the lights of which the test poses get the true radiance."""

    #: Of the lights that are not at 1.
    levels: Mapping[str, float]

    @property
    def folder(self) -> str:
        """``relit/level_0.25`` for ambient light alone, else ``relit/ambient_4+pendant_0.25``."""
        return data_set.mixture_folder(self.levels)

    def describe(self) -> dict[str, Any]:
        """An entry of dataset.json's ``relit``."""
        return {"folder": self.folder, "levels": dict(self.levels)}


@dataclass(frozen=True, eq=False)
class Shot:
    """One pose: one render, and all that is derived from it."""

    split: str
    index: int
    #: Camera to world [4, 4].
    pose: np.ndarray
    #: Of the lights that are not at 1 in the pictures of this pose.
    levels: Mapping[str, float]
    relit: tuple[Relighting, ...] = ()
    #: Its radiance was rendered before and is taken from elsewhere: there is no render of it here.
    stored: bool = False

    @property
    def name(self) -> str:
        return f"{self.split}_{self.index:03d}"

    @property
    def passes(self) -> str:
        """Path of the render, under the data set's folder as all that follow."""
        return data_set.passes_file(self.split, self.index)

    @property
    def hdr(self) -> str:
        return f"{data_set.truth_folder(self.split)}/{data_set.truth_file(self.index)}"

    @property
    def stem(self) -> str:
        return data_set.pose_stem(self.split, self.index)

    def bracket(self, k: int) -> str:
        """Picture of exposure ``k``."""
        return data_set.picture_file(self.stem, k)

    def relit_hdr(self, light: Relighting) -> str:
        return f"{light.folder}/{data_set.truth_file(self.index)}"

    def files(self, exposures: int) -> list[str]:
        """Everything that belongs to this pose."""
        names = [self.hdr, *(self.bracket(k) for k in range(exposures))]
        names += [self.relit_hdr(light) for light in self.relit]
        return names if self.stored else [self.passes, *names]


def shots(poses: RigPoses, options: Options, lights: Sequence[str]) -> list[Shot]:
    """All poses, in the order they are rendered.

    Raises:
        UnknownNameError: an option names a light that the scene does not have.
    """
    check_lights(options, lights)
    relit = relightings(options, lights)
    count = len(poses.test) if options.relit_views is None else min(options.relit_views, len(poses.test))
    chosen = set(rig.spread_indices(len(poses.test), count))
    varied = lit_levels(len(poses.lit), options, lights)
    return [
        *(Shot(TRAIN, k, pose, {}) for k, pose in enumerate(poses.train)),
        *(Shot(TEST, k, pose, {}, relit if k in chosen else ()) for k, pose in enumerate(poses.test)),
        *(Shot(LIT, k, pose, varied[k]) for k, pose in enumerate(poses.lit)),
        *(Shot(VALIDATION, k, pose, {}) for k, pose in enumerate(poses.validation)),
    ]


def check_lights(options: Options, lights: Sequence[str]) -> None:
    """
    Raises:
        UnknownNameError: an option names a light that the scene does not have.
    """
    mixed = [name for levels in options.mixed_levels or () for name, _ in levels]
    for name in [*options.lit_lights, *mixed]:
        if name not in lights:
            raise UnknownNameError("light of this scene", name, list(lights))


def varied_lights(options: Options, lights: Sequence[str]) -> list[str]:
    """The lights that vary in the lit split, in the scene's order."""
    return [name for name in lights if name in options.lit_lights]


def lit_levels(count: int, options: Options, lights: Sequence[str]) -> list[dict[str, float]]:
    """Levels of the lit views: every combination of levels equally often, in an order that the seed draws.

    Each run through all combinations is shuffled by itself, so any first part of the views is balanced too.
    """
    names = varied_lights(options, lights)
    combinations = [
        dict(zip(names, each, strict=True))
        for each in itertools.product(options.lit_levels, repeat=len(names))
    ]
    dice = np.random.default_rng([options.seed, 0x117])
    drawn: list[dict[str, float]] = []
    while len(drawn) < count:
        drawn += [combinations[k] for k in dice.permutation(len(combinations))]
    return drawn[:count]


def relightings(options: Options, lights: Sequence[str]) -> tuple[Relighting, ...]:
    """The ambient light alone at each of its levels; where further lights vary in training, each of them
    alone at those levels, and mixtures of all at once."""
    if options.relit_views == 0:
        return ()
    varied = varied_lights(options, lights)
    levels = [{AMBIENT: level} for level in options.ambient_levels]
    levels += [{name: level} for name in varied if name != AMBIENT for level in options.ambient_levels]
    if options.mixed_levels is not None:
        levels += [
            dict(sorted(each, key=lambda pair: lights.index(pair[0]))) for each in options.mixed_levels
        ]
    elif len(varied) > 1:
        levels += mixtures(varied, options.lit_levels)
    levels_of_lights = [{name: level for name, level in each.items() if level != 1.0} for each in levels]
    unique = {Relighting(each).folder: Relighting(each) for each in levels_of_lights if each}
    return tuple(unique.values())


def mixtures(names: Sequence[str], trained: Sequence[float]) -> list[dict[str, float]]:
    """Every second light low and the others high, and the reverse, between and beyond the trained levels.

    Trained at 0.25 and 4: (0.5, 2), (2, 0.5), (0.125, 8), (8, 0.125).
    """
    positive = [level for level in trained if level > 0.0]
    low, high = min([1.0, *positive]), max([1.0, *positive])
    made = []
    for exponent in (BETWEEN, BEYOND):
        pair = [float(f"{level**exponent:.{DIGITS}g}") for level in (low, high)]
        made += [{name: pair[(k + turn) % 2] for k, name in enumerate(names)} for turn in (0, 1)]
    return made
