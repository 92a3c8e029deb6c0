# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam without ``torch.optim.Adam``, which imports torch's compiler: two seconds of each training's start."""

from dataclasses import dataclass, field

import torch
from torch.optim.adam import adam

#: Decay of the two moments (Kingma and Ba, "Adam: A Method for Stochastic Optimization", 2015).
BETA1, BETA2 = 0.9, 0.999


@dataclass
class Group:
    """Parameters that share a learning rate."""

    name: str
    params: list[torch.Tensor]
    lr: float = 0.0


@dataclass
class Adam:
    """What ``torch.optim.Adam`` computes, to the bit. ``fused``: by one kernel for each group.

    ``state``: of each parameter that has had a gradient its ``step``, ``exp_avg`` and ``exp_avg_sq``.
    """

    groups: list[Group]
    eps: float = 1e-8
    fused: bool | None = None
    state: dict[torch.Tensor, dict[str, torch.Tensor]] = field(default_factory=dict)

    @torch.no_grad()
    def step(self) -> None:
        """Move all parameters that have a gradient."""
        for group in self.groups:
            moved = [parameter for parameter in group.params if parameter.grad is not None]
            states = [self._state_of(parameter) for parameter in moved]
            adam(
                moved,
                [parameter.grad for parameter in moved if parameter.grad is not None],
                [state["exp_avg"] for state in states],
                [state["exp_avg_sq"] for state in states],
                [],
                [state["step"] for state in states],
                fused=self.fused,
                amsgrad=False,
                beta1=BETA1,
                beta2=BETA2,
                lr=group.lr,
                weight_decay=0.0,
                eps=self.eps,
                maximize=False,
            )

    def clear_gradients(self) -> None:
        """Forget the gradients, so that a parameter without a new one stays."""
        for group in self.groups:
            for parameter in group.params:
                parameter.grad = None

    def _state_of(self, parameter: torch.Tensor) -> dict[str, torch.Tensor]:
        if parameter not in self.state:
            device = parameter.device if self.fused else None
            self.state[parameter] = {
                "step": torch.zeros((), dtype=torch.float32, device=device),
                "exp_avg": torch.zeros_like(parameter),
                "exp_avg_sq": torch.zeros_like(parameter),
            }
        return self.state[parameter]
