# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that set the scale and the ground of a capture, which structure from motion cannot know.

By two points and their distance, by three points of the floor, or by the height of the cameras. Points are
given by a script, are the places of selected empties, or are picked on the model in the 3D view.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, cast

import bpy
import gpu
import numpy as np
from bpy_extras import view3d_utils
from gpu_extras.batch import batch_for_shader

from ...bridge.errors import BadValueError, DataMismatchError, FileMissingError, PhysHDRError
from .. import similarity
from ..blender import cloud_of, layout_of, world_of
from ..capture import placement
from ..capture.picking import surface_along_ray
from ..layouts.cameras import camera_places
from ..model import origin
from ..model.look import is_model, shown_shape
from ..viewport.splat_data import is_splats
from .base import LINKED, OnModel

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

#: Points that each purpose needs, and what the status bar asks for.
POINTS = {
    "SCALE": ("a point", "the other point, whose distance from the first is known"),
    "FLOOR": ("a point of the floor", "a second point of the floor", "a third, not in line with the others"),
}
GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
#: Of the points that are picked, as they are drawn: orange, pixels across.
COLOUR, SIZE = (1.0, 0.45, 0.0, 1.0), 9.0
#: What turns and moves the view keeps doing so while points are picked.
NAVIGATION = ("MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "NDOF_MOTION")


def _point(name: str) -> Any:
    return bpy.props.FloatVectorProperty(
        name=name, subtype="TRANSLATION", options=GIVEN, description="In the world, metres"
    )


class _OnCapture(OnModel):
    """What is done to the capture of the active model: ``change`` says what, as a map of the world."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if not is_model(context.object):
            cls.poll_message_set("Select an imported model first")
            return False
        if context.object.library is not None:
            cls.poll_message_set(LINKED)
            return False
        return True

    def points(self, context: bpy.types.Context, names: Sequence[str]) -> np.ndarray:
        """``[N, 3]``: the points given under these names, else the places of as many selected empties.

        Raises ``BadValueError`` where there are neither.
        """
        if all(self.properties.is_property_set(name) for name in names):
            return np.array([getattr(self, name) for name in names], np.float64)
        found = selected_places(context)
        if len(found) != len(names):
            raise BadValueError(
                f"{len(names)} points are needed, and {len(found)} empties are selected",
                "Pick them in the 3D view, or select an empty at each of them with the model.",
            )
        return found


def selected_places(context: bpy.types.Context) -> np.ndarray:
    """``[N, 3]``: where the selected empties are."""
    empties = [each for each in context.selected_objects or () if each.type == "EMPTY"]
    return np.array([each.matrix_world.translation for each in empties], np.float64).reshape(-1, 3)


class PHYSHDR_OT_capture_scale(_OnCapture):
    """Set the scale of the capture by two points of it whose distance is known: select an empty at each, or
    pick them on the model"""

    bl_idname = "physhdr.capture_scale"
    bl_label = "Set Scale"

    first: _point("First Point")
    second: _point("Second Point")
    distance: bpy.props.FloatProperty(
        name="Distance", subtype="DISTANCE", min=1e-6, default=1.0, options=GIVEN, description="True distance"
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        try:
            first, second = self.points(context, ("first", "second"))
        except PhysHDRError:
            return pick(self, context, "SCALE")
        self.first, self.second = first, second  # not those that are selected when the dialog ends
        if not self.properties.is_property_set("distance"):
            self.distance = float(np.linalg.norm(second - first))
        return context.window_manager.invoke_props_dialog(self, confirm_text="Set Scale")

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        layout.prop(self, "distance")

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        first, second = self.points(context, ("first", "second"))
        change = similarity.scaled_to(first, second, self.distance)
        placement.move(context.scene, target, change).has_scale = True
        return f"The capture is {change[0, 0]:.4g} times as large: the points lie {self.distance:g} m apart"


class PHYSHDR_OT_capture_floor(_OnCapture):
    """Turn and move the capture so that three points of its floor lie at z = 0: select an empty at each, or
    pick them on the model"""

    bl_idname = "physhdr.capture_floor"
    bl_label = "Set Floor"

    first: _point("First Point")
    second: _point("Second Point")
    third: _point("Third Point")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        names = ("first", "second", "third")
        given = all(self.properties.is_property_set(name) for name in names)
        if given or len(selected_places(context)) == len(names):
            return self.execute(context)
        return pick(self, context, "FLOOR")

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        points = self.points(context, ("first", "second", "third"))
        change = similarity.floor_to_ground(points, above_floor(target))
        placement.move(context.scene, target, change).has_floor = True
        angle = np.degrees(np.arccos(np.clip(change[2, 2], -1.0, 1.0)))
        return f"The capture is turned by {angle:.2f}°, and its floor lies at z = 0"


def above_floor(target: bpy.types.Object) -> np.ndarray:
    """``[3]``: a point of the world that is above the floor: the middle of the cameras, else of the model."""
    folder = origin.data_of(target)
    try:
        places = camera_places(folder) if folder else None
    except PhysHDRError:
        places = None
    if places is None:
        places = shown_shape(target)[0].astype(np.float64)
    return similarity.apply(np.array(world_of(target)), np.median(places, axis=0)[None])[0]


class PHYSHDR_OT_capture_height(_OnCapture):
    """Set the scale or the ground of the capture by the height at which its cameras were held: the middle of
    its data set's, or of those cameras that are selected"""

    bl_idname = "physhdr.capture_height"
    bl_label = "Set Cameras' Height"

    height: bpy.props.FloatProperty(
        name="Height",
        subtype="DISTANCE",
        min=1e-6,
        default=1.6,
        options=GIVEN,
        description="Of the cameras above the ground, z = 0",
    )
    sets: bpy.props.EnumProperty(
        name="By It Set",
        items=[
            (
                "SCALE",
                "Scale",
                "The floor is at z = 0 already: the capture grows until the height is right",
            ),
            ("GROUND", "Ground", "The scale is right already: the capture moves up or down"),
        ],
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        target = context.object
        assert is_model(target)
        known = placement.settings_of(context.scene).captures.get(origin.capture_of(target))
        if not (known and known.has_floor) and not self.properties.is_property_set("sets"):
            self.sets = "GROUND"
        return context.window_manager.invoke_props_dialog(self, confirm_text="Set Height")

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        layout.prop(self, "height")
        layout.prop(self, "sets", expand=True)

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        heights = camera_heights(context, target)
        now = float(np.median(heights))
        if self.sets == "GROUND":
            change = similarity.raised(self.height - now)
        elif now <= 0.0:
            raise BadValueError(
                f"the cameras are at {now:.3g} m, not above the ground",
                "Set the floor by three points first, or set the ground by the height.",
            )
        else:
            change = similarity.scaled(self.height / now)
        kept = placement.move(context.scene, target, change)
        if self.sets == "GROUND":
            kept.has_floor = True
            return f"The capture is moved by {change[2, 3]:+.4g} m: its cameras are {self.height:g} m high"
        kept.has_scale = True
        return f"The capture is {change[0, 0]:.4g} times as large: its cameras are {self.height:g} m high"


def camera_heights(context: bpy.types.Context, target: bpy.types.Object) -> np.ndarray:
    """``[N]``, metres: of the selected cameras, else of those of the model's data set, where it stands now.

    Raises ``FileMissingError`` where there are neither.
    """
    selected = [each for each in context.selected_objects or () if each.type == "CAMERA"]
    if selected:
        return np.array([each.matrix_world.translation.z for each in selected])
    folder = origin.data_of(target)
    if folder is None:
        raise FileMissingError(
            "the data set of this model is not there, and with it the places of its cameras",
            "Select a camera that stands where one of the photos was taken, with the model.",
        )
    context.view_layer.update()
    return similarity.apply(np.array(world_of(target)), camera_places(folder))[:, 2]


class PHYSHDR_OT_capture_reset(_OnCapture):
    """Put the capture back to where it was imported, and forget its scale and ground"""

    bl_idname = "physhdr.capture_reset"
    bl_label = "Reset Scale and Ground"

    def act(self, context: bpy.types.Context, target: bpy.types.Object) -> str:
        placement.forget(context.scene, target)
        return "The capture stands where it was imported"


# ---- picking -----------------------------------------------------------------------------------------------


def pick(asking: bpy.types.Operator, context: bpy.types.Context, purpose: str) -> set[str]:
    """Let the points for a purpose be picked on the active model; the operator that asks is called again with
    them. It reports where nothing could be done with the points."""
    target = context.object
    assert is_model(target)
    try:
        _check_pickable(context.scene, target)
    except PhysHDRError as error:
        asking.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    operators = cast(Any, bpy.ops).physhdr
    operators.points_pick("INVOKE_DEFAULT", purpose=purpose)
    return {"CANCELLED"}


def _check_pickable(scene: bpy.types.Scene, target: bpy.types.Object) -> None:
    if not is_splats(cloud_of(target)):
        raise DataMismatchError(f"{target.name} has lost what it is drawn by", "Import it again.")
    similarity.scale_of(np.array(world_of(target), np.float64))
    placement.check_at_rest(scene, origin.capture_of(target))


class PHYSHDR_OT_points_pick(bpy.types.Operator):
    """Pick points on the model: each is where half of the light from behind is gone"""

    bl_idname = "physhdr.points_pick"
    bl_label = "Pick Points"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    purpose: bpy.props.EnumProperty(
        name="Purpose", items=[("SCALE", "Scale", ""), ("FLOOR", "Floor", "")], options={"SKIP_SAVE"}
    )

    _handler: Any = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return is_model(context.object) and context.area is not None and context.area.type == "VIEW_3D"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        target = context.object
        assert is_model(target)
        self._points: list[np.ndarray] = []
        self._target, self._shape = target.name, shown_shape(target)
        add = bpy.types.SpaceView3D.draw_handler_add
        self._handler = add(draw_points, (self._points,), "WINDOW", "POST_VIEW")
        context.window_manager.modal_handler_add(self)
        self._ask(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in NAVIGATION:
            return {"PASS_THROUGH"}
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self._end(context)
            return {"CANCELLED"}
        if event.type == "BACK_SPACE" and event.value == "PRESS" and self._points:
            self._points.pop()
            self._ask(context)
        if event.type == "LEFTMOUSE" and event.value == "PRESS":
            if not _is_in(context.region, event):
                return {"PASS_THROUGH"}
            self._pick(context, (event.mouse_region_x, event.mouse_region_y))
            if len(self._points) == len(POINTS[self.purpose]):
                self._end(context)
                return self._hand_on(context)
            self._ask(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends it: another file is opened, or the window closed."""
        self._end(context)

    def _pick(self, context: bpy.types.Context, at: tuple[float, float]) -> None:
        target = self._model()
        region, view = context.region, context.region_data
        if target is None or region is None or view is None:
            return
        origin = np.array(view3d_utils.region_2d_to_origin_3d(region, view, at), np.float64)
        direction = np.array(view3d_utils.region_2d_to_vector_3d(region, view, at), np.float64)
        point = surface_point(np.array(world_of(target), np.float64), self._shape, origin, direction)
        if point is None:
            self.report({"WARNING"}, "There is nothing of the model under the mouse")
        else:
            self._points.append(point)

    def _ask(self, context: bpy.types.Context) -> None:
        wanted = POINTS[self.purpose][len(self._points)]
        context.workspace.status_text_set(f"Click {wanted}    Backspace: the last again    Esc: cancel")
        if context.area:
            context.area.tag_redraw()

    def _end(self, context: bpy.types.Context) -> None:
        bpy.types.SpaceView3D.draw_handler_remove(self._handler, "WINDOW")
        if context.workspace:
            context.workspace.status_text_set(None)
        if context.area:
            context.area.tag_redraw()

    def _model(self) -> bpy.types.Object | None:
        """The model that points are picked on; None where it is gone."""
        return bpy.data.objects.get((self._target, None))  # of another file there may be one of that name

    def _hand_on(self, context: bpy.types.Context) -> set[str]:
        """What is asked for by the points happens to the model that they were picked on: what passes through
        (a click in the Outliner) may have made another object active."""
        context.view_layer.update()  # what was taken out of it is still among its objects else
        target = self._model()
        if target is None or target not in context.view_layer.objects.values() or context.mode != "OBJECT":
            text = f"{self._target} is no longer in this view layer, or Object Mode was left"
            self.report({"ERROR"}, f"The points were not used: {text}. Select the model and pick them again.")
            return {"CANCELLED"}
        context.view_layer.objects.active = target
        names = ("first", "second", "third")
        points = {name: tuple(point) for name, point in zip(names, self._points, strict=False)}
        ops = cast(Any, bpy.ops).physhdr
        operator = ops.capture_scale if self.purpose == "SCALE" else ops.capture_floor
        try:
            operator("INVOKE_DEFAULT", True, **points)  # True: a step of undo of its own
        except RuntimeError as error:  # how its report comes here, as of points in one line
            self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
            return {"CANCELLED"}
        return {"FINISHED"}


def surface_point(
    matrix_world: np.ndarray, shape: Sequence[np.ndarray], origin: np.ndarray, direction: np.ndarray
) -> np.ndarray | None:
    """``[3]``, world: where a ray of the world meets a model's Gaussians; None where it meets nothing.

    ``shape``: theirs, as ``shown_shape`` tells it.
    """
    to_object = np.linalg.inv(matrix_world)
    along = surface_along_ray(
        similarity.apply(to_object, origin[None])[0],
        to_object[:3, :3] @ direction,  # not made of length 1: what is found along it holds in the world
        *shape,
    )
    return None if along is None else origin + along * direction


def _is_in(region: bpy.types.Region | None, event: bpy.types.Event) -> bool:
    if region is None:
        return False
    return 0 <= event.mouse_region_x < region.width and 0 <= event.mouse_region_y < region.height


def draw_points(points: list[np.ndarray]) -> None:
    """The points that were picked so far, in front of everything (a draw handler)."""
    if not points:
        return
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "POINTS", {"pos": [tuple(point) for point in points]})
    gpu.state.point_size_set(SIZE)
    gpu.state.depth_test_set("NONE")
    shader.bind()
    shader.uniform_float("color", COLOUR)
    batch.draw(shader)


_CLASSES = (
    PHYSHDR_OT_capture_scale,
    PHYSHDR_OT_capture_floor,
    PHYSHDR_OT_capture_height,
    PHYSHDR_OT_capture_reset,
    PHYSHDR_OT_points_pick,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
