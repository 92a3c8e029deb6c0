# SPDX-License-Identifier: GPL-3.0-or-later
"""The lossless PLY read without torch, as Blender reads it, against the model file of the same method."""

from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.export.baked import network_comments, parameter_columns
from physhdr.backend.export.blender_model import to_model
from physhdr.backend.methods.physhdr import PhysHDR, PhysHDRConfig
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.bridge.display import display_colour_sh
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.gaussian_ply import standard_columns, write_lossless_ply
from physhdr.bridge.model_file import Model
from physhdr.bridge.ply_model import read_ply_model


def write(path: Path, config: PhysHDRConfig) -> tuple[PhysHDR, Model]:
    """A method with random parameters, exported as the command does."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    gaussians = initial_gaussians(
        rng.normal(size=(40, 3)),
        rng.normal(0.0, 2.0, (40, 3)),
        sh_degree=config.sh_degree,
        opacity=0.5,
        scale_factor=1.0,
        ambient_share=0.3 if config.has_ambient_share else None,
        context_size=0,
        seed=0,
    )
    for tensor in gaussians.parameters.values():
        tensor.data += 0.2 * torch.randn_like(tensor)
    method = PhysHDR(config, gaussians, (1.0, 0.73))
    for parameter in method.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    model = to_model(method, np.zeros(3), (1.0,), {"scene": "test"})
    columns = standard_columns(
        model.position, model.rotation, model.scale, model.opacity, display_colour_sh(model)
    )
    comments = ["PhysHDR scene: test", *network_comments(method, model)]
    write_lossless_ply(path, columns, parameter_columns(gaussians), comments)
    return method, model


@pytest.mark.parametrize(
    "config",
    [
        PhysHDRConfig(),
        PhysHDRConfig(sh_degree=0),
        PhysHDRConfig(branches="image-exposure", lighting_level="exposure"),
    ],
    ids=["default", "degree 0", "baseline"],
)
def test_without_networks_in_the_radiance_it_is_the_model_file(tmp_path: Path, config: PhysHDRConfig) -> None:
    _, expected = write(tmp_path / "a.ply", config)
    found = read_ply_model(tmp_path / "a.ply")
    assert found.notes == () and dict(found.model.metadata) == {"scene": "test"}
    assert found.model.tensors().keys() == expected.tensors().keys()
    for name, array in expected.tensors().items():
        np.testing.assert_allclose(found.model.tensors()[name], array, rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(("composer", "modulator"), [("learned", "additive"), ("product", "learned")])
def test_networks_in_the_radiance_need_the_model_file(tmp_path: Path, composer, modulator) -> None:
    write(tmp_path / "a.ply", PhysHDRConfig(composer=composer, modulator=modulator))
    with pytest.raises(BadValueError, match=rf"composer {composer}, modulator {modulator}"):
        read_ply_model(tmp_path / "a.ply")


def test_the_baked_colour_is_the_networks_response(tmp_path: Path) -> None:
    """The file's response is sampled: at the constant part it is the network's to 0.1 of an 8-bit code."""
    method, model = write(tmp_path / "a.ply", PhysHDRConfig(sh_degree=0))
    shown = 0.5 + 0.28209479 * display_colour_sh(model, 4.0, 0.5)[:, 0]
    log_exposed = 0.28209479 * model.log_radiance_sh[:, 0] + model.log_gain(0.5) + np.log(4.0)
    with torch.no_grad():
        code = method.tone_mapper.curve_logits(torch.from_numpy(log_exposed.T.copy()).float()).sigmoid()
    np.testing.assert_allclose(shown, code.numpy().T, atol=4e-4)
