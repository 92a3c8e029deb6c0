# SPDX-License-Identifier: GPL-3.0-or-later
"""For test_viewport.py: draw models with the viewport's shader, without a window, in Blender's Python.

``run-blender draw_splats.py -- CASES.json``: each case has ``model`` (a file), ``camera`` (keyword arguments
of ``ViewCamera``), ``matrix_world``, ``levels``, ``exposure``, ``format`` and ``out`` (an ``.npz`` with
``colour`` [H, W, 4] and ``depth`` [H, W], top row first).
"""

import json
import sys
from pathlib import Path

import bpy
import gpu
import mathutils
import numpy as np

from physhdr.addon import viewport
from physhdr.addon.model import nodes
from physhdr.addon.model.model_import import import_model
from physhdr.addon.model.point_cloud import lights_of
from physhdr.addon.viewport import splats
from physhdr.addon.viewport.camera import ViewCamera
from physhdr.addon.viewport.splat_renderer import SplatRenderer


def draw(case: dict, renderer: SplatRenderer) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    target = import_model(case["model"])
    target.physhdr_viewport = "SPLATS"
    target.matrix_world = mathutils.Matrix(case["matrix_world"])
    modifier = nodes.find_modifier(target)
    for index, level in enumerate(case["levels"]):
        nodes.set_input(modifier, nodes.level_input(lights_of(target.data), index), level)
    nodes.set_input(modifier, nodes.EXPOSURE, case["exposure"])
    camera = ViewCamera(**{**case["camera"], "camera_to_world": np.array(case["camera"]["camera_to_world"])})
    depsgraph = bpy.context.evaluated_depsgraph_get()
    groups = splats.items_by_tone(splats.shown_objects(bpy.context.view_layer, depsgraph))
    ((_, items),) = groups.values()
    colour, depth = renderer.render(items, camera, format=case["format"]).read()
    np.savez(case["out"], colour=colour, depth=depth)


gpu.init()
viewport.register()
shaders = SplatRenderer()
for case in json.loads(Path(sys.argv[sys.argv.index("--") + 1]).read_text()):
    draw(case, shaders)
viewport.unregister()
