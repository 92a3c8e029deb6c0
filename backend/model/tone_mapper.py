# SPDX-License-Identifier: GPL-3.0-or-later
"""The tone mapper f_tm: exposed radiance in, LDR out (paper section 4.2, figure 3)."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

from ..bounds import FromZero, Size
from ..kernels.bracket import bracket_errors, can_compare_bracket, log_range
from ..kernels.curve_table import interpolate, knots_between
from ..kernels.local_curves import local_curves
from ..kernels.mlp import Activation, can_tabulate, curve_knots, curve_mlp, curve_slopes
from ..kernels.pointwise import corrected, log_of_exposure
from ..kernels.ssim import PixelError, SsimTarget
from ..scene.encoding import SRGB
from .adam import Adam, Group
from .radiance import SmallNetwork

#: Added to exposed radiance before its logarithm, as in GaussHDR.
LOG_EPSILON = 1e-5

#: A response whose logit rises faster per e-fold of exposure is not read from a table: |σ⁗| ≤ 1/8, so the
#: table's error is below 0.024 h⁴ · 40⁴/8 = 3e-5 up to here, where a response clips, and 1e-8 at slopes
#: below 5, as cameras have elsewhere.
STEEPEST = 40.0

#: x ~ U(−3, 3) in batches of 1024, Adam at 5e-4: HDR-NeRF's and GaussHDR's warm start of the curves.
WARM_START_RANGE = 3.0
WARM_START_BATCH = 1024
WARM_START_LEARNING_RATE = 5e-4

#: A measured response is logits at so many ln exposures a unit, in this range.
MEASURED_PER_UNIT, MEASURED_RANGE = 32, (-12, 8)
#: Its place in ``state_dict``.
MEASURED = "measured"

#: The response as a table, for files and plots: so many ln exposures in this range.
SAMPLES, SAMPLED_RANGE = 256, (-12.0, 8.0)


@dataclass(frozen=True, kw_only=True)
class ToneMapperConfig:
    """f_tm. The defaults are those of the preset ``default``; see docs/method.md."""

    #: Width of the networks.
    hidden: Size = 64
    #: Of the networks, between their layers.
    activation: Activation = "softplus"
    #: The response passes through the data set's anchor, a known exposure × radiance and its code value; the
    #: absolute scale of the radiance then cannot drift. Needs a data set that names an anchor.
    anchored: bool = True
    #: The response at the start, to which the network learns what is missing; measured: what brackets or
    #: points tell of it (``start.response``), sRGB's where they do not; line: a line.
    initial_curve: Literal["measured", "line"] = "measured"
    #: Slope of that line: of logit(LDR) over ln(exposure). ``None``: the network does not begin at zero with
    #: either, it is warm-started instead (``warm_start_steps``).
    initial_slope: float | None = 0.6
    #: Local curves beside the global ones, which see a rendered context feature (GaussHDR).
    local: bool = False
    context_size: Size = 4
    #: Adam steps on the global curves before training (the paper's lineage: 1000).
    warm_start_steps: FromZero = 0


class Response(nn.Module, ABC):
    """What stands where a method has its global response: one that is learned, or one that is known.

    ``anchor``: a known point of it, (exposure × radiance, code value), or None where there is none to learn.
    """

    anchor: tuple[float, float] | None

    @abstractmethod
    def tone_map(
        self, exposed: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Exposed radiance ``[3, …]`` → global LDR and, if there are local curves, local LDR."""

    @abstractmethod
    def inverse(self, ldr: torch.Tensor) -> torch.Tensor:
        """ln(exposure × radiance) at which the global response gives ``ldr`` ``[3, P]``."""

    @abstractmethod
    def sampled(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The global response as a table: ln(exposure × radiance) ``[S]`` and LDR ``[S, 3]``."""

    def warm_start(self, seed: int) -> None:
        """What is done once before a training."""


class KnownResponse(Response):
    """The response where no training picture has one to be learned: what is shown is the sRGB curve.

    It clips at exposure × radiance = 1 and has no parameters. Pictures are not compared through it but
    through their own encodings.
    """

    anchor = None

    def __init__(self) -> None:
        super().__init__()
        # It goes where the method goes, so that its table is made there. Not saved: there is nothing to save.
        self.register_buffer("place", torch.zeros(0), persistent=False)

    def tone_map(
        self, exposed: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        return SRGB.developed(exposed), None

    def inverse(self, ldr: torch.Tensor) -> torch.Tensor:
        linear = SRGB.decode(ldr.double().cpu().numpy())
        return torch.from_numpy(np.log(np.maximum(linear, LOG_EPSILON))).to(ldr)

    def sampled(self) -> tuple[torch.Tensor, torch.Tensor]:
        x = torch.linspace(*SAMPLED_RANGE, SAMPLES, device=self.get_buffer("place").device)
        return x, SRGB.developed(x.exp())[:, None].expand(-1, 3).contiguous()


class _Measured(torch.autograd.Function):
    """``_measured_logits``, differentiable in the points: their slope is at hand, and autograd would need an
    operation for each of those that made the value."""

    @staticmethod
    def forward(ctx: Any, log_exposure: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        logits, slopes = _measured_logits(log_exposure, values)
        ctx.save_for_backward(slopes)
        return logits

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (slopes,) = ctx.saved_tensors
        return grads[0] * slopes, None


def _measured_logits(log_exposure: torch.Tensor, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A measured response's logits at ``[3, P]`` and their slopes, ``[3, P]`` each, by its knots ``[3, N]``.

    A cubic between two knots, whose slopes there are those between their neighbours; beyond the ends
    straight on.
    """
    last = values.shape[1] - 1
    place = (log_exposure - MEASURED_RANGE[0]) * MEASURED_PER_UNIT
    left = place.floor().clamp(0, last - 1).long()
    rises = values.diff(dim=1)
    slopes = torch.cat([rises[:, :1], 0.5 * (rises[:, 1:] + rises[:, :-1]), rises[:, -1:]], dim=1)
    before, after = values.gather(1, left), values.gather(1, left + 1)
    here, there = slopes.gather(1, left), slopes.gather(1, left + 1)
    s = (place - left).clamp(0.0, 1.0)
    twice, thrice = 3.0 * (after - before) - 2.0 * here - there, 2.0 * (before - after) + here + there
    within = before + s * (here + s * (twice + s * thrice))
    slope = here + s * (2.0 * twice + 3.0 * s * thrice)
    beyond = place - left - s
    return within + beyond * slope, slope * MEASURED_PER_UNIT


class ToneMapper(Response):
    """Global and local response curves per colour channel.

    ``anchor``: (exposure × radiance, code value), or ``None`` where the data name none.
    """

    def __init__(self, config: ToneMapperConfig, anchor: tuple[float, float] | None) -> None:
        super().__init__()
        self.config = config
        hidden = config.hidden
        # Three nets 1 → H → 1, one a colour channel. ln-exposures span about ±8: spread the bends there.
        self.w1 = nn.Parameter(torch.empty(3, hidden).uniform_(-1.0, 1.0))
        self.b1 = nn.Parameter(torch.empty(3, hidden).uniform_(-1.0, 1.0))
        bound = 1.0 / math.sqrt(hidden)
        self.w2 = nn.Parameter(torch.empty(3, hidden).uniform_(-bound, bound))
        self.b2 = nn.Parameter(torch.zeros(3))
        if config.initial_slope is not None:
            self.slope = nn.Parameter(torch.full((3, 1), config.initial_slope))
            # Not learned: what is learned is added to it. Zero until something is measured.
            low, high = MEASURED_RANGE
            self.register_buffer(MEASURED, torch.zeros(3, (high - low) * MEASURED_PER_UNIT + 1))
            nn.init.zeros_(self.w2)
            # One bend for each unit, at evenly spread exposures, so that early steps can shape the curve.
            with torch.no_grad():
                centres = torch.linspace(-8.0, 8.0, hidden)
                self.w1.copy_(torch.where(torch.arange(hidden) % 2 == 0, 1.0, -1.0).expand(3, hidden))
                self.b1.copy_(-self.w1 * centres)
        if config.local:
            self.local_curves = nn.ModuleList(
                SmallNetwork(1 + config.context_size, hidden, 1) for _ in range(3)
            )
        self.anchor = anchor

    def curve_logits(self, log_exposure: torch.Tensor) -> torch.Tensor:
        """The global response before its sigmoid: ln(exposure × radiance) ``[3, P]`` → ``[3, P]``."""
        logits, count = self._learned_logits(log_exposure), log_exposure.shape[1]
        if not (self.config.anchored and self.anchor is not None):
            return logits if self.config.initial_slope is None else logits + self._first_logits(log_exposure)
        # Shift each channel's curve so that it meets the anchor, whatever the network says.
        exposure, value = self.anchor
        at_anchor = log_exposure.new_full((3, 1), math.log(exposure))
        logits = logits + (math.log(value / (1.0 - value)) - self._learned_logits(at_anchor))
        if self.config.initial_slope is None:
            return logits
        # At once, for on a card operations on one point cost as much as on all. Not so the network, whose b₂
        # takes no part: of two equal sums its gradient is 0, of one sum what rounding leaves.
        first = self._first_logits(torch.cat([log_exposure, at_anchor], dim=1))
        first, at_anchor = first.split([count, 1], dim=1)
        return logits + (first - at_anchor)

    def _learned_logits(self, log_exposure: torch.Tensor) -> torch.Tensor:
        return curve_mlp(log_exposure, self.w1, self.b1, self.w2, self.b2, self.config.activation)

    def _first_logits(self, log_exposure: torch.Tensor) -> torch.Tensor:
        """What the network adds to: the line and the measured response."""
        return self.slope * log_exposure + _Measured.apply(log_exposure, self.get_buffer(MEASURED))

    @property
    def measures_response(self) -> bool:
        """Whether it is to begin with a response that is found (``begin_with``)."""
        return self.config.initial_curve == "measured" and self.config.initial_slope is not None

    @property
    def is_measured(self) -> bool:
        """Whether it began with one."""
        return self.config.initial_slope is not None and bool(self.get_buffer(MEASURED).any())

    @torch.no_grad()
    def begin_with(self, log_exposure: np.ndarray, logits: np.ndarray) -> None:
        """Begin with the response through ``logits`` ``[3, N]`` at ln exposures ``[3, N]``, both rising.

        Beyond their ends it goes straight on. It stays as it is; what is learned is added to it, and the
        line's slope begins at zero.
        """
        assert self.config.initial_slope is not None, "a curve that is warm-started begins elsewhere"
        values = self.get_buffer(MEASURED)
        at = np.linspace(*MEASURED_RANGE, values.shape[1])
        for channel, (x, y) in enumerate(zip(log_exposure, logits, strict=True)):
            first, last = ((y[i + 1] - y[i]) / (x[i + 1] - x[i]) for i in (0, -2))
            beyond = np.minimum(at - x[0], 0.0) * first + np.maximum(at - x[-1], 0.0) * last
            values[channel] = torch.from_numpy(np.interp(at, x, y) + beyond).to(values)
        self.slope.zero_()

    def response(self, log_exposure: torch.Tensor) -> torch.Tensor:
        """The global response: ln(exposure × radiance) ``[3, P]`` → LDR ``[3, P]`` in (0, 1).

        At very many points the whole of it, sigmoid and all, is read from a table (``kernels.curve_table``).
        """
        knots = curve_knots(log_exposure, self.w1, self.config.activation)
        table = None if knots is None else self._table(knots)
        if knots is None or table is None:
            return self.curve_logits(log_exposure).sigmoid()
        return interpolate(log_exposure, knots, *table)

    def _table(self, knots: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor] | None:
        """The response at knots ``[K]`` and its slopes there, ``[3, K]``; None where it is too steep."""
        at_knots = knots.expand(3, -1).contiguous()
        values = self.curve_logits(at_knots).sigmoid()
        with torch.no_grad():
            slopes = curve_slopes(at_knots, self.w1, self.b1, self.w2, self.config.activation)
            if self.config.initial_slope is not None:
                slopes = slopes + self.slope + _measured_logits(at_knots, self.get_buffer(MEASURED))[1]
            if not slopes.abs().max() <= STEEPEST:
                return None
            return values, slopes * values * (1.0 - values)

    def bracket_errors(
        self,
        radiance: torch.Tensor,
        exposures: Sequence[float],
        targets: Sequence[SsimTarget],
        error: PixelError,
    ) -> tuple[torch.Tensor, torch.Tensor] | None:
        """SSIM and mean pixel difference ``[K]`` each of the global images of radiance ``[3, H, W]``.

        At K ``exposures`` and against as many ``targets``, by the fused kernel; None where that cannot be.
        """
        smooth = can_tabulate(self.w1, self.config.activation)
        if not (smooth and can_compare_bracket(radiance) and radiance.numel()):
            return None
        low, high = log_range(radiance, exposures, LOG_EPSILON)
        knots = knots_between(low, high, len(exposures) * radiance[0].numel())
        table = None if knots is None else self._table(knots)
        if knots is None or table is None:
            return None
        return bracket_errors(radiance, exposures, LOG_EPSILON, knots, *table, targets, error)

    def tone_map(
        self, exposed: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """f_tm: exposed radiance ``[3, H, W]`` → global LDR and, if there are local curves, local LDR.

        Both branches at once are ``[3, 2, H, W]``. ``context``: ``[4, H, W]``, rendered, the same for both.
        The local curve is a correction of the global one, clip(global + local − ½) (GaussHDR).
        """
        return self.tone_map_log(log_of_exposure(exposed, LOG_EPSILON), context)

    def tone_map_log(
        self, log_exposure: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """``tone_map`` of ln(exposure × radiance), for what is known by its logarithm (each splat)."""
        shape = log_exposure.shape
        glo = self.response(log_exposure.reshape(3, -1)).reshape(shape)
        loc = None
        if self.config.local:
            assert context is not None, "local curves need the rendered context feature"
            features = context.reshape(self.config.context_size, -1)
            # Counted, as with no splats at all nothing says how many branches there are.
            branches = math.prod(shape[1 : len(shape) - context.dim() + 1])
            curves = list(self.local_curves)
            correction = local_curves(
                log_exposure.reshape(3, branches, features.shape[1]),
                features,
                *(torch.stack([curve.get_parameter(name) for curve in curves]) for name in ("w1", "b1")),
                *(torch.cat([curve.get_parameter(name) for curve in curves]) for name in ("w2", "b2")),
            ).reshape(shape)
            loc = corrected(glo, correction)
        return glo, loc

    def unit_exposure_error(self) -> torch.Tensor:
        """L_unit: mean over channels of (f(anchor's exposure) − anchor's value)² (HDR-NeRF)."""
        assert self.anchor is not None, "L_unit needs the data set's anchor"
        exposure, value = self.anchor
        x = self.w1.new_full((3, 1), math.log(exposure))
        return (self.curve_logits(x).sigmoid() - value).square().mean()

    def inverse(self, ldr: torch.Tensor) -> torch.Tensor:
        """ln(exposure × radiance) at which the global response gives ``ldr`` ``[3, P]``, by table.

        On the device of ``ldr``, wherever the curve is.
        """
        with torch.no_grad():
            x = torch.linspace(-12.0, 12.0, 2049, device=self.w1.device)
            y = self.curve_logits(x.expand(3, -1).contiguous()).sigmoid().cummax(dim=1).values
            x, y = x.to(ldr.device), y.to(ldr.device)
            index = torch.searchsorted(y.contiguous(), ldr.contiguous()).clamp(max=x.numel() - 1)
            return x[index]

    @torch.no_grad()
    def sampled(self) -> tuple[torch.Tensor, torch.Tensor]:
        """The global response as a table: ln(exposure × radiance) ``[S]`` and LDR ``[S, 3]``."""
        x = torch.linspace(*SAMPLED_RANGE, SAMPLES, device=self.w1.device)
        return x, self.curve_logits(x.expand(3, -1).contiguous()).sigmoid().T.contiguous()

    def warm_start(self, seed: int) -> None:
        """Fit the global curves to clip(ln(1 + eˣ), 0, 1), as HDR-NeRF and GaussHDR do before training."""
        if not self.config.warm_start_steps:
            return
        generator = torch.Generator().manual_seed(seed)
        curves: list[torch.Tensor] = [self.w1, self.b1, self.w2, self.b2]
        optimiser = Adam([Group("curves", curves, WARM_START_LEARNING_RATE)])
        for _ in range(self.config.warm_start_steps):
            x = torch.empty(3, WARM_START_BATCH).uniform_(
                -WARM_START_RANGE, WARM_START_RANGE, generator=generator
            )
            target = nn.functional.softplus(x).clamp(0.0, 1.0)
            error = torch.linalg.vector_norm(self.curve_logits(x).sigmoid() - target, dim=0).mean()
            optimiser.clear_gradients()
            error.backward()
            optimiser.step()
        self.zero_grad(set_to_none=True)  # the training's first step must not find these gradients
