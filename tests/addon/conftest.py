# SPDX-License-Identifier: GPL-3.0-or-later
"""Small models and scenes for the Blender side's tests. They need Python with bpy 5.2 or newer."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.model_file import Model, write_model


@pytest.fixture
def make_model() -> Callable[..., Model]:
    """Builds a random model: N Gaussians in a ball of radius 1, radiance over about 6 stops."""

    def make(
        count: int = 40,
        degree: int = 1,
        modulator: str = "additive",
        seed: int = 0,
        lights: tuple[str, ...] = ("ambient",),
        confidence: bool = False,
    ) -> Model:
        rng = np.random.default_rng(seed)

        def uniform(*shape: int, low: float, high: float) -> np.ndarray:
            return rng.uniform(low, high, shape).astype(np.float32)

        levels = (0.25, 0.5, 1.0, 4.0)
        # Of several lights and the rest any mixture; of one any share.
        mixture = rng.dirichlet(np.full(len(lights) + 1, 0.5), (count, 3))[..., :-1].transpose(0, 2, 1)
        light = (
            {"light_share": mixture.astype(np.float32), "lights": lights}
            if modulator == "additive"
            else {"level_log_gain": uniform(4, count, 3, low=-2.0, high=2.0), "levels": levels}
        )
        log_radiance_sh = rng.normal(0.0, 0.4, (count, (degree + 1) ** 2, 3))
        log_radiance_sh[:, 0] *= 8.0
        return Model(
            position=uniform(count, 3, low=-0.6, high=0.6),
            rotation=rng.normal(size=(count, 4)).astype(np.float32),
            scale=np.exp(uniform(count, 3, low=-4.0, high=-1.5)),
            opacity=uniform(count, low=0.05, high=1.0),
            log_radiance_sh=log_radiance_sh.astype(np.float32),
            **light,
            exposures=(0.25, 1.0, 4.0),
            metadata={"scene": "test", "method": "physhdr", "iteration": "100"},
            confidence=uniform(count, low=0.0, high=1.0) if confidence else None,
        )

    return make


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Model], Path]:
    """Writes a model and gives its path."""

    def write(model: Model) -> Path:
        write_model(tmp_path / "model.safetensors", model)
        return tmp_path / "model.safetensors"

    return write


@pytest.fixture
def look_at() -> Callable[..., np.ndarray]:
    """A 4×4 camera-to-world pose in Blender's axes that looks from ``eye`` to the origin."""

    def look_at(*eye: float) -> np.ndarray:
        pose = np.eye(4)
        back = np.array(eye) / np.linalg.norm(eye)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose[:3, :3] = np.column_stack([right, np.cross(back, right), back])
        pose[:3, 3] = eye
        return pose

    return look_at


@pytest.fixture(scope="session")
def factory_settings():
    """Blender as it comes from the factory, preferences and all."""
    bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy


@pytest.fixture
def scene(factory_settings):
    """Blender's scene, empty; the preferences stay, which cost most of the time of making a file anew."""
    factory_settings.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return factory_settings.context.scene


@pytest.fixture
def registered(scene):
    """The same, with the extension switched on."""
    import physhdr  # needs bpy, which not every Python has

    physhdr.register()
    yield scene
    physhdr.unregister()
