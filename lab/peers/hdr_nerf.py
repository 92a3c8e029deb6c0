# SPDX-License-Identifier: GPL-3.0-or-later
"""HDR-NeRF (Huang et al., CVPR 2022, arXiv:2111.14451): right, if slow.

Two fields, a coarse one that finds where to look and a fine one, give density and ln radiance ln e; each
has a tone mapper of its own, a curve for each colour channel of ln e + ln t. A picture of exposure t is the
volume rendering of what the tone mapper makes of every *sample* (3-D tone mapping), and the radiance is that
of e, with the same weights. An iteration sees rays of all training pictures at once.
"""

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
import torch

from ...backend.bounds import FromZero, Size
from ...backend.kernels.ahead import Needs
from ...backend.methods.base import Batch, MethodConfig, MethodSetup, Outcome, Pool, Traits
from ...backend.model.rates import Rate, require_rates
from ...backend.model.tone_mapper import ToneMapper, ToneMapperConfig
from ...backend.scene.camera import Camera
from ...backend.scene.scene import View
from ...bridge.errors import BadValueError
from .field import Field, FieldConfig, importance_samples, ray_weights, stratified
from .rays import Rays, RaySpace, pixel_directions
from .without_splats import WithoutSplats

#: Where the data name no point of the response, f(ln 1) is this (HDR-NeRF on photographs).
UNIT_VALUE = 0.5
#: Standard deviation of the noise on σ while training on photographs (HDR-NeRF); rendered data: none.
PHOTOGRAPH_NOISE = 1.0
#: Samples that go through a network at once: their activations stay in a CPU's cache, and the memory is
#: bounded (a full batch of the published size would need 4 GiB). A card wants many, measured in megabytes.
CPU_VALUES, CUDA_VALUES = 1 << 19, 1 << 26
#: Bytes of rendered pictures that are cached, so that the radiance is there after the bracket was rendered.
KEPT_BYTES = 1 << 28


@dataclass(frozen=True, kw_only=True)
class HDRNeRFConfig(MethodConfig):
    """Sizes and schedule. The defaults are the published ones, for rendered data."""

    name: ClassVar[str] = "hdr-nerf"

    #: Both fields, coarse and fine.
    field: FieldConfig = field(default_factory=FieldConfig)
    #: Hidden units of each curve 1 → H → 1.
    tone_mapper_hidden: Size = 128
    #: Rays of an iteration, drawn from all pixels of all training pictures.
    rays_per_iteration: int = 1024
    #: Samples along a ray: evenly spread ones, which the coarse field sees, and more where it says that
    #: something is (published: 128 for rendered data, 64 for photographs); the fine field sees both.
    coarse_samples: int = 64
    fine_samples: FromZero = 128
    #: Standard deviation of the noise on σ in training; None: 1 where the data name no point of the response
    #: (photographs), else 0.
    density_noise: float | None = None
    #: NDC for cameras that face alike (all of HDR-NeRF's data), else metric; auto finds out.
    rays: Literal["auto", "ndc", "metric"] = "auto"
    #: Adam steps on the curves alone before training.
    warm_start_steps: FromZero = 500
    #: Weight of U, for each of the two curves.
    unit_weight: float = 0.5
    #: Adam's rate, and which share of it is left at the end (×0.1 in 500 k steps, of which 200 k are done;
    #: photographs: in 250 k, which is 0.158).
    learning_rate: float = 5e-4
    final_rate_share: float = 0.398

    def __post_init__(self) -> None:
        if self.coarse_samples < 3:
            raise BadValueError(
                f"{self.coarse_samples} coarse samples are too few: what lies between the first and the last "
                "says where to look",
                "Give --set method.coarse_samples=3 or more.",
            )
        names = ("learning_rate", "final_rate_share")
        require_rates("method", {name: getattr(self, name) for name in names})

    def rate(self) -> Rate:
        """Adam's, of everything."""
        final = self.learning_rate * self.final_rate_share
        return Rate(start=self.learning_rate, final=final, shape="exponential")

    @property
    def traits(self) -> Traits:
        return Traits(splats=False)  # an iteration's rays are of all pictures anyway

    def kernels_needed(self) -> Needs:
        return Needs(activations=(self.tone_mapper.activation,))

    @property
    def tone_mapper(self) -> ToneMapperConfig:
        return ToneMapperConfig(
            hidden=self.tone_mapper_hidden,
            activation="relu",
            anchored=False,
            initial_slope=None,
            warm_start_steps=self.warm_start_steps,
        )


@dataclass(frozen=True)
class Marched:
    """A field along rays: ``weights`` ``[R, S]`` of the samples, ``log_radiance`` ``[3, R, S]``."""

    weights: torch.Tensor
    log_radiance: torch.Tensor

    def composite(self, colours: torch.Tensor) -> torch.Tensor:
        """Σ w c before black: ``[3, R, S]`` → ``[3, R]``."""
        return (self.weights * colours).sum(dim=-1)


@dataclass(frozen=True)
class Film:
    """Every pixel that training may see, where the method is.

    ``codes`` ``[P, 3]`` uint8, or uint16 where a picture has 16 bits: picture after picture, each row by
    row; ``largest``: the code of white; ``compared`` ``[Q]``: the pixels that no mask hides (None: all);
    ``starts`` ``[K + 1]``: which pixel a picture begins with; ``log_exposures`` ``[K]``; ``poses``
    ``[K, 3, 4]`` float64; ``intrinsics`` ``[K, 5]`` float64: width, fx, fy, cx, cy.
    """

    codes: torch.Tensor
    largest: float
    compared: torch.Tensor | None
    starts: torch.Tensor
    log_exposures: torch.Tensor
    poses: torch.Tensor
    intrinsics: torch.Tensor

    @property
    def size(self) -> int:
        """How many pixels may be drawn."""
        return len(self.codes if self.compared is None else self.compared)


class HDRNeRF(WithoutSplats):
    """The method: two fields, each with the curves of its tone mapper, and the space that rays are in."""

    adam_epsilon = 1e-8

    def __init__(self, config: HDRNeRFConfig, setup: MethodSetup) -> None:
        super().__init__(config, setup)
        self.config = config
        setup.refuse_known("HDR-NeRF")
        self.coarse, self.fine = Field(config.field), Field(config.field)
        unit = setup.anchor or (1.0, UNIT_VALUE)
        self.coarse_curves = ToneMapper(config.tone_mapper, unit)
        self.fine_curves = ToneMapper(config.tone_mapper, unit)
        self.density_noise = config.density_noise
        if self.density_noise is None:
            self.density_noise = PHOTOGRAPH_NOISE if setup.anchor is None else 0.0
        self.space = RaySpace()
        self._film: tuple[Pool, Film] | None = None
        self._cache = _PictureCache()

    @property
    def tone_mapper(self) -> ToneMapper:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the field which pictures are drawn of."""
        return self.fine_curves

    def to_device(self, device: torch.device) -> None:
        super().to_device(device)
        self._film = None

    def parameter_groups(self) -> dict[str, list[torch.Tensor]]:
        return {"coarse": self._parameters_of("coarse"), "fine": self._parameters_of("fine")}

    def _parameters_of(self, name: Literal["coarse", "fine"]) -> list[torch.Tensor]:
        network, curves = self._networks(name)
        return [*network.parameters(), *curves.parameters()]

    def _networks(self, name: Literal["coarse", "fine"]) -> tuple[Field, ToneMapper]:
        if name == "coarse":
            return self.coarse, self.coarse_curves
        return self.fine, self.fine_curves

    def rates(self) -> dict[str, Rate]:
        return {"coarse": self.config.rate(), "fine": self.config.rate()}

    def prepare(self, seed: int) -> None:
        self.coarse_curves.warm_start(seed)
        self.fine_curves.warm_start(seed + 1)

    # -- rays ------------------------------------------------------------------------------------------

    def march(
        self, rays: Rays, jitter: torch.Tensor, u: torch.Tensor, noise: tuple[torch.Tensor, ...] = ()
    ) -> tuple[Marched | None, Marched]:
        """The fields along ``rays``: coarse and fine.

        ``jitter`` ``[R or 1, S]``, ``u`` ``[R or 1, F]``: in [0, 1), where to look; ``noise``: on the
        densities of both. Without gradients the coarse colours are unused, and omitted (None).
        """
        t = stratified(len(rays), self.config.coarse_samples, jitter)
        coarse = None
        if torch.is_grad_enabled():
            coarse = _marched(self.coarse, rays, t, *noise[:1])
            weights = coarse.weights.detach()
        else:
            weights = ray_weights(self.coarse.densities(rays.points(t)), t, rays.directions)
        more = importance_samples(t, weights, u)
        t = torch.cat([t, more], dim=1).sort(dim=1).values
        return coarse, _marched(self.fine, rays, t, *noise[1:])

    def _rays_at_once(self) -> int:
        values = CPU_VALUES if self.device.type == "cpu" else CUDA_VALUES
        samples = self.config.coarse_samples + self.config.fine_samples
        return max(1, values // (samples * self.config.field.width))

    # -- training --------------------------------------------------------------------------------------

    def training_outcome(self, batch: Batch) -> Outcome:
        film = self._film_of(batch.pool)
        rays, targets, log_exposures, generator = self._draw(film, batch.seed)
        draws = self._chances(len(rays), generator)
        parts = [part.split(self._rays_at_once()) for part in (targets, log_exposures, *draws)]
        work = zip(rays.split(self._rays_at_once()), *parts, strict=True)

        def losses() -> Iterable[tuple[torch.Tensor, torch.Tensor]]:
            for some, target, log_t, jitter, u, *noise in work:
                coarse, fine = self.march(some, jitter, u, tuple(noise))
                assert coarse is not None
                yield (
                    self._squared_error(coarse, self.coarse_curves, log_t, target) / targets.numel(),
                    self._squared_error(fine, self.fine_curves, log_t, target) / targets.numel(),
                )

        coarse, fine = sum_in_parts(losses, self._parameters_of("coarse"), self._parameters_of("fine"))
        weight = self.config.unit_weight
        terms = {"fine": fine, "coarse": coarse}
        if weight:
            unit = self.fine_curves.unit_exposure_error() + self.coarse_curves.unit_exposure_error()
            terms["unit"] = weight * unit
        return Outcome(terms)

    @staticmethod
    def _squared_error(
        marched: Marched, curves: ToneMapper, log_exposures: torch.Tensor, target: torch.Tensor
    ) -> torch.Tensor:
        """Σ (LDR − target)² over rays and channels; ``log_exposures`` ``[R]``, ``target`` ``[R, 3]``."""
        exposed = marched.log_radiance + log_exposures[:, None]
        ldr = curves.response(exposed.reshape(3, -1)).view_as(exposed)
        return (marched.composite(ldr).T - target).square().sum()

    def _draw(
        self, film: Film, seed: tuple[int, ...]
    ) -> tuple[Rays, torch.Tensor, torch.Tensor, torch.Generator]:
        """Rays of random pixels of all pictures, their values ``[R, 3]`` and ln exposures ``[R]``."""
        dtype, device = self.coarse.density.weight.dtype, self.device
        state = int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] >> 1)
        generator = torch.Generator(device).manual_seed(state)
        count = self.config.rays_per_iteration
        pixel = torch.randint(film.size, (count,), generator=generator, device=device)
        if film.compared is not None:
            pixel = film.compared[pixel]
        picture = torch.searchsorted(film.starts, pixel, right=True) - 1
        within = (pixel - film.starts[picture]).double()
        width, fx, fy, cx, cy = film.intrinsics[picture].unbind(1)
        row, column = (within / width).floor(), within % width
        directions = torch.stack(
            [(column + 0.5 - cx) / fx, -(row + 0.5 - cy) / fy, -torch.ones_like(fx)], dim=1
        )
        rays = self.space.rays(film.poses[picture], directions, dtype)
        targets = film.codes[pixel].to(dtype) / film.largest
        return rays, targets, film.log_exposures[picture].to(dtype), generator

    def _chances(self, rays: int, generator: torch.Generator) -> list[torch.Tensor]:
        """Jitter of the coarse samples, u of the fine ones, and the noise on both densities, if any."""
        coarse, fine = self.config.coarse_samples, self.config.fine_samples
        like = self.coarse.density.weight
        kind: Any = {"generator": generator, "dtype": like.dtype, "device": like.device}
        draws = [torch.rand(rays, coarse, **kind), torch.rand(rays, fine, **kind)]
        if self.density_noise:
            draws += [self.density_noise * torch.randn(rays, n, **kind) for n in (coarse, coarse + fine)]
        return draws

    def _film_of(self, pool: Pool) -> Film:
        """The pool's pixels, gathered at its first use; then the rays are set, too, if they are not yet."""
        if self._film is None or self._film[0] is not pool:
            if not self.space.is_known:
                cameras = [view.camera for view in pool.views]
                self.space.survey(cameras, pool.first_points(self.first_response), self.config.rays)
            self._film = pool, film_of(pool, self.space, self.device)
        return self._film[1]

    # -- use -------------------------------------------------------------------------------------------

    def hdr_at(self, camera: Camera, levels: tuple[float, ...]) -> torch.Tensor:
        """A level only scales."""
        return self._pictures(camera, (None,))[0] * levels[0]

    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        return self.bracket_at(camera, [exposure], levels)[0]

    def bracket_at(
        self, camera: Camera, exposures: Sequence[float], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        return self._pictures(camera, tuple(exposure * levels[0] for exposure in exposures))

    def _pictures(self, camera: Camera, exposures: tuple[float | None, ...]) -> list[torch.Tensor]:
        """Pictures ``[3, H, W]`` at ``exposures`` (seconds; None: the radiance), marched through once.

        The radiance is rendered too, and what was rendered is cached until a parameter changes: marching is a
        thousand times as dear as asking twice.
        """
        self._cache.forget_unless(self._state())
        if any((camera, exposure) not in self._cache for exposure in exposures):
            wanted = tuple(dict.fromkeys((*exposures, None)))
            for exposure, picture in zip(wanted, self._render(camera, wanted), strict=True):
                self._cache[camera, exposure] = picture
            self._cache.shrink(keep=len(wanted))
        return [self._cache[camera, exposure].clone() for exposure in exposures]

    def _state(self) -> bytes:
        """A hash of all that pictures depend on; torch's version counters miss what a fused Adam does."""
        digest = hashlib.blake2b()
        for tensor in (*self.parameters(), *self.buffers()):
            digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
        return digest.digest()

    def _render(self, camera: Camera, exposures: tuple[float | None, ...]) -> torch.Tensor:
        """``[E, 3, H, W]``."""
        config, device = self.config, self.device
        like = self.coarse.density.weight
        middle = like.new_full((1, config.coarse_samples), 0.5)
        u = torch.linspace(0.0, 1.0, config.fine_samples, dtype=like.dtype, device=device)[None]
        pose = self.space.poses([camera])
        pixels = torch.arange(camera.height * camera.width, device=device)
        pictures = like.new_empty(len(exposures), 3, pixels.numel())
        for some in pixels.split(self._rays_at_once()):
            rows = torch.div(some, camera.width, rounding_mode="floor")
            directions = pixel_directions(camera, rows, some % camera.width)
            rays = self.space.rays(pose, directions, like.dtype)
            _, marched = self.march(rays, middle, u)
            for picture, exposure in zip(pictures, exposures, strict=True):
                colours = self._developed(marched, exposure)
                picture[:, some] = marched.composite(colours)
        return pictures.view(len(exposures), 3, camera.height, camera.width)

    def _developed(self, marched: Marched, exposure: float | None) -> torch.Tensor:
        """The colours of samples ``[3, R, S]``: radiance, or what the fine curves make of an exposure."""
        if exposure is None:
            return marched.log_radiance.clamp(*self.log_radiance_range).exp()
        log_exposure = math.log(max(exposure, 1e-12))
        # Most samples are of nothing and weigh exactly 0 (ReLU), so their colour does not matter.
        seen = marched.weights > 0.0
        colours = torch.zeros_like(marched.log_radiance)
        colours[:, seen] = self.fine_curves.response(marched.log_radiance[:, seen] + log_exposure)
        return colours


def _marched(network: Field, rays: Rays, t: torch.Tensor, noise: torch.Tensor | None = None) -> Marched:
    density, log_radiance = network(rays.points(t), rays.views)
    if noise is not None:
        density = density + noise
    weights = ray_weights(density, t, rays.directions)
    return Marched(weights, log_radiance.permute(2, 0, 1).contiguous())


# -- gradients in parts ------------------------------------------------------------------------------------


def sum_in_parts(
    losses: Callable[[], Iterable[tuple[torch.Tensor, ...]]], *groups: list[torch.Tensor]
) -> tuple[torch.Tensor, ...]:
    """Sums of losses that come in parts, each part's graph gone before the next is made.

    ``losses()`` yields, for each part, one loss for each of ``groups``, which depends on that group's
    parameters alone. The gradients are summed along the way and handed out in the backward pass.
    """
    sizes = [len(group) for group in groups]
    return _SumInParts.apply(losses, sizes, *(parameter for group in groups for parameter in group))


class _SumInParts(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, losses: Callable, sizes: list[int], *parameters: torch.Tensor):
        sums: list[torch.Tensor] = []
        gradients = [torch.zeros_like(parameter) for parameter in parameters]
        with torch.enable_grad():
            for each in losses():
                total = torch.stack(each).sum()
                for whole, part in zip(gradients, torch.autograd.grad(total, parameters), strict=True):
                    whole += part
                values = [value.detach() for value in each]
                sums = [a + b for a, b in zip(sums, values, strict=True)] if sums else values
        ctx.gradients, ctx.sizes = gradients, sizes
        return tuple(sums)

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        gradients, at = [], 0
        for grad, size in zip(grads, ctx.sizes, strict=True):
            gradients += [grad * each for each in ctx.gradients[at : at + size]]
            at += size
        return None, None, *gradients


# -- what training sees ------------------------------------------------------------------------------------


def film_of(pool: Pool, space: RaySpace, device: torch.device) -> Film:
    """All pixels of ``pool`` on ``device``, as integers."""
    each = [(view, k) for view, indices in zip(pool.views, pool.exposures, strict=True) for k in indices]
    cameras = [view.camera for view, _ in each]
    pictures = [view.image(k).reshape(-1, 3) for view, k in each]
    deep = any(picture.dtype == np.uint16 for picture in pictures)
    if deep:  # 65535 = 257 · 255: no 8-bit value changes
        pictures = [p if p.dtype == np.uint16 else p.astype(np.uint16) * np.uint16(257) for p in pictures]
    codes = [torch.from_numpy(picture.copy()) for picture in pictures]
    starts = np.cumsum([0, *(len(picture) for picture in codes)])
    return Film(
        codes=torch.cat(codes).to(device),
        largest=65535.0 if deep else 255.0,
        compared=_compared(each, device),
        starts=torch.as_tensor(starts, device=device),
        log_exposures=torch.tensor([math.log(view.exposures[k]) for view, k in each], device=device),
        poses=space.poses(cameras),
        intrinsics=torch.tensor(
            [(c.width, c.fx, c.fy, c.cx, c.cy) for c in cameras], dtype=torch.float64, device=device
        ),
    )


def _compared(each: Sequence[tuple[View, int]], device: torch.device) -> torch.Tensor | None:
    """Numbers of the pixels that no mask hides, counted over all pictures; None where there is no mask."""
    masks = [view.mask(k) for view, k in each]
    if all(mask is None for mask in masks):
        return None
    sizes = [(view.camera.height, view.camera.width) for view, _ in each]
    seen = [np.ones(size, bool) if mask is None else mask for mask, size in zip(masks, sizes, strict=True)]
    return torch.from_numpy(np.flatnonzero(np.concatenate([mask.reshape(-1) for mask in seen]))).to(device)


class _PictureCache(OrderedDict[tuple[Camera, float | None], torch.Tensor]):
    """Rendered pictures by camera and exposure, the oldest forgotten first."""

    state = b""

    def forget_unless(self, state: bytes) -> None:
        """Forget all that was rendered in another state of the method."""
        if state != self.state:
            self.clear()
            self.state = state

    def shrink(self, keep: int) -> None:
        """Forget the oldest beyond the budget, but never the last ``keep``."""
        held = sum(picture.nbytes for picture in self.values())
        while held > KEPT_BYTES and len(self) > keep:
            held -= self.popitem(last=False)[1].nbytes
