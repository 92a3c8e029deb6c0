# SPDX-License-Identifier: GPL-3.0-or-later
"""What an inspection of a data set says, and the judgements that are the same for every layout."""

import math
from dataclasses import dataclass, field
from typing import Any, TypeGuard

import numpy as np

from .results import NOVEL_EXPOSURES, OBSERVED_EXPOSURES

#: Share of pixels without a usable exposure from which on there is a warning (as ``synth`` warns).
LOST = 0.05
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709
#: The response that is assumed where radiance is estimated from pictures: HDR-NeRF-Syn's camera.
GAMMA = 2.2


@dataclass
class Split:
    """``poses``: how many. ``levels``: light → the levels it has here. ``hdr``: how many true pictures."""

    poses: int
    levels: dict[str, list[float]] = field(default_factory=dict)
    hdr: int = 0


@dataclass
class Exposure:
    """``use``: OE (training sees it), NE (evaluation only). ``white``, ``black``: of the training pixels.

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

    ``messages``: what the reader decided, in sentences. ``resolution``: that training sees, pixels.
    """

    folder: str
    layout: str = ""
    scene: str = ""
    made_by: str = ""
    resolution: tuple[int, int] | None = None
    splits: dict[str, Split] = field(default_factory=dict)
    exposures: list[Exposure] = field(default_factory=list)
    exposure_modes: list[str] = field(default_factory=list)
    lights: list[str] = field(default_factory=list)
    relit: list[dict[str, Any]] = field(default_factory=list)
    passes: int = 0
    renders: dict[str, list[float]] = field(default_factory=dict)
    """``samples`` and ``noise_psnr`` (dB, before denoising) of each pose's render."""
    points: int | None = None
    response: str = ""
    camera: dict[str, Any] = field(default_factory=dict)
    dynamic_range: DynamicRange | None = None
    noise_floor: dict[str, Any] | None = None
    messages: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


# ---- exposures ---------------------------------------------------------------------------------------


def tell_exposures(found: Inspection, brackets: dict[str, list[dict[int, float]]]) -> None:
    """The exposures by their place in the bracket, and how training may use them.

    ``brackets``: of each split, one a view, place → seconds.
    """
    places: dict[int, float] = {}
    differ = False
    for bracket in (bracket for views in brackets.values() for bracket in views):
        for k, seconds in bracket.items():
            differ |= places.setdefault(k, seconds) != seconds
    if differ:
        found.warnings.append("the exposures differ from view to view: the first view's are shown")
    for k, seconds in sorted(places.items()):
        use = "OE" if k in OBSERVED_EXPOSURES else "NE" if k in NOVEL_EXPOSURES else "unused"
        found.exposures.append(Exposure(seconds, round(math.log2(seconds), 4), use, place=k))
    trained = {k for bracket in brackets.get("train", []) for k in bracket if k in OBSERVED_EXPOSURES}
    if found.exposures:
        found.exposure_modes = ["exp1", "exp3"] if len(trained) > 1 else ["exp1"]


class Clipped:
    """How much of the training pictures is white or black at each exposure."""

    def __init__(self) -> None:
        self._shares: dict[int, list[tuple[float, float]]] = {}

    def add(self, picture: np.ndarray, place: int) -> None:
        """``picture`` ``[H, W, 3]`` uint8. White: a channel is at 255; black: all are at 0."""
        brightest = picture.max(-1)
        self._shares.setdefault(place, []).append(((brightest == 255).mean(), (brightest == 0).mean()))

    def tell(self, found: Inspection) -> None:
        for exposure in found.exposures:
            if exposure.place in self._shares:
                means = np.mean(self._shares[exposure.place], axis=0)
                exposure.white, exposure.black = (round(float(value), 5) for value in means)


def warn_of_exposures(found: Inspection) -> None:
    """What is lost at both ends of the bracket, too few exposures, no test views."""
    warn = found.warnings.append
    if found.exposures:
        in_order = sorted(found.exposures, key=lambda exposure: exposure.seconds)
        shortest, longest = in_order[0], in_order[-1]
        for share, what, which, other in (
            (shortest.white, "white", "shortest", "shorter"),
            (longest.black, "black", "longest", "longer"),
        ):
            if share is not None and share > LOST:
                warn(
                    f"{share:.0%} of the training pixels are {what} even at the {which} exposure: "
                    f"{other} exposures would show more"
                )
        if len(found.exposure_modes) < 2:
            warn("training sees one exposure only: the scale of the radiance comes from the response alone")
    if "test" not in found.splits:
        warn("there are no test views: physhdr evaluate has nothing to measure")


# ---- numbers -----------------------------------------------------------------------------------------


def dynamic_range_of(luminance: np.ndarray) -> DynamicRange:
    """As dataset.json defines it; ``stops`` is None where more than one pixel in a hundred is black."""
    low, high = float(np.percentile(luminance, 1)), float(luminance.max())
    return DynamicRange(low, high, round(math.log2(high / low), 2) if low > 0 else None)


class Estimate:
    """Dynamic range from pictures alone: the brightest pixel of the shortest exposure over the 1st percentile
    of the longest, both through the inverse of (x / (1 + x))^(1 / 2.2).
    """

    def __init__(self) -> None:
        self.counts: dict[float, np.ndarray] = {}

    def add(self, picture: np.ndarray, seconds: float) -> None:
        """Count the codes of a picture's mean over the channels."""
        codes = np.round(picture.mean(-1)).astype(np.int64)
        counted = np.bincount(codes.ravel(), minlength=256)
        self.counts[seconds] = self.counts.get(seconds, np.zeros(256, np.int64)) + counted

    def range(self) -> DynamicRange | None:
        """None without pictures."""
        if not self.counts:
            return None
        shortest, longest = min(self.counts), max(self.counts)
        brightest = int(np.nonzero(self.counts[shortest])[0][-1])
        share = np.cumsum(self.counts[longest]) / self.counts[longest].sum()
        darkest = int(np.searchsorted(share, 0.01))
        high, low = _radiance(min(brightest, 254), shortest), _radiance(max(darkest, 1), longest)
        clipped = brightest == 255 or darkest == 0
        stops = round(math.log2(high / low), 1) if high > low else 0.0
        return DynamicRange(low, high, stops, estimated=True, at_least=clipped)


def _radiance(code: int, seconds: float) -> float:
    linear = (code / 255.0) ** GAMMA
    return linear / (1.0 - linear) / seconds


def is_number(value: Any) -> TypeGuard[float]:
    """A finite one that a float can hold, which not every integer of a JSON file can."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
