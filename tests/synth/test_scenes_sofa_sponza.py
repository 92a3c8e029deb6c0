# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry that the scenes sofa and sponza rest on: parquet without gaps or overlaps, strewn leaves."""

import bmesh
import bpy
import pytest
from mathutils import Vector

from physhdr.synth.built_in import built
from physhdr.synth.scenes import materials, props, shapes


def test_the_parquet_covers_the_room_once():
    with built("sofa") as stage:
        item = stage.scene.objects["parquet"]
        xs, ys, area = [], [], 0.0
        for face in item.data.polygons:
            area += face.area
            xs += [item.data.vertices[k].co.x for k in face.vertices]
            ys += [item.data.vertices[k].co.y for k in face.vertices]
        room = (max(xs) - min(xs)) * (max(ys) - min(ys))
        # Blocks of 45 × 9 cm with joints of 3 mm fill this much of the plane; overlaps would add to it.
        block = (0.45 - 0.003) * (0.09 - 0.003) / (0.45 * 0.09)
        assert room == pytest.approx(4.6 * 5.4, rel=2e-3)
        assert area / room == pytest.approx(block, abs=0.01)
        mesh = bmesh.new()
        mesh.from_mesh(item.data)
        assert {round(face.normal.z, 3) for face in mesh.faces} == {1.0}
        mesh.free()


def leaves(density: float, seed: int) -> list[tuple[float, ...]]:
    """Where ``scatter`` puts its instances on a box of 2 × 2 × 1 m."""
    scene = bpy.data.scenes.new("scatter")
    grey = materials.plain("grey", (0.5, 0.5, 0.5))
    host = props.box(scene.collection, "host", (0, 0, 0), (2.0, 2.0, 1.0), grey)
    shapes.scatter(host, shapes.leaf("leaf", 0.1, 0.05, grey), density, seed=seed)
    layer = scene.view_layers[0]
    layer.update()
    found = [
        tuple(round(v, 6) for row in instance.matrix_world for v in row)
        for instance in layer.depsgraph.object_instances
        if instance.is_instance
    ]
    bpy.data.scenes.remove(scene)
    return found


def test_scatter_is_dense_as_told_and_the_same_each_time():
    first = leaves(50.0, 3)
    assert len(first) == pytest.approx(50.0 * 16.0, rel=0.15)  # 16 m² of faces
    assert leaves(50.0, 3) == first
    assert leaves(50.0, 4) != first


def test_a_cord_hangs_by_its_sag():
    points = shapes.hanging((0, 0, 2), (2, 0, 2), 0.3)
    assert min(point.z for point in points) == pytest.approx(1.7)
    assert points[0] == Vector((0, 0, 2)) and points[-1] == Vector((2, 0, 2))
