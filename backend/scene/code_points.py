# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours that a file states by numbers (ITU-T H.273): primaries and a transfer curve, as HEIF and AVIF do.

They become a ``Profile``, as an ICC profile does. Of pictures for displays of more than white the curve
matters, too: PQ's (ITU-R BT.2100) goes to 10,000 cd/m², of which few displays show a tenth. Here 1 is
1000 cd/m², what BT.2100 has HLG's displays reach, and in HLG the largest code; what is above is white.
"""

import math
from collections.abc import Callable

import numpy as np

from ...bridge import srgb
from ...bridge.errors import BadValueError
from .color_space import D65, SPACES, Chromaticities
from .icc import Curve, Profile

#: The number for unspecified, treated as sRGB, which a file without colours is (MIAF, ISO/IEC 23000-22).
UNSPECIFIED = 2
#: PQ's largest luminance, and the one that is 1, in cd/m².
PQ_MOST, PQ_WHITE = 10_000.0, 1000.0
#: Codes of 16 bits, at which curves of closed form are tabled.
CODES = 1 << 16

_P3 = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))
#: H.273, table 2: by number, what people call them and where they are.
PRIMARIES = {
    1: ("BT.709", SPACES["rec709"]),
    4: ("BT.470 M", Chromaticities((0.67, 0.33), (0.21, 0.71), (0.14, 0.08), (0.310, 0.316))),
    5: ("BT.601, 625 lines", Chromaticities((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), D65)),
    6: ("BT.601, 525 lines", Chromaticities((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65)),
    7: ("SMPTE 240M", Chromaticities((0.630, 0.340), (0.310, 0.595), (0.155, 0.070), D65)),
    9: ("BT.2020", SPACES["rec2020"]),
    11: ("DCI-P3", Chromaticities(*_P3, (0.314, 0.351))),
    12: ("Display P3", Chromaticities(*_P3, D65)),
}
_SRGB = Curve(
    None, 3, (srgb.POWER, 1.0 / srgb.SCALE, srgb.OFFSET / srgb.SCALE, 1.0 / srgb.SLOPE, srgb.CODE_KNEE)
)
_BT709 = Curve(None, 3, (1.0 / 0.45, 1.0 / 1.099, 0.099 / 1.099, 1.0 / 4.5, 0.081))
#: H.273, table 3: curves as ICC has them. 14 and 15 are BT.2020's, which is BT.709's.
CURVES = {
    **dict.fromkeys((1, 6, 14, 15), _BT709),
    **dict.fromkeys((UNSPECIFIED, 13), _SRGB),
    4: Curve(None, 0, (2.2,)),
    5: Curve(None, 0, (2.8,)),
    8: Curve(None),
    17: Curve(None, 0, (2.6,)),
}


def pq(codes: np.ndarray) -> np.ndarray:
    """Luminance over ``PQ_WHITE`` of codes 0…1: the EOTF of BT.2100, table 4."""
    m1, m2 = 2610.0 / 16384.0, 2523.0 / 4096.0 * 128.0
    c1, c2, c3 = 3424.0 / 4096.0, 2413.0 / 4096.0 * 32.0, 2392.0 / 4096.0 * 32.0
    power = np.asarray(codes, np.float64) ** (1.0 / m2)
    return PQ_MOST / PQ_WHITE * (np.maximum(power - c1, 0.0) / (c2 - c3 * power)) ** (1.0 / m1)


def hlg(codes: np.ndarray) -> np.ndarray:
    """What the scene sent, 0…1, of codes 0…1: the inverse of BT.2100's OETF, table 5."""
    a = 0.17883277
    b, c = 1.0 - 4.0 * a, 0.5 - a * math.log(4.0 * a)
    codes = np.asarray(codes, np.float64)
    return np.where(codes <= 0.5, codes**2 / 3.0, (np.exp((codes - c) / a) + b) / 12.0)


#: Those beyond white, whose codes need 16 bits where they become sRGB's.
HDR_CURVES: dict[int, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {16: ("PQ", pq), 18: ("HLG", hlg)}


def profile_of_code_points(primaries: int, transfer: int) -> Profile | None:
    """The profile of pictures with these numbers; None where they are sRGB's except for the curve.

    Raises ``BadValueError`` for numbers of other primaries or curves.
    """
    if primaries == UNSPECIFIED:
        primaries = 1
    if primaries not in PRIMARIES or transfer not in (*CURVES, *HDR_CURVES):
        raise BadValueError(
            f"its colours are of the primaries {primaries} and the transfer {transfer} of ITU-T H.273, which "
            "are not known here",
            "Convert it to sRGB, keeping EXIF.",
        )
    name, chromaticities = PRIMARIES[primaries]
    key = f"H.273 {primaries} {transfer}"
    matrix = chromaticities.to_rec709()
    matrix = matrix / matrix.sum(axis=1, keepdims=True)
    if transfer in HDR_CURVES:
        curve_name, curve = HDR_CURVES[transfer]
        tabled = Curve(curve(np.linspace(0.0, 1.0, CODES)))
        return Profile(f"{name} with {curve_name}", key, matrix, (tabled, tabled, tabled))
    plain = CURVES[transfer]
    profile = Profile(name, key, matrix, (plain, plain, plain))
    return None if profile.is_srgb else profile
