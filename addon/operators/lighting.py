# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that let a capture light the scene: *Light From Here*, *Restore World*.

The panoramas are drawn by the backend, in a process of its own, from the file that the model was imported
from; where there is no backend, or the model was edited since, by Cycles in this Blender.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import bpy

from ...bridge.errors import BadValueError, DataMismatchError, PhysHDRError
from ...bridge.model_file import SUFFIX, read_model
from ...bridge.probe import MUCH_UNSEEN, WIDTH, Probe, read_probe
from .. import outside
from ..blend_paths import moved
from ..blender import cloud_of, layout_of
from ..light import lighting, probes
from ..light.probe_checks import note
from ..light.probe_render import render_probe
from ..model import nodes
from ..model.attributes import FILE
from ..model.drawn import drawn_of, drawn_of_file
from ..model.look import cleaning_of, is_model, models_among
from ..runtime import session
from ..session.light import LIGHT, panorama_command
from ..session.state import CHECK, INSTALL, NotTaken, Problem, TaskMade
from .afterwards import scene_of, take_when_ended
from .base import LINKED, OVERRIDE, wait_for_task

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

#: Seconds that scripts wait for the backend.
LONGEST = 24 * 3600.0
GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
FOLDER: "set[PropertyFlagItems]" = {"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}

MIRRORS = [
    (
        "ENVIRONMENT",
        "Environment",
        "Reflections show the panorama, as from the probe: bright and smooth, without parallax",
    ),
    (
        "SPLATS",
        "Splats",
        "Reflections show the Gaussians where they are, and the panorama through their gaps. Slower; the "
        "Gaussians keep the colours that they have toward the camera",
    ),
]


@dataclass(frozen=True)
class Task:
    """A probe to be made: the empty's ``session_uid``, 0 for a new one at ``place``; ``at``: in the model's
    space; ``width``: pixels."""

    empty: int
    place: probes.Place
    at: probes.Place
    folder: str
    width: int


class PHYSHDR_OT_light_from_here(bpy.types.Operator):
    """Light the scene with what the active model shows from a place: the selected empties, or the 3D cursor.
    CG there is lit as the capture is, and follows the model's lighting levels and exposure"""

    bl_idname = "physhdr.light_from_here"
    bl_label = "Light From Here"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    at: bpy.props.FloatVectorProperty(
        name="At",
        description="Where the light is taken, in the world. Not given: at the selected empties, else at the "
        "3D cursor",
        subtype="TRANSLATION",
        options=GIVEN,
    )
    width: bpy.props.IntProperty(
        name="Width",
        description="Of the panoramas, pixels: a power of two. A small bright lamp wants a wide one",
        default=WIDTH,
        min=16,
        max=16384,
    )
    by: bpy.props.EnumProperty(
        name="Drawn By",
        items=[
            ("AUTO", "Automatic", "The backend where there is one and the model is as it was imported"),
            ("BACKEND", "Backend", "The trainer's rasteriser, beside Blender"),
            ("BLENDER", "Blender", "Cycles, in this Blender, which waits: the model as it is now"),
        ],
    )
    mirrors: bpy.props.EnumProperty(
        name="Reflections", description="What mirrors and glass see of the capture", items=MIRRORS
    )
    model: bpy.props.StringProperty(
        name="Model", description="The object whose light it is. Empty: the active one", options=GIVEN
    )
    subject: bpy.props.StringProperty(
        name="Subject",
        description="The object to whose place the light of several probes is blended. Empty: the camera",
        options=GIVEN,
    )
    folder: bpy.props.StringProperty(
        name="Folder",
        description="A probe of this model that physhdr render --at has drawn: it is used as it is",
        subtype="DIR_PATH",
        options=FOLDER,
    )
    #: Each probe that is taken again has the width that it had.
    same_width: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first (Tab)")
            return False
        if session().state.task(LIGHT):
            cls.poll_message_set("Light is being taken: wait for that to end, or cancel it")
            return False
        model = model_in(context)
        if model is None:
            cls.poll_message_set("Select an imported model first")
            return False
        if model.library is not None:
            cls.poll_message_set(LINKED)
            return False
        return True

    def draw(self, context: bpy.types.Context) -> None:
        column = layout_of(self).column()
        column.use_property_split = True
        for name in ("width", "by", "mirrors"):
            column.prop(self, name)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            return self._run(context)
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _run(self, context: bpy.types.Context) -> set[str]:
        context.view_layer.update()  # what a script has just set is in no matrix yet
        model = self._model(context)
        tasks = self._tasks(context, model)
        subject = _object(context.scene, self.subject) if self.subject else None
        after = After(
            scene=context.scene.session_uid,
            model=model.session_uid,
            name=model.name,
            mirrors=self.mirrors,
            subject=subject.session_uid if subject else 0,
            drawn=drawn_of(cloud_of(model)),
        )
        if self.folder:
            return self._told(after.apply(tasks))
        if self._drawn_by(model) == "BLENDER":
            manager = context.window_manager
            manager.progress_begin(0.0, 1.0)
            try:
                for number, task in enumerate(tasks):

                    def report(done: float, number: int = number) -> None:
                        manager.progress_update((number + done) / len(tasks))

                    render_probe(model, task.at, task.width, _absolute(task.folder), report)
            finally:
                manager.progress_end()
            return self._told(after.apply(tasks))
        if not (source := source_of(model)):
            raise DataMismatchError(
                f"the file that {model.name} was imported from is not there",
                "Let Blender draw, or import it again.",
            )
        if self.by == "BACKEND":  # Automatic has found that the two draw the same
            after = replace(after, drawn=_drawn_of_file(source))
        if not self.wait:
            _draw_all(source, after, tasks, of_one_width(tasks))
            return {"FINISHED"}
        for each in of_one_width(tasks):
            _start(source, each)
            if not wait_for_task(self, LIGHT, LONGEST):
                return {"CANCELLED"}
            if problem := session().state.problem:
                raise DataMismatchError(problem.message, problem.hint)
            if not all_there(each):
                self.report({"ERROR"}, "taking the light was cancelled")
                return {"CANCELLED"}
        return self._told(after.apply(tasks))

    def _model(self, context: bpy.types.Context) -> bpy.types.Object:
        model = _object(context.scene, self.model) if self.model else model_in(context)
        if not is_model(model):
            raise BadValueError(f"{self.model} is not a model of ours", "Name an imported model.")
        if model.library is not None:  # what its light needs of it would not be saved
            raise DataMismatchError(f"{model.name} is linked from another file", OVERRIDE)
        if nodes.find_modifier(model) is None:
            raise DataMismatchError(f"{model.name} has lost its PhysHDR modifier", "Import it again.")
        return model

    def _tasks(self, context: bpy.types.Context, model: bpy.types.Object) -> list[Task]:
        """The places, and the folder of each."""
        scene = context.scene
        if self.folder:
            there = read_probe(_absolute(self.folder)).at
            return [self._at(context, model, _place(probes.in_world(model, there)), self.folder)]
        if self.properties.is_property_set("at"):
            empties, place = [], _place(self.at)
        else:
            empties = [each for each in context.selected_objects or () if each.type == "EMPTY"]
            place = _place(scene.cursor.location)
        if not empties:
            return [self._at(context, model, place)]
        return [self._anew(each, model, _place(each.matrix_world.translation)) for each in empties]

    def _anew(self, empty: bpy.types.Object, model: bpy.types.Object, place: probes.Place) -> Task:
        """Light taken at an empty."""
        keeps = self.same_width and probes.is_probe(empty)
        width = probes.known(empty).width if keeps else self.width
        folder = probes.new_folder(empty.name)
        return Task(empty.session_uid, place, probes.into_model(model, place), folder, width)

    def _at(
        self, context: bpy.types.Context, model: bpy.types.Object, place: probes.Place, folder: str = ""
    ) -> Task:
        """A probe at a place of the world: the one that stands there already, or a new one."""
        there = probes.into_model(model, place)
        for each in probes.probes_of(context.scene, model):
            if probes.is_at(each, there):
                folder = folder or probes.new_folder(each.name)
                return Task(each.session_uid, place, there, folder, self.width)
        return Task(0, place, there, folder or probes.new_folder(probes.NEW), self.width)

    def _drawn_by(self, model: bpy.types.Object) -> Literal["BACKEND", "BLENDER"]:
        if self.by != "AUTO":
            if self.by == "BACKEND" and not session().state.backend.ready:
                raise DataMismatchError("there is no backend", "Install it, or let Blender draw.")
            return self.by
        if why_not_backend(model):
            return "BLENDER"
        return "BACKEND"

    def _told(self, made: Sequence[Probe]) -> set[str]:
        for probe in made:
            text = f"{probe.unseen:.0%} of the sphere was never seen and is filled from its rim"
            self.report({"WARNING" if probe.unseen > MUCH_UNSEEN else "INFO"}, text)
        return {"FINISHED"}


class PHYSHDR_OT_light_refresh(bpy.types.Operator):
    """Take the light anew at all probes of the model, where they stand now. Their widths, reflections and the
    subject stay as they are"""

    bl_idname = "physhdr.light_refresh"
    bl_label = "Take Light Again"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        model = model_in(context)
        if model is None or not probes.probes_of(context.scene, model):
            cls.poll_message_set("There is no probe of this model: use Light From Here first")
            return False
        return PHYSHDR_OT_light_from_here.poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        model = model_in(context)
        assert model is not None
        found = probes.probes_of(context.scene, model)
        chosen = {"object": model, "active_object": model, "selected_objects": found}
        override: Any = context.temp_override(**chosen)
        call: Any = getattr(bpy.ops, "physhdr").light_from_here  # noqa: B009
        world = context.scene.world
        given = lighting.choices_of(world, model) if world is not None else None
        mirrors, subject = given or ("ENVIRONMENT", None)
        is_here = subject is not None and subject.name in context.scene.objects
        with override:
            return call(
                model=model.name,
                same_width=True,
                mirrors=mirrors,
                subject=subject.name if subject is not None and is_here else "",
            )


class PHYSHDR_OT_light_reset(bpy.types.Operator):
    """Give the scene the world back that it had before a capture lit it. The probes stay"""

    bl_idname = "physhdr.light_reset"
    bl_label = "Restore World"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not lighting.is_lit(context.scene.world):
            cls.poll_message_set("This scene's world is not lit by a capture")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        lighting.reset(context.scene)
        return {"FINISHED"}


# ---- what they share ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class After:
    """What is done with finished panoramas.

    ``session_uid``s, not data-blocks nor names: an undo or a new name may come between. ``subject``: 0 for
    the camera; ``name``: the model's at the start; ``drawn``: what its panoramas were drawn from
    (``model.drawn``).
    """

    scene: int
    model: int
    name: str
    mirrors: lighting.Mirrors
    subject: int
    drawn: str

    def apply(self, tasks: Sequence[Task]) -> list[Probe]:
        """Let the probes be in the scene, and light it; raises where something has gone meanwhile."""
        scene = scene_of(self.scene)
        model = _of_uid(scene, self.model) if scene else None
        if scene is None or not is_model(model):
            raise DataMismatchError(f"{self.name} is no longer in the scene", "Use Light From Here again.")
        made, new = [], []
        try:
            for task in tasks:
                found = read_probe(_absolute(task.folder))
                empty = _of_uid(scene, task.empty)
                if empty is None:
                    empty = probes.new_probe(scene, model, task.place)
                    new.append(empty)
                probes.mark(empty, model, task.folder, found)
                note(empty, model, self.drawn)
                made.append(found)
            bpy.context.view_layer.update()
            subject = _of_uid(scene, self.subject)
            lighting.light(scene, model, probes.probes_of(scene, model), self.mirrors, subject)
        except BaseException:
            bpy.data.batch_remove(new)
            raise
        return made


def model_in(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where it is a model, the model of an active probe, else the scene's only model."""
    active = context.object
    if is_model(active):
        return active
    if probes.is_probe(active) and is_model(model := active.get(probes.MODEL)):
        return model
    models = list(models_among(context.scene.objects))
    return models[0] if len(models) == 1 else None


def source_of(model: bpy.types.Object) -> str:
    """The model file that a model was imported from; "" where it is not there any more."""
    path = Path(bpy.path.abspath(str(cloud_of(model).get(FILE, ""))))
    return str(path) if path.suffix == SUFFIX and outside.is_file(path) else ""


def why_not_backend(model: bpy.types.Object) -> str:
    """Why the backend cannot draw the model as it is here; empty where it can."""
    state = session().state
    if not state.backend.ready:
        return "there is no backend"
    if state.task(INSTALL) or state.task(CHECK):
        return "the backend is being worked on"
    if not (source := source_of(model)):
        return "the file that it was imported from is not there"
    if cleaning_of(model).by_itself:
        return "some of the model is hidden"
    try:
        if _drawn_of_file(source) != drawn_of(cloud_of(model)):
            return "the model was edited"
    except PhysHDRError:
        return "the file that it was imported from cannot be read"
    return ""


def _drawn_of_file(source: str) -> str:
    return drawn_of_file(read_model(source))


def of_one_width(tasks: Sequence[Task]) -> list[list[Task]]:
    """The probes by their panoramas' width: the backend draws one width at a time."""
    widths = dict.fromkeys(task.width for task in tasks)
    return [[task for task in tasks if task.width == width] for width in widths]


def all_there(tasks: Sequence[Task]) -> bool:
    """Whether all probes' folders are whole."""
    try:
        return all(read_probe(_absolute(task.folder)) is not None for task in tasks)
    except PhysHDRError:
        return False


def _start(source: str, tasks: Sequence[Task]) -> None:
    """Let the backend draw probes of one width; raises ``OutputError``."""
    current = session()
    current.pump()
    places = [(task.at, str(_absolute(task.folder))) for task in tasks]
    command = current.backend_command(*panorama_command(source, tasks[0].width, places))
    current.start_task(LIGHT, command, current.home / "light.log", current.environment())


def _draw_all(source: str, after: After, tasks: Sequence[Task], left: Sequence[Sequence[Task]]) -> None:
    """Let the backend draw what is ``left`` of the probes, by width, and light the scene once all are there,
    unless another file has been opened by then."""
    beside = Path(bpy.data.filepath).parent
    _start(source, left[0])

    def take() -> bool:
        if session().state.problem is not None:
            return False
        there = [_from_here(task, beside) for task in tasks]
        drawn, *rest = [[_from_here(task, beside) for task in each] for each in left]
        if not all_there(drawn):
            ended = session().ended(LIGHT)
            if ended is not None and ended.ok and not ended.cancelled:
                lost = f"the light that was drawn is not in {_absolute(drawn[0].folder).parent} any more"
                session().dispatch(NotTaken(Problem(lost, "Use Light From Here again.")))
            return False
        try:
            if rest:
                _draw_all(source, after, there, rest)
                return False
            after.apply(there)
            session().dispatch(TaskMade(LIGHT, str(_absolute(there[0].folder))))
        except PhysHDRError as error:
            session().dispatch(NotTaken(Problem(error.message, error.hint)))
            return False
        return True

    take_when_ended(LIGHT, take, PHYSHDR_OT_light_from_here.bl_label)


def _from_here(task: Task, beside: Path) -> Task:
    """A task that was begun while the .blend was in the folder ``beside``: its probe is still drawn there."""
    here = Path(bpy.data.filepath).parent
    if here == beside or not task.folder.startswith("//"):
        return task
    return replace(task, folder=moved(task.folder, str(beside), str(here)))


def _of_uid(scene: bpy.types.Scene, uid: int) -> bpy.types.Object | None:
    """The scene's object of a ``session_uid``, whatever its name is by now; None where it is gone."""
    return next((each for each in scene.objects if each.session_uid == uid), None)


def _object(scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    found = scene.objects.get(name)
    if found is None:
        raise BadValueError(f"there is no object {name} in the scene")
    return found


def _place(vector: Any) -> probes.Place:
    x, y, z = vector
    return x, y, z


def _absolute(folder: str) -> Path:
    return Path(bpy.path.abspath(folder))


_CLASSES = (PHYSHDR_OT_light_from_here, PHYSHDR_OT_light_refresh, PHYSHDR_OT_light_reset)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
