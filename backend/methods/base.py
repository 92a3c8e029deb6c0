# SPDX-License-Identifier: GPL-3.0-or-later
"""What the trainer, the evaluation, the server and the export want of every method.

``Method`` is a system that can be trained on batches and asked for pictures; its configuration
(``MethodConfig``) declares what others must know of it. It draws a backbone's splats, and has its whole use
(pictures, previews) written once: a method needs the colours of the splats and the way from radiance to the
picture.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Protocol

import numpy as np
import torch
from torch import nn

from ...bridge.errors import BadValueError
from ...bridge.lights import AMBIENT, Levels, as_levels, check_lights
from ..device import use_whole_float32
from ..evaluate.panorama import LitSplats, parted
from ..kernels.activations import LOG_RADIANCE_RANGE
from ..kernels.ahead import Needs
from ..kernels.ssim import SsimTarget
from ..model.backbone import Attributes, Backbone, Splats
from ..model.gaussians import Gaussians
from ..model.rates import Rate
from ..model.tone_mapper import Response, ToneMapper
from ..rasterize import Implementation, Rasterization, rasterize
from ..scene.camera import Camera
from ..scene.encoding import CAMERA, Encoding
from ..scene.scene import View

#: What is known of the responses that the training pictures have, together.
Responses = Literal["learned", "mixed", "known"]


@dataclass(frozen=True, kw_only=True)
class Traits:
    """What others must know of a method, as its configuration declares it."""

    #: It draws a backbone's splats, which start at points and grow.
    splats: bool = True
    #: What the lighting level follows. view: it learns from views under other light, each at its own level;
    #: exposure: it knows no light but that of the exposure, and such views would only confuse it.
    light: Literal["view", "exposure"] = "exposure"
    #: An iteration can compare a view at several exposures. Else each exposure is another drawing.
    brackets_at_once: bool = True
    #: It can learn from views at half their size.
    half_sizes: bool = True
    #: ln radiance at the start: merged from the brackets, or the data set's points' colours as they are.
    initial_radiance: Literal["merged", "points"] = "merged"
    #: It obeys a recording's ``effect``, what one picture's camera did to the exposed radiance of each pixel.
    effects: bool = False
    #: Its splats have developed colours, so that a picture is not the response of blended radiance.
    develops_splats: bool = False


@dataclass(frozen=True, kw_only=True)
class MethodConfig(ABC):
    """What a method is made of: its settings, which stand in ``config.json``.

    Settings that contradict each other are refused by ``__post_init__``, with ``BadValueError``.
    """

    #: What ``config.json`` and messages call the method.
    name: ClassVar[str]

    @property
    @abstractmethod
    def traits(self) -> Traits:
        """What others must know of a method with these settings."""

    @abstractmethod
    def kernels_needed(self) -> Needs:
        """The CPU kernels that training it calls, so that they are compiled before."""

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        """What the backbone's splats must carry, where ``lights`` have levels; asked if the method splats.

        Raises ``BadValueError`` where the method cannot tell so many lights apart.
        """
        return Attributes()


@dataclass(frozen=True)
class MethodSetup:
    """What a method must know of the data and the machine.

    ``anchor``: a known point of the response, (exposure × radiance, code value), or None. ``implementation``:
    of the rasteriser. ``lights``: names of those whose levels vary. ``responses``: of the training pictures'
    encodings. Learned: all are a camera's; known: none is; mixed: some are. ``log_radiance_range``: bounds of
    the ln radiance of what is drawn, wide enough for all that the training pictures show.
    ``standard_levels``: of the lights in the standard pictures; empty: 1.
    """

    anchor: tuple[float, float] | None = None
    implementation: Implementation = "auto"
    lights: tuple[str, ...] = (AMBIENT,)
    responses: Responses = "learned"
    log_radiance_range: tuple[float, float] = LOG_RADIANCE_RANGE
    standard_levels: tuple[float, ...] = ()

    def refuse_known(self, method: str) -> None:
        """Raises ``BadValueError`` where ``method`` would take pictures for a camera's that are none."""
        if self.responses != "learned":
            which = "the" if self.responses == "known" else "some"
            raise BadValueError(
                f"{method} learns every response, but {which} training pictures have a known one (radiance, "
                "or developed raw files)",
                "Train by the preset default or baseline, which know what to make of them.",
            )


@dataclass(frozen=True, kw_only=True)
class Exposed:
    """How one picture was taken: ``exposure`` in seconds, its ``encoding``, and what its camera did besides.

    ``effect``: a factor on the exposed radiance, ``[3, 1, 1]`` or ``[3, H, W]``; None: 1.
    """

    exposure: float
    encoding: Encoding = CAMERA
    effect: torch.Tensor | None = None


@dataclass(frozen=True, kw_only=True)
class Recording(Exposed):
    """A picture that training sees: its values ``[3, H, W]``, in [0, 1] unless it is radiance.

    ``mask``: which pixels are compared, ``[H, W]`` bool; None: all.
    """

    picture: torch.Tensor
    mask: torch.Tensor | None = None
    #: Where what SSIM needs of the picture is kept from one iteration to the next (``train.targets``).
    kept_target: Callable[[], SsimTarget] | None = None

    def ssim_target(self) -> SsimTarget:
        """What SSIM needs of the picture, of which nothing is masked."""
        return SsimTarget(self.picture) if self.kept_target is None else self.kept_target()

    def with_target(self, kept: Callable[[], SsimTarget]) -> "Recording":
        """The same, with a target that is kept."""
        return replace(self, kept_target=kept)


class Pool(Protocol):
    """Every picture that training may see."""

    views: list[View]
    #: For each view, the positions in its bracket that training may see.
    exposures: list[tuple[int, ...]]

    def picture(self, view: View, k: int) -> torch.Tensor:
        """``[3, H, W]`` in [0, 1], where the method is."""
        ...

    def first_points(self, response: Response) -> np.ndarray:
        """Points of surfaces ``[P, 3]`` (metres): the data set's, else stereo's by ``response``."""
        ...


@dataclass(frozen=True)
class Batch:
    """What one iteration sees: a view at one exposure, or at all of its bracket's that training may see.

    ``recordings``: one for each exposure; ``levels``: one a light. ``pool`` and ``seed``: for methods that
    sample pixels of all pictures themselves. ``index``: the view's (``View.index``), whose ``camera`` may be
    at half its size, or moved. ``progress``: the share of the training that is done.
    """

    camera: Camera
    recordings: tuple[Recording, ...]
    levels: tuple[float, ...]
    iteration: int
    pool: Pool
    seed: tuple[int, ...] = (0,)
    index: int = 0
    progress: float = 0.0


@dataclass(frozen=True)
class Drawn:
    """One pass of the rasteriser, and what growth reads of it.

    ``screen_offsets`` ``[M, 2]``: their gradient is that of the screen positions, per pixel; None where
    nobody watches. ``illumination_deviation`` ``[M]``: |L_a − L̂_a|, where both are known.
    """

    splats: Splats
    rasterization: Rasterization
    screen_offsets: torch.Tensor | None = None
    illumination_deviation: torch.Tensor | None = None


@dataclass(frozen=True)
class Outcome:
    """An iteration's weighted loss terms, whose sum is minimised, and what was drawn for them (if it was)."""

    terms: dict[str, torch.Tensor]
    drawn: Drawn | None = None


class Method(nn.Module, ABC):
    """A system of the benchmark: a backbone of splats and a global response curve (and perhaps more).

    Subclasses say what colour the splats have (``radiance_of``) and how a picture comes of it (``ldr_at``).
    Whoever uses one gives lighting levels as ``Levels``, or none for the standard light; here they become one
    number a light, once.
    """

    backbone: Backbone
    tone_mapper: Response
    #: Names of the lights that have levels.
    lights: tuple[str, ...] = (AMBIENT,)
    #: Adam's. 3DGS's: gradients of Gaussians are tiny, and Adam's default would damp them.
    adam_epsilon: float = 1e-15

    def __init__(self, config: MethodConfig, backbone: Backbone, setup: MethodSetup) -> None:
        super().__init__()
        self.lights = check_lights(setup.lights, "the method")
        self.standard_levels = setup.standard_levels or tuple(1.0 for _ in self.lights)
        self.attributes = config.attributes(self.lights)
        self.backbone = backbone
        #: The backbone's share of what a checkpoint holds.
        self.backbone_networks = backbone.networks
        self.implementation: Implementation = setup.implementation
        self.log_radiance_range = setup.log_radiance_range
        #: SH coefficients above this degree are not used yet (3DGS's schedule raises it).
        self.active_sh_degree = self.attributes.sh_degree

    @abstractmethod
    def training_outcome(self, batch: Batch) -> Outcome:
        """The forward pass and the losses of one iteration."""

    @abstractmethod
    def radiance_of(self, splats: Splats, levels: tuple[float, ...] | None) -> torch.Tensor:
        """Scene-linear colours ``[M, 3]`` of splats; ``levels`` None: as captured."""

    # -- training --------------------------------------------------------------------------------------

    def parameter_groups(self) -> dict[str, list[torch.Tensor]]:
        """What is optimised, by the names that learning rates have; empty groups are left out."""
        groups = {name: [tensor] for name, tensor in self.backbone.parameters.items()}
        groups |= {name: list(network.parameters()) for name, network in self.backbone.networks.items()}
        return groups | {name: params for name, params in self.network_groups().items() if params}

    def network_groups(self) -> dict[str, list[torch.Tensor]]:
        """The method's own networks by the names of their rates.

        Those of ``parameter_groups`` that ``OptimiserConfig.networks_times`` hastens.
        """
        return {"tone_mapper": list(self.tone_mapper.parameters())}

    def rates(self) -> dict[str, Rate]:
        """Learning rates that are the method's or the backbone's own; others are ``OptimiserConfig``'s."""
        return self.backbone.rates()

    def backbone_terms(self, splats: Splats) -> dict[str, torch.Tensor]:
        """The backbone's own loss term, for ``Outcome.terms``; empty where it has none."""
        term = self.backbone.regulariser(splats)
        return {} if term is None else {"scale": term}

    @property
    def first_response(self) -> Response:
        """The response by which pictures say how bright the first points are, and where stereo finds them."""
        return self.tone_mapper

    def prepare(self, seed: int) -> None:
        """Done once before a training, such as a warm start of the response."""
        self.tone_mapper.warm_start(seed)

    def follow_schedule(self, iteration: int, iterations: int, sh_degree_every: int) -> None:
        """Set what depends on the iteration alone, before it is trained (and before it is used)."""
        self.active_sh_degree = min(self.attributes.sh_degree, iteration // sh_degree_every)

    # -- what it is ------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        """How many Gaussians there are; 0 of a method that has none."""
        return self.backbone.gaussian_count

    @property
    def device(self) -> torch.device:
        return self.backbone.positions.device

    def to_device(self, device: torch.device) -> None:
        """Move everything; an optimiser must be made after this."""
        if device.type == "cuda":
            use_whole_float32()
        self.to(device)
        self.backbone.to_device(device)

    @property
    def gaussians(self) -> Gaussians:
        """The backbone where it is 3DGS's."""
        if not isinstance(self.backbone, Gaussians):
            raise BadValueError(
                "this model's Gaussians are another set for each view",
                "Use backbone.splats(camera), or export it, which fixes them.",
            )
        return self.backbone

    @property
    def learns_response(self) -> bool:
        """Whether ``response_curve`` is learned; else it is the sRGB curve, by which pictures are shown."""
        return isinstance(self.tone_mapper, ToneMapper)

    @property
    def curves(self) -> ToneMapper:
        """The response of a method that always learns it (``MethodSetup.refuse_known``)."""
        assert isinstance(self.tone_mapper, ToneMapper)
        return self.tone_mapper

    @property
    def remarks(self) -> tuple[str, ...]:
        """What every report on this model must say, such as that it has seen what others may not."""
        return ()

    @property
    def can_relight(self) -> bool:
        """Whether light can be turned apart from the exposure; without, a level only scales."""
        return False

    @property
    def composes_by_product(self) -> bool:
        """Whether ln radiance is ln L_a + ln H_r, and nothing else."""
        return True

    @property
    def has_light_share(self) -> bool:
        """Whether each splat knows which share of its radiance each light causes."""
        return self.attributes.lights > 0

    @property
    def lights_apart(self) -> tuple[str, ...]:
        """The lights that ``lit_splats`` has a part of each for; () where the method cannot tell them apart.

        Where nothing is known of the light, a level scales all of it: it is all the first light's.
        """
        return self.lights if self.has_light_share or not self.can_relight else ()

    # -- use -------------------------------------------------------------------------------------------

    def levels_of(self, level: Levels | None) -> tuple[float, ...]:
        """One for each of ``lights``; None: those of the standard pictures. Raises as ``as_levels``."""
        return self.standard_levels if level is None else as_levels(level, self.lights)

    @torch.no_grad()
    def hdr(self, camera: Camera, lighting_level: Levels | None = None) -> torch.Tensor:
        """Scene-linear radiance ``[3, H, W]``."""
        return self.hdr_at(camera, self.levels_of(lighting_level))

    @torch.no_grad()
    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels | None = None) -> torch.Tensor:
        """The picture ``[3, H, W]`` in [0, 1] that a camera with ``exposure`` seconds would record."""
        return self.ldr_at(camera, exposure, self.levels_of(lighting_level))

    @torch.no_grad()
    def ldr_bracket(
        self, camera: Camera, exposures: Sequence[float], lighting_level: Levels | None = None
    ) -> list[torch.Tensor]:
        """``ldr`` at several exposures, which costs less than each alone where the method knows how."""
        return self.bracket_at(camera, exposures, self.levels_of(lighting_level))

    @torch.no_grad()
    def photographed(
        self,
        camera: Camera,
        exposures: Sequence[float],
        effects: Sequence[torch.Tensor],
        lighting_level: Levels | None = None,
    ) -> list[torch.Tensor]:
        """``ldr_bracket``, where an effect ``[1 or 3, H, W]`` is on each exposed radiance before."""
        taken = [Exposed(exposure=t, effect=e) for t, e in zip(exposures, effects, strict=True)]
        return self.photographed_at(camera, taken, self.levels_of(lighting_level))

    def photographed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        """``photographed`` at one level a light; of methods with ``Traits.effects``."""
        raise BadValueError("this method does not model a photo's gain, white balance or vignetting")

    def hdr_at(self, camera: Camera, levels: tuple[float, ...]) -> torch.Tensor:
        """``hdr`` at one level a light."""
        splats = self.backbone.splats(camera, self.active_sh_degree)
        return self.rasterize(splats, self.seen_radiance(splats, levels), camera).image

    @abstractmethod
    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        """``ldr`` at one level a light."""

    def bracket_at(
        self, camera: Camera, exposures: Sequence[float], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        """``ldr_bracket`` at one level a light."""
        return [self.ldr_at(camera, exposure, levels) for exposure in exposures]

    @torch.no_grad()
    def response_curve(self) -> tuple[torch.Tensor, torch.Tensor] | None:
        """The global response, ln(exposure × radiance) ``[S]`` and LDR ``[S, 3]``; or None."""
        return self.tone_mapper.sampled()

    # -- drawing ---------------------------------------------------------------------------------------

    def rasterize(
        self,
        splats: Splats,
        colours: torch.Tensor,
        camera: Camera,
        *,
        screen_offsets: torch.Tensor | None = None,
        with_depth: bool = False,
    ) -> Rasterization:
        """Draw splats with C-channel ``colours`` ``[M, C]``."""
        return rasterize(
            splats.means,
            splats.quaternions,
            splats.scales,
            splats.opacities,
            colours,
            camera,
            screen_offsets=screen_offsets,
            with_depth=with_depth,
            implementation=self.implementation,
        )

    def watched(self, splats: Splats) -> torch.Tensor:
        """Zeros ``[M, 2]`` to add to screen positions, whose gradient growth reads."""
        return torch.zeros(splats.means.shape[0], 2, device=splats.means.device, requires_grad=True)

    def seen_radiance(self, splats: Splats, levels: tuple[float, ...]) -> torch.Tensor:
        """``[M, 3]``; where the method cannot relight, the (first light's) level scales all of it."""
        standard = is_standard(levels)
        colours = self.radiance_of(splats, levels if self.can_relight and not standard else None)
        return colours if self.can_relight or standard else colours * levels[0]

    def lit_splats(self, camera: Camera) -> LitSplats:
        """The splats as ``camera`` sees them, each light at level 1 (``lights_apart``)."""
        splats = self.backbone.splats(camera, self.active_sh_degree)
        radiance = self.radiance_of(splats, None)
        if not self.lights_apart:
            parts = radiance[None]
        elif splats.light_share is not None:
            parts = parted(radiance, splats.light_share)
        else:
            parts = parted(radiance, torch.ones_like(radiance)[:, None])
        return LitSplats(splats.means, splats.quaternions, splats.scales, splats.opacities, parts)

    def surface_splats(self, camera: Camera) -> LitSplats | None:
        """``lit_splats`` of a method that has any."""
        return self.lit_splats(camera)

    def parts_beyond(
        self, camera: Camera, place: Sequence[float], near: float
    ) -> tuple[torch.Tensor, torch.Tensor, int]:
        """What ``camera`` sees without the splats within ``near`` metres of ``place`` ``[3]`` or around it.

        The parts of ``lit_splats`` ``[P, 3, H, W]``, coverage ``[H, W]``, and how many were left out.
        """
        splats = self.lit_splats(camera)
        kept = splats.beyond(place, near)
        return *kept.drawn(camera, self.implementation), len(splats.means) - len(kept.means)

    @torch.no_grad()
    def preview(self, camera: Camera, lighting_level: Levels | None = None) -> Rasterization:
        """The radiance of ``hdr`` with alpha and depth (metres along the camera's axis), in one pass."""
        levels = self.levels_of(lighting_level)
        splats = self.backbone.splats(camera, self.active_sh_degree)
        return self.rasterize(splats, self.seen_radiance(splats, levels), camera, with_depth=True)

    @torch.no_grad()
    def preview_ldr(
        self, drawn: Rasterization, camera: Camera, exposure: float, lighting_level: Levels | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The picture of ``ldr``, from what ``preview`` drew where that suffices, and the camera's black.

        ``[3, H, W]``, and ``[3, 1, 1]``: what the tone mapper makes of a pixel where nothing is.
        """
        return self.preview_ldr_at(drawn, camera, exposure, self.levels_of(lighting_level))

    @abstractmethod
    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """``preview_ldr`` at one level a light."""


class UnlitMethod(Method):
    """A method whose splats have a radiance, and no light apart from it: ``log_illumination`` stays 0."""

    def log_radiance(self, splats: Splats) -> torch.Tensor:
        """ln e ``[M, 3]``."""
        return splats.log_reflectance.clamp(*self.log_radiance_range)

    def radiance_of(self, splats: Splats, levels: tuple[float, ...] | None) -> torch.Tensor:
        return self.log_radiance(splats).exp()


def exposed_by(radiance: torch.Tensor, taken: Exposed) -> torch.Tensor:
    """What a picture's response sees of radiance ``[3, H, W]``."""
    exposed = radiance * taken.exposure
    return exposed if taken.effect is None else exposed * taken.effect


def is_standard(levels: Sequence[float]) -> bool:
    """Whether every light is at 1, where shares change nothing."""
    return all(level == 1.0 for level in levels)


def mean_terms(each: Sequence[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    """The mean of the loss terms of several pictures, which all have the same names."""
    if len(each) == 1:
        return each[0]
    return {name: torch.stack([terms[name] for terms in each]).mean() for name in each[0]}
