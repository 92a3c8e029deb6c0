# SPDX-License-Identifier: GPL-3.0-or-later
"""Registering, importing, and what happens to files that cannot be imported."""

import dataclasses
import importlib.util
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import plyfile
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import addon_utils  # noqa: E402

import physhdr  # noqa: E402
from physhdr.addon.model import attributes, model_import, nodes, point_cloud, radiance_tree  # noqa: E402
from physhdr.addon.model import material as materials  # noqa: E402
from physhdr.addon.model.look import look_of  # noqa: E402
from physhdr.addon.operators.photographed_light import choices_of  # noqa: E402
from physhdr.bridge import native_splats, spherical_harmonics  # noqa: E402
from physhdr.bridge.errors import DataMismatchError  # noqa: E402
from physhdr.bridge.gaussian_ply import write_standard_ply  # noqa: E402
from physhdr.bridge.splat_files import read_splat_file  # noqa: E402


def test_registers_and_unregisters_cleanly_twice(scene):
    for _ in range(2):
        physhdr.register()
        assert "model_import" in dir(bpy.ops.physhdr)
        physhdr.unregister()
        assert not hasattr(bpy.types, "PHYSHDR_OT_model_import")


def test_blender_side_never_imports_torch():
    code = "import sys, bpy, physhdr; physhdr.register(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux tells which files are mapped")
def test_the_file_of_an_imported_model_is_let_go(scene, make_model, write):
    """Windows would let no training export to it again while this Blender runs."""
    path = write(make_model())
    target = model_import.import_model(path)
    assert target.name == "model" and str(path) not in Path("/proc/self/maps").read_text(encoding="utf-8")


@pytest.mark.parametrize("modulator", ["additive", "baked-levels"])
@pytest.mark.parametrize("degree", [0, 2])
def test_every_attribute_arrives_exactly(scene, make_model, write, modulator: str, degree: int):
    model = make_model(degree=degree, modulator=modulator)
    cloud = model_import.import_model(write(model)).data

    def read(name: str) -> np.ndarray:
        return point_cloud.read_attribute(cloud, name)

    for name in ("position", "scale"):
        np.testing.assert_array_equal(read(name), getattr(model, name))
    unit = model.rotation / np.linalg.norm(model.rotation, axis=1, keepdims=True)
    np.testing.assert_allclose(read("rotation"), unit, atol=1e-7)
    np.testing.assert_array_equal(read("radiance:base")[:, 3], model.opacity)
    for k in range((degree + 1) ** 2):
        np.testing.assert_array_equal(read(f"physhdr:log_sh_{k}"), model.log_radiance_sh[:, k])
    if modulator == "additive":
        np.testing.assert_array_equal(read("physhdr:light_share_0"), model.light_share[:, 0])
    else:
        for index in range(4):
            np.testing.assert_array_equal(
                read(f"physhdr:level_log_gain_{index}"), model.level_log_gain[index]
            )
    types = {attribute.name: attribute.data_type for attribute in cloud.attributes}
    assert types["rotation"] == "QUATERNION"
    assert types["radiance:base"] == "FLOAT4"
    assert types["physhdr:log_sh_0"] == "FLOAT_VECTOR"


def test_confidence_arrives_exactly(scene, make_model, write):
    model = make_model(confidence=True)
    cloud = model_import.import_model(write(model)).data
    found = point_cloud.read_attribute(cloud, attributes.CONFIDENCE.name)
    np.testing.assert_array_equal(found, model.confidence)
    np.testing.assert_array_equal(point_cloud.model_of(cloud).confidence, model.confidence)


def test_provenance_is_kept(scene, make_model, write):
    path = write(make_model())
    cloud = model_import.import_model(path).data
    assert cloud["physhdr_scene"] == "test"
    assert cloud["physhdr_iteration"] == "100"
    assert cloud["physhdr_modulator"] == "additive"
    assert list(cloud["physhdr_exposures"]) == [0.25, 1.0, 4.0]
    assert cloud["physhdr_file"] == str(path)
    assert len(cloud[attributes.IDENTITY]) == 32


def test_of_a_files_metadata_only_ours_is_taken(registered, make_model, write):
    """A long key is no name of a property, and one of our own properties' names would be another's word."""
    metadata = {"scene": "test", "k" * 80: "v", "color_space": "SRGB", "capture": "elsewhere"}
    path = write(dataclasses.replace(make_model(), metadata=metadata))
    assert bpy.ops.physhdr.model_import(filepath=str(path)) == {"FINISHED"}
    cloud = bpy.context.active_object.data
    assert cloud["physhdr_scene"] == "test" and attributes.COLOR_SPACE not in cloud
    assert cloud[attributes.CAPTURE] == str(path)
    assert len(bpy.data.pointclouds) == 1


def test_a_model_of_photographs_is_as_bright_as_they_are(registered, make_model, write, tmp_path):
    """Its radiance is per second: at EV 0 what a hundredth of one has shown is white."""
    from physhdr.addon.rendering import shots

    path = write(dataclasses.replace(make_model(), metadata={"photographed_ev": "-6.6439"}))
    assert bpy.ops.physhdr.model_import(filepath=str(path)) == {"FINISHED"}
    target = bpy.context.active_object
    modifier = nodes.find_modifier(target)
    assert nodes.get_input(modifier, nodes.EXPOSURE) == pytest.approx(-6.6439)
    assert point_cloud.model_of(target.data).developed_ev == pytest.approx(-6.6439)
    assert shots.photographed_ev_of(target) == pytest.approx(-6.6439)  # stops of a video are from there
    # Colours for a screen have their exposure in them already.
    assert bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"), quick=True) == {"FINISHED"}
    bpy.ops.physhdr.model_import(filepath=str(tmp_path / "a.ply"))
    baked = bpy.context.active_object
    assert (
        nodes.get_input(nodes.find_modifier(baked), nodes.EXPOSURE) == shots.photographed_ev_of(baked) == 0.0
    )


def test_a_model_is_lit_as_its_photographs_at_first(registered, make_model, write, tmp_path):
    """A lamp that was on in its group alone begins off, for every way of looking at the model."""
    lights = ("ambient", "flash")
    model = dataclasses.replace(
        make_model(lights=lights),
        metadata={"photographed_light": '[{"name": "standard", "levels": {"flash": 0}}]'},
    )
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    target = bpy.context.active_object
    assert nodes.get_input(nodes.find_modifier(target), nodes.level_input(lights, 1)) == 0.0
    assert look_of(target).lighting_levels == point_cloud.model_of(target.data).standard_levels == (1.0, 0.0)
    # Blender alone shows it so, too: as a model whose radiance is without the flash from the start.
    without = np.log(1.0 - model.light_share[:, 1]) / spherical_harmonics.C0
    sh = model.log_radiance_sh.copy()
    sh[:, 0] += without.astype(np.float32)
    shown = point_cloud.read_attribute(target.data, "radiance:base")[:, :3]
    np.testing.assert_allclose(shown, native_splats.shown_sh(sh)[:, 0], atol=1e-5)
    # Colours for a screen have their light in them already.
    assert bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"), quick=True) == {"FINISHED"}
    bpy.ops.physhdr.model_import(filepath=str(tmp_path / "a.ply"))
    baked = bpy.context.active_object
    assert look_of(baked).lighting_levels == (1.0,) and "physhdr_photographed_light" not in baked.data
    target.modifiers.clear()
    assert look_of(target).lighting_levels == (1.0, 0.0)


def test_a_model_is_lit_as_any_of_its_photographs(registered, make_model, write):
    """One click for each group; without groups there is nothing to choose, and nothing in the panel."""
    lights = ("ambient", "pendant")
    text = (
        '[{"name": "standard", "levels": {}}, {"name": "pendant off", "levels": {"pendant": 0}}, '
        '{"name": "evening", "levels": {"ambient": 0.25}, "found": {"ambient": "estimated"}}]'
    )
    bpy.ops.physhdr.model_import(filepath=str(write(make_model(lights=lights))))
    assert not bpy.ops.physhdr.light_as_photographed.poll()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    model = dataclasses.replace(make_model(lights=lights), metadata={"photographed_light": text})
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    target = bpy.context.active_object
    assert [each.name for each in choices_of(target)] == ["standard", "pendant off", "evening"]
    for number, levels in ((2, (0.25, 1.0)), (1, (1.0, 0.0)), (0, (1.0, 1.0))):
        assert bpy.ops.physhdr.light_as_photographed(light=str(number)) == {"FINISHED"}
        assert look_of(target).lighting_levels == levels
    target.data["physhdr_photographed_light"] = "bright"
    assert not choices_of(target)
    with pytest.raises(DataMismatchError, match="import the model again"):
        look_of(target)


@pytest.mark.parametrize("told", ["nan", "inf", "1e9", "bright", ""])
def test_an_exposure_that_is_none_is_not_taken(registered, make_model, write, told):
    path = write(dataclasses.replace(make_model(), metadata={"photographed_ev": told}))
    assert bpy.ops.physhdr.model_import(filepath=str(path)) == {"FINISHED"}
    modifier = nodes.find_modifier(bpy.context.active_object)
    assert nodes.get_input(modifier, nodes.EXPOSURE) == 0.0


def test_operator_imports_selects_and_names(registered, make_model, write):
    assert bpy.ops.physhdr.model_import(filepath=str(write(make_model())), name="Room") == {"FINISHED"}
    assert bpy.context.active_object.name == "Room"
    assert len(bpy.context.active_object.data.points) == 40


def test_two_models_of_one_kind_share_the_tree_and_the_materials(registered, make_model, write):
    path = str(write(make_model()))
    bpy.ops.physhdr.model_import(filepath=path)
    trees = [*bpy.data.node_groups]
    bpy.ops.physhdr.model_import(filepath=path)
    assert [*bpy.data.node_groups] == trees and sum(nodes.MARK in tree for tree in trees) == 1
    assert len(bpy.data.materials) == 2
    first, second = bpy.data.objects
    assert first.data[attributes.IDENTITY] != second.data[attributes.IDENTITY]


def test_operator_reports_what_is_wrong_and_makes_nothing(registered, make_model, write, tmp_path):
    path = write(make_model())
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(RuntimeError, match="is truncated"):  # bpy.ops raises what was reported
        bpy.ops.physhdr.model_import(filepath=str(path))
    with pytest.raises(RuntimeError, match="there is no model file"):
        bpy.ops.physhdr.model_import(filepath=str(tmp_path / "none.safetensors"))
    assert len(bpy.data.objects) == len(bpy.data.pointclouds) == 0


@pytest.fixture
def without_cycles(trees_built):
    """Cycles is an extension, and may be switched off."""
    addon_utils.disable("cycles")
    yield
    addon_utils.enable("cycles")


def test_without_cycles_a_model_is_imported_whole(registered, make_model, write, without_cycles):
    assert bpy.ops.physhdr.model_import(filepath=str(write(make_model()))) == {"FINISHED"}
    assert all(any(node.bl_idname == "NodeGroupOutput" for node in t.nodes) for t in bpy.data.node_groups)
    assert sum(nodes.MARK in tree for tree in bpy.data.node_groups) == 1
    for material in bpy.data.materials:
        assert any(node.bl_idname == "ShaderNodeOutputMaterial" for node in material.node_tree.nodes)
    assert bpy.ops.physhdr.render_setup() == {"FINISHED"}


def test_what_was_imported_without_cycles_is_no_lamp_once_a_render_is_set_up(
    registered, make_model, write, without_cycles
):
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())))
    addon_utils.enable("cycles")
    splat = next(each for each in bpy.data.materials if "Splat" in each.name)
    assert splat.cycles.emission_sampling == "AUTO"
    bpy.ops.physhdr.render_setup()
    assert splat.cycles.emission_sampling == "NONE"


@pytest.mark.parametrize(
    "broken", [(materials, "_build"), (radiance_tree, "declare_cleaning"), (radiance_tree, "draw")]
)
def test_what_could_not_be_built_is_not_found_by_the_next_import(
    trees_built, registered, make_model, write, monkeypatch, broken
):
    """A half of a material or a node group, marked as ours, would be every later model's."""
    path = str(write(make_model()))
    with monkeypatch.context() as moment:
        moment.setattr(*broken, lambda *_: 1 / 0)
        with pytest.raises(RuntimeError, match="ZeroDivisionError"):
            bpy.ops.physhdr.model_import(filepath=path)
    assert not bpy.data.objects and not bpy.data.pointclouds
    assert all(each.get("physhdr_material") for each in bpy.data.materials) and not bpy.data.node_groups
    assert bpy.ops.physhdr.model_import(filepath=path) == {"FINISHED"}
    for each in bpy.data.materials:
        assert any(node.bl_idname == "ShaderNodeOutputMaterial" for node in each.node_tree.nodes)


# ---- other programs' formats -----------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path) -> Path:
    """What other programs wrote of the Gaussians in ``source.ply``."""
    with zipfile.ZipFile(Path(__file__).parents[1] / "fixtures" / "splat_files.zip") as archive:
        archive.extractall(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "up"),
    [
        ("source.ply", (0, 0, 1)),  # which says it
        ("chunks.compressed.ply", (0, -1, 0)),
        ("version-2.spz", (0, 1, 0)),
        ("version-3.spz", (0, 1, 0)),
        ("gaussians.splat", (0, -1, 0)),
        ("level-1.ksplat", (0, -1, 0)),
    ],
)
def test_other_programs_files_stand_upright(registered, files, name, up):
    """By the format's convention, unless the user says otherwise; the data stay as they are in the file."""
    assert bpy.ops.physhdr.model_import(filepath=str(files / name)) == {"FINISHED"}
    target = bpy.context.active_object
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(target.matrix_world)[:3, :3] @ up, (0, 0, 1), atol=1e-6)
    assert len(target.data.points) == 270
    cloud = read_splat_file(files / name)
    np.testing.assert_array_equal(point_cloud.read_attribute(target.data, "position"), cloud.position)
    np.testing.assert_array_equal(
        point_cloud.read_attribute(target.data, "radiance:base")[:, :3], cloud.colour_sh[:, 0]
    )
    assert target.data["physhdr_color_space"] == "SRGB"
    bpy.ops.physhdr.model_import(filepath=str(files / name), orientation="AS_IS")
    assert bpy.context.active_object.rotation_euler.x == 0.0


def test_a_format_that_is_not_read_here_says_how_to_convert_it(registered, tmp_path):
    for name in ("a.sog", "a.glb", "a.usdc"):
        (tmp_path / name).write_bytes(b"PK\3\4" if name == "a.sog" else b"{}")
        with pytest.raises(RuntimeError, match=r"is not read here[\s\S]*physhdr export IN OUT\.ply"):
            bpy.ops.physhdr.model_import(filepath=str(tmp_path / name))
    assert len(bpy.data.objects) == 0


def test_spz_4_is_read_or_says_what_is_missing(registered, files):
    """Blender's Python 3.13 has no zstd."""
    path = str(files / "version-4.spz")
    if sys.version_info >= (3, 14) or importlib.util.find_spec("zstandard"):
        assert bpy.ops.physhdr.model_import(filepath=path) == {"FINISHED"}
    else:
        with pytest.raises(RuntimeError, match=r"zstd[\s\S]*physhdr export"):
            bpy.ops.physhdr.model_import(filepath=path)


def test_saturated_gaussians_arrive_opaque(scene, tmp_path):
    """splat-transform writes the opacity 1 as a logit of +∞, and a flat Gaussian may have ln 0."""
    given = {
        "positions": np.zeros((3, 3)),
        "rotations": np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        "scales": np.full((3, 3), 0.1),
        "opacities": np.full(3, 0.5),
        "colour_sh": np.zeros((3, 1, 3)),
    }
    write_standard_ply(tmp_path / "a.ply", **{k: v.astype(np.float32) for k, v in given.items()})
    ply = plyfile.PlyData.read(str(tmp_path / "a.ply"), mmap=False)
    ply["vertex"].data["opacity"][:2] = np.inf, -np.inf
    ply["vertex"].data["scale_2"][2] = -np.inf
    ply.write(str(tmp_path / "a.ply"))
    cloud = model_import.import_model(tmp_path / "a.ply").data
    np.testing.assert_allclose(point_cloud.read_attribute(cloud, "radiance:base")[:, 3], [1.0, 0.0, 0.5])
    assert np.isfinite(point_cloud.read_attribute(cloud, "scale")).all()


def test_undo_and_redo_of_an_import(registered, make_model, write):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())))
    bpy.ops.ed.undo_push(message="import")
    bpy.ops.ed.undo()
    assert len(bpy.data.objects) == 0
    bpy.ops.ed.redo()
    assert len(bpy.data.objects[0].data.points) == 40
    assert bpy.data.objects[0].modifiers[0].node_group is not None


def lines_run(call: Callable[[], object]) -> int:
    """How many lines of ours ``call`` runs, in all its threads: a loop counts each time round."""
    count, ours = 0, str(Path(physhdr.__file__).parent)

    def trace(frame, event, argument):
        nonlocal count
        if not frame.f_code.co_filename.startswith(ours):
            return None
        count += event == "line"
        return trace

    threading.settrace(trace)
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(None)
        threading.settrace(None)
    return count


def test_no_python_runs_for_each_gaussian(scene, make_model):
    """So that a million take a second or two: arrays are filled whole, or in blocks of hundreds."""
    small, large = (make_model(count=count, degree=1) for count in (5_000, 25_000))
    grown = lines_run(lambda: point_cloud.build_point_cloud(large, "large"))
    grown -= lines_run(lambda: point_cloud.build_point_cloud(small, "small"))
    assert grown < 20_000 / 10
