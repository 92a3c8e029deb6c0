# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator that lights a model as some of its photographs were: the standard ones, or those of a group."""

from functools import lru_cache
from typing import ClassVar

import bpy

from ...bridge.errors import PhysHDRError
from ...bridge.lights import in_words
from ...bridge.photographed_light import PhotographedLight
from ..blender import cloud_of
from ..model import nodes
from ..model.point_cloud import lights_of, photographed_light_of
from .render import model_for


def choices_of(target: bpy.types.Object | None) -> tuple[PhotographedLight, ...]:
    """The light that a model can have as photographed; () without a choice, and of damaged data."""
    if target is None or nodes.find_modifier(target) is None:
        return ()
    try:
        found = photographed_light_of(cloud_of(target))
    except PhysHDRError:
        return ()
    return found if len(found) > 1 else ()


@lru_cache(maxsize=16)
def _items(texts: tuple[tuple[str, str], ...]) -> list[tuple[str, str, str]]:
    """Entries of name and tooltip; Blender keeps no reference to these strings, the cache does."""
    return [(str(number), name, tooltip) for number, (name, tooltip) in enumerate(texts)]


def _choices(_: object, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    found = choices_of(model_for(context)) if context is not None else ()
    return _items(tuple((each.name, _in_words(each)) for each in found))


def _in_words(light: PhotographedLight) -> str:
    """``ambient 0.2 (estimated) + pendant 0``; lights that are not named are at 1."""
    named = {
        f"{name} {level:.3g} ({light.found[name]})" if name in light.found else f"{name} {level:.3g}"
        for name, level in light.levels.items()
    }
    return " + ".join(sorted(named)) or "all lights at 1"


class PHYSHDR_OT_light_as_photographed(bpy.types.Operator):
    """Set the level of each light to what it was in the standard photos, or in a group of others"""

    bl_idname = "physhdr.light_as_photographed"
    bl_label = "Light as Photographed"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    light: bpy.props.EnumProperty(name="Light", items=_choices)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not choices_of(model_for(context)):
            cls.poll_message_set("No model of photos that were taken under several lights")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        target = model_for(context)
        assert target is not None  # by poll
        modifier, lights = nodes.find_modifier(target), lights_of(cloud_of(target))
        assert modifier is not None
        levels = choices_of(target)[int(self.light)].of(lights)
        for index, level in enumerate(levels):
            nodes.set_input(modifier, nodes.level_input(lights, index), level)
        self.report({"INFO"}, in_words(dict(zip(lights, levels, strict=True))))
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_OT_light_as_photographed,))
