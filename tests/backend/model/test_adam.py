# SPDX-License-Identifier: GPL-3.0-or-later
"""Our Adam against ``torch.optim.Adam``, to the bit."""

import pytest
import torch

from physhdr.backend.model.adam import Adam, Group

RATES = {"first": 3e-2, "second": 1e-3}


@pytest.mark.parametrize("fused", [True, None])
def test_steps_are_those_of_torchs_own(fused):
    """Two groups whose rates change, one parameter without a gradient at every other step."""
    generator = torch.Generator().manual_seed(1)
    values = {name: [torch.randn(5, 3, generator=generator) for _ in range(2)] for name in RATES}
    ours, theirs = (
        {name: [value.clone().requires_grad_() for value in values[name]] for name in RATES} for _ in "ab"
    )
    adam = Adam([Group(name, ours[name]) for name in RATES], eps=1e-15, fused=fused)
    torchs = torch.optim.Adam(
        [{"params": theirs[name], "lr": 0.0} for name in RATES], lr=0.0, eps=1e-15, fused=fused
    )
    for iteration in range(6):
        for name, group, other in zip(RATES, adam.groups, torchs.param_groups, strict=True):
            group.lr = other["lr"] = RATES[name] / (1 + iteration)
            for place, (mine, its) in enumerate(zip(ours[name], theirs[name], strict=True)):
                if place and iteration % 2:
                    continue
                mine.grad = torch.randn(5, 3, generator=generator)
                its.grad = mine.grad.clone()
        adam.step()
        torchs.step()
        adam.clear_gradients()
        torchs.zero_grad(set_to_none=True)
    for name in RATES:
        for mine, its in zip(ours[name], theirs[name], strict=True):
            assert torch.equal(mine, its) and mine.grad is None
            for moment, value in torchs.state[its].items():
                assert torch.equal(adam.state[mine][moment], value), moment
