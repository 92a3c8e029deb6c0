# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender 5.3 packs and decodes of Gaussians that it draws itself, and numbers that survive it.

It shows sRGB decoded from ½ + Σ sh·Y, whatever the values are. EEVEE keeps the constant band in 8 bits over
the range of all points, Cycles the others in 8 bits over −1 … 1; scales are kept as logarithms in 9 bits over
their range. One absurd value costs all others their precision, and a scale of 0 all of it.
"""

import numpy as np

from . import srgb
from .spherical_harmonics import C0, basis, degree_of, exponential, quadrature, refit

#: Nodes of the quadrature with which sRGB codes are fitted, by degree.
_NODES = (1, 3, 4, 5)
#: The constant coefficient of the codes 0 and 1: ±½ / Y_0.
DC_LIMIT = np.float32(0.5 / C0)
#: What Cycles keeps of the other coefficients.
SH_LIMIT = np.float32(1.0)
#: Scales are at least this share of the typical Gaussian's (the median of the largest of each three). At a
#: 10 000th of a neighbour's size nobody sees an extent; nine bits then step by some 4 %.
SMALLEST_SHARE = 1e-4


def shown_sh(log_radiance_sh: np.ndarray) -> np.ndarray:
    """``[N, K, 3]`` float32: SH, 3DGS's way (½ + Σ sh·Y), of the sRGB codes of radiance exp(Σ_k sh_k Y_k).

    Of radiance up to 1: what is brighter is shown as white, as any display does. Exact for degree 0, least
    squares over all directions else. All are within ±``DC_LIMIT`` and ±``SH_LIMIT``.
    """
    degree = degree_of(log_radiance_sh.shape[1])
    directions, weights = quadrature(_NODES[degree])
    evaluate = basis(directions, degree)
    fitted = refit(log_radiance_sh, _code, evaluate, (evaluate * weights[:, None]).T)
    np.clip(fitted[:, 0], -DC_LIMIT, DC_LIMIT, out=fitted[:, 0])
    np.clip(fitted[:, 1:], -SH_LIMIT, SH_LIMIT, out=fitted[:, 1:])
    return fitted


def _code(log_radiance: np.ndarray) -> np.ndarray:
    """sRGB codes − ½ of exp(``log_radiance``) limited to 1; overwrites it.

    x^(1/2.4) is exp(ln x / 2.4): one exponential does it.
    """
    np.minimum(log_radiance, np.float32(0.0), out=log_radiance)
    dark = np.flatnonzero(log_radiance < np.float32(np.log(srgb.LINEAR_KNEE)))
    straight = np.exp(log_radiance.reshape(-1)[dark]) * np.float32(srgb.SLOPE)
    log_radiance *= np.float32(1.0 / srgb.POWER)
    code = exponential(log_radiance)
    code *= np.float32(srgb.SCALE)
    code -= np.float32(srgb.OFFSET)
    code.reshape(-1)[dark] = straight
    code -= np.float32(0.5)
    return code


def packable(scale: np.ndarray) -> np.ndarray:
    """``[N, 3]`` standard deviations, none of them below ``SMALLEST_SHARE`` of the typical Gaussian's.

    The very array where none is.
    """
    if not len(scale):
        return scale
    typical = float(np.median(scale.max(axis=1)))
    floor = np.float32(SMALLEST_SHARE * typical) if typical > 0.0 else np.finfo(np.float32).tiny
    return scale if scale.min() >= floor else np.maximum(scale, floor)
