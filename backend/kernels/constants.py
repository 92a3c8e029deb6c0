# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers in which kernels for the CPU, for a card and their plain-torch twins agree."""

import numpy as np

#: 3DGS's spherical harmonics, without their signs, by degree.
Y0 = 0.28209479177387814
Y1 = 0.4886025119029199
Y2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
Y3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)

#: SSIM's window, a Gaussian, and the constants that keep its quotients finite.
SSIM_TAPS = 11
SSIM_SIGMA = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2


def ssim_window() -> np.ndarray:
    """``[SSIM_TAPS]`` float64, whose sum is 1."""
    window = np.exp(-((np.arange(SSIM_TAPS) - SSIM_TAPS // 2) ** 2) / (2.0 * SSIM_SIGMA**2))
    return window / window.sum()
