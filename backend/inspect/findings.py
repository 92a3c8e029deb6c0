# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of inspecting a data set, and the checks shared by all layouts."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ...bridge.contents import lost_at_the_ends
from ...bridge.data_set import TEST, TRAIN
from ...bridge.limits import is_number
from ..evaluate.results import OBSERVED, part_of


@dataclass
class Split:
    """``poses``: number of poses. ``levels``: light → its levels. ``hdr``: number of true pictures."""

    poses: int
    levels: dict[str, list[float]] = field(default_factory=dict)
    hdr: int = 0


@dataclass
class Exposure:
    """``use``: OE (for training), NE (evaluation only). ``white``, ``black``: shares of the training pixels.

    ``place``: in the bracket, 0 to 4 in the paper's data.
    """

    seconds: float
    ev: float
    use: str
    white: float | None = None
    black: float | None = None
    place: int = 0


@dataclass
class DynamicRange:
    """Luminance of the training views from the 1st percentile to the maximum, in stops.

    ``estimated``: from the pictures, through an assumed response; ``at_least``: some were clipped.
    """

    percentile_1: float
    maximum: float
    stops: float | None
    estimated: bool = False
    at_least: bool = False


@dataclass
class Inspection:
    """Everything found in ``folder``; ``errors`` are faults that make the data unusable as they are.

    ``remedies``: one for each of them. ``messages``: decisions of the reader. ``resolution``: pixels of the
    view of median size, as in training; ``resolutions``: how many different ones there are.
    """

    folder: str
    layout: str = ""
    scene: str = ""
    made_by: str = ""
    resolution: tuple[int, int] | None = None
    resolutions: int = 1
    splits: dict[str, Split] = field(default_factory=dict)
    exposures: list[Exposure] = field(default_factory=list)
    exposure_modes: list[str] = field(default_factory=list)
    over_views: float = 0.0
    """Stops from the shortest to the longest exposure if each view has its own."""
    lights: list[str] = field(default_factory=list)
    turnable: list[str] = field(default_factory=list)
    """Of a capture, a sentence for each light that can be turned afterwards."""
    relit: list[dict[str, Any]] = field(default_factory=list)
    passes: int = 0
    samples: dict[str, list[float]] = field(default_factory=dict)
    """For each split, the samples per pixel of each pose's render."""
    noise_psnr: list[float] = field(default_factory=list)
    """Of each pose's render in dB, before denoising."""
    points: int | None = None
    points_origin: str = ""
    """The kind of points according to their file; empty if unknown."""
    response: str = ""
    camera: dict[str, Any] = field(default_factory=dict)
    dynamic_range: DynamicRange | None = None
    noise_floor: dict[str, Any] | None = None
    """Of two renders of one test view: ``psnr`` (dB at each exposure) and ``hdr_psnr``, as stated."""
    reference_floor: dict[str, Any] | None = None
    """The same for the stored test view and one rendered without denoising at ``samples``."""
    messages: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    remedies: list[str] = field(default_factory=list)

    def add_fault(self, message: str, remedy: str) -> None:
        """Add one of the ``errors``."""
        self.errors.append(message)
        self.remedies.append(remedy)


def samples_in_words(samples: Mapping[str, Sequence[float]]) -> str:
    """``256``, ``8 … 10``; if the splits differ, ``train 256, test 4096``."""
    spans = {split: span(values) for split, values in samples.items()}
    if len(set(spans.values())) == 1:
        return next(iter(spans.values()))
    return ", ".join(f"{split} {words}" for split, words in spans.items())


def span(values: Sequence[float]) -> str:
    """``8``, or ``8 … 10`` from the least to the most; ``–`` for no values."""
    if not values:
        return "–"
    return " … ".join(dict.fromkeys(f"{value:.4g}" for value in (min(values), max(values))))


def floor_in_words(floor: Mapping[str, Any]) -> str:
    """``50, 51 dB at the exposures, HDR 47 dB``, and the number of samples if known.

    The floor of stored truth was measured with the response it names, which may differ from the data's.
    """
    hdr, samples, response = floor.get("hdr_psnr"), floor.get("samples"), floor.get("response")
    by = f" by {response:.40}" if isinstance(response, str) else ""
    return (
        f"{', '.join(f'{value:g}' for value in floor['psnr'])} dB at the exposures{by}"
        + (f", HDR {hdr:g} dB" if is_number(hdr) else "")
        + (f" ({samples:g} samples)" if is_number(samples) else "")
    )


def add_exposures(
    found: Inspection, brackets: dict[str, list[dict[int, float]]], sees_all: bool = False
) -> None:
    """Add the exposures by their place in the bracket, and their use in training.

    ``brackets``: for each split, one per view, place → seconds. ``sees_all``: training uses all.
    """
    every = [bracket for views in brackets.values() for bracket in views]
    places: dict[int, float] = {}
    differ = False
    for bracket in every:
        for k, seconds in bracket.items():
            differ |= places.setdefault(k, seconds) != seconds
    if differ and all(len(bracket) == 1 for bracket in every):
        seconds = [only for bracket in every for only in bracket.values()]
        found.over_views = round(math.log2(max(seconds) / min(seconds)), 4)
        found.messages.append(
            f"one exposure per view, from {min(seconds):.3g} to {max(seconds):.3g} s: a bracket of "
            f"{found.over_views:.2g} stops over the views (the first view's is shown)"
        )
    elif differ:
        found.warnings.append("the exposures differ from view to view: the first view's are shown")
    observed = {k for k in places if sees_all or part_of(k) == OBSERVED}
    for k, seconds in sorted(places.items()):
        use = "OE" if k in observed else "NE"
        found.exposures.append(Exposure(seconds, round(math.log2(seconds), 4), use, place=k))
    trained = {k for bracket in brackets.get(TRAIN, []) for k in bracket if k in observed}
    if found.exposures:
        found.exposure_modes = ["exp1", "exp3"] if len(trained) > 1 else ["exp1"]


def warn_of_exposures(found: Inspection) -> None:
    """Warn of losses at both ends of the bracket, too few exposures, and missing test views."""
    warn = found.warnings.append
    if found.exposures:
        in_order = sorted(found.exposures, key=lambda exposure: exposure.seconds)
        for lost, other in lost_at_the_ends(in_order[0].white, in_order[-1].black):
            warn(f"{lost}: {other} exposures would show more")
        if len(found.exposure_modes) < 2 and not found.over_views:
            warn("training sees one exposure only: the scale of the radiance comes from the response alone")
    if TEST not in found.splits:
        warn("there are no test views: physhdr evaluate has nothing to measure")
