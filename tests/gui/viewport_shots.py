# SPDX-License-Identifier: GPL-3.0-or-later
"""Screenshots of Gaussians in a real Blender window: shader and overlay, shadings, depth, relighting.

    blender --factory-startup -P tests/gui/viewport_shots.py -- \\
        --model model.safetensors --cameras transforms_test.json --out FOLDER

Needs a display (Xvfb will do) and ImageMagick's ``import``. Numbers that a picture cannot show go to
``DIR/report.json``: colours against planes of the same emission, and how long redraws took.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils
import numpy as np

ROOT = Path(__file__).resolve().parent.parent.parent
#: Radiance of the colour test's patches.
PATCHES = (0.18, 1.0, 8.0)


def load_package() -> None:
    """Make the repository importable as ``physhdr`` where it is not installed."""
    import importlib.util

    # What the extension bundles; pure Python, so a wheel can be imported from as it is.
    sys.path += [str(wheel) for wheel in (ROOT / "wheels").glob("*.whl")]
    spec = importlib.util.spec_from_file_location(
        "physhdr", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["physhdr"] = module
    spec.loader.exec_module(module)


class Window:
    """The window's 3D view, and screenshots of it."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.report: dict[str, object] = {}
        window = bpy.context.window_manager.windows[0]
        self.area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
        self.region = next(region for region in self.area.regions if region.type == "WINDOW")
        self.space = self.area.spaces.active

    @property
    def rv3d(self) -> bpy.types.RegionView3D:
        return self.region.data

    def shot(self, name: str) -> None:
        subprocess.run(["import", "-window", "root", str(self.out / f"{name}.png")], check=True)

    def settle(self, redraws: int = 4, seconds: float = 0.15) -> Iterator[float]:
        for _ in range(redraws):
            self.region.tag_redraw()
            yield seconds

    def sharpen(self, most: float = 20.0) -> Iterator[float]:
        """Redraw until every picture of splats is sharp."""
        from physhdr.addon.viewport import splats

        start = time.perf_counter()
        yield from self.settle(2, 0.05)
        while not all(view.is_sharp for view in splats._runtime.views.values()):
            if time.perf_counter() - start > most:
                raise RuntimeError(f"the splats are not sharp after {most} s")
            yield 0.05
        self.report.setdefault("seconds until sharp", []).append(round(time.perf_counter() - start, 2))
        yield 0.2

    def pixels(self, name: str) -> np.ndarray:
        """``[H, W, 3]`` 8-bit values of a screenshot, top row first."""
        image = bpy.data.images.load(str(self.out / f"{name}.png"))
        image.colorspace_settings.name = "Non-Color"
        values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
        image.pixels.foreach_get(values)
        width, height = image.size
        bpy.data.images.remove(image)
        return np.rint(255.0 * values.reshape(height, width, 4)[::-1, :, :3]).astype(int)

    def on_screen(self, x: float, y: float) -> tuple[int, int]:
        """Column and row in a screenshot of a pixel of the region (from its top left)."""
        height = bpy.context.window_manager.windows[0].height
        return round(self.region.x + x), round(height - (self.region.y + self.region.height) + y)

    def shade(self, shading: str, engine: str = "BLENDER_EEVEE") -> None:
        bpy.context.scene.render.engine = engine
        if engine == "CYCLES":
            bpy.context.scene.cycles.preview_samples = 4
            bpy.context.scene.cycles.use_preview_denoising = False
        self.space.shading.type = shading


#: Shading, engine, redraws until EEVEE's shaders are compiled or Cycles is done.
SHADINGS = (
    ("SOLID", "BLENDER_EEVEE", 4),
    ("MATERIAL", "BLENDER_EEVEE", 14),
    ("RENDERED", "BLENDER_EEVEE", 14),
    ("RENDERED", "CYCLES", 24),
)


def emission(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs[0].default_value = (*colour, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs[0])
    return material


def clear_scene() -> None:
    for target in list(bpy.data.objects):
        bpy.data.objects.remove(target)


def add_test_objects() -> None:
    """A ball nearer than everything, a post among the furniture, and a wall of it behind the room."""
    magenta = bpy.data.materials.new("magenta")
    magenta.diffuse_color = (0.8, 0.05, 0.5, 1.0)
    magenta.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.05, 0.5, 1.0)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.12, location=(-0.45, -0.9, 1.6))
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(magenta)
    bpy.ops.mesh.primitive_cylinder_add(radius=0.12, depth=3.0, location=(0.35, 1.4, 0.6))
    bpy.context.object.data.materials.append(magenta)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(-1.0, 9.0, 1.2))
    bpy.context.object.data.materials.append(magenta)
    bpy.ops.object.light_add(type="SUN", rotation=(0.9, 0.2, 0.3))
    bpy.ops.object.select_all(action="DESELECT")


def test_colours(window: Window) -> Iterator[float]:
    """A picture of known radiance beside planes of the same emission: the same on the screen."""
    from physhdr.addon.viewport import overlay
    from physhdr.addon.viewport.camera import of_region

    clear_scene()
    for index, value in enumerate(PATCHES):
        bpy.ops.mesh.primitive_plane_add(size=1.0)
        bpy.context.object.data.materials.append(emission(f"{value}", (value,) * 3))
        place = mathutils.Matrix.Translation((-1.6 + 1.2 * index, 1.2, -10.0))
        bpy.context.object.matrix_world = window.rv3d.view_matrix.inverted() @ place
    bpy.ops.object.select_all(action="DESELECT")
    yield from window.settle()
    camera = of_region(window.region, window.rv3d)
    rgba = np.zeros((camera.height, camera.width, 4), np.float16)
    depth = np.full((camera.height, camera.width), 5.0, np.float32)
    centres = [
        (round(camera.cx + camera.fx * (-0.16 + 0.12 * index)), round(camera.cy)) for index in range(3)
    ]
    for (x, y), value in zip(centres, PATCHES, strict=True):
        rgba[y - 30 : y + 30, x - 30 : x + 30] = (value, value, value, 1.0)
    overlay.set_picture(overlay.region_key(window.region), overlay.Picture(rgba, depth, camera))
    for transform in ("Standard", "AgX"):
        bpy.context.scene.view_settings.view_transform = transform
        for shading, engine, redraws in SHADINGS[1:]:
            window.shade(shading, engine)
            yield from window.settle(redraws)
            name = f"colours-{transform}-{shading}-{engine}"
            window.shot(name)
            compare_patches(window, name, camera, centres)
    overlay.clear()
    bpy.context.scene.view_settings.view_transform = "Standard"


def compare_patches(window: Window, name: str, camera, centres: list[tuple[int, int]]) -> None:
    """The picture's patches and the planes 0.12 above them must have the same code values, to 1."""
    pixels = window.pixels(name)

    def seen(x: float, y: float) -> list[int]:
        column, row = window.on_screen(x, y)
        return np.median(pixels[row - 4 : row + 5, column - 4 : column + 5], axis=(0, 1)).astype(int).tolist()

    pairs = [(seen(x, y), seen(x, camera.cy - 0.12 * camera.fy)) for x, y in centres]
    window.report[name] = dict(zip(map(str, PATCHES), pairs, strict=True))
    worst = max(abs(a - b) for picture, plane in pairs for a, b in zip(picture, plane, strict=True))
    if worst > 1:
        raise RuntimeError(f"{name}: the picture and the plane differ by {worst} code values: {pairs}")


def compare_projection(window: Window) -> None:
    """Our pinhole against Blender's own matrix, for the view as it is."""
    from physhdr.addon.viewport.camera import of_region

    camera = of_region(window.region, window.rv3d)
    rng = np.random.default_rng(0)
    pixel = rng.uniform(0.0, 1.0, (200, 2)) * (camera.width, camera.height)
    depth = rng.uniform(0.5, 20.0, 200)
    plane = (pixel - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    in_camera = np.column_stack([plane[:, 0] * depth, -plane[:, 1] * depth, -depth, np.ones(200)])
    world = in_camera @ camera.camera_to_world.T
    clip = world @ np.array(window.rv3d.perspective_matrix, np.float64).T
    theirs = 0.5 * (1.0 + clip[:, :2] / clip[:, 3:] * (1.0, -1.0)) * (camera.width, camera.height)
    ours, _ = camera.project(world[:, :3])
    window.report.setdefault("projection differs by px", []).append(float(np.abs(ours - theirs).max()))


def look_through(window: Window, cameras: Path, index: int) -> None:
    from physhdr.addon import camera_file, render

    pose = camera_file.read_pose(cameras, index)
    scene = bpy.context.scene
    render.set_resolution(scene, 800, 800)
    render.add_camera(scene, pose.camera_to_world, pose.angle_x)
    window.rv3d.view_perspective = "CAMERA"
    window.rv3d.view_camera_zoom = 25.0
    window.rv3d.view_camera_offset = (0.0, 0.0)


def test_splats(window: Window, model: Path, cameras: Path) -> Iterator[float]:
    """The shader: every shading, with objects in front and behind; then three levels, two exposures."""
    from physhdr.addon import model_import, nodes
    from physhdr.addon.viewport import overlay

    clear_scene()
    target = model_import.import_model(model)
    target.physhdr_viewport = "SPLATS"
    look_through(window, cameras, 1)
    bpy.context.scene.camera.data.shift_x = 0.08
    bpy.context.scene.camera.data.shift_y = -0.05
    yield from window.settle(2)
    compare_projection(window)
    bpy.context.scene.camera.data.shift_x = bpy.context.scene.camera.data.shift_y = 0.0
    add_test_objects()
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.EXPOSURE, 1.0)
    for shading, engine, redraws in SHADINGS:
        window.shade(shading, engine)
        yield from window.settle(redraws)
        yield from window.sharpen()
        window.shot(f"splats-{shading}-{engine}")
    window.shade("SOLID")
    for level in (0.25, 1.0, 4.0):
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        yield from window.sharpen()
        window.shot(f"splats-level-{level:g}")
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 1.0)
    window.space.overlay.show_overlays = False
    for shading, engine in (("SOLID", "BLENDER_EEVEE"), ("RENDERED", "CYCLES")):
        window.shade(shading, engine)
        yield from window.settle(12)
        yield from window.sharpen()
        window.shot(f"splats-no-overlays-{shading}")
    window.space.overlay.show_overlays = True
    window.shade("SOLID")
    # A free view, near the camera's.
    window.rv3d.view_perspective = "PERSP"
    window.rv3d.view_location = (0.2, 1.4, 0.9)
    window.rv3d.view_rotation = mathutils.Euler((1.3, 0.0, 0.25)).to_quaternion()
    window.rv3d.view_distance = 3.4
    yield from window.sharpen()
    window.shot("splats-free-view")
    compare_projection(window)
    window.report["seconds in the handler while moving"] = moving = []
    sources = overlay._runtime.sources
    drawn = sources[0]

    def timed(context, camera):
        start = time.perf_counter()
        layers = drawn(context, camera)
        moving.append(round(time.perf_counter() - start, 4))
        return layers

    sources[0] = timed
    for step in range(10):
        window.rv3d.view_rotation = mathutils.Euler((1.3, 0.0, 0.25 + 0.03 * step)).to_quaternion()
        window.region.tag_redraw()
        yield 0.03
    window.shot("splats-moving")
    window.report["seconds in the handler while sharpening"] = moving = []
    yield from window.sharpen()
    sources[0] = drawn
    window.rv3d.view_perspective = "ORTHO"
    yield from window.sharpen()
    window.shot("splats-orthographic")


def test_overlay(window: Window) -> Iterator[float]:
    """The overlay with a backend's kind of picture, full and half size, then seen from a moved view."""
    from physhdr.addon.viewport import overlay, splats
    from physhdr.addon.viewport.camera import of_region
    from physhdr.addon.viewport.splat_renderer import SplatRenderer

    window.rv3d.view_perspective = "CAMERA"
    yield from window.settle(3)
    drawn: list[overlay.Picture] = []

    def draw() -> None:
        if drawn:
            return
        camera = of_region(window.region, window.rv3d)
        context = bpy.context
        shown = splats.shown_objects(context.view_layer, context.view_layer.depsgraph)
        ((_, items),) = splats.items_by_tone(shown).values()
        for scale in (1.0, 0.5):
            small = camera.scaled(scale)
            rgba, depth = SplatRenderer().render(items, small).read()
            drawn.append(overlay.Picture(rgba.astype(np.float16), depth, small))

    handler = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")
    yield from window.settle(3, 0.5)
    bpy.types.SpaceView3D.draw_handler_remove(handler, "WINDOW")
    splats.set_hidden(
        splats.identity(target.data) for target in bpy.data.objects if target.type == "POINTCLOUD"
    )
    key = overlay.region_key(window.region)
    for name, picture in zip(("full", "half"), drawn, strict=True):
        overlay.set_picture(key, picture)
        yield from window.settle()
        window.shot(f"overlay-{name}")
    window.shade("RENDERED")
    yield from window.settle(12)
    window.shot("overlay-rendered")
    window.shade("SOLID")
    matrix = window.rv3d.view_matrix.inverted()
    window.rv3d.view_perspective = "PERSP"
    window.rv3d.view_matrix = (matrix @ mathutils.Matrix.Translation((0.15, 0.0, 0.1))).inverted()
    yield from window.settle()
    window.shot("overlay-moved")
    uploads = window.report["seconds to upload"] = {}
    timed = overlay.upload

    def upload_timed(picture: overlay.Picture) -> overlay.Layer:
        start = time.perf_counter()
        layer = timed(picture)
        uploads.setdefault(picture.camera.width, []).append(round(time.perf_counter() - start, 4))
        return layer

    overlay.upload = upload_timed
    for size in [400] * 6 + [800] * 6:
        small = drawn[0].camera.resized(size, size)
        rgba = np.random.default_rng(0).random((size, size, 4)).astype(np.float16)
        overlay.set_picture(key, overlay.Picture(rgba, np.ones((size, size), np.float32), small))
        yield from window.settle(1)
    overlay.upload = timed
    overlay.clear()
    splats.set_hidden(())


def steps(options: argparse.Namespace) -> Iterator[float]:
    from physhdr.addon import viewport

    viewport.register()
    window = Window(options.out)
    try:
        if "colours" in options.only:
            yield from test_colours(window)
        if "splats" in options.only:
            yield from test_splats(window, options.model, options.cameras)
        if "overlay" in options.only:
            yield from test_overlay(window)
    finally:
        (options.out / "report.json").write_text(json.dumps(window.report, indent=1))
    viewport.unregister()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--cameras", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", default=["colours", "splats", "overlay"])
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])
    options.out.mkdir(parents=True, exist_ok=True)
    load_package()
    bpy.context.preferences.view.show_splash = False
    running = steps(options)

    def tick() -> float | None:
        try:
            return next(running)
        except StopIteration:
            code = 0
        except BaseException:  # noqa: BLE001 (whatever it is, the window must not stay open)
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        os._exit(code)

    bpy.app.timers.register(tick, first_interval=1.0)


main()
