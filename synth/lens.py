# SPDX-License-Identifier: GPL-3.0-or-later
"""A lens that bends straight lines: OpenCV's models, as structure from motion and other trainers name them.

A point of the camera's space (x right, y down, z forward) is seen at the pixel

    OPENCV            (a, b) = (x, y) / z, r² = a² + b², s = 1 + k1 r² + k2 r⁴
                      u = fx (a s + 2 p1 a b + p2 (r² + 2 a²)) + cx
                      v = fy (b s + p1 (r² + 2 b²) + 2 p2 a b) + cy
    OPENCV_FISHEYE    θ = angle to the axis, t = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)
                      (u, v) = (fx, fy) t (x, y) / √(x² + y²) + (cx, cy)

(docs.opencv.org, modules calib3d and fisheye; COLMAP's and nerfstudio's OPENCV and OPENCV_FISHEYE are these).
The middle of the first pixel is at (½, ½). Numpy alone; ``lens_shader.py`` is the same as a camera of Cycles.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .errors import OptionError

OPENCV, FISHEYE = "OPENCV", "OPENCV_FISHEYE"
#: Model → what its numbers are called.
COEFFICIENTS = {OPENCV: ("k1", "k2", "p1", "p2"), FISHEYE: ("k1", "k2", "k3", "k4")}
#: Steps of Newton's method from the bent point: of a lens that bends corners by a third, six are enough for
#: float32; those that would need more are refused.
ITERATIONS = 12
#: Pixels that a point which went through the lens backward and forward may be off (float64).
EXACT = 1e-6
#: Steps from the picture's middle to its border at which a lens is looked at.
STEPS = 64


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A lens before a picture of a known size."""

    model: str
    #: In the order of ``COEFFICIENTS``.
    coefficients: tuple[float, float, float, float]
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def described(cls, content: Mapping[str, Any]) -> "Lens":
        """The lens that ``describe`` described."""
        k1, k2, k3, k4 = (float(content[name]) for name in COEFFICIENTS[content["camera_model"]])
        return cls(
            model=content["camera_model"],
            coefficients=(k1, k2, k3, k4),
            width=content["w"],
            height=content["h"],
            fx=content["fl_x"],
            fy=content["fl_y"],
            cx=content["cx"],
            cy=content["cy"],
        )

    @property
    def straight(self) -> "Lens":
        """The pinhole with its focal length and centre."""
        return replace(self, model=OPENCV, coefficients=(0.0, 0.0, 0.0, 0.0))

    def check(self) -> "Lens":
        """The lens itself, if one direction alone is seen at each point of the picture.

        Raises:
            OptionError: lines are bent so much that the picture folds over before its border.
        """
        rim = _rim(self.width, self.height)
        centre = np.array([self.cx, self.cy])
        for share in np.linspace(0.0, 1.0, STEPS + 1)[1:]:
            pixels = centre + share * (rim - centre)
            slope = self._slopes(self._straight(self._plane(pixels)))
            off = np.abs(self.project(self.directions(pixels)) - pixels).max()
            if not (slope > 0.0).all() or not off < EXACT:
                raise OptionError(
                    f"--lens: {self.model} with {', '.join(f'{value:g}' for value in self.coefficients)} "
                    f"folds the picture over at {share:.0%} of the way to its border",
                    "weaken the distortion, or take a longer focal length",
                )
        return self

    def directions(self, pixels: np.ndarray) -> np.ndarray:
        """Unit vectors [..., 3] (x right, y down, z forward) of what is seen at pixels [..., 2]."""
        point = self._straight(self._plane(pixels))
        if self.model == OPENCV:
            rays = np.concatenate([point, np.ones_like(point[..., :1])], -1)
            return rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        theta = np.linalg.norm(point, axis=-1, keepdims=True)
        return np.concatenate([np.sinc(theta / np.pi) * point, np.cos(theta)], -1)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels [..., 2] at which points [..., 3] of the camera's space are seen."""
        if self.model == OPENCV:
            straight = points[..., :2] / points[..., 2:]
        else:
            across = np.linalg.norm(points[..., :2], axis=-1, keepdims=True)
            theta = np.arctan2(across, points[..., 2:])
            straight = theta * points[..., :2] / np.maximum(across, np.finfo(float).tiny)
        return self._bent(straight) * [self.fx, self.fy] + [self.cx, self.cy]

    def cosines(self) -> np.ndarray:
        """[height, width] of the angle between the axis and the ray through each pixel's middle."""
        v, u = np.mgrid[: self.height, : self.width] + 0.5
        return self.directions(np.stack([u, v], -1))[..., 2]

    def describe(self) -> dict[str, Any]:
        """In the names of nerfstudio's ``transforms.json``."""
        named = dict(zip(COEFFICIENTS[self.model], self.coefficients, strict=True))
        size = {"w": self.width, "h": self.height}
        return {
            "camera_model": self.model,
            **size,
            **{"fl_x": self.fx, "fl_y": self.fy, "cx": self.cx, "cy": self.cy},
            **named,
        }

    def _plane(self, pixels: np.ndarray) -> np.ndarray:
        return (np.asarray(pixels, np.float64) - [self.cx, self.cy]) / [self.fx, self.fy]

    def _bent(self, point: np.ndarray) -> np.ndarray:
        """Where the lens puts a point [..., 2] of the plane at z = 1 (OPENCV), or of angles (fisheye)."""
        a, b = point[..., 0], point[..., 1]
        r2 = a * a + b * b
        if self.model == FISHEYE:
            return point * _polynomial(r2, self.coefficients)[..., None]
        k1, k2, p1, p2 = self.coefficients
        radial = 1.0 + r2 * (k1 + r2 * k2)
        return np.stack(
            [
                a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a),
                b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b,
            ],
            -1,
        )

    def _straight(self, bent: np.ndarray) -> np.ndarray:
        """The point that ``_bent`` puts there: Newton's method, as in ``lens_shader.py``."""
        with np.errstate(all="ignore"):  # of a lens that folds: ``check`` finds out
            if self.model == FISHEYE:
                wanted = np.linalg.norm(bent, axis=-1)
                theta = wanted
                for _ in range(ITERATIONS):
                    off = theta * _polynomial(theta**2, self.coefficients) - wanted
                    theta = theta - off / _derivative(theta**2, self.coefficients)
                return bent * (theta / np.maximum(wanted, np.finfo(float).tiny))[..., None]
            point = bent
            for _ in range(ITERATIONS):
                off = self._bent(point) - bent
                aa, ab, bb = self._jacobian(point)
                step = np.stack(
                    [bb * off[..., 0] - ab * off[..., 1], aa * off[..., 1] - ab * off[..., 0]], -1
                )
                point = point - step / (aa * bb - ab * ab)[..., None]
            return point

    def _jacobian(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """∂a'/∂a, ∂a'/∂b = ∂b'/∂a and ∂b'/∂b of OPENCV's ``_bent``."""
        k1, k2, p1, p2 = self.coefficients
        a, b = point[..., 0], point[..., 1]
        r2 = a * a + b * b
        radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * r2 * k2)
        return (
            radial + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a,
            a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b,
            radial + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a,
        )

    def _slopes(self, point: np.ndarray) -> np.ndarray:
        """How much larger a small area becomes; the picture folds where that is not above 0."""
        if self.model == FISHEYE:
            theta2 = (point**2).sum(-1)
            inside = np.sqrt(theta2) < np.pi
            return np.where(inside, _derivative(theta2, self.coefficients), -1.0)
        aa, ab, bb = self._jacobian(point)
        return np.where(aa > 0.0, aa * bb - ab * ab, -1.0)


def _polynomial(theta2: np.ndarray, k: tuple[float, ...]) -> np.ndarray:
    return 1.0 + theta2 * (k[0] + theta2 * (k[1] + theta2 * (k[2] + theta2 * k[3])))


def _derivative(theta2: np.ndarray, k: tuple[float, ...]) -> np.ndarray:
    """Of θ times the polynomial, by θ."""
    return 1.0 + theta2 * (3.0 * k[0] + theta2 * (5.0 * k[1] + theta2 * (7.0 * k[2] + theta2 * 9.0 * k[3])))


def _rim(width: int, height: int) -> np.ndarray:
    """Points [..., 2] around the picture's border, its corners among them."""
    x, y = np.linspace(0.0, width, STEPS + 1), np.linspace(0.0, height, STEPS + 1)
    sides = [
        np.stack([x, np.zeros_like(x)], -1),
        np.stack([x, np.full_like(x, height)], -1),
        np.stack([np.zeros_like(y), y], -1),
        np.stack([np.full_like(y, width), y], -1),
    ]
    return np.concatenate(sides)
