# SPDX-License-Identifier: GPL-3.0-or-later
"""How far each Gaussian's radiance can be trusted, according to the training pictures.

A pixel's codes determine ln radiance with a variance v: each exposure k adds (d value / d ln x)² / variance
of the value to 1/v, and adds nothing where it is clipped or black. Before any picture is considered, the
rendered radiance is off by ``UNKNOWN`` (a factor e); the codes say that it is off by Δ. By Bayes for normal
distributions, with s = UNKNOWN² / (UNKNOWN² + v), its expected squared error is then

    E = (s Δ)² + s v

which is Δ² where pixels are well exposed, and UNKNOWN² where every exposure is clipped or starved. A view
says √(mean of E over the channels), averaged over the pixels that a Gaussian is in by its blend weights w
(transmittance × alpha); all views together, each counting 1 − exp(−Σ w), so that one near view is no more
than a view, and a further one of weight ``DOUBT`` that says UNKNOWN: what few views see is unsure. That is
the expected error b; the confidence is 1 − exp(−(TOLERANCE / b) ^ SHAPE), a Weibull distribution of errors.

``DOUBT`` and ``SHAPE`` were fitted on validation views of the two tuning scenes (docs/light.md); no true
radiance is read here.

Σ_p w_p q_p of any per-pixel q is the gradient of Σ_p q_p image_p with respect to a Gaussian's colour, so the
rasteriser can compute it unchanged: one picture forward, one backward.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...bridge.confidence import TOLERANCE
from ..methods.base import Method
from ..model.backbone import Splats
from ..model.tone_mapper import Response
from ..rasterize import Rasterization, rasterize
from ..scene.camera import Camera
from ..scene.encoding import LARGEST, Encoding
from ..scene.scene import View

#: Standard deviation of ln radiance where nothing is known: a factor e, 1.4 stops.
UNKNOWN = 1.0
#: The cap on a measured error.
LARGEST_ERROR = 2.0
#: The weight of not knowing, in views.
DOUBT = 0.05
#: Of the Weibull distribution of errors: between exponential (1) and that of a distance in a plane (2).
SHAPE = 1.75
#: Standard deviation of a camera's values beside rounding, of 0 … 1: half a code of 8 bits.
NOISE = 0.5 / 255.0
#: Radiance below this has the logarithm of this.
DARKEST = 1e-6
#: The pixels that say how a photo's own gain is off are at least so many, each known to this variance.
FEWEST, TELLING = 64, 0.1**2
#: This many pixels are used, of evenly spread views, in about 45 s on two cores. (Not of smaller pictures:
#: small Gaussians are widened to their pixels, and what is right looks wrong.)
MOST_PIXELS = 100_000_000
#: … but of at least this many views, whatever their size.
FEWEST_VIEWS = 32


@dataclass(frozen=True)
class ViewInTraining:
    """A view used in training, at those positions of its bracket.

    ``effect``: what the lens did to the light, a factor ``[1 or 3, H, W]``; None: nothing.
    ``has_own_gain``: its pictures are photos, each with an unknown gain and white balance; the
    median difference of each channel is then the camera's, not an error of the radiance.
    """

    view: View
    positions: tuple[int, ...]
    effect: torch.Tensor | None = None
    has_own_gain: bool = False


@dataclass(frozen=True)
class CodeInformation:
    """What each code determines: ln(exposure × radiance) and 1 / its variance, ``[codes, 3]`` float32."""

    log_exposed: np.ndarray
    information: np.ndarray


def information_of(encoding: Encoding, response: Response, dtype: np.dtype) -> CodeInformation:
    """What codes of that type determine with that ``encoding``; a camera's by the learned response."""
    codes = np.arange(LARGEST[np.dtype(dtype)] + 1)
    unit = encoding.unit(np.dtype(dtype))
    values = np.repeat((codes / unit)[:, None], 3, axis=1)
    if encoding.is_known:
        exposed = encoding.decode(values)
        log_exposed = np.log(np.maximum(exposed, np.finfo(np.float64).tiny))
        log_exposed[0] = log_exposed[1]
        slope = np.zeros_like(values)
        slope[1:] = np.gradient(values[1:, 0], log_exposed[1:, 0])[:, None]
    else:
        log_exposed, slope = _by_response(response, values)
    variance = 1.0 / (12.0 * unit**2) + NOISE**2
    information = slope**2 / variance
    information[0] = 0.0
    if encoding.clips or not encoding.is_known:
        information[-1] = 0.0
    return CodeInformation(log_exposed.astype(np.float32), information.astype(np.float32))


def _by_response(response: Response, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln exposure and slope of values ``[codes, 3]`` by a learned response; slope 0 beyond its ends."""
    x, curves = (part.double().cpu().numpy() for part in response.sampled())
    log_exposed, slope = np.empty_like(values), np.empty_like(values)
    for channel in range(3):
        curve = np.maximum.accumulate(curves[:, channel])
        log_exposed[:, channel] = np.interp(values[:, channel], curve, x)
        slope[:, channel] = np.interp(log_exposed[:, channel], x, np.gradient(curve, x))
        beyond = (values[:, channel] < curve[0]) | (values[:, channel] > curve[-1])
        slope[beyond, channel] = 0.0
    return log_exposed, slope


class Tables:
    """``information_of`` of a response, each made once."""

    def __init__(self, response: Response) -> None:
        self._response = response
        self._made: dict[tuple[Encoding, np.dtype], CodeInformation] = {}

    def of(self, encoding: Encoding, dtype: np.dtype) -> CodeInformation:
        key = encoding, dtype
        if key not in self._made:
            self._made[key] = information_of(encoding, self._response, dtype)
        return self._made[key]


def expected_error(
    seen: ViewInTraining, radiance: np.ndarray, tables: Tables
) -> tuple[np.ndarray, np.ndarray]:
    """√E ``[H, W]`` of a view's drawn ``radiance`` ``[3, H, W]``, and which pixels are compared, bool.

    Raises what reading its pictures raises.
    """
    view = seen.view
    log_drawn = np.log(np.maximum(radiance, DARKEST)).astype(np.float32)
    if seen.effect is not None:
        log_drawn = log_drawn + np.log(np.maximum(seen.effect.cpu().numpy(), DARKEST))
    total, weighted = np.zeros_like(log_drawn), np.zeros_like(log_drawn)
    compared = np.zeros(log_drawn.shape[1:], bool)
    for k in seen.positions:
        codes, mask = view.image(k), view.mask(k)
        known = tables.of(view.encodings[k], codes.dtype)
        channels = range(3)
        information = np.stack([known.information[codes[..., c], c] for c in channels])
        difference = np.stack([known.log_exposed[codes[..., c], c] for c in channels])
        difference -= log_drawn + np.float32(math.log(view.exposures[k]))
        if mask is not None:
            information = information * mask
        compared |= True if mask is None else mask
        if seen.has_own_gain:
            difference -= _own_gain(difference, information)
        total += information
        weighted += information * difference
    variance = 1.0 / np.maximum(total, 1e-12)
    share = UNKNOWN**2 / (UNKNOWN**2 + variance)
    squared = (share * weighted * variance) ** 2 + share * variance
    return np.sqrt(np.minimum(squared, LARGEST_ERROR**2).mean(axis=0)), compared


def _own_gain(difference: np.ndarray, information: np.ndarray) -> np.ndarray:
    """``[3, 1, 1]``: by how much a photo is brighter than it states, in each channel."""
    telling = information > 1.0 / TELLING
    medians = [
        np.median(plane[known]) if np.count_nonzero(known) >= FEWEST else 0.0
        for plane, known in zip(difference, telling, strict=True)
    ]
    return np.array(medians, np.float32)[:, None, None]


def blended(splats: Splats, camera: Camera, planes: np.ndarray) -> torch.Tensor:
    """``[N, 3]``: each Gaussian's Σ_p w_p q_p of three quantities q of pixels, ``planes`` ``[3, H, W]``."""
    colours = torch.zeros(splats.means.shape[0], 3, requires_grad=True)
    with torch.enable_grad():
        image = _drawn(splats, colours, camera).image
        image.backward(torch.from_numpy(np.ascontiguousarray(planes, np.float32)))
    assert colours.grad is not None
    return colours.grad


def _drawn(splats: Splats, colours: torch.Tensor, camera: Camera) -> Rasterization:
    """On the CPU, whatever device the run uses."""
    means, quaternions = splats.means.detach(), splats.quaternions.detach()
    return rasterize(means, quaternions, splats.scales.detach(), splats.opacities.detach(), colours, camera)


def thinned(seen: Sequence[ViewInTraining]) -> Sequence[ViewInTraining]:
    """As many of the views, evenly spread, as ``MOST_PIXELS`` and ``FEWEST_VIEWS`` allow."""
    pixels = sum(each.view.camera.width * each.view.camera.height for each in seen)
    if pixels <= MOST_PIXELS or len(seen) <= FEWEST_VIEWS:
        return seen
    count = max(FEWEST_VIEWS, len(seen) * MOST_PIXELS // pixels)
    return [seen[index] for index in np.linspace(0, len(seen) - 1, count).round().astype(int)]


@torch.no_grad()
def confidence_of(
    method: Method, seen: Sequence[ViewInTraining], show: Callable[[int, int, str], None] | None = None
) -> np.ndarray:
    """``[N]`` float32 in 0 … 1, of a method on plain Gaussians on the CPU (``on_gaussians``).

    ``show(done, of how many, which view)`` is called after each view. Raises what reading pictures raises.
    """
    seen = thinned(seen)
    tables = Tables(method.first_response)
    said, weight = (torch.zeros(method.size, dtype=torch.float64) for _ in range(2))
    for done, each in enumerate(seen, start=1):
        camera = each.view.camera
        splats = method.backbone.splats(camera, method.active_sh_degree)
        levels = method.standard_levels if each.view.is_standard else each.view.known_levels
        radiance = _drawn(splats, method.seen_radiance(splats, levels), camera).image
        error, compared = expected_error(each, radiance.numpy(), tables)
        ones = compared.astype(np.float32)
        drawn = blended(splats, camera, np.stack([ones, ones * error, ones])).double()
        counted = -torch.expm1(-drawn[:, 0])
        said += counted * drawn[:, 1] / drawn[:, 0].clamp_min(1e-12)
        weight += counted
        if show is not None:
            show(done, len(seen), each.view.name)
    expected = (said + DOUBT * UNKNOWN) / (weight + DOUBT)
    return confidence_at(expected.numpy()).astype(np.float32)


def confidence_at(expected: np.ndarray) -> np.ndarray:
    """The confidence where |ln error| is expected to be that: the probability of less than TOLERANCE."""
    return -np.expm1(-((TOLERANCE / np.maximum(expected, 1e-9)) ** SHAPE))


@torch.no_grad()
def confidence_picture(method: Method, confidence: np.ndarray, camera: Camera) -> Rasterization:
    """Confidence drawn as ``camera`` sees it: three equal channels, 0 where nothing is drawn."""
    splats = method.backbone.splats(camera, method.active_sh_degree)
    colours = torch.from_numpy(np.ascontiguousarray(confidence, np.float32))[:, None].expand(-1, 3)
    return _drawn(splats, colours.contiguous(), camera)
