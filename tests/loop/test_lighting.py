# SPDX-License-Identifier: GPL-3.0-or-later
"""*Light From Here* with the real backend and without one: both draw the same light at the same places."""

import json
import math
import sys

import numpy as np
import pytest

from physhdr.backend.scene.pictures import read_exr
from physhdr.bridge.model_file import Model, write_model
from physhdr.bridge.panorama import solid_angles


@pytest.mark.long
def test_the_backend_and_blender_draw_the_same_light(in_blender, tmp_path):
    rng = np.random.default_rng(4)
    count, lights = 250, ("ambient", "lamp")
    vectors = rng.normal(size=(count, 3))
    vectors *= rng.uniform(2.0, 3.0, (count, 1)) / np.linalg.norm(vectors, axis=1, keepdims=True)
    model = Model(
        position=vectors.astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        scale=np.exp(rng.uniform(-2.3, -0.9, (count, 3))).astype(np.float32),
        opacity=rng.uniform(0.5, 1.0, count).astype(np.float32),
        log_radiance_sh=rng.normal(0.0, 1.0, (count, 4, 3)).astype(np.float32),
        light_share=rng.dirichlet(np.ones(3), (count, 3))[..., :2].transpose(0, 2, 1).astype(np.float32),
        lights=lights,
    )
    write_model(tmp_path / "model.safetensors", model)
    in_blender("tests/loop/use_lighting.py", sys.executable, tmp_path / "model.safetensors", tmp_path)
    seen = json.loads((tmp_path / "seen.json").read_text())
    weight = solid_angles(64)[:, None, None] / (4.0 * math.pi)
    for name in ("left", "right"):
        ours, theirs = seen["backend"][name], seen["blender"][name]
        assert ours["made_by"].startswith("physhdr") and theirs["made_by"].startswith("Blender")
        assert ours["lights"] == theirs["lights"] == list(lights)
        assert np.allclose(ours["at"], theirs["at"], atol=1e-5)
        assert abs(ours["unseen"] - theirs["unseen"]) < 0.04  # an affine projection is a little large
        for file in ("fixed.exr", "light_0.exr", "light_1.exr"):
            a, b = (read_exr(tmp_path / kind / name / file) for kind in ("backend", "blender"))
            psnr = 10.0 * math.log10(b.max() ** 2 / np.square(a - b).mean())
            light = (weight * a).sum() * 64 / ((weight * b).sum() * 64)
            print(f"{name} {file}: {psnr:.1f} dB, light {light:.3f}")
            assert psnr > 30.0 and abs(math.log2(light)) < 0.05
