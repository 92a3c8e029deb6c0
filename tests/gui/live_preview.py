# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview in a real window: among the scene's objects, relit at three levels, and how fast."""

import json
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import Window, drive, slowness
from mathutils import Matrix

LEVELS = (0.25, 1.0, 4.0)
#: Pixels of the 3D view whose speed is measured, and for how long its camera turns.
SIDE = 400
SECONDS = 6.0
#: What the adaptive resolution aims at (addon/viewport/schedule.py).
FRAME_SECONDS = 0.8 / 15
#: The longest that anything of ours may hold the interface up, on an idle machine.
HOLD_MILLISECONDS = 50.0


def test(window: Window) -> Iterator[float]:
    options = window.options
    yield from window.open()
    session = window.module("addon.runtime").session()
    settings = bpy.context.scene.physhdr
    yield from open_moved(window)
    window.look_through(options.data / "transforms_test.json", 8)
    window.add_objects()
    settings.preview = True
    yield from window.show_panels("model")  # its sliders in sight
    for level in LEVELS:
        settings.lighting_level = level
        yield from window.sharp()
        window.screenshot(f"level_{level:g}")
    settings.lighting_level = 1.0
    yield from window.show_panels()
    settings.tone = "learned"
    bpy.context.scene.view_settings.view_transform = "Standard"
    yield from window.sharp()
    window.screenshot("learned_tone")
    settings.tone = "linear"
    window.area.spaces.active.region_3d.view_perspective = "PERSP"
    turn(window, 0.4)
    yield from window.sharp()
    window.screenshot("user_view")

    yield from measure(window, session)
    yield from shut_down(window)


def open_moved(window: Window) -> Iterator[float]:
    """Open a run whose data set is not where it was: the one that is chosen in the panel is sent along."""
    run, session, settings = window.options.model.parent, window.session, bpy.context.scene.physhdr
    config = run / "config.json"
    written = json.loads(config.read_text())
    written["data"] = str(Path("/") / "an_old_disk" / "room")
    config.write_text(json.dumps(written))
    settings.data, settings.out = str(window.options.data), str(run)
    bpy.ops.physhdr.run_open()
    yield from window.until(lambda: session.state.job.has_model, 120, "opened")
    assert session.state.problem is None and session.state.job.data == str(window.options.data)
    yield from window.redrawn()
    window.screenshot("opened")


def shut_down(window: Window) -> Iterator[float]:
    """What the backend held is gone with it, and what was said of a file with the file."""
    headline = window.module("addon.session.advice").headline
    choices = window.module("addon.operators.base").choices
    assert headline(window.session.state, choices(bpy.context)) == "Trained model open"
    yield from window.shut_down()
    window.area.spaces.active.show_region_ui = True
    yield from window.redrawn()
    window.screenshot("shut_down")
    assert headline(window.session.state, choices(bpy.context)) == "Ready"
    bpy.ops.wm.read_homefile(app_template="")
    yield from window.redrawn(1)
    window.full_screen()
    yield from window.redrawn()
    window.show_tab()
    yield from window.redrawn()
    window.screenshot("another_file")
    assert headline(window.session.state, choices(bpy.context)) == "Ready"


def turn(window: Window, angle: float) -> None:
    """Turn the view about the vertical through its own place, a little."""
    view = window.region.data
    pose = view.view_matrix.inverted()
    place = pose.translation.copy()
    pose.translation = (0.0, 0.0, 0.0)
    pose = Matrix.Translation(place) @ Matrix.Rotation(0.05 * math.sin(angle), 4, "Z") @ pose
    view.view_matrix = pose.inverted()


def measure(window: Window, session) -> Iterator[float]:
    """Pictures a second in a view of 400 × 400 that moves all the time, from request to pixels.

    ``bare``: redraws a second of the same view with no preview, which is as fast as this machine can show
    anything. ``held``: how long a timer's call or a draw handler held the interface up at most.
    """
    overlay, runtime = window.module("addon.viewport.overlay"), window.module("addon.runtime")
    live, settings = runtime._live, bpy.context.scene.physhdr
    yield from window.resize_view(SIDE, SIDE)
    # Without a graphics card all that Blender itself draws is drawn by these two cores: no more than needed.
    bpy.context.preferences.system.viewport_aa = "OFF"
    space = window.area.spaces.active
    space.show_gizmo = space.overlay.show_overlays = False
    redraws: list[float] = []
    pictures: list[tuple[float, int]] = []
    answers: list[float] = []
    held: list[float] = []

    def timed(function, called):
        def replacement(*arguments):
            begun = time.perf_counter()
            result = function(*arguments)
            called(begun, time.perf_counter() - begun, result)
            return result

        return replacement

    def uploaded(begun, seconds, layer):
        pictures.append((begun, layer.camera.width))

    def ticked(begun, seconds, result):
        held.append(seconds)

    def drawn(begun, seconds, result):
        redraws.append(begun)
        held.append(seconds)

    def received(begun, seconds, answer):
        if answer is not None:
            answers.append(answer.header.milliseconds)

    overlay.upload = timed(overlay.upload, uploaded)
    live.tick = timed(live.tick, ticked)
    session.take_preview = timed(session.take_preview, received)
    bpy.types.SpaceView3D.draw_handler_remove(overlay._runtime.handlers[1], "WINDOW")
    after_scene = timed(overlay._after_scene, drawn)
    add = bpy.types.SpaceView3D.draw_handler_add
    overlay._runtime.handlers[1] = add(after_scene, (), "WINDOW", "POST_VIEW")

    report = {"view": [window.region.width, window.region.height], "gaussians": session.state.job.gaussians}
    for name, frame_seconds in (("bare", None), ("adaptive", FRAME_SECONDS), ("full size", math.inf)):
        settings.preview = frame_seconds is not None
        if settings.preview:
            yield from window.sharp()
        for schedule in live._schedules.values():
            schedule.ladder.step, schedule.ladder.frame_seconds = 0, frame_seconds
        for record in (redraws, pictures, answers, held):
            record.clear()
        begun = time.perf_counter()
        while (now := time.perf_counter()) < begun + SECONDS:
            turn(window, 10.0 * (now - begun))
            yield 0.005
        report[name] = {"redraws a second": round(len(redraws) / SECONDS, 1)}
        if pictures:
            report[name] |= {
                "pictures a second": round(len(pictures) / SECONDS, 1),
                "median width": int(np.median([width for _, width in pictures])),
                "median rendering, ms": round(float(np.median(answers)), 1),
                "longest hold, ms": round(1e3 * max(held), 1),
            }
    window.screenshot("moving")
    (window.options.out / "speed.json").write_text(json.dumps(report, indent=1))
    # Whoever else computes takes turns with the interface.
    longest = max(report[name]["longest hold, ms"] for name in ("adaptive", "full size"))
    assert longest < HOLD_MILLISECONDS * slowness(), report


drive(test)
