# SPDX-License-Identifier: GPL-3.0-or-later
"""What a card without a compiler computes by Warp, on the CPU: against the plain-torch twins in float64."""

import pytest
import torch

from physhdr.backend import kernels
from physhdr.backend.kernels import mlp
from physhdr.backend.rasterize import card

warp = pytest.importorskip("warp", reason="warp-lang is not installed")


@pytest.fixture(params=["one by one", "in blocks"], autouse=True)
def by_warp(request, monkeypatch):
    """Everything float32 goes to Warp, whose blocks of threads run in both ways that it has on the CPU."""
    if request.param == "in blocks":
        if not hasattr(warp.config, "enable_cpu_blocks"):
            pytest.skip("before warp-lang 1.18 there are no blocks on the CPU")
        monkeypatch.setattr(warp.config, "enable_cpu_blocks", True)
    with card.warp_on_cpu():
        yield


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def compare(function, twin, inputs, tolerance=1e-5, kind=""):
    """Value and gradients of ``function`` in float32 against ``twin`` in float64, relative to their norms.

    Says which class of autograd computed it: a function that went to the twin would be equal to it.
    """

    def evaluated(call, dtype):
        leaves = [t.to(dtype).clone().requires_grad_() for t in inputs]
        value = call(*leaves)
        value.backward(normal(*value.shape, seed=9).to(dtype))
        return value, [leaf.grad for leaf in leaves]

    ours, our_gradients = evaluated(function, torch.float32)
    truth, true_gradients = evaluated(twin, torch.float64)
    assert kind in str(_graph(ours))
    for found, expected in zip([ours, *our_gradients], [truth, *true_gradients], strict=True):
        if expected is None:
            assert found is None
        else:
            assert (found - expected).norm() <= tolerance * expected.norm().clamp_min(1e-6)


def _graph(value: torch.Tensor) -> list[str]:
    """The names of all steps that led to ``value``."""
    names, nodes = [], [value.grad_fn]
    while nodes:
        node = nodes.pop()
        if node is not None:
            names.append(f"{type(node).__module__}.{type(node).__name__}")
            nodes += [step for step, _ in node.next_functions]
    return names


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("direction", [False, True], ids=["fixed", "moving"])
def test_spherical_harmonics(degree, direction):
    means, viewpoint = normal(70, 3), torch.tensor([0.3, -2.0, 0.5])

    def call(function):
        return lambda dc, rest, means: function(dc, rest, means, viewpoint.to(dc), degree, direction)

    inputs = [normal(70, 1, 3, seed=1), normal(70, 15, 3, seed=2), means]
    compare(call(kernels.evaluate_sh), call(kernels.evaluate_sh_reference), inputs, kind="_Evaluate")


def test_spherical_harmonics_of_nothing():
    nothing = torch.zeros(0, 3)
    assert kernels.evaluate_sh(nothing, torch.zeros(0, 15, 3), nothing, torch.zeros(3), 3).shape == (0, 3)


@pytest.mark.parametrize("activation", ["relu", "softplus", "silu"])
@pytest.mark.parametrize("points", [0, 1, 255, 1024, 2500])
def test_curves(activation, points):
    inputs = [2.0 * normal(3, points), normal(3, 16, seed=1), normal(3, 16, seed=2), normal(3, 16, seed=3)]

    def call(function):
        return lambda *leaves: function(*leaves, activation)

    inputs.append(normal(3, seed=4))
    compare(call(mlp.curve_mlp), call(mlp.curve_mlp_reference), inputs, kind="_Networks")


@pytest.mark.parametrize("points", [0, 1500])  # none: a view may see nothing of the scene
@pytest.mark.parametrize(("inputs", "outputs"), [(6, 3), (1, 1), (9, 2)])
def test_small_networks(inputs, outputs, points):
    tensors = [normal(inputs, points), normal(64, inputs, seed=1), normal(64, seed=2)]
    tensors += [normal(outputs, 64, seed=3), normal(outputs, seed=4)]

    def call(function):
        return lambda *leaves: function(*leaves, "relu")

    compare(call(mlp.small_mlp), call(mlp.small_mlp_reference), tensors, kind="_Networks")


@pytest.mark.parametrize(("branches", "points"), [(1, 700), (2, 700), (1, 0)])
def test_local_curves(branches, points):
    tensors = [normal(3, branches, points), normal(4, points, seed=1), normal(3, 16, 5, seed=2)]
    tensors += [normal(3, 16, seed=3), normal(3, 16, seed=4), normal(3, seed=5)]
    compare(kernels.local_curves, kernels.local_curves_reference, tensors, kind="_Networks")


@pytest.mark.parametrize("activation", ["relu", "softplus", "silu"])
def test_nan_is_not_swallowed(activation):
    """It must reach the loss, where training refuses it."""
    inputs = [normal(3, 40), normal(3, 16, seed=1), normal(3, 16, seed=2), normal(3, 16, seed=3)]
    inputs[0][1, 7] = float("nan")
    assert mlp.curve_mlp(*inputs, normal(3, seed=4), activation).isnan().nonzero().tolist() == [[1, 7]]


def test_softplus_where_its_exponential_is_lost_beside_one():
    """ln(1 + e^z) is e^z there, not 0."""
    z = torch.linspace(-30.0, 30.0, 601)[None]
    one = torch.ones(1, 1)
    found = mlp.curve_mlp(z, one, torch.zeros(1, 1), one, torch.zeros(1), "softplus")
    torch.testing.assert_close(
        found.double(), torch.nn.functional.softplus(z.double(), threshold=99.0), rtol=3e-6, atol=0.0
    )


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (33, 21)])
def test_similarity(size):
    target = torch.rand(3, *size, generator=torch.Generator().manual_seed(1))
    prediction = target + 0.1 * normal(3, *size)

    def call(function):
        return lambda prediction: function(prediction, target.to(prediction))

    compare(call(kernels.ssim_map), call(kernels.ssim_map_reference), [prediction], 2e-5, kind="_Similarity")
    compare(call(kernels.ssim), call(kernels.ssim_reference), [prediction], 2e-5, kind="_Similarity")


def test_the_target_of_a_training_is_taken_as_it_is_kept():
    target = kernels.SsimTarget(torch.rand(3, 20, 24, generator=torch.Generator().manual_seed(1)))
    prediction = torch.rand(3, 20, 24, generator=torch.Generator().manual_seed(2))
    found = kernels.ssim_and_error(prediction, target, "l1")
    with kernels.plain_torch():
        expected = kernels.ssim_and_error(prediction, target, "l1")
    torch.testing.assert_close(found, expected)


def test_inside_plain_torch_nothing_is_warps():
    x, weights = normal(3, 10).requires_grad_(), [normal(3, 4, seed=i) for i in range(3)]
    with kernels.plain_torch():
        value = mlp.curve_mlp(x, *weights, normal(3), "relu")
    assert "_Networks" not in str(_graph(value))


def test_double_precision_is_torchs():
    x = normal(3, 10).double().requires_grad_()
    weights = [normal(3, 4, seed=i).double() for i in range(3)]
    assert "_Networks" not in str(_graph(mlp.curve_mlp(x, *weights, normal(3).double(), "relu")))
