# SPDX-License-Identifier: GPL-3.0-or-later
"""Drives a real Blender window: a test is a generator that yields how many seconds to let Blender live.

Run by tools/gui_test.py, inside Blender: ``blender -P tests/gui/panel.py -- --out FOLDER …``. Screenshots are
of the X server's root window (ImageMagick's ``import``): Blender's own come out black under Xvfb.
"""

import argparse
import importlib
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

#: Before the first redraw panels cannot be chosen.
SETTLE_SECONDS = 1.5
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

    def sharp(self) -> Iterator[float]:
        """``yield from``: until the live preview shows each view as it is now, at full size."""

        def is_sharp() -> bool:
            live = self.module("addon.runtime")._live
            schedules = live._schedules.values()
            return live._asked is None and all(
                schedule._last is not None and schedule._last[0].is_sharp for schedule in schedules
            )

        yield 0.5  # for the timer to see what has changed
        yield from self.until(is_sharp, 60, "sharp")
        yield from self.redrawn()

    def redrawn(self) -> Iterator[float]:
        """``yield from``: everything drawn anew; Blender does not see what scripts change."""
        for area in bpy.context.window_manager.windows[0].screen.areas:
            for region in area.regions:
                region.tag_redraw()
        yield 0.5

    def screenshot(self, name: str) -> Path:
        path = self.options.out / f"{name}.png"
        subprocess.run(["import", "-window", "root", str(path)], check=True)
        return path

    def open(self) -> Iterator[float]:
        """``yield from``: the extension installed, an empty scene, a large 3D view with the panel."""
        self.install()
        self.full_screen()
        yield 1.0
        self.show_tab()
        self.clear_scene()
        yield 0.5

    def install(self) -> None:
        """Install the zip as a user does."""
        bpy.ops.extensions.package_install_files(
            filepath=str(self.options.zip), repo="user_default", enable_on_install=True
        )

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

    def scroll_panel(self, pixels: int = 2000) -> None:
        """Show the lower end of the panel."""
        region = next(region for region in self.area.regions if region.type == "UI")
        window = bpy.context.window_manager.windows[0]
        with bpy.context.temp_override(window=window, area=self.area, region=region):
            for _ in range(0, pixels, 120):
                bpy.ops.view2d.scroll_down(deltay=120)

    def clear_scene(self) -> None:
        for target in list(bpy.data.objects):
            bpy.data.objects.remove(target)

    def look_through(self, transforms: Path, index: int) -> bpy.types.Object:
        """Put the data set's camera into the scene, and look through it."""
        pose = self.module("addon.camera_file").read_pose(transforms, index)
        render = self.module("addon.render")
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

    def settle(self, redraws: int = 4, seconds: float = 0.15) -> Iterator[float]:
        """``yield from``: so many redraws of the 3D view."""
        for _ in range(redraws):
            self.region.tag_redraw()
            yield seconds

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

    def resize_view(self, width: int, height: int) -> Iterator[float]:
        """``yield from``: make Blender's window such that the 3D view has so many pixels."""
        space = self.area.spaces.active
        space.show_region_ui = space.show_region_header = space.show_region_tool_header = False
        yield 0.5
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
        yield 1.5

    def until(self, done: Callable[[], bool], seconds: float, what: str) -> Iterator[float]:
        """``yield from window.until(…)``: let Blender live until ``done``; fails after ``seconds``."""
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                raise TimeoutError(f"not {what} within {seconds:g} s")
            yield 0.05


def drive(test: Callable[[Window], Iterator[float]]) -> None:
    """Run a test in this Blender and quit; ``OUT/result.txt`` then says ``passed`` or has the traceback."""
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    result = options.out / "result.txt"
    result.write_text("did not end\n")
    bpy.context.preferences.view.show_splash = False
    steps = test(Window(options))

    def step() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            result.write_text("passed\n")
        except BaseException:  # noqa: BLE001 (it is told, and the window must not stay open)
            result.write_text(traceback.format_exc())
            subprocess.run(["import", "-window", "root", str(options.out / "failed.png")], check=False)
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(step, first_interval=SETTLE_SECONDS, persistent=True)
