# SPDX-License-Identifier: GPL-3.0-or-later
"""Points lie on what renders show: between the clipping distances, and of the shape that renders have."""

from collections.abc import Callable

import bpy
import numpy as np
import pytest

from physhdr.synth import points, user_camera
from physhdr.synth.rays import Rays
from physhdr.synth.stage import CameraHints, Stage

SIZE = (16, 12)
#: From (0, 0, 5) straight down.
EYE = np.eye(4)
EYE[2, 3] = 5.0


def card(name: str, height: float, half: float) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    data.from_pydata(corners, [], [(0, 1, 2, 3)])
    item = bpy.data.objects.new(name, data)
    item.location.z = height
    bpy.context.scene.collection.objects.link(item)
    return item


@pytest.fixture
def scene() -> bpy.types.Scene:
    """A wide floor at 0 and a card at 2 that fills the picture of a camera at 5."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    card("floor", 0.0, 50.0)
    card("card", 2.0, 10.0)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location.z = 5.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    return scene


def cast(scene: bpy.types.Scene, clip: tuple[float, float]) -> np.ndarray:
    hints = CameraHints(
        centre=(0, 0, 5),
        target=(0, 0, 0),
        extent=(1, 1),
        angle_x=2.0,
        orbit_radius=5.0,
        orbit_arc=1.0,
        elevation=(0.0, 1.0),
        clip=clip,
    )
    return points.cast(
        Stage(scene=scene, cameras=hints, lights={}), [EYE], [np.zeros((*SIZE[::-1], 3), np.uint8)], 0
    )


@pytest.mark.parametrize(
    ("clip", "height"),
    [((0.1, 100.0), 2.0), ((2.9, 3.1), 2.0), ((3.1, 100.0), 0.0), ((3.1, 4.9), None), ((5.1, 100.0), None)],
)
def test_the_clipping_distances_are_planes_for_points_and_for_the_rig(scene, clip, height) -> None:
    """Not spheres: at an angle of 115° all of the card is met where its middle is."""
    found = cast(scene, clip)
    lens = scene.camera.data
    lens.angle, (lens.clip_start, lens.clip_end) = 2.0, clip
    rays = Rays(scene, scene.view_layers[0])
    if height is None:
        assert not len(found)
        assert user_camera.target_distance(scene.camera, EYE, rays, SIZE)[1] == "the middle of the scene"
        return
    assert len(found) == SIZE[0] * SIZE[1]
    assert found["z"] == pytest.approx(height, abs=1e-5)
    distance, _ = user_camera.target_distance(scene.camera, EYE, rays, SIZE)
    assert distance == pytest.approx(5.0 - height)


def raised(item: bpy.types.Object) -> float:
    """In renders alone, by 1 m."""
    modifier = item.modifiers.new("raised", "DISPLACE")
    modifier.direction, modifier.mid_level, modifier.strength = "Z", 0.0, 1.0
    modifier.show_viewport = False
    return 3.0


def lowered(item: bpy.types.Object) -> float:
    """In views alone."""
    raised(item)
    modifier = item.modifiers[0]
    modifier.strength, modifier.show_viewport, modifier.show_render = -1.0, True, False
    return 2.0


def rounded(item: bpy.types.Object) -> float:
    """In renders alone: a box, whose top they make lower, by as much as Blender's own vertices say."""
    solid = item.modifiers.new("solid", "SOLIDIFY")
    solid.thickness, solid.offset = 20.0, -1.0
    finer = item.modifiers.new("finer", "SUBSURF")
    finer.levels = finer.render_levels = 3
    bpy.context.view_layer.update()
    _, highest = heights(item)
    finer.levels = 0
    assert highest < 1.0
    return highest


def rounded_where_views_are_simplified(item: bpy.types.Object) -> float:
    highest = rounded(item)
    item.modifiers["finer"].levels = 3
    render = bpy.context.scene.render
    render.use_simplify, render.simplify_subdivision = True, 0
    return highest


@pytest.mark.parametrize("shape", [raised, lowered, rounded, rounded_where_views_are_simplified])
def test_points_lie_on_the_shape_that_renders_have(scene, shape: Callable) -> None:
    item = bpy.data.objects["card"]
    highest = shape(item)
    scene.view_layers[0].update()
    before = state(item), heights(item)
    assert before[1][1] != pytest.approx(highest, abs=0.5)  # views show it elsewhere
    found = cast(scene, (0.1, 100.0))
    assert found["z"].max() == pytest.approx(highest, abs=0.02)
    assert (state(item), heights(item)) == before


def state(item: bpy.types.Object) -> list[tuple[bool, int, int]]:
    limit = bpy.context.scene.render.simplify_subdivision
    return [(each.show_viewport, getattr(each, "levels", 0), limit) for each in item.modifiers]


def heights(item: bpy.types.Object) -> tuple[float, float]:
    """Lowest and highest vertex as views show it."""
    shown = item.evaluated_get(bpy.context.view_layer.depsgraph)
    found = [(shown.matrix_world @ vertex.co).z for vertex in shown.data.vertices]
    return min(found), max(found)
