# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture lights the scene, drawn by the backend and by Blender: run inside Blender by test_lighting.py."""

import json
import sys
from pathlib import Path

import bpy

import physhdr
from physhdr.addon import runtime, settings
from physhdr.addon.light import probes
from physhdr.addon.session.state import PythonChosen

WIDTH = 64


def main() -> None:
    python, model_file, out = sys.argv[sys.argv.index("--") + 1 :]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings.home_folder = lambda: Path(out) / "home"
    physhdr.register()
    session = runtime.session()
    bpy.ops.physhdr.model_import(filepath=model_file)
    model, scene = bpy.context.object, bpy.context.scene
    model.location, model.rotation_euler, model.scale = (1.0, 2.0, 3.0), (0.2, 0.4, 0.6), (0.5,) * 3
    for name in ("left", "right"):
        empty = bpy.data.objects.new(name, None)
        empty.location = (1.0 + 0.1 * (name == "right"), 2.0, 3.0)
        scene.collection.objects.link(empty)
        empty.select_set(True)
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(out) / "scene.blend"))

    seen = {}
    # Without a backend Blender draws, with one the backend does.
    for report in ({}, {"versions": {"torch": "2"}, "missing": []}):
        session.dispatch(PythonChosen(python if report else "", report))
        assert bpy.ops.physhdr.light_from_here(width=WIDTH) == {"FINISHED"}
        found = {each.name: each for each in probes.probes_of(scene, model)}
        assert set(found) == {"left", "right"}
        kind = "backend" if report else "blender"
        seen[kind] = {name: json.loads(each[probes.KNOWN]) for name, each in found.items()}
        (Path(out) / kind).mkdir()
        for name, each in found.items():
            Path(bpy.path.abspath(each[probes.FOLDER])).rename(Path(out) / kind / name)
    (Path(out) / "seen.json").write_text(json.dumps(seen))


main()
