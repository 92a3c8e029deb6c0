# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a model into an empty scene, save it as a .blend, and render it with Cycles at lighting levels.

    blender -b -P addon/scripts/relight.py -- MODEL --camera DATA/transforms_test.json:3 --out DIR
    python addon/scripts/relight.py -- MODEL …        (Python 3.13 with the bpy wheel)

Writes DIR/level_0.25.exr and so on: 32-bit, scene-linear, premultiplied RGBA on black. ``--levels`` are those
of the first light (the ambient one); ``--light pendant=2`` sets another one for all pictures, which are then
called level_0.25+pendant_2.exr and so on.
"""

import argparse
import importlib.util
import math
import re
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def load_package() -> None:
    """Make this checkout importable as ``physhdr``, whatever its folder is called, installed or not."""
    spec = importlib.util.spec_from_file_location(
        "physhdr", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["physhdr"] = package
    spec.loader.exec_module(package)


def light_level(text: str) -> tuple[str, float]:
    """``pendant=2`` as a name and a level."""
    name, _, level = text.rpartition("=")
    if not name or not 0.0 <= float(level) < math.inf:
        raise ValueError(text)  # argparse says so
    return name, float(level)


def parse_arguments(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="relight.py", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("model", type=Path, help="the model file (.safetensors), or any 3DGS PLY")
    parser.add_argument("--camera", required=True, metavar="FILE:INDEX", help="transforms_*.json and a frame")
    parser.add_argument("--out", required=True, type=Path, help="folder for the pictures")
    parser.add_argument(
        "--resolution",
        type=int,
        nargs="+",
        default=[200],
        metavar="PX",
        help="width and height; one if equal",
    )
    parser.add_argument(
        "--levels", type=float, nargs="+", default=[0.25, 1.0, 4.0], help="levels of the first light, ambient"
    )
    parser.add_argument(
        "--light",
        type=light_level,
        action="append",
        default=[],
        metavar="NAME=LEVEL",
        help="level of another light in all pictures; may be given for each, those that are not are at 1",
    )
    parser.add_argument("--exposure", type=float, default=0.0, help="EV, baked into the pictures")
    parser.add_argument("--blend", type=Path, help="save the scene here, before rendering")
    parser.add_argument("--samples", type=int, default=1, help="1 is free of noise; see --filter-width")
    parser.add_argument("--filter-width", type=float, default=0.01, help="pixels; 0.01 samples pixel centres")
    parser.add_argument(
        "--shape",
        choices=["splat", "ellipsoid"],
        default="splat",
        help="splat: cards that match the trainer's picture; ellipsoid: right from any side",
    )
    options = parser.parse_args(arguments)
    if len(options.resolution) > 2 or min(options.resolution) < 1:
        parser.error("--resolution takes one or two positive numbers")
    if not all(0.0 <= level < math.inf for level in options.levels):
        parser.error("--levels must be 0 or more")
    if len({name for name, _ in options.light}) < len(options.light):
        parser.error("--light names a light twice")
    if ":" not in options.camera or not options.camera.rpartition(":")[2].isdigit():
        parser.error("--camera must be FILE:INDEX, for example data/transforms_test.json:3")
    return options


class Report:
    """Prints each step with the seconds it took."""

    def __init__(self) -> None:
        self.start = time.perf_counter()

    def step(self, message: str) -> None:
        now = time.perf_counter()
        sys.stdout.write(f"[{now - self.start:6.2f} s] {message}\n")
        sys.stdout.flush()
        self.start = now


def run(options: argparse.Namespace) -> None:
    import bpy

    from physhdr.addon.layouts import cameras
    from physhdr.addon.model import model_import, nodes, point_cloud
    from physhdr.addon.rendering import render, render_setup
    from physhdr.bridge.lights import in_words

    report = Report()
    camera_path, _, index = options.camera.rpartition(":")
    pose = cameras.read_pose(Path(camera_path), int(index))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    gaussians = model_import.import_model(options.model)
    report.step(f"imported {len(gaussians.data.points)} Gaussians from {options.model}")
    lights, others = point_cloud.lights_of(gaussians.data), dict(options.light)
    check_others(options.model, lights, others)

    width, height = options.resolution[0], options.resolution[-1]
    render.set_resolution(scene, width, height)
    render.add_camera(scene, pose.camera_to_world, pose.angle_x)
    render_setup.set_up(scene, render_setup.Wishes(camera_splats=options.shape == "splat"))
    render.prepare_cycles(scene, options.samples, options.filter_width)
    modifier = gaussians.modifiers[nodes.MODIFIER_NAME]
    nodes.set_input(modifier, nodes.EXPOSURE, options.exposure)
    for name, level in others.items():
        nodes.set_input(modifier, nodes.level_input(lights, lights.index(name)), level)
    if options.blend:
        render.save_blend(options.blend)
        report.step(f"saved {options.blend}")
    for level in options.levels:
        path = options.out / f"{'+'.join([f'level_{level:g}', *map(file_part, others.items())])}.exr"
        nodes.set_input(modifier, nodes.LIGHTING_LEVEL, level)
        render.render_exr(scene, path)
        words = in_words({lights[0]: level, **others}) if others else f"lighting level {level:g}"
        report.step(f"rendered {pose.name} at {words}: {path}")


def check_others(model: Path, lights: tuple[str, ...], others: dict[str, float]) -> None:
    """Raise ``BadValueError`` where ``--light`` names what the model has not, or what ``--levels`` sets."""
    from physhdr.bridge.errors import BadValueError
    from physhdr.bridge.lights import named_levels

    named_levels(others, lights, str(model))
    if lights[0] in others:
        raise BadValueError(f"--light {lights[0]}: it is the model's first light", "Give --levels for it.")


def file_part(named: tuple[str, float]) -> str:
    """``pendant_2``; what a file's name may not have becomes ``_``."""
    name, level = named
    safe = re.sub(r"[^\w.-]", "_", name)
    return f"{safe}_{level:g}"


def main() -> int:
    # After "--" in Blender; a Python with bpy takes them with or without it.
    after = sys.argv.index("--") + 1 if "--" in sys.argv else 1
    options = parse_arguments(sys.argv[after:])
    load_package()
    from physhdr.bridge.errors import PhysHDRError

    try:
        run(options)
    except PhysHDRError as error:
        sys.stderr.write(f"relight.py: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
