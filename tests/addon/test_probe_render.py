# SPDX-License-Identifier: GPL-3.0-or-later
"""A probe that Cycles draws without a backend, against Gaussians evaluated along rays in float64."""

import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from physhdr.addon.layouts.cameras import Frame
from physhdr.addon.light import probe_checks, probe_render
from physhdr.addon.model import nodes
from physhdr.addon.model.drawn import drawn_of
from physhdr.addon.model.model_import import import_model
from physhdr.addon.rendering.render import read_exr
from physhdr.bridge.errors import OutputError
from physhdr.bridge.model_file import Model
from physhdr.bridge.panorama import directions
from physhdr.bridge.probe import read_probe
from physhdr.bridge.splatting import ALPHA_MAX, ALPHA_MIN

WIDTH = 64
LIGHTS = ("ambient", "lamp")
AT = (0.3, -0.2, 0.5)


@pytest.fixture
def shell(write):
    """30 Gaussians 2 to 3 metres around ``AT``, of two lights, as a model and as a file."""
    rng = np.random.default_rng(4)
    count = 30
    vectors = rng.normal(size=(count, 3))
    vectors *= rng.uniform(2.0, 3.0, (count, 1)) / np.linalg.norm(vectors, axis=1, keepdims=True)
    model = Model(
        position=(vectors + AT).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        scale=np.exp(rng.uniform(-1.6, -0.7, (count, 3))).astype(np.float32),
        opacity=rng.uniform(0.3, 1.0, count).astype(np.float32),
        log_radiance_sh=rng.normal(0.0, 1.0, (count, 4, 3)).astype(np.float32),
        light_share=rng.dirichlet(np.ones(3), (count, 3))[..., :2].transpose(0, 2, 1).astype(np.float32),
        lights=LIGHTS,
    )
    return model, write(model)


def along_rays(model: Model, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radiance ``[P, R, 3]`` of each part and coverage ``[R]`` along unit rays ``[R, 3]`` from ``AT``."""
    offset = model.position.astype(float) - AT
    q = model.rotation / np.linalg.norm(model.rotation, axis=1, keepdims=True)
    w, x, y, z = q.T.astype(float)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    to_sphere = rotation.transpose(0, 2, 1) / model.scale[:, :, None]
    start = -np.einsum("nij,nj->ni", to_sphere, offset)[:, None]
    along = np.einsum("nij,rj->nri", to_sphere, rays)
    way = -(along * start).sum(-1) / (along * along).sum(-1)
    nearest = np.where(way > 0, np.square(start + way[..., None] * along).sum(-1), np.inf)
    alpha = np.minimum(model.opacity[:, None] * np.exp(-0.5 * nearest), ALPHA_MAX)
    alpha[alpha < ALPHA_MIN] = 0.0
    order = np.argsort(np.linalg.norm(offset, axis=1))
    alpha = alpha[order]
    weight = alpha * np.cumprod(np.concatenate([np.ones_like(alpha[:1]), 1.0 - alpha[:-1]]), axis=0)
    toward = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    radiance = model.radiance(toward)
    shares = model.light_share
    parts = np.stack([radiance * (1.0 - shares.sum(1)), radiance * shares[:, 0], radiance * shares[:, 1]])
    return np.einsum("nr,pnc->prc", weight, parts[:, order]), weight.sum(0)


@pytest.fixture
def unfilled(monkeypatch):
    """What was seen alone; returns where the coverage comes to be."""
    seen: list[np.ndarray] = []

    def filled(parts: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        seen.append(alpha)
        return parts

    monkeypatch.setattr(probe_render, "filled", filled)
    return seen


def test_parts_are_what_rays_meet(scene, shell, unfilled, tmp_path):
    model, path = shell
    target = import_model(path)
    # Neither where it stands nor how it is looked at counts.
    target.location, target.scale, target.rotation_euler = (5.0, 1.0, 2.0), (3.0,) * 3, (0.1, 0.2, 0.3)
    modifier = nodes.find_modifier(target)
    nodes.set_input(modifier, nodes.EXPOSURE, 3.0)
    nodes.set_input(modifier, nodes.LIGHTING_LEVEL, 7.0)
    blocks = [len(getattr(bpy.data, name)) for name in ("objects", "scenes", "cameras", "pointclouds")]
    done: list[float] = []
    probe = probe_render.render_probe(target, AT, WIDTH, tmp_path / "probe", done.append)
    assert done == [1 / 3, 2 / 3, 1.0] and probe == read_probe(tmp_path / "probe")
    assert blocks == [
        len(getattr(bpy.data, name)) for name in ("objects", "scenes", "cameras", "pointclouds")
    ]
    found = np.stack([read_exr(tmp_path / "probe" / name)[..., :3] for name in probe.files])
    steps = (np.arange(4) + 0.5) / 4
    every = [along_rays(model, directions(WIDTH, c, r).reshape(-1, 3)) for r in steps for c in steps]
    true = np.mean([each[0] for each in every], axis=0).reshape(found.shape)
    alpha = np.mean([each[1] for each in every], axis=0).reshape(found.shape[1:3])
    psnr = [
        10.0 * math.log10(t.max() ** 2 / np.square(f - t).mean()) for f, t in zip(found, true, strict=True)
    ]
    print("dB:", psnr, "coverage:", np.abs(unfilled[0] - alpha).mean())
    assert min(psnr) > 33.0
    assert np.abs(unfilled[0] - alpha).mean() < 0.01
    assert np.einsum("phwc->pc", found) == pytest.approx(np.einsum("phwc->pc", true), rel=0.05)


def test_what_is_hidden_or_too_near_is_not_drawn(scene, shell, unfilled, tmp_path):
    model, path = shell
    target = import_model(path)
    target.location = (7.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    nodes.set_input(nodes.find_modifier(target), nodes.LARGEST_SIZE, float(np.median(model.scale.max(1))))
    assert probe_checks._hidden(target) != ""
    probe_render.render_probe(target, AT, 32, tmp_path / "part")
    nodes.set_input(nodes.find_modifier(target), nodes.LARGEST_SIZE, 0.0)
    probe_render.render_probe(target, AT, 32, tmp_path / "whole")
    near = probe_render.render_probe(target, tuple(model.position[0].tolist()), 32, tmp_path / "near")
    part, whole, _ = unfilled
    assert 0.05 < part.mean() < 0.8 * whole.mean() and near.left_out >= 1


def test_a_folder_of_other_things_is_refused(scene, shell, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        probe_render.render_probe(import_model(shell[1]), AT, 16, folder)


def frame(position: tuple[float, float, float]) -> Frame:
    """A camera of 90 degrees that looks along +Y."""
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    pose[:3, 3] = position
    return Frame("f", "train", pose, 100, 80, 50.0, 50.0, 50.0, 40.0)


def test_a_place_that_no_camera_saw_is_told():
    frames = [frame((-1, 0, 0)), frame((1, 0, 0))]
    assert not probe_checks.is_outside(frames, np.array([0.0, 5.0, 0.0]))
    assert not probe_checks.is_outside(frames, np.array([1.0, 5.0, 3.9]))  # in one picture, at its top
    assert not probe_checks.is_outside(frames, np.array([0.5, -0.2, 0.0]))  # behind, but among them
    assert probe_checks.is_outside(frames, np.array([0.0, -5.0, 0.0]))
    assert probe_checks.is_outside(frames, np.array([0.0, 5.0, 4.2]))
    assert not probe_checks.is_outside([], np.zeros(3))


def test_a_probe_says_when_its_model_is_another_by_now(scene, shell, tmp_path: Path):
    import json
    from dataclasses import asdict

    from physhdr.addon.light import probes
    from physhdr.bridge.probe import Probe

    target = import_model(shell[1])
    empty = probes.new_probe(scene, target, AT)
    found = Probe(AT, 64, LIGHTS, 0.1, 0.01, 0, 30, "test")
    probes.mark(empty, target, "", found)
    probe_checks.note(empty, target, drawn_of(target.data))
    bpy.context.view_layer.update()
    assert probe_checks.warnings_of(empty, target) == []
    nodes.set_input(nodes.find_modifier(target), nodes.SMALLEST_OPACITY, 0.2)
    assert "edited" in probe_checks.warnings_of(empty, target)[0]
    nodes.set_input(nodes.find_modifier(target), nodes.SMALLEST_OPACITY, 0.0)
    empty[probes.KNOWN] = json.dumps(asdict(found) | {"unseen": 0.6, "gaussians": 31})
    empty.location.z += 1.0
    bpy.context.view_layer.update()
    told = probe_checks.warnings_of(empty, target)
    assert [word in each for word, each in zip(("moved", "edited", "60%"), told, strict=True)] == [True] * 3
