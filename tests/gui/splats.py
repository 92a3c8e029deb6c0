# SPDX-License-Identifier: GPL-3.0-or-later
"""Imported Gaussians drawn by the viewport's shader: every shading, among objects, relit, moving."""

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import SHADINGS, Window, drive
from mathutils import Euler

LEVELS = (0.25, 1.0, 4.0)
#: Pixels by which our pinhole and Blender's own (float32) matrix may differ.
PROJECTION_PIXELS = 1e-3


def test(window: Window) -> Iterator[float]:
    options, report = window.options, {}
    yield from window.open()
    bpy.ops.physhdr.model_import(filepath=str(options.model))
    target = bpy.context.object
    target.select_set(False)
    camera = window.look_through(options.data / "transforms_test.json", 1)
    window.region.data.view_camera_zoom = 25.0
    camera.data.shift_x, camera.data.shift_y = 0.08, -0.05
    yield from window.redrawn()
    report["camera view with lens shift, px"] = projection_error(window)
    camera.data.shift_x = camera.data.shift_y = 0.0
    window.add_objects()

    nodes = window.module("addon.model.nodes")
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.EXPOSURE, 1.0)
    for shading, engine, redraws in SHADINGS:
        yield from window.shaded(shading, engine, redraws)
        yield from window.drawn()
        window.screenshot(f"{shading}_{engine}")
    window.shade("SOLID")
    for level in LEVELS:
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        yield from window.drawn()
        window.screenshot(f"level_{level:g}")
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 1.0)

    view = window.region.data
    view.view_perspective = "PERSP"
    view.view_location, view.view_distance = (0.2, 1.4, 0.9), 3.4
    view.view_rotation = Euler((1.3, 0.0, 0.25)).to_quaternion()
    yield from window.drawn()
    window.screenshot("free_view")
    report["free view, px"] = projection_error(window)
    yield from measure(window, report)
    view.view_perspective = "ORTHO"
    yield from window.drawn()
    window.screenshot("orthographic")
    (options.out / "report.json").write_text(json.dumps(report, indent=1))
    assert max(report["camera view with lens shift, px"], report["free view, px"]) < PROJECTION_PIXELS, report


def measure(window: Window, report: dict) -> Iterator[float]:
    """How long the draw handler holds the interface up while the view turns, and while it then sharpens."""
    sources = window.module("addon.viewport.overlay")._runtime.sources
    drawn, seconds = sources[0], []

    def timed(context, camera):
        begun = time.perf_counter()
        layers = drawn(context, camera)
        seconds.append(time.perf_counter() - begun)
        return layers

    sources[0] = timed
    for step in range(20):
        window.region.data.view_rotation = Euler((1.3, 0.0, 0.25 + 0.02 * step)).to_quaternion()
        window.region.tag_redraw()
        yield 0.03
    report["moving, ms"] = [round(1e3 * value) for value in seconds]
    window.screenshot("moving")
    seconds.clear()
    yield from window.drawn()
    report["sharpening, ms"] = [round(1e3 * value) for value in seconds]
    sources[0] = drawn


def projection_error(window: Window) -> float:
    """Pixels by which our pinhole and Blender's own matrix differ at most, for the view as it is."""
    camera = window.module("addon.viewport.camera").of_region(window.region, window.region.data)
    rng = np.random.default_rng(0)
    pixel = rng.uniform(0.0, 1.0, (200, 2)) * (camera.width, camera.height)
    depth = rng.uniform(0.5, 20.0, 200)
    plane = (pixel - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    in_camera = np.column_stack([plane[:, 0] * depth, -plane[:, 1] * depth, -depth, np.ones(200)])
    world = in_camera @ camera.camera_to_world.T
    clip = world @ np.array(window.region.data.perspective_matrix, np.float64).T
    theirs = 0.5 * (1.0 + clip[:, :2] / clip[:, 3:] * (1.0, -1.0)) * (camera.width, camera.height)
    ours, _ = camera.project(world[:, :3])
    return float(np.abs(ours - theirs).max())


drive(test)
