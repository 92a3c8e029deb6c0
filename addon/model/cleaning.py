# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians of a model are drawn: what people set to clean it, as numbers. numpy alone.

The inputs of a model's modifier say it (``nodes``, ``look.look_of``), the nodes do it where Cycles and EEVEE
render (``cleaning_nodes``), and ``kept`` says the same here, for all else that draws, bakes or saves a model.
Lengths are the model's own, as in its file: the object's scale changes nothing about what is hidden.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...bridge.splatting import ALPHA_MIN, JACOBIAN_MARGIN, NEAR_PLANE

#: Standard deviations to where a Gaussian of opacity 1 ends: no splat reaches farther.
REACH = float(np.sqrt(np.float32(-2.0 * np.log(ALPHA_MIN))))
#: A model with a side scaled so many times another's is stretched (``RenderCamera.is_even``).
EVEN = 1.001

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Cleaning:
    """What is hidden of a model. The defaults keep everything; 0 is no limit."""

    #: From the model's space to the crop box's, 4×4 row by row: kept is what is then within ±1 on each axis.
    crop: tuple[float, ...] | None = None
    #: Keep what is outside of the box instead.
    keep_outside: bool = False
    #: Metres: the largest standard deviation of a Gaussian that is kept.
    largest_size: float = 0.0
    smallest_opacity: float = 0.0
    #: How many times longer than wide a Gaussian may be: the largest over the middle standard deviation.
    #: (Those of a surface are flat: their smallest says nothing.)
    largest_elongation: float = 0.0
    #: Metres from ``centre``, in the model's space.
    largest_distance: float = 0.0
    centre: Place = (0.0, 0.0, 0.0)
    #: Metres that the nearest camera of the data set is away at least, where the cloud has measured that.
    clear_of_photos: float = 0.0

    #: How likely the radiance is right at least, where the cloud knows that.
    smallest_confidence: float = 0.0

    #: By the camera that renders, and hidden from it alone. Metres that it is away at least and at most …
    clear_of_camera: float = 0.0
    farthest: float = 0.0
    #: … and whether only what reaches into its picture is kept, widened by so many halves of it.
    only_in_view: bool = False
    view_margin: float = 0.125

    @property
    def keeps_everything(self) -> bool:
        return not (self.by_itself or self.by_camera)

    @property
    def by_itself(self) -> bool:
        """Whether anything is hidden from every side."""
        limits = (
            *(self.largest_size, self.smallest_opacity, self.largest_elongation, self.largest_distance),
            *(self.clear_of_photos, self.smallest_confidence),
        )
        return self.crop is not None or any(limit > 0.0 for limit in limits)

    @property
    def by_camera(self) -> bool:
        """Whether anything is hidden from the camera that renders."""
        return self.clear_of_camera > 0.0 or self.farthest > 0.0 or self.only_in_view

    def without_camera(self) -> "Cleaning":
        """What is hidden from every side alone."""
        return replace(
            self,
            clear_of_camera=ALL.clear_of_camera,
            farthest=ALL.farthest,
            only_in_view=ALL.only_in_view,
            view_margin=ALL.view_margin,
        )


#: Nothing is hidden.
ALL = Cleaning()


@dataclass(frozen=True)
class RenderCamera:
    """The camera that renders, in the model's space."""

    place: Place
    #: Unit axes; it looks along −back.
    right: Place
    up: Place
    back: Place
    #: 4×4, row by row: OpenGL's.
    projection: tuple[float, ...]
    is_orthographic: bool = False
    #: Length of one of the scene's metres: 1 / the model's scale.
    unit: float = 1.0
    #: Whether the model has the same scale along its axes. Where not, nobody is out of view.
    is_even: bool = True


def kept(
    cleaning: Cleaning,
    position: np.ndarray,
    scale: np.ndarray,
    opacity: np.ndarray,
    camera_distance: np.ndarray | None = None,
    camera: RenderCamera | None = None,
    confidence: np.ndarray | None = None,
) -> np.ndarray:
    """Bool ``[N]``: which Gaussians are drawn.

    ``position`` and ``scale`` ``[N, 3]`` and ``opacity`` ``[N]`` as in a model, float32, in which all is
    reckoned, as in the nodes. ``camera_distance`` ``[N]``: metres to the nearest of the data set's cameras;
    ``None``: nobody measured it, and it hides nothing. ``camera``: the one that renders; ``None`` (the 3D
    view, a bake): none does, and what only a camera would hide is kept. ``confidence`` ``[N]``; ``None``: the
    model does not know, and it hides nothing.
    """
    keep = np.ones(len(position), bool)
    if cleaning.crop is not None:
        matrix = _array(cleaning.crop).reshape(4, 4)
        inside = np.ones(len(position), bool)
        for row in matrix[:3]:
            inside &= np.abs(_along(position, row[:3]) + row[3]) <= 1.0
        keep &= ~inside if cleaning.keep_outside else inside
    if cleaning.largest_size > 0.0:
        keep &= scale.max(axis=1) <= np.float32(cleaning.largest_size)
    if cleaning.smallest_opacity > 0.0:
        keep &= opacity >= np.float32(cleaning.smallest_opacity)
    if cleaning.largest_elongation > 0.0:
        keep &= scale.max(axis=1) <= middle_of(scale) * np.float32(cleaning.largest_elongation)
    if cleaning.largest_distance > 0.0:
        keep &= _length(position - _array(cleaning.centre)) <= np.float32(cleaning.largest_distance)
    if cleaning.clear_of_photos > 0.0 and camera_distance is not None:
        keep &= camera_distance >= np.float32(cleaning.clear_of_photos)
    if cleaning.smallest_confidence > 0.0 and confidence is not None:
        keep &= confidence >= np.float32(cleaning.smallest_confidence)
    if camera is not None and cleaning.by_camera:
        keep &= _kept_by_camera(cleaning, position, scale, camera)
    return keep


def middle_of(scale: np.ndarray) -> np.ndarray:
    """``[N]``: the middle of each three of ``[N, 3]``."""
    x, y, z = scale.T
    return np.maximum(np.minimum(x, y), np.minimum(np.maximum(x, y), z))


def elongation_of(scale: np.ndarray) -> np.ndarray:
    """``[N]``: how many times longer than wide each Gaussian is; infinite for a line."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(scale.max(axis=1) > 0.0, scale.max(axis=1) / middle_of(scale), 1.0)


def _kept_by_camera(
    cleaning: Cleaning, position: np.ndarray, scale: np.ndarray, camera: RenderCamera
) -> np.ndarray:
    offset = position - _array(camera.place)
    distance = _length(offset)
    keep = distance >= np.float32(cleaning.clear_of_camera)
    if cleaning.farthest > 0.0:
        keep &= distance <= np.float32(cleaning.farthest)
    if not (cleaning.only_in_view and camera.is_even):
        return keep
    projection = _array(camera.projection).reshape(4, 4)
    depth = -_along(offset, _array(camera.back))
    radius = scale.max(axis=1) * np.float32(REACH)
    widened = np.float32(cleaning.view_margin) + np.float32(1.0)
    keep &= depth + radius >= np.float32(NEAR_PLANE) * np.float32(camera.unit)
    for row, axis in enumerate((camera.right, camera.up)):
        slope, shift, move = projection[row, row], projection[row, 2], projection[row, 3]
        if camera.is_orthographic:
            # Such a picture is so many of the scene's metres wide, wherever something is.
            per_length = slope / np.float32(camera.unit)
            along = _along(offset, _array(axis)) * per_length
            keep &= np.abs(along + move) <= widened + radius * per_length
        else:
            # How far a ball reaches toward a slanted side, at most; and a card, which lies in the picture's
            # plane and which the projection's Jacobian makes longer there.
            across = _along(offset, _array(axis)) * slope
            slant = slope + (widened + np.abs(shift) + np.float32(JACOBIAN_MARGIN))
            keep &= np.abs(across - depth * shift) <= depth * widened + radius * slant
    return keep


def _array(numbers: tuple[float, ...]) -> np.ndarray:
    return np.array(numbers, np.float32)


def _along(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """``[N]`` products of ``[N, 3]`` with one ``[3]``, added in the nodes' order: to the last bit theirs."""
    x, y, z = vectors.T
    return x * axis[0] + y * axis[1] + z * axis[2]


def _length(vectors: np.ndarray) -> np.ndarray:
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)
