# SPDX-License-Identifier: GPL-3.0-or-later
"""What the 3D view's own drawing costs for a million Gaussians in a room. Runs in Blender; prints JSON.

.venvs/run-blender benchmarks/blender_view.py -- [--count N] [--rounds R] [--size W H]
"""

import argparse
import json
import sys
import time
from collections.abc import Callable

import bpy
import gpu
import numpy as np
from blender_import import load_package

#: Metres: half the sides of the room, whose surfaces the Gaussians lie on.
ROOM = (4.0, 3.0, 1.5)


def room(count: int, degree: int = 3):
    """Flat Gaussians on the walls, floor and ceiling of a room and on boxes in it, as trained ones lie."""
    from physhdr.bridge.model_file import Model

    rng = np.random.default_rng(0)
    half = np.array(ROOM, np.float32)
    position = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    axis, side = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    position[np.arange(count), axis] = side
    position *= half
    in_boxes = rng.random(count) < 0.4
    boxes = rng.uniform(-0.8, 0.8, (12, 3)) * half
    chosen = boxes[rng.integers(0, len(boxes), in_boxes.sum())]
    position[in_boxes] = chosen + 0.12 * position[in_boxes]
    spacing = float(np.sqrt(100.0 / count))
    scale = spacing * np.exp(rng.normal(0.0, 0.5, (count, 3)))
    scale[np.arange(count), axis] *= 0.1
    rotation = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1))
    return Model(
        position=position.astype(np.float32),
        rotation=rotation,
        scale=scale.astype(np.float32),
        opacity=rng.uniform(0.1, 1.0, count).astype(np.float32),
        log_radiance_sh=rng.normal(0.0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
        light_share=rng.random((count, 1, 3), dtype=np.float32),
    )


def pose(angle: float) -> np.ndarray:
    """Camera to world: in the middle of the room, level, turned by ``angle``."""
    right = np.array([np.cos(angle), np.sin(angle), 0.0])
    back = np.array([np.sin(angle), -np.cos(angle), 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, [0.0, 0.0, 1.0], back])
    return matrix


def milliseconds(work: Callable[[], object], rounds: int) -> float:
    """The quickest of so many: other work on the machine only adds to it."""
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return 1e3 * min(seconds)


def main() -> None:
    after = sys.argv.index("--") + 1 if "--" in sys.argv else 1
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000, help="Gaussians")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), help="pixels of the view")
    options = parser.parse_args(sys.argv[after:])
    load_package()
    import physhdr
    from physhdr.addon.model.cleaning import Cleaning
    from physhdr.addon.model.look import kept_of
    from physhdr.addon.model.point_cloud import build_point_cloud
    from physhdr.addon.viewport.camera import ViewCamera
    from physhdr.addon.viewport.chunks import Chunks
    from physhdr.addon.viewport.splat_data import SplatTextures, fingerprint, read_arrays
    from physhdr.addon.viewport.splat_renderer import Item, SplatRenderer, Target

    physhdr.register()
    gpu.init()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cloud = build_point_cloud(room(options.count), "room")
    width, height = options.size
    start = time.process_time()
    arrays = read_arrays(cloud)
    read = time.process_time()
    splats = SplatTextures(arrays)
    built = time.process_time()
    del arrays
    item, renderer = Item(splats, np.eye(4)), SplatRenderer()
    target = Target(width, height)
    # A lens of 35 mm, as the artist's view has 50.
    camera = ViewCamera(pose(0.6), width, height, width, width, width / 2, height / 2)
    result: dict[str, float] = {
        "count": options.count,
        "read, CPU ms": 1e3 * (read - start),
        "textures, CPU ms": 1e3 * (built - read),
        "textures, MB": splats.texture_bytes / 1e6,
        "projected for a view, MB": splats.rows * 2048 * 48 / 1e6,
        "fingerprint, ms": milliseconds(lambda: fingerprint(cloud), options.rounds),
        "a slider of the crop, ms": milliseconds(
            lambda: kept_of(cloud, Cleaning(crop=tuple(np.eye(4).reshape(-1)), largest_size=0.1)),
            options.rounds,
        ),
    }
    visible = Chunks.visible
    for name, is_culled in (("culled", True), ("all", False)):
        Chunks.visible = visible if is_culled else lambda self, *_: np.arange(len(self.radius))

        def begin(exact_count: int | None, is_waited_for: bool = True):
            drawing = renderer.begin([item], camera, target, exact_count=exact_count)
            if is_waited_for:
                target.wait()
            return drawing

        drawing = begin(None)
        result[f"{name}: drawn, Gaussians"] = drawing.count
        result[f"{name}: order, MB"] = drawing.count * 4 / 1e6
        result[f"{name}: begin, sorted exactly, ms"] = milliseconds(lambda: begin(None), options.rounds)
        result[f"{name}: begin, roughly, ms"] = milliseconds(lambda: begin(0), options.rounds)
        result[f"{name}: of which Python, ms"] = milliseconds(lambda: begin(0, False), options.rounds)

        def whole():
            begin(None).draw()
            target.wait()

        result[f"{name}: whole picture, ms"] = milliseconds(whole, options.rounds)
    Chunks.visible = visible
    sys.stdout.write(json.dumps({key: round(value, 1) for key, value in result.items()}) + "\n")


if __name__ == "__main__":
    main()
