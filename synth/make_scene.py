# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a synthetic HDR data set with Cycles.

    blender -b -P synth/make_scene.py -- --out data/demo
    python synth/make_scene.py -- --out data/demo          (with the bpy wheel)

Interrupted and started again with the same options it renders only what is missing.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

if not globals().get("__package__"):  # run as a script: make it a module of the package `synth` (PEP 366)
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    __package__ = "synth"


def parser() -> argparse.ArgumentParser:
    from .options import Options
    from .response import BUILT_IN
    from .rig import RIGS
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
    add("--scene", default=default.scene, help=f"one of: {', '.join(SCENES)}")
    add("--resolution", default="200", metavar="N|WxH", help="size of the pictures in pixels")
    add("--samples", type=int, default=default.samples, help="Cycles samples a pixel")
    add("--views", type=int, default=default.views, help="training and test poses together")
    add("--camera-rig", default=default.camera_rig, help=f"one of: {', '.join(RIGS)}")
    add("--exposures", default=listed(default.exposures), metavar="T,T,…", help="seconds, shortest first")
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
        default=argparse.SUPPRESS,
        help=f"test poses that get the relit truth (default: {default.relit_views}, or all if fewer)",
    )
    add(
        "--lit-levels",
        default=listed(default.lit_levels),
        metavar="L,L,…",
        help="levels of the extra training views",
    )
    add(
        "--lit-views",
        type=int,
        default=default.lit_views,
        help="extra training views at other ambient levels",
    )
    add("--denoise", action=argparse.BooleanOptionalAction, default=default.denoise, help="denoise with OIDN")
    return made


def main(arguments: list[str]) -> int:
    """Exit code: 0 done, 1 an error the message explains, 2 wrong usage, 130 interrupted."""
    from .dataset import make
    from .errors import SynthError
    from .options import Options, parse_numbers, parse_resolution

    given = parser().parse_args(arguments)
    try:
        options = Options(
            scene=given.scene,
            resolution=parse_resolution(given.resolution),
            samples=given.samples,
            views=given.views,
            exposures=parse_numbers("--exposures", given.exposures),
            crf=given.crf,
            seed=given.seed,
            ambient_levels=parse_numbers("--ambient-levels", given.ambient_levels),
            relit_views=getattr(given, "relit_views", min(Options.relit_views, given.views // 2)),
            lit_levels=parse_numbers("--lit-levels", given.lit_levels),
            lit_views=given.lit_views,
            camera_rig=given.camera_rig,
            denoise=given.denoise,
        )
        make(Path(given.out), options)
    except SynthError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except OSError as error:
        sys.stderr.write(
            f"error: {error.strerror or error}: '{error.filename or given.out}'. Is the disk full?\n"
        )
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: the same command goes on where it stopped\n")
        return 130
    return 0


if __name__ == "__main__":
    # Blender's own arguments end at '--'; so do ours where the wheel's Python runs the script.
    after = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(after))
