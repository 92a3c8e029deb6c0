# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for data sets: render one from the open scene, look at one.

The rendering is another Blender's (synth/make_scene.py on a copy of the file as it is now, unsaved changes
included), so this one is neither blocked nor changed, and what fails there fails alone.
"""

import math
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import bpy

from ...bridge.data_set import INFO_FILE
from ...bridge.errors import BadValueError, OutputError, PhysHDRError
from ..blender import layout_of
from ..dataset_summary import summarise
from ..paths import ROOT
from ..runtime import session
from ..session.state import DATASET
from ..settings import RELATIVE
from .base import PhysHDROperator

SCRIPT = ROOT / "synth" / "make_scene.py"
#: Seconds that scripts wait for a data set.
RENDER_SECONDS = 30 * 24 * 3600.0
MOST_EXPOSURES = 64
LOOK_SECONDS = 0.5
AUTOMATIC = {
    "rig_distance": "Distance",
    "rig_width": "Grid Width",
    "rig_height": "Grid Height",
    "resolution_y": "Height",
}

RIGS = [
    ("GRID", "Grid", "A flat grid around your camera, facing the scene"),
    ("ORBIT", "Orbit", "On an arc around what your camera looks at, at its height"),
    ("HEMISPHERE", "Hemisphere", "On a part of a sphere around what your camera looks at"),
    ("PATH", "Camera Animation", "Along your camera's own animation; all else stands still"),
]
RESPONSES = [
    ("reinhard-gamma", "Reinhard, Gamma", "The camera of HDR-NeRF's synthetic data"),
    ("srgb", "sRGB", "Clipped at white"),
    ("filmic", "Filmic", "Blender's Filmic, medium contrast"),
    ("file", "From a File", "A measured curve: pairs of exposure × radiance and code value"),
]
DEVICES = [
    ("CPU", "Processor", "The processor: the same seed gives the same bytes on any machine of its kind"),
    ("GPU", "Graphics Card", "The card that is chosen in Preferences > System, else the first that works"),
]


class PHYSHDR_OT_dataset_render(PhysHDROperator):
    """Render an HDR data set of this scene from a rig of cameras around its camera. Nothing in the file is
    changed, and what was rendered before with the same settings into the same folder is kept"""

    bl_idname = "physhdr.dataset_render"
    bl_label = "Render Data Set"
    action = "render"

    out: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", options=RELATIVE, description="A new folder, or one to go on with"
    )
    rig: bpy.props.EnumProperty(name="Cameras", items=RIGS)
    views: bpy.props.IntProperty(
        name="Views",
        default=35,
        min=2,
        max=10_000,
        description="Every second one is for training, the others for testing",
    )
    rig_distance: bpy.props.FloatProperty(
        name="Distance",
        min=0.0,
        subtype="DISTANCE",
        description="From your camera to what the rig looks at; 0: its focus, else what it sees",
    )
    rig_width: bpy.props.FloatProperty(
        name="Grid Width", min=0.0, subtype="DISTANCE", description="0: half the distance"
    )
    rig_height: bpy.props.FloatProperty(
        name="Grid Height", min=0.0, subtype="DISTANCE", description="0: three tenths of the distance"
    )
    rig_arc: bpy.props.FloatProperty(
        name="Arc",
        default=math.radians(90.0),
        min=math.radians(0.1),
        max=math.tau,
        subtype="ANGLE",
        description="Azimuth of orbit and hemisphere, your camera in its middle",
    )
    exposures: bpy.props.StringProperty(
        name="Exposures (EV)",
        default="-3 -1 1 3 5",
        description="A list such as '-3 -1 1 3 5', or start:step:count such as '-3:2:5'; EV 0 is 1 second",
    )
    response: bpy.props.EnumProperty(name="Camera Response", items=RESPONSES)
    response_file: bpy.props.StringProperty(
        name="Curve",
        subtype="FILE_PATH",
        options=RELATIVE,
        description="JSON or text of the response, where it is a file's",
    )
    resolution_x: bpy.props.IntProperty(name="Width", default=400, min=8, max=8192, subtype="PIXEL")
    resolution_y: bpy.props.IntProperty(
        name="Height",
        min=0,
        max=8192,
        subtype="PIXEL",
        description="0: as the scene's render resolution says",
    )
    samples: bpy.props.IntProperty(name="Samples", default=64, min=1, max=2**20)
    denoise: bpy.props.BoolProperty(name="Denoise", default=True, description="With OpenImageDenoise")
    seed: bpy.props.IntProperty(name="Seed", min=0, description="Of the noise")
    device: bpy.props.EnumProperty(name="Device", items=DEVICES)
    lit_views: bpy.props.IntProperty(
        name="Views Under Other Light",
        default=12,
        min=0,
        max=10_000,
        description="Further training views at other levels of the ambient light (world and suns)",
    )
    lit_levels: bpy.props.StringProperty(
        name="Their Levels", default="0.25 4", description="Factors on the ambient light"
    )
    relit_views: bpy.props.IntProperty(
        name="Relit Test Views",
        default=4,
        min=0,
        max=5000,
        description="Test views that are rendered at each level too, to measure relighting",
    )
    ambient_levels: bpy.props.StringProperty(
        name="At Levels", default="0.125 0.5 2 8", description="Factors on the ambient light"
    )
    wait: bpy.props.BoolProperty(default=bpy.app.background, options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.camera is None:
            cls.poll_message_set("Add a camera to the scene first: the views are taken around it")
            return False
        return super().poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.out and bpy.data.filepath:
            self.out = f"//{Path(bpy.data.filepath).stem}_dataset"
        return context.window_manager.invoke_props_dialog(self, width=440, confirm_text="Render")

    def draw(self, context: bpy.types.Context) -> None:
        layout = layout_of(self)
        layout.use_property_split = True
        layout.prop(self, "out")
        rig = layout.column(align=True)
        for name in ("rig", "views", *_rig_options(self.rig)):
            rig.prop(self, name, **_auto(self, name))
        camera = layout.column(align=True)
        file = ("response_file",) if self.response == "file" else ()
        for name in ("exposures", "response", *file, "resolution_x", "resolution_y"):
            camera.prop(self, name, **_auto(self, name))
        cycles = layout.column(align=True)
        for name in ("samples", "denoise", "seed", "device"):
            cycles.prop(self, name)
        light = layout.column(align=True)
        for name in ("lit_views", "lit_levels", "relit_views", "ambient_levels"):
            light.prop(self, name)

    def run(self, context: bpy.types.Context) -> set[str]:
        session().pump()  # a task before this one may have ended since the last time
        out = _folder(self.out)
        arguments = self._arguments(out, context.scene)
        with _copy_of_file() as copy:
            if bpy.app.module:  # the wheel: there is no Blender to start
                command = [sys.executable, str(SCRIPT), "--", "--from-file", str(copy)]
            else:
                command = [bpy.app.binary_path, "-b", str(copy), "-P", str(SCRIPT), "--"]
                command += ["--from-file", "current"]
            current = session()
            current.start_task(DATASET, [*command, *arguments], current.home / "dataset.log")
        if not self.wait:
            _choose_when_done(context.scene.name, out)
            return {"FINISHED"}
        try:
            current.wait(lambda state: state.task(DATASET) is None, RENDER_SECONDS)
        except KeyboardInterrupt:
            current.cancel_task(DATASET)
            raise
        finally:
            _remove_copies()
        problem = current.state.problem
        if problem or not (out / INFO_FILE).is_file():
            told = (problem.message, problem.hint) if problem else ("the rendering was cancelled",)
            self.report({"ERROR"}, ": ".join(filter(None, told)))
            return {"CANCELLED"}
        context.scene.physhdr.data = str(out)
        self.report({"INFO"}, summarise(out).lines[0])
        return {"FINISHED"}

    def _arguments(self, out: Path, scene: bpy.types.Scene) -> list[str]:
        """The options of synth/make_scene.py; it checks what is not checked here."""
        response = bpy.path.abspath(self.response_file) if self.response == "file" else self.response
        if not response:
            raise BadValueError("no file of the camera's response is chosen", "Choose one under Curve.")
        size = f"{self.resolution_x}x{self.resolution_y}" if self.resolution_y else str(self.resolution_x)
        given = {
            "out": out,
            "scene-name": scene.name,
            "camera-rig": self.rig.lower(),
            "views": self.views,
            "exposures": ",".join(repr(2.0**ev) for ev in parse_evs(self.exposures)),
            "crf": response,
            "resolution": size,
            "samples": self.samples,
            "seed": self.seed,
            "device": self.device,
            "lit-views": self.lit_views,
            "lit-levels": self.lit_levels,
            "relit-views": min(self.relit_views, self.views // 2),
            "ambient-levels": self.ambient_levels,
        }
        if self.rig != "PATH" and self.rig_distance:
            given["rig-distance"] = self.rig_distance
        if self.rig == "GRID" and (self.rig_width or self.rig_height):
            if not (self.rig_width and self.rig_height):
                raise BadValueError("the grid has only one side", "Give both its width and its height.")
            given["rig-extent"] = f"{self.rig_width}x{self.rig_height}"
        if self.rig in {"ORBIT", "HEMISPHERE"}:
            given["rig-arc"] = round(math.degrees(self.rig_arc), 4)
        denoise = "--denoise" if self.denoise else "--no-denoise"
        return [*(f"--{name}={value}" for name, value in given.items()), denoise, "--progress-json"]


def _auto(operator: PHYSHDR_OT_dataset_render, name: str) -> dict[str, Any]:
    """The text of a setting whose 0 means that it is found by itself; it says so while it is 0."""
    if name not in AUTOMATIC or getattr(operator, name):
        return {}
    return {"text": f"{AUTOMATIC[name]} (0: automatic)"}


def _choose_when_done(name: str, out: Path) -> None:
    """Choose the data set for training once it is complete, unless another file has been opened by then.

    Blender removes the timer when a file is opened. Saving this one, by whatever name, changes nothing.
    """

    def look() -> float | None:
        if not hasattr(bpy.types.Scene, "physhdr"):
            return None
        if session().state.task(DATASET):
            return LOOK_SECONDS
        scene = bpy.data.scenes.get(name)
        if scene and (out / INFO_FILE).is_file():
            scene.physhdr.data = str(out)
        return None

    bpy.app.timers.register(look, first_interval=LOOK_SECONDS)


def _rig_options(rig: str) -> tuple[str, ...]:
    """The settings that a rig knows, beside the number of views."""
    return {
        "GRID": ("rig_distance", "rig_width", "rig_height"),
        "ORBIT": ("rig_distance", "rig_arc"),
        "HEMISPHERE": ("rig_distance", "rig_arc"),
        "PATH": (),
    }[rig]


def parse_evs(text: str) -> list[float]:
    """``"-3 -1 1"`` or ``"-3:2:3"`` (start, step, count) → [-3.0, -1.0, 1.0].

    Raises ``BadValueError``.
    """
    remedy = "Write a rising list such as -3 -1 1 3 5, or start:step:count such as -3:2:5."
    try:
        if ":" in text:
            start, step, count = (float(part) for part in text.split(":"))
            if not (step > 0.0 and count == int(count) and 1 <= count <= MOST_EXPOSURES):
                raise ValueError
            return [start + step * k for k in range(int(count))]
        evs = [float(part) for part in text.replace(",", " ").split()]
    except (ValueError, OverflowError) as error:
        raise BadValueError(f"the exposures {text!r} are not understood", remedy) from error
    rising = all(a < b for a, b in pairwise(evs))
    if not evs or len(evs) > MOST_EXPOSURES or not rising or not all(-19 < ev < 19 for ev in evs):
        raise BadValueError(f"the exposures {text!r} are no rising list of EV within ±19", remedy)
    return evs


def _folder(given: str) -> Path:
    if not given.strip():
        raise BadValueError("no folder is chosen for the data set", "Choose a new or empty one.")
    if given.startswith("//") and not bpy.data.filepath:
        raise BadValueError(
            f"{given} is relative to a file that is not saved yet", "Save it, or choose a whole path."
        )
    return Path(bpy.path.abspath(given)).absolute()


def _copies() -> Path:
    """Blender's own folder for this session's temporary files, which it removes itself when it ends."""
    return Path(bpy.app.tempdir) / "physhdr_dataset"


def _remove_copies() -> None:
    shutil.rmtree(_copies(), ignore_errors=True)


@contextmanager
def _copy_of_file() -> Iterator[Path]:
    """The file as it is in memory, saved elsewhere; the open one stays as it is, saved or not.

    The copy outlives the context unless it failed: the other Blender may still be reading it. There is one
    data set at a time, so the next one removes it. Paths in it are made to fit its place.
    """
    _remove_copies()
    copy = _copies() / f"{Path(bpy.data.filepath).stem or 'untitled'}.blend"
    paths = bpy.context.preferences.filepaths
    preview = paths.file_preview_type
    try:
        copy.parent.mkdir(parents=True, exist_ok=True)
        paths.file_preview_type = "NONE"  # a preview is a picture of the window: slow, and of no use here
        bpy.ops.wm.save_as_mainfile(
            filepath=str(copy), copy=True, compress=False, check_existing=False, relative_remap=True
        )
        yield copy
    except (OSError, RuntimeError) as error:
        _remove_copies()
        raise OutputError(
            f"no copy of this file can be saved in {copy.parent}: {error}", "Is the disk full?"
        ) from error
    except PhysHDRError:
        _remove_copies()
        raise
    finally:
        paths.file_preview_type = preview


class PHYSHDR_OT_dataset_check(bpy.types.Operator):
    """Look whether a folder is a data set, and tell what it holds and what is wrong with it"""

    bl_idname = "physhdr.dataset_check"
    bl_label = "Check Data Set"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    folder: bpy.props.StringProperty(name="Data Set", subtype="DIR_PATH", options=RELATIVE)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            summary = summarise(_folder(self.folder))
        except PhysHDRError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for line in summary.lines:
            self.report({"INFO"}, line)
        for warning in summary.warnings:
            self.report({"WARNING"}, warning)
        return {"FINISHED"}


_CLASSES = (PHYSHDR_OT_dataset_render, PHYSHDR_OT_dataset_check)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
