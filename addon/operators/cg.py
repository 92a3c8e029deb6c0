# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that let CG stand in a capture, and that take away again what is needed for it."""

from typing import TYPE_CHECKING, ClassVar

import bpy
from mathutils import Vector

from ...bridge.errors import PhysHDRError
from ...bridge.words import counted
from ..blender import animated_paths
from ..light import cg
from ..rendering.render_setup import has_model

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
#: What has a body that can stand on something.
BODIES = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "VOLUME"}


class PHYSHDR_OT_cg_here(bpy.types.Operator):
    """Let CG stand in the capture at the 3D cursor: a ground plane there whose shadow falls on the splats in
    Cycles. Selected objects are put onto it"""

    bl_idname = "physhdr.cg_here"
    bl_label = "Put CG Here"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    location: bpy.props.FloatVectorProperty(
        name="Place",
        subtype="TRANSLATION",
        options=GIVEN,
        description="In the world, metres: the 3D cursor where none is given",
    )
    floor: bpy.props.EnumProperty(
        name="Height",
        items=[
            (
                "BELOW",
                "Floor Below",
                "Where the model's surface is below the place, else as high as the place",
            ),
            ("PLACE", "As Placed", "As high as the place itself"),
        ],
    )
    size: bpy.props.FloatProperty(
        name="Size",
        subtype="DISTANCE",
        default=4.0,
        min=1e-3,
        description="How wide the ground plane is. It may be scaled and moved afterwards as any object",
    )
    thickness: bpy.props.FloatProperty(
        name="Thickness",
        subtype="DISTANCE",
        default=0.0,
        min=0.0,
        description="So far above the plane splats belong to the ground and are shaded. 0: as its splats are",
    )
    stand: bpy.props.BoolProperty(
        name="Put Selected There",
        default=True,
        description="Move the selected objects, together, so that they stand on the ground at that place",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if not has_model(context.scene):
            cls.poll_message_set("Import a trained model first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        given = self.properties.is_property_set("location")
        place = Vector(self.location) if given else scene.cursor.location.copy()
        if not given:
            self.location = place
        try:
            context.view_layer.update()
            if self.floor == "BELOW":
                below = cg.floor_below(scene, place)
                place.z = place.z if below is None else below
            cg.put(scene, context.view_layer, place, self.size, self.thickness or None)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        moved, left = stood(context, place) if self.stand else (0, "")
        text = f"Ground at z = {place.z:.3g} m"
        if moved:
            text += f", {counted(moved, 'object')} put onto it"
        if scene.render.engine != "CYCLES":
            text += ". Its shadow is drawn by Cycles alone"
        self.report({"WARNING" if left else "INFO"}, f"{text}. {left}" if left else text)
        return {"FINISHED"}


def stood(context: bpy.types.Context, place: Vector) -> tuple[int, str]:
    """Move the selected bodies together so that the middle of their underside is at ``place``.

    Returns how many, and a note about those that stay: the next frame, or reopening the file, would put
    them back.
    """
    chosen = [each for each in context.selected_objects or () if each.type in BODIES and cg.MARK not in each]
    chosen = [each for each in chosen if not cg.shows_model(each)]
    tops = [each for each in chosen if not _has_ancestor(each, set(chosen))]
    kept = {each: _kept_by(each) for each in tops}
    tops = [each for each in tops if not kept[each]]
    moved = [each for each in chosen if each in tops or _has_ancestor(each, set(tops))]
    left = ". ".join(f"{each.name} is {why}" for each, why in kept.items() if why)
    if not moved:
        return 0, left
    depsgraph = context.evaluated_depsgraph_get()
    corners = []
    for each in moved:
        there = each.evaluated_get(depsgraph)
        corners += [there.matrix_world @ Vector(corner) for corner in there.bound_box]
    low = Vector([min(corner[axis] for corner in corners) for axis in range(3)])
    high = Vector([max(corner[axis] for corner in corners) for axis in range(3)])
    by = place - Vector(((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z))
    for each in tops:
        matrix = each.matrix_world.copy()
        matrix.translation += by
        each.matrix_world = matrix
    context.view_layer.update()
    return len(moved), left


def _kept_by(item: bpy.types.Object) -> str:
    """Why an object would not stay where it is put, and what helps; "" where it would."""
    if item.library is not None:
        return "linked from another file and was not moved: make a library override of it"
    if "location" in animated_paths(item):
        return "animated and was not moved: move an empty that is its parent"
    return ""


def _has_ancestor(item: bpy.types.Object, among: set[bpy.types.Object]) -> bool:
    parent = item.parent
    return parent is not None and (parent in among or _has_ancestor(parent, among))


class PHYSHDR_OT_cg_reset(bpy.types.Operator):
    """Take away the ground, the view layers and the compositor nodes of Put CG Here; the CG stays"""

    bl_idname = "physhdr.cg_reset"
    bl_label = "Remove Ground"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not cg.is_there(context.scene):
            cls.poll_message_set("There is no ground of Put CG Here in this scene")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        cg.reset(context.scene)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_OT_cg_here, PHYSHDR_OT_cg_reset))
