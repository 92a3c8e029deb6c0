# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in scenes by name. A new one is a module under ``synth/scenes`` with ``build`` and a line here.

Eight are named after HDR-NeRF's synthetic scenes and composed in their spirit; ``interior`` is the demo's.
A scene's module is imported when the scene is built: the extension that users install has none of them.
"""

import importlib
import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy

from .assets import Assets
from .stage import Stage

Build = Callable[[bpy.types.Scene, Assets], Stage]


@dataclass(frozen=True)
class BuiltInScene:
    """A scene: its module under ``synth/scenes``, or the function itself, and its exposures in EV."""

    build: str | Build
    evs: tuple[float, ...] = (-3.0, -1.0, 1.0, 3.0, 5.0)

    @property
    def is_here(self) -> bool:
        """Whether it can be built: the extension that users install leaves the modules of scenes out."""
        return not isinstance(self.build, str) or importlib.util.find_spec(_SCENES, __package__) is not None

    def __call__(self, scene: bpy.types.Scene, assets: Assets) -> Stage:
        if isinstance(self.build, str):
            return importlib.import_module(f"{_SCENES}.{self.build}", __package__).build(scene, assets)
        return self.build(scene, assets)


_SCENES = ".scenes"
_DARKER = (-4.0, -2.0, 0.0, 2.0, 4.0)

SCENES: dict[str, BuiltInScene] = {
    "interior": BuiltInScene("interior"),
    "bathroom": BuiltInScene("bathroom"),
    "bear": BuiltInScene("bear"),
    "chair": BuiltInScene("chair"),
    "desk": BuiltInScene("desk"),
    "diningroom": BuiltInScene("diningroom", _DARKER),
    "dog": BuiltInScene("dog", _DARKER),
    "sofa": BuiltInScene("sofa"),
    "sponza": BuiltInScene("sponza", (-5.0, -3.0, -1.0, 1.0, 3.0)),
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
def built(name: str, assets: Assets | None = None) -> Iterator[Stage]:
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
