# SPDX-License-Identifier: GPL-3.0-or-later
"""A bracket compared by one kernel, against float64 autograd of the same picture by picture."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from numba import njit

from physhdr.backend.kernels import SsimTarget, plain_torch, ssim_and_error
from physhdr.backend.methods.base import Recording
from physhdr.backend.methods.physhdr import DrawnRadiance, PhysHDR
from physhdr.backend.model.tone_mapper import STEEPEST, ToneMapper, ToneMapperConfig
from physhdr.backend.scene.encoding import SRGB
from physhdr.backend.simd import LANES, add_powers, load, load_quads, store
from physhdr.backend.train.presets import PRESETS
from physhdr.tests.backend.threads import assert_same_bits

EXPOSURES = (0.125, 1.0, 1.0 / 30.0)


def response(seed=0, activation="softplus"):
    torch.manual_seed(seed)
    result = ToneMapper(ToneMapperConfig(activation=activation), (1.0, 0.5))
    with torch.no_grad():
        result.w2.add_(0.1 * torch.randn_like(result.w2))
    return result


def pictures(height, width):
    """Radiance, some of it 0 and some below, and pictures."""
    generator = torch.Generator().manual_seed(1)
    radiance = 8.0 * torch.rand(3, height, width, generator=generator) ** 3
    radiance[0, 3, 2:7], radiance[1, 4, 5] = 0.0, -0.1
    return radiance, [torch.rand(3, height, width, generator=generator) for _ in EXPOSURES]


def one_by_one(mapper, radiance, exposures, targets, error):
    """As ``PhysHDR.develop_bracket`` and L_rec do it, in plain torch."""
    with plain_torch():
        found = []
        for exposure, target in zip(exposures, targets, strict=True):
            shown, _ = mapper.tone_map(radiance * exposure, None)
            found.append(ssim_and_error(shown, target.to(radiance), error))
    return torch.stack([s for s, _ in found]), torch.stack([p for _, p in found])


def gradients(function, mapper, radiance):
    """Values and gradients of radiance and the response's parameters; each picture has its own weight."""
    radiance = radiance.clone().requires_grad_()
    similarity, pixel = function(mapper, radiance)
    weights = torch.linspace(0.3, 1.0, len(similarity)).to(radiance)
    loss = (similarity * weights - 2.0 * pixel * weights.flip(0)).sum()
    return [similarity, pixel, *torch.autograd.grad(loss, [radiance, *mapper.parameters()])]


@pytest.mark.parametrize("size", [(60, 80), (33, 61), (97, 64), (300, LANES + 1)])
@pytest.mark.parametrize("error", ["l1", "mse"])
@pytest.mark.parametrize("activation", ["softplus", "silu"])
def test_against_float64(size, error, activation):
    mapper, (radiance, targets) = response(activation=activation), pictures(*size)

    def fused(mapper, radiance):
        found = mapper.bracket_errors(radiance, EXPOSURES, [SsimTarget(t) for t in targets], error)
        assert found is not None
        return found

    ours = gradients(fused, mapper, radiance)
    truth = gradients(
        lambda mapper, radiance: one_by_one(mapper, radiance, EXPOSURES, targets, error),
        copy.deepcopy(mapper).double(),
        radiance.double(),
    )
    names = ["similarity", "pixel", "radiance", *(name for name, _ in mapper.named_parameters())]
    for name, a, b in zip(names, ours, truth, strict=True):
        bound = 1e-6 if name in ("similarity", "pixel") else 2e-5
        assert (a.detach() - b.detach()).norm() <= bound * b.detach().norm(), name


def test_threads():
    mapper, (radiance, targets) = response(), pictures(150, 61)
    known = [SsimTarget(t) for t in targets]
    assert_same_bits(
        lambda: gradients(lambda m, x: m.bracket_errors(x, EXPOSURES, known, "l1"), mapper, radiance)
    )


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_what_no_table_holds_is_left_to_the_other_way(bad):
    mapper, (radiance, targets) = response(), pictures(60, 80)
    known = [SsimTarget(t) for t in targets]
    assert mapper.bracket_errors(radiance, EXPOSURES, known, "l1") is not None
    assert mapper.bracket_errors(radiance.double(), EXPOSURES, known, "l1") is None
    spoiled = radiance.clone()
    spoiled[1, 2, 3] = bad
    assert mapper.bracket_errors(spoiled, EXPOSURES, known, "l1") is None
    few, some = pictures(8, 8)
    assert mapper.bracket_errors(few, EXPOSURES, [SsimTarget(t) for t in some], "l1") is None
    with torch.no_grad():
        mapper.slope.fill_(2.0 * STEEPEST)
    assert mapper.bracket_errors(radiance, EXPOSURES, known, "l1") is None
    assert response(activation="relu").bracket_errors(radiance, EXPOSURES, known, "l1") is None


def test_a_methods_terms_are_the_same_either_way():
    """The mean of the losses one by one; masks, effects, known encodings and further terms go that way."""
    trained = PhysHDR.__new__(PhysHDR)
    torch.nn.Module.__init__(trained)
    trained.config, trained.tone_mapper = PRESETS["default"].method, response()
    radiance, targets = pictures(60, 80)
    recordings = [Recording(exposure=t, picture=p) for t, p in zip(EXPOSURES, targets, strict=True)]
    drawn = DrawnRadiance(None, None, radiance=radiance, context=None)
    fused = trained.bracket_terms(drawn, recordings)
    each = [
        trained.losses(one, recording.picture)
        for one, recording in zip(trained.develop_bracket(drawn, recordings), recordings, strict=True)
    ]
    assert fused.keys() == each[0].keys()
    assert fused["rec"].item() == pytest.approx(np.mean([terms["rec"].item() for terms in each]), rel=1e-5)

    others = [
        replace(recordings[1], mask=torch.ones(60, 80, dtype=torch.bool)),
        replace(recordings[1], effect=torch.ones(3, 1, 1)),
        replace(recordings[1], encoding=SRGB),
    ]
    assert all(trained.bracket_terms(drawn, [recordings[0], other]) is None for other in others)

    class Mine(PhysHDR):
        def losses(self, developed, picture, mask=None):
            return super().losses(developed, picture, mask) | {"mine": developed.ldr.mean()}

    trained.config, trained.__class__ = PRESETS["default"].method, Mine
    assert trained.bracket_terms(drawn, recordings) is None  # its own term would not be there


@pytest.mark.parametrize("with_masks", [False, True])
@pytest.mark.parametrize("local", [False, True])
def test_where_no_kernel_computes_all_recordings_go_together(local, with_masks):
    """What they lose is the mean of what each of them loses alone, and has its gradient."""
    torch.manual_seed(0)
    trained = PhysHDR.__new__(PhysHDR)
    torch.nn.Module.__init__(trained)
    config = PRESETS["default"].method
    mapped = replace(config.tone_mapper, local=local)
    trained.config = replace(config, tone_mapper=mapped)
    trained.tone_mapper = ToneMapper(mapped, (0.5, 0.6)).double()
    with torch.no_grad():
        for parameter in trained.tone_mapper.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    radiance, targets = pictures(30, 40)
    radiance = radiance.double().requires_grad_()
    context = torch.randn(mapped.context_size, 30, 40, dtype=torch.float64) if local else None
    recordings = [
        Recording(
            exposure=t,
            picture=picture.double(),
            effect=torch.rand(3, 1, 1, dtype=torch.float64) + 0.5,
            mask=torch.rand(30, 40) > 0.3 if with_masks else None,
        )
        for t, picture in zip(EXPOSURES, targets, strict=True)
    ]
    drawn = DrawnRadiance(None, None, radiance=radiance, context=context)
    together = trained.bracket_terms(drawn, recordings)
    each = [
        trained.losses(one, recording.picture, recording.mask)
        for one, recording in zip(trained.develop_bracket(drawn, recordings), recordings, strict=True)
    ]
    assert together.keys() == each[0].keys()
    alone = torch.stack([terms["rec"] for terms in each]).mean()
    assert together["rec"].item() == pytest.approx(alone.item(), rel=1e-12)
    leaves = [radiance, *(p for p in trained.tone_mapper.parameters() if p.requires_grad)]
    ours, expected = (torch.autograd.grad(loss, leaves) for loss in (together["rec"], alone))
    for a, b in zip(ours, expected, strict=True):
        assert torch.allclose(a, b, rtol=1e-9, atol=1e-12)
    assert trained.bracket_terms(drawn, [replace(recordings[0], encoding=SRGB), *recordings[1:]]) is None


def test_quads_and_powers():
    @njit
    def run(table, places, result, sums):
        a, b, c, d = load_quads(table, 4, load(places, 0))
        store(a, result, 0)
        store(b, result, LANES)
        store(c, result, 2 * LANES)
        store(d, result, 3 * LANES)
        add_powers(sums, 1, np.float32(3.0), np.float32(2.0))

    table = np.arange(400, dtype=np.float32)
    places = np.array([5, 0, 17, 3, 80, 2, 2, 41] * (LANES // 8), np.float32)
    result, sums = np.empty(4 * LANES, np.float32), np.ones(6, np.float32)
    run(table, places, result, sums)
    expected = table[4 + 4 * places.astype(int)[None] + np.arange(4)[:, None]]
    assert np.array_equal(result.reshape(4, LANES), expected)
    assert sums.tolist() == [1.0, 4.0, 7.0, 13.0, 25.0, 1.0]
