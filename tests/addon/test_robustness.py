# SPDX-License-Identifier: GPL-3.0-or-later
"""Undo, saving, appending, linking, copying, deleting, several models: imported models survive it all."""

import dataclasses

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import physhdr  # noqa: E402
from physhdr.addon.model import look, model_import, nodes, point_cloud  # noqa: E402
from physhdr.addon.model.attributes import Attribute  # noqa: E402


@pytest.fixture
def response():
    """Fields of a model's learned response; ``shift`` makes another one of it."""

    def response(shift: float = 0.0):
        x = np.linspace(-12.0, 8.0, 256, dtype=np.float32)
        curve = 1.0 / (1.0 + np.exp(-np.outer(x, [0.7, 1.0, 1.3]) - shift))
        return {"tone_curve_log_exposure": x, "tone_curve": curve.astype(np.float32)}

    return response


def radiance(target, name: str = "physhdr:radiance") -> np.ndarray:
    geometry = target.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    return point_cloud.read_attribute(geometry.instances_pointcloud(), name)[:, :3]


def constant(model) -> np.ndarray:
    """The mean ln radiance at level 1; the test models' random log gains are not 0 there."""
    return np.exp(0.28209479 * model.log_radiance_sh[:, 0] + model.log_gain(1.0))


def add_fixed(model, write):
    """Import without dependence on the view, so that a picture's numbers need no camera."""
    target = model_import.import_model(write(model))
    nodes.set_input(target.modifiers[0], nodes.VIEW_DEPENDENT, False)
    return target


def test_registers_and_unregisters_twice_with_models_in_the_file(scene, make_model, write):
    for _ in range(2):
        physhdr.register()
        bpy.ops.physhdr.model_import(filepath=str(write(make_model())))
        assert "model_bake" in dir(bpy.ops.physhdr) and hasattr(bpy.types, "PHYSHDR_FH_gaussians")
        physhdr.unregister()
        assert not hasattr(bpy.types, "PHYSHDR_OT_model_bake")
        assert not hasattr(bpy.types, "PHYSHDR_FH_gaussians")
    assert len(bpy.data.objects) == 2


def test_undo_and_redo_of_an_import_and_of_a_slider(registered, make_model, write):
    model = make_model()
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.physhdr.model_import(filepath=str(write(model)), viewport="NODES")
    bpy.ops.ed.undo_push(message="import")
    modifier = nodes.find_modifier(bpy.context.object)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    nodes.set_input(modifier, nodes.EXPOSURE, 2.0)
    bpy.ops.ed.undo_push(message="slider")
    for _ in range(2):
        bpy.ops.ed.undo()
        bpy.ops.ed.undo()
        assert not bpy.data.objects
        bpy.ops.ed.redo()
        assert look.look_of(bpy.data.objects[0]) == look.Look()
        bpy.ops.ed.redo()
        target = bpy.data.objects[0]
        assert look.look_of(target).exposure_ev == 2.0
        np.testing.assert_allclose(radiance(target), 4.0 * constant(model), rtol=1e-5)
        np.testing.assert_array_equal(
            point_cloud.read_attribute(target.data, "physhdr:log_sh_3"), model.log_radiance_sh[:, 3]
        )


def test_linked_from_a_library_it_renders_and_imports_go_on(registered, make_model, write, tmp_path):
    model = make_model()
    name = add_fixed(model, write).name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    linked = bpy.data.objects[name]
    bpy.context.scene.collection.objects.link(linked)
    assert linked.library and look.is_model(linked)
    assert look.look_of(linked).view_dependent is False
    np.testing.assert_allclose(radiance(linked), constant(model), rtol=1e-5)
    # A model imported now gets a tree of its own: a library's cannot be edited and may go away.
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    own = bpy.context.object
    assert own.modifiers[0].node_group.library is None and linked.modifiers[0].node_group.library is not None
    override = linked.override_create(remap_local_usages=True)
    nodes.set_input(nodes.find_modifier(override), nodes.EXPOSURE, 1.0)
    np.testing.assert_allclose(radiance(override), 2.0 * constant(model), rtol=1e-5)


def test_appended_by_a_script_next_to_its_like_it_is_independent(registered, make_model, write, tmp_path):
    model = make_model()
    name = add_fixed(model, write).name
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    here = add_fixed(model, write)
    with bpy.data.libraries.load(str(tmp_path / "other.blend"), link=False) as (_, wanted):
        wanted.objects = [name]
    appended = wanted.objects[0]
    bpy.context.scene.collection.objects.link(appended)
    nodes.set_input(nodes.find_modifier(appended), nodes.EXPOSURE, 3.0)
    np.testing.assert_allclose(radiance(appended), 8.0 * constant(model), rtol=1e-5)
    np.testing.assert_allclose(radiance(here), constant(model), rtol=1e-5)
    assert sum(map(look.is_model, bpy.context.scene.objects)) == 2


def test_models_of_different_degree_modulator_and_response_side_by_side(scene, make_model, write, response):
    models = [
        make_model(count=20, degree=0, seed=1),
        make_model(count=30, degree=3, seed=2),
        make_model(count=25, degree=2, modulator="baked-levels", seed=3),
        dataclasses.replace(make_model(count=15, degree=0, seed=4), **response()),
        dataclasses.replace(make_model(count=15, degree=0, seed=4), **response(0.5)),
    ]
    targets = [add_fixed(model, write) for model in models]
    assert len({target.modifiers[0].node_group.name for target in targets}) == 5
    assert len(bpy.data.materials) == 2
    for index, target in enumerate(targets):
        nodes.set_input(target.modifiers[0], nodes.EXPOSURE, float(index))
    for index, (target, model) in enumerate(zip(targets, models, strict=True)):
        np.testing.assert_allclose(radiance(target), 2.0**index * constant(model), rtol=1e-5)


def test_models_of_one_camera_share_the_tree(scene, make_model, write, response):
    for seed in range(2):
        add_fixed(dataclasses.replace(make_model(seed=seed), **response()), write)
    assert sum(nodes.MARK in tree for tree in bpy.data.node_groups) == 1


def test_a_duplicate_and_a_linked_duplicate(registered, make_model, write):
    model = make_model()
    target = add_fixed(model, write)
    for linked in (False, True):
        target.select_set(True)
        bpy.context.view_layer.objects.active = target
        bpy.ops.object.duplicate(linked=linked)
        copy = bpy.context.object
        assert (copy.data == target.data) is linked
        nodes.set_input(nodes.find_modifier(copy), nodes.LIGHTING_LEVEL, 0.0)
        np.testing.assert_allclose(
            radiance(copy), constant(model) * (1.0 - model.light_share[:, 0]), rtol=1e-4, atol=1e-7
        )
        np.testing.assert_allclose(radiance(target), constant(model), rtol=1e-5)
        copy.select_set(False)


def test_deleted_and_purged_nothing_is_left_and_the_next_import_works(registered, make_model, write):
    path = str(write(make_model()))
    for _ in range(2):
        bpy.ops.physhdr.model_import(filepath=path)
        bpy.ops.object.delete()
        bpy.ops.outliner.orphans_purge(do_recursive=True)
        assert not (bpy.data.objects or bpy.data.pointclouds or bpy.data.node_groups or bpy.data.materials)


def test_points_that_were_deleted_stay_away(scene, make_model, write):
    """A user cuts a model: what is left keeps its numbers (by geometry nodes and applying, or edit mode)."""
    model = make_model(count=40)
    target = add_fixed(model, write)
    keep = bpy.data.pointclouds.new("kept")
    keep.resize(10)
    for key in target.data.keys():  # noqa: SIM118
        keep[key] = target.data[key]
    for attribute in target.data.attributes:
        values = point_cloud.read_attribute(target.data, attribute.name)[:10]
        point_cloud.write_attribute(keep, Attribute(attribute.name, attribute.data_type), values)
    target.data = keep
    np.testing.assert_allclose(radiance(target), constant(model)[:10], rtol=1e-5)
    assert point_cloud.model_of(keep).count == 10


# ---- the learned tone mapper -------------------------------------------------------------------------


def test_the_standard_view_shows_the_learned_code(scene, make_model, write, response):
    """Encoded as sRGB the value is the response at ln(radiance · 2^EV), to a tenth of an 8-bit code."""
    model = dataclasses.replace(make_model(count=300), **response(0.2))
    target = add_fixed(model, write)
    nodes.set_input(target.modifiers[0], nodes.TONE_MAPPER, True)
    for exposure in (-6.0, 0.0, 2.5, 12.0):
        nodes.set_input(target.modifiers[0], nodes.EXPOSURE, exposure)
        linear = radiance(target)
        shown = np.where(
            linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
        )
        x = np.log(constant(model)) + exposure * np.log(2.0)
        expected = 1.0 / (1.0 + np.exp(-np.clip(x, -12.0, 8.0) * [0.7, 1.0, 1.3] - 0.2))
        np.testing.assert_allclose(shown, expected, atol=4e-4)


def test_the_tone_mapper_is_off_at_first_and_absent_without_a_response(scene, make_model, write, response):
    plain = add_fixed(make_model(), write)
    assert not nodes.has_input(plain.modifiers[0], nodes.TONE_MAPPER)
    with pytest.raises(KeyError, match="Learned tone mapper"):
        nodes.set_input(plain.modifiers[0], nodes.TONE_MAPPER, True)
    model = dataclasses.replace(make_model(), **response())
    toned = add_fixed(model, write)
    np.testing.assert_allclose(radiance(toned), constant(model), rtol=1e-5)


def test_a_tree_of_an_older_version_keeps_working(scene, make_model, write):
    """Its mark is another one: a new import makes a tree of its own, and the old sliders are still found."""
    model = make_model()
    old = add_fixed(model, write)
    tree = old.modifiers[0].node_group
    tree[nodes.MARK] = "1 degree 1 levels []"
    new = add_fixed(model, write)
    assert new.modifiers[0].node_group != tree
    nodes.set_input(nodes.find_modifier(old), nodes.EXPOSURE, 1.0)
    assert look.look_of(old).exposure_ev == 1.0 and look.look_of(new).exposure_ev == 0.0
    np.testing.assert_allclose(radiance(old), 2.0 * constant(model), rtol=1e-5)
