# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the trained parameters back from a lossless PLY, which is what makes it lossless."""

import numpy as np
import torch

from physhdr.backend.model.gaussians import Gaussians
from physhdr.bridge.lossless_form import (
    CURVE,
    EXPOSURES,
    FORM,
    LIGHTS,
    NETWORK,
    SEPARATOR,
    tensors_from_comments,
)
from physhdr.bridge.ply_model import AMBIENT_LOGITS, CONFIDENCE, LIGHT_LOGITS

#: What the names of the columns that say something begin with; all other ``phys_`` columns are parameters.
SAYING = tuple(f"{each}{SEPARATOR}" for each in (FORM, LIGHTS, EXPOSURES, CURVE))


def parameters_from_columns(columns: dict[str, np.ndarray]) -> Gaussians:
    """The Gaussians that ``parameter_columns`` was given."""
    found: dict[str, dict[int, np.ndarray]] = {}
    for column, values in columns.items():
        if column.startswith("phys_") and column != CONFIDENCE and not column.startswith(SAYING):
            prefix, _, index = column.rpartition("_")
            name = (LIGHT_LOGITS if prefix == AMBIENT_LOGITS else prefix).removeprefix("phys_")
            found.setdefault(name, {})[int(index)] = values
    parameters = {}
    for name, parts in found.items():
        tensor = torch.from_numpy(np.stack([parts[i] for i in range(len(parts))], axis=1))
        if name == "opacity_logits":
            tensor = tensor[:, 0]
        elif name.startswith("reflectance") or name == "light_share_logits":
            tensor = tensor.reshape(len(tensor), -1, 3)
        parameters[name] = tensor.contiguous()
    if "reflectance_rest" not in parameters:  # degree 0 has none
        parameters["reflectance_rest"] = torch.zeros(len(parameters["means"]), 0, 3)
    return Gaussians(parameters)


def networks_from_comments(comments: list[str]) -> dict[str, torch.Tensor]:
    """The networks that ``network_comments`` wrote, by their names."""
    return {name: torch.from_numpy(array) for name, array in tensors_from_comments(NETWORK, comments).items()}
