# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers of an evaluation: one row per comparison, and the means in the tables."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...bridge.data_set import TEST, VALIDATION
from ...bridge.lights import in_words
from .linearity import Linearity
from .metrics import MU

#: Exposure indices of the paper's two columns: those seen in training, and those between.
OBSERVED_EXPOSURES = (0, 2, 4)
NOVEL_EXPOSURES = (1, 3)
OBSERVED, NOVEL = "LDR-OE", "LDR-NE"
#: Names of the views of a split.
VIEWS_OF = {TEST: "test views", VALIDATION: "validation views"}


@dataclass(frozen=True)
class Metrics:
    """PSNR in dB (at most ``PSNR_CAP``), SSIM, LPIPS (canonical), LPIPS 01 (the paper's); None: skipped."""

    psnr: float
    ssim: float
    lpips: float | None = None
    lpips_01: float | None = None


@dataclass(frozen=True)
class LdrRow:
    """One view at one exposure (seconds)."""

    view: str
    index: int
    exposure_index: int
    exposure: float
    metrics: Metrics


@dataclass(frozen=True)
class HdrRow:
    """One view: M, its own median scale ratio, the metrics without and with the scale aligned.

    The ratio is NaN if all of the compared truth is black. ``slope``: ``Linearity.slope`` of this view.
    """

    view: str
    index: int
    normaliser: float
    scale_ratio: float
    metrics: Metrics
    aligned: Metrics
    slope: float = math.nan


@dataclass(frozen=True)
class RelitRow:
    """One test view under other light: PSNR in dB of pictures against the relit truth.

    ``levels``: of the changed lights, by name. ``scaled_truth`` is for ``factor`` × the true radiance under
    the standard light, ``scaled_ours`` for ``factor`` × ours. ``factor``: the level if a single light is
    changed (and not off), else ``best_factor``, the median of relit truth / true radiance;
    ``best_scaled_truth`` is for that × the true radiance: as good as scaling can be. ``light_left``: where a
    single light is off, how much of it remains in ours, as a share of it; None elsewhere, or where it shows
    nowhere.
    """

    levels: dict[str, float]
    view: str
    index: int
    normaliser: float
    scale_ratio: float
    ours: float
    scaled_truth: float
    scaled_ours: float
    best_scaled_truth: float
    factor: float
    best_factor: float
    light_left: float | None = None

    @property
    def condition(self) -> str:
        """``ambient 4 + pendant 0.25``."""
        return in_words(self.levels)

    @property
    def gain_over_scaled_truth(self) -> float:
        """dB by which ours is nearer to the relit truth than the true picture times ``factor``."""
        return self.ours - self.scaled_truth

    @property
    def gain_over_scaled_ours(self) -> float:
        """dB by which ours is nearer than our own picture times ``factor``."""
        return self.ours - self.scaled_ours

    @property
    def gain_over_best_scaled_truth(self) -> float:
        """dB by which ours is nearer than the true picture times ``best_factor``."""
        return self.ours - self.best_scaled_truth


@dataclass(frozen=True)
class LitRow:
    """One photo under other light that was left out: PSNR in dB of what may stand for it.

    ``ours``: relit, as the photo states its exposure. Of the standard light, at the exposure that fits best:
    ``scaled_ours``, our render; ``scaled_photo``, the photo from the same place, None where there is none.
    """

    group: str
    view: str
    index: int
    exposure_index: int
    exposure: float
    ours: float
    scaled_ours: float
    scaled_photo: float | None


@dataclass(frozen=True)
class GeometryRow:
    """How far a view's surface is from the true one.

    ``depth``: median error in metres, ``depth_beyond``: the share beyond 10 cm; ``normal``: median angle in
    degrees, ``normal_beyond``: the share beyond 30°, both NaN where every pixel has an edge.
    """

    view: str
    index: int
    depth: float
    depth_beyond: float
    normal: float
    normal_beyond: float


@dataclass(frozen=True)
class GeometryMeans:
    """Means over views of the numbers of ``GeometryRow``."""

    depth: float
    depth_beyond: float
    normal: float
    normal_beyond: float

    def __str__(self) -> str:
        return (
            f"surface against the true one, means over views: depth {100.0 * self.depth:.1f} cm (median "
            f"error; {100.0 * self.depth_beyond:.0f} % beyond 10 cm), normals {self.normal:.1f}° "
            f"({100.0 * self.normal_beyond:.0f} % beyond 30°)"
        )


@dataclass(frozen=True)
class LitMeans:
    """Means in dB over the photos of one group, or all; the photo's where each has one."""

    photos: int
    ours: float
    scaled_ours: float
    scaled_photo: float | None

    @property
    def gain(self) -> float:
        """dB by which ours is nearer than the best that scaling does."""
        return self.ours - max(self.scaled_ours, self.scaled_photo or -math.inf)


@dataclass(frozen=True)
class ExposureMeans:
    """All views at one exposure index. ``exposure``: median, seconds. ``part``: LDR-OE or LDR-NE."""

    exposure_index: int
    exposure: float
    part: str
    views: int
    metrics: Metrics


@dataclass(frozen=True)
class ViewMeans:
    """One view: its own LDR-OE and LDR-NE over its exposures, and its HDR row; None: not available."""

    view: str
    index: int
    ldr_oe: Metrics | None
    ldr_ne: Metrics | None
    hdr: Metrics | None
    scale_ratio: float | None
    slope: float | None


@dataclass(frozen=True)
class RelitMeans:
    """Means in dB over the views of one condition, or over everything; ``light_left`` where it is known."""

    ours: float
    scaled_truth: float
    scaled_ours: float
    best_scaled_truth: float
    light_left: float | None = None

    @property
    def gain_over_scaled_truth(self) -> float:
        return self.ours - self.scaled_truth

    @property
    def gain_over_scaled_ours(self) -> float:
        return self.ours - self.scaled_ours

    @property
    def gain_over_best_scaled_truth(self) -> float:
        return self.ours - self.best_scaled_truth


@dataclass(frozen=True)
class ResponseCheck:
    """Errors of a learned response; each number is the worst of the three channels.

    ``largest_fall``: how far the code falls anywhere while exposure rises (0: monotonic), in 1/255.
    ``rms_error``, ``largest_error``: of the code against the true curve where that is informative, in 1/255.
    ``scale``: the median of learned / true exposure at equal code, over all channels (1: the absolute scale
    is right). None: the true response is unknown; ``scale`` only: the learned curve reaches no true code.
    """

    largest_fall: float
    rms_error: float | None = None
    largest_error: float | None = None
    scale: float | None = None

    @property
    def is_monotonic(self) -> bool:
        return self.largest_fall == 0.0

    def __str__(self) -> str:
        rises = "rises everywhere" if self.is_monotonic else f"FALLS by {self.largest_fall:.2f}/255"
        if self.rms_error is None:
            return f"response: {rises}; the true one is unknown"
        scale = "not measurable" if self.scale is None else f"at equal code {self.scale:.4f}"
        return (
            f"response: {rises}; against the true one {self.rms_error:.2f}/255 RMS, at most "
            f"{self.largest_error:.2f}/255; exposure scale {scale}"
        )


@dataclass(frozen=True)
class Evaluation:
    """All numbers, row by row; means are computed from them. ``messages``: what was skipped, and why.

    ``split``: test or val.
    ``data_set``: the published benchmark that the scene belongs to (``published.data_set_of``), else "".
    ``response``: of a method with a global response curve. ``iteration``: the evaluated one of the planned
    ``iterations``; None: unknown. ``eight_bit``: whether all pictures were quantised to 8 bit.
    ``training_exposures``: the places in the bracket that training chose from; None: unknown.
    ``falloff_used``: whether the pictures have the learned vignetting, and are compared with it.
    """

    scene: str
    split: str
    exposure_mode: str
    resolution: tuple[int, int]
    ldr: list[LdrRow]
    hdr: list[HdrRow]
    relit: list[RelitRow]
    messages: list[str] = field(default_factory=list)
    mu: float = MU
    seconds: float = 0.0
    data_set: str = ""
    response: ResponseCheck | None = None
    iteration: int | None = None
    iterations: int | None = None
    eight_bit: bool = True
    training_exposures: tuple[int, ...] | None = None
    falloff_used: bool = False
    lit: list[LitRow] = field(default_factory=list)
    linearity: Linearity | None = None
    geometry: list[GeometryRow] = field(default_factory=list)

    def ldr_mean(self, part: str) -> Metrics | None:
        """Mean over the views for each exposure, then over those of ``part``; None if there are none."""
        return mean_metrics([each.metrics for each in self.exposures if each.part == part])

    @property
    def parts(self) -> dict[str, list[int]]:
        """The exposure indices of the two columns: the paper's, and further ones of longer brackets."""
        places = {*OBSERVED_EXPOSURES, *NOVEL_EXPOSURES, *(row.exposure_index for row in self.ldr)}
        return {part: sorted(k for k in places if part_of(k) == part) for part in (OBSERVED, NOVEL)}

    @property
    def ldr_oe(self) -> Metrics | None:
        """LDR at the exposures seen in training."""
        return self.ldr_mean(OBSERVED)

    @property
    def ldr_ne(self) -> Metrics | None:
        """LDR at novel exposures."""
        return self.ldr_mean(NOVEL)

    @property
    def exposures(self) -> list[ExposureMeans]:
        """The mean over the views at each exposure index, rising."""
        means = []
        for k in sorted({row.exposure_index for row in self.ldr}):
            rows = [row for row in self.ldr if row.exposure_index == k]
            metrics = mean_metrics([row.metrics for row in rows])
            assert metrics is not None
            exposure = float(np.median([row.exposure for row in rows]))
            means.append(ExposureMeans(k, exposure, part_of(k), len(rows), metrics))
        return means

    @property
    def views(self) -> list[ViewMeans]:
        """The numbers of each view, in the order of the rows."""
        hdr = {row.index: row for row in self.hdr}
        by_pose: dict[int, list[LdrRow]] = {}
        for row in self.ldr:
            by_pose.setdefault(row.index, []).append(row)

        def over(rows: list[LdrRow], part: str) -> Metrics | None:
            return mean_metrics([row.metrics for row in rows if part_of(row.exposure_index) == part])

        return [
            ViewMeans(
                rows[0].view,
                index,
                over(rows, OBSERVED),
                over(rows, NOVEL),
                hdr[index].metrics if index in hdr else None,
                hdr[index].scale_ratio if index in hdr else None,
                hdr[index].slope if index in hdr else None,
            )
            for index, rows in by_pose.items()
        ]

    @property
    def hdr_mean(self) -> Metrics | None:
        """HDR by the paper's protocol, scale not aligned."""
        return mean_metrics([row.metrics for row in self.hdr])

    @property
    def hdr_aligned_mean(self) -> Metrics | None:
        """HDR after dividing all predictions by the one ``scale_ratio``."""
        return mean_metrics([row.aligned for row in self.hdr])

    @property
    def scale_ratio(self) -> float | None:
        """The median over the views of their median prediction / truth; 1 is right. None: no view has one."""
        return middle_ratio([row.scale_ratio for row in self.hdr])

    @property
    def geometry_mean(self) -> GeometryMeans | None:
        """Over the views that have each number; None if there are no rows."""
        if not self.geometry:
            return None

        def mean(name: str) -> float:
            values = [value for row in self.geometry if not math.isnan(value := getattr(row, name))]
            return _mean(values) if values else math.nan

        return GeometryMeans(mean("depth"), mean("depth_beyond"), mean("normal"), mean("normal_beyond"))

    @property
    def lit_groups(self) -> list[str]:
        """The groups of photos under other light that have rows."""
        return list(dict.fromkeys(row.group for row in self.lit))

    def lit_mean(self, group: str | None = None) -> LitMeans | None:
        """Means over the photos of ``group``, or over all rows; None if there are none."""
        rows = [row for row in self.lit if group is None or row.group == group]
        if not rows:
            return None
        photos = [row.scaled_photo for row in rows if row.scaled_photo is not None]
        return LitMeans(
            len(rows),
            _mean([row.ours for row in rows]),
            _mean([row.scaled_ours for row in rows]),
            _mean(photos) if len(photos) == len(rows) else None,
        )

    @property
    def relit_conditions(self) -> list[str]:
        """The mixes of lights with rows (``ambient 4 + pendant 0.25``), in the truth's order."""
        return list(dict.fromkeys(row.condition for row in self.relit))

    def relit_mean(self, condition: str | None = None) -> RelitMeans | None:
        """Means over the views under ``condition``, or over all rows; None if there are none."""
        rows = [row for row in self.relit if condition is None or row.condition == condition]
        if not rows:
            return None
        left = [row.light_left for row in rows if row.light_left is not None]
        return RelitMeans(
            _mean([row.ours for row in rows]),
            _mean([row.scaled_truth for row in rows]),
            _mean([row.scaled_ours for row in rows]),
            _mean([row.best_scaled_truth for row in rows]),
            _mean(left) if left else None,
        )


def part_of(place: int) -> str:
    """The column that an exposure belongs to; in brackets of more than five they keep alternating."""
    return NOVEL if place % 2 else OBSERVED


def middle_ratio(ratios: Sequence[float]) -> float | None:
    """The median of the finite scale ratios (black has none); None without any."""
    numbers = [ratio for ratio in ratios if math.isfinite(ratio)]
    return float(np.median(numbers)) if numbers else None


def mean_metrics(rows: list[Metrics]) -> Metrics | None:
    """The mean of each metric; LPIPS only if every row has it; None for no rows."""
    if not rows:
        return None
    lpips = [row.lpips for row in rows if row.lpips is not None]
    lpips_01 = [row.lpips_01 for row in rows if row.lpips_01 is not None]
    return Metrics(
        _mean([row.psnr for row in rows]),
        _mean([row.ssim for row in rows]),
        _mean(lpips) if len(lpips) == len(rows) else None,
        _mean(lpips_01) if len(lpips_01) == len(rows) else None,
    )


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
