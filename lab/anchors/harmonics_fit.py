# SPDX-License-Identifier: GPL-3.0-or-later
"""Spherical harmonics fitted to colours that are known in some directions only."""

import torch

from ...backend.kernels.spherical_harmonics import Y0, evaluate_sh_reference

#: Ridge on the directional coefficients, against the mean square of a view's basis (0.08 each).
RIDGE = 1e-3


class HarmonicsFit:
    """Weighted least squares for each of the points ``means`` ``[M, 3]`` by itself, view after view."""

    def __init__(self, means: torch.Tensor, degree: int) -> None:
        self.means, self.degree = means, degree
        count = (degree + 1) ** 2
        self.normal = means.new_zeros(len(means), count, count)
        self.right = means.new_zeros(len(means), count, 3)
        self.weight_sum = means.new_zeros(len(means))

    def add(self, viewpoint: torch.Tensor, colours: torch.Tensor, weight: torch.Tensor) -> None:
        """What is seen from ``viewpoint`` ``[3]``: ``colours`` ``[M, 3]``, each of ``weight`` ``[M]``."""
        basis = sh_basis(self.means, viewpoint, self.degree)
        weighted = basis * weight[:, None]
        self.normal += weighted[:, :, None] * basis[:, None, :]
        self.right += weighted[:, :, None] * colours[:, None, :]
        self.weight_sum += weight

    def solved(self) -> torch.Tensor:
        """The coefficients ``[M, K, 3]``, the constant one first."""
        ridge = torch.full_like(self.normal[0, 0], RIDGE)
        ridge[0] = 0.0
        normal = self.normal + self.weight_sum[:, None, None] * torch.diag(ridge)
        return torch.linalg.solve(normal, self.right)


def sh_basis(means: torch.Tensor, viewpoint: torch.Tensor, degree: int) -> torch.Tensor:
    """Y₀ … of the directions from ``viewpoint`` ``[3]`` to ``means`` ``[M, 3]``: ``[M, (degree + 1)²]``.

    Read off ``evaluate_sh_reference``, three functions at a time, so that there is one definition of them.
    """
    count = (degree + 1) ** 2 - 1
    basis = means.new_full((means.shape[0], count + 1), Y0)
    for first in range(0, count, 3):
        coefficients = means.new_zeros(1, count, 3)
        for channel in range(3):
            coefficients[0, first + channel, channel] = 1.0
        rest, dc = coefficients.expand(means.shape[0], -1, -1), means.new_zeros(means.shape[0], 3)
        basis[:, 1 + first : 4 + first] = evaluate_sh_reference(dc, rest, means, viewpoint, degree)
    return basis
