# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether this Blender can denoise: some distributions build it without OpenImageDenoise."""

from functools import cache
from importlib import import_module

from ...bridge.errors import BadValueError

#: As the dialog says it.
REASON = "This Blender has no OpenImageDenoise: take more samples"


@cache
def can_denoise() -> bool:
    """Whether Cycles and the compositor have OpenImageDenoise.

    By what Cycles was built with: to ask a scene for its denoiser would make Cycles look for graphics cards.
    """
    try:
        return bool(import_module("_cycles").with_openimagedenoise)
    except (ImportError, AttributeError):
        return False


def require_denoiser() -> None:
    """Raises ``BadValueError`` where this Blender cannot denoise."""
    if not can_denoise():
        raise BadValueError(
            "this Blender was built without the denoiser OpenImageDenoise",
            "Switch Denoise off and take more samples, or use the Blender of blender.org.",
        )
