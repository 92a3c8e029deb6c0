# SPDX-License-Identifier: GPL-3.0-or-later
"""One file that holds everything a run needs to go on bit-identically, replaced atomically.

A safetensors file: parameters, Adam's moments, densification statistics; the iteration in its metadata.
Random numbers are drawn from (seed, iteration), so there is no generator state to keep.
"""

import json
import os
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from ...bridge.errors import DataMismatchError, FileDamagedError, FileMissingError, OutputError
from ...bridge.lights import AMBIENT, check_lights

FORMAT = "physhdr-checkpoint"
VERSION = 1
#: The light's parameter, ``[N, C, 3]``, and what it is called in the file where the ambient light is the only
#: one, ``[N, 3]``: as it was before there were others.
SHARES, AMBIENT_SHARES = ".light_share_logits", ".ambient_share_logits"


def save_checkpoint(
    path: Path,
    tensors: dict[str, torch.Tensor],
    metadata: dict[str, str],
    lights: tuple[str, ...] = (AMBIENT,),
) -> None:
    """Write the tensors; an older file at ``path`` survives until the new one is whole.

    ``lights``: names of the lights that the model has levels for. Raises ``OutputError`` where it cannot be
    written (a full disk, no permission).
    """
    temporary = path.with_suffix(".partial")
    metadata = {"format": FORMAT, "version": str(VERSION), **metadata}
    if lights == (AMBIENT,):
        tensors = {
            name.replace(SHARES, AMBIENT_SHARES): tensor.squeeze(1) if _is_share(name, tensor, 3) else tensor
            for name, tensor in tensors.items()
        }
    else:
        metadata["lights"] = json.dumps(list(lights))
    try:
        save_file({k: v.detach().cpu().contiguous() for k, v in tensors.items()}, temporary, metadata)
        temporary.chmod(0o644)  # safetensors makes files that only their owner reads
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except (OSError, SafetensorError) as error:
        temporary.unlink(missing_ok=True)
        raise OutputError(
            f"cannot write the checkpoint {path}: {error}",
            "Free some space or choose another --out; the previous checkpoint is untouched.",
        ) from error


def load_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors and metadata of a checkpoint; errors name the file and what to do."""
    if not path.is_file():
        raise FileMissingError(
            f"there is no checkpoint {path}",
            "Train first: physhdr train DATA --out RUN, or name another run.",
        )
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, ValueError) as error:
        raise FileDamagedError(
            f"the checkpoint {path} cannot be read: {error}", "It is damaged: train again, or restore a copy."
        ) from error
    if metadata.get("format") != FORMAT:
        raise FileDamagedError(f"{path} is not a PhysHDR checkpoint", "Name a folder that 'train' wrote.")
    if metadata.get("version") != str(VERSION):
        raise DataMismatchError(
            f"{path} has checkpoint version {metadata.get('version')}, this program reads {VERSION}",
            "Use the version of PhysHDR that wrote it.",
        )
    tensors = {
        name.replace(AMBIENT_SHARES, SHARES): tensor[:, None] if _is_share(name, tensor, 2) else tensor
        for name, tensor in tensors.items()
    }
    return tensors, metadata


def lights_of(metadata: dict[str, str], path: Path) -> tuple[str, ...]:
    """The lights of a checkpoint's model, from its metadata; raises ``BadValueError``."""
    try:
        named = json.loads(metadata["lights"]) if "lights" in metadata else [AMBIENT]
    except ValueError as error:
        raise FileDamagedError(
            f"{path}: its lights are not JSON: {error}", "It is damaged: restore a copy."
        ) from error
    return check_lights(named, str(path))


def _is_share(name: str, tensor: torch.Tensor, axes: int) -> bool:
    """Whether this is the light's parameter or one of its moments (Adam's step count has no axes)."""
    return (SHARES in name or AMBIENT_SHARES in name) and tensor.dim() == axes
