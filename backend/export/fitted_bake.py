# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours with which a standard 3DGS viewer shows our own picture.

Our picture blends radiance, then responds; viewers blend display colours. No conversion of each Gaussian's
colour by itself makes both equal: where Gaussians of different radiance overlap, the response of the blend is
not the blend of the responses. So the colours are fitted to pictures. Shapes and opacities stay, hence a
viewer's picture is linear in the colours but for their floor at 0,

    image_p = Σ_i w_pi max(0, ½ + Σ_k sh_ik Y_k(ω_i)),

with the weights w found once a view (``rasterize.cpu.weights``). It is least squares, by Gauss and Newton:
conjugate gradients between which the colours at the floor are chosen anew, with the diagonal as
preconditioner. A ridge holds what no pixel determines at its starting colours.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from ...bridge import srgb
from ...bridge.display import Tone
from ...bridge.lights import Levels
from ...bridge.model_file import Model
from ..evaluate.renderer import Renderer
from ..kernels.blending import blend, gather, gather_squares, spread, spread_squares, toward_camera
from ..rasterize import rasterize
from ..rasterize.cpu.weights import BlendWeights, blend_weights
from ..scene.camera import Camera
from ..simd import run_parallel, run_ranges

#: Views that are fitted to at most: training cameras, evenly spread, and places between them.
MOST_VIEWS = 48
#: Focal lengths there, of the cameras': what lies beside their pictures will be looked at, too. And their
#: pictures are finer, up to a screen's width: viewers show more pixels than the data set's pictures have,
#: and colours that were fitted to those alone are speckled there. (lab/notebook.md, Colours for viewers)
WIDER, FINER, SCREEN = 0.8, 3.0, 1600
#: Weights that are held, 8 bytes each; where all pixels have more, so many of the pixels are fitted to, as
#: many of each view.
MOST_WEIGHTS = 60_000_000
#: Pixels of each view by which those are estimated beforehand.
PROBED = 2000
#: What holds a coefficient at its start, against the sum of w² Y² over all pixels that see it.
RIDGE = 1e-3
#: Conjugate gradients' steps after each choice of what is at the floor.
STEPS = (15, 15)

Picture = Callable[[Camera], np.ndarray]
#: Called with (steps done, of how many, what is done).
Show = Callable[[int, int, str], None]


def fitted_colour_sh(
    model: Model, start: np.ndarray, cameras: Sequence[Camera], picture: Picture, show: Show | None = None
) -> np.ndarray:
    """``[N, K, 3]`` float32: SH of display colours (colour = Σ sh·Y + ½) whose blend is ``picture``.

    ``start`` ``[N, K, 3]``: where it begins, and stays where no camera shows otherwise
    (``display_colour_sh``). ``cameras``: those of the training views; ``picture`` draws what is to be shown
    as one of them sees it, ``[3, H, W]`` in 0 … 1. The same on any number of threads.
    """
    fit = _Fit(model, _with_places_between(_thinned(cameras)), picture, start, show)
    sh = np.array(start, np.float32)
    for steps in STEPS:
        sh += fit.step(sh, steps)
    return sh


def model_picture(model: Model, exposure: float, levels: Levels = 1.0, tone: Tone = "LEARNED") -> Picture:
    """What a model file's own picture is: radiance blended, then its learned response or the sRGB curve.

    ``exposure`` seconds; ``levels`` and ``tone`` as ``display_colour_sh`` has them.
    """
    shape = _shape(model)

    def draw(camera: Camera) -> np.ndarray:
        radiance = torch.from_numpy(model.radiance(_directions(model.position, camera), levels))
        exposed = exposure * rasterize(*shape, radiance, camera).image.numpy()
        return _responded(model, exposed, tone)

    return draw


def method_picture(method: Renderer, exposure: float, levels: Levels = 1.0) -> Picture:
    """What a trained method's own picture is, with all of its networks."""

    @torch.no_grad()
    def draw(camera: Camera) -> np.ndarray:
        return method.ldr(camera, exposure, levels).clamp(0.0, 1.0).cpu().numpy()

    return draw


def _responded(model: Model, exposed: np.ndarray, tone: Tone) -> np.ndarray:
    x, curve = model.tone_curve_log_exposure, model.tone_curve
    if tone == "SRGB" or x is None or curve is None:
        return srgb.to_srgb(exposed.clip(0.0, 1.0)).astype(np.float32)
    log_exposed = np.log(np.maximum(exposed, np.exp(x[0])))
    return np.stack([np.interp(log_exposed[c], x, curve[:, c]) for c in range(3)]).astype(np.float32)


@dataclass(eq=False)
class _View:
    """What a view says: the pixels' weights, of the Gaussians in them alone (``seen`` ``[n]``, rising).

    ``directions`` ``[n, 3]``: from the camera. ``wanted`` ``[P, 3]``: the pixels. ``free`` ``[n, 3]``: 1
    where a colour is above the floor, else 0.
    """

    seen: np.ndarray
    weights: BlendWeights
    directions: np.ndarray
    wanted: np.ndarray
    free: np.ndarray

    @property
    def matrix(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.weights.starts, self.weights.gaussians, self.weights.weights

    def colours(self, sh: np.ndarray) -> np.ndarray:
        """``[n, 3]``: Σ_k sh_k Y_k."""
        found = np.empty_like(self.free)
        toward_camera(self.seen, self.directions, sh, found)
        return found

    def blended(self, colours: np.ndarray) -> np.ndarray:
        """``[P, 3]``: the pixels of ``colours``."""
        pixels = np.empty_like(self.wanted)
        blend(*self.matrix, colours, pixels)
        return pixels

    def gathered(self, pixels: np.ndarray) -> np.ndarray:
        """``[n, 3]``: Σ_p w_p pixel_p; nothing of colours at the floor."""
        sums = np.zeros_like(self.free)
        gather(*self.matrix, pixels, sums)
        sums *= self.free
        return sums

    def residual(self, sh: np.ndarray) -> np.ndarray:
        """``[n, 3]``: gathered differences to what is wanted; finds which colours are at the floor."""
        colours = self.colours(sh)
        colours += np.float32(0.5)
        np.greater(colours, 0.0, out=self.free, casting="unsafe")
        colours *= self.free
        return self.gathered(self.wanted - self.blended(colours))

    def curvature(self, sh: np.ndarray) -> np.ndarray:
        """``[n, 3]``: what a change ``sh`` does to the gathered differences."""
        colours = self.colours(sh)
        colours *= self.free
        return self.gathered(self.blended(colours))


class _Fit:
    """The least squares of all views."""

    def __init__(
        self,
        model: Model,
        cameras: Sequence[Camera],
        picture: Picture,
        start: np.ndarray,
        show: Show | None,
    ) -> None:
        self._count, self._coefficients = start.shape[:2]
        self._start = np.ascontiguousarray(start, np.float32)
        self._show, self._done = show, 0
        self._of = len(cameras) + sum(STEPS)
        random = np.random.default_rng(0)
        own = cameras[0].width * cameras[0].height
        held = sum(_weights_a_pixel(model, camera, random) for camera in cameras)
        most = max(1, min(own, int(MOST_WEIGHTS / held)))
        self._views: list[_View] = []
        for camera in cameras:
            self._views.append(_view_of(model, camera, picture, most, random))
            self._told()
        self._ridge = np.float32(RIDGE * most / own)
        self._preconditioner = self._inverse_diagonal()

    def step(self, sh: np.ndarray, steps: int) -> np.ndarray:
        """The change of ``sh`` that so many conjugate gradients find."""
        rest = self._summed([view.residual for view in self._views], sh)
        rest -= self._ridge * (sh - self._start)
        change = np.zeros_like(sh)
        ahead = self._preconditioner * rest
        along = ahead.copy()
        product = _dot(rest, ahead)
        for _ in range(steps):
            if product <= 0.0:
                break
            bent = self._summed([view.curvature for view in self._views], along)
            bent += self._ridge * along
            length = np.float32(product / _dot(along, bent))
            change += length * along
            rest -= length * bent
            np.multiply(self._preconditioner, rest, out=ahead)
            product, before = _dot(rest, ahead), product
            along *= np.float32(product / before)
            along += ahead
            self._told()
        return change

    def _summed(self, functions: Sequence[Callable[[np.ndarray], np.ndarray]], sh: np.ndarray) -> np.ndarray:
        """``[N, K, 3]``: the sum over views of what each gives ``[n, 3]`` of ``sh``, times its Y."""
        given: list[np.ndarray] = [np.empty(0)] * len(functions)
        tickets = itertools.count()

        def work(_: int) -> None:
            while (index := next(tickets)) < len(functions):
                given[index] = functions[index](sh)

        run_parallel(work)
        total = np.zeros_like(self._start)
        for view, part in zip(self._views, given, strict=True):
            run_ranges(spread, len(view.seen), view.seen, view.directions, part, total)
        return total

    def _inverse_diagonal(self) -> np.ndarray:
        """``[N, K, 1]``: the preconditioner."""
        diagonal = np.full((self._count, self._coefficients), self._ridge, np.float32)
        for view in self._views:
            squares = np.zeros(len(view.seen), np.float32)
            gather_squares(*view.matrix[1:], squares)
            spread_squares(view.seen, view.directions, squares, diagonal)
        return 1.0 / diagonal[:, :, None]

    def _told(self) -> None:
        self._done += 1
        if self._show is not None:
            self._show(self._done, self._of, "")


def _weights_a_pixel(model: Model, camera: Camera, random: np.random.Generator) -> float:
    """How many Gaussians are in a pixel of that camera, by a sample of them; at least 1."""
    count = camera.width * camera.height
    pixels = np.sort(random.choice(count, min(count, PROBED), replace=False))
    return max(1.0, blend_weights(*_shape(model), camera, pixels).weights.size / pixels.size)


def _view_of(model: Model, camera: Camera, picture: Picture, most: int, random: np.random.Generator) -> _View:
    """A view by at most so many of its pixels, drawn by chance."""
    pixels = np.arange(camera.width * camera.height)
    if most < pixels.size:
        pixels = np.sort(random.choice(pixels, most, replace=False))
    weights = blend_weights(*_shape(model), camera, pixels)
    seen, places = np.unique(weights.gaussians, return_inverse=True)
    wanted = picture(camera).reshape(3, -1)[:, pixels].T
    return _View(
        seen=seen.astype(np.int64),
        weights=BlendWeights(weights.starts, places.astype(np.int32), weights.weights),
        directions=_directions(model.position[seen], camera).astype(np.float32),
        wanted=np.ascontiguousarray(wanted, np.float32),
        free=np.empty((len(seen), 3), np.float32),
    )


def _shape(model: Model) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Position, rotation, scale, opacity."""
    arrays = model.position, model.rotation, model.scale, model.opacity
    means, rotation, scale, opacity = (torch.from_numpy(np.array(each, np.float32)) for each in arrays)
    return means, rotation, scale, opacity


def _directions(position: np.ndarray, camera: Camera) -> np.ndarray:
    """``[N, 3]`` unit vectors from the camera."""
    offset = position - np.asarray(camera.position, np.float32)
    return offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), np.float32(1e-12))


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("nkc,nkc->", a, b, dtype=np.float64))


def _thinned(cameras: Sequence[Camera]) -> Sequence[Camera]:
    """At most two thirds of ``MOST_VIEWS``, evenly spread."""
    most = 2 * MOST_VIEWS // 3
    if len(cameras) <= most:
        return cameras
    return [cameras[index] for index in np.linspace(0, len(cameras) - 1, most).round().astype(int)]


def _with_places_between(cameras: Sequence[Camera]) -> Sequence[Camera]:
    """The cameras, and one half way from each to its nearest, as many as ``MOST_VIEWS`` leaves room for."""
    places = np.array([camera.position for camera in cameras])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    pairs = sorted({tuple(sorted((i, int(j)))) for i, j in enumerate(apart.argmin(axis=1))})
    room = MOST_VIEWS - len(cameras)
    return [*cameras, *(_half_way(cameras[i], cameras[j]) for i, j in pairs[:room] if len(cameras) > 1)]


def _half_way(one: Camera, other: Camera) -> Camera:
    """Between two cameras, in place and turn; the first one's lens and size, but ``WIDER`` and ``FINER``."""
    turns = Rotation.from_matrix([each.camera_to_world[:3, :3] for each in (one, other)])
    pose = np.eye(4)
    pose[:3, :3] = turns.mean().as_matrix()
    pose[:3, 3] = 0.5 * (one.position + other.position)
    between = Camera(pose, one.width, one.height, WIDER * one.fx, WIDER * one.fy, one.cx, one.cy)
    return between.resized(max(one.width, min(round(FINER * one.width), SCREEN)))
