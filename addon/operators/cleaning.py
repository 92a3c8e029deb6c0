# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that clean a model: select in Edit Mode by what a Gaussian is like, remove what is hidden,
measure how near the data set's cameras are, suggest floaters. All can be undone."""

from dataclasses import replace
from typing import Any, ClassVar, cast

import bpy
import mathutils
import numpy as np

from ...bridge.errors import BadValueError, DataMismatchError, FileMissingError, PhysHDRError
from .. import similarity
from ..blender import add_entry, cloud_of, collection_beside, curves_of, layout_of, remove_entry, world_of
from ..layouts.cameras import camera_places
from ..model import nodes, origin
from ..model.attributes import BASE, CAMERA_DISTANCE, CONFIDENCE, POSITION, SCALE
from ..model.cleaning import ALL, elongation_of
from ..model.floaters import floaters
from ..model.look import cleaning_of, is_model, kept_of
from ..model.point_cloud import read_attribute, write_attribute
from ..model.point_removal import keep_points, select_points, selection_of
from .base import OnModel

#: What a crop box is fitted to: all but so much of the Gaussians at either end of each axis.
OUTLIERS = 0.02
#: Limits to begin with, where they do not depend on the model's size: opacity, times, metres, probability.
FIRST_LIMITS = {"OPACITY": 0.1, "ELONGATION": 10.0, "PHOTOS": 0.1, "CONFIDENCE": 0.1}


class _OnModel(OnModel):
    """What is done to the active model: ``act`` does it and says so, or raises with nothing changed."""

    #: Whether the Gaussians themselves are changed, which a linked model's cannot be.
    edits_points: ClassVar[bool] = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        target = context.object
        if not is_model(target):
            cls.poll_message_set("Select an imported model first")
            return False
        if target.library is not None or (cls.edits_points and not cloud_of(target).is_editable):
            cls.poll_message_set("The model is linked from another file: clean it there")
            return False
        if cls.edits_points and cloud_of(target).override_library is not None:
            text = "Blender does not save changes to the points of a library override"
            cls.poll_message_set(f"{text}: clean the model in its own file")
            return False
        if not len(cloud_of(target).points):
            cls.poll_message_set("The model has no Gaussians: all were deleted")
            return False
        return True


class PHYSHDR_OT_cleaning_select(_OnModel):
    """Select Gaussians by what they are like. In Object Mode the selection shows once Edit Mode is entered"""

    bl_idname = "physhdr.cleaning_select"
    bl_label = "Select Gaussians"

    by: bpy.props.EnumProperty(
        name="By",
        items=[
            ("SIZE", "Size", "Larger than the limit, metres of one standard deviation"),
            ("OPACITY", "Opacity", "Fainter than the limit"),
            ("ELONGATION", "Elongation", "Needles: so many times longer than wide"),
            ("DISTANCE", "Distance", "Farther than the limit from the 3D cursor, metres"),
            ("PHOTOS", "Near Photos", "Nearer than the limit to a camera of the data set, metres"),
            ("CONFIDENCE", "Confidence", "Less likely than the limit to have the right radiance, 0 to 1"),
            ("CROP", "Outside the Crop Box", "What the model's crop box hides, also while Crop is off"),
            ("HIDDEN", "Hidden", "All that the limits in Clean hide"),
            ("FLOATERS", "Floaters", "A suggestion: alone, and near a camera or large and faint"),
        ],
    )
    # SKIP_SAVE: Blender would remember the limit for another criterion, and that it was subtracted.
    limit: bpy.props.FloatProperty(name="Limit", min=0.0, default=0.1, precision=4, options={"SKIP_SAVE"})
    action: bpy.props.EnumProperty(
        name="Selection",
        items=[
            ("REPLACE", "Replace", "Select these alone"),
            ("EXTEND", "Extend", "Select these as well"),
            ("SUBTRACT", "Subtract", "Deselect these"),
        ],
        options={"SKIP_SAVE"},
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        layout.prop(self, "by")
        if self.by not in {"CROP", "HIDDEN", "FLOATERS"}:
            layout.prop(self, "limit")
        layout.prop(self, "action")

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        cloud = cloud_of(target)
        if not self.properties.is_property_set("limit"):
            self.limit = _likely_limit(target, self.by)
        found = self._found(context, target)
        if self.action == "EXTEND":
            found |= selection_of(cloud)
        elif self.action == "SUBTRACT":
            found = selection_of(cloud) & ~found
        select_points(cloud, found)
        return f"{int(found.sum())} of {len(found)} Gaussians are selected"

    def _found(self, context: bpy.types.Context, target: bpy.types.Object) -> np.ndarray:
        cloud = cloud_of(target)
        if self.by == "SIZE":
            return read_attribute(cloud, SCALE.name).max(axis=1) > self.limit
        if self.by == "OPACITY":
            return read_attribute(cloud, BASE.name)[:, 3] < self.limit
        if self.by == "ELONGATION":
            return elongation_of(read_attribute(cloud, SCALE.name)) > self.limit
        if self.by == "DISTANCE":
            cursor = np.array(world_of(target).inverted_safe() @ context.scene.cursor.location)
            offset = read_attribute(cloud, POSITION.name) - cursor
            return np.linalg.norm(offset, axis=1) > self.limit
        if self.by == "PHOTOS":
            return camera_distances(context, target) < self.limit
        if self.by == "CONFIDENCE":
            if CONFIDENCE.name not in cloud.attributes:
                raise DataMismatchError(
                    "this model's file does not know how sure its radiance is",
                    "Export it again by this version (physhdr export), and import it.",
                )
            return read_attribute(cloud, CONFIDENCE.name) < self.limit
        if self.by == "FLOATERS":
            return find_floaters(context, target)
        cleaning = cleaning_of(target, context.evaluated_depsgraph_get())
        if self.by == "CROP":
            modifier = nodes.find_modifier(target)
            box = _crop_box(modifier) if modifier else None
            if modifier is None or box is None:
                raise BadValueError(
                    "the model has no crop box", "Add one in Clean, or choose an object there."
                )
            to_box = world_of(box).inverted_safe() @ world_of(target)
            flat = tuple(number for row in to_box for number in row)
            keep_outside = bool(nodes.get_input(modifier, nodes.KEEP_OUTSIDE))
            cleaning = replace(ALL, crop=flat, keep_outside=keep_outside)
        return ~kept_of(cloud, cleaning.without_camera())


class PHYSHDR_OT_cleaning_floaters(_OnModel):
    """Suggest floaters: Gaussians that are alone, and near a camera or large and faint. They are selected,
    for you to look at in Edit Mode and delete there (X); nothing is removed"""

    bl_idname = "physhdr.cleaning_floaters"
    bl_label = "Find Floaters"

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        found = find_floaters(context, target)
        select_points(cloud_of(target), found)
        share = f"{int(found.sum())} of {len(found)} Gaussians look like floaters and are selected"
        if context.mode == "OBJECT":
            enter = cast(Any, bpy.ops).object.mode_set
            if target.name not in context.view_layer.objects or not enter.poll():
                return (
                    f"{share}: to look at them, show the model (Outliner, monitor icon) and enter Edit Mode"
                )
            enter(mode="EDIT")
        return f"{share}: look, then X deletes them"


class PHYSHDR_OT_cleaning_apply(_OnModel):
    """Remove for good what the limits in Clean hide from every side, and in Object Mode reset
    them. What only the camera that renders leaves out stays"""

    bl_idname = "physhdr.cleaning_apply"
    bl_label = "Remove What Is Hidden"

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        cloud = cloud_of(target)
        cleaning = cleaning_of(target, context.evaluated_depsgraph_get()).without_camera()
        keep = kept_of(cloud, cleaning)
        removed = int((~keep).sum())
        if not keep.any():
            raise BadValueError(
                "everything of the model is hidden", "Widen the limits, or delete the object."
            )
        if removed:
            keep_points(cloud, keep)
        # Undo in Edit Mode brings back points, not sliders. There the limits stay: they hide nothing more.
        animated = _reset(target) if context.mode == "OBJECT" else []
        text = f"Removed {removed} of {len(keep)} Gaussians"
        if cloud.users > 1:
            text += f", of all {cloud.users} objects with this point cloud"
        return f"{text}. Animated limits stay: {', '.join(animated)}" if animated else text


class PHYSHDR_OT_cleaning_measure(_OnModel):
    """Measure how far each Gaussian is from the nearest camera of the data set (or from the selected
    cameras), so that Clear of Photos can hide floaters"""

    bl_idname = "physhdr.cleaning_measure"
    bl_label = "Measure from Photos"

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        distance = measured(context, target)
        write_attribute(cloud_of(target), CAMERA_DISTANCE, distance)
        cloud_of(target).update_tag()
        return f"The Gaussians are {distance.min():.3g} to {distance.max():.3g} m from the nearest photo"


class PHYSHDR_OT_cleaning_box(_OnModel):
    """Add a crop box around the model: a cube to move, turn and scale. What is outside is hidden"""

    bl_idname = "physhdr.cleaning_box"
    bl_label = "Add Crop Box"
    edits_points = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        return super().poll(context)

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        modifier = _modifier(target)
        position = read_attribute(cloud_of(target), POSITION.name).astype(np.float64)
        low, high = np.quantile(position, [OUTLIERS, 1.0 - OUTLIERS], axis=0)
        box = bpy.data.objects.new(f"{target.name} crop", None)
        box.empty_display_type, box.empty_display_size = "CUBE", 1.0
        collection_beside(target, context.scene).objects.link(box)
        inside = mathutils.Matrix.Translation((low + high) / 2.0)
        inside @= mathutils.Matrix.Diagonal((*np.maximum((high - low) / 2.0, 1e-3), 1.0))
        box.matrix_world = world_of(target) @ inside
        nodes.set_input(modifier, nodes.CROP_BOX, box)
        nodes.set_input(modifier, nodes.CROP, True)
        context.view_layer.update()
        return f"{box.name!r} crops the model: move, turn and scale it"


# ---- what the operators need -------------------------------------------------------------------------------


def measured(context: bpy.types.Context, target: bpy.types.Object) -> np.ndarray:
    """``[N]`` float32: metres in the model's space to the nearest of the selected cameras, else of the data
    set's. Raises ``FileMissingError`` where there are neither, ``DataMismatchError`` where cameras are
    selected and the model is flat: they have no place in its space."""
    selected = [each for each in context.selected_objects or () if each.type == "CAMERA"]
    folder = origin.data_of(target)
    if selected:
        places = np.array([each.matrix_world.translation for each in selected], np.float64)
        places = similarity.apply(similarity.inverse_of(np.array(world_of(target), np.float64)), places)
    elif folder is not None:
        places = camera_places(folder)
    else:
        raise FileMissingError(
            "the data set of this model is not there, and with it the places of its cameras",
            "Select cameras that stand where photos were taken, with the model.",
        )
    position = read_attribute(cloud_of(target), POSITION.name)
    nearest = np.full(len(position), np.inf, np.float32)
    for place in places.astype(np.float32):
        offset = position - place
        np.minimum(nearest, np.einsum("nc,nc->n", offset, offset), out=nearest)
    return np.sqrt(nearest)


def camera_distances(context: bpy.types.Context, target: bpy.types.Object) -> np.ndarray:
    """``[N]``: as they were measured, else measured now. Raises as ``measured``."""
    cloud = cloud_of(target)
    if CAMERA_DISTANCE.name in cloud.attributes:
        return read_attribute(cloud, CAMERA_DISTANCE.name)
    return measured(context, target)


def find_floaters(context: bpy.types.Context, target: bpy.types.Object) -> np.ndarray:
    """Bool ``[N]``: ``floaters`` of a model, with its cameras' distances where they can be known."""
    cloud = cloud_of(target)
    try:
        distance = camera_distances(context, target)
    except PhysHDRError:  # without its data set they are found by size and opacity alone
        distance = None
    position, scale = read_attribute(cloud, POSITION.name), read_attribute(cloud, SCALE.name)
    return floaters(position, scale, read_attribute(cloud, BASE.name)[:, 3], distance)


def _likely_limit(target: bpy.types.Object, by: str) -> float:
    """A limit with something beyond it, and not much; 0 where there is no limit."""
    if by == "SIZE":
        scale = read_attribute(cloud_of(target), SCALE.name)
        return float(np.quantile(scale.max(axis=1), 0.99))
    if by == "DISTANCE":
        position = read_attribute(cloud_of(target), POSITION.name)
        return float(np.quantile(np.linalg.norm(position - np.median(position, axis=0), axis=1), 0.99))
    return FIRST_LIMITS.get(by, 0.0)


def _modifier(target: bpy.types.Object) -> bpy.types.NodesModifier:
    """The model's modifier. Raises ``DataMismatchError`` where it was removed, or its inputs were."""
    modifier = nodes.find_modifier(target)
    if modifier is None or not nodes.has_input(modifier, nodes.CROP):
        raise DataMismatchError("the PhysHDR modifier was removed or edited", "Import the model again.")
    return modifier


def _crop_box(modifier: bpy.types.NodesModifier) -> bpy.types.Object | None:
    return nodes.get_input(modifier, nodes.CROP_BOX)


def _reset(target: bpy.types.Object) -> list[str]:
    """Let the limits that hide from every side hide nothing; the labels of those that something animates."""
    modifier = nodes.find_modifier(target)
    if modifier is None or not nodes.has_input(modifier, nodes.CROP):
        return []
    animation = target.animation_data
    paths = {curve.data_path for curve in animation.drivers} if animation else set()
    if animation and animation.action:
        paths |= {curve.data_path for curve in curves_of(animation)}
    off = {nodes.CROP: False, nodes.KEEP_OUTSIDE: False, nodes.CROP_BOX: None, nodes.DISTANCE_FROM: None}
    for name in nodes.CLEANING:
        nodes.set_input(modifier, name, off.get(name, 0.0))
    return [name for name in nodes.CLEANING if nodes.input_data_path(modifier, name) in paths]


_CLASSES = (
    PHYSHDR_OT_cleaning_select,
    PHYSHDR_OT_cleaning_floaters,
    PHYSHDR_OT_cleaning_apply,
    PHYSHDR_OT_cleaning_measure,
    PHYSHDR_OT_cleaning_box,
)


def _draw_select_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    if is_model(context.object):
        layout = layout_of(menu)
        layout.separator()
        layout.operator_menu_enum(PHYSHDR_OT_cleaning_select.bl_idname, "by", text="Gaussians by")


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    add_entry(bpy.types.VIEW3D_MT_select_edit_pointcloud, _draw_select_menu)


def unregister() -> None:
    remove_entry(bpy.types.VIEW3D_MT_select_edit_pointcloud, _draw_select_menu)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
