# SPDX-License-Identifier: GPL-3.0-or-later
"""Drives a real Blender window: a test is a generator that yields how many seconds to let Blender live.

Run by tools/gui_test.py, inside Blender: ``blender -P tests/gui/panel.py -- --out FOLDER …``. Screenshots are
of the X server's root window (ImageMagick's ``import``): Blender's own come out black under Xvfb.
"""

import argparse
import importlib
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from gui_inside import Patience, slowness

__all__ = ["EXTENSION", "SHADINGS", "Patience", "Window", "arguments", "drive", "slowness"]

#: Before its window is there Blender draws nothing.
SETTLE_SECONDS = 0.5
#: Between looks whether what is waited for has happened.
LOOK_SECONDS = 0.03
#: After a redraw: what Blender has drawn is on its way to the X server.
FLUSH_SECONDS = 0.1
#: A box that opens or closes changes at least this share of the screen.
POP_UP = 0.01
#: Shading, engine, redraws until EEVEE's shaders are compiled or Cycles is done.
SHADINGS = (
    ("SOLID", "BLENDER_EEVEE", 4),
    ("MATERIAL", "BLENDER_EEVEE", 14),
    ("RENDERED", "BLENDER_EEVEE", 14),
    ("RENDERED", "CYCLES", 24),
)
EXTENSION = "bl_ext.user_default.physhdr"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True, help="where screenshots go")
    parser.add_argument("--zip", type=Path, required=True, help="the extension")
    parser.add_argument("--python", type=Path, required=True, help="a Python with torch")
    parser.add_argument("--data", type=Path, required=True, help="a data set")
    parser.add_argument("--model", type=Path, required=True, help="a trained model file, in its run's folder")
    return parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])


class Window:
    """What a test sees and does."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        #: How often 3D views were drawn.
        self._drawn = 0
        self._panels: list[type] = []
        bpy.types.SpaceView3D.draw_handler_add(self._count, (), "WINDOW", "POST_PIXEL")

    def _count(self) -> None:
        self._drawn += 1

    @property
    def area(self) -> bpy.types.Area:
        """The largest 3D view."""
        areas = [
            area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D"
        ]
        return max(areas, key=lambda area: area.width * area.height)

    @property
    def region(self) -> bpy.types.Region:
        return next(region for region in self.area.regions if region.type == "WINDOW")

    def override(self) -> "bpy.types.ContextTempOverride":
        """The context of the 3D view, for operators that want one."""
        window = bpy.context.window_manager.windows[0]
        return bpy.context.temp_override(window=window, area=self.area, region=self.region)

    def module(self, name: str):
        """A module of the installed extension."""
        return importlib.import_module(f"{EXTENSION}.{name}")

    @property
    def session(self):
        """The extension's session."""
        return self.module("addon.runtime").session()

    def sharp(self) -> Iterator[float]:
        """``yield from``: until the live preview shows each view as it is now, at full size."""
        live, module = self.module("addon.runtime")._live, self.module("addon.viewport.live")

        first: dict[int, int] = {}

        def is_sharp() -> bool:
            if live._late:
                return False
            for region in module._regions(self.session.state.job):
                schedule = live._schedules.get(region.key)
                last = schedule._last[0] if schedule and schedule._last else None
                if last is None or not last.is_sharp or schedule._last_held != region.view.held:
                    first.pop(region.key, None)
                    return False
                # While a model trains, a busy machine always has the next picture of a view under way.
                number = first.setdefault(region.key, last.number)
                if schedule._outstanding is not None and schedule._outstanding[0].number <= number:
                    return False
            return bool(live._schedules)

        yield from self.redrawn()
        yield from self.until(is_sharp, 60, "sharp")
        yield from self.redrawn()

    def drawn(self) -> Iterator[float]:
        """``yield from``: until the shader's pictures of all models are as good as they get."""
        views = self.module("addon.viewport.splats")._runtime.views

        def is_sharp() -> bool:
            return bool(views) and all(view.is_sharp for view in views.values())

        yield from self.redrawn()
        yield from self.until(is_sharp, 60, "sharp")
        yield from self.redrawn()

    def redrawn(self, times: int = 2) -> Iterator[float]:
        """``yield from``: all drawn anew so often; Blender does not see what scripts change.

        What is asked for at once is drawn at once: the 3D view tells for its sidebar, too.
        """
        wanted = self._drawn + times

        def is_drawn() -> bool:
            if self._drawn >= wanted:
                return True
            for area in bpy.context.window_manager.windows[0].screen.areas:
                for region in area.regions:
                    region.tag_redraw()
            return False

        yield from self.until(is_drawn, 60, "redrawn")
        yield FLUSH_SECONDS

    def still(self) -> Iterator[float]:
        """``yield from``: until the screen does not change any more: boxes are open, pictures done."""
        last: bytes | None = None

        def is_still() -> bool:
            nonlocal last
            before, last = last, self.grab()
            return before == last

        yield from self.until(is_still, 60, "still")

    def pops_up(self, invoke: Callable[[], object]) -> Iterator[float]:
        """``yield from``: what ``invoke`` opens over the window is there."""
        yield from self.redrawn()
        before = self.grab()
        with self.override():
            invoke()
        yield from self.until(lambda: self.changed(before) > POP_UP, 60, "opened")
        yield from self.still()

    def closes(self, before: bytes) -> Iterator[float]:
        """``yield from``: the screen differs from ``before`` as much as by a box that has gone."""
        yield from self.until(lambda: self.changed(before) > POP_UP, 60, "closed")
        yield from self.still()

    def changed(self, before: bytes) -> float:
        """The share of the screen's bytes that are others than ``before``."""
        now = self.grab()
        if len(now) != len(before):
            return 1.0
        return float(np.mean(np.frombuffer(now, np.uint8) != np.frombuffer(before, np.uint8)))

    def grab(self) -> bytes:
        """The screen's pixels, as they come."""
        command = ["import", "-silent", "-window", "root", "-depth", "8", "rgb:-"]
        return subprocess.run(command, check=True, capture_output=True).stdout

    def grab_pixels(self) -> np.ndarray:
        """``[H, W, 3]`` 8-bit codes of the screen, top row first."""
        window = bpy.context.window_manager.windows[0]
        return np.frombuffer(self.grab(), np.uint8).reshape(-1, window.width, 3)

    def key(self, name: str) -> None:
        """Press a key, wherever the mouse is."""
        subprocess.run(["xdotool", "key", name], check=True)

    def point(self, x: float, y: float) -> Iterator[float]:
        """``yield from``: the mouse at a share of the 3D view, and Blender knows."""
        left, top = self.on_screen(self.region.width * x, self.region.height * y)
        subprocess.run(["xdotool", "mousemove", "--sync", str(left), str(top)], check=True)
        yield from self.redrawn()

    def screenshot(self, name: str) -> Path:
        path = self.options.out / f"{name}.png"
        subprocess.run(["import", "-window", "root", str(path)], check=True)
        return path

    def open(self) -> Iterator[float]:
        """``yield from``: the extension there, an empty scene, a large 3D view with the panel."""
        yield from self.redrawn(1)
        self.install()
        self.full_screen()
        yield from self.redrawn()
        self.show_tab()
        self.clear_scene()
        yield from self.redrawn()

    def install(self) -> None:
        """Turn the extension on; ``prepare.py`` has installed it as a user does."""
        bpy.ops.preferences.addon_enable(module=EXTENSION)

    def full_screen(self) -> None:
        """Nothing but the 3D view, with its sidebar."""
        with self.override():
            bpy.ops.screen.screen_full_area(use_hide_panels=False)
        space = self.area.spaces.active
        space.show_region_ui = True
        space.show_region_toolbar = False
        # The floor's grid is in front of what lies below it, as it should be, and a nuisance in pictures.
        space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False

    def show_tab(self, name: str = "PhysHDR") -> None:
        next(region for region in self.area.regions if region.type == "UI").active_panel_category = name

    def show_panels(self, *names: str) -> Iterator[float]:
        """``yield from``: below the top only these panels, open; none: all, as they are by themselves."""
        self._register_panels(*names)
        yield from self.redrawn()

    def _register_panels(self, *names: str) -> None:
        for cls in reversed(self._parts()):
            if cls.is_registered:
                bpy.utils.unregister_class(cls)
        for cls in self._parts():
            name = cls.__name__.removeprefix("PHYSHDR_PT_")
            if not names or name in names:
                options, usual = getattr(cls, "bl_options", set()), cls.__dict__.get("bl_idname")
                if names and "DEFAULT_CLOSED" in options:
                    # Blender remembers by its name that a panel is folded.
                    cls.bl_options, cls.bl_idname = options - {"DEFAULT_CLOSED"}, f"{cls.__name__}_open"
                bpy.utils.register_class(cls)
                if names and "DEFAULT_CLOSED" in options:
                    cls.bl_options = options
                    if usual is None:
                        del cls.bl_idname
                    else:
                        cls.bl_idname = usual

    def _parts(self) -> list[type]:
        """The classes of the sidebar's panels but for the top one, each after the one that it is in."""
        if not self._panels:
            known = [cls for cls in bpy.types.Panel.__subclasses__() if cls.__module__.startswith(EXTENSION)]
            known = [cls for cls in known if cls.is_registered and cls.bl_space_type == "VIEW_3D"]
            depth = ("", "PHYSHDR_PT_model", "PHYSHDR_PT_cleaning").index
            self._panels = sorted(known, key=lambda cls: depth(getattr(cls, "bl_parent_id", "")))
            self._panels = [cls for cls in self._panels if cls.__name__ != "PHYSHDR_PT_status"]
        return self._panels

    def clear_scene(self) -> None:
        for target in list(bpy.data.objects):
            bpy.data.objects.remove(target)

    def look_through(self, transforms: Path, index: int) -> bpy.types.Object:
        """Put the data set's camera into the scene, and look through it."""
        pose = self.module("addon.layouts.cameras").read_pose(transforms, index)
        render = self.module("addon.rendering.render")
        camera = render.add_camera(bpy.context.scene, pose.camera_to_world, pose.angle_x)
        render.set_resolution(bpy.context.scene, 400, 400)
        self.area.spaces.active.region_3d.view_perspective = "CAMERA"
        return camera

    def add_objects(self) -> None:
        """A ball nearer than everything in the demo's room, a post among its furniture, a sun."""
        material = bpy.data.materials.new("orange")
        material.diffuse_color = (0.9, 0.3, 0.05, 1.0)
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.9, 0.3, 0.05, 1.0)
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.12, location=(-0.45, -0.9, 1.6))
        bpy.ops.object.shade_smooth()
        bpy.context.object.data.materials.append(material)
        bpy.ops.mesh.primitive_cylinder_add(radius=0.12, depth=3.0, location=(0.35, 1.4, 0.6))
        bpy.context.object.data.materials.append(material)
        bpy.ops.object.light_add(type="SUN", rotation=(0.9, 0.2, 0.3))
        bpy.ops.object.select_all(action="DESELECT")

    def shade(self, shading: str, engine: str = "BLENDER_EEVEE") -> None:
        bpy.context.scene.render.engine = engine
        if engine == "CYCLES":
            bpy.context.scene.cycles.preview_samples = 4
            bpy.context.scene.cycles.use_preview_denoising = False
        self.area.spaces.active.shading.type = shading

    def pixels(self, name: str) -> np.ndarray:
        """``[H, W, 3]`` 8-bit codes of a screenshot, top row first."""
        image = bpy.data.images.load(str(self.options.out / f"{name}.png"))
        image.colorspace_settings.name = "Non-Color"
        values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
        image.pixels.foreach_get(values)
        width, height = image.size
        bpy.data.images.remove(image)
        return np.rint(255.0 * values.reshape(height, width, 4)[::-1, :, :3]).astype(int)

    def on_screen(self, x: float, y: float) -> tuple[int, int]:
        """Column and row in a screenshot of a pixel of the 3D view, from its top left."""
        height = bpy.context.window_manager.windows[0].height
        return round(self.region.x + x), round(height - (self.region.y + self.region.height) + y)

    def shaded(self, shading: str, engine: str, redraws: int) -> Iterator[float]:
        """``yield from``: the 3D view so shaded, its shaders compiled and its samples taken."""
        self.shade(shading, engine)
        yield from self.redrawn(redraws)
        yield from self.still()

    def checked(self) -> Iterator[float]:
        """``yield from``: the backend's check, here and now."""
        bpy.ops.physhdr.backend_use(filepath=str(self.options.python))
        yield from self.until(lambda: not self.session.state.tasks, 300, "checked")
        assert self.session.state.backend.ready, self.session.state.backend

    def forget_backend(self) -> None:
        """As if none had been checked yet."""
        self.session.dispatch(self.module("addon.session.state").PythonChosen(""))

    def shut_down(self) -> Iterator[float]:
        """``yield from``: the backend has ended, and with it what it trained."""
        link = self.session.state.link
        if link.status == "off":
            return
        pid = link.pid or (link.welcome.pid if link.welcome else 0)
        bpy.ops.physhdr.backend_shutdown()
        alive = self.module("addon.session.process").is_alive
        yield from self.until(lambda: self.session.state.link.status == "off", 30, "shut down")
        yield from self.until(lambda: not pid or not alive(pid), 30, "gone")

    def end(self) -> Iterator[float]:
        """``yield from``: nothing that this Blender has begun is under way any more, and it never warned."""
        if self._panels and is_enabled():
            self._register_panels()
        assert not bpy.app.autoexec_fail, f"a security warning was provoked: {bpy.app.autoexec_fail_message}"
        if not is_enabled():
            return
        for task in self.session.state.tasks:
            self.session.cancel_task(task.name)
        yield from self.until(lambda: not self.session.state.tasks, 60, "cancelled")
        if self.session.state.link.status in ("starting", "connecting"):
            settled = ("off", "connected")
            yield from self.until(lambda: self.session.state.link.status in settled, 90, "started")
        yield from self.shut_down()

    def resize_view(self, width: int, height: int) -> Iterator[float]:
        """``yield from``: make Blender's window such that the 3D view has so many pixels."""
        space = self.area.spaces.active
        space.show_region_ui = space.show_region_header = space.show_region_tool_header = False
        yield from self.redrawn()
        window = bpy.context.window_manager.windows[0]
        wanted = window.width - self.region.width + width, window.height - self.region.height + height
        found = subprocess.run(
            ["xdotool", "search", "--onlyvisible", "--name", "Blender"],
            capture_output=True,
            text=True,
            check=True,
        )
        for identifier in found.stdout.split():
            subprocess.run(["xdotool", "windowsize", identifier, *map(str, wanted)], check=True)
        is_so = lambda: (self.region.width, self.region.height) == (width, height)  # noqa: E731
        yield from self.until(is_so, 30, f"of {width} × {height} pixels")
        yield from self.redrawn()

    def until(self, done: Callable[[], bool], seconds: float, what: str) -> Iterator[float]:
        """``yield from window.until(…)``: let Blender live until ``done``; fails where for ``seconds``
        neither that nor any step of the work under way was made.

        They are seconds of an idle machine: where others run, it takes longer.
        """
        patience, before = Patience(seconds), self._progress()
        while not done():
            if (now := self._progress()) != before:
                patience, before = Patience(seconds), now
            if patience.is_over:
                raise TimeoutError(f"not {what} within {seconds:g} s of an idle machine")
            yield LOOK_SECONDS

    def _progress(self) -> object:
        """Another value after each step that training or a task reports."""
        if not is_enabled():
            return None
        state = self.session.state
        tasks = [(task.name, task.fraction, task.message) for task in state.tasks]
        return state.job.iteration, state.job.message, tasks


def is_enabled() -> bool:
    return EXTENSION in bpy.context.preferences.addons


def drive(test: Callable[[Window], Iterator[float]]) -> None:
    """Run a test in this Blender and quit; ``OUT/result.txt`` then says ``passed`` or has the traceback."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    result = options.out / "result.txt"
    result.write_text("did not end\n")
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.smooth_view = 0  # a view that is set is there at once
    window = Window(options)
    told: list[str] = []

    def whole() -> Iterator[float]:
        """The test, and its end, however it ends."""
        for steps in (test, Window.end):
            try:
                yield from steps(window)
            except BaseException:  # noqa: BLE001 (it is told, and the window must not stay open)
                picture = options.out / f"failed{len(told) or ''}.png"
                subprocess.run(["import", "-window", "root", str(picture)], check=False)
                told.append(traceback.format_exc())

    steps = whole()

    def step() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            result.write_text("\n".join(told) or "passed\n")
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(step, first_interval=SETTLE_SECONDS, persistent=True)
