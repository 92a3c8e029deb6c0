# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for what a run is worth and what it shows: evaluate it, make a video or a web page of it.

All are the backend's work (``physhdr evaluate``, ``render``, ``export``), in a process of its own: one
keeps working beside it.
"""

import subprocess
import time
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import bpy

from ...bridge.errors import BadValueError, FileMissingError
from ...bridge.lights import AMBIENT
from ...bridge.run_folder import SHEET_FILE, WEB_FILE, WEB_FOLDER, WEB_INDEX, data_of, same_folder
from ...bridge.shots import write_shots
from .. import outside
from ..blender import layout_of
from ..capture import placement
from ..model import origin
from ..model.look import is_of_run
from ..paths import first_free, whole
from ..rendering.shots import shots_of
from ..runtime import session
from ..session.process import unseen
from ..session.results import (
    EVALUATE,
    VIDEO,
    WEB,
    VideoOptions,
    evaluate_command,
    evaluation_of,
    video_command,
    web_command,
    why_not_on_run,
)
from ..session.session import Session
from ..session.state import State
from .afterwards import take_when_ended
from .base import PhysHDROperator, choices, choose_named, follow_task, has_run, moved_data

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import PropertyFlagItems

GIVEN: "set[PropertyFlagItems]" = {"SKIP_SAVE"}
FOLDER: "set[PropertyFlagItems]" = {"SKIP_SAVE", "PATH_SUPPORTS_BLEND_RELATIVE"}
#: Seconds that scripts wait, and that the backend's Python has to say whether it can encode.
WAIT_SECONDS, ASK_SECONDS = 7 * 24 * 3600.0, 30.0
#: The frames of Blender's camera, for the backend to read, in Blender's folder for temporary files.
SHOTS_FILE = "physhdr_shots.json"
#: Suffixes by format; numbered pictures go into a folder.
SUFFIXES = {"MP4": ".mp4", "WEBP": ".webp", "PNG": ""}
PATHS = [
    ("CAMERA", "Scene's Camera", "The scene's camera and its keyframes, with those of exposure and levels"),
    ("SPLINE", "Past the Photographs", "Through the places from which the training pictures were taken"),
    ("ORBIT", "Around", "Round the middle of those places"),
    ("STILL", "Standing Still", "From a test picture's place, while exposure or light change"),
]
SWEEPS = [
    ("none", "Nothing", "Exposure and light stay"),
    ("exposure", "Exposure", "From the shortest exposure to the longest and back"),
    ("lighting", "Light", "The first light from an eighth to eight times and back"),
    ("both", "Both", "First the exposure, then the light"),
]
FORMATS = [
    ("MP4", "MP4", "H.264, which every player shows; the backend's Python needs the package av"),
    ("WEBP", "WebP", "An animated picture, which web pages loop; for short videos"),
    ("PNG", "Pictures", "Numbered PNG files, for any other program"),
]

#: Seconds by which a file system's clock may be behind ours.
CLOCK_SECONDS = 3.0

#: The video, or folder of pictures, that this Blender asked for last, by run. Of this session alone.
_made: dict[str, str] = {}
#: The web page that it asked for last, by run.
_pages: dict[str, str] = {}


def shown_run(context: bpy.types.Context, state: State) -> str:
    """The run that the panel is about: the chosen folder, else the one whose model is open; or empty."""
    chosen = choices(context).out
    if has_run(chosen):
        return chosen
    return state.job.run if state.job.has_model and has_run(state.job.run) else ""


def made_of(run: str) -> str:
    """The video of a run that was made last in this session, if it is there; or empty."""
    path = _made.get(run, "")
    return path if path and Path(path).exists() else ""


def page_of(run: str) -> str:
    """The web page of a run that was written last in this session, else the one in its folder; or empty."""
    paths = Path(_pages.get(run, "")), Path(run) / WEB_FILE, Path(run) / WEB_FOLDER / WEB_INDEX
    return next((str(path) for path in paths if path.is_file()), "")


class _OnRun(PhysHDROperator):
    """What is done with a run's folder: greyed, with the reason, while that is impossible."""

    task: ClassVar[str]
    if TYPE_CHECKING:
        run_folder: str
        wait: bool

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        reason = why_not_on_run(session().state, cls.task)
        if reason:
            cls.poll_message_set(reason)
        return not reason

    def chosen(self, context: bpy.types.Context) -> tuple[str, str]:
        """The run's folder, and its data set where that is elsewhere now (else empty). Raises errors."""
        choose_named(context)
        state = session().state
        chosen = whole(self.run_folder)
        run = chosen or shown_run(context, state)
        if chosen and not has_run(chosen):
            raise FileMissingError(f"there is no trained run in {chosen}", "Choose the folder of a run.")
        if reason := why_not_on_run(state, self.task, run):
            raise BadValueError(reason)
        return run, moved_data(run, choices(context).data)

    def follow(self, command: list[str], makes: Path, success: str) -> set[str]:
        """Start the backend's command, which ``makes`` that file or folder; in scripts, wait and report."""
        current = session()
        log = current.home / f"{self.task}.log"
        command = current.backend_command(*command)
        current.start_task(self.task, command, log, current.environment(), makes=str(makes))
        return follow_task(self, self.task, WAIT_SECONDS, success) if self.wait else {"FINISHED"}


class PHYSHDR_OT_results_evaluate(_OnRun):
    """Compare the run's pictures with photographs that training never saw: how good it is, and where not.
    It runs beside your work"""

    bl_idname = "physhdr.results_evaluate"
    bl_label = "Evaluate"
    task = EVALUATE

    run_folder: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options=FOLDER)
    lpips_weights: bpy.props.StringProperty(
        name="LPIPS Weights",
        subtype="FILE_PATH",
        options=FOLDER,
        description="An .npz of AlexNet and its linear heads, for LPIPS as well; empty: without",
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def run(self, context: bpy.types.Context) -> set[str]:
        session().pump()
        run, data = self.chosen(context)
        named = data_of(Path(run))
        if not data and named is not None and not outside.is_folder(named):
            raise FileMissingError(
                f"the run's data set is not there any more: {named}",
                "Choose in Data Set where it is now: an evaluation compares with its pictures.",
            )
        weights = whole(self.lpips_weights)
        command = evaluate_command(run, data, weights)
        done = self.follow(command, Path(run) / SHEET_FILE, f"Evaluated {run}")
        if done == {"FINISHED"} and self.wait and (found := evaluation_of(run)):
            for figure in found.figures:
                self.report({"INFO"}, f"{figure.what}: {figure.words} ({figure.numbers})")
        return done


class PHYSHDR_OT_results_video(_OnRun):
    """Make a video of the run, drawn by the backend: along the scene's camera with all keyframes, or along
    the photographs. It runs beside your work"""

    bl_idname = "physhdr.results_video"
    bl_label = "Make Video"
    task = VIDEO

    run_folder: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options={*FOLDER, "HIDDEN"})
    filepath: bpy.props.StringProperty(
        name="File",
        subtype="FILE_PATH",
        options=FOLDER,
        description="The video, or the folder for pictures; empty: in the run's folder",
    )
    format: bpy.props.EnumProperty(name="Format", items=FORMATS)
    path: bpy.props.EnumProperty(name="Camera", items=PATHS)
    sweep: bpy.props.EnumProperty(name="Change", items=SWEEPS)
    seconds: bpy.props.FloatProperty(name="Length", default=6.0, min=0.1, max=3600.0, subtype="TIME_ABSOLUTE")
    fps: bpy.props.IntProperty(name="Frames a Second", default=30, min=1, max=240)
    width: bpy.props.IntProperty(
        name="Width",
        min=0,
        max=20_000,
        subtype="PIXEL",
        description="Of the picture; 0: as the photographs, or with the scene's camera as a render",
    )
    exposure: bpy.props.FloatProperty(
        name="Exposure (s)",
        min=0.0,
        description="Seconds of the photograph that is shown, at EV 0; 0: the middle one of the data set",
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        is_set = self.properties.is_property_set
        if not is_set("format") and self.format == "MP4" and not encodes(session()):
            self.format = "WEBP"
        if not is_set("path") and self.path == "CAMERA" and context.scene.camera is None:
            self.path = "SPLINE"
        return context.window_manager.invoke_props_dialog(self, width=360, title="Video", confirm_text="Make")

    def draw(self, context: bpy.types.Context) -> None:
        column = layout_of(self).column()
        column.use_property_split = True
        names = ["path"]
        names += [] if self.path == "CAMERA" else ["sweep", "seconds", "fps"]
        for name in names:
            column.prop(self, name)
        size = "as rendered" if self.path == "CAMERA" else "as photos"
        column.prop(self, "width", text="Width" if self.width else f"Width (0: {size})")
        column.prop(self, "exposure", text="Exposure (s)" if self.exposure else "Exposure (0: middle)")
        for name in ("format", "filepath"):
            column.prop(self, name)

    def run(self, context: bpy.types.Context) -> set[str]:
        current = session()
        current.pump()
        run, data = self.chosen(context)
        if self.format == "MP4" and not encodes(current):
            python = current.state.backend.python
            raise BadValueError(
                "the backend's Python has no package av, which writes MP4",
                f"Choose WebP or Pictures; or add it: {python} -m pip install av",
            )
        out = self._out(run)
        options = self._options(context, run)
        command = video_command(run, str(out), options, data)
        done = self.follow(command, out, f"Wrote {out}")
        _made[run] = str(out)
        return done

    def _out(self, run: str) -> Path:
        suffix = SUFFIXES[self.format]
        if self.filepath:
            chosen = Path(whole(self.filepath))
            ending = chosen.suffix.lower()
            if ending == suffix:
                return chosen
            # Another format's ending is replaced; what else follows a dot belongs to the name.
            is_other = ending in SUFFIXES.values() and ending != ""
            return chosen.with_name(f"{chosen.stem if is_other else chosen.name}{suffix}")
        return first_free(Path(run) / f"video{suffix}", suffix)

    def _options(self, context: bpy.types.Context, run: str) -> VideoOptions:
        if self.path != "CAMERA":
            if self.path == "STILL" and self.sweep == "none":
                raise BadValueError("nothing moves", "Choose what changes while the camera stands still.")
            return VideoOptions(
                path=self.path.lower(),
                sweep=self.sweep,
                seconds=self.seconds,
                fps=self.fps,
                width=self.width,
                exposure=self.exposure,
            )
        current = session()
        job = current.state.job
        lights = job.lights if job.has_model and same_folder(job.run, run) else ()
        data = str(data_of(Path(run)) or "")
        window_manager = context.window_manager
        window_manager.progress_begin(0.0, 1.0)
        try:
            target = filmed(context, run, data)
            shots = shots_of(
                context,
                target,
                data,
                tuple(lights) or (AMBIENT,),
                show=lambda done, total: window_manager.progress_update(done / total),
            )
        finally:
            window_manager.progress_end()
        file = Path(bpy.app.tempdir) / SHOTS_FILE  # of this Blender alone: another one may film, too
        write_shots(file, shots)
        return VideoOptions(shots=str(file), width=self.width, exposure=self.exposure)


class PHYSHDR_OT_results_web(_OnRun):
    """Write the trained model as a web page that anybody can look at and relight in a browser, with nothing
    installed and no server, and open it"""

    bl_idname = "physhdr.results_web"
    bl_label = "Export Web Page"
    task = WEB

    run_folder: bpy.props.StringProperty(name="Run", subtype="DIR_PATH", options={*FOLDER, "HIDDEN"})
    single_file: bpy.props.BoolProperty(
        name="One File",
        default=True,
        description="One HTML file with everything in it, to send; off: a folder, for a web server",
    )
    filepath: bpy.props.StringProperty(
        name="File",
        subtype="FILE_PATH",
        options=FOLDER,
        description="The page, or its folder; empty: in the run's folder",
    )
    show: bpy.props.BoolProperty(
        name="Open in Browser", default=not bpy.app.background, description="Once it is written"
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        manager = context.window_manager
        return manager.invoke_props_dialog(self, width=360, title="Export Web Page", confirm_text="Export")

    def draw(self, context: bpy.types.Context) -> None:
        column = layout_of(self).column()
        column.use_property_split = True
        for name in ("single_file", "filepath", "show"):
            column.prop(self, name)

    def run(self, context: bpy.types.Context) -> set[str]:
        session().pump()
        run, data = self.chosen(context)
        out = self._out(run)
        page = out if self.single_file else out / WEB_INDEX
        begun = time.time() - CLOCK_SECONDS
        command = web_command(run, str(out), data, self.single_file)
        done = self.follow(command, page, f"Wrote {page}")
        _pages[run] = str(page)
        if self.show and done == {"FINISHED"}:

            def open_page() -> bool:
                if page.is_file() and page.stat().st_mtime >= begun:  # not where it failed
                    webbrowser.open(page.as_uri())
                return False

            if self.wait:
                open_page()
            else:
                take_when_ended(WEB, open_page, self.bl_label)
        return done

    def _out(self, run: str) -> Path:
        if not self.filepath:
            return Path(run).absolute() / (WEB_FILE if self.single_file else WEB_FOLDER)
        chosen = Path(whole(self.filepath))
        is_html = chosen.suffix.lower() in (".html", ".htm")
        if self.single_file:
            return chosen if is_html else chosen.with_name(f"{chosen.name}.html")
        return chosen.with_suffix("") if is_html else chosen


def filmed(context: bpy.types.Context, run: str, data: str) -> bpy.types.Object | None:
    """The imported model of a run whose look and place count: the active one if it is of this run, else the
    first of the scene; None where none is imported."""
    of_run = [each for each in context.scene.objects if is_of_run(each, run)]
    if context.object in of_run:
        return context.object
    if of_run:
        return of_run[0]
    return next(placement.models_of(context.scene, origin.key_of(data)), None) if data else None


_encoders: dict[str, bool] = {}


def encodes(current: Session) -> bool:
    """Whether the backend's Python can write MP4; asked of it once."""
    python = current.state.backend.python
    if python not in _encoders:
        try:
            asked = subprocess.run(
                [python, "-c", "import av"],
                env=current.environment(),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=ASK_SECONDS,
                check=False,
                **unseen(),
            )
        except (OSError, subprocess.TimeoutExpired):
            return False
        if asked.returncode:  # it may be installed at any time
            return False
        _encoders[python] = True
    return True


_CLASSES = (PHYSHDR_OT_results_evaluate, PHYSHDR_OT_results_video, PHYSHDR_OT_results_web)
register, unregister = bpy.utils.register_classes_factory(_CLASSES)
