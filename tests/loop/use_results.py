# SPDX-License-Identifier: GPL-3.0-or-later
"""A run evaluated and filmed from Blender, as a script: run inside Blender by test_results.py."""

import json
import math
import sys
from pathlib import Path

import bpy

import physhdr
from physhdr.addon import runtime, settings
from physhdr.addon.model import nodes
from physhdr.addon.session.results import evaluation_of
from physhdr.addon.session.state import PythonChosen


def main() -> None:
    python, run, out = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings.home_folder = lambda: Path(out) / "home"
    physhdr.register()
    session = runtime.session()
    session.dispatch(PythonChosen(python, {"versions": {"torch": "2"}, "missing": []}))
    scene = bpy.context.scene
    scene.physhdr.out = run

    assert bpy.ops.physhdr.results_evaluate() == {"FINISHED"}
    found = evaluation_of(run)
    seen = {"views": found.views, "figures": [[f.what, f.words, f.numbers] for f in found.figures]}

    # Two frames from in front of the scene, the second nearer, wider, darker and with the light turned up.
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.rotation_euler = (0.5 * math.pi, 0.0, 0.0)
    for frame, place, angle, look in ((1, -4.0, 0.9, (0.0, 1.0)), (2, -3.0, 1.2, (-1.0, 4.0))):
        camera.location = (0.0, place, 0.0)
        camera.data.angle_x = angle
        scene.physhdr.exposure_ev, scene.physhdr.lighting_level = look
        camera.keyframe_insert("location", frame=frame)
        camera.data.keyframe_insert("lens", frame=frame)
        for name in ("exposure_ev", "lighting_level"):
            scene.physhdr.keyframe_insert(name, frame=frame)
    for form in ("PNG", "MP4"):
        filepath = str(Path(out) / "video")
        assert bpy.ops.physhdr.results_video(format=form, filepath=filepath, exposure=2.0) == {"FINISHED"}
    assert bpy.ops.physhdr.results_web(filepath=str(Path(out) / "page")) == {"FINISHED"}

    # The model, turned and moved, as a standard PLY: fitted by the backend, whose word is waited for.
    bpy.ops.physhdr.model_import(filepath=str(Path(run) / "model.safetensors"))
    target = bpy.context.object
    target.location, target.rotation_euler = (1.0, 2.0, 3.0), (0.3, -0.2, 0.5)
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.EXPOSURE, -0.5)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 2.0)
    bpy.context.view_layer.update()
    for name, quick in (("fitted.ply", False), ("quick.ply", True)):
        filepath = str(Path(out) / name)
        baked = bpy.ops.physhdr.model_bake(filepath=filepath, tone="LEARNED", quick=quick)
        assert baked == {"FINISHED"}
    assert not list(Path(bpy.app.tempdir).glob("physhdr_bake_*"))
    seen["matrix"] = [list(row) for row in target.matrix_world]
    (Path(out) / "seen.json").write_text(json.dumps(seen))


main()
