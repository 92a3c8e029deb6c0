# SPDX-License-Identifier: GPL-3.0-or-later
"""*Bake to PLY*: the active model's look for any 3DGS viewer. Its colours are fitted by the backend, in a
process of its own: you keep working beside it."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper

from ...bridge.display import Tone
from ...bridge.errors import BadValueError, PhysHDRError
from ...bridge.model_file import SUFFIX, Model, write_model
from ...bridge.run_folder import VIEWS_FILE
from ...bridge.splat_files import read_splat_file
from .. import outside
from ..blender import cloud_of, layout_of, world_of
from ..model.attributes import FILE
from ..model.bake import bake, baked_look, baked_model, moved, write_fitted
from ..model.look import Look, is_model, look_of
from ..model.origin import data_of
from ..paths import whole
from ..runtime import session
from ..session.results import BAKE, bake_command, why_not_on_run
from ..session.state import NotTaken, Problem, TaskMade
from .afterwards import take_when_ended
from .base import report_task, wait_for_task

#: Seconds that scripts wait.
WAIT_SECONDS = 24 * 3600.0


@dataclass(frozen=True)
class Baking:
    """A bake that is under way: what is fitted, in ``folder``, and where it goes."""

    folder: Path
    model: Model
    look: Look
    tone: Tone
    to_world: np.ndarray
    path: Path

    @property
    def source(self) -> Path:
        return self.folder / f"model{SUFFIX}"

    @property
    def fitted(self) -> Path:
        return self.folder / "fitted.ply"

    def take(self) -> None:
        """Write the file with what was fitted. Raises ``PhysHDRError``."""
        colours = read_splat_file(self.fitted).colour_sh
        write_fitted(self.path, self.model, colours, self.look, self.tone, self.to_world)

    def discard(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


class PHYSHDR_OT_model_bake(bpy.types.Operator, ExportHelper):
    """Export the active model with its current look (exposure, lighting levels, tone) as a 3DGS PLY, which
    any viewer opens. Its colours are fitted so that a viewer shows the model's own picture"""

    bl_idname = "physhdr.model_bake"
    bl_label = "Bake to PLY"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".ply"
    # ExportHelper's own is remembered: the next model would be offered the file of the last one.
    filepath: bpy.props.StringProperty(name="File Path", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.ply", options={"HIDDEN"})
    tone: bpy.props.EnumProperty(
        name="Tone",
        description="How radiance becomes the colours that viewers show",
        items=[
            ("LOOK", "As shown", "The learned tone mapper where the model shows it, else the sRGB curve"),
            ("LEARNED", "Learned", "The response of the camera that took the training pictures"),
            ("SRGB", "sRGB", "The plain sRGB curve, as Blender's Standard view"),
        ],
    )
    apply_transform: bpy.props.BoolProperty(
        name="Apply transform",
        description="Write world space: the object's location, rotation and scale. Off: as it was imported",
        default=True,
    )
    quick: bpy.props.BoolProperty(
        name="Quick",
        description="Convert each Gaussian's colour by itself, at once: their blend is a darker picture. "
        "Off: fitted to the model's own pictures by the backend, in about half a minute",
        default=False,
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not is_model(context.object):
            cls.poll_message_set("Select an imported model first")
            return False
        if session().state.task(BAKE):
            cls.poll_message_set("A bake is under way")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            self.filepath = f"{_active_model(context).name}.ply"
        return set(super().invoke(context, event))

    def draw(self, context: bpy.types.Context) -> None:
        column = layout_of(self).column()
        column.use_property_split = True
        for name in ("tone", "apply_transform"):
            column.prop(self, name)
        reason = why_not_fitted(context.object) if is_model(context.object) else ""
        row = column.row()
        row.active = not reason
        row.prop(self, "quick")
        if reason:
            column.label(text=f"Quick only: {reason}", icon="INFO")

    def execute(self, context: bpy.types.Context) -> set[str]:
        target = _active_model(context)
        depsgraph = context.evaluated_depsgraph_get()  # drivers and keyframes, as of this frame
        try:
            path = Path(whole(self.filepath))
            look = look_of(target, depsgraph)
            tone: Tone = self.tone
            if self.tone == "LOOK":
                tone = "LEARNED" if look.tone_mapper else "SRGB"
            reason = "" if self.quick else why_not_fitted(target)
            if not self.quick and not reason:
                return self._fit(target, path, look, tone)
            model = bake(target, path, look, tone, self.apply_transform)
            alone = f". Each Gaussian's colour by itself: {reason}" if reason else ""
            said = f"Wrote {model.count} Gaussians to {path}: {baked_look(model, look, tone)}{alone}"
            self.report({"INFO"}, said)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _fit(self, target: bpy.types.Object, path: Path, look: Look, tone: Tone) -> set[str]:
        current = session()
        model = baked_model(target, look)
        if tone == "LEARNED" and model.tone_curve is None:
            raise BadValueError("the model has no learned tone mapper", "Bake it with the sRGB curve.")
        to_world = np.array(world_of(target)) if self.apply_transform else np.eye(4)
        moved(model, to_world)  # refuses what cannot be written before half a minute is spent on it
        folder = Path(tempfile.mkdtemp(prefix="physhdr_bake_", dir=bpy.app.tempdir))
        baking = Baking(folder, model, look, tone, to_world, path)
        try:
            write_model(baking.source, model)
            levels = dict(zip(model.lights, look.lighting_levels, strict=True))
            command = bake_command(
                *(str(baking.source), str(baking.fitted), cameras_of(target)),
                *(look.exposure_ev, levels, tone),
            )
            log = current.home / f"{BAKE}.log"
            current.start_task(BAKE, current.backend_command(*command), log, current.environment())
        except PhysHDRError:
            baking.discard()
            raise
        text = f"Wrote {model.count} Gaussians to {path}, fitted to the model's pictures"
        if self.wait:
            try:
                if not wait_for_task(self, BAKE, WAIT_SECONDS):
                    current.cancel_task(BAKE)  # nobody would take what it makes
                    return {"CANCELLED"}
                if baking.fitted.is_file():
                    baking.take()
                return report_task(self, text)
            finally:
                baking.discard()

        def take() -> bool:
            try:
                if baking.fitted.is_file():  # not where it failed, or was cancelled
                    baking.take()
                    session().dispatch(TaskMade(BAKE, str(baking.path)))
            except PhysHDRError as error:
                session().dispatch(NotTaken(Problem(error.message, error.hint)))
            finally:
                baking.discard()
            return False

        take_when_ended(BAKE, take, self.bl_label, in_any_file=True)
        self.report({"INFO"}, f"Fitting colours: {path} is written when that is done")
        return {"FINISHED"}


def cameras_of(target: bpy.types.Object) -> str:
    """The run or data set whose cameras saw what a model shows; empty where nobody knows."""
    file = bpy.path.abspath(str(cloud_of(target).get(FILE, "")))
    run = Path(file).parent
    return str(run if file and outside.is_file(run / VIEWS_FILE) else data_of(target) or "")


def why_not_fitted(target: bpy.types.Object) -> str:
    """Why a bake of a model can be a quick one alone; empty where its colours can be fitted."""
    if reason := why_not_on_run(session().state, BAKE):
        return reason
    return "" if cameras_of(target) else "the cameras of its data set are not known any more"


def _active_model(context: bpy.types.Context) -> bpy.types.Object:
    """The object for which ``poll`` let the operator run."""
    assert is_model(context.object)
    return context.object


register, unregister = bpy.utils.register_classes_factory((PHYSHDR_OT_model_bake,))
