# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders what a photographer's walk through a built-in scene shows, through a lens that bends lines.

    .venvs/run-blender lab/tools/render_capture.py -- interior --out CAPTURE --places 40 --size 800x600 \\
        --lens opencv:-0.12,0.03,0.001,-0.0008 --samples 64

It writes ``passes/place_007.exr`` a place, and of test places ``pinhole/``, the same camera without
distortion. Interrupted, the same command resumes; several may work at the same time.
``lab/tools/take_photos.py`` then makes photos of it, as often and with as many faults as wanted.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.lock import Claims
from physhdr.synth import folder, passes, settings, walk
from physhdr.synth.built_in import SCENES, built
from physhdr.synth.capture import Capture, Place
from physhdr.synth.dataset import GENERATOR
from physhdr.synth.errors import NotFiniteRenderError
from physhdr.synth.parse import parse_resolution
from physhdr.synth.parse_lens import parse_lens
from physhdr.synth.passes import Passes
from physhdr.synth.renderer import Renderer, renderer, view_seed
from physhdr.synth.stage import Stage
from physhdr.synth.truth import TruthRenderer


def main() -> int:
    given = _parser().parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    try:
        return _render(given)
    except PhysHDRError as error:
        sys.stderr.write(f"error: {error.message}{': ' + error.hint if error.hint else ''}\n")
        return 1


def _parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add = made.add_argument
    add("scene", choices=list(SCENES))
    add("--out", type=Path, required=True, help="a new folder, or one to resume")
    add("--places", type=int, default=40)
    add("--size", default="800x600", metavar="WxH")
    add("--lens", default="opencv:0,0,0,0", help="opencv:k1,k2,p1,p2, fisheye:k1,k2,k3,k4, or a JSON file")
    add("--test-every", type=int, default=8, help="of so many places one is for testing; 0: none")
    add("--samples", type=int, default=64)
    add(
        "--test-samples",
        type=int,
        help="of test places, with the care of a data set's truth (docs/scenes.md)",
    )
    add(
        "--pinhole",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="test places without the lens, too",
    )
    add("--denoise", action=argparse.BooleanOptionalAction, default=True)
    add("--seed", type=int, default=0)
    add("--threads", type=int, default=0, help="0: all of the processor's")
    return made


def _render(given: argparse.Namespace) -> int:
    size = parse_resolution(given.size)
    with built(given.scene) as stage:
        capture = _capture(given, size, stage)
        capture.enter()
        wanted = settings.ground_truth(size, given.samples, threads=given.threads)
        with settings.applied(stage.scene, wanted), Claims(given.out / ".claims", print) as claims:
            for pinhole in (False, True):
                lens = capture.pinhole if pinhole else capture.lens
                left = [place for place in _wanted(given, capture, pinhole)]
                if not left:
                    continue
                with renderer(stage, given.denoise, lens) as camera:
                    for place in left:
                        path = capture.file(place, pinhole)
                        claim = f"{path.parent.name}_{place.name}"
                        if path.exists() or not claims.take(claim):
                            continue
                        try:
                            began = time.monotonic(), time.process_time()
                            passes.write(path, _rendered(given, camera, place, claim, path))
                            spent = time.monotonic() - began[0], time.process_time() - began[1]
                            print(f"{claim}: {spent[0]:.1f} s, {spent[1]:.1f} CPU s", flush=True)
                        finally:
                            claims.release(claim)
        missing = sum(not path.exists() for path in _all(given, capture))
    if missing:
        print(f"{missing} are left to other processes, or to the same command once more")
    else:
        print(f"capture {given.out}: {len(capture.places)} places are rendered")
    return 0


def _capture(given: argparse.Namespace, size: tuple[int, int], stage: Stage) -> Capture:
    lens = parse_lens(given.lens, size, stage.cameras.angle_x)
    poses = walk.places(stage.cameras, given.places, given.seed)
    every = given.test_every
    options = {
        **{
            name: getattr(given, name)
            for name in ("scene", "places", "test_every", "samples", "test_samples")
        },
        **{name: getattr(given, name) for name in ("denoise", "seed")},
        "size": list(size),
        "lens": lens.describe(),
        "generator": GENERATOR,
    }
    # Neither end of the walk: nobody else sees what is seen from there.
    places = [Place(k, pose, bool(every) and k % every == every // 2) for k, pose in enumerate(poses)]
    return Capture(given.out, options, lens, lens.straight, tuple(stage.lights), tuple(places))


def _wanted(given: argparse.Namespace, capture: Capture, pinhole: bool) -> Iterator[Place]:
    """Those that are not there yet, with the lens all, without it those for testing."""
    for place in capture.places:
        if (not pinhole or (given.pinhole and place.test)) and not capture.file(place, pinhole).exists():
            yield place


def _all(given: argparse.Namespace, capture: Capture) -> list[Path]:
    return [
        capture.file(place, pinhole)
        for pinhole in (False, True)
        for place in _wanted(given, capture, pinhole)
    ]


def _rendered(given: argparse.Namespace, camera: Renderer, place: Place, name: str, path: Path) -> Passes:
    """Once more, with other noise, where a value is no number, as data sets are rendered."""
    careful = place.test and given.test_samples is not None
    render = TruthRenderer(camera, given.test_samples).render if careful else camera.render
    try:
        return render(place.pose, view_seed(given.seed, name), folder.scratch(path))
    except NotFiniteRenderError:
        return render(place.pose, view_seed(given.seed, f"{name}/finite"), folder.scratch(path))


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # Blender's own end of the process is not needed, and may crash with what is freed
