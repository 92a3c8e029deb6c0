# SPDX-License-Identifier: GPL-3.0-or-later
"""Where photographs were taken from, learned beside the scene.

Structure from motion is right within parts of a pixel, a phone's tracking or a pose that a photo has borrowed
is not, and a scene that is seen from wrong places is blurred. What a view's camera sees at x, in the camera's
own axes, it then sees at

    exp(ω) x + τ

To turn all Gaussians that way and to turn the camera the other way is the same picture, so the gradient of
ω and τ is a sum of those that the Gaussians get of the view anyway: Σ x × ∂L/∂x and Σ ∂L/∂x, and what turns
their axes. (How a reflectance changes with the viewing direction has no part in it, unless positions learn
from it; then it has in τ alone, for a camera that turns sees all from the same place.) Numbers are in pixels:
ω by the focal length, τ by that at the median depth of the first points.

That all cameras move, turn or spread together is no information, for the scene can follow: such parts are
taken out of every step, so that other views' poses remain true. Each view is stepped when it is seen, by Adam
with a count of its own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from ...bridge.axes import camera_to_world_opengl
from ...bridge.errors import BadValueError
from ..methods.base import Batch, Outcome
from ..model.backbone import Splats
from ..scene.camera import Camera
from ..scene.resident import camera_tensors
from ..scene.scene import View
from .data import Shot
from .nuisances import ADAM_EPSILON, BETAS
from .plan import Plan
from .state import Part, State

#: ω and τ.
NUMBERS = 6
#: Nothing is nearer to a camera than this share of the distance between cameras, where its depth is asked.
NEAREST = 1e-3
#: Pixels that a view moves at most, each time that it is seen; falls to zero by a cosine. Measured, as what
#: follows: lab/notebook.md.
RATE = 0.15
#: Share of the training before anything moves: an unfinished scene misleads.
START = 0.2


def moved(camera: Camera, twist: np.ndarray) -> Camera:
    """The camera that sees at exp(ω) x + τ what ``camera`` sees at x; ``twist`` ``[6]``: ω, τ (metres)."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix()
    motion[:3, 3] = twist[3:]
    return replace(camera, camera_to_world=camera_to_world_opengl(motion @ camera.world_to_camera))


@torch.no_grad()
def twist_gradient(splats: Splats, camera: Camera) -> torch.Tensor:
    """∂L/∂(ω, τ) at zero ``[6]``, of the gradients that ``splats`` have (``LearnedPoses.watch``)."""
    means, quaternions = splats.means, splats.quaternions
    assert means.grad is not None and quaternions.grad is not None
    seen_by = camera_tensors(camera, means)
    to_camera, away = seen_by.view[:3, :3], means - seen_by.position
    # Also None where nothing depends on the direction: at SH degree 0.
    by_direction = None if splats.seen_at is None else splats.seen_at.grad
    turned = _crossed(away.T @ (means.grad if by_direction is None else means.grad - by_direction))
    # q turned by ω is (1, ω/2) q.
    pairs = quaternions.T @ quaternions.grad
    turned += 0.5 * (pairs[0, 1:] - pairs[1:, 0] + _crossed(pairs[1:, 1:]))
    return torch.cat([to_camera @ turned, to_camera @ means.grad.sum(dim=0)])


def _crossed(pairs: torch.Tensor) -> torch.Tensor:
    """Σ a × b of Σ a bᵀ ``[3, 3]``."""
    return torch.stack([pairs[1, 2] - pairs[2, 1], pairs[2, 0] - pairs[0, 2], pairs[0, 1] - pairs[1, 0]])


class LearnedPoses(Part):
    """Of each training view, ``twist`` ``[V, 6]`` pixels: 0 at the start. All on the host, float64.

    ``positions`` ``[P, 3]`` metres: of the first primitives, for depths. What a view's gradient says is
    heeded when the view is drawn again: a card's host need not wait for it.
    """

    name = "poses"

    @classmethod
    def is_wanted(cls, plan: Plan) -> bool:
        mode = plan.config.poses
        if mode == "on" and not plan.splats:
            name = plan.config.method.name
            raise BadValueError(f"{name} cannot learn poses", "Leave out --poses on.")
        return mode == "on" or (mode == "auto" and plan.splats and plan.seen.scene.photographs)

    @classmethod
    def new(cls, state: State) -> Self:
        return cls(state.views, state.method.backbone.positions)

    def __init__(self, views: Sequence[View], positions: torch.Tensor) -> None:
        self._row = {view: row for row, view in enumerate(views)}
        shape = (len(views), NUMBERS)
        self.twist = np.zeros(shape)
        #: Adam's two moments, how often each view was stepped, and the gradient that is still to be heeded.
        self.moments = np.zeros((2, *shape))
        self.steps = np.zeros(len(views))
        self.waiting = np.full(shape, np.nan)
        self._coming: dict[int, tuple[torch.Tensor, torch.cuda.Event]] = {}
        self._seen = 0  # the view that was drawn last
        self._cameras = [view.camera for view in views]
        #: Radians and metres of a pixel, ``[V, 6]``.
        self.pixel = _pixels(self._cameras, positions.detach().double().cpu().numpy())
        self._together = _together(self._cameras, self.pixel)

    def before(self, batch: Batch, shot: Shot) -> Batch:
        return replace(batch, camera=self.posed(shot.view, batch.camera, batch.progress))

    def term(self, outcome: Outcome) -> None:
        if outcome.drawn is not None:
            self.watch(outcome.drawn.splats)

    def after(self, outcome: Outcome, batch: Batch) -> None:
        if outcome.drawn is not None:
            self.observe(outcome.drawn.splats, batch.camera, batch.progress)

    def posed(self, view: View, camera: Camera, progress: float) -> Camera:
        """``camera``, which is the view's at any size, where it is now. ``progress``: of the training.

        From now on until ``observe`` this view is the one that was seen.
        """
        self._seen = row = self._row[view]
        if row in self._coming:
            buffer, arrived = self._coming.pop(row)
            arrived.synchronize()
            self.waiting[row] = buffer.numpy()
        if not np.isnan(self.waiting[row, 0]):
            self._step(row, self.waiting[row], 0.5 * (1.0 + math.cos(math.pi * progress)))
            self.waiting[row] = np.nan
        return moved(camera, self.twists[row])

    @staticmethod
    def watch(splats: Splats) -> None:
        """Have gradients kept that ``observe`` reads; before the backward pass."""
        for tensor in (splats.means, splats.quaternions, splats.seen_at):
            if tensor is not None and tensor.requires_grad:
                tensor.retain_grad()

    def observe(self, splats: Splats, camera: Camera, progress: float) -> None:
        """Take what the gradients say of the pose that was seen; ``camera``: as ``posed`` gave it."""
        if progress < START or splats.means.grad is None:
            return
        row, gradient = self._seen, twist_gradient(splats, camera)
        if not gradient.is_cuda:
            self.waiting[row] = gradient.double().numpy()
            return
        buffer = torch.empty(NUMBERS, dtype=gradient.dtype, pin_memory=True)
        buffer.copy_(gradient, non_blocking=True)
        arrived = torch.cuda.Event()
        arrived.record()
        self._coming[row] = buffer, arrived

    def _step(self, row: int, gradient: np.ndarray, share: float) -> None:
        gradient = gradient * self.pixel[row]
        self.steps[row] += 1.0
        corrected = []
        for moment, beta, new in zip(self.moments, BETAS, (gradient, gradient**2), strict=True):
            moment[row] = beta * moment[row] + (1.0 - beta) * new
            corrected.append(moment[row] / (1.0 - beta ** self.steps[row]))
        mean, square = corrected
        self.twist[row] -= RATE * share * mean / (np.sqrt(square) + ADAM_EPSILON)
        flat = self.twist.reshape(-1)
        flat -= self._together @ (self._together.T @ flat)

    @property
    def twists(self) -> np.ndarray:
        """How each view's camera has moved, ``[V, 6]``: ω in radians, τ in metres, as ``moved`` takes it."""
        return self.twist * self.pixel

    @property
    def summary(self) -> str:
        """How far poses have moved: what is in the middle of a view, at its median depth, in pixels."""
        across, down = self.twist[:, 3] + self.twist[:, 1], self.twist[:, 4] - self.twist[:, 0]
        pixels = np.hypot(across, down)
        farthest = list(self._row)[int(pixels.argmax())].name
        mean = np.sqrt(np.mean(pixels**2))
        return f"poses moved by {mean:.2f} pixels (root mean square), {farthest} by {pixels.max():.2f}"

    # -- checkpoints -------------------------------------------------------------------------------------

    def tensors(self) -> dict[str, torch.Tensor]:
        for row, (buffer, arrived) in self._coming.items():
            arrived.synchronize()
            self.waiting[row] = buffer.numpy()
        self._coming.clear()
        waits = ~np.isnan(self.waiting)
        return {
            "twist": torch.from_numpy(self.twist),
            "exp_avg": torch.from_numpy(self.moments[0]),
            "exp_avg_sq": torch.from_numpy(self.moments[1]),
            "step": torch.from_numpy(self.steps),
            "waiting": torch.from_numpy(np.where(waits, self.waiting, 0.0)),
            "waits": torch.from_numpy(waits[:, 0].astype(np.uint8)),
            "pixel": torch.from_numpy(self.pixel),
        }

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        arrays = {name: tensor.cpu().numpy() for name, tensor in tensors.items()}
        self.twist[...], self.pixel[...] = arrays["twist"], arrays["pixel"]
        self.moments[0], self.moments[1] = arrays["exp_avg"], arrays["exp_avg_sq"]
        self.steps[...] = arrays["step"]
        self.waiting[...] = np.where(arrays["waits"][:, None] != 0, arrays["waiting"], np.nan)
        self._together = _together(self._cameras, self.pixel)


def _pixels(cameras: Sequence[Camera], positions: np.ndarray) -> np.ndarray:
    """``[V, 6]``: radians, and metres at the median depth of what each view sees, of a pixel."""
    centres = np.array([camera.position for camera in cameras])
    nearest = NEAREST * max(float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()), NEAREST)
    depths = np.full(len(cameras), np.nan)
    for row, camera in enumerate(cameras):
        x, y, z = camera.world_to_camera[:3, :3] @ positions.T + camera.world_to_camera[:3, 3:]
        before = z > nearest
        u = camera.fx * x[before] / z[before] + camera.cx
        v = camera.fy * y[before] / z[before] + camera.cy
        inside = (u > 0.0) & (u < camera.width) & (v > 0.0) & (v < camera.height)
        if inside.any():
            depths[row] = np.median(z[before][inside])
    known = depths[~np.isnan(depths)]
    depths[np.isnan(depths)] = np.median(known) if len(known) else 1.0
    radians = np.array([1.0 / camera.fx for camera in cameras])
    return np.repeat(np.stack([radians, radians * depths], axis=1), 3, axis=1)


def _together(cameras: Sequence[Camera], pixel: np.ndarray) -> np.ndarray:
    """``[6V, K]``: an orthonormal basis of what all cameras do when the world moves, turns or grows."""
    centres = np.array([camera.position for camera in cameras])
    arms = centres - centres.mean(axis=0)
    to_camera = np.stack([camera.world_to_camera[:3, :3] for camera in cameras])
    nothing = np.zeros_like(arms)
    world = [(nothing, np.broadcast_to(axis, arms.shape)) for axis in np.eye(3)]
    world += [(np.broadcast_to(axis, arms.shape), np.cross(axis, arms)) for axis in np.eye(3)]
    world += [(nothing, arms)]
    columns = [
        np.concatenate([np.einsum("vij,vj->vi", to_camera, part) for part in parts], axis=1) / pixel
        for parts in world
    ]
    basis, strengths, _ = np.linalg.svd(
        np.stack([c.reshape(-1) for c in columns], axis=1), full_matrices=False
    )
    return basis[:, strengths > 1e-9 * strengths[0]]
