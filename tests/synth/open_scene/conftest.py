# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixture: the user's scene, fresh for each test."""

import bpy
import pytest

from physhdr.tests.synth.open_scene.user_scene import CAMERA, PITCH, add, background, light, mesh


@pytest.fixture
def scene():
    """A cube on a plane, world, sun and lamp, a camera whose render is 16:9; not as our settings are."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    grey = bpy.data.materials.new("grey")
    floor = [(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)]
    add("floor", mesh("floor", floor, [(0, 1, 2, 3)], grey))
    cube = [(x, y, z) for z in (0, 1) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
    faces = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    add("cube", mesh("cube", cube, faces, grey))
    scene.world = bpy.data.worlds.new("sky")
    background().inputs["Color"].default_value = (0.3, 0.5, 1.0, 1.0)
    background().inputs["Strength"].default_value = 0.5
    light("sun", "SUN", 2.0, (0, 0, 5))
    light("lamp", "POINT", 60.0, (1.5, -1.5, 1.5))
    scene.camera = add("mine", bpy.data.cameras.new("mine"), CAMERA, (PITCH, 0, 0))
    scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
    scene.render.engine = "BLENDER_EEVEE"
    scene.view_settings.exposure = 1.5
    scene.cycles.samples = 333
    scene.cycles.max_bounces = 9
    return scene
