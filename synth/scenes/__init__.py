# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes by name. A new scene is one module with ``build`` and one line in ``SCENES``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager

import bpy

from . import interior
from .stage import Stage

SCENES: dict[str, Callable[[bpy.types.Scene], Stage]] = {"interior": interior.build}

_SCRATCH = (
    "objects",
    "meshes",
    "lights",
    "cameras",
    "materials",
    "worlds",
    "collections",
    "textures",
    "images",
)


@contextmanager
def built(name: str):
    """A fresh Blender scene with the named scene in it; everything it added is removed on the way out.

    Yields:
        ``Stage``: the Blender scene, what its lights are and where cameras may stand.
    """
    before = {kind: set(getattr(bpy.data, kind)) for kind in _SCRATCH}
    scene = bpy.data.scenes.new(f"physhdr {name}")
    try:
        yield SCENES[name](scene)
    finally:
        bpy.data.scenes.remove(scene)
        for kind in _SCRATCH:
            bpy.data.batch_remove([block for block in getattr(bpy.data, kind) if block not in before[kind]])
