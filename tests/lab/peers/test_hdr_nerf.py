# SPDX-License-Identifier: GPL-3.0-or-later
"""HDR-NeRF from its equations: encoding, field, rays, volume rendering, losses, and a training."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate.metrics import psnr
from physhdr.backend.methods.base import Batch, MethodSetup
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.source import Decoded
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.config import TrainConfig, read_config, write_config
from physhdr.backend.train.saver import load_method
from physhdr.backend.train.state import TrainingDivergedError
from physhdr.backend.train.trainer import run, step
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.run_folder import CHECKPOINT_FILE
from physhdr.lab.peers import hdr_nerf
from physhdr.lab.peers.field import (
    Field,
    FieldConfig,
    importance_samples,
    positional_encoding,
    ray_weights,
    stratified,
)
from physhdr.lab.peers.hdr_nerf import HDRNeRF, HDRNeRFConfig, film_of, sum_in_parts
from physhdr.lab.peers.rays import RaySpace, mean_frame, pixel_directions

ANCHOR = (1.0, 0.73)
TINY = HDRNeRFConfig(
    field=FieldConfig(depth=3, width=24, skip=1, view_width=12, position_octaves=4, direction_octaves=2),
    tone_mapper_hidden=16,
    rays_per_iteration=48,
    coarse_samples=8,
    fine_samples=6,
    warm_start_steps=20,
)


def forward_facing(count: int = 5) -> list[Camera]:
    """Cameras beside each other that look along +Y in Blender's world, turned by a few degrees."""
    cameras = []
    for i in range(count):
        angle = 0.1 * (i - 0.5 * (count - 1))
        pose = np.eye(4)
        pose[:3, 0] = [math.cos(angle), math.sin(angle), 0.0]
        pose[:3, 1] = [0.0, 0.0, 1.0]
        pose[:3, 2] = [math.sin(angle), -math.cos(angle), 0.0]
        pose[:3, 3] = [0.4 * i, 0.1 * i, 1.5 - 0.1 * i]
        cameras.append(Camera(pose, 40, 30, 35.0, 36.0, 19.0, 16.0))
    return cameras


def ring(count: int = 6) -> list[Camera]:
    """Cameras around the origin, 3 m from it, that look at it."""
    cameras = []
    for angle in np.linspace(0.0, 2.0 * math.pi, count, endpoint=False):
        back = np.array([math.cos(angle), math.sin(angle), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([np.cross([0.0, 0.0, 1.0], back), [0.0, 0.0, 1.0], back], axis=1)
        pose[:3, 3] = 3.0 * back
        cameras.append(Camera.from_field_of_view(pose, 32, 32, 0.8))
    return cameras


def points_before(cameras: list[Camera]) -> np.ndarray:
    """A box 2 … 6 m before forward-facing cameras."""
    rng = np.random.default_rng(3)
    return rng.uniform([-1.5, 2.0, 0.0], [2.5, 6.0, 3.0], (500, 3))


def space_of(kind: str) -> tuple[RaySpace, list[Camera], np.ndarray]:
    cameras = forward_facing() if kind == "ndc" else ring()
    points = points_before(cameras) if kind == "ndc" else np.random.default_rng(1).normal(0.0, 0.4, (400, 3))
    space = RaySpace()
    space.survey(cameras, points, "auto")
    return space, cameras, points


def method_of(config: HDRNeRFConfig = TINY, anchor=ANCHOR, double: bool = False) -> HDRNeRF:
    """One whose fields are not black anywhere: random networks often are."""
    torch.manual_seed(1)
    method = HDRNeRF(config, MethodSetup(anchor))
    with torch.no_grad():
        for network in (method.coarse, method.fine):
            network.density.weight.mul_(4.0)
            network.density.bias.add_(1.0)
    if double:
        method.double()
    method.space.survey(forward_facing(), points_before(forward_facing()), "auto")
    return method


# -- the parts -----------------------------------------------------------------------------------------------


def test_positional_encoding_is_its_closed_form():
    x = torch.tensor([[0.3, -0.7, 1.1], [0.0, 2.0, -0.1]], dtype=torch.float64)
    expected = []
    for row in x.tolist():
        line = list(row)
        for octave in range(3):
            line += [math.sin(2.0**octave * v) for v in row] + [math.cos(2.0**octave * v) for v in row]
        expected.append(line)
    assert torch.allclose(positional_encoding(x, 3), torch.tensor(expected, dtype=torch.float64), atol=1e-14)
    assert positional_encoding(x, 10).shape == (2, 63) and positional_encoding(x, 4).shape == (2, 27)


@pytest.mark.parametrize("config", [FieldConfig(), TINY.field])
def test_the_field_is_nerf_layer_by_layer(config):
    """Against the layers one after the other: the field itself multiplies two of them first."""
    torch.manual_seed(0)
    field = Field(config).double()
    points, views = torch.randn(5, 4, 3, dtype=torch.float64), torch.randn(5, 3, dtype=torch.float64)
    with torch.no_grad():
        density, log_radiance = field(points, views)
        for r in range(5):
            for s in range(4):
                encoded = positional_encoding(points[r, s], config.position_octaves)
                hidden = encoded
                for i, layer in enumerate(field.layers):
                    hidden = layer(hidden).relu()
                    if i == config.skip and i + 1 < config.depth:
                        hidden = torch.cat([encoded, hidden])
                seen = torch.cat(
                    [field.feature(hidden), positional_encoding(views[r], config.direction_octaves)]
                )
                assert torch.allclose(density[r, s], field.density(hidden), atol=1e-12)
                expected = field.log_radiance(field.view(seen).relu())
                assert torch.allclose(log_radiance[r, s], expected, atol=1e-12)
        assert torch.allclose(field.densities(points), density)


def test_the_published_size():
    """NeRF's network has 595,844 parameters; both, and twice three curves 1 → 128 → 1."""
    assert sum(p.numel() for p in Field(FieldConfig()).parameters()) == 595_844
    parameters = HDRNeRF(HDRNeRFConfig(), MethodSetup()).parameters()
    assert sum(each.numel() for each in parameters) == 2 * (595_844 + 3 * (3 * 128 + 1))


def test_hes_first_weights_keep_a_signal_as_large_as_it_was():
    torch.manual_seed(0)
    points = torch.rand(4000, 3) * 2.0 - 1.0
    entering = positional_encoding(points, 10).square().mean()
    with torch.no_grad():
        kept, faded = (
            Field(FieldConfig(first_weights=kind)).trunk(points).square().mean() / entering
            for kind in ("he", "torch")
        )
    assert 0.5 < kept.item() < 4.0
    assert faded.item() < 0.05


def test_a_slab_of_constant_density_lets_exp_of_minus_sigma_l_through():
    sigma, samples = 1.7, 50
    t = torch.linspace(0.0, 1.0, samples, dtype=torch.float64)[None]
    directions = torch.tensor([[0.0, 1.2, 0.9]], dtype=torch.float64)  # 1.5 long
    weights = ray_weights(torch.full_like(t, sigma), t, directions)
    length = 1.5 * t[0]
    stopped = torch.cat([torch.zeros(1), weights[0].cumsum(0)[:-1]])
    assert torch.allclose(stopped, 1.0 - (-sigma * length).exp(), atol=1e-14)
    assert weights.sum().item() == pytest.approx(1.0, abs=1e-12)  # the last sample reaches beyond everything
    assert torch.equal(ray_weights(torch.full_like(t, -1.0), t, directions), torch.zeros_like(t))  # ReLU


def test_weights_are_alpha_times_what_the_samples_before_let_through():
    rng = torch.Generator().manual_seed(2)
    density = torch.randn(3, 6, generator=rng, dtype=torch.float64) * 5.0
    t = torch.rand(3, 6, generator=rng, dtype=torch.float64).sort(dim=1).values
    directions = torch.randn(3, 3, generator=rng, dtype=torch.float64)
    weights = ray_weights(density, t, directions)
    for r in range(3):
        passing, length = 1.0, float(directions[r].norm())
        for s in range(6):
            step = float(t[r, s + 1] - t[r, s]) if s < 5 else 1e10
            alpha = 1.0 - math.exp(-max(float(density[r, s]), 0.0) * step * length)
            assert float(weights[r, s]) == pytest.approx(passing * alpha, abs=1e-12)
            passing *= 1.0 - alpha
    density.requires_grad_()
    assert torch.autograd.gradcheck(lambda d: ray_weights(d, t, directions), (density,))


def test_stratified_samples_stay_in_their_strata_and_without_chance_in_the_middle():
    jitter = torch.rand(2000, 8, generator=torch.Generator().manual_seed(0))
    t = stratified(2000, 8, jitter)
    even = torch.linspace(0.0, 1.0, 8)
    edges = torch.cat([even[:1], 0.5 * (even[1:] + even[:-1]), even[-1:]])
    assert (t >= edges[:-1]).all() and (t <= edges[1:]).all()
    middles = 0.5 * (edges[1:] + edges[:-1])
    assert torch.allclose(t.mean(dim=0), middles, atol=5e-3)
    assert torch.allclose(stratified(3, 8, torch.full((1, 8), 0.5)), middles.expand(3, 8))


def test_importance_samples_are_distributed_as_the_weights():
    t = torch.linspace(0.0, 1.0, 6, dtype=torch.float64)[None]
    weights = torch.tensor([[9.0, 1.0, 0.0, 3.0, 2.0, 9.0]], dtype=torch.float64)  # the ends have no bin
    u = torch.rand(1, 40_000, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    samples = importance_samples(t, weights, u)[0].numpy()
    counts, _ = np.histogram(samples, bins=np.linspace(0.1, 0.9, 5))
    assert counts.sum() == 40_000
    np.testing.assert_allclose(counts / 40_000, np.array([1.0, 0.0, 3.0, 2.0]) / 6.0, atol=0.01)
    # Within a bin it is even: u = 1/6 + 3/12 is half way through the bin of 3, which begins at 0.5.
    half_way = importance_samples(t, weights, torch.tensor([[1.0 / 6.0 + 0.25]], dtype=torch.float64))
    assert half_way.item() == pytest.approx(0.6, abs=1e-4)
    ends = importance_samples(t, weights, torch.tensor([[0.0, 1.0]], dtype=torch.float64))
    assert ends[0].tolist() == pytest.approx([0.1, 0.9])


# -- rays ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["ndc", "metric"])
def test_what_lies_on_a_pixels_ray_projects_to_that_pixel(kind):
    space, cameras, _ = space_of(kind)
    assert space.name == kind
    inverse = np.linalg.inv(space.frame.numpy())
    numbers = space.numbers.numpy()
    rows, columns = torch.tensor([0, 7, 29]), torch.tensor([5, 0, 31])
    for camera in cameras:
        rays = space.rays(space.poses([camera]), pixel_directions(camera, rows, columns), torch.float64)
        for t in (0.0, 0.3, 0.9):
            x, y, z = rays.points(torch.full((3, 1), t, dtype=torch.float64))[:, 0].numpy().T
            if kind == "ndc":  # solve its definition for the point
                depth = 2.0 * numbers[0] / (z - 1.0)
                in_frame = np.stack([-x * depth / numbers[1], -y * depth / numbers[2], depth])
            else:
                in_frame = np.stack([x, y, z]) / numbers[2] + numbers[3:, None]
            world = (inverse[:3, :3] @ in_frame).T + inverse[:3, 3]
            seen = world @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            np.testing.assert_allclose(
                camera.fx * seen[:, 0] / seen[:, 2] + camera.cx, columns + 0.5, atol=1e-6
            )
            np.testing.assert_allclose(camera.fy * seen[:, 1] / seen[:, 2] + camera.cy, rows + 0.5, atol=1e-6)


def test_ndc_reaches_from_the_near_plane_to_infinity():
    space, cameras, points = space_of("ndc")
    rows, columns = torch.tensor([0, 29]), torch.tensor([39, 3])
    rays = space.rays(space.poses(cameras[:1]), pixel_directions(cameras[0], rows, columns), torch.float64)
    assert torch.allclose(rays.origins[:, 2], torch.tensor(-1.0, dtype=torch.float64), atol=1e-12)
    assert torch.allclose(rays.directions[:, 2], torch.tensor(2.0, dtype=torch.float64), atol=1e-12)
    depths = -(points @ space.frame.numpy()[2, :3] + space.frame.numpy()[2, 3])
    assert 0.7 * depths.min() < float(space.numbers[0]) < depths.min()


def test_metric_rays_hold_what_there_is_in_the_cube():
    space, cameras, points = space_of("metric")
    near, far, scale = space.numbers[:3].tolist()
    distances = np.concatenate([np.linalg.norm(points - camera.position, axis=1) for camera in cameras])
    assert near < np.quantile(distances, 0.01) and far > np.quantile(distances, 0.99)
    in_frame = points @ space.frame.numpy()[:3, :3].T + space.frame.numpy()[:3, 3]
    inside = np.abs((in_frame - space.numbers[3:].numpy()) * scale) <= 1.0 + 1e-9
    assert inside.mean() > 0.99
    rays = space.rays(
        space.poses(cameras[:1]),
        pixel_directions(cameras[0], torch.tensor([3]), torch.tensor([4])),
        torch.float64,
    )
    assert rays.directions.norm().item() == pytest.approx((far - near) * scale)


def test_ndc_is_refused_where_cameras_do_not_face_alike():
    with pytest.raises(BadValueError, match=r"mean direction.*\n?.*--set method.rays=metric"):
        RaySpace().survey(ring(), np.zeros((0, 3)), "ndc")
    space = RaySpace()
    with pytest.raises(BadValueError, match="has not seen its scene"):
        _ = space.name
    space.survey(forward_facing(), np.zeros((0, 3)), "auto")  # nothing known but the cameras
    assert space.name == "ndc" and float(space.numbers[0]) > 0.0
    space.survey(forward_facing(), points_before(forward_facing()), "metric")
    assert space.name == "metric"


def test_the_mean_frame_is_rigid_and_looks_as_the_cameras_do():
    frame = mean_frame(forward_facing())
    np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(frame[2, :3], [0.0, -1.0, 0.0], atol=1e-12)  # backwards, by symmetry


# -- the losses ----------------------------------------------------------------------------------------------


def test_losses_and_gradients_are_those_of_the_equations(tiny_data, monkeypatch):
    """Every term and gradient in float64, computed ray by ray, without parts, kernels or shortcuts."""
    monkeypatch.setattr(hdr_nerf, "CPU_VALUES", 5 * 14 * 24)  # five rays at once: the last part is smaller
    config = dataclasses.replace(TINY, rays_per_iteration=12)
    state = begin(read_scene(tiny_data), TrainConfig(method=config, iterations=10))
    method = method_of(config, double=True)
    batch = state.batch(3)
    film = method._film_of(state.data)
    rays, targets, log_t, generator = method._draw(film, batch.seed)
    jitter, u = method._chances(len(rays), generator)

    def curve(curves, x):  # [3] → [3]
        hidden = (curves.w1 * x[:, None] + curves.b1).relu()
        return ((curves.w2 * hidden).sum(1) + curves.b2).sigmoid()

    sums = {"coarse": 0.0, "fine": 0.0}
    for r in range(len(rays)):
        one = rays.split(1)[r]
        t = stratified(1, 8, jitter[r : r + 1])
        for name in ("coarse", "fine"):
            network, curves = getattr(method, name), getattr(method, f"{name}_curves")
            density, log_radiance = network(one.points(t), one.views)
            weights = ray_weights(density, t, one.directions)[0]
            ldr = sum(w * curve(curves, e + log_t[r]) for w, e in zip(weights, log_radiance[0], strict=True))
            sums[name] = sums[name] + (ldr - targets[r]).square().sum()
            if name == "coarse":
                more = importance_samples(t, weights[None].detach(), u[r : r + 1])
                t = torch.cat([t, more], dim=1).sort(dim=1).values
    at_one = torch.zeros(3, dtype=torch.float64)
    unit = sum((curve(c, at_one) - 0.73).square().mean() for c in (method.coarse_curves, method.fine_curves))
    expected = {name: each / (3 * len(rays)) for name, each in sums.items()} | {"unit": 0.5 * unit}
    parameters = list(method.parameters())
    gradients = torch.autograd.grad(sum(expected.values()), parameters)

    terms = method.training_outcome(batch).terms
    assert terms.keys() == expected.keys()
    for name, term in terms.items():
        assert term.item() == pytest.approx(expected[name].item(), rel=1e-10), name
    torch.stack(list(terms.values())).sum().backward()
    for parameter, gradient in zip(parameters, gradients, strict=True):
        assert parameter.grad is not None
        assert torch.allclose(parameter.grad, gradient, rtol=1e-8, atol=1e-12)
    assert all(float(gradient.abs().max()) > 0.0 for gradient in gradients)  # nothing is left out


def test_float32_with_kernels_agrees_with_float64(tiny_data):
    state = begin(read_scene(tiny_data), TrainConfig(method=TINY, iterations=10))
    batch = state.batch(0)
    config = dataclasses.replace(TINY, rays_per_iteration=400)
    single, double = method_of(config), method_of(config, double=True)
    double.load_state_dict(single.state_dict())
    # The same chances: float64 draws others than float32 does.
    film = single._film_of(state.data)
    rays, targets, log_t, generator = single._draw(film, batch.seed)
    chances = single._chances(len(rays), generator)
    errors = []
    for method in (single, double):
        dtype = method.coarse.density.weight.dtype
        some = dataclasses.replace(rays, **{k: v.to(dtype) for k, v in vars(rays).items()})
        coarse, fine = method.march(some, *(chance.to(dtype) for chance in chances))
        for marched, curves in ((coarse, method.coarse_curves), (fine, method.fine_curves)):
            error = method._squared_error(marched, curves, log_t.to(dtype), targets.to(dtype))
            errors.append(error.item() / targets.numel())
    assert errors[:2] == pytest.approx(errors[2:], rel=2e-3)


def test_sums_in_parts_hand_each_group_its_own_gradient():
    a, b = torch.tensor([2.0], requires_grad=True), torch.tensor([5.0], requires_grad=True)
    parts = lambda: (((x * a).sum(), (x * b * b).sum()) for x in (torch.ones(1), torch.ones(2)))  # noqa: E731
    first, second = sum_in_parts(parts, [a], [b])
    assert (first.item(), second.item()) == (6.0, 75.0)
    (2.0 * first + 10.0 * second).backward()
    assert (a.grad.item(), b.grad.item()) == (6.0, 300.0)


def test_without_a_known_response_the_unit_is_a_half_and_photographs_have_noise():
    torch.manual_seed(0)
    photographs, rendered = HDRNeRF(TINY, MethodSetup()), HDRNeRF(TINY, MethodSetup(ANCHOR))
    assert (photographs.density_noise, rendered.density_noise) == (1.0, 0.0)
    assert HDRNeRF(dataclasses.replace(TINY, density_noise=0.0), MethodSetup()).density_noise == 0.0
    curves = photographs.fine_curves
    with torch.no_grad():
        at_one = ((curves.w2 * curves.b1.relu()).sum(1) + curves.b2).sigmoid()
        assert curves.unit_exposure_error().item() == pytest.approx(float((at_one - 0.5).square().mean()))
    generator = torch.Generator().manual_seed(0)
    assert len(rendered._chances(4, generator)) == 2
    noise = photographs._chances(4000, generator)[3]
    assert noise.shape == (4000, 14)
    assert noise.std().item() == pytest.approx(1.0, abs=0.02)


@pytest.mark.long
def test_the_warm_start_reaches_its_target():
    torch.manual_seed(0)
    method = HDRNeRF(HDRNeRFConfig(field=TINY.field), MethodSetup(ANCHOR))  # 500 steps, 128 hidden
    x = torch.linspace(-3.0, 3.0, 101).expand(3, -1).contiguous()
    target = torch.nn.functional.softplus(x).clamp(0.0, 1.0)
    error = lambda curves: (curves.response(x) - target).abs().mean().item()  # noqa: E731
    before = error(method.fine_curves)
    method.prepare(0)
    assert before > 0.15
    assert error(method.coarse_curves) < 0.05 and error(method.fine_curves) < 0.05
    assert not torch.equal(method.fine_curves.w2, method.coarse_curves.w2)


def test_rates_fall_as_published():
    rate = HDRNeRF(TINY, MethodSetup(ANCHOR)).rates()["fine"]
    assert rate.at(0.0, 7.0) == pytest.approx(5e-4)  # no extent in it
    assert rate.at(1.0, 7.0) == pytest.approx(5e-4 * 0.1 ** (200 / 500), rel=1e-3)
    assert rate.at(0.5, 7.0) == pytest.approx(5e-4 * 0.1 ** (100 / 500), rel=1e-3)


# -- pictures ------------------------------------------------------------------------------------------------


def test_pictures_are_the_rendering_of_radiance_and_of_tone_mapped_samples():
    method, camera = method_of(), forward_facing()[1]
    hdr, ldr = method.hdr(camera), method.ldr(camera, 2.0)
    assert hdr.shape == ldr.shape == (3, 30, 40)
    row, column = 11, 23
    directions = pixel_directions(camera, torch.tensor([row]), torch.tensor([column]))
    ray = method.space.rays(method.space.poses([camera]), directions, torch.float32)
    with torch.no_grad():
        _, marched = method.march(ray, torch.full((1, 8), 0.5), torch.linspace(0.0, 1.0, 6)[None])
        weights, log_radiance = marched.weights[0].double(), marched.log_radiance[:, 0].double()
        curves = method.fine_curves.double()
        mapped = curves.curve_logits(log_radiance + math.log(2.0)).sigmoid()
    assert 0.2 < float(weights.sum()) <= 1.0 + 1e-6
    assert torch.allclose(hdr[:, row, column].double(), (weights * log_radiance.exp()).sum(1), rtol=1e-4)
    assert torch.allclose(ldr[:, row, column].double(), (weights * mapped).sum(1), atol=1e-5)


def test_a_bracket_is_its_pictures_and_levels_scale(monkeypatch):
    method, camera = method_of(), forward_facing()[0]
    together = method.ldr_bracket(camera, [0.5, 4.0])
    hdr = method.hdr(camera)
    monkeypatch.setattr(hdr_nerf, "CPU_VALUES", 1 << 14)  # other parts, the same pictures
    alone = method_of()
    for picture, exposure in zip(together, (0.5, 4.0), strict=True):
        assert torch.allclose(alone.ldr(camera, exposure), picture, atol=1e-5)
    assert torch.allclose(alone.hdr(camera, 3.0), 3.0 * hdr, rtol=1e-4)
    assert torch.equal(method.ldr(camera, 1.0, 4.0), together[1])
    assert not method.can_relight


def test_what_was_rendered_is_kept_until_a_parameter_changes(monkeypatch):
    method, camera = method_of(), forward_facing()[0]
    calls = []
    render = method._render
    monkeypatch.setattr(method, "_render", lambda *a: calls.append(a) or render(*a))
    first = method.ldr_bracket(camera, [1.0, 2.0])[0]
    first.zero_()  # the caller's own
    assert method.ldr(camera, 1.0).sum() > 0.0
    before = method.hdr(camera)
    assert len(calls) == 1
    adam = torch.optim.Adam(method.parameters(), lr=1e-2, fused=True)
    sum(p.sum() for p in method.fine.parameters()).backward()
    adam.step()
    assert not torch.allclose(method.hdr(camera), before)
    method.load_state_dict(method_of().state_dict())
    assert torch.allclose(method.hdr(camera), before, rtol=1e-4)
    assert len(calls) == 3
    monkeypatch.setattr(hdr_nerf, "KEPT_BYTES", 0)
    method.ldr_bracket(camera, [3.0, 4.0])
    assert len(method._cache) == 3


# -- training ------------------------------------------------------------------------------------------------

LEARNING = dataclasses.replace(
    TINY,
    field=dataclasses.replace(TINY.field, width=32, view_width=16, first_weights="he"),
    rays_per_iteration=128,
    coarse_samples=12,
    fine_samples=12,
    learning_rate=5e-3,
    final_rate_share=0.1,
    warm_start_steps=200,
)


def train(scene, config, folder, stop_at=None):
    folder.mkdir(parents=True, exist_ok=True)
    state = begin(scene, config)
    for _ in run(state, folder, should_stop=lambda: state.iteration == stop_at):
        pass
    return state


@pytest.mark.long
def test_a_short_training_learns_the_scene_and_its_files_hold_it(tiny_data, tmp_path):
    scene = read_scene(tiny_data)
    config = TrainConfig(method=LEARNING, iterations=300)
    state = train(scene, config, tmp_path)
    view = scene.train[1]
    truth = torch.from_numpy(view.image(2).copy()).permute(2, 0, 1) / 255.0
    picture = state.method.ldr(view.camera, view.exposures[2])
    assert psnr(picture, truth) > 20.0
    flat = truth.mean(dim=(1, 2), keepdim=True).expand_as(truth)
    assert psnr(picture, truth) > psnr(flat, truth) + 4.0

    write_config(tmp_path / "config.json", config, tiny_data, "hdr-nerf")
    read = read_config(tmp_path / "config.json").config
    assert read == config
    method, _ = load_method(tmp_path, read, scene.response_anchor)
    assert torch.equal(method.ldr(view.camera, view.exposures[2]), picture)
    x, curve = method.response_curve()
    assert curve.shape == (x.numel(), 3)
    assert curve[-1].min() > curve[0].max() + 0.3  # it rises


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_stopped_and_resumed_run_is_bit_identical(tiny_data, tmp_path, noise):
    scene = read_scene(tiny_data)
    method = dataclasses.replace(TINY, density_noise=noise)
    config = TrainConfig(method=method, iterations=12, exposure_mode="exp1")
    train(scene, config, tmp_path / "whole")
    train(scene, config, tmp_path / "parts", stop_at=5)
    state = resume(tmp_path / "parts", scene, config)
    for _ in run(state, tmp_path / "parts"):
        pass
    whole, parts = (load_checkpoint(tmp_path / name / CHECKPOINT_FILE)[0] for name in ("whole", "parts"))
    assert whole.keys() == parts.keys() and any(name.startswith("adam.") for name in whole)
    for name in whole:
        assert torch.equal(whole[name], parts[name]), name


def test_points_come_from_the_data_set_else_from_stereo(tiny_data):
    state = begin(read_scene(tiny_data), TrainConfig(method=TINY, iterations=4))
    response = state.method.first_response
    assert len(state.data.first_points(response)) == 60
    without = begin(dataclasses.replace(state.plan.seen.scene, points=None), state.config)
    found = without.data.first_points(response)
    assert found.shape[1:] == (3,)
    step(state)
    assert state.method.space.is_known


def test_rays_that_the_cameras_forbid_are_told_as_what_they_are(tiny_data, tmp_path):
    """Not as a training that diverged, which lower learning rates would fix."""
    scene = read_scene(tiny_data)
    train = []
    for view, around in zip(scene.train, ring(len(scene.train)), strict=True):
        camera = dataclasses.replace(view.camera, camera_to_world=around.camera_to_world)
        train.append(dataclasses.replace(view, camera=camera))
    config = TrainConfig(method=dataclasses.replace(TINY, rays="ndc"), iterations=4)
    state = begin(dataclasses.replace(scene, train=train), config)
    with pytest.raises(BadValueError, match="cannot be in NDC") as raised:
        list(run(state, tmp_path))
    assert raised.value.hint == "Give --set method.rays=metric."


def test_nan_is_rejected(tiny_data, tmp_path):
    state = begin(read_scene(tiny_data), TrainConfig(method=TINY, iterations=30))
    with torch.no_grad():
        state.method.fine.log_radiance.bias[1] = math.nan
    with pytest.raises(TrainingDivergedError, match="not a number"):
        list(run(state, tmp_path))
    assert not (tmp_path / CHECKPOINT_FILE).exists()


def test_every_picture_that_training_may_see_is_on_the_film(tiny_data):
    state = begin(read_scene(tiny_data), TrainConfig(method=TINY, iterations=4))
    method = state.method
    film = method._film_of(state.data)
    assert film.codes.shape == (3 * 3 * 32 * 32, 3)  # three views, three exposures
    rays, targets, log_exposures, _ = method._draw(film, (0, 0))
    assert isinstance(state.batch(0), Batch)
    allowed = {round(math.log(view.exposures[k]), 4) for view in state.views for k in (0, 2, 4)}
    assert {round(x, 4) for x in log_exposures.tolist()} == allowed
    # A drawn ray is that of its pixel: find the pixel by projecting, and compare its value.
    numbers, inverse = method.space.numbers.numpy(), np.linalg.inv(method.space.frame.numpy())
    x, y, z = rays.points(torch.full((len(rays), 1), 0.4))[:, 0].double().numpy().T
    depth = 2.0 * numbers[0] / (z - 1.0)
    in_frame = np.stack([-x * depth / numbers[1], -y * depth / numbers[2], depth])
    world = (inverse[:3, :3] @ in_frame).T + inverse[:3, 3]
    for i in range(len(rays)):
        matches = []
        for view in state.views:
            seen = view.camera.world_to_camera[:3, :3] @ world[i] + view.camera.world_to_camera[:3, 3]
            column = view.camera.fx * seen[0] / seen[2] + view.camera.cx - 0.5
            row = view.camera.fy * seen[1] / seen[2] + view.camera.cy - 0.5
            if max(abs(row - round(row)), abs(column - round(column))) > 1e-2:
                continue
            if not (0 <= round(row) < 32 and 0 <= round(column) < 32):
                continue
            k = [math.log(t) for t in view.exposures].index(pytest.approx(float(log_exposures[i]), abs=1e-4))
            matches.append(view.image(k)[round(row), round(column)] / 255.0)
        assert any(np.allclose(match, targets[i].numpy(), atol=1e-6) for match in matches)


def test_masked_pixels_are_never_drawn_and_16_bits_are_kept(tiny_data):
    """One picture of 16 bits and one with a mask: all of the film is then of 16 bits, 257 times the 8."""
    state = begin(read_scene(tiny_data), TrainConfig(method=TINY, iterations=4))
    view, k = state.views[1], state.data.exposures[1][0]
    read, mask = view.cache.get(view.sources[k]), np.zeros((32, 32), bool)
    mask[10:20] = True
    deep = read.codes.astype(np.uint16) * np.uint16(257) + np.uint16(11)
    view.cache._pictures[view.sources[k].key] = Decoded(deep, mask)
    film = film_of(state.data, state.method.space, torch.device("cpu"))
    assert film.codes.dtype == torch.uint16 and film.largest == 65535.0
    first = 3 * 32 * 32  # of the second view
    there = film.compared[(film.compared >= first) & (film.compared < first + 32 * 32)] - first
    assert torch.equal(there, torch.arange(10 * 32, 20 * 32)) and film.size == 8 * 32 * 32 + 10 * 32
    assert np.array_equal(film.codes[first : first + 1024].int().numpy(), deep.reshape(-1, 3))
    eight = state.views[0].image(state.data.exposures[0][0]).reshape(-1, 3)
    assert np.array_equal(film.codes[:1024].int().numpy() / 65535.0, eight / 255.0)
    step(state)
