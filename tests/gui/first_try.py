# SPDX-License-Identifier: GPL-3.0-or-later
"""An artist's first half hour with a model in one window: import, render setup, light, cleaning, file.

Blender's own default file without its cube; the model is the demo's.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import EXTENSION, Window, drive

#: Where the demo's room is empty, seen by its first test camera.
BALL = (0.1, 0.3, 0.75)
RADIUS = 0.25
LEVELS = (0.25, 1.0, 4.0)
#: Codes by which red and blue of what is magenta are above its green, whatever the view transform.
MAGENTA = 30


def test(window: Window) -> Iterator[float]:
    yield from window.open()
    bpy.ops.physhdr.model_import(filepath=str(window.options.model))
    yield from window.drawn()
    window.screenshot("1_imported")
    yield from set_up_render(window)
    yield from light(window)
    yield from clean(window)
    yield from open_without(window)


def set_up_render(window: Window) -> Iterator[float]:
    """The panel says what would render wrong; *Set Up Render* sets it right."""
    scene = bpy.context.scene
    problems = window.module("addon.rendering.render_setup").render_problems
    bpy.ops.physhdr.cameras_import(directory=str(window.options.data), look_through=True)
    window.area.spaces.active.region_3d.view_perspective = "CAMERA"
    scene.render.engine = "CYCLES"
    yield from window.show_panels("render")
    yield from window.drawn()
    window.screenshot("2_render_warns")
    assert problems(scene)
    bpy.ops.physhdr.render_setup(use_size=True)
    yield from window.drawn()
    window.screenshot("3_render_set_up")
    assert not problems(scene)


def light(window: Window) -> Iterator[float]:
    """Balls of chrome and grey are lit by the capture, and follow its level."""
    scene, session = bpy.context.scene, window.session
    lighting, nodes = window.module("addon.light.lighting"), window.module("addon.model.nodes")
    model = bpy.context.object
    scene.cursor.location = BALL
    former = scene.world
    bpy.ops.physhdr.light_from_here()
    yield from window.until(lambda: session.state.task("light") is None, 300, "taken")
    yield from window.until(lambda: lighting.is_lit(scene.world), 30, "lit")
    assert session.state.problem is None, session.state.problem
    for name, place, metallic, roughness in (("chrome", -0.3, 1.0, 0.03), ("grey", 0.3, 0.0, 1.0)):
        ball(name, place, metallic, roughness)
    bpy.context.view_layer.objects.active = model
    model.select_set(True)
    scene.cycles.samples = scene.cycles.preview_samples = 8
    yield from window.show_panels("model", "light")
    window.shade("RENDERED", "BLENDER_EEVEE")
    yield from compiled(window, bpy.data.objects["grey"])
    yield from window.drawn()
    yield from window.still()
    window.screenshot("4_lit")
    seen = []
    for level in LEVELS:
        nodes.set_input(nodes.find_modifier(model), nodes.LIGHTING_LEVEL, level)
        yield from window.drawn()
        yield from window.still()
        window.screenshot(f"lit_{level:g}")
        seen.append(float(block(window, window.pixels(f"lit_{level:g}"), "grey").mean()))
    assert seen[0] < seen[1] < seen[2], seen
    nodes.set_input(nodes.find_modifier(model), nodes.LIGHTING_LEVEL, 1.0)
    bpy.ops.physhdr.light_reset()
    assert scene.world == former


def compiled(window: Window, target: bpy.types.Object) -> Iterator[float]:
    """Until an object is magenta, and is not any more: EEVEE draws nothing while it compiles its shaders."""
    usual = target.data.materials[0]
    magenta = bpy.data.materials.new("magenta")
    shader = magenta.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    shader.inputs["Emission Color"].default_value = (1.0, 0.0, 1.0, 1.0)
    shader.inputs["Emission Strength"].default_value = 1.0

    def is_magenta() -> bool:
        window.region.tag_redraw()
        red, green, blue = block(window, window.grab_pixels(), target.name).mean((0, 1))
        return min(red, blue) > green + MAGENTA

    target.data.materials[0] = magenta
    yield from window.until(is_magenta, 120, "drawn by EEVEE")
    target.data.materials[0] = usual
    yield from window.until(lambda: not is_magenta(), 60, "as it is")


def ball(name: str, aside: float, metallic: float, roughness: float) -> None:
    material = bpy.data.materials.new(name)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = metallic, roughness
    shader.inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1.0) if metallic else (0.5, 0.5, 0.5, 1.0)
    place = (BALL[0] + aside, BALL[1], BALL[2])
    bpy.ops.mesh.primitive_uv_sphere_add(radius=RADIUS, segments=64, ring_count=32, location=place)
    bpy.ops.object.shade_smooth()
    bpy.context.object.name = name
    bpy.context.object.data.materials.append(material)
    bpy.context.object.select_set(False)


def block(window: Window, pixels: np.ndarray, name: str) -> np.ndarray:
    """The codes of a ball's middle in a picture of the screen."""
    camera = window.module("addon.viewport.camera").of_region(window.region, window.region.data)
    centre = np.array(bpy.data.objects[name].location, np.float64)[None]
    ((x, y),), _ = camera.project(centre)
    column, row = window.on_screen(x, y)
    return pixels[row - 8 : row + 9, column - 8 : column + 9].astype(float)


def clean(window: Window) -> Iterator[float]:
    """A crop box, and how many Gaussians it hides."""
    nodes, panel = window.module("addon.model.nodes"), window.module("addon.panels.cleaning")
    for name in ("chrome", "grey"):
        bpy.data.objects.remove(bpy.data.objects[name])
    model = bpy.context.object
    window.shade("SOLID")
    window.area.spaces.active.region_3d.view_perspective = "PERSP"
    view = window.region.data
    view.view_location, view.view_distance = (0.2, 1.4, 0.9), 14.0
    yield from window.show_panels("model", "cleaning")
    yield from window.drawn()
    window.screenshot("5_clean")
    bpy.ops.physhdr.cleaning_box()
    modifier = nodes.find_modifier(model)
    box = nodes.get_input(modifier, nodes.CROP_BOX)
    box.scale.x *= 0.5
    nodes.set_input(modifier, nodes.LARGEST_SIZE, 0.3)
    model.update_tag()
    yield from window.drawn()
    yield from window.until(lambda: panel.hidden._known is not None, 60, "counted")
    yield from window.drawn()
    window.screenshot("6_cropped")
    count = len(model.data.points)
    assert 0.1 * count < panel.hidden._known[1] < 0.9 * count, panel.hidden._known


def open_without(window: Window) -> Iterator[float]:
    """The file, opened where there is no PhysHDR: Blender itself draws the points."""
    path = window.options.out / "home" / "room.blend"
    model = bpy.context.object
    nodes = window.module("addon.model.nodes")
    nodes.set_input(nodes.find_modifier(model), nodes.CROP, False)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    yield from window.show_panels()
    bpy.ops.preferences.addon_disable(module=EXTENSION)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    yield from window.redrawn()
    yield from window.still()
    window.screenshot("7_without")
    shown = window.pixels("7_without")
    left, top = window.on_screen(0.35 * window.region.width, 0.35 * window.region.height)
    right, bottom = window.on_screen(0.65 * window.region.width, 0.65 * window.region.height)
    colours = np.unique(shown[top:bottom, left:right].reshape(-1, 3), axis=0)
    assert len(colours) > MANY_COLOURS, len(colours)


#: A box and a background have fewer.
MANY_COLOURS = 500

drive(test)
