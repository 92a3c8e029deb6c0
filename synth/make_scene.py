# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a synthetic HDR data set with Cycles: of a built-in scene, or of any scene of yours.

    blender -b -P synth/make_scene.py -- --out data/demo
    python synth/make_scene.py -- --out data/demo          (with the bpy wheel)
    blender -b -P synth/make_scene.py -- --scene all --out data/synthetic
    blender -b my.blend -P synth/make_scene.py -- --from-file current --out data/mine
    python synth/make_scene.py -- --from-file my.blend --out data/mine

Interrupted and started again with the same options it renders only what is missing; started several times
at once, on one machine or on several that share the folder, the processes share the work.
"""

from __future__ import annotations

import argparse
import importlib.util
import signal
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .options import Options

def _load_package() -> None:
    """Make the repository's root, wherever it lies and whatever its folder is called, the package ``physhdr``."""
    root = Path(__file__).resolve().parent.parent
    spec = importlib.util.spec_from_file_location(
        "physhdr", root / "__init__.py", submodule_search_locations=[str(root)]
    )
    assert spec and spec.loader
    sys.modules["physhdr"] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)


if not globals().get("__package__"):  # run as a script: make it a module of the package (PEP 366)
    _load_package()
    __package__ = "physhdr.synth"


def parser() -> argparse.ArgumentParser:
    from . import camera_model
    from .device import DEVICES
    from .options import ALL, CURRENT, Options
    from .response import BUILT_IN
    from .rig import PATH, RIGS
    from .scenes import SCENES

    default = Options()

    def listed(values: tuple[float, ...]) -> str:
        return ",".join(f"{value:g}" for value in values)

    made = argparse.ArgumentParser(
        prog="make_scene.py",
        description="Render a synthetic HDR, relightable data set (layout: docs/formats.md).",
        epilog="Started again with the same options, it renders only what is missing.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = made.add_argument
    add("--out", required=True, metavar="FOLDER", help="where to write: a new folder, or one to resume")
    add(
        "--scene",
        default=default.scene,
        metavar=f"NAME,NAME,…|{ALL}",
        help=f"of: {', '.join(SCENES)}; several go to folders of their own within --out",
    )
    add("--assets", metavar="FOLDER", help="models for the furniture (.sh3f, .obj, .glb), else built-in ones")
    add(
        "--from-file",
        metavar=f"FILE|{CURRENT}",
        help="your own scene instead: a .blend, or the one that is open",
    )
    add("--scene-name", default="", metavar="NAME", help="the scene in that file, if not its active one")
    add(
        "--resolution",
        default="200",
        metavar="N|WxH",
        help="pixels; N alone is a square, or with --from-file the width at your render's aspect",
    )
    add("--samples", type=int, default=default.samples, help="Cycles samples a pixel, at most")
    add(
        "--noise-threshold",
        type=float,
        default=default.noise_threshold,
        metavar="N",
        help="stop sampling a pixel where its noise is below N, such as 0.01; 0: take all samples",
    )
    add("--views", type=int, default=default.views, help="training and test poses together")
    add(
        "--camera-rig",
        default=default.camera_rig,
        help=f"one of: {', '.join(RIGS)}; of your own scene also {PATH}",
    )
    exposures = made.add_mutually_exclusive_group()
    exposures.add_argument(
        "--exposures", metavar="T,T,…", help="in seconds, shortest first (default: the scene's own)"
    )
    exposures.add_argument(
        "--evs", metavar="EV,EV,…", help="the same as EV, 0 is one second; write --evs=-3,-1,1,3,5"
    )
    add("--crf", default=default.crf, help=f"camera response: {', '.join(BUILT_IN)}, or the file of a curve")
    add("--seed", type=int, default=default.seed, help="of the renders' noise; the scene itself is fixed")
    add(
        "--ambient-levels",
        default=listed(default.ambient_levels),
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
        default=default.lit_views,
        help="extra training views under other light",
    )
    add(
        "--train-ambient-levels",
        "--lit-levels",
        dest="lit_levels",
        default=listed(default.lit_levels),
        metavar="L,L,…",
        help="levels of the light in them",
    )
    add(
        "--lit-lights",
        default=",".join(default.lit_lights),
        metavar="LIGHT,LIGHT,…",
        help="which lights vary in them, each by itself: every combination of levels comes equally often",
    )
    own = made.add_argument_group("the rig around your own camera (with --from-file)")
    own.add_argument(
        "--rig-distance",
        type=float,
        metavar="METRES",
        help="to what it looks at (default: the focus, else what the camera sees, else the scene's middle)",
    )
    own.add_argument(
        "--rig-extent", metavar="WxH", help="of the grid in metres (default: 0.5 and 0.3 of the distance)"
    )
    own.add_argument("--rig-arc", type=float, metavar="DEGREES", help="of orbit and hemisphere (default: 90)")
    own.add_argument(
        "--rig-elevation",
        metavar="LOW,HIGH",
        help="of the hemisphere, in degrees (default: from 20 below to 30 above your camera's own)",
    )
    add("--device", default=default.device, help=f"one of: {', '.join(DEVICES)}")
    add(
        "--workers",
        type=int,
        default=default.workers,
        metavar="N",
        help="processes that render at the same time and share the cores; on small pictures as many as "
        "there are cores is fastest. Other machines may join: start the same command on the same folder",
    )
    add("--worker-of", type=int, help=argparse.SUPPRESS)
    add(
        "--progress-json",
        action="store_true",
        help="tell the progress as one JSON object a line, for programs",
    )
    add("--denoise", action=argparse.BooleanOptionalAction, default=default.denoise, help="denoise with OIDN")
    camera_model.add_arguments(made)
    return made


def main(arguments: list[str]) -> int:
    """Exit code: 0 done, 1 an error the message explains, 2 wrong usage, 130 interrupted."""
    from .errors import SynthError
    from .parse import parse_scenes
    from .progress import JsonReport, Report
    from .several import make_all
    from .workers import WorkerReport, helping

    given = parser().parse_args(arguments)
    report: Report
    if given.worker_of:
        report, others = WorkerReport(given.worker_of), 0
    else:
        report, others = JsonReport() if given.progress_json else Report(), given.workers - 1
    try:
        options, scenes = _options(given), parse_scenes(given.scene)
        with helping(others, arguments, given.from_file):
            report.end(make_all(Path(given.out), scenes, options, report))
    except SynthError as error:
        report.fail(error.code, error.message, error.hint)
        return 1
    except OSError as error:
        what = f"{error.strerror or error}: '{error.filename or given.out}'"
        report.fail("file", f"{what}. Is the disk full?")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: the same command goes on where it stopped\n")
        return 130
    except Exception as error:  # noqa: BLE001 (Blender would end with status 0, as if all were well)
        traceback.print_exc()
        report.fail(
            "internal", f"{type(error).__name__}: {error}", "this is a fault of the program: report it"
        )
        return 1
    return 0


def _options(given: argparse.Namespace) -> Options:
    """
    Raises:
        OptionError: a text is no number, or no size.
    """
    from .camera_model import from_arguments
    from .options import Options
    from .parse import parse_evs, parse_mixtures, parse_names, parse_numbers, parse_pair, parse_resolution

    exposures = None
    if given.exposures is not None:
        exposures = parse_numbers("--exposures", given.exposures)
    elif given.evs is not None:
        exposures = parse_evs(given.evs)
    return Options(
        resolution=parse_resolution(given.resolution, follow=given.from_file is not None),
        samples=given.samples,
        noise_threshold=given.noise_threshold,
        views=given.views,
        exposures=exposures,
        crf=given.crf,
        seed=given.seed,
        ambient_levels=parse_numbers("--ambient-levels", given.ambient_levels),
        relit_views=given.relit_views,
        mixed_levels=None if given.mixed_levels is None else parse_mixtures(given.mixed_levels),
        lit_levels=parse_numbers("--train-ambient-levels", given.lit_levels),
        lit_views=given.lit_views,
        lit_lights=parse_names(given.lit_lights),
        camera_rig=given.camera_rig,
        denoise=given.denoise,
        device=given.device,
        workers=given.workers,
        camera=from_arguments(given),
        assets=given.assets,
        from_file=given.from_file,
        scene_name=given.scene_name,
        rig_distance=given.rig_distance,
        rig_extent=parse_pair("--rig-extent", given.rig_extent) if given.rig_extent else None,
        rig_arc=given.rig_arc,
        rig_elevation=parse_pair("--rig-elevation", given.rig_elevation) if given.rig_elevation else None,
    )


def _run(arguments: list[str]) -> int:
    """``main`` where CTRL-C raises KeyboardInterrupt; Blender would take it for itself."""
    from .interrupts import signals

    for each in signals():
        signal.signal(each, signal.default_int_handler)
    return main(arguments)


if __name__ == "__main__":
    # Blender's own arguments end at '--'; so do ours where the wheel's Python runs the script.
    after = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(_run(after))
