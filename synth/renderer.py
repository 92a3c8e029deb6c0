# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one pose at one lighting level to an EXR that appears under its name only when it is whole."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from . import exr
from .errors import NotFiniteError, RenderError
from .folder import temporary
from .interrupts import held
from .progress import quiet
from .scenes.stage import AMBIENT, Stage


def view_seed(seed: int, name: str) -> int:
    """Cycles seed of a picture: a hash of ``--seed`` and the file's name, so that no two share noise."""
    return zlib.crc32(f"{seed}/{name}".encode()) & 0x7FFFFFFF


class Renderer:
    """A camera in a built stage. ``settings.applied`` must be around its use."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        data = bpy.data.cameras.new("physhdr camera")
        data.sensor_fit = "HORIZONTAL"
        data.angle = stage.cameras.angle_x
        data.clip_start, data.clip_end = stage.cameras.clip
        self.camera = bpy.data.objects.new("physhdr camera", data)
        stage.scene.collection.objects.link(self.camera)
        stage.scene.camera = self.camera

    def render(self, path: Path, pose: np.ndarray, level: float, seed: int) -> np.ndarray:
        """Render, move into place, and return what was read back: [height, width, 3] float32.

        Raises:
            RenderError: Blender failed, or wrote nothing.
        """
        scene, pending = self.stage.scene, temporary(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        pending.unlink(missing_ok=True)
        self.camera.matrix_world = Matrix(pose.tolist())
        self.stage.set_levels({AMBIENT: level})
        scene.cycles.seed = seed
        scene.render.filepath = str(pending.absolute())
        try:
            with quiet(), held():
                done = bpy.ops.render.render(
                    write_still=True, scene=scene.name, layer=self.stage.view_layer.name
                )
        except RuntimeError as error:
            raise RenderError(f"Blender could not render '{path}': {str(error).strip()}") from error
        if "CANCELLED" in done:  # Blender took the CTRL-C for itself
            raise KeyboardInterrupt
        if not pending.exists():
            raise RenderError(f"Blender wrote no picture for '{path}': is the disk full?")
        try:
            image = exr.read(pending)
        except NotFiniteError as error:
            raise RenderError(
                f"the render of '{path}' holds NaN or infinity",
                "a material, a texture or a light of the scene gives values that are no numbers: mend it",
            ) from error
        pending.write_bytes(exr.without_times(pending.read_bytes()))  # the same seed, the same bytes
        os.replace(pending, path)
        return image
