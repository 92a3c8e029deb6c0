# SPDX-License-Identifier: GPL-3.0-or-later
"""The lossless PLY read without torch, as Blender reads it, against the model file of the same method."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from physhdr.backend.export.baked import network_comments, parameter_columns
from physhdr.backend.export.blender_model import to_model
from physhdr.backend.methods.base import MethodSetup
from physhdr.backend.methods.physhdr_common import PhysHDRConfig, PhysHDRMethod
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.display import display_colour_sh
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.gaussian_ply import read_ply, standard_columns, write_lossless_ply
from physhdr.bridge.model_file import Model, read_model, write_model
from physhdr.bridge.ply_model import read_ply_model
from physhdr.lab.peers.paper import PaperConfig


def write(
    path: Path, config: PhysHDRConfig, lights: tuple[str, ...] = ("ambient",)
) -> tuple[PhysHDRMethod, Model]:
    """A method with random parameters, exported as the command does."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    gaussians = initial_gaussians(
        rng.normal(size=(40, 3)),
        rng.normal(0.0, 2.0, (40, 3)),
        sh_degree=config.sh_degree,
        opacity=0.5,
        ambient_share=0.3 if config.has_light_share else None,
        context_size=0,
        seed=0,
        lights=len(lights),
    )
    for tensor in gaussians.parameters.values():
        tensor.data += 0.2 * torch.randn_like(tensor)
    method = METHODS[config.name].make(config, gaussians, MethodSetup((1.0, 0.73), lights=lights))
    for parameter in method.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    model = to_model(method, np.zeros(3), (1.0, 1.0 / 3.0, 16.0), {"scene": "test"})
    columns = standard_columns(
        model.position, model.rotation, model.scale, model.opacity, display_colour_sh(model)
    )
    comments = ["PhysHDR scene: test", *network_comments(method, model)]
    write_lossless_ply(path, columns, parameter_columns(gaussians, lights), comments)
    return method, model


@pytest.mark.parametrize(
    ("config", "lights"),
    [
        (PhysHDRConfig(), ("ambient",)),
        (PhysHDRConfig(sh_degree=0), ("ambient",)),
        (PhysHDRConfig(illumination_branch=False), ("ambient",)),
        (PhysHDRConfig(), ("ambient", "desk lamp", "screen")),
        (PhysHDRConfig(), ("pendant",)),
    ],
    ids=["default", "degree 0", "baseline", "three lights", "a lamp alone"],
)
def test_without_networks_in_the_radiance_it_is_the_model_file(
    tmp_path: Path, lossless: ModuleType, config: PhysHDRConfig, lights: tuple[str, ...]
) -> None:
    method, expected = write(tmp_path / "a.ply", config, lights)
    found = read_ply_model(tmp_path / "a.ply")
    assert found.model.lights == expected.lights == lights
    assert found.model.exposures == expected.exposures and found.model.developed_ev == 0.0
    ply = read_ply(tmp_path / "a.ply")
    for name, tensor in lossless.parameters_from_columns(ply.columns).parameters.items():
        assert torch.equal(tensor, method.gaussians.parameters[name]), name
    assert found.notes == () and dict(found.model.metadata) == {"scene": "test"}
    assert found.model.tensors().keys() == expected.tensors().keys()
    for name, array in expected.tensors().items():
        np.testing.assert_allclose(found.model.tensors()[name], array, rtol=1e-5, atol=1e-6, err_msg=name)


def test_the_ambient_light_alone_is_written_as_before_there_were_others(tmp_path: Path) -> None:
    write(tmp_path / "a.ply", PhysHDRConfig())
    ply = read_ply(tmp_path / "a.ply")
    assert "phys_ambient_share_logits_2" in ply.columns and "phys_light_share_logits_0" not in ply.columns
    assert "phys_form product additive" in ply.comments
    assert not any(line.startswith("phys_lights") for line in ply.comments)


def test_the_model_file_of_several_lights_renders_as_the_method(tmp_path: Path) -> None:
    lights = ("ambient", "desk lamp", "screen")
    method, model = write(tmp_path / "a.ply", PhysHDRConfig(), lights)
    write_model(tmp_path / "m.safetensors", model)
    back = read_model(tmp_path / "m.safetensors")
    at_origin = Camera.from_field_of_view(np.eye(4), 8, 8, 0.8)
    directions = model.position / np.linalg.norm(model.position, axis=1, keepdims=True)
    for levels in [(1.0, 1.0, 1.0), (0.0, 4.0, 0.5), (8.0, 0.0, 0.0)]:
        with torch.no_grad():
            splats = method.gaussians.splats(at_origin, method.active_sh_degree)
            expected = method.radiance_of(splats, levels).numpy()
        np.testing.assert_allclose(back.radiance(directions, levels), expected, rtol=1e-3)


def test_splat_transform_keeps_the_model(tmp_path: Path, splat_transform: Callable[..., None]) -> None:
    """The exporter's own file, which that rewrites without comments, at two levels of each light."""
    lights = ("ambient", "desk lamp")
    _, expected = write(tmp_path / "a.ply", PhysHDRConfig(), lights)
    splat_transform(tmp_path / "a.ply", tmp_path / "b.ply")
    assert b"phys_form product" not in (tmp_path / "b.ply").read_bytes()
    found = read_ply_model(tmp_path / "b.ply").model
    assert found.lights == lights and found.exposures == expected.exposures
    order = np.linalg.norm(found.position[:, None] - expected.position, axis=2).argmin(axis=0)
    directions = np.tile(np.float32([0.0, 0.6, 0.8]), (expected.count, 1))
    for levels in ((0.25, 4.0), (4.0, 0.25)):
        np.testing.assert_allclose(
            found.radiance(directions, levels)[order], expected.radiance(directions, levels), rtol=1e-4
        )


def test_splat_transform_turns_the_model(tmp_path: Path, splat_transform: Callable[..., None]) -> None:
    """It turns positions and its own colours; ours follow: seen from the turned side, all is as before."""
    _, expected = write(tmp_path / "a.ply", PhysHDRConfig())
    splat_transform(tmp_path / "a.ply", "-r", "30,-50,20", "-s", "2", "-t", "1,2,3", tmp_path / "b.ply")
    found = read_ply_model(tmp_path / "b.ply")
    assert any("turned" in note for note in found.notes)
    moved, centre = found.model.position, found.model.position.mean(axis=0)
    # The rotation, of the three first Gaussians' places alone.
    before = (expected.position - expected.position.mean(axis=0))[:3].T.astype(np.float64)
    turn = (moved - centre)[:3].T.astype(np.float64) @ np.linalg.inv(before) / 2.0
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-4)
    direction = np.array([0.0, 0.6, 0.8])
    here = np.tile(direction.astype(np.float32), (expected.count, 1))
    there = np.tile((turn @ direction).astype(np.float32), (expected.count, 1))
    np.testing.assert_allclose(found.model.radiance(there), expected.radiance(here), rtol=2e-3)


def test_networks_in_the_radiance_need_the_model_file(tmp_path: Path) -> None:
    write(tmp_path / "a.ply", PaperConfig())
    with pytest.raises(BadValueError, match="composer learned, modulator learned"):
        read_ply_model(tmp_path / "a.ply")


def test_the_baked_colour_is_the_networks_response(tmp_path: Path) -> None:
    """The file's response is sampled: at the constant part it is the network's to 0.1 of an 8-bit code."""
    method, model = write(tmp_path / "a.ply", PhysHDRConfig(sh_degree=0))
    shown = 0.5 + 0.28209479 * display_colour_sh(model, 4.0, 0.5)[:, 0]
    log_exposed = 0.28209479 * model.log_radiance_sh[:, 0] + model.log_gain(0.5) + np.log(4.0)
    with torch.no_grad():
        code = method.tone_mapper.curve_logits(torch.from_numpy(log_exposed.T.copy()).float()).sigmoid()
    np.testing.assert_allclose(shown, code.numpy().T, atol=4e-4)
