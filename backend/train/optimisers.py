# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam for Gaussians and networks, their learning rates over time, and surgery on Adam's moments."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from ..bounds import FromZero
from ..methods.base import Method
from ..model.adam import Adam, Group
from ..model.backbone import Backbone
from ..model.rates import Rate, require_rates


@dataclass(frozen=True, kw_only=True)
class OptimiserConfig:
    """Learning rates; ``means`` are multiplied by the scene's extent (3DGS).

    Defaults: preset ``default``, which trains a tenth of 3DGS's iterations and therefore moves faster
    (measured: lab/notebook.md). ``STOCK_3DGS`` are 3DGS's own.
    """

    #: Rate of positions at the start.
    means: float = 1.6e-4
    #: Rate of positions at the end.
    means_final: float = 1.6e-6
    #: Rate of sizes.
    log_scales: float = 1e-2
    #: Rate of rotations.
    quaternions: float = 4e-3
    #: Rate of opacities.
    opacity_logits: float = 5e-2
    #: Rate of mean colours.
    reflectance_dc: float = 1e-2
    #: Rate of the other colour coefficients.
    reflectance_rest: float = 1e-3
    #: Rate of L_a.
    log_illumination: float = 2.5e-3
    #: Rate of each light's share.
    light_share_logits: float = 5e-2
    #: Rate of the features that local curves see.
    context: float = 2.5e-3
    #: Rate of g and φ (the paper: 6e-5).
    radiance_networks: float = 6e-5
    #: Rate of the response f (the paper: 2e-4).
    tone_mapper: float = 2e-4
    #: All networks of the method learn so many times faster, for trainings much shorter than they were
    #: published for.
    networks_times: float = 1.0
    #: The length of training, in iterations, that the Gaussians' rates are for. In a longer one they fall
    #: from there on, by (rates_for / iteration)³: at full rates it would go on to learn the pictures' noise
    #: (lab/notebook.md). 0: constant, however long it is (3DGS).
    rates_for: FromZero = 2500

    def __post_init__(self) -> None:
        require_rates("optimiser", vars(self))

    def rate(self, name: str, iterations: int) -> Rate:
        """How the rate of a group goes in a training of so many iterations."""
        if name == "means":
            return Rate(start=self.means, final=self.means_final, shape="exponential", of_extent=True)
        start = getattr(self, name)
        if name in ("radiance_networks", "tone_mapper"):
            return Rate(start=start, shape="cosine")
        return Rate(start=start, falls_from=self.rates_for / iterations if self.rates_for else 1.0)


#: What 3DGS uses over 30,000 iterations.
STOCK_3DGS = OptimiserConfig(
    log_scales=5e-3, quaternions=1e-3, reflectance_dc=2.5e-3, reflectance_rest=1.25e-4, rates_for=0
)


#: Prefix of Adam's state in a checkpoint, and what Adam knows of a parameter.
ADAM = "adam."
MOMENTS = ("exp_avg", "exp_avg_sq")


class Optimiser:
    """One fused Adam with a named group for each parameter of the primitives and one for each network."""

    def __init__(self, method: Method, config: OptimiserConfig, extent: float, iterations: int) -> None:
        self.extent = extent
        self.iterations = iterations
        groups = method.parameter_groups()
        self.rates = {name: config.rate(name, iterations) for name in groups if name not in method.rates()}
        self.rates |= {name: rate for name, rate in method.rates().items() if name in groups}
        if config.networks_times != 1.0:
            for name in method.network_groups().keys() & self.rates.keys():
                self.rates[name] = self.rates[name].times(config.networks_times)
        self.adam = Adam(
            [Group(name, list(params)) for name, params in groups.items()], method.adam_epsilon, fused=True
        )

    def learning_rate(self, name: str, iteration: int) -> float:
        """The rate of a group at an iteration (counted from 0)."""
        return self.rates[name].at(iteration / self.iterations, self.extent)

    def step(self, iteration: int) -> None:
        """Apply the gradients that are there with the rates of ``iteration``, then clear them."""
        for group in self.adam.groups:
            group.lr = self.learning_rate(group.name, iteration)
        self.adam.step()
        self.adam.clear_gradients()

    def resample(self, backbone: Backbone, source: torch.Tensor, fresh: torch.Tensor) -> None:
        """Make primitive j a copy of the old primitive ``source[j]``, moments included.

        ``source`` ``[M]`` int64; ``fresh`` ``[M]`` bool: these start with zero moments. Cloning, splitting,
        pruning and reordering are all of this form.
        """
        parameters = backbone.parameters
        for group in self.adam.groups:
            name = group.name
            if name not in parameters:
                continue
            old = parameters[name]
            new = old.detach()[source].contiguous().requires_grad_()
            state = self.adam.state.pop(old, None)
            if state:
                for moment in MOMENTS:
                    moved = state[moment][source]
                    moved[fresh] = 0.0
                    state[moment] = moved
                self.adam.state[new] = state
            group.params = [new]
            parameters[name] = new

    def clear_moments(self, tensor: torch.Tensor) -> None:
        """Forget what Adam knows of a parameter that was set by hand."""
        state = self.adam.state.get(tensor)
        if state:
            state["exp_avg"].zero_()
            state["exp_avg_sq"].zero_()

    def state_tensors(self) -> dict[str, torch.Tensor]:
        """Adam's state as named tensors, for a checkpoint."""
        return {
            f"{ADAM}{group.name}.{index}.{key}": value
            for group in self.adam.groups
            for index, tensor in enumerate(group.params)
            for key, value in self.adam.state.get(tensor, {}).items()
        }

    def state_like(self, tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """What a checkpoint with ``tensors`` must hold, as tensors that are alike in shape and type.

        Adam knows all of a parameter or nothing: those of which ``tensors`` has nothing are left out.
        """
        like: dict[str, torch.Tensor] = {}
        for group in self.adam.groups:
            for index, tensor in enumerate(group.params):
                prefix = f"{ADAM}{group.name}.{index}."
                if any(name.startswith(prefix) for name in tensors):
                    like[f"{prefix}step"] = torch.tensor(0.0)
                    like |= {f"{prefix}{moment}": tensor for moment in MOMENTS}
        return like

    def load_state_tensors(self, tensors: dict[str, torch.Tensor]) -> None:
        """Restore what ``state_tensors`` gave; parameters that had no state then have none now."""
        self.adam.state.clear()
        for group in self.adam.groups:
            for index, tensor in enumerate(group.params):
                prefix = f"{ADAM}{group.name}.{index}."
                state = {k[len(prefix) :]: v.clone() for k, v in tensors.items() if k.startswith(prefix)}
                if state:
                    self.adam.state[tensor] = state
