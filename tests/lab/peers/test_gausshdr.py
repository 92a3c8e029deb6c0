# SPDX-License-Identifier: GPL-3.0-or-later
"""GaussHDR: its forward pass in NumPy, its losses in float64, and that it learns."""

import copy
import dataclasses
import math

import numpy as np
import pytest
import torch

from physhdr.backend.evaluate.protocol import evaluate
from physhdr.backend.kernels import ssim_map_reference
from physhdr.backend.methods.base import Batch, MethodSetup, Recording
from physhdr.backend.model.backbone import Start
from physhdr.backend.model.gaussians import initial_gaussians
from physhdr.backend.model.tone_mapper import ToneMapperConfig
from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.camera import Camera
from physhdr.backend.train.backbones import new_method
from physhdr.backend.train.begin import begin, resume
from physhdr.backend.train.checkpoint import load_checkpoint
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import run
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.run_folder import CHECKPOINT_FILE
from physhdr.lab.peers.gausshdr import GaussHDR, GaussHDRConfig, Half

ANCHOR = (1.0, 0.73)
EXPOSURE = 2.0


@pytest.fixture
def camera():
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera.from_field_of_view(pose, 24, 20, 0.8)


def make(anchor=ANCHOR, implementation="cpu", **changes) -> GaussHDR:
    """A method of 30 Gaussians of which nothing is where it started."""
    config = dataclasses.replace(PRESETS["gausshdr"].method, **changes)
    rng = np.random.default_rng(5)
    gaussians = initial_gaussians(
        rng.uniform(-0.6, 0.6, (30, 3)),
        rng.uniform(-1.5, 0.5, (30, 3)),
        sh_degree=3,
        opacity=0.6,
        ambient_share=None,
        context_size=4,
        seed=0,
    )
    torch.manual_seed(2)
    method = GaussHDR(config, gaussians, MethodSetup(anchor, implementation))
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for name, tensor in [*method.named_parameters(), *gaussians.parameters.items()]:
            if name not in ("means", "log_illumination"):
                tensor += 0.3 * torch.randn(tensor.shape, generator=generator)
    return method


def in_double(method: GaussHDR) -> GaussHDR:
    """A copy that computes in float64, in plain torch, by the reference rasteriser."""
    double = copy.deepcopy(method).double()
    double.implementation = "reference"
    double.backbone.parameters = {
        name: tensor.detach().double().requires_grad_() for name, tensor in method.backbone.parameters.items()
    }
    return double


def array(tensor):
    return tensor.detach().double().numpy()


def sigmoid(z):
    return 1.0 / (1.0 + np.exp(-z))


def tone_mapper_by_hand(method, x, context):
    """g_c(x), clip(g_c + Δ_c − ½, 0, 1) and u of ``x`` ``[3, P]`` and ``context`` ``[4, P]``, in NumPy."""
    mapper, net = method.tone_mapper, method.uncertainty.network
    glo, loc, u = [], [], []
    for c in range(3):
        hidden = np.log1p(np.exp(np.outer(array(mapper.w1)[c], x[c]) + array(mapper.b1)[c][:, None]))
        glo.append(sigmoid(array(mapper.w2)[c] @ hidden + array(mapper.b2)[c]))
        seen = np.concatenate([x[c][None], context])

        def network(of, seen=seen):
            return array(of.w2) @ np.maximum(array(of.w1) @ seen + array(of.b1)[:, None], 0.0) + array(of.b2)

        correction = sigmoid(network(mapper.local_curves[c])[0])
        loc.append(np.clip(glo[c] + correction - 0.5, 0.0, 1.0))
        u.append(np.log1p(np.exp(network(net)[0])))  # the same network for every channel
    return np.array(glo), np.array(loc), np.array(u)


def test_the_forward_pass_is_as_described(camera):
    """Both ways, from sixteen drawn channels: 3-D global, local, radiance, context and uncertainty."""
    method = make()
    splats = method.backbone.splats(camera, 3)
    log_radiance, context = array(splats.log_reflectance), array(splats.context)
    glo, loc, u = tone_mapper_by_hand(method, (log_radiance + math.log(EXPOSURE)).T, context.T)
    sixteen = np.concatenate([glo.T, loc.T, np.exp(log_radiance), context, u.T], axis=1)
    assert sixteen.shape == (30, 16)
    geometry = (splats.means, splats.quaternions, splats.scales, splats.opacities)
    image = rasterize(*(g.detach().double() for g in geometry), torch.tensor(sixteen), camera).image.numpy()
    _, local_3d, radiance, features, u_3d = np.split(image, [3, 6, 9, 13])
    x = np.log(radiance * EXPOSURE + 1e-5)
    global_2d, local_2d, u_2d = (
        part.reshape(3, 20, 24)
        for part in tone_mapper_by_hand(method, x.reshape(3, -1), features.reshape(4, -1))
    )
    u_3d, u_2d = np.maximum(u_3d, 0.1), np.maximum(u_2d, 0.1)
    fused = (u_2d**2 * local_3d + u_3d**2 * local_2d) / (u_2d**2 + u_3d**2)

    drawn = method.draw(camera, EXPOSURE)
    for got, expected in [
        (drawn.in_3d.ldr, local_3d),
        (drawn.in_3d.uncertainty, u_3d),
        (drawn.in_2d.ldr, local_2d),
        (drawn.in_2d.uncertainty, u_2d),
        (drawn.global_2d, global_2d),
        (drawn.ldr, fused),
        (method.ldr(camera, EXPOSURE), fused),
        (method.hdr(camera), radiance),
    ]:
        assert np.abs(array(got) - expected).max() < 2e-4
    # All of it matters here: the two ways differ, and so do global and local.
    assert np.abs(local_3d - local_2d).max() > 0.02 and np.abs(global_2d - local_2d).max() > 0.02


def test_the_sum_of_the_losses_in_float64(camera):
    """Each term by its formula, and the gradient of their sum with respect to everything that learns."""
    method = make()
    picture = torch.rand(3, 20, 24, generator=torch.Generator().manual_seed(1))
    drawn = method.draw(camera, EXPOSURE, watch=True)
    terms = method.losses(drawn, picture)

    double = in_double(method)
    expected = double.draw(camera, EXPOSURE, watch=True)
    y = picture.double()
    total, rec, likelihood = 0.0, 0.0, 0.0
    u_3d, u_2d = expected.in_3d.uncertainty, expected.in_2d.uncertainty
    for half, other in ((expected.in_3d, u_2d), (expected.in_2d, u_3d)):
        weight = (other**2 / (u_3d**2 + u_2d**2)).detach()
        dissimilarity = 1.0 - ssim_map_reference(half.ldr, y)
        rec = rec + (weight * (0.8 * (half.ldr - y).abs() + 0.2 * dissimilarity)).mean()
        u = half.uncertainty
        likelihood = likelihood + (dissimilarity.detach() / (2 * u**2) + 0.5 * u.log()).mean()
    glo = expected.global_2d
    global_2d = 0.5 * (0.8 * (glo - y).abs().mean() + 0.2 * (1 - ssim_map_reference(glo, y)).mean())
    m = double.tone_mapper
    at_one = (m.w2 * torch.nn.functional.softplus(m.b1)).sum(1) + m.b2  # ln 1 = 0
    unit = 0.5 * (at_one.sigmoid() - 0.73).square().mean()
    for name, value in {"rec": rec, "uncertainty": likelihood, "global": global_2d, "unit": unit}.items():
        assert terms[name].item() == pytest.approx(value.item(), rel=1e-4), name
    assert set(terms) == {"rec", "uncertainty", "global", "unit"}

    sum(terms.values()).backward()
    total = rec + likelihood + global_2d + unit
    total.backward()
    learned = {**dict(method.named_parameters()), **method.backbone.parameters}
    reference = {**dict(double.named_parameters()), **double.backbone.parameters}
    assert learned.pop("log_illumination").grad is None  # stays 0, so ln radiance is ln H_r
    for name, tensor in learned.items():
        error = (tensor.grad.double() - reference[name].grad).norm() / reference[name].grad.norm()
        assert error < 2e-3, (name, error)
    watched, watched_reference = drawn.screen_offsets.grad.double(), expected.screen_offsets.grad
    assert (watched - watched_reference).norm() < 2e-3 * watched_reference.norm()


@pytest.mark.long
def test_only_the_likelihood_teaches_the_uncertainty(camera):
    method = make()
    picture = torch.rand(3, 20, 24)
    network = list(method.uncertainty.parameters())
    mapper = [p for name, p in method.tone_mapper.named_parameters()]
    terms = method.losses(method.draw(camera, EXPOSURE), picture)
    gradients = torch.autograd.grad(terms["rec"], network, allow_unused=True, retain_graph=True)
    assert all(g is None or not g.any() for g in gradients)
    # … and it teaches nothing else of the tone mapper: neither D nor the network's inputs learn.
    gradients = torch.autograd.grad(
        terms["uncertainty"], [*network, *mapper], allow_unused=True, retain_graph=True
    )
    assert all(g.abs().max() > 0 for g in gradients[: len(network)])
    assert all(g is None or not g.any() for g in gradients[len(network) :])
    # … nor do the splats, unless they are let.
    shapes = [method.gaussians.parameters[name] for name in ("means", "log_scales", "opacity_logits")]
    gradients = torch.autograd.grad(terms["uncertainty"], shapes, allow_unused=True)
    assert all(g is None or not g.any() for g in gradients)
    literal = make(uncertainty_moves_splats=True)
    drawn, drawn_at_once = method.draw(camera, EXPOSURE), literal.draw(camera, EXPOSURE)
    assert drawn_at_once.rasterization.image.shape[0] == drawn.rasterization.image.shape[0] + 3 == 13
    assert torch.allclose(drawn.in_3d.uncertainty, drawn_at_once.in_3d.uncertainty, atol=1e-5)
    literal.losses(drawn_at_once, picture)["uncertainty"].backward()
    assert literal.gaussians.means.grad.any() and literal.gaussians.opacity_logits.grad.any()


def test_no_splat_is_more_certain_than_the_bound():
    method = make()
    with torch.no_grad():
        method.uncertainty.network.b2.fill_(-20.0)
    u = method.uncertainty(torch.zeros(3, 7), torch.zeros(4, 7))
    assert torch.equal(u, torch.full((3, 7), 0.1))


def test_a_perfect_picture_leaves_the_logarithm_of_the_uncertainties(camera):
    method = make()
    picture = torch.rand(3, 20, 24)
    drawn = method.draw(camera, EXPOSURE)
    halves = {
        "in_3d": Half(picture, torch.full_like(picture, 0.5)),
        "in_2d": Half(picture, torch.full_like(picture, 0.2)),
    }
    terms = method.losses(dataclasses.replace(drawn, **halves, global_2d=picture), picture)
    assert terms["rec"].item() == pytest.approx(0.0, abs=1e-6)
    assert terms["global"].item() == pytest.approx(0.0, abs=1e-6)
    assert terms["uncertainty"].item() == pytest.approx(0.5 * (math.log(0.5) + math.log(0.2)), abs=1e-5)


def test_gamma_is_smaller_where_no_anchor_is_known(camera):
    picture = torch.rand(3, 20, 24)
    with_anchor, without = make(), make(anchor=None)
    at = {m: m.losses(m.draw(camera, EXPOSURE), picture) for m in (with_anchor, without)}
    ratio = at[without]["global"] / at[with_anchor]["global"]
    assert ratio.item() == pytest.approx(0.2 / 0.5, rel=1e-5)
    assert "unit" not in at[without]


def test_a_level_scales_as_an_exposure(camera):
    method = make()
    assert torch.allclose(method.ldr(camera, 2.0, 3.0), method.ldr(camera, 6.0), atol=1e-6)
    assert torch.allclose(method.hdr(camera, 3.0), 3.0 * method.hdr(camera), rtol=1e-5)
    drawn = method.preview(camera, 3.0)
    shown, black = method.preview_ldr(drawn, camera, 2.0, 3.0)
    assert torch.equal(shown, method.ldr(camera, 2.0, 3.0))
    behind = np.eye(4)
    behind[2, 3] = -3.0  # looks away: nothing is in the picture
    away = dataclasses.replace(camera, camera_to_world=behind)
    assert torch.allclose(method.ldr(away, 2.0), black.expand(3, 20, 24), atol=1e-6)


def test_from_where_no_anchor_is_seen_nothing_is_developed(camera):
    """All Gaussians of the backbone may be out of sight, in training too; each of their tensors is empty."""
    config = PRESETS["gausshdr-scaffold"]
    method = new_method(config.method, config.backbone, MethodSetup(ANCHOR, "cpu"))
    behind = np.random.default_rng(5).uniform(-0.6, 0.6, (30, 3)) + [0.0, 0.0, 9.0]
    method.backbone.place(behind, np.zeros((30, 3)), Start())
    assert method.hdr(camera).max() == 0.0
    nothing = method.preview(camera)
    at_nothing = method.preview_ldr(nothing, camera, EXPOSURE)[1]
    assert torch.allclose(method.ldr(camera, EXPOSURE), at_nothing.expand(3, 20, 24), atol=1e-6)
    recording = Recording(exposure=EXPOSURE, picture=torch.rand(3, 20, 24))
    batch = Batch(camera=camera, recordings=(recording,), levels=(1.0,), iteration=0, pool=None)
    terms = method.training_outcome(batch).terms.values()
    torch.stack(list(terms)).sum().backward()
    assert all(torch.isfinite(term) for term in terms)


def test_global_curves_stand_in_for_local_ones_until(camera):
    """The paper's first 6 k of 30 k iterations."""
    method = make(global_until=0.2)
    method.follow_schedule(19, 100, 1)
    early = method.draw(camera, EXPOSURE)
    assert torch.equal(early.in_2d.ldr, early.global_2d)
    sum(method.losses(early, torch.rand(3, 20, 24)).values()).backward()
    assert all(p.grad is None for p in method.tone_mapper.local_curves.parameters())
    method.follow_schedule(20, 100, 1)
    later = method.draw(camera, EXPOSURE)
    assert not torch.allclose(later.in_2d.ldr, later.global_2d, atol=1e-2)
    sum(method.losses(later, torch.rand(3, 20, 24)).values()).backward()
    assert all(p.grad.abs().max() > 0 for p in method.tone_mapper.local_curves.parameters())


def test_what_cannot_be():
    with pytest.raises(BadValueError, match="local"):
        GaussHDRConfig(tone_mapper=ToneMapperConfig(local=False))
    with pytest.raises(BadValueError, match=r"method\.sh_degree"):
        GaussHDRConfig(sh_degree=4)
    with pytest.raises(BadValueError, match="uncertainty"):
        GaussHDRConfig(least_uncertainty=0.0)
    with pytest.raises(BadValueError, match=r"bracket[\s\S]*--set supervision=one"):
        dataclasses.replace(PRESETS["gausshdr"], supervision="bracket")


def test_the_published_rates_and_parts():
    config = PRESETS["gausshdr"]
    method = make()
    rate = method.rates()["tone_mapper"]
    assert (rate.at(0.0, 7.0), rate.at(1.0, 7.0)) == pytest.approx((5e-4, 5e-5))
    assert rate.at(0.5, 7.0) == pytest.approx(math.sqrt(5e-4 * 5e-5))  # log-linear
    assert config.iterations == 30_000 and config.method.tone_mapper.warm_start_steps == 1000
    assert config.method.global_until == 0.0  # as in the code
    sizes = {tuple(p.shape) for p in method.uncertainty.parameters()}
    assert sizes == {(64, 5), (64,), (1, 64), (1,)}
    groups = method.parameter_groups()
    assert {id(p) for p in method.uncertainty.parameters()} <= {id(p) for p in groups["tone_mapper"]}


def short(**changes):
    config = PRESETS["gausshdr"]
    density = dataclasses.replace(
        config.backbone, start=5, every=10, stop=0.8, threshold=1e-5, reset_every=25, prune_scale=10.0
    )
    mapper = dataclasses.replace(config.method.tone_mapper, warm_start_steps=50)
    method = dataclasses.replace(config.method, global_until=0.5, tone_mapper=mapper)
    return dataclasses.replace(config, iterations=40, backbone=density, method=method, **changes)


def test_it_goes_on_bit_identically_across_the_switch_to_local_curves(tiny_data, tmp_path):
    scene, config = read_scene(tiny_data), short()
    for name in ("whole", "parts"):
        (tmp_path / name).mkdir()
    for _ in run(begin(scene, config), tmp_path / "whole"):
        pass
    state = begin(scene, config)
    for _ in run(state, tmp_path / "parts", should_stop=lambda: state.iteration >= 15):
        pass
    resumed = resume(tmp_path / "parts", scene, config)
    for _ in run(resumed, tmp_path / "parts"):
        pass
    whole, parts = (load_checkpoint(tmp_path / name / CHECKPOINT_FILE)[0] for name in ("whole", "parts"))
    assert whole.keys() == parts.keys() and len(resumed.method.gaussians) > 60
    assert "networks.uncertainty.network.w1" in whole
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


@pytest.mark.long
def test_it_learns_the_tiny_scene(tiny_data, tmp_path):
    """Few soft Gaussians before a bright background are hard for the 3-D way, which blends LDR colours."""
    scene = read_scene(tiny_data)
    config = PRESETS["gausshdr-short"]
    config = dataclasses.replace(
        config, iterations=250, sh_degree_every=1000, backbone=dataclasses.replace(config.backbone, stop=0.0)
    )
    state = begin(scene, config)
    before = evaluate(state.method, scene)
    for _ in run(state, tmp_path):
        pass
    after = evaluate(state.method, scene)
    assert after.ldr_oe.psnr > max(22.5, before.ldr_oe.psnr + 8.0)
    drawn = state.method.draw(scene.test[0].camera, 2.0)
    assert drawn.in_3d.uncertainty.min() >= 0.1 and drawn.in_2d.uncertainty.std() > 0.0
