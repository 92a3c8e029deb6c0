# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians as other programs hold them: display-referred colours, no light, the axes of their file."""

from dataclasses import dataclass, replace

import numpy as np

from ..affine import multiply, quaternions_of
from ..axes import Up
from ..errors import BadValueError, DataMismatchError
from ..spherical_harmonics import rotated

#: What the files of each format are by convention, where they do not say it themselves.
UP: dict[str, Up] = {
    "ply": "colmap",
    "compressed-ply": "colmap",
    "spz": "y",
    "splat": "colmap",
    "ksplat": "colmap",
    "sog": "colmap",
    "gltf": "y",
    "usd": "z",
}
#: A turn's matrix is orthonormal to this.
_ORTHONORMAL = 1e-5


@dataclass(frozen=True, eq=False)
class SplatCloud:
    """N Gaussians, all arrays float32. Building one checks the shapes; raises ``DataMismatchError``."""

    #: ``[N, 3]`` metres.
    position: np.ndarray
    #: ``[N, 4]`` unit quaternions, wxyz.
    rotation: np.ndarray
    #: ``[N, 3]`` standard deviations, metres; 0 is flat.
    scale: np.ndarray
    #: ``[N]``, 0…1.
    opacity: np.ndarray
    #: ``[N, K, 3]``, K of SH degree 0 to 3: display-referred, colour = SH_C0·sh_0 + ½ + higher toward a
    #: direction from the camera to the Gaussian (``bridge.gaussian_ply``).
    colour_sh: np.ndarray
    #: Sentences for the user about what the file could not tell, or could not be kept of it.
    notes: tuple[str, ...] = ()
    #: Which way is up in these axes, by the file's own word or the format's convention.
    up: Up = "z"
    #: Whether the colours were fitted to pictures (``display.FITTED_COMMENT``): only their blend is right.
    is_fitted: bool = False

    def __post_init__(self) -> None:
        count = len(self.position)
        expected = {
            "position": (count, 3),
            "rotation": (count, 4),
            "scale": (count, 3),
            "opacity": (count,),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise DataMismatchError(f"{name} are {getattr(self, name).shape}, expected {shape}")
        sh = self.colour_sh.shape
        if len(sh) != 3 or sh[0] != count or sh[1] not in (1, 4, 9, 16) or sh[2] != 3:
            raise DataMismatchError(f"colour_sh is {sh}, expected ({count}, 1, 4, 9 or 16, 3)")

    @property
    def count(self) -> int:
        """N."""
        return len(self.position)


def turned(cloud: SplatCloud, turn: np.ndarray) -> SplatCloud:
    """``cloud`` turned about the origin by ``turn`` ``[3, 3]``: places, ellipsoids and colours.

    Seen along a turned direction a Gaussian has the colour that it had along the direction before. ``up``
    stays: the caller knows what it has turned. Raises ``BadValueError`` where ``turn`` is no rotation.
    """
    turn = np.asarray(turn, np.float64)
    if turn.shape != (3, 3) or not (
        np.abs(turn @ turn.T - np.eye(3)).max() < _ORTHONORMAL and np.linalg.det(turn) > 0.0
    ):
        raise BadValueError(
            "the turn is not a rotation", "Its matrix must be orthonormal with determinant 1."
        )
    rotation = multiply(quaternions_of(turn[None])[0], cloud.rotation)
    return replace(
        cloud,
        position=(cloud.position @ turn.T).astype(np.float32),
        rotation=rotation.astype(np.float32),
        colour_sh=rotated(cloud.colour_sh, turn),
    )
