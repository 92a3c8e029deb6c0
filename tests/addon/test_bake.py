# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking the current look to a PLY: the numbers of the look, of the trainer's exporter, in world space."""

import dataclasses
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge import srgb
from physhdr.bridge.affine import matrices_of
from physhdr.bridge.gaussian_ply import read_ply
from physhdr.bridge.spherical_harmonics import basis

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import look, model_import, nodes, point_cloud  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def make_toned(make_model):
    """A model with a response, a different one for each colour."""

    def make(**options):
        x = np.linspace(-12.0, 8.0, 256, dtype=np.float32)
        curve = 1.0 / (1.0 + np.exp(-np.outer(x, [0.7, 1.0, 1.3]) - [0.0, 0.3, -0.4]))
        return dataclasses.replace(
            make_model(**options), tone_curve_log_exposure=x, tone_curve=curve.astype(np.float32)
        )

    return make


def colour_sh(columns: dict[str, np.ndarray]) -> np.ndarray:
    """``[N, K, 3]`` of a PLY's columns, by the format's rule: channel by channel."""
    rest = sum(name.startswith("f_rest_") for name in columns) // 3
    sh = [np.stack([columns[f"f_dc_{c}"] for c in range(3)], axis=1)]
    sh += [np.stack([columns[f"f_rest_{c * rest + k}"] for c in range(3)], axis=1) for k in range(rest)]
    return np.stack(sh, axis=1)


@pytest.mark.parametrize(
    ("modulator", "lights"),
    [("additive", ("ambient",)), ("additive", ("sun", "Küche 2")), ("baked-levels", ("ambient",))],
)
def test_a_point_cloud_is_its_model_again(scene, make_toned, write, modulator, lights):
    model = make_toned(degree=2, modulator=modulator, lights=lights)
    back = point_cloud.model_of(model_import.import_model(write(model)).data)
    assert back.tensors().keys() == model.tensors().keys()
    for name, array in model.tensors().items():
        expected = array / np.linalg.norm(array, axis=1, keepdims=True) if name == "rotation" else array
        np.testing.assert_allclose(getattr(back, name), expected, atol=1e-7, err_msg=name)
    assert (back.levels, back.exposures, back.lights) == (model.levels, model.exposures, model.lights)
    assert dict(back.metadata) == dict(model.metadata)


def test_the_operator_bakes_the_look_of_the_sliders(registered, make_toned, write, tmp_path):
    model = make_toned(degree=1)
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    modifier = nodes.find_modifier(bpy.context.object)
    nodes.set_input(modifier, nodes.EXPOSURE, 1.5)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 2.0)
    nodes.set_input(modifier, nodes.TONE_MAPPER, True)
    assert bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "baked.ply")) == {"FINISHED"}
    ply = read_ply(tmp_path / "baked.ply")
    assert ply.comments[-1].endswith("through the learned response, baked at EV 1.5, lighting level 2")
    sh, errors = colour_sh(ply.columns), []
    for direction in np.random.default_rng(0).normal(size=(30, 3)):
        direction /= np.linalg.norm(direction)
        radiance = 2**1.5 * model.radiance(np.broadcast_to(direction, (model.count, 3)), 2.0)
        expected = 1.0 / (1.0 + np.exp(-np.log(radiance) * [0.7, 1.0, 1.3] - [0.0, 0.3, -0.4]))
        errors.append(0.5 + np.einsum("k,nkc->nc", basis(direction[None], 1)[0], sh) - expected)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    np.testing.assert_array_equal(ply.columns["x"], model.position[:, 0])
    nodes.set_input(modifier, nodes.TONE_MAPPER, False)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "flat.ply"))
    flat = read_ply(tmp_path / "flat.ply")
    assert "f_rest_0" not in flat.columns and "sRGB curve" in flat.comments[-1]
    constant = np.exp(0.5 / math.sqrt(math.pi) * model.log_radiance_sh[:, 0])
    relit = 2**1.5 * constant * (1.0 + model.light_share[:, 0])
    shown = 0.5 + 0.28209479 * colour_sh(flat.columns)[:, 0]
    np.testing.assert_allclose(shown, srgb.to_srgb(relit), rtol=1e-4, atol=1e-5)


def test_beyond_the_levels_of_a_model_the_file_says_the_level_that_it_has(
    registered, make_model, write, tmp_path, capfd
):
    """A model of baked levels knows nothing beyond them; its colours are those of the nearest."""
    bpy.ops.physhdr.model_import(filepath=str(write(make_model(degree=0, modulator="baked-levels"))))
    nodes.set_input(nodes.find_modifier(bpy.context.object), nodes.LIGHTING_LEVEL, 7.0)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "baked.ply"))
    assert read_ply(tmp_path / "baked.ply").comments[-1].endswith("lighting level 4")
    told = capfd.readouterr().out
    assert "lighting level 4" in told and "level 7" not in told


def test_a_bake_of_several_lights_is_the_models_radiance_at_their_levels(
    registered, make_model, write, tmp_path
):
    """View-independent, through the sRGB curve: exact, at levels between, beyond and off."""
    lights = ("ambient", "pendant", "screen")
    model = make_model(degree=0, lights=lights)
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    modifier = nodes.find_modifier(bpy.context.object)
    for levels in [(0.25, 1.0, 3.0), (1.0, 0.0, 9.0), (0.5, 2.0, 0.125)]:
        for index, level in enumerate(levels):
            nodes.set_input(modifier, nodes.level_input(lights, index), level)
        bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "baked.ply"))
        ply = read_ply(tmp_path / "baked.ply")
        words = " + ".join(f"{name} {level:g}" for name, level in zip(lights, levels, strict=True))
        assert ply.comments[-1].endswith(f"baked at EV 0, lighting levels {words}")
        radiance = model.radiance(np.tile([0.0, 0.0, 1.0], (model.count, 1)), levels)
        shown = 0.5 + 0.28209479 * colour_sh(ply.columns)[:, 0]
        np.testing.assert_allclose(shown, srgb.to_srgb(radiance), rtol=1e-4, atol=1e-5)


EXPORT = """
import sys
from pathlib import Path
import numpy as np, torch
from physhdr.backend.export.blender_model import to_model
from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.methods.physhdr_common import PhysHDRConfig
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.bridge.display import display_colour_sh
from physhdr.bridge.gaussian_ply import write_standard_ply
from physhdr.bridge.model_file import write_model
from physhdr.lab.peers.paper import PaperConfig


def export(out, config):
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    gaussians = initial_gaussians(
        rng.normal(size=(50, 3)), rng.normal(0, 2, (50, 3)), sh_degree=3, opacity=0.5,
        ambient_share=0.3 if config.has_light_share else None, context_size=0, seed=0,
    )
    for tensor in gaussians.parameters.values():
        tensor.data += 0.1 * torch.randn_like(tensor)
    method = METHODS[config.name].make(config, gaussians, MethodSetup((1.0, 0.73)))
    for tensor in method.parameters():
        tensor.data += 0.05 * torch.randn_like(tensor)
    model = to_model(method, np.zeros(3), (1.0,), {"scene": "test", "method": "m", "iteration": "1"})
    write_model(out / "model.safetensors", model)
    write_standard_ply(
        out / "baked.ply", model.position, model.rotation, model.scale, model.opacity,
        display_colour_sh(model, 2.0**0.75, 0.5),
    )
    # The networks themselves at the constant part: what the sampled response must reproduce.
    with torch.no_grad():
        log = torch.from_numpy(model.log_radiance_sh[:, 0] * 0.28209479 + model.log_gain(0.5))
        log = log + 0.75 * np.log(2.0)
        code = method.tone_mapper.curve_logits(log.T.float().contiguous()).sigmoid().T
    np.save(out / "code.npy", code.numpy())


for name, config in (("product", PhysHDRConfig()), ("learned", PaperConfig())):
    out = Path(sys.argv[1], name)
    out.mkdir()
    export(out, config)
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """A folder for each composer with what the trainer exports: one process, torch is slow to load."""
    python = ROOT / ".venvs/backend/bin/python"
    if not python.exists():
        pytest.skip("no backend environment: run make setup")
    folder = tmp_path_factory.mktemp("exported")
    subprocess.run([str(python), "-c", EXPORT, str(folder)], check=True)
    return folder


@pytest.mark.long  # the trainer's process starts for longer than all else here takes
@pytest.mark.parametrize("composer", ["product", "learned"])
def test_the_same_numbers_as_the_trainers_exporter(registered, exported, tmp_path, composer):
    theirs = exported / composer
    bpy.ops.physhdr.model_import(filepath=str(theirs / "model.safetensors"))
    modifier = nodes.find_modifier(bpy.context.object)
    nodes.set_input(modifier, nodes.EXPOSURE, 0.75)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 0.5)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "ours.ply"), tone="LEARNED")
    baked, ours = read_ply(theirs / "baked.ply").columns, read_ply(tmp_path / "ours.ply").columns
    assert list(baked) == list(ours)
    for name, column in baked.items():
        np.testing.assert_allclose(ours[name], column, atol=2e-6, err_msg=name)
    nodes.set_input(modifier, nodes.VIEW_DEPENDENT, False)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "flat.ply"), tone="LEARNED")
    shown = 0.5 + 0.28209479 * colour_sh(read_ply(tmp_path / "flat.ply").columns)[:, 0]
    np.testing.assert_allclose(shown, np.load(theirs / "code.npy"), atol=1e-3)


def test_in_world_space_whatever_the_objects_transform(registered, make_toned, write, tmp_path, scene):
    """The same colours and shapes as the transformed object has: with a scale that is not uniform, too."""
    model = make_toned(degree=1)
    bpy.ops.physhdr.model_import(filepath=str(write(model)))
    target = bpy.context.object
    target.location, target.rotation_euler, target.scale = (1, 2, 3), (0.3, -0.8, 1.9), (0.5, 2.0, 1.0)
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"), tone="LEARNED")
    matrix = np.array(target.matrix_world, np.float64)
    columns = read_ply(tmp_path / "a.ply").columns
    position = np.stack([columns[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(position, model.position @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-5)

    def covariance(rotation, scale):
        unit = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
        axes = matrices_of(unit) * scale[:, None]
        return axes @ axes.transpose(0, 2, 1)

    baked = covariance(
        np.stack([columns[f"rot_{i}"] for i in range(4)], axis=1),
        np.exp(np.stack([columns[f"scale_{i}"] for i in range(3)], axis=1)),
    )
    expected = matrix[:3, :3] @ covariance(model.rotation, model.scale) @ matrix[:3, :3].T
    np.testing.assert_allclose(baked, expected, atol=1e-4 * np.abs(expected).max())

    sh, errors = colour_sh(columns), []
    for direction in np.random.default_rng(0).normal(size=(30, 3)):
        direction /= np.linalg.norm(direction)
        local = np.linalg.inv(matrix[:3, :3]) @ direction
        local /= np.linalg.norm(local)
        log_exposed = np.log(model.radiance(np.broadcast_to(local, (model.count, 3))))
        code = 1.0 / (1.0 + np.exp(-log_exposed * [0.7, 1.0, 1.3] - [0.0, 0.3, -0.4]))
        errors.append(0.5 + np.einsum("k,nkc->nc", basis(direction[None], 1)[0], sh) - code)
    assert np.sqrt(np.mean(np.square(errors))) < 0.03
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "b.ply"), tone="LEARNED", apply_transform=False)
    np.testing.assert_array_equal(read_ply(tmp_path / "b.ply").columns["x"], model.position[:, 0])


def test_an_imported_ply_bakes_to_itself(registered, make_model, tmp_path):
    """Bake, import, bake again: nothing drifts."""
    from physhdr.bridge.gaussian_ply import write_standard_ply

    rng = np.random.default_rng(0)
    sh = rng.normal(0.0, 0.03, (100, 4, 3))
    sh[:, 0] = rng.uniform(-0.8, 1.5, (100, 3))
    model = make_model(count=100)
    rotations = model.rotation / np.linalg.norm(model.rotation, axis=1, keepdims=True)
    write_standard_ply(
        tmp_path / "a.ply", model.position, rotations, model.scale, model.opacity, sh.astype(np.float32)
    )
    bpy.ops.physhdr.model_import(filepath=str(tmp_path / "a.ply"))
    bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "b.ply"))
    first, second = read_ply(tmp_path / "a.ply").columns, read_ply(tmp_path / "b.ply").columns
    np.testing.assert_allclose(colour_sh(second), sh, atol=0.01)
    for name in ("x", "scale_1", "rot_2", "opacity"):
        np.testing.assert_allclose(second[name], first[name], atol=2e-4, rtol=1e-4)


def test_what_cannot_be_baked_says_why(registered, make_model, write, tmp_path):
    assert not bpy.ops.physhdr.model_bake.poll()
    bpy.ops.physhdr.model_import(filepath=str(write(make_model())))
    with pytest.raises(RuntimeError, match=r"no learned tone mapper[\s\S]*SRGB"):
        bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"), tone="LEARNED")
    target = bpy.context.object
    target.scale.z = 0.0
    with pytest.raises(RuntimeError, match="flat or not finite"):
        bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"))
    target.scale.z = 1.0
    target.data.attributes.remove(target.data.attributes["physhdr:light_share_0"])
    with pytest.raises(RuntimeError, match=r"is no PhysHDR model[\s\S]*import it again"):
        bpy.ops.physhdr.model_bake(filepath=str(tmp_path / "a.ply"))
    assert not (tmp_path / "a.ply").exists()


def test_looks_follow_keyframes_and_survive_without_the_modifier(scene, make_toned, write):
    target = model_import.import_model(write(make_toned()))
    assert [each for each in scene.objects if look.is_model(each)] == [target]
    modifier = nodes.find_modifier(target)
    modifier.name = "another name"
    for frame, value in [(1, 0.0), (11, 2.0)]:
        nodes.set_input(modifier, nodes.EXPOSURE, value)
        target.keyframe_insert(nodes.input_data_path(modifier, nodes.EXPOSURE), frame=frame)
    for frame, value in [(1, False), (6, True)]:
        nodes.set_input(modifier, nodes.TONE_MAPPER, value)
        target.keyframe_insert(nodes.input_data_path(modifier, nodes.TONE_MAPPER), frame=frame)
    scene.frame_set(11)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert look.look_of(target, depsgraph) == look.Look(2.0, (1.0,), True, True)
    assert look.look_of(target, depsgraph).exposure == 4.0
    scene.frame_set(1)
    assert look.look_of(target, bpy.context.evaluated_depsgraph_get()) == look.Look()
    target.modifiers.clear()
    assert look.look_of(target) == look.Look()


def test_another_model_is_not_offered_the_last_ones_file(registered):
    """What has no such mark Blender fills in as it was the last time, before the file's name is proposed."""
    for name in ("model_bake", "model_save"):
        path = getattr(bpy.ops.physhdr, name).get_rna_type().properties["filepath"]
        assert path.is_skip_save and path.subtype == "FILE_PATH"


def test_beside_a_file_that_is_not_saved_nothing_is_written(
    registered, make_model, write, tmp_path, monkeypatch
):
    """Blender takes ``//`` for the folder that it runs in, then."""
    monkeypatch.chdir(tmp_path)
    bpy.context.view_layer.objects.active = model_import.import_model(write(make_model(count=5)))
    before = sorted(tmp_path.iterdir())
    for save in (bpy.ops.physhdr.model_save, bpy.ops.physhdr.model_bake):
        with pytest.raises(RuntimeError, match="not saved yet"):
            save(filepath="//kitchen.out")
    assert sorted(tmp_path.iterdir()) == before
