# SPDX-License-Identifier: GPL-3.0-or-later
"""make_scene.py's command line: what may be written there, a function a group, and the options it means."""

import argparse

from . import camera_model
from .built_in import SCENES
from .device import DEVICES
from .options import ALL, CURRENT, REFERENCE_FACTOR, Options, join
from .parse import (
    parse_evs,
    parse_light,
    parse_mixtures,
    parse_names,
    parse_numbers,
    parse_pair,
    parse_part,
    parse_resolution,
)
from .response import BUILT_IN
from .rig import PATH, RIGS

_DEFAULT = Options()


class _Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows defaults, except those that the help describes in words, and where there is none."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, "") or "(default" in (action.help or ""):
            return action.help
        return super()._get_help_string(action)


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; ``options`` reads what it returns."""
    made = argparse.ArgumentParser(
        prog="make_scene.py",
        description="Render a synthetic HDR, relightable data set (layout: docs/formats.md).",
        epilog="Started again with the same options, it renders only what is missing.",
        formatter_class=_Formatter,
    )
    _add_scene(made)
    _add_pictures(made)
    _add_light(made)
    _add_own_rig(made)
    _add_work(made)
    camera_model.add_arguments(made)
    return made


def _add_scene(made: argparse.ArgumentParser) -> None:
    """Of what the data set is made, and where to."""
    add = made.add_argument
    add("--out", required=True, metavar="FOLDER", help="where to write: a new folder, or one to resume")
    add(
        "--scene",
        default=_DEFAULT.scene,
        metavar=f"NAME,NAME,…|{ALL}",
        help=f"of: {', '.join(SCENES)}; several go to folders of their own within --out",
    )
    add("--assets", metavar="FOLDER", help="models for the furniture (.sh3f, .obj, .glb), else built-in ones")
    add(
        "--from-file",
        metavar=f"FILE|{CURRENT}",
        help="your own scene instead: a .blend, or the one that is open",
    )
    add(
        "--allow-scripts",
        action="store_true",
        help="let the Python in that .blend run, drivers above all: only of a file that you trust. For one "
        "that is open, Blender's -y before its name",
    )
    add("--scene-name", default="", metavar="NAME", help="the scene in that file, if not its active one")
    add(
        "--light",
        action="append",
        default=[],
        metavar="NAME=group:GROUP|NAME=collection:COLLECTION",
        help="a light of that scene that has a level of its own: all that shines in a light group or in a "
        "collection. Given as often as there are lights; beside them there are ambient (the world, and the "
        "suns in none of them) and lamps, the rest (default: each light group)",
    )


def _add_pictures(made: argparse.ArgumentParser) -> None:
    """What is rendered: size, samples, poses, exposures and the response to them."""
    add = made.add_argument
    add(
        "--resolution",
        default="200",
        metavar="N|WxH",
        help="pixels; N alone is a square, or with --from-file the width at your render's aspect",
    )
    add("--samples", type=int, default=_DEFAULT.samples, help="Cycles samples a pixel, at most")
    add(
        "--test-samples",
        type=int,
        metavar="N",
        help="samples of test and validation views, whose radiance is the truth that methods are measured "
        "against; a built-in scene's ambient light and its lamps are then rendered by themselves, and the "
        "truth is checked (default: as --samples)",
    )
    add(
        "--reference-samples",
        type=int,
        metavar="N",
        help="samples of one test view without denoising, against which the truth is checked "
        f"(default: {REFERENCE_FACTOR} × --test-samples; 0: it is not)",
    )
    add(
        "--test-truth",
        metavar="FOLDER",
        help="take test and validation views that were rendered before and are kept, such as those in "
        "lab/data/dog; needs --relit-views 0",
    )
    add(
        "--renders-of",
        metavar="FOLDER",
        help="a data set of the same scene and size whose renders are taken instead of new ones: for other "
        "exposures, another response or another camera; the two floors of --test-samples are measured anew",
    )
    add(
        "--noise-threshold",
        type=float,
        default=_DEFAULT.noise_threshold,
        metavar="N",
        help="stop sampling a pixel where its noise is below N, such as 0.01; 0: take all samples, as "
        "--test-samples always does",
    )
    add("--views", type=int, default=_DEFAULT.views, help="training and test poses together")
    add(
        "--validation-views",
        type=int,
        default=_DEFAULT.validation_views,
        help="further poses to make choices with, neither trained nor tested",
    )
    add(
        "--camera-rig",
        default=_DEFAULT.camera_rig,
        help=f"one of: {', '.join(RIGS)}; of your own scene also {PATH}",
    )
    exposures = made.add_mutually_exclusive_group()
    exposures.add_argument(
        "--exposures", metavar="T,T,…", help="in seconds, shortest first (default: the scene's own)"
    )
    exposures.add_argument(
        "--evs", metavar="EV,EV,…", help="the same as EV, 0 is one second; write --evs=-3,-1,1,3,5"
    )
    add("--crf", default=_DEFAULT.crf, help=f"camera response: {', '.join(BUILT_IN)}, or the file of a curve")
    add("--seed", type=int, default=_DEFAULT.seed, help="of the renders' noise; the scene itself is fixed")


def _add_light(made: argparse.ArgumentParser) -> None:
    """Which levels of which lights are rendered: the relit truth, and the views that are trained on."""
    add = made.add_argument
    add(
        "--ambient-levels",
        default=join(_DEFAULT.ambient_levels),
        metavar="L,L,…",
        help="relit truth: factors on sky, sun and fill; the lamps stay",
    )
    add(
        "--relit-views",
        type=int,
        metavar="N",
        help="test poses that get the relit truth (default: all)",
    )
    add(
        "--mixed-levels",
        metavar="LIGHT=L,LIGHT=L …",
        help="relit truth with several lights turned at once, such as 'ambient=4,pendant=0.25 pendant=2' "
        "(default: where several lights vary, between and beyond the levels trained)",
    )
    add(
        "--lit-views",
        type=int,
        default=_DEFAULT.lit_views,
        help="extra training views under other light",
    )
    add(
        "--train-ambient-levels",
        "--lit-levels",
        dest="lit_levels",
        default=join(_DEFAULT.lit_levels),
        metavar="L,L,…",
        help="levels of the light in them",
    )
    add(
        "--lit-lights",
        default=",".join(_DEFAULT.lit_lights),
        metavar="LIGHT,LIGHT,…",
        help="which lights vary in them, each by itself: every combination of levels comes equally often",
    )


def _add_own_rig(made: argparse.ArgumentParser) -> None:
    """Where cameras stand in the user's own scene."""
    add = made.add_argument_group("the rig around your own camera (with --from-file)").add_argument
    add(
        "--rig-distance",
        type=float,
        metavar="METRES",
        help="to what it looks at (default: the focus, else what the camera sees, else the scene's middle)",
    )
    add("--rig-extent", metavar="WxH", help="of the grid in metres (default: 0.5 and 0.3 of the distance)")
    add("--rig-arc", type=float, metavar="DEGREES", help="of orbit and hemisphere (default: 90)")
    add(
        "--rig-elevation",
        metavar="LOW,HIGH",
        help="of the hemisphere, in degrees (default: from 20 below to 30 above your camera's own)",
    )


def _add_work(made: argparse.ArgumentParser) -> None:
    """With what it is rendered, and how the progress is reported."""
    add = made.add_argument
    add("--device", default=_DEFAULT.device, help=f"one of: {', '.join(DEVICES)}")
    add(
        "--workers",
        type=int,
        default=_DEFAULT.workers,
        metavar="N",
        help="processes that render at the same time and share the cores; on small pictures as many as "
        "there are cores is fastest. For several machines see physhdr synthesise",
    )
    add(
        "--threads",
        type=int,
        default=_DEFAULT.threads,
        metavar="N",
        help="of each process; 0: all of the processor's, shared out",
    )
    add(
        "--part",
        metavar="K/N",
        help="render only the K-th of N parts of the poses, and nothing of what needs them all; the same "
        "command without --part then completes the data set",
    )
    add("--worker-of", type=int, help=argparse.SUPPRESS)
    add(
        "--progress-json",
        action="store_true",
        help="report the progress as one JSON object per line, for programs",
    )
    add(
        "--denoise", action=argparse.BooleanOptionalAction, default=_DEFAULT.denoise, help="denoise with OIDN"
    )


def options(args: argparse.Namespace) -> Options:
    """The options that a parsed command line means; not checked yet.

    Raises:
        OptionError: a text is no number, or no size.
    """
    exposures = None
    if args.exposures is not None:
        exposures = parse_numbers("--exposures", args.exposures)
    elif args.evs is not None:
        exposures = parse_evs(args.evs)
    return Options(
        resolution=parse_resolution(args.resolution, follow=args.from_file is not None),
        samples=args.samples,
        test_samples=args.test_samples,
        reference_samples=args.reference_samples,
        test_truth=args.test_truth,
        renders_of=args.renders_of,
        noise_threshold=args.noise_threshold,
        views=args.views,
        validation_views=args.validation_views,
        exposures=exposures,
        crf=args.crf,
        seed=args.seed,
        ambient_levels=parse_numbers("--ambient-levels", args.ambient_levels),
        relit_views=args.relit_views,
        mixed_levels=None if args.mixed_levels is None else parse_mixtures(args.mixed_levels),
        lit_levels=parse_numbers("--train-ambient-levels", args.lit_levels),
        lit_views=args.lit_views,
        lit_lights=parse_names(args.lit_lights),
        camera_rig=args.camera_rig,
        denoise=args.denoise,
        device=args.device,
        workers=args.workers,
        threads=args.threads,
        part=None if args.part is None else parse_part(args.part),
        camera=camera_model.from_arguments(args),
        assets=args.assets,
        from_file=args.from_file,
        allow_scripts=args.allow_scripts,
        scene_name=args.scene_name,
        light_choices=tuple(parse_light(text) for text in args.light),
        rig_distance=args.rig_distance,
        rig_extent=parse_pair("--rig-extent", args.rig_extent) if args.rig_extent else None,
        rig_arc=args.rig_arc,
        rig_elevation=parse_pair("--rig-elevation", args.rig_elevation) if args.rig_elevation else None,
    )
