# SPDX-License-Identifier: GPL-3.0-or-later
"""The sRGB curve: the standard's values, and both ways round."""

import numpy as np

from physhdr.bridge import srgb


def test_transfer_function_is_srgb():
    """Values of IEC 61966-2-1, to four digits."""
    codes, linear = [0.0, 0.02, 0.5, 0.7353569830524495, 1.0], [0.0, 0.001548, 0.214041, 0.5, 1.0]
    np.testing.assert_allclose(srgb.to_linear(np.array(codes)), linear, atol=5e-7)
    np.testing.assert_allclose(srgb.to_srgb(np.array(linear)), codes, atol=1e-5)
    values = np.linspace(0.0, 3.0, 500)
    np.testing.assert_allclose(srgb.to_srgb(srgb.to_linear(values)), values, atol=1e-6)
