# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered of the user's scene: the same bytes again, in the file's own colours, without models."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from physhdr.bridge.blend_file import MODEL_IDENTITY
from physhdr.synth import dataset, open_scene
from physhdr.synth.errors import ConflictError
from physhdr.synth.make_scene import main
from physhdr.synth.progress import Report
from physhdr.tests.synth import conftest as readers
from physhdr.tests.synth.open_scene.user_scene import ARGUMENTS, ROOT, SMALL, add


def test_only_what_is_rendered_is_the_same_again(scene, tmp_path):
    """The same scene and seed: the same bytes, also from a file, whatever is its view transform."""
    dataset.make(tmp_path / "a", SMALL)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "untitled.blend"))
    scene = bpy.context.scene
    scene.view_settings.view_transform = "Filmic"
    dataset.make(tmp_path / "b", SMALL)
    assert (
        main(["--from-file", str(tmp_path / "untitled.blend"), "--out", str(tmp_path / "c"), *ARGUMENTS]) == 0
    )
    names = sorted(
        p.relative_to(tmp_path / "a")
        for p in (tmp_path / "a").rglob("*")
        if p.suffix in {".exr", ".png", ".ply"}
    )
    assert len(names) == 8 + 8 + 1 + 5 * 8 + 1
    for name in names:
        first = (tmp_path / "a" / name).read_bytes()
        assert (tmp_path / "b" / name).read_bytes() == first, name
        assert (tmp_path / "c" / name).read_bytes() == first, name


def test_another_working_space_is_converted_on_the_way_out(scene, tmp_path):
    """The file's colours are ACEScg: pixels are Rec.709 all the same, and the file's space stays."""
    options = replace(SMALL, samples=16, views=2, lit_views=0, relit_views=0)
    dataset.make(tmp_path / "a", options)
    bpy.ops.wm.set_working_color_space(working_space="ACEScg", convert_colors=True)
    try:
        dataset.make(tmp_path / "b", options)
        assert bpy.data.colorspace.working_space == "ACEScg"
    finally:
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=True)
    a, b = (readers.read_exr(tmp_path / name / "test_hdr/hdr_000.exr") for name in "ab")
    # Light between surfaces is not quite the same with other primaries; unconverted, blue would be far off.
    assert np.abs(a.mean((0, 1)) / b.mean((0, 1)) - 1).max() < 0.02
    assert readers.read_json(tmp_path / "b/dataset.json")["working_space"] == "Linear Rec.709"


@pytest.mark.parametrize(
    "called",
    [
        "Utility - Linear - sRGB",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("Linear Rec.709 (sRGB)", "Something Else")),
    ],
)
def test_another_configuration_of_colours(scene, tmp_path, monkeypatch, called):
    """Blender's own, in which Rec.709 has another name: the same radiance, or an error with a remedy."""
    own = Path(bpy.utils.resource_path("LOCAL"), "datafiles/colormanagement")
    text = (own / "config.ocio").read_text(encoding="utf-8").replace("Linear Rec.709", called)
    text = text.replace("icc:luts:filmic", ":".join(str(own / part) for part in ("icc", "luts", "filmic")))
    (tmp_path / "config.ocio").write_text(text, encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    command = [sys.executable, ROOT / "synth/make_scene.py", "--", "--from-file", tmp_path / "room.blend"]
    command += ["--out", tmp_path / "d", *ARGUMENTS, "--views", "2", "--lit-views", "0", "--relit-views", "0"]
    monkeypatch.setenv("OCIO", str(tmp_path / "config.ocio"))
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if called == "Something Else":
        assert done.returncode == 1 and "Traceback" not in done.stderr
        assert "error: the configuration of colours (OCIO) has no space 'Linear Rec.709'" in done.stderr
        assert "without the variable OCIO" in done.stderr
        return
    assert done.returncode == 0, done.stderr
    dataset.make(tmp_path / "own", replace(SMALL, views=2, lit_views=0, relit_views=0))
    ours, own_ones = (readers.read_exr(tmp_path / name / "test_hdr/hdr_000.exr") for name in ("d", "own"))
    np.testing.assert_allclose(ours, own_ones, rtol=1e-4)
    assert readers.read_json(tmp_path / "d/dataset.json")["working_space"] == "Linear Rec.709"


def test_the_users_light_paths_are_kept_and_told(scene, tmp_path):
    dataset.make(tmp_path, replace(SMALL, views=2, lit_views=0, relit_views=0))
    told = readers.read_json(tmp_path / "dataset.json")["render_settings"]
    assert told["scene.cycles.max_bounces"] == 9 and told["scene.cycles.use_light_tree"] is True
    assert told["scene.cycles.sample_clamp_indirect"] == 0.0


def test_resume_renders_what_is_missing_and_refuses_a_changed_scene(scene, tmp_path):
    dataset.make(tmp_path, SMALL)
    lost = tmp_path / "passes/test_001.exr"
    radiance = lost.read_bytes()
    lost.unlink()
    dataset.make(tmp_path, SMALL)
    assert lost.read_bytes() == radiance
    bpy.data.objects["cube"].location.x += 0.25
    lost.unlink()
    with pytest.raises(ConflictError, match="the scene, its lights or its camera have changed"):
        dataset.make(tmp_path, SMALL)
    bpy.data.objects["cube"].location.x -= 0.25
    bpy.data.materials["grey"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.1
    with pytest.raises(ConflictError):
        dataset.make(tmp_path, SMALL)
    assert not lost.exists()


def test_resume_refuses_cameras_that_stand_elsewhere(scene, tmp_path):
    """Nothing has moved, but the rig looks at another distance, or the animation goes elsewhere."""
    scene.camera.data.dof.use_dof, scene.camera.data.dof.focus_distance = True, 4.0
    dataset.make(tmp_path / "grid", SMALL)
    scene.camera.data.dof.focus_distance = 4.5
    with pytest.raises(ConflictError, match="its camera have changed"):
        dataset.make(tmp_path / "grid", SMALL)
    mine = scene.camera
    for frame, x in ((1, 0.5), (250, 1.0)):
        mine.location.x = x
        mine.keyframe_insert("location", frame=frame)
    dataset.make(tmp_path / "path", replace(SMALL, camera_rig="path"))
    mine.location.x = 2.0
    mine.keyframe_insert("location", frame=250)
    with pytest.raises(ConflictError, match="its camera have changed"):
        dataset.make(tmp_path / "path", replace(SMALL, camera_rig="path"))


def test_every_second_scene_of_a_file_can_be_asked_for(scene, tmp_path):
    other = bpy.data.scenes.new("other")
    camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    camera.matrix_world = Matrix.Translation((0, 0, 3))
    lamp = bpy.data.objects.new("lamp 2", bpy.data.lights.new("lamp 2", "POINT"))
    lamp.data.energy = 10.0
    for item in (camera, lamp, bpy.data.objects["floor"]):
        other.collection.objects.link(item)
    other.camera = camera
    with open_scene.opened(replace(SMALL, scene_name="other"), Report()) as (stage, options):
        assert stage.scene == other and stage.source["camera"] == "eye"
        assert options.relit_views == 0  # only a lamp there
        assert bpy.context.window.scene == other
    assert bpy.context.window.scene == scene


def test_trained_models_are_left_out_and_told(scene, tmp_path, capsys):
    """A model stands before the camera, another is instanced: the same bytes as without, and both named."""
    dataset.make(tmp_path / "without", SMALL)
    cloud = bpy.data.pointclouds.new("splats")
    cloud.resize(1)
    cloud.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.array([0.6], np.float32))
    cloud[MODEL_IDENTITY] = "some model"
    add("splats", cloud, (0.3, -2, 1))
    hidden = bpy.data.collections.new("hidden")
    hidden.objects.link(bpy.data.objects.new("more splats", cloud))
    holder = add("holder", None, (-1, -2, 1))
    holder.instance_type, holder.instance_collection = "COLLECTION", hidden
    bpy.context.view_layer.update()
    dataset.make(tmp_path / "with", SMALL)
    assert "trained models: splats, more splats" in capsys.readouterr().out
    told = readers.read_json(tmp_path / "with/dataset.json")["source"]
    assert told["left_out"] == ["splats", "more splats"] and told["warnings"] == []
    name = "test_hdr/hdr_001.exr"
    assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes()
    assert not bpy.data.objects["splats"].hide_render and not bpy.data.objects["more splats"].hide_render
    del cloud[MODEL_IDENTITY]  # any other point cloud is a part of the scene
    dataset.make(tmp_path / "cloud", SMALL)
    assert (tmp_path / "cloud" / name).read_bytes() != (tmp_path / "without" / name).read_bytes()
