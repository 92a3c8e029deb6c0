# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a view paired with a model's renders, each in the domain of its own encoding.

A camera's pictures are compared with the output of the model's response, quantised to the file's bits.
Pictures of a known encoding are compared in it: the model's radiance is encoded without anything learned.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...bridge.errors import BadValueError
from ..scene.scene import View
from .lpips import Lpips
from .metrics import hdr_pair, psnr, quantise, ssim_map
from .renderer import Renderer
from .results import Metrics


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction and its reference, values ``[3, H, W]`` float64; radiance may exceed 1.

    ``mask``: which pixels are compared, ``[H, W]`` bool; None: all.
    """

    picture: torch.Tensor
    reference: torch.Tensor
    mask: torch.Tensor | None

    def shown(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Both in 0…1, black where nothing is compared: for display, SSIM and LPIPS."""
        both = self.picture.clamp(0.0, 1.0), self.reference.clamp(0.0, 1.0)
        if self.mask is None:
            return both
        black = torch.zeros((), dtype=torch.float64)
        return torch.where(self.mask, both[0], black), torch.where(self.mask, both[1], black)

    def psnr(self) -> float:
        """In dB for a range of 1, over the compared pixels; NaN where there are none."""
        if self.mask is None:
            return psnr(self.picture, self.reference)
        return psnr(self.picture[:, self.mask], self.reference[:, self.mask])

    def metrics(self, lpips: Lpips | None = None) -> Metrics:
        """PSNR over compared pixels; SSIM over them, with the others black in both; LPIPS with these black.

        PSNR and SSIM are NaN if no pixel is compared.
        """
        distances = lpips.both(*self.shown()) if lpips else (None, None)
        if self.mask is None:
            similarity = ssim_map(self.picture, self.reference).mean().item()
            return Metrics(self.psnr(), similarity, *distances)
        picture, reference = (torch.where(self.mask, p, 0.0) for p in (self.picture, self.reference))
        similarity = ssim_map(picture, reference)[:, self.mask].mean().item()
        return Metrics(self.psnr(), similarity, *distances)


def pairs(
    renderer: Renderer,
    view: View,
    positions: Sequence[int] | None = None,
    rounded: bool = True,
    effect: torch.Tensor | None = None,
) -> Iterator[Pair]:
    """The view at each of ``positions`` of its bracket (None: all), in their order.

    ``rounded``: quantise the response's output to the file's bits. ``effect``: a factor on the light before,
    ``[1 or 3, H, W]``, such as the lens's vignetting; None: 1.

    Raises ``BadValueError`` if the model renders NaN, and what reading the pictures raises.
    """
    places = range(len(view.exposures)) if positions is None else positions
    cameras = [k for k in places if not view.encodings[k].is_known]
    at = () if view.is_standard else (view.known_levels,)
    exposures = [view.exposures[k] for k in cameras]
    if effect is not None and exposures:
        effects = [effect] * len(exposures)
        developed = iter(renderer.photographed(view.camera, exposures, effects, *at))
    elif len(exposures) == 1:
        developed = iter([renderer.ldr(view.camera, exposures[0], *at)])
    else:
        developed = iter(renderer.ldr_bracket(view.camera, exposures, *at) if exposures else ())
    radiance: torch.Tensor | None = None
    for k in places:
        encoding, where = view.encodings[k], f"{view.name} at {view.exposures[k]:g} s"
        if encoding.is_known:
            if radiance is None:
                radiance = finite(renderer.hdr(view.camera, *at), where).double()
            exposed = radiance * view.exposures[k]
            picture = encoding.developed(exposed if effect is None else exposed * effect)
        else:
            picture = finite(next(developed), where)
            if rounded:
                eight_bits = view.image(k).dtype == np.uint8
                picture = quantise(picture) if eight_bits else picture.double().clamp(0.0, 1.0)
        mask = view.mask(k)
        compared = None if mask is None else torch.from_numpy(mask.copy())
        yield Pair(picture, torch.from_numpy(view.values(k)).permute(2, 0, 1), compared)


def radiance_pair(
    prediction: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor | None, *, published: bool = False
) -> Pair:
    """Radiance ``[3, h, w]`` and its truth ``[3, H, W]`` as the HDR protocol compares them (``hdr_pair``).

    ``mask``: of ``compared_everywhere``. ``published``: whether the scene is one of a published benchmark.
    """
    pair = hdr_pair(prediction, truth, published=published)
    return Pair(pair.prediction, pair.truth, mask)


def compared_everywhere(view: View) -> torch.Tensor | None:
    """The pixels compared in all pictures of a view, ``[H, W]`` bool; None: all. Also used for its radiance
    and relit pictures, which have no masks. Raises what reading the pictures raises.
    """
    masks = [mask for k in range(len(view.exposures)) if (mask := view.mask(k)) is not None]
    return torch.from_numpy(np.logical_and.reduce(masks)) if masks else None


def all_of_eight_bits(views: Sequence[View]) -> bool:
    """Whether every picture is an 8-bit camera picture."""
    every = ((view, k) for view in views for k in range(len(view.exposures)))
    return all(view.image(k).dtype == np.uint8 and not view.encodings[k].is_known for view, k in every)


def finite(picture: torch.Tensor, what: str) -> torch.Tensor:
    """The picture on the CPU; raises ``BadValueError`` for NaN or infinity, which would pass as black."""
    picture = picture.detach().cpu()
    if not bool(torch.isfinite(picture).all()):
        raise BadValueError(
            f"the model renders NaN or infinity: {what}", "Train again, or use an earlier checkpoint."
        )
    return picture


def notes_on(views: Sequence[View]) -> list[str]:
    """Notes on these views' pictures for the report: known encodings and masks."""
    notes = []
    every = [(view, k) for view in views for k in range(len(view.exposures))]
    for encoding in dict.fromkeys(view.encodings[k] for view, k in every):
        count = sum(view.encodings[k] == encoding for view, k in every)
        if encoding.is_known:
            notes.append(f"{count} of {len(every)} pictures are compared in their own domain: {encoding}.")
    hidden = [1.0 - float(mask.mean()) for view, k in every if (mask := view.mask(k)) is not None]
    if hidden:
        share = sum(hidden) / len(every)
        where = f"{len(hidden)} of {len(every)} pictures"
        notes.append(f"{share:.1%} of the pixels are masked, in {where}, and not compared.")
    return notes
