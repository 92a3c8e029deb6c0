# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training will take in memory, told before it starts; one that cannot fit is refused.

The peak is a sum: the program, the pictures, every Gaussian's state, and the larger of what finding the
first points and what one iteration need beside that. The constants are from measured peaks of trainings on
two cores (pictures of 100² to 400², 10,000 to a million Gaussians, every method): with as many Gaussians
as there were in the end the sum is 2 % below to 24 % above.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import torch

from ...kernels.ahead import CONTEXT
from ...memory import NotEnoughMemoryError, Room, cores, gigabytes, picture_room, room
from ...scene.encoding import CAMERA
from ...scene.resident import picture_room_on
from ...scene.scene import View
from ...shell import option
from ...start.stereo import MOST_DEPTHS, WORK_WIDTH
from ..plan import Plan
from ..targets import TARGET_BYTES, TARGET_PIXEL_BYTES
from .course import course_of

FLOAT = 4

#: The process with torch, Numba, SciPy, TensorBoard and the kernels loaded that has trained (490 to 550 MB).
PROGRAM_BYTES = 550_000_000
#: What a card's context takes beside torch's tensors (a guess).
CARD_BYTES = 500_000_000
#: A parameter is there with its gradient and Adam's two moments; growth copies all of it, and the heap keeps
#: what the smaller arrays of before have left.
COPIES = 8
#: An iteration's bytes for each Gaussian beside the backbone's (``BackboneConfig.splat_bytes``): for each
#: channel of its colour, and for each thread that sorts it.
CHANNEL_BYTES, SORT_BYTES = 100, 16
#: An iteration's bytes for each pixel: of the view that is drawn, with the tile lists; of each picture that
#: is developed and compared, for each branch; and what local curves add to that.
DRAWN_PIXEL_BYTES, DEVELOPED_PIXEL_BYTES, LOCAL_PIXEL_BYTES = 200, 250, 200
#: Merging a view's bracket: votes, weights and two sums, three channels in float64.
VOTE_BYTES = 3 * 8
#: Arrays of matching costs that a thread holds in the search for the first points.
COST_VOLUMES = 3
#: A method of rays sends samples through its networks in portions of one size (HDR-NeRF as published: 40 MB).
RAYS_BYTES = 100_000_000

#: Pictures smaller by this on each side are tried as a remedy, and no fewer Gaussians than these.
SMALLER, FEWEST_GAUSSIANS = (2, 4, 8), 5000


@dataclass(frozen=True)
class Sizes:
    """What decides how much a training takes.

    ``pixels``: of the largest training view; ``picture_bytes``: all pictures that training sees, decoded;
    ``exposures``: the most of a view; ``compared``: how many pictures an iteration compares. ``first`` and
    ``most``: Gaussians at the start and at the end; ``row_bytes``: state of each, ``splat_bytes``: work.
    ``pixel_bytes``: an iteration's for each pixel; ``seeks``: whether stereo seeks the first points;
    ``merges``: whether brackets may be merged, which is known when they are read.
    """

    pixels: int
    picture_bytes: int
    exposures: int
    first: int = 0
    most: int = 0
    row_bytes: float = 0.0
    splat_bytes: int = 0
    pixel_bytes: int = 0
    seeks: bool = False
    merges: bool = False


@dataclass(frozen=True)
class Estimate:
    """A training's peak, in bytes, by part."""

    program: int
    pictures: int
    gaussians: int
    iteration: int
    #: Of finding the first points, which is over when iterations begin.
    start: int = 0

    @property
    def total(self) -> int:
        return self.program + self.pictures + self.gaussians + max(self.start, self.iteration)


def check_memory(
    plan: Plan,
    device: torch.device,
    report: Callable[[str], None],
    *,
    resumed: bool = False,
) -> Estimate:
    """What a training of ``plan`` will take on ``device``, which ``report`` is told in a line.

    ``resumed``: the configuration is a run's own, which no option changes. Raises ``NotEnoughMemoryError``
    where that is more than there is, with what would make it fit.
    """
    sizes = sizes_of(plan)
    needed, there = estimate(sizes), room()
    on_card = device.type == "cuda"
    if on_card:
        # The host decodes pictures and finds the first points, all else is on the card.
        of_host = needed.program + needed.pictures + needed.start
        if of_host > there.bytes:
            raise _too_much(of_host, "", there, ["Take smaller pictures: --downscale."])
        needed, there = _on_card(sizes, device), _room_on_card(device)
    parts = _parts(needed, sizes, plan)
    if needed.total > there.bytes:
        remedies = [] if resumed else _remedies(plan, sizes, there, device)
        raise _too_much(needed.total, f" ({parts})", there, remedies)
    report(f"training will take about {gigabytes(needed.total)}: {parts}; {there.in_words}")
    return needed


def _parts(needed: Estimate, sizes: Sizes, plan: Plan) -> str:
    """In gigabytes, what takes how much."""

    def short(size: int) -> str:
        return f"{size / 1e9:.1f}" if size >= 5e7 else "less than 0.1"

    guess = "" if plan.backbone.budget or sizes.most == sizes.first else "perhaps "
    of_gaussians = f"{short(needed.gaussians)} for {guess}{sizes.most:,} Gaussians, " if sizes.most else ""
    rest = f"{short(needed.total - needed.pictures - needed.gaussians)} for the program and one iteration"
    return f"{short(needed.pictures)} for pictures, {of_gaussians}{rest}"


def sizes_of(plan: Plan) -> Sizes:
    """The sizes of a training, without reading a picture."""
    config, seen = plan.config, plan.seen
    pixels = [view.camera.width * view.camera.height for view in seen.views]
    sizes = Sizes(
        pixels=max(pixels),
        picture_bytes=sum(
            count * len(places) * _pixel_bytes(view)
            for count, places, view in zip(pixels, seen.exposures, seen.views, strict=True)
        ),
        exposures=max(len(places) for places in seen.exposures),
    )
    if not plan.splats:
        return sizes
    needs = config.method.kernels_needed()
    channels, local = max(needs.channels), bool(needs.local_branches)
    branches = max(1, (channels - (CONTEXT if local else 0)) // 3)
    compared = sizes.exposures if config.supervision == "bracket" else 1
    developed = DEVELOPED_PIXEL_BYTES + (LOCAL_PIXEL_BYTES if local else 0)
    course = course_of(plan)
    wanted = config.method.attributes(seen.lights)
    return dataclasses.replace(
        sizes,
        first=course.first,
        most=course.most,
        row_bytes=COPIES * FLOAT * plan.backbone.numbers(wanted),
        splat_bytes=plan.backbone.splat_bytes + CHANNEL_BYTES * channels + SORT_BYTES * cores(),
        pixel_bytes=DRAWN_PIXEL_BYTES + compared * branches * developed,
        seeks=course.seeks,
        merges=sizes.exposures > 1 and plan.merges != "off",
    )


def estimate(sizes: Sizes) -> Estimate:
    """The peak of a training of these sizes on the CPU."""
    pictures = min(sizes.picture_bytes, picture_room())
    if not sizes.most:  # the pixels of all pictures once more, as one array
        return Estimate(PROGRAM_BYTES, pictures + sizes.picture_bytes, 0, RAYS_BYTES)
    start = VOTE_BYTES * (2 * sizes.exposures + 2) * sizes.pixels
    if sizes.seeks:
        volume = FLOAT * MOST_DEPTHS * min(sizes.pixels, WORK_WIDTH**2)
        start += cores() * COST_VOLUMES * volume
    # Of 8 bits a channel; what is kept of the pictures' statistics.
    kept = min(sizes.picture_bytes * TARGET_PIXEL_BYTES // 3, TARGET_BYTES)
    if sizes.merges:  # of 16 bits
        kept += min(2 * sizes.picture_bytes, picture_room())
    return Estimate(
        PROGRAM_BYTES,
        pictures + kept,
        round(sizes.most * (sizes.row_bytes + sizes.splat_bytes)),
        sizes.pixel_bytes * sizes.pixels,
        start,
    )


def _pixel_bytes(view: View) -> int:
    """Of a decoded picture with its mask, the most among the view's: what is developed here has 16 bits."""
    return max(
        (3 if source.encoding == CAMERA else 6) + (source.mask_path is not None or source.alpha)
        for source in view.sources
    )


# -- refusing ------------------------------------------------------------------------------------------------


def _too_much(needed: int, parts: str, there: Room, remedies: list[str]) -> NotEnoughMemoryError:
    return NotEnoughMemoryError(
        f"this training would take about {gigabytes(needed)}{parts}; {there.in_words}",
        " ".join([*remedies, there.remedy]),
    )


def _remedies(plan: Plan, sizes: Sizes, there: Room, device: torch.device) -> list[str]:
    """Options of which each would make the training fit, a sentence each."""

    def total(changed: Sizes) -> int:
        return (_on_card(changed, device) if on_card else estimate(changed)).total

    on_card = device.type == "cuda"
    found = []
    for factor in SMALLER:
        area = factor**2
        smaller = dataclasses.replace(
            sizes, pixels=sizes.pixels // area, picture_bytes=sizes.picture_bytes // area
        )
        if total(smaller) <= there.bytes:
            downscale = factor * plan.seen.scene.train[0].cache.reduction.factor
            found.append(f"Train on smaller pictures: --downscale {downscale:g}.")
            break
    if sizes.most:
        each = sizes.row_bytes + (0 if on_card else sizes.splat_bytes)
        most = sizes.most + int((there.bytes - total(sizes)) / each)
        most -= most % 1000
        if most >= max(sizes.first, FEWEST_GAUSSIANS):
            found.append(f"Train fewer Gaussians: {option('backbone.budget', most)}.")
    return found or [
        "Train on smaller pictures (--downscale) and with fewer Gaussians, or on another machine."
    ]


# -- cards ---------------------------------------------------------------------------------------------------


def _on_card(sizes: Sizes, device: torch.device) -> Estimate:
    """The card's share: its context instead of the program, and the pictures that stay there.

    On an H200 an iteration takes what it does on the CPU for each pixel, but for each Gaussian its state
    alone, four copies (1.1 kB in ``default``; lab/scale.md); growth takes more.
    """
    needed = estimate(sizes)
    return dataclasses.replace(
        needed,
        program=CARD_BYTES,
        pictures=min(needed.pictures, picture_room_on(device)),
        gaussians=round(sizes.most * sizes.row_bytes),
        start=0,
    )


def _room_on_card(device: torch.device) -> Room:
    free, _ = torch.cuda.mem_get_info(device)
    return Room(free + torch.cuda.memory_reserved(device), "card")
