# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks at a built-in scene quickly: some views at three exposures in one PNG, and its figures.

    .venvs/run-blender tools/preview_scene.py -- bathroom --samples 16 --views 2 --out /tmp/bathroom.png

For those who make a scene; data sets are made by ``synth/make_scene.py``.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from physhdr.synth import noise, png, rig, settings
from physhdr.synth.built_in import SCENES, built
from physhdr.synth.renderer import renderer
from physhdr.synth.response import by_name

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec.709


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", choices=list(SCENES))
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--size", type=int, default=200)
    parser.add_argument("--views", type=int, default=1, help="how many of the grid's 35, spread over it")
    parser.add_argument("--rig", default="grid", choices=list(rig.RIGS))
    parser.add_argument("--noise", action="store_true", help="render the first view twice: the noise floor")
    parser.add_argument("--out", type=Path, default=Path("preview.png"))
    after = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    args = parser.parse_args(after)
    exposures = [2.0**ev for ev in SCENES[args.scene].evs]
    response = by_name("reinhard-gamma")
    began = time.monotonic()
    with built(args.scene) as stage:
        print(f"built in {time.monotonic() - began:.1f} s; lights: {', '.join(stage.lights)}")
        poses = rig.poses(args.rig, stage.cameras, 35, 0)
        poses = [*poses.train, *poses.test]
        wanted = settings.ground_truth((args.size, args.size), args.samples)
        scratch = args.out.with_suffix(".exr")
        rows = []
        with settings.applied(stage.scene, wanted), renderer(stage, denoise=True) as camera:
            for index in rig.spread_indices(len(poses), args.views):
                began = time.monotonic()
                image = camera.render(poses[index], index, scratch).radiance({})
                print(f"pose {index}: {time.monotonic() - began:.1f} s")
                rows.append(image.astype(np.float64))
            if args.noise:
                index = rig.spread_indices(len(poses), args.views)[0]
                again = camera.render(poses[index], 12345, scratch).radiance({})
                print("noise floor", noise.floor(rows[0], again, response, tuple(exposures)))
    radiance = np.stack(rows)
    luminance, brightest = radiance @ LUMINANCE, radiance.max(-1)
    low, high = np.percentile(luminance, 1), luminance.max()
    print(f"1st percentile {low:.2g}, median {np.median(luminance):.2g}, maximum {high:.3g}")
    print(f"dynamic range {np.log2(high / max(low, 1e-12)):.1f} stops")
    white = (png.quantise(response(brightest * exposures[0])) == 255).mean()
    black = (png.quantise(response(brightest * exposures[-1])) == 0).mean()
    print(f"white at the shortest exposure {white:.1%}, black at the longest {black:.1%}")
    sheet = np.concatenate(
        [
            np.concatenate([png.quantise(response(row * exposures[k])) for k in (0, 2, 4)], axis=1)
            for row in rows
        ]
    )
    args.out.write_bytes(png.encode(sheet))
    print(args.out)


if __name__ == "__main__":
    main()
