# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's compositor parts the layers of ``physhdr render --layers``: each socket has the file's numbers.

``tests/fixtures/layers.exr`` is what ``tests/backend/cli/test_layers.py`` says the trainer writes.
"""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.synth import exr  # noqa: E402

FILE = Path(__file__).resolve().parents[1] / "fixtures" / "layers.exr"


def test_the_compositor_has_a_socket_for_each_layer(scene, tmp_path):
    """What it writes of a socket is, bit by bit, what the file holds."""
    stored, texts = exr.read_channels(FILE)
    assert texts["physhdr:levels"] == "sun=0.5, lamp.001=2"
    tree = bpy.data.node_groups.new("Layers", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    output, node = tree.nodes.new("NodeGroupOutput"), tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(FILE))
    sockets = [socket.name for socket in node.outputs]
    assert sockets == ["Combined", "Alpha", "Depth", "Confidence", "Fixed", "Light lamp_001", "Light sun"]
    assert node.layer == "ViewLayer"

    scene.compositing_node_group = tree
    scene.collection.objects.link(camera := bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera")))
    scene.camera, scene.render.engine = camera, "CYCLES"
    scene.cycles.samples, scene.cycles.device = 1, "CPU"
    height, width = stored["ViewLayer.Depth.Z"].shape
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    settings = render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    single = {"Alpha": "Combined.A", "Depth": "Depth.Z", "Confidence": "Confidence.X"}
    for socket in node.outputs:
        for link in list(tree.links):
            tree.links.remove(link)
        tree.links.new(socket, output.inputs[0])
        render.filepath = str(tmp_path / f"{socket.name}.exr")
        bpy.ops.render.render(write_still=True)
        channels = [f"{socket.name}.{c}" for c in "RGB"]
        channels = [single[socket.name]] * 3 if socket.name in single else channels
        expected = np.stack([stored[f"ViewLayer.{name}"] for name in channels], axis=-1)
        np.testing.assert_array_equal(exr.read(Path(render.filepath)), expected)
