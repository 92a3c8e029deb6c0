# SPDX-License-Identifier: GPL-3.0-or-later
"""Any 3DGS PLY in Blender: what arrives, how it is turned, several files, drag and drop."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from physhdr.bridge.display import FITTED_COMMENT
from physhdr.bridge.gaussian_ply import write_standard_ply

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import model_import, nodes, point_cloud  # noqa: E402
from physhdr.addon.operators import model_files  # noqa: E402


@pytest.fixture
def gaussians():
    """30 Gaussians of degree 2 and display colours, float32."""
    rng = np.random.default_rng(0)
    rotations = rng.normal(size=(30, 4))
    sh = rng.normal(0.0, 0.04, (30, 9, 3))
    sh[:, 0] = rng.uniform(-1.5, 1.7, (30, 3))
    arrays = {
        "positions": rng.normal(size=(30, 3)),
        "rotations": rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        "scales": rng.lognormal(-3.0, 0.5, (30, 3)),
        "opacities": rng.uniform(0.05, 0.95, 30),
        "colour_sh": sh,
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


@pytest.fixture
def ply(gaussians, tmp_path):
    write_standard_ply(tmp_path / "plant.ply", **gaussians)
    return tmp_path / "plant.ply"


def test_the_attributes_of_5_3_are_the_files_own(scene, ply, gaussians):
    cloud = model_import.import_model(ply).data

    def read(name: str) -> np.ndarray:
        return point_cloud.read_attribute(cloud, name)

    np.testing.assert_array_equal(read("position"), gaussians["positions"])
    np.testing.assert_allclose(read("scale"), gaussians["scales"], rtol=1e-5)
    np.testing.assert_allclose(read("rotation"), gaussians["rotations"], atol=1e-6)
    np.testing.assert_allclose(read("radiance:base")[:, 3], gaussians["opacities"], atol=1e-6)
    np.testing.assert_array_equal(read("radiance:base")[:, :3], gaussians["colour_sh"][:, 0])
    for k in range(1, 9):
        np.testing.assert_array_equal(read(f"radiance:sh_{k - 1}"), gaussians["colour_sh"][:, k])
    types = {attribute.name: (attribute.data_type, attribute.domain) for attribute in cloud.attributes}
    assert types["radiance:base"] == ("FLOAT4", "POINT")
    assert types["radiance:sh_7"] == ("FLOAT_VECTOR", "POINT")
    assert types["rotation"] == ("QUATERNION", "POINT")
    assert cloud["physhdr_color_space"] == "SRGB"


def test_without_the_view_it_is_the_linearised_mean_colour(scene, ply, gaussians):
    """And exposure and level scale it: nothing is known of its light."""
    target = model_import.import_model(ply)
    modifier = target.modifiers[0]
    assert not nodes.has_input(modifier, nodes.TONE_MAPPER)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    nodes.set_input(modifier, nodes.EXPOSURE, 1.0)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 0.25)
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    radiance = point_cloud.read_attribute(geometry.instances_pointcloud(), "physhdr:radiance")[:, :3]
    code = 0.5 + 0.28209479 * gaussians["colour_sh"][:, 0]
    bright = (code > 0.2).all(axis=1)
    assert bright.sum() > 5
    linear = ((code + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(radiance[bright], 0.5 * linear[bright], rtol=0.1)


@pytest.mark.parametrize(
    ("orientation", "up"), [("AS_IS", (0, 0, 1)), ("Y_UP", (0, 1, 0)), ("COLMAP", (0, -1, 0))]
)
def test_orientation_turns_the_object_and_not_the_data(registered, ply, gaussians, orientation, up):
    """The file's up becomes Blender's Z."""
    assert bpy.ops.physhdr.model_import(filepath=str(ply), orientation=orientation) == {"FINISHED"}
    target = bpy.context.active_object
    bpy.context.view_layer.update()
    turned = np.array(target.matrix_world)[:3, :3] @ up
    np.testing.assert_allclose(turned, (0, 0, 1), atol=1e-6)
    assert math.isclose(np.linalg.det(np.array(target.matrix_world)[:3, :3]), 1.0, abs_tol=1e-6)
    np.testing.assert_array_equal(point_cloud.read_attribute(target.data, "position"), gaussians["positions"])


def test_several_files_at_once_and_one_of_them_damaged(registered, ply, make_model, write):
    write(make_model())
    (ply.parent / "mesh.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    files = [{"name": name} for name in ("plant.ply", "mesh.ply", "model.safetensors")]
    done = bpy.ops.physhdr.model_import(directory=str(ply.parent), files=files, name="ignored")
    assert done == {"FINISHED"}
    assert {target.name for target in bpy.context.selected_objects} == {"plant", "model"}
    assert {target.name: len(target.data.points) for target in bpy.data.objects} == {"plant": 30, "model": 40}


def test_what_is_no_ply_of_gaussians_is_reported(registered, tmp_path):
    (tmp_path / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n1 2 3\n"
    )
    with pytest.raises(RuntimeError, match=r"points\.ply[\s\S]*plain point cloud\?[\s\S]*Stanford PLY"):
        bpy.ops.physhdr.model_import(filepath=str(tmp_path / "points.ply"))
    assert len(bpy.data.objects) == len(bpy.data.pointclouds) == 0


def test_left_out_gaussians_are_counted_in_the_report(registered, gaussians, tmp_path):
    import plyfile

    write_standard_ply(tmp_path / "a.ply", **gaussians)
    content = plyfile.PlyData.read(str(tmp_path / "a.ply"), mmap=False)
    content["vertex"].data["x"][:3] = np.nan
    content.write(str(tmp_path / "a.ply"))
    done = model_import.import_file(tmp_path / "a.ply")
    assert len(done.target.data.points) == 27
    assert done.notes[0].startswith("3 Gaussians with NaN")
    assert any("lighting level scales everything" in note for note in done.notes)


def test_drag_and_drop_is_offered_for_every_kind_of_file(registered):
    handler = bpy.types.PHYSHDR_FH_gaussians
    kinds = [".safetensors", ".ply", ".spz", ".ksplat", ".splat", ".sog"]
    assert handler.bl_file_extensions.split(";") == kinds
    assert handler.bl_import_operator == "physhdr.model_import"
    assert not handler.poll_drop(bpy.context)  # no area is under the mouse here


def test_the_viewport_shows_splats_unless_asked_otherwise(registered, ply):
    bpy.ops.physhdr.model_import(filepath=str(ply))
    splats = bpy.context.active_object
    bpy.ops.physhdr.model_import(filepath=str(ply), viewport="NODES")
    instances = bpy.context.active_object
    assert (splats.physhdr_viewport, instances.physhdr_viewport) == ("SPLATS", "NODES")
    assert splats.modifiers[0].show_render and instances.modifiers[0].show_render


def test_a_collection_that_is_excluded_or_linked_takes_it_nevertheless(registered, ply, scene):
    hidden = bpy.data.collections.new("hidden")
    scene.collection.children.link(hidden)
    bpy.context.view_layer.active_layer_collection = bpy.context.view_layer.layer_collection.children[0]
    bpy.context.view_layer.layer_collection.children[0].exclude = True
    assert bpy.ops.physhdr.model_import(filepath=str(ply)) == {"FINISHED"}
    assert len(bpy.data.objects) == 1


def test_the_dialog_names_the_model_file_of_a_baked_one(registered, gaussians, tmp_path):
    path = tmp_path / "baked.ply"
    write_standard_ply(path, **gaussians, comments=[FITTED_COMMENT])
    (tmp_path / "model.safetensors").touch()
    labels = []
    column = SimpleNamespace(prop=lambda *_: None, label=lambda text: labels.append(text))
    dialog = SimpleNamespace(
        layout=SimpleNamespace(column=lambda: column), color_space="SRGB", _paths=lambda: [path]
    )
    model_files.PHYSHDR_OT_model_import.draw(dialog, bpy.context)
    assert "fitted for viewers that blend codes" in " ".join(labels)
    assert str(tmp_path / "model.safetensors") in "".join(labels)
