# SPDX-License-Identifier: GPL-3.0-or-later
"""What the lossless PLY adds to the standard one: every parameter as a column, the networks as comments.

The standard PLY is the model file's look, baked by ``bridge.display``, as Blender bakes it too: each
Gaussian's radiance goes through the learned global response *before* blending, as standard viewers blend
display values. Edges of bright Gaussians therefore differ a little from our own picture, which blends
radiance.
"""

import json

import numpy as np

from ...bridge.gaussian_ply import EXTRA_PREFIX
from ...bridge.lights import AMBIENT
from ...bridge.lossless_form import CURVE, EXPOSURES, FORM, LIGHTS, NETWORK, tensor_comments
from ...bridge.model_file import ADDITIVE_LIGHTS, Model
from ...bridge.ply_model import AMBIENT_LOGITS, CONFIDENCE, LIGHT_LOGITS
from ..methods.base import Method
from ..model.gaussians import Gaussians


def parameter_columns(gaussians: Gaussians, lights: tuple[str, ...] = (AMBIENT,)) -> dict[str, np.ndarray]:
    """Every parameter as named ``phys_…`` columns ``[N]``, float32: ``phys_means_0`` …

    Where the ambient light is the only one, its logits have a name of their own.
    """
    columns = {}
    for name, tensor in gaussians.parameters.items():
        flat = tensor.detach().reshape(len(gaussians), -1).numpy()
        prefix = f"{EXTRA_PREFIX}{name}"
        if prefix == LIGHT_LOGITS and lights == (AMBIENT,):
            prefix = AMBIENT_LOGITS
        for index in range(flat.shape[1]):
            columns[f"{prefix}_{index}"] = flat[:, index]
    return columns


def confidence_column(model: Model) -> dict[str, np.ndarray]:
    """How likely each radiance is right, as a column ``[N]``; none where the model does not know."""
    return {} if model.confidence is None else {CONFIDENCE: model.confidence}


def network_comments(method: Method, model: Model) -> list[str]:
    """The networks, the sampled response, the exposures and what the radiance is made of, as comment lines.

    ``write_lossless_ply`` says all but the networks in the names of columns, too.
    """
    by_network = method.can_relight and not method.has_light_share
    form = "product" if method.composes_by_product else "learned", "learned" if by_network else "additive"
    lights: list[str] = []
    if method.lights != (AMBIENT,):
        lights = [f"{LIGHTS} {json.dumps(list(method.lights))}"]
        form = form[0], form[1] if form[1] != "additive" else ADDITIVE_LIGHTS
    exposures = [f"{EXPOSURES} {json.dumps(model.exposures)}"] if model.exposures else []
    networks = {name: tensor.detach().numpy() for name, tensor in method.state_dict().items()}
    curve = {name: array for name, array in model.tensors().items() if name.startswith("tone_curve")}
    return [
        f"{FORM} {form[0]} {form[1]}",
        *lights,
        *exposures,
        *tensor_comments(CURVE, curve),
        *tensor_comments(NETWORK, networks),
    ]
