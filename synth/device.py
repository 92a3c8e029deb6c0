# SPDX-License-Identifier: GPL-3.0-or-later
"""What Cycles renders with: the CPU, or the GPU of the user's preferences."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from .errors import DeviceError
from .progress import quiet

DEVICES = ("CPU", "GPU")
_KINDS = ("OPTIX", "CUDA", "HIP", "METAL", "ONEAPI")  # the fastest first where a card knows several


@contextmanager
def chosen(device: str) -> Iterator[None]:
    """Make ``cycles.device`` = ``device`` work; the preferences are put back afterwards, and never saved.

    Raises:
        DeviceError: ``GPU``, and there is none that this Blender can use.
    """
    if device == "CPU":
        yield
        return
    addon = bpy.context.preferences.addons.get("cycles")
    if addon is None:
        raise DeviceError("the Cycles add-on is switched off", "enable it in Preferences > Add-ons")
    preferences: Any = addon.preferences  # of Cycles, as is what a card is called
    with quiet():
        preferences.refresh_devices()
    kind = preferences.compute_device_type
    used = [(each, each.use) for each in preferences.devices]
    try:
        if not any(each.use and each.type == kind for each in preferences.devices):
            _take_first(preferences)
        yield
    finally:
        preferences.compute_device_type = kind
        for each, use in used:
            each.use = use


def _take_first(preferences: Any) -> None:
    """Use all cards of the first kind that there is."""
    for kind in _KINDS:
        found = [each for each in preferences.devices if each.type == kind]
        if not found:
            continue
        try:
            preferences.compute_device_type = kind
        except TypeError:  # this Blender was built without it
            continue
        for each in found:
            each.use = True
        return
    raise DeviceError(
        "Cycles finds no GPU here", "use the CPU (--device CPU), or choose the GPU in Preferences > System"
    )
