# SPDX-License-Identifier: GPL-3.0-or-later
"""Small models and scenes for the Blender side's tests. They need Python with bpy 5.2 or newer."""

import functools
import inspect
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
def factory_settings(tmp_path_factory):
    """Blender as it comes from the factory, preferences and all; node trees that were built once are kept."""
    bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with pytest.MonkeyPatch.context() as patch:
        keep_trees(patch, tmp_path_factory.mktemp("trees"))
        yield bpy


def keep_trees(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Imports append the tree that their like has built before: one built anew takes ten times as long."""
    import bpy

    from physhdr.addon.model import radiance_tree
    from physhdr.addon.model.nodes import MARK

    build = radiance_tree.radiance_tree
    kept: dict[tuple, tuple[str, str]] = {}

    @functools.wraps(build)
    def from_file(degree, levels, curve, lights):
        key = (degree, levels, curve and curve.digest, lights)
        path, name = kept.get(key, ("", ""))
        # Beside another, materials are shared, and a library's tree is not the file's own: both are built.
        if path and not any(MARK in tree for tree in bpy.data.node_groups):
            with bpy.data.libraries.load(path) as (_, wanted):
                wanted.node_groups = [name]
        tree = build(degree, levels, curve, lights)  # finds what was appended
        if not path:
            path = str(folder / f"{len(kept)}.blend")
            bpy.data.libraries.write(path, {tree})
            kept[key] = path, tree.name
        return tree

    patch.setattr(radiance_tree, "radiance_tree", from_file)


@pytest.fixture
def trees_built(factory_settings, monkeypatch) -> None:
    """Imports build their node trees, and what these use."""
    from physhdr.addon.model import radiance_tree

    monkeypatch.setattr(radiance_tree, "radiance_tree", inspect.unwrap(radiance_tree.radiance_tree))


@pytest.fixture
def scene(factory_settings):
    """Blender's scene, empty; the preferences stay, which cost most of the time of making a file anew."""
    factory_settings.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return factory_settings.context.scene


@pytest.fixture
def registered(scene, tmp_path, monkeypatch):
    """The same, with the extension switched on, whose files are in a folder of the test's own."""
    import physhdr  # needs bpy, which not every Python has
    from physhdr.addon import settings

    monkeypatch.setattr(settings, "home_folder", lambda: tmp_path / "home")
    physhdr.register()
    yield scene
    physhdr.unregister()


@pytest.fixture
def extension(registered):
    """The session of the extension, which is switched on."""
    from physhdr.addon import runtime

    return runtime.session()
