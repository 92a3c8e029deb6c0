# SPDX-License-Identifier: GPL-3.0-or-later
"""CG in the capture: its light, with what of that is a guess, and the ground that takes its shadow."""

from typing import ClassVar

import bpy

from ..blender import layout_of
from ..light import cg, lighting, probes
from ..light.probe_checks import warnings_of
from ..operators.lighting import model_in
from ..rendering.render_setup import has_model
from ..runtime import session
from ..session.light import LIGHT
from .parts import ModelSubpanel, write


class PHYSHDR_PT_light(ModelSubpanel, bpy.types.Panel):
    bl_label = "Light and CG"
    bl_options: ClassVar[set[str]] = set()

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_model(context.scene) or lighting.is_lit(context.scene.world)

    def draw(self, context: bpy.types.Context) -> None:
        layout, model = layout_of(self), model_in(context)
        column = layout.column(align=True)
        column.enabled = session().state.task(LIGHT) is None
        column.operator("physhdr.light_from_here", icon="LIGHTPROBE_SPHERE")
        write(context, column, _places(context))
        found = probes.probes_of(context.scene, model) if model else []
        for probe in found:
            assert model is not None
            _draw_probe(context, layout, probe, model)
        if lighting.lost_probes(context.scene):
            remedy = "press Again, or As Before" if found else "press As Before, or Light From Here"
            write(context, layout, f"A probe of this light is gone: {remedy}", "ERROR")
        row = layout.row(align=True)
        if found:
            row.operator("physhdr.light_refresh", text="Again", icon="FILE_REFRESH")
        if lighting.is_lit(context.scene.world):
            row.operator("physhdr.light_reset", text="As Before", icon="LOOP_BACK")
            if model is not None and context.scene.world[lighting.MODEL] != model:
                write(context, layout, "Another model lights this scene", "INFO")
        draw_cg(context, layout)


def draw_cg(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """The ground of CG, and why its shadow would not be drawn."""
    scene = context.scene
    row = layout.row(align=True)
    row.operator("physhdr.cg_here", icon="PIVOT_CURSOR")
    if not cg.is_there(scene):
        return
    row.operator("physhdr.cg_reset", text="", icon="X")
    for reason in cg.hindrances(scene):
        write(context, layout, reason, "ERROR")


def _places(context: bpy.types.Context) -> str:
    """Where light would be taken."""
    empties = [each for each in context.selected_objects or () if each.type == "EMPTY"]
    if not empties:
        return "At the 3D cursor"
    return f"At {empties[0].name}" if len(empties) == 1 else f"At {len(empties)} selected empties"


def _draw_probe(
    context: bpy.types.Context,
    layout: bpy.types.UILayout,
    probe: bpy.types.Object,
    model: bpy.types.Object,
) -> None:
    known = probes.known(probe)
    row = layout.row(align=True)
    row.label(text=probe.name, icon="LIGHTPROBE_SPHERE")
    row.label(text=f"{known.unseen:.0%} guessed")
    for warning in warnings_of(probe, model):
        write(context, layout, warning, "ERROR")
    if not known.lights:
        write(context, layout, "Its lights are not known apart: levels do not change it", "INFO")


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_PT_light,))
