# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of synth/make_scene.py for a data set of the open scene, checked before it starts."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import bpy

from ...bridge.errors import BadValueError, PhysHDRError
from ...bridge.lights import AMBIENT
from ...synth import arguments as command_line
from ...synth import user_camera
from ...synth.options import CURRENT, Options
from ...synth.response import by_name
from .. import outside
from ..session.dataset_words import in_the_dialogs_words
from . import dataset_folder
from .dataset_settings import RenderOptions
from .denoiser import require_denoiser

MOST_EXPOSURES = 64


def of(chosen: SimpleNamespace, scene: bpy.types.Scene) -> list[str]:
    """The arguments of synth/make_scene.py, which checks them again.

    Raises:
        PhysHDRError: something cannot be, found without a look at the scene's objects; nothing was done.
    """
    out = dataset_folder.chosen_folder(chosen.out)
    if chosen.denoise:
        require_denoiser()
    made = _arguments(chosen, scene, out)
    try:
        user_camera.checked(scene)
        wanted = options(made)
        wanted.check()
        by_name(wanted.crf)
    except PhysHDRError as error:
        raise BadValueError(in_the_dialogs_words(error.message), in_the_dialogs_words(error.hint)) from error
    dataset_folder.check(out)
    return made


def options(arguments: list[str]) -> Options:
    """What a command line means; raises ``OptionError``."""
    return command_line.options(command_line.parser().parse_args(["--from-file", CURRENT, *arguments]))


def _arguments(chosen: SimpleNamespace, scene: bpy.types.Scene, out: Path) -> list[str]:
    response = chosen.response
    if response == "file":
        response = outside.followed(bpy.path.abspath(chosen.response_file))
    if not response:
        raise BadValueError("no file of the camera's response is chosen", "Choose one under Curve.")
    if chosen.lit_views and not chosen.lights:
        raise BadValueError(
            "no light varies in the views under other light",
            "Tick one of the lights, or set Views Under Other Light to 0.",
        )
    options: dict[str, object] = {
        "out": out,
        "scene-name": scene.name,
        "exposures": ",".join(repr(2.0**ev) for ev in parse_evs(chosen.exposures)),
        "crf": response,
        "samples": chosen.samples,
        "seed": chosen.seed,
        "device": chosen.device,
        "lit-levels": chosen.lit_levels,
        "lit-lights": ",".join(chosen.lights or (AMBIENT,)),
        "relit-views": min(chosen.relit_views, chosen.views // 2),
        "ambient-levels": chosen.ambient_levels,
    }
    options |= _cameras(chosen)
    lights = [f"--light={choice}" for choice in chosen.light_choices]
    denoise = "--denoise" if chosen.denoise else "--no-denoise"
    return [*_written(options), *lights, denoise, "--progress-json"]


def _written(options: dict[str, object]) -> list[str]:
    return [f"--{name}={value}" for name, value in options.items()]


def _cameras(chosen: SimpleNamespace) -> dict[str, object]:
    """The options of how many cameras there are, of which size, and where, as far as that is not found by
    itself; ``BadValueError`` where they cannot be."""
    options: dict[str, object] = {
        "camera-rig": chosen.rig.lower(),
        "views": chosen.views,
        "lit-views": chosen.lit_views,
        "resolution": "x".join(str(side) for side in (chosen.resolution_x, chosen.resolution_y) if side),
    }
    if chosen.rig != "PATH" and chosen.rig_distance:
        options["rig-distance"] = chosen.rig_distance
    if chosen.rig == "GRID" and (chosen.rig_width or chosen.rig_height):
        if not (chosen.rig_width and chosen.rig_height):
            raise BadValueError("the grid has only one side", "Give both its width and its height.")
        options["rig-extent"] = f"{chosen.rig_width}x{chosen.rig_height}"
    if chosen.rig in {"ORBIT", "HEMISPHERE"}:
        options["rig-arc"] = round(math.degrees(chosen.rig_arc), 4)
    return options


def camera_options(chosen: SimpleNamespace, scene: bpy.types.Scene) -> Options:
    """Of synth's options those that say where cameras stand; ``BadValueError`` where they cannot be."""
    meant = options(["--out=nowhere", *_written(_cameras(chosen))])
    return replace(meant, resolution=user_camera.resolution(scene, meant.resolution))


def combinations(chosen: SimpleNamespace) -> int:
    """How many settings of the lights the views under other light go through."""
    levels = len(chosen.lit_levels.replace(",", " ").split())
    return levels ** len(chosen.lights)


def pictures(chosen: SimpleNamespace) -> int:
    """How many renders a data set takes: every view, and one more that tells the noise."""
    return chosen.views + chosen.lit_views + 1


def size(chosen: SimpleNamespace, scene: bpy.types.Scene) -> tuple[int, int]:
    """Pixels of the pictures."""
    return user_camera.resolution(scene, (chosen.resolution_x, chosen.resolution_y))


def parse_evs(text: str) -> list[float]:
    """``"-3 -1 1"`` or ``"-3:2:3"`` (start, step, count) → [-3.0, -1.0, 1.0].

    Raises ``BadValueError``.
    """
    remedy = "Write a rising list such as -3 -1 1 3 5, or start:step:count such as -3:2:5."
    try:
        if ":" in text:
            start, step, count = (float(part) for part in text.split(":"))
            if not (step > 0.0 and count == int(count) and 1 <= count <= MOST_EXPOSURES):
                raise ValueError
            evs = [start + step * k for k in range(int(count))]
        else:
            evs = [float(part) for part in text.replace(",", " ").split()]
    except (ValueError, OverflowError) as error:
        raise BadValueError(f"the exposures {text!r} are not understood", remedy) from error
    rising = all(a < b for a, b in pairwise(evs))
    if not evs or len(evs) > MOST_EXPOSURES or not rising or not all(-19 < ev < 19 for ev in evs):
        raise BadValueError(f"the exposures {text!r} are not a rising list of EV within ±19", remedy)
    return evs


def label(name: str, value: object) -> str:
    """The text of a setting whose 0 means that it is found by itself; it says so while it is 0."""
    text: str = RenderOptions.__annotations__[name].keywords["name"]
    return text if value or name not in AUTOMATIC else f"{text} (0: automatic)"


#: Settings whose 0 means that they are found by themselves.
AUTOMATIC = {"rig_distance", "rig_width", "rig_height", "resolution_y"}
