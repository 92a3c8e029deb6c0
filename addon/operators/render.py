# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for rendering: set the scene up for its models, bring in the cameras of the data set."""

from pathlib import Path
from typing import Any, ClassVar, cast

import bpy

from ...bridge.blend_file import SPLIT
from ...bridge.errors import BadValueError, FileMissingError, PhysHDRError
from ..blender import layout_of
from ..capture.dataset_cameras import cameras_of, first_of, has_cameras, import_cameras, take_size
from ..model import origin
from ..model.look import models_among
from ..rendering import develop
from ..rendering.render_setup import (
    has_model,
    models_in_render,
    models_of,
    render_problems,
    set_up,
    wishes_from,
)
from ..viewport.framing import views


def model_for(context: bpy.types.Context) -> bpy.types.Object | None:
    """The model that is meant: the active one, or the one whose instance is active, else one that the render
    shows, else any of the scene."""
    shown = models_of(context.object) or models_in_render(context.scene)
    return shown[0] if shown else next(models_among(context.scene.objects), None)


class PHYSHDR_OT_render_setup(bpy.types.Operator):
    """Set what the scene's models need to render right in Cycles and EEVEE, and nothing else. Other objects'
    bounces, samples and shadows stay, and what is set higher stays, too"""

    bl_idname = "physhdr.render_setup"
    bl_label = "Set Up Render"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    camera_splats: bpy.props.BoolProperty(
        name="Camera Splats",
        default=True,
        description="Draw cards that face the camera, as trained. Off: ellipsoids, right in mirrors and from "
        "any side",
    )
    cast_shadows: bpy.props.BoolProperty(
        name="Cast Shadows",
        description="Let Gaussians cast shadows on other objects: slow in Cycles, and EEVEE may not finish",
        options={"SKIP_SAVE"},
    )
    film_transparent: bpy.props.BoolProperty(
        name="Transparent Film",
        description="Leave out the world behind the models. Off: the film stays as it is set",
        options={"SKIP_SAVE"},
    )
    exact: bpy.props.BoolProperty(
        name="Exact",
        description="Look through the pixels' centres, without denoiser and direct clamping, as the trainer "
        "does: for comparing. Edges of other objects become jagged. Off: filter and denoiser stay as set",
        options={"SKIP_SAVE"},
    )
    camera: bpy.props.StringProperty(
        name="Camera",
        description="Render through this camera, of the data set or of your own; empty: the scene's",
        options={"SKIP_SAVE"},
    )
    use_size: bpy.props.BoolProperty(
        name="Size of Its Picture",
        description="Render as wide and as high as the picture of the data set's camera",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_model(context.scene):
            cls.poll_message_set("Import a model first")
            return False
        return True

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        for name in ("camera_splats", "cast_shadows", "film_transparent", "exact"):
            layout.prop(self, name)
        layout.prop_search(self, "camera", context.scene, "objects", icon="CAMERA_DATA")
        layout.prop(self, "use_size")

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        try:
            develop.check_developed(scene)  # before anything is set
            camera = self._camera(scene)
            if self.use_size:
                if camera is None:
                    raise FileMissingError("there is no camera", "Import the data set's cameras first.")
                take_size(scene, camera)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        scene.camera = camera
        set_up(scene, wishes_from(self))
        left = render_problems(scene)
        if left:
            self.report({"WARNING"}, ". ".join(problem.text for problem in left))
        else:
            self.report({"INFO"}, "The scene is set up: its models render as they were trained")
        return {"FINISHED"}

    def _camera(self, scene: bpy.types.Scene) -> bpy.types.Object | None:
        """The camera that is asked for, or the scene's; raises ``BadValueError``."""
        if not self.camera:
            return scene.camera
        camera = scene.objects.get(self.camera)
        if camera is None or camera.type != "CAMERA":
            raise BadValueError(
                f"{self.camera!r} is not a camera of this scene", "Choose one of its cameras."
            )
        return camera


def model_to_develop_by(context: bpy.types.Context) -> bpy.types.Object | None:
    """The model whose learned response a picture gets: the one that is meant where it has a response, else
    one with a response that the render shows."""
    found = [model_for(context), *models_in_render(context.scene)]
    return next((each for each in found if develop.response_of(each) is not None), None)


class PHYSHDR_OT_develop_render(bpy.types.Operator):
    """Let the compositor develop renders as the camera would have that took the pictures: by the active
    model's learned response, applied to what was blended, other objects included. Learned Tones of the models
    are switched off for it, and the view is set to Standard, which shows its codes"""

    bl_idname = "physhdr.develop_render"
    bl_label = develop.LABEL
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    remove: bpy.props.BoolProperty(
        name="Remove",
        description="Take it out of the compositor again, and give Learned Tones and the view back",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        if properties.remove:
            return "Renders are developed: take that out of the compositor, and give tones and view back"
        return " ".join((cls.__doc__ or "").split())

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if develop.node_of(context.scene) is None and model_to_develop_by(context) is None:
            cls.poll_message_set("None of the models has a learned response: train with several exposures")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, models = context.scene, models_in_render(context.scene)
        if self.remove:
            others = [each for each in bpy.data.scenes if each != scene and develop.node_of(each) is not None]
            elsewhere = {model for each in others for model in models_in_render(each)}
            elsewhere |= {model for each in others for model in models_among(each.objects)}
            develop.remove(scene, models, elsewhere)
            self.report({"INFO"}, "Renders are scene-linear radiance again")
            return {"FINISHED"}
        target = model_to_develop_by(context)
        if target is None:
            self.report({"ERROR"}, "No model has a learned response: train one with several exposures")
            return {"CANCELLED"}
        try:
            develop.develop(scene, target, models)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        text = f"Renders are developed by the response of {target.name!r}, and whatever else is in them"
        self.report({"INFO"}, text)
        return {"FINISHED"}


class PHYSHDR_OT_cameras_import(bpy.types.Operator):
    """Bring in the cameras of the model's data set, in a collection of their own; those that are there
    already are put back to their places"""

    bl_idname = "physhdr.cameras_import"
    bl_label = "Import Cameras"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(
        name="Data Set",
        subtype="DIR_PATH",
        description="Folder of the data set, where it has moved; empty: where the model was trained from it",
        options={"SKIP_SAVE"},
    )
    look_through: bpy.props.BoolProperty(
        name="Look Through",
        description="Render through the first test view. A scene without a camera does so anyway",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if not has_model(context.scene):
            cls.poll_message_set("Import a model first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        target = model_for(context)
        if target is None or self.directory or has_cameras(target):
            return self.execute(context)
        self.report({"WARNING"}, f"The data set of {target.name!r} has moved: choose its folder")
        context.window_manager.fileselect_add(cast(Any, self))
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context) -> None:
        layout_of(self).prop(self, "look_through")

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, target = context.scene, model_for(context)
        assert target is not None
        folder = Path(bpy.path.abspath(self.directory)) if self.directory else None
        try:
            done = import_cameras(scene, target, folder)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if self.look_through or scene.camera is None:
            scene.camera = first_of(done.cameras)
        kept = len(done.cameras) - done.added
        text = f"{done.added} cameras of {origin.capture_of(target)}"
        text += f", and {kept} put back." if kept else "."
        self.report({"INFO"}, " ".join([text, *done.notes]))
        return {"FINISHED"}


class PHYSHDR_OT_look_through(bpy.types.Operator):
    """Look and render through the next camera of the capture, as its photo was taken"""

    bl_idname = "physhdr.look_through"
    bl_label = "Look Through"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    step: bpy.props.IntProperty(
        name="Step",
        default=1,
        description="1: the next camera, −1: the one before; 0: the present one, or the first",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return PHYSHDR_OT_cameras_import.poll.__func__(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, target = context.scene, model_for(context)
        assert target is not None
        cameras = cameras_of(scene, target)
        if not cameras:
            try:
                cameras = list(import_cameras(scene, target).cameras)
            except PhysHDRError as error:
                self.report({"ERROR"}, str(error))
                return {"CANCELLED"}
        cameras.sort(key=lambda camera: (camera.get(SPLIT, ""), camera.name))
        if scene.camera in cameras:
            scene.camera = cameras[(cameras.index(scene.camera) + self.step) % len(cameras)]
        else:
            scene.camera = first_of(tuple(cameras))
        for view, region in views(context):
            view.use_local_camera = False
            region.view_perspective = "CAMERA"
        return {"FINISHED"}


_CLASSES = (
    PHYSHDR_OT_render_setup,
    PHYSHDR_OT_develop_render,
    PHYSHDR_OT_cameras_import,
    PHYSHDR_OT_look_through,
)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
