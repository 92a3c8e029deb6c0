# SPDX-License-Identifier: GPL-3.0-or-later
"""Clean: what is hidden of the selected model, how many Gaussians that is, and how to make it final."""

from typing import Any

import bpy

from ...bridge.errors import PhysHDRError
from ..blender import cloud_of, layout_of
from ..model import nodes
from ..model.attributes import CAMERA_DISTANCE, CONFIDENCE
from ..model.cleaning import Cleaning
from ..model.look import cleaning_of, is_model, kept_of
from ..viewport import overlay
from .parts import ModelSubpanel, write

#: A slider that moves is waited for so long, seconds: counting a million Gaussians takes longer than drawing.
PATIENCE = 0.15
#: So many distances tell whether they are those that were counted with.
SAMPLES = 16


class _Count:
    """How many Gaussians are hidden, counted beside the drawing: a timer counts, the panel tells."""

    def __init__(self) -> None:
        self._known: tuple[object, int] | None = None
        self._wanted: tuple[object, str, Cleaning] | None = None

    def of(self, cloud: bpy.types.PointCloud, cleaning: Cleaning) -> int | None:
        """The number; ``None`` until it is counted, which this asks for."""
        if not cleaning.by_itself:
            return 0
        key = cloud.session_uid, len(cloud.points), _measured(cloud), cleaning
        if self._known is not None and self._known[0] == key:
            return self._known[1]
        self._wanted = key, cloud.name_full, cleaning
        _stop_waiting()
        bpy.app.timers.register(_count_hidden, first_interval=PATIENCE)
        return None

    def count(self) -> None:
        """Count what was asked for last."""
        if self._wanted is None:
            return
        key, name, cleaning = self._wanted
        self._wanted = None
        cloud = next((each for each in bpy.data.pointclouds if each.name_full == name), None)
        if cloud is None:
            return
        try:
            keep = kept_of(cloud, cleaning)
        except KeyError:  # edited into something that is no model
            return
        self._known = key, len(keep) - int(keep.sum())
        overlay.redraw_all()

    def forget(self) -> None:
        _stop_waiting()
        self._known = self._wanted = None


hidden = _Count()


def _count_hidden() -> None:
    # Blender knows a timer by the function itself, and a method is another object each time it is named.
    hidden.count()


def _stop_waiting() -> None:
    if bpy.app.timers.is_registered(_count_hidden):
        bpy.app.timers.unregister(_count_hidden)


def _measured(cloud: bpy.types.PointCloud) -> tuple[float, ...]:
    """A few of the distances from the data set's cameras: others when they were measured anew."""
    attribute: Any = cloud.attributes.get(CAMERA_DISTANCE.name)
    if attribute is None:
        return ()
    count = len(attribute.data)
    return tuple(attribute.data[index].value for index in range(0, count, max(1, count // SAMPLES)))


class PHYSHDR_PT_cleaning(ModelSubpanel, bpy.types.Panel):
    bl_label = "Clean"

    def draw(self, context: bpy.types.Context) -> None:
        layout, target = layout_of(self), context.object
        assert is_model(target)
        modifier = nodes.find_modifier(target)
        if modifier is None or not nodes.has_input(modifier, nodes.CROP):
            write(context, layout, "Its PhysHDR modifier was removed or edited: import it again", "ERROR")
            _draw_find(layout)
            return
        _draw_crop(layout, modifier)
        column = _column(layout)
        for name in (nodes.LARGEST_SIZE, nodes.SMALLEST_OPACITY, nodes.LARGEST_ELONGATION):
            _draw(column, modifier, name)
        _draw(column, modifier, nodes.LARGEST_DISTANCE)
        row = column.row()
        row.active = nodes.get_input(modifier, nodes.LARGEST_DISTANCE) > 0.0
        _draw(row, modifier, nodes.DISTANCE_FROM)
        cloud = cloud_of(target)
        if CAMERA_DISTANCE.name in cloud.attributes:
            _draw(column, modifier, nodes.CLEAR_OF_PHOTOS)
        else:
            layout.operator("physhdr.cleaning_measure", icon="DRIVER_DISTANCE")
        if CONFIDENCE.name in cloud.attributes:
            _draw(column, modifier, nodes.SMALLEST_CONFIDENCE)
        _draw_count(context, layout, target)
        _draw_find(layout)
        layout.operator("physhdr.model_save", text="Save Edited Model…", icon="FILE_TICK")
        layout.operator("physhdr.model_bake", text="Bake to PLY…", icon="EXPORT")


class PHYSHDR_PT_culling(ModelSubpanel, bpy.types.Panel):
    bl_label = "Leave Out in Renders"
    bl_parent_id = "PHYSHDR_PT_cleaning"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        modifier = nodes.find_modifier(context.object) if is_model(context.object) else None
        return modifier is not None and nodes.has_input(modifier, nodes.CROP)

    def draw(self, context: bpy.types.Context) -> None:
        assert is_model(context.object)
        modifier = nodes.find_modifier(context.object)
        assert modifier is not None
        column = _column(layout_of(self))
        for name in nodes.CULLING:
            if nodes.has_input(modifier, name):
                _draw(column, modifier, name)


def _column(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = True
    return column


def _draw(layout: bpy.types.UILayout, modifier: bpy.types.NodesModifier, name: str) -> None:
    socket = getattr(nodes.inputs_of(modifier), nodes.input_identifier(modifier, name))
    layout.prop(socket, "value", text=name)


def _draw_crop(layout: bpy.types.UILayout, modifier: bpy.types.NodesModifier) -> None:
    if nodes.get_input(modifier, nodes.CROP_BOX) is None:
        layout.operator("physhdr.cleaning_box", icon="CUBE")
        return
    column = _column(layout)
    for name in (nodes.CROP, nodes.CROP_BOX, nodes.KEEP_OUTSIDE):
        _draw(column, modifier, name)


def _draw_count(context: bpy.types.Context, layout: bpy.types.UILayout, target: bpy.types.Object) -> None:
    cloud = cloud_of(target)
    try:
        cleaning = cleaning_of(target, context.view_layer.depsgraph).without_camera()
    except PhysHDRError as error:
        layout.label(text=str(error), icon="ERROR")
        return
    if not cleaning.by_itself:
        layout.label(text="Nothing is hidden", icon="HIDE_OFF")
        return
    count = hidden.of(cloud, cleaning)
    text = "Counting" if count is None else f"{count:,} of {len(cloud.points):,} hidden"
    layout.label(text=text, icon="HIDE_ON")
    layout.operator("physhdr.cleaning_apply", icon="TRASH")


def _draw_find(layout: bpy.types.UILayout) -> None:
    row = layout.row(align=True)
    row.operator("physhdr.cleaning_floaters", icon="VIEWZOOM")
    row.operator_menu_enum("physhdr.cleaning_select", "by", text="Select by", icon="RESTRICT_SELECT_OFF")


_CLASSES = (PHYSHDR_PT_cleaning, PHYSHDR_PT_culling)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    hidden.forget()
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
