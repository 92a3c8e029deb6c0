# SPDX-License-Identifier: GPL-3.0-or-later
"""A cube and a ball on the floor of a built-in scene, and the same put into its capture by *Put CG Here*.

    physhdr panorama runs/demo --at 0.45 0.55 0.15 --out PROBE
    .venvs/run-blender tools/standing_cg.py -- interior --model runs/demo/model.safetensors --probe PROBE \\
        --out FOLDER

It writes what Cycles shows of the true scene without and with them, and what the capture shows without them,
with them but no ground, and with the ground. It says how far each is from the truth: PSNR after the μ-law of
the project's HDR comparison, over the floor where the true shadow takes a tenth of the light or more. Where
that is, two pictures with the same noise tell, not denoised: what noise or a denoiser takes is no shadow.
"""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from physhdr.addon.model import model_import, nodes
from physhdr.addon.rendering import render
from physhdr.bridge.errors import PhysHDRError
from physhdr.synth import exr, folder, rig, settings
from physhdr.synth.built_in import built
from physhdr.synth.renderer import renderer, view_seed
from physhdr.synth.stage import Stage

#: Where they stand, metres: the middle of the undersides of cube and ball, on the rug, where no sun is.
PLACES = {"interior": ((0.35, 0.48, 0.016), (0.56, 0.62, 0.016))}
#: Half of the cube's edge and the ball's radius, metres; their albedo.
HALF, ALBEDO = 0.1, 0.5
#: Pixels and field of view of the picture; of the data set's pictures, whose pixels widen its Gaussians.
SIZE, ANGLE = 80, 0.36
PIXELS, ACROSS = 200, math.radians(62.0)
#: The true floor has lost this share of its light where it counts as shaded, and this where it does not.
SHADED, LIT = 0.1, 0.01
#: The built-in scene's lamp that neither cameras nor a panorama see.
FILL = "fill"
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
MU = 5000.0


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scene", choices=list(PLACES))
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument(
        "--probe", type=Path, required=True, help="what physhdr panorama drew near the objects"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=128, help="of the truth, and of the shadow")
    parser.add_argument(
        "--no-fill", dest="fill", action="store_false", help="no lamp that cameras cannot see"
    )
    parser.add_argument("--picture-samples", type=int, default=8, help="of the capture's picture")
    given = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    try:
        pose = _truth(given)
        _captured(given, pose)
        print("\n".join(compared(given.out)))
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1
    return 0


def _truth(given: argparse.Namespace) -> np.ndarray:
    """Render the true scene without and with the objects; the camera's pose [4, 4]."""
    pose = np.eye(4)
    for name in ("true_without", "true"):
        path, raw = given.out / f"{name}.exr", given.out / f"{name}_raw.npy"
        with built(given.scene) as stage:
            pose = _pose(stage, given.scene)
            items = _objects(stage.scene.collection, given.scene) if name == "true" else []
            for index, item in enumerate(items):
                item.pass_index = index + 1
            if path.exists() and raw.exists():
                continue
            if not given.fill:
                for item in stage.scene.objects:
                    item.hide_render = item.hide_render or item.name == FILL
            wanted = settings.ground_truth((SIZE, SIZE), given.samples)
            with settings.applied(stage.scene, wanted), renderer(stage, denoise=True) as camera:
                camera.camera.data.angle = ANGLE
                seen = camera.render(pose, view_seed(0, "true"), path.with_suffix(".scratch.exr"))
        folder.write(path, exr.encode_rgb(seen.radiance({})))
        np.save(given.out / f"{name}_index.npy", seen.index)
        np.save(raw, seen.raw)
        print(path, flush=True)
    return pose


def _pose(stage: Stage, scene: str) -> np.ndarray:
    middle = np.mean(PLACES[scene], axis=0) + [0.0, 0.0, HALF]
    return rig.look_at(np.array(stage.cameras.centre), middle)


def _objects(collection: bpy.types.Collection, scene: str) -> list[bpy.types.Object]:
    from physhdr.synth.scenes import materials, props

    grey = materials.plain("grey", (ALBEDO,) * 3, 1.0)
    cube, ball = (np.array(place) + [0.0, 0.0, HALF] for place in PLACES[scene])
    made = [props.box(collection, "cube", tuple(cube), (2.0 * HALF,) * 3, grey)]
    made[0].rotation_euler.z = 0.5
    return [*made, props.ball(collection, "ball", tuple(ball), HALF, grey, 5)]


def _captured(given: argparse.Namespace, pose: np.ndarray) -> None:
    """Render the capture without the objects, with them, and with the ground."""
    from physhdr import addon

    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    scene = bpy.context.scene
    model = model_import.import_model(str(given.model))
    bpy.context.view_layer.objects.active = model
    modifier = nodes.find_modifier(model)
    assert modifier is not None
    nodes.set_input(modifier, nodes.CAMERA_SPLATS, True)
    nodes.set_input(modifier, nodes.IMAGE_WIDTH, round(PIXELS * math.tan(ANGLE / 2) / math.tan(ACROSS / 2)))
    operators: Any = bpy.ops
    operators.physhdr.light_from_here(folder=str(given.probe.resolve()), model=model.name)
    render.prepare_cycles(scene, given.picture_samples)
    cycles: Any = scene.cycles
    cycles.max_bounces, cycles.pixel_filter_type, cycles.filter_width = 3, "BLACKMAN_HARRIS", 1.5
    cycles.use_denoising = True
    render.set_resolution(scene, SIZE, SIZE)
    render.add_camera(scene, pose, ANGLE)
    if not (given.out / "without.exr").exists():
        render.render_exr(scene, given.out / "without.exr")
    for item in _objects(scene.collection, given.scene):
        item.select_set(False)
    render.render_exr(scene, given.out / "no_ground.exr")
    operators.cg_here(location=PLACES[given.scene][0], size=3.0, stand=False)
    scene.view_layers["PhysHDR Shadow"].samples = given.samples
    scene.view_layers["PhysHDR Front"].samples = given.picture_samples
    render.render_exr(scene, given.out / "ground.exr")


def compared(root: Path) -> list[str]:
    """What is said of the pictures in a folder, a line each."""
    true, before = exr.read(root / "true.exr"), exr.read(root / "true_without.exr")
    objects = np.load(root / "true_index.npy") > 0
    near = objects.copy()
    for axis in (0, 1):  # and their edges
        near |= np.roll(near, 1, axis) | np.roll(near, -1, axis)
    left = light_left(np.load(root / "true_raw.npy"), np.load(root / "true_without_raw.npy"), near)
    shaded, lit = ~near & (left <= 1.0 - SHADED), ~near & (np.abs(left - 1.0) <= LIT)
    largest = true.max()
    pictures = {
        name: render.read_exr(root / f"{name}.exr")[..., :3] for name in ("without", "no_ground", "ground")
    }

    here = light_left(pictures["ground"], pictures["without"], near)

    def shown(values: np.ndarray) -> np.ndarray:
        return np.log1p(MU * np.clip(values / largest, 0.0, 1.0)) / math.log1p(MU)

    def decibels(name: str, truth: np.ndarray, where: np.ndarray) -> float:
        error = np.square(shown(pictures[name])[where] - shown(truth)[where]).mean()
        return -10.0 * math.log10(max(float(error), 1e-12))

    return [
        f"pixels of the true shadow {shaded.sum()}, unshaded {lit.sum()}, of the objects {objects.sum()}",
        f"shadow, without the ground: {decibels('no_ground', true, shaded):.1f} dB",
        f"shadow, with it: {decibels('ground', true, shaded):.1f} dB",
        f"that floor without objects, capture against truth: {decibels('without', before, shaded):.1f} dB",
        f"objects: {decibels('ground', true, objects):.1f} dB",
        f"unshaded floor, with the ground against without it: "
        f"{decibels('ground', pictures['no_ground'], lit):.1f} dB",
        *(
            f"light that the shadow leaves, {name}: {np.quantile(each[shaded], QUANTILES).round(2)}"
            for name, each in (("true", left), ("here", here))
        ),
        f"here against true: {np.mean((here - left)[shaded]):+.3f}, "
        f"root mean square {np.sqrt(np.square(here - left)[shaded].mean()):.3f}",
    ]


def light_left(shaded: np.ndarray, lit: np.ndarray, without: np.ndarray) -> np.ndarray:
    """[H, W]: light of one picture [H, W, 3] over that of another, both smoothed over 3 × 3 pixels; pixels
    of ``without`` [H, W] count for none, and have 1 where nothing else is near."""
    sums = []
    for picture in (shaded, lit):
        light = np.where(without, 0.0, picture.sum(-1, dtype=np.float64))
        for axis in (0, 1):
            light = light + np.roll(light, 1, axis) + np.roll(light, -1, axis)
        sums.append(light)
    return np.where(sums[1] > 0.0, sums[0] / np.maximum(sums[1], 1e-12), 1.0)


if __name__ == "__main__":
    sys.exit(main())
