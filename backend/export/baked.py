# SPDX-License-Identifier: GPL-3.0-or-later
"""What the two PLY files hold: the look baked at one exposure and lighting level, and every parameter.

A display-referred bake: each Gaussian's radiance goes through the learned global response *before*
blending, as standard viewers blend display values. Edges of bright Gaussians therefore differ a little
from our own picture, which blends radiance.
"""

import base64
import json

import numpy as np
import torch

from ...bridge.spherical_harmonics import basis
from ..methods.physhdr import PhysHDR
from ..model.gaussians import Gaussians
from .blender_model import PROJECTION_DIRECTIONS, fibonacci_sphere, log_radiance_sh

#: Networks are stored as base64 in comment lines of at most this many characters.
COMMENT_WIDTH = 400


@torch.no_grad()
def baked_colour_sh(method: PhysHDR, exposure: float, lighting_level: float) -> np.ndarray:
    """``[N, K, 3]``: SH of display colour (colour = Σ sh·Y + ½), fitted to the response at every direction.

    ``exposure`` in seconds. K as trained.
    """
    sh = torch.from_numpy(log_radiance_sh(method))
    log_gain = _relit_log_gain(method, lighting_level)
    degree = method.active_sh_degree
    Y = torch.from_numpy(basis(fibonacci_sphere(PROJECTION_DIRECTIONS), degree)).float()
    colours = []
    for y in Y:
        exposed = ((y[:, None] * sh).sum(1) + log_gain).exp() * exposure
        colours.append(_global_response(method, exposed) - 0.5)
    return torch.einsum("kd,dnc->nkc", torch.linalg.pinv(Y), torch.stack(colours)).numpy()


def _relit_log_gain(method: PhysHDR, lighting_level: float) -> torch.Tensor:
    """ln(ĉ(level)/c) ``[N, 1 or 3]``, at the constant part of the reflectance."""
    g = method.gaussians
    if lighting_level == 1.0:
        return torch.zeros_like(g.log_illumination)
    if not method.can_relight:
        return torch.full_like(g.log_illumination, float(np.log(lighting_level)))
    log_reflectance = g.reflectance_dc[:, 0] * basis(np.array([[0.0, 0.0, 1.0]]), 0).item()
    relit = method.composer(method.log_modulated_illumination(lighting_level), log_reflectance)
    reference = method.composer(method.log_modulated_illumination(1.0), log_reflectance)
    return relit.log() - reference.log()


def _global_response(method: PhysHDR, exposed: torch.Tensor) -> torch.Tensor:
    """The global curves at radiance × exposure ``[N, 3]``; what a local curve adds needs a picture."""
    logits = method.tone_mapper.curve_logits(exposed.clamp_min(1e-12).log().T.contiguous())
    return logits.sigmoid().T


def parameter_columns(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Every parameter as named ``phys_…`` columns ``[N]``, float32: ``phys_means_0`` …"""
    columns = {}
    for name, tensor in gaussians.parameters.items():
        flat = tensor.detach().reshape(len(gaussians), -1).numpy()
        for index in range(flat.shape[1]):
            columns[f"phys_{name}_{index}"] = flat[:, index]
    return columns


def parameters_from_columns(columns: dict[str, np.ndarray]) -> Gaussians:
    """The Gaussians that ``parameter_columns`` was given."""
    found: dict[str, dict[int, np.ndarray]] = {}
    for column, values in columns.items():
        if column.startswith("phys_"):
            name, _, index = column.removeprefix("phys_").rpartition("_")
            found.setdefault(name, {})[int(index)] = values
    parameters = {}
    for name, parts in found.items():
        tensor = torch.from_numpy(np.stack([parts[i] for i in range(len(parts))], axis=1))
        if name == "opacity_logits":
            tensor = tensor[:, 0]
        elif name.startswith("reflectance"):
            tensor = tensor.reshape(len(tensor), -1, 3)
        parameters[name] = tensor.contiguous()
    if "reflectance_rest" not in parameters:  # degree 0 has none
        parameters["reflectance_rest"] = torch.zeros(len(parameters["means"]), 0, 3)
    return Gaussians(parameters)


def network_comments(method: PhysHDR) -> list[str]:
    """The networks as comment lines: ``phys_network NAME SHAPE PART BASE64`` (float32, little endian)."""
    lines = []
    for name, tensor in method.state_dict().items():
        text = base64.b64encode(tensor.numpy().astype("<f4").tobytes()).decode()
        shape = json.dumps(list(tensor.shape), separators=(",", ":"))
        for part, start in enumerate(range(0, max(len(text), 1), COMMENT_WIDTH)):
            lines.append(f"phys_network {name} {shape} {part} {text[start : start + COMMENT_WIDTH]}")
    return lines


def networks_from_comments(comments: list[str]) -> dict[str, torch.Tensor]:
    """The networks that ``network_comments`` wrote, by their names."""
    texts: dict[str, list[str]] = {}
    shapes: dict[str, list[int]] = {}
    for line in comments:
        if line.startswith("phys_network "):
            _, name, shape, _, text = line.split(" ", 4)
            texts.setdefault(name, []).append(text)
            shapes[name] = json.loads(shape)
    return {
        name: torch.from_numpy(
            np.frombuffer(base64.b64decode("".join(parts)), "<f4").reshape(shapes[name]).copy()
        )
        for name, parts in texts.items()
    }
