# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user is told of their scene before and while it is rendered."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from physhdr.synth import dataset, open_scene
from physhdr.synth.errors import RenderError
from physhdr.synth.progress import Report
from physhdr.tests.synth import conftest as readers
from physhdr.tests.synth.open_scene.user_scene import SMALL


def test_exposures_that_lose_the_picture_are_told(scene, tmp_path):
    dataset.make(tmp_path, replace(SMALL, exposures=(512.0, 1024.0), crf="srgb", lit_views=0, relit_views=0))
    (told,) = readers.read_json(tmp_path / "dataset.json")["source"]["warnings"]
    assert "white even at the shortest exposure" in told and "shorter" in told


def test_simulations_that_are_not_baked_are_told(scene):
    bpy.context.view_layer.objects.active = bpy.data.objects["cube"]
    bpy.ops.rigidbody.object_add()
    scene.frame_set(5)
    report = Report()
    with open_scene.opened(SMALL, report):
        pass
    assert "simulations that are not baked may look otherwise: cube" in report.warnings


def test_a_picture_that_the_system_refuses_is_told_as_missing(scene, tmp_path):
    """As Blender, which cannot read it either: a name that is too long is refused to everybody."""
    there = tmp_path / "there.png"
    there.write_bytes(b"")
    for name, path in (("bark", there), ("leaves", tmp_path / "gone.png"), ("moss", tmp_path / ("m" * 300))):
        image = bpy.data.images.new(name, 4, 4)
        image.source, image.filepath, image.use_fake_user = "FILE", str(path), True
    report = Report()
    with open_scene.opened(SMALL, report):
        pass
    assert "missing files (File > External Data): leaves, moss" in report.warnings


def test_a_material_that_gives_no_number_is_named(scene, tmp_path):
    nodes = bpy.data.materials["grey"].node_tree
    glow, end = nodes.nodes.new("ShaderNodeEmission"), nodes.nodes["Material Output"]
    power = nodes.nodes.new("ShaderNodeMath")
    power.operation, power.inputs[0].default_value, power.inputs[1].default_value = "POWER", 1e30, 9.0
    nodes.links.new(power.outputs[0], glow.inputs["Strength"])
    nodes.links.new(glow.outputs[0], end.inputs["Surface"])
    try:
        dataset.make(tmp_path, SMALL)
    except RenderError as error:
        assert "NaN or infinity" in error.message and "material" in error.hint
    else:  # Cycles itself may refuse such light: then the picture is finite, and whole
        assert np.isfinite(readers.read_exr(tmp_path / "test_hdr/hdr_000.exr")).all()


def test_a_material_that_reads_the_index_is_rendered_as_the_user_sees_it(scene, tmp_path):
    """A cube that shines as brightly as its number; the floor has none."""
    nodes = bpy.data.materials["grey"].node_tree
    glow, info = nodes.nodes.new("ShaderNodeEmission"), nodes.nodes.new("ShaderNodeObjectInfo")
    nodes.links.new(info.outputs["Object Index"], glow.inputs["Strength"])
    nodes.links.new(glow.outputs[0], nodes.nodes["Material Output"].inputs["Surface"])
    bpy.data.objects["cube"].pass_index = 5
    dataset.make(tmp_path, SMALL)
    told = readers.read_json(tmp_path / "dataset.json")
    assert told["objects"] == {"cube": 5}
    assert any("keep the numbers" in warning for warning in told["source"]["warnings"])
    assert readers.read_exr(tmp_path / "test_hdr/hdr_000.exr").max() == pytest.approx(5.0, rel=0.01)
