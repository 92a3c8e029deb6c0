# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one pose: the light of each group and the geometry, as numbers checked to be whole."""

import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from . import animation, compositor, exr, lens_shader, noise
from .blender import cycles
from .errors import DamagedFileError, NotFiniteError, NotFiniteRenderError, RenderError
from .interrupts import held
from .lens import Lens
from .passes import SKY, Passes
from .progress import quiet
from .stage import Stage

#: In Cycles' status line.
SAMPLE = re.compile(r"Sample (\d+)/\d+")


def view_seed(seed: int, name: str) -> int:
    """Cycles seed of a picture: a hash of ``--seed`` and the pose's name, so that no two share noise."""
    return zlib.crc32(f"{seed}/{name}".encode()) & 0x7FFFFFFF


class Renderer:
    """Made by ``renderer``."""

    def __init__(
        self, stage: Stage, denoise: bool, outlet: compositor.Outlet, lens: Lens | None = None
    ) -> None:
        self.stage, self.denoise, self.outlet = stage, denoise, outlet
        data = bpy.data.cameras.new("physhdr camera")
        data.sensor_fit = "HORIZONTAL"
        data.angle = stage.cameras.angle_x
        data.clip_start, data.clip_end = stage.cameras.clip
        # For any camera but a pinhole Cycles gives the distance, not how far along the axis things are.
        self._along_axis = lens.cosines().astype(np.float32) if lens else None
        if lens:
            lens_shader.mount(lens, data)
        self.camera = bpy.data.objects.new("physhdr camera", data)
        stage.scene.collection.objects.link(self.camera)
        stage.scene.camera = self.camera

    def render(self, pose: np.ndarray, seed: int, scratch: Path) -> Passes:
        """The passes of a pose [4, 4] under the lights as they are set.

        ``scratch``: a file that Blender writes and that is removed; its name must end in .exr.

        Raises:
            NotFiniteRenderError: the picture holds NaN or infinity.
            RenderError: Blender failed, wrote nothing or half of it.
        """
        scene = self.stage.scene
        scratch.parent.mkdir(parents=True, exist_ok=True)
        self.camera.matrix_world = Matrix(pose.tolist())
        cycles(scene).seed = seed
        scene.update_tag()  # else persistent data keeps the former seed
        self.outlet.aim(scratch)
        try:
            with quiet(), held(), _most_samples(scene) as most:
                done = bpy.ops.render.render(
                    write_still=False, scene=scene.name, layer=self.stage.view_layer.name
                )
            if "CANCELLED" in done:  # Blender took the CTRL-C for itself
                raise KeyboardInterrupt
            return self._read(scratch, seed, most[0])
        except RuntimeError as error:
            raise RenderError(f"Blender could not render to '{scratch}': {str(error).strip()}") from error
        finally:
            scratch.unlink(missing_ok=True)

    def _read(self, scratch: Path, seed: int, most: int) -> Passes:
        if not scratch.exists():
            raise RenderError(f"Blender wrote no picture '{scratch}'", "is the disk full?")
        try:
            channels, _ = exr.read_channels(scratch)
        except NotFiniteError as error:
            raise NotFiniteRenderError(
                f"the render '{scratch}' holds NaN or infinity",
                "a material, a texture or a light of the scene gives values that are not numbers: fix it",
            ) from error
        except DamagedFileError as error:
            raise RenderError(f"Blender wrote '{scratch}' only in part", "is the disk full?") from error

        def colour(name: str, ends: str = "RGB") -> np.ndarray:
            return np.stack([channels[f"{name}.{end}"] for end in ends], -1)

        # Differences of passes are a rounding below 0 where a light does not reach.
        lights = {name: np.maximum(colour(f"light_{k}"), 0.0) for k, name in enumerate(self.stage.lights)}
        whole = reduce(np.add, lights.values()) if self.denoise else None
        raw = colour(compositor.RAW)
        planes = {name: channels[f"{name}.V"] for name in compositor.PLANES}
        planes["samples"] = planes["samples"] * most  # Cycles gives the share of what any pixel got
        if self._along_axis is not None:
            seen = planes["depth"] < SKY
            planes["depth"] = np.where(seen, planes["depth"] * self._along_axis, planes["depth"])
        return Passes(
            lights,
            normal=colour("normal", "XYZ"),
            facts={
                "seed": seed,
                "samples": round(float(planes["samples"].mean()), 3),
                "noise_psnr": noise.estimate(raw, whole),
            },
            raw=raw,
            **planes,
        )


@contextmanager
def renderer(stage: Stage, denoise: bool, lens: Lens | None = None) -> Iterator[Renderer]:
    """A camera in a built stage, and the passes switched on. ``settings.applied`` must be around it.

    ``lens``: at the size of the render; a pinhole with the stage's field of view if ``None``.
    """
    # Animated, the seed would be the same in every view, and so would the noise.
    with animation.muted(stage.scene, {"cycles.seed"}), compositor.connected(stage, denoise) as outlet:
        yield Renderer(stage, denoise, outlet, lens)


@contextmanager
def _most_samples(scene: bpy.types.Scene) -> Iterator[list[int]]:
    """The samples that the pixel with most of them gets, known on the way out.

    If all pixels are good early, Cycles ends before ``cycles.samples``: only its status line shows that.
    """
    most = [cycles(scene).samples]
    if not cycles(scene).use_adaptive_sampling:
        yield most
        return
    seen = [0]

    def note(status: str, *_: object) -> None:
        found = SAMPLE.search(status or "")
        if found:
            seen[0] = max(seen[0], int(found[1]))

    handlers: Any = bpy.app.handlers.render_stats  # which are called with the status line, too
    handlers.append(note)
    try:
        yield most
    finally:
        handlers.remove(note)
        most[0] = seen[0] or most[0]
