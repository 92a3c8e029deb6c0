# SPDX-License-Identifier: GPL-3.0-or-later
"""A trained run in a real window: evaluated, filmed and baked beside one's work, told in the panel."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive


def test(window: Window) -> Iterator[float]:
    options = window.options
    run = options.model.parent
    yield from window.open()
    session = window.module("addon.runtime").session()
    settings = bpy.context.scene.physhdr
    settings.data, settings.out = str(options.data), str(run)
    yield from window.show_panels("capture")
    window.screenshot("1_before")

    assert bpy.ops.physhdr.results_evaluate() == {"FINISHED"}
    yield from window.until(lambda: session.state.task("evaluate").fraction > 0.1, 200, "under way")
    yield from window.redrawn()
    window.screenshot("2_evaluating")
    yield from window.until(lambda: session.state.task("evaluate") is None, 300, "evaluated")
    assert session.state.problem is None, session.state.problem
    assert session.state.made is not None and session.state.made.task == "evaluate"
    yield from window.show_panels()
    window.screenshot("3_done")
    bpy.ops.physhdr.made_dismiss()
    yield from window.show_panels("capture")
    window.screenshot("3_evaluated")

    bpy.ops.physhdr.model_import(filepath=str(run / "model.safetensors"))
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 6
    camera = window.look_through(options.data / "transforms_test.json", 0)
    scene.render.resolution_x, scene.render.resolution_y = 160, 120
    for frame, turn in ((1, 0.0), (6, math.radians(10.0))):
        camera.rotation_euler.z += turn
        camera.keyframe_insert("rotation_euler", frame=frame)
    yield from window.drawn()
    yield from window.point(0.4, 0.5)
    yield from window.pops_up(lambda: bpy.ops.physhdr.results_video("INVOKE_DEFAULT"))
    window.screenshot("4_video_dialogue")
    before = window.grab()
    window.key("Escape")
    yield from window.closes(before)
    with window.override():
        assert bpy.ops.physhdr.results_video(format="WEBP") == {"FINISHED"}
    yield from window.until(lambda: session.state.task("video") is None, 300, "filmed")
    assert session.state.problem is None, session.state.problem
    assert (run / "video.webp").stat().st_size > 1000
    yield from window.redrawn()
    window.screenshot("5_filmed")

    yield from window.show_panels("model", "cleaning")
    baked = run / "baked_in_blender.ply"
    before = window.grab()
    with window.override():
        bpy.ops.physhdr.model_bake("INVOKE_DEFAULT", filepath=str(baked))
    yield from window.redrawn()
    yield 1.0
    window.screenshot("6_bake_dialogue")
    window.key("Escape")
    yield 1.0
    with window.override():
        assert bpy.ops.physhdr.model_bake(filepath=str(baked), tone="LEARNED") == {"FINISHED"}
    yield from window.until(lambda: session.state.task("bake").fraction > 0.1, 200, "fitting")
    yield from window.redrawn()
    window.screenshot("7_baking")
    yield from window.until(lambda: session.state.task("bake") is None, 300, "fitted")
    yield from window.until(lambda: session.state.made is not None, 30, "written")
    assert session.state.made.path == str(baked) and baked.is_file()
    assert session.state.problem is None, session.state.problem
    assert b"fitted to pictures" in baked.read_bytes()[:2000]


drive(test)
