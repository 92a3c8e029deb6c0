# SPDX-License-Identifier: GPL-3.0-or-later
"""How noisy a sensor is: variance = slope × signal + offset, of photons and of the electronics.

Found in the raw pictures themselves, where a file does not tell it: among blocks of equal brightness the flat
ones vary least, and what varies there is noise (Foi et al., "Practical Poissonian-Gaussian noise modeling and
fitting for single-image raw-data", 2008, is the model; the fit here is simpler).
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

#: Photosites of one colour along each side of a block: 144 independent differences.
BLOCK = 24
#: Of the blocks of one brightness the share that varies least is taken for flat.
FLAT = 0.2
#: Brightnesses that are told apart, each with at least so many blocks.
BINS, FEWEST = 32, 20
#: Blocks darker than the first are left out, and those that hold anything brighter than the second: what is
#: cut off at white varies too little.
DARKEST, BRIGHTEST = 0.005, 0.98


@dataclass(frozen=True)
class Noise:
    """Of one photosite, before white balance: variance = ``slope`` × signal + ``offset``, signal 0…1."""

    slope: float
    offset: float


def planes_of_mosaic(codes: np.ndarray, black: np.ndarray, white: float) -> list[np.ndarray]:
    """The four pictures ``[h, w]`` of a Bayer mosaic ``[H, W]``: 0 at ``black`` ``[2, 2]``, 1 at white."""
    height, width = (side // 2 * 2 for side in codes.shape)
    return [
        (codes[row:height:2, column:width:2].astype(np.float32) - black[row, column])
        / (white - black[row, column])
        for row in range(2)
        for column in range(2)
    ]


def estimated(planes: Iterable[np.ndarray]) -> Noise | None:
    """The noise of pictures ``[h, w]`` of one ISO; None where too little of them is flat."""
    blocks = [_blocks(plane) for plane in planes]
    if not blocks:
        return None
    signal, variance, brightest = np.concatenate(blocks, axis=1)
    inside = (signal > DARKEST) & (brightest < BRIGHTEST)
    signal, variance = signal[inside], variance[inside]
    # Bins of equal ratio: photographs have far more dark than bright.
    edges = np.geomspace(DARKEST, 1.0, BINS + 1)
    points = []
    for low, high in itertools.pairwise(edges):
        here = (signal >= low) & (signal < high)
        if here.sum() >= FEWEST:
            points.append((np.median(signal[here]), np.quantile(variance[here], FLAT), here.sum()))
    if len(points) < 3:
        return None
    x, y, count = np.array(points).T
    # The quantile of a variance that is estimated from so many differences, were all blocks flat.
    free = (BLOCK // 2) ** 2
    y = y / (2.0 * gammaincinv(free / 2.0, FLAT) / free)
    weight = np.sqrt(count) / np.maximum(y, y.max() * 1e-6)  # each variance is known to a share of itself
    slope, offset = np.linalg.lstsq(np.stack([x, np.ones_like(x)], axis=1) * weight[:, None], y * weight)[0]
    if slope < 0.0:
        slope, offset = 0.0, float(np.average(y, weights=weight**2))
    elif offset < 0.0:
        offset, slope = 0.0, float((x * y * weight**2).sum() / (x * x * weight**2).sum())
    return Noise(float(slope), float(offset))


def _blocks(plane: np.ndarray) -> np.ndarray:
    """``[3, n]``: the mean of each block, its variance at the finest scale, its largest value.

    By (a − b − c + d) / 2 of each two by two, which is free of any slope of brightness and has the variance
    of one of the four.
    """
    height, width = (side // BLOCK * BLOCK for side in plane.shape)
    plane = plane[:height, :width]
    fine = (plane[::2, ::2] - plane[::2, 1::2] - plane[1::2, ::2] + plane[1::2, 1::2]) / 2.0

    def cut(values: np.ndarray, side: int) -> np.ndarray:
        tall, wide = values.shape[0] // side, values.shape[1] // side
        return values.reshape(tall, side, wide, side).swapaxes(1, 2).reshape(tall * wide, side * side)

    whole = cut(plane, BLOCK)
    return np.stack([whole.mean(axis=1), cut(fine**2, BLOCK // 2).mean(axis=1), whole.max(axis=1)])
