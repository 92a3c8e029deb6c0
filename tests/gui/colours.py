# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of known radiance beside planes of the same emission: the same codes on the screen.

In Material Preview and Rendered, with EEVEE and Cycles, under two view transforms.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import SHADINGS, Patience, Window, drive
from mathutils import Matrix

#: Radiance of the patches.
PATCHES = (0.18, 1.0, 8.0)
#: Seconds of an idle machine that EEVEE may compile.
PATIENCE = 60


def test(window: Window) -> Iterator[float]:
    yield from window.redrawn(1)
    window.install()
    window.clear_scene()
    overlay, camera_module = window.module("addon.viewport.overlay"), window.module("addon.viewport.camera")
    view = window.region.data
    view.view_perspective = "PERSP"
    for index, value in enumerate(PATCHES):
        bpy.ops.mesh.primitive_plane_add(size=1.0)
        bpy.context.object.data.materials.append(emission(value))
        place = Matrix.Translation((-1.6 + 1.2 * index, 1.2, -10.0))
        bpy.context.object.matrix_world = view.view_matrix.inverted() @ place
    bpy.ops.object.select_all(action="DESELECT")
    yield from window.redrawn()
    camera = camera_module.of_region(window.region, view)
    rgba = np.zeros((camera.height, camera.width, 4), np.float16)
    depth = np.full((camera.height, camera.width), 5.0, np.float32)
    centres = [
        (round(camera.cx + camera.fx * (-0.16 + 0.12 * index)), round(camera.cy)) for index in range(3)
    ]
    for (x, y), value in zip(centres, PATCHES, strict=True):
        rgba[y - 30 : y + 30, x - 30 : x + 30] = (value, value, value, 1.0)
    overlay.set_picture(overlay.region_key(window.region), overlay.RenderedView(rgba, depth, camera))
    report = {}
    for transform in ("Standard", "AgX"):
        bpy.context.scene.view_settings.view_transform = transform
        for shading, engine, redraws in SHADINGS[1:]:  # Solid shows Standard whatever is set
            window.shade(shading, engine)
            yield from window.redrawn(redraws)
            name = f"{transform}_{shading}_{engine}"
            patience, pairs = Patience(PATIENCE), []
            while not (
                pairs and (is_right(pairs) or patience.is_over)
            ):  # until EEVEE has compiled its shaders
                yield from window.redrawn(1)
                window.screenshot(name)
                pairs = seen_codes(window, name, camera, centres)
            assert is_right(pairs), f"{name}: codes of the picture's patches and the planes': {pairs}"
            report[name] = pairs
    (window.options.out / "codes.json").write_text(json.dumps(report, indent=1))


def emission(value: float) -> bpy.types.Material:
    material = bpy.data.materials.new(f"{value}")
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs[0].default_value = (value, value, value, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs[0])
    return material


def seen_codes(window: Window, name: str, camera, centres: list[tuple[int, int]]) -> list:
    """For each radiance the codes of the picture's patch, and those of the plane 0.12 above it."""
    pixels = window.pixels(name)

    def seen(x: float, y: float) -> list[int]:
        column, row = window.on_screen(x, y)
        return np.median(pixels[row - 4 : row + 5, column - 4 : column + 5], axis=(0, 1)).astype(int).tolist()

    return [(seen(x, y), seen(x, camera.cy - 0.12 * camera.fy)) for x, y in centres]


def is_right(pairs: list) -> bool:
    """The same to one code, and something at all: 0.18 is darker than 1."""
    differences = [abs(a - b) for picture, plane in pairs for a, b in zip(picture, plane, strict=True)]
    return max(differences) <= 1 and pairs[0][1] < pairs[1][1]


drive(test)
