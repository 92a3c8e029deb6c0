# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes by name. A new scene is one module with ``build`` and one line in ``SCENES``.

Eight are named after HDR-NeRF's synthetic scenes and composed in their spirit; ``interior`` is the demo's.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass

import bpy

from .assets import Assets
from .stage import Stage

Build = Callable[[bpy.types.Scene, Assets], Stage]


@dataclass(frozen=True)
class Entry:
    """A scene: its module under ``synth/scenes``, or the function itself, and its exposures in EV."""

    build: str | Build
    evs: tuple[float, ...] = (-3.0, -1.0, 1.0, 3.0, 5.0)

    def __call__(self, scene: bpy.types.Scene, assets: Assets) -> Stage:
        if isinstance(self.build, str):
            return importlib.import_module(f".{self.build}", __package__).build(scene, assets)
        return self.build(scene, assets)


_DARKER = (-4.0, -2.0, 0.0, 2.0, 4.0)

SCENES: dict[str, Entry] = {
    "interior": Entry("interior"),
    "bathroom": Entry("bathroom"),
    "bear": Entry("bear"),
    "chair": Entry("chair"),
    "desk": Entry("desk"),
    "diningroom": Entry("diningroom", _DARKER),
    "dog": Entry("dog", _DARKER),
    "sofa": Entry("sofa"),
    "sponza": Entry("sponza", (-5.0, -3.0, -1.0, 1.0, 3.0)),
}

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
    "node_groups",
)


@contextmanager
def built(name: str, assets: Assets | None = None):
    """A fresh Blender scene with the named scene in it; everything it added is removed on the way out.

    Yields:
        ``Stage``: the Blender scene, what its lights are and where cameras may stand.
    """
    before = {kind: set(getattr(bpy.data, kind)) for kind in _SCRATCH}
    scene = bpy.data.scenes.new(f"physhdr {name}")
    try:
        yield SCENES[name](scene, assets or Assets())
    finally:
        bpy.data.scenes.remove(scene)
        for kind in _SCRATCH:
            bpy.data.batch_remove([block for block in getattr(bpy.data, kind) if block not in before[kind]])
