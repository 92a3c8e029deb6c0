# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pictures of a COLMAP model belong to one pose: brackets, where names say so."""

import math
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...bridge.layouts.picture_files import SUFFIXES, bracket_name
from .camera import Camera
from .colmap_model import SparseImage, SparseModel

#: Pictures whose cameras are farther apart than this share of the cameras' spread are no bracket: a hand does
#: not move that far.
FAR = 0.1
#: Nor does it turn so far, degrees: beyond, they are views around from one place.
TURNED = 10.0


@dataclass(frozen=True, eq=False)
class Group:
    """A pose: picture names by place in the bracket, and those of them that the model has."""

    name: str
    names: dict[int, str]
    registered: list[SparseImage]


def grouped(
    model: SparseModel, there: Sequence[str], spread: float
) -> tuple[list[Group], set[str], list[str]]:
    """The poses of a model in the order of names; the names of those beside brackets that are none; messages.

    ``there``: names of pictures, among which a bracket's others are looked for. ``spread``: of all cameras.
    """
    groups, strays = _brackets_by_name(model.images, there)
    messages = []
    if strays:
        messages.append(
            f"{len(strays)} of {len(model.images)} pictures of the model are not named as brackets: "
            f"each is a separate view (first: {strays[0].registered[0].name:.200})"
        )
    groups, alone = sorted([*groups, *strays], key=lambda group: group.name), list(strays)
    far = [group for group in groups if moved(model, group) > FAR * spread]
    away = {
        group: [image for image in group.registered if turn(model, group, image) > TURNED]
        for group in groups
        if group not in far
    }
    # COLMAP may orient a dark picture of a bracket wrongly; the others show where the camera was.
    turned = [group for group, images in away.items() if 2 * len(images) >= len(group.registered)]
    for some, are in ((far, "are far apart"), (turned, "look in different directions")):
        if some:
            names = ", ".join(f"'{group.name}_…'" for group in some)
            messages.append(
                f"names like brackets, but the cameras of {names} {are}: each of their pictures in the model "
                "is a separate view"
            )
    odd = [image.name for group, images in away.items() if group not in turned for image in images]
    if odd:
        messages.append(
            f"{len(odd)} of {len(model.images)} pictures of the model are turned by more than {TURNED:g}° "
            "against most of their bracket: they stay in it, under the camera of the picture with the most "
            f"points (first: {odd[0]:.200})"
        )
    far += turned
    if far:
        groups = [one for group in groups for one in (single(group.registered) if group in far else [group])]
        alone += [one for group in far for one in single(group.registered)]
    return groups, {group.name for group in alone}, messages


def single(images: list[SparseImage]) -> list[Group]:
    """Each picture of the model as a pose of its own."""
    return [Group(image.name.rsplit(".", 1)[0], {0: image.name}, [image]) for image in images]


def with_pictures(groups: list[Group], usable: Mapping[str, Path]) -> list[Group]:
    """The groups without the names that no picture belongs to, and without those that are left with none."""
    left = (
        Group(group.name, {k: n for k, n in group.names.items() if n in usable}, group.registered)
        for group in groups
    )
    return [group for group in left if group.names]


def _brackets_by_name(images: list[SparseImage], there: Sequence[str]) -> tuple[list[Group], list[Group]]:
    """The model's poses, each with all its pictures that are there; and its pictures that are of no bracket.

    Names are of brackets where all are ``<pose>_<k>`` and some pose has several pictures, or where at least
    half of the model's pictures are of such poses. Else each picture is a pose, and none is apart. The
    smallest k becomes place 0.
    """
    in_model: dict[str, list[SparseImage]] = {}
    others = [image.name for image in images if bracket_name(image.name) is None]
    series = {re.sub(r"_\d+\.[^./]+$", "", name) for name in others}  # img_10: img_1 … img_9 are numbers, too
    for image in images:
        parts = bracket_name(image.name)
        if parts is not None and parts[0] not in series:
            in_model.setdefault(parts[0], []).append(image)
    names: dict[str, dict[int, str]] = {}
    # Of a_0.jpg and a_0.png, the one in the model.
    for name in [*(image.name for found in in_model.values() for image in found), *there]:
        parts = bracket_name(name)
        if parts is not None and parts[0] in in_model and name.lower().endswith(SUFFIXES):
            names.setdefault(parts[0], {}).setdefault(parts[1], name)
    named = {image.name for base in names for image in in_model[base]}
    several = sum(len(in_model[base]) for base, bracket in names.items() if len(bracket) > 1)
    if not several or (len(named) < len(images) and 2 * several < len(images)):
        return single(images), []
    first = min(min(bracket) for bracket in names.values())
    groups = [
        Group(base, {k - first: names[base][k] for k in sorted(names[base])}, in_model[base])
        for base in sorted(names)
    ]
    strays = single([image for image in images if image.name not in named])
    return groups, [
        Group(stray.names[0], stray.names, stray.registered) if stray.name in names else stray
        for stray in strays
    ]


def placed(groups: list[Group], alone: set[str], seconds: dict[str, float]) -> list[Group]:
    """The groups, each single picture in ``alone`` at the brackets' place whose exposure is closest."""
    logs: dict[int, list[float]] = {}
    for group in groups:
        if group.name not in alone:
            for k, name in group.names.items():
                logs.setdefault(k, []).append(math.log(seconds[name]))
    usual = {k: statistics.median(values) for k, values in logs.items()}
    if not usual:
        return groups
    found = []
    for group in groups:
        if group.name in alone:
            ((_, name),) = group.names.items()
            k = min(usual, key=lambda k, name=name: abs(usual[k] - math.log(seconds[name])))
            group = Group(group.name, {k: name}, group.registered)
        found.append(group)
    return found


def alike(groups: list[Group], seconds: dict[str, float]) -> tuple[str, str] | None:
    """Two pictures of one pose with one exposure, which brackets do not have."""
    for group in groups:
        seen: dict[float, str] = {}
        for name in group.names.values():
            if seconds[name] in seen:
                return seen[seconds[name]], name
            seen[seconds[name]] = name
    return None


def camera_of(model: SparseModel, group: Group) -> Camera:
    """The camera of the group's picture with the most points."""
    return model.camera(best_of(group))


def moved(model: SparseModel, group: Group) -> float:
    """How far the group's other cameras are from that of ``camera_of`` at most, units."""
    of = camera_of(model, group).position
    return max(float(np.linalg.norm(model.camera(image).position - of)) for image in group.registered)


def turn(model: SparseModel, group: Group, image: SparseImage) -> float:
    """By how much the camera of one of the group's pictures is turned against ``camera_of``, degrees."""
    of = camera_of(model, group).camera_to_world[:3, :3]
    # The difference of two rotations has the norm √8 sin(angle / 2).
    apart = float(np.linalg.norm(model.camera(image).camera_to_world[:3, :3] - of))
    return math.degrees(2.0 * math.asin(min(1.0, apart / math.sqrt(8.0))))


def best_of(group: Group) -> SparseImage:
    """The group's picture with the most points."""
    return max(group.registered, key=lambda image: image.observed)
