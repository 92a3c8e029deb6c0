# SPDX-License-Identifier: GPL-3.0-or-later
"""What a model's point cloud holds for Blender 5.3, which draws splats itself, by what is documented of it.

Its decode is written here anew: ½ + Σ sh·Y is an sRGB code, which it makes linear. There is no 5.3 to try
it on where these were written; what needs one says so and runs where there is one.
"""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import attributes, model_import, native, nodes, point_cloud  # noqa: E402
from physhdr.addon.rendering.render import add_camera  # noqa: E402
from physhdr.bridge import native_splats, spherical_harmonics  # noqa: E402
from physhdr.bridge.model_file import Model  # noqa: E402

C0 = 0.28209479177387814
HAS_SPLATS = bpy.app.version >= (5, 3, 0)


def decoded(code: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, from a code to linear."""
    return np.where(code <= 0.04045, code / 12.92, (np.maximum(code, 0.0) + 0.055) ** 2.4 / 1.055**2.4)


def shown(cloud, direction: np.ndarray) -> np.ndarray:
    """``[N, 3]``: linear colours that 5.3 shows toward a camera that sees along ``direction``."""
    code = 0.5 + C0 * point_cloud.read_attribute(cloud, "radiance:base")[:, :3]
    basis = spherical_harmonics.basis(direction[None], 3)[0]
    for k, values in enumerate(point_cloud.read_numbered(cloud, attributes.SHOWN_SH), 1):
        code = code + values * basis[k]
    return decoded(code)


def values(cloud, name: str) -> np.ndarray:
    return point_cloud.read_attribute(cloud, name)


# ---- what is imported ------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_layout_is_blenders(scene, make_model, degree: int):
    cloud = point_cloud.build_point_cloud(make_model(degree=degree), "model")
    types = {each.name: (each.data_type, each.domain) for each in cloud.attributes}
    for name, kind in (
        ("position", "FLOAT_VECTOR"),
        ("scale", "FLOAT_VECTOR"),
        ("rotation", "QUATERNION"),
        ("radiance:base", "FLOAT4"),
        *((f"radiance:sh_{k}", "FLOAT_VECTOR") for k in range((degree + 1) ** 2 - 1)),
    ):
        assert types[name] == (kind, "POINT"), name
    assert f"radiance:sh_{(degree + 1) ** 2 - 1}" not in types
    base = values(cloud, "radiance:base")
    # Eight bits over this range are a display's eight bits; radiance goes up to hundreds here.
    code = 0.5 + C0 * base[:, :3]
    assert code.min() >= -1e-6 and code.max() <= 1.0 + 1e-6
    assert base[:, 3].min() >= 0.0 and base[:, 3].max() <= 1.0
    for sh in point_cloud.read_numbered(cloud, attributes.SHOWN_SH):
        assert np.abs(sh).max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(values(cloud, "rotation"), axis=1), 1.0, atol=1e-6)


def test_colours_of_degree_0_decode_to_the_radiance_up_to_white(scene, make_model):
    model = make_model(count=500, degree=0)
    model = Model(**{**model.__dict__, "log_radiance_sh": 2.0 * model.log_radiance_sh})
    cloud = point_cloud.build_point_cloud(model, "model")
    radiance = np.exp(C0 * model.log_radiance_sh[:, 0])
    assert radiance.max() > 20.0 and radiance.min() < 0.003
    np.testing.assert_allclose(
        shown(cloud, np.array([0, 0, 1.0])), np.minimum(radiance, 1.0), rtol=1e-4, atol=1e-7
    )


def test_colours_of_degree_3_decode_to_the_radiance_toward_every_side(scene, make_model):
    """In codes, as they are packed and seen; what a trained model's SH vary by."""
    model = make_model(count=300, degree=3)
    sh = np.array(model.log_radiance_sh)
    sh[:, 1:] *= 0.2
    sh[:, 0] -= 3.0  # mostly below white
    model = Model(**{**model.__dict__, "log_radiance_sh": sh})
    cloud = point_cloud.build_point_cloud(model, "model")
    errors = []
    for direction in spherical_harmonics.fibonacci_sphere(40):
        radiance = model.radiance(np.broadcast_to(direction, (model.count, 3)))
        wanted, found = np.minimum(radiance, 1.0), np.clip(shown(cloud, direction), 0.0, None)
        errors.append(np.abs(wanted ** (1 / 2.4) - found ** (1 / 2.4)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.01


def test_absurd_radiance_is_white_or_black(scene):
    for log_radiance, code in ((1e4, 1.0), (-1e4, 0.0)):
        sh = np.zeros((2, 4, 3), np.float32)
        sh[:, 0] = log_radiance
        shown = native_splats.shown_sh(sh)
        np.testing.assert_allclose(0.5 + C0 * shown[:, 0], code, atol=1e-6)
        np.testing.assert_allclose(shown[:, 1:], 0.0, atol=1e-6)


def test_a_plys_colours_stay_as_its_file_has_them(scene, make_model):
    colour_sh = np.random.default_rng(1).normal(0.0, 3.0, (40, 4, 3)).astype(np.float32)
    cloud = point_cloud.build_point_cloud(make_model(), "model", colour_sh)
    np.testing.assert_array_equal(values(cloud, "radiance:base")[:, :3], colour_sh[:, 0])
    np.testing.assert_array_equal(values(cloud, "radiance:sh_2"), colour_sh[:, 3])


def test_no_scale_is_zero_and_no_other_is_changed(scene, make_model):
    model = make_model(count=100)
    assert native_splats.packable(model.scale) is model.scale
    scale = model.scale.copy()
    scale[:7, 2] = 0.0
    scale[7] = 0.0
    flat = Model(**{**model.__dict__, "scale": scale})
    cloud = point_cloud.build_point_cloud(flat, "model")
    found, floor = values(cloud, "scale"), 1e-4 * np.median(scale.max(axis=1))
    np.testing.assert_allclose(found[:7, 2], floor, rtol=1e-5)
    np.testing.assert_allclose(found[7], floor, rtol=1e-5)
    np.testing.assert_array_equal(found[8:], scale[8:])
    np.testing.assert_array_equal(found[:7, :2], scale[:7, :2])
    # Nine bits of the logarithm's range: steps of a few per cent, where a zero would leave one step in all.
    steps = (np.log(found.max()) - np.log(found.min())) / 511.0
    assert steps < 0.05


# ---- what is converted -----------------------------------------------------------------------------------


@pytest.fixture
def typed(monkeypatch):
    """What the type of clouds is set to, where this Blender's clouds have none."""
    kinds: dict[str, str] = {}
    if not HAS_SPLATS:
        monkeypatch.setattr(native, "_set_type", lambda cloud, kind: kinds.update({cloud.name: kind}))
    return kinds


class Points:
    """What the modifier puts out: values and types by name. (The geometry itself ends with its set.)"""

    def __init__(self, target: bpy.types.Object) -> None:
        bpy.context.view_layer.update()
        depsgraph = bpy.context.evaluated_depsgraph_get()
        geometry = target.evaluated_get(depsgraph).evaluated_geometry()
        assert geometry.instances_pointcloud() is None
        cloud = geometry.pointcloud
        self.type = getattr(cloud, "type", "")
        self.types = {each.name: each.data_type for each in cloud.attributes}
        self.values = {
            name: values(cloud, name) for name in self.types if self.types[name] in attributes.TYPES
        }

    def __len__(self) -> int:
        return len(self.values["position"])


def model_in_the_scene(model: Model, path) -> bpy.types.Object:
    from physhdr.bridge.model_file import write_model

    write_model(path, model)
    target = model_import.import_model(path)
    add_camera(bpy.context.scene, np.array([[1, 0, 0, 0.0], [0, 0, -1, -4], [0, 1, 0, 0], [0, 0, 0, 1]]), 0.9)
    return target


@pytest.mark.parametrize("lights", [("ambient",), ("sky", "lamp")])
def test_a_converted_model_puts_out_points_with_the_look_of_its_sliders(
    scene, make_model, typed, tmp_path, lights
):
    model = make_model(count=60, degree=2, lights=lights)
    target = model_in_the_scene(model, tmp_path / "model.safetensors")
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.EXPOSURE, -1.5)
    levels = [0.25] if len(lights) == 1 else [2.0, 0.5]
    for index, level in enumerate(levels):
        nodes.set_input(modifier, nodes.level_input(lights, index), level)
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, True)  # which means nothing to splats
    native.convert(target)
    assert typed.get(target.data.name, native.SPLATS) == "GAUSSIAN_SPLAT"
    for index, level in enumerate(levels):
        identifier = nodes.input_identifier(modifier, nodes.level_input(lights, index))
        assert getattr(nodes.inputs_of(modifier), identifier).value == level, "sliders keep their values"

    points = Points(target)
    visible = model.opacity > 1.0 / 255.0
    assert len(points) == visible.sum()
    offset = model.position[visible] - (0.0, -4.0, 0.0)
    direction = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    basis = spherical_harmonics.basis(direction, 2)
    at_1 = np.exp(np.einsum("nk,nkc->nc", basis, model.log_radiance_sh[visible]))
    share = model.light_share[visible]
    gain = 1.0 - share.sum(axis=1) + np.einsum("k,nkc->nc", levels, share)
    radiance = at_1 * gain * 2.0**-1.5
    found = points.values["physhdr:radiance"]
    np.testing.assert_allclose(found[:, :3], radiance, rtol=2e-3, atol=1e-6)  # HDR, above white too
    assert radiance.max() > 2.0
    np.testing.assert_allclose(found[:, 3], model.opacity[visible], rtol=1e-6)
    # Without the material: as it was imported.
    for name in ("radiance:base", "radiance:sh_0", "radiance:sh_7"):
        np.testing.assert_array_equal(points.values[name], values(target.data, name)[visible])
    assert points.types["radiance:base"] == "FLOAT4"
    np.testing.assert_allclose(points.values["radiance:base"][:, 3], model.opacity[visible], rtol=1e-6)
    np.testing.assert_allclose(points.values["scale"], model.scale[visible], rtol=1e-4)


def test_the_width_of_a_picture_widens_native_splats_as_it_does_instances(scene, make_model, typed, tmp_path):
    """0.3 pixel² of variance, at 0.9 rad over 50 pixels: none is left out with Blender's own dilation off."""
    model = make_model(count=30)
    target = model_in_the_scene(model, tmp_path / "model.safetensors")
    native.convert(target)
    nodes.set_input(nodes.find_modifier(target), nodes.IMAGE_WIDTH, 50)
    points = Points(target)
    visible = model.opacity > 1.0 / 255.0
    depth = model.position[visible][:, 1] + 4.0
    pixel = 2.0 * np.tan(0.45) * depth / 50.0
    wanted = np.sqrt(model.scale[visible] ** 2 + 0.3 * pixel[:, None] ** 2)
    np.testing.assert_allclose(points.values["scale"], wanted, rtol=2e-3)


def test_a_keyframed_model_is_converted_and_taken_back(scene, make_model, typed, tmp_path):
    """Keyframes find their input afterwards."""
    model = make_model(count=20, degree=1)
    target = model_in_the_scene(model, tmp_path / "model.safetensors")
    cloud, modifier = target.data, nodes.find_modifier(target)
    path = nodes.input_data_path(modifier, nodes.LIGHTING_LEVEL)
    for frame, level in ((1, 1.0), (11, 3.0)):
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        target.keyframe_insert(path, frame=frame)
    before = modifier.node_group
    native.convert(target)
    assert modifier.node_group is not before and bpy.data.node_groups.get(before.name) is before
    assert np.abs(values(cloud, "radiance:base")[:, :3]).max() < 1.78
    assert [material.name for material in cloud.materials] == ["PhysHDR Native Splats"]
    brightness = []
    for frame in (1, 11):
        bpy.context.scene.frame_set(frame)
        brightness.append(Points(target).values["physhdr:radiance"][:, :3])
    gain = brightness[1] / brightness[0]
    visible = model.opacity > 1.0 / 255.0
    np.testing.assert_allclose(gain, 1.0 + 2.0 * model.light_share[visible][:, 0], rtol=5e-3)
    other = target.copy()
    bpy.context.scene.collection.objects.link(other)
    native.prepare(other)
    assert len([tree for tree in bpy.data.node_groups if "native" in tree.name]) == 1, "made once"
    if HAS_SPLATS:
        native.revert(target)
        assert modifier.node_group is before and not native.is_native(cloud)


def test_a_model_without_its_modifier_gets_one(scene, make_model, typed, tmp_path):
    target = model_in_the_scene(make_model(), tmp_path / "model.safetensors")
    target.modifiers.clear()
    native.convert(target)
    assert nodes.find_modifier(target) is not None and len(Points(target))


def test_another_cloud_is_refused_before_anything_changes(scene, typed):
    cloud = bpy.data.pointclouds.new("points")
    cloud.resize(3)
    target = bpy.data.objects.new("points", cloud)
    bpy.context.scene.collection.objects.link(target)
    with pytest.raises(point_cloud.DataMismatchError, match="no PhysHDR model"):
        native.convert(target)
    assert not target.modifiers and not cloud.materials and not typed


# ---- by version ------------------------------------------------------------------------------------------


@pytest.mark.skipif(HAS_SPLATS, reason="this Blender draws splats itself")
def test_before_5_3_the_button_says_why_and_draws_nothing(registered, make_model, tmp_path):
    target = model_in_the_scene(make_model(), tmp_path / "model.safetensors")
    bpy.context.view_layer.objects.active = target
    assert not native.available() and not native.is_native(target.data)
    assert native.why_not() == f"Blender 5.3 and newer draw Gaussian splats; this is {bpy.app.version_string}"
    assert not bpy.ops.physhdr.native_convert.poll()
    with pytest.raises(RuntimeError, match=r"5\.3 and newer"):
        bpy.ops.physhdr.native_convert()


@pytest.mark.skipif(not HAS_SPLATS, reason="needs Blender 5.3, which draws splats itself")
def test_from_5_3_on_one_click_makes_it_native_and_one_takes_it_back(registered, make_model, tmp_path):
    target = model_in_the_scene(make_model(), tmp_path / "model.safetensors")
    bpy.context.view_layer.objects.active = target
    target.select_set(True)
    assert bpy.ops.physhdr.native_convert() == {"FINISHED"}
    assert target.data.type == "GAUSSIAN_SPLAT" and Points(target).type == "GAUSSIAN_SPLAT"
    assert bpy.ops.physhdr.native_revert() == {"FINISHED"}
    assert target.data.type != "GAUSSIAN_SPLAT"


@pytest.mark.skipif(HAS_SPLATS, reason="the real one is tested above")
def test_the_operators_as_they_go_from_5_3_on(registered, make_model, tmp_path, typed, monkeypatch):
    """All that surrounds the type, which this Blender does not have: several at once, and the 3D view."""
    monkeypatch.setattr(native, "available", lambda: True)
    monkeypatch.setattr(native, "is_native", lambda cloud: typed.get(cloud.name) == native.SPLATS)
    targets = []
    for name in ("one", "two"):
        target = model_in_the_scene(make_model(), tmp_path / f"{name}.safetensors")
        target.physhdr_viewport = "SPLATS"
        target.select_set(True)
        targets.append(target)
    bpy.context.view_layer.objects.active = targets[0]
    assert not bpy.ops.physhdr.native_revert.poll()
    assert bpy.ops.physhdr.native_convert() == {"FINISHED"}
    assert set(typed.values()) == {"GAUSSIAN_SPLAT"} and len(typed) == 2
    assert not bpy.ops.physhdr.native_convert.poll(), "they are native now"
    for target in targets:
        modifier = nodes.find_modifier(target)
        assert target.physhdr_viewport == "NODES" and modifier.show_viewport
        assert target.display_type == "TEXTURED", "nothing of ours stands in the way of Blender's drawing"
        assert len(Points(target)) == 40


def test_the_version_is_asked_in_one_place():
    """Of all that Blender loads, only native.py looks at the version or at the type of a cloud."""
    from pathlib import Path

    root = Path(native.__file__).parent
    asking = {
        path.name
        for path in root.rglob("*.py")
        if "bpy.app.version " in (text := path.read_text()) or "GAUSSIAN_SPLAT" in text
    }
    assert asking == {"native.py"}
