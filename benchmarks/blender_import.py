# SPDX-License-Identifier: GPL-3.0-or-later
"""How long Blender takes to import a million Gaussians. Runs in Blender; prints one line of JSON.

.venvs/run-blender benchmarks/blender_import.py -- [--count N] [--rounds R]
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parent.parent


def load_package() -> None:
    """``physhdr`` from this checkout, where Blender has it not installed."""
    try:
        import physhdr  # noqa: F401
    except ImportError:
        sys.path.insert(0, str(ROOT / "addon" / "scripts"))
        import relight

        relight.load_package()


def write_files(folder: Path, count: int) -> dict[str, Path]:
    """A model file and a standard PLY of ``count`` Gaussians of degree 3, as trained ones are spread."""
    from physhdr.bridge.gaussian_ply import write_standard_ply
    from physhdr.bridge.model_file import Model, write_model

    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, dtype=np.float32)

    model = Model(
        position=normal(count, 3),
        rotation=normal(count, 4),
        scale=np.exp(normal(count, 3) - 4.0),
        opacity=rng.random(count, dtype=np.float32),
        log_radiance_sh=normal(count, 16, 3) * np.float32(0.1),
        light_share=rng.random((count, 1, 3), dtype=np.float32),
    )
    write_model(folder / "model.safetensors", model)
    write_standard_ply(
        folder / "splats.ply",
        model.position,
        model.rotation,
        model.scale,
        model.opacity,
        model.log_radiance_sh,
    )
    return {"model file": folder / "model.safetensors", "PLY": folder / "splats.ply"}


def seconds_of_import(path: Path) -> float:
    """The operator, as the menu runs it, in an empty file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    start = time.perf_counter()
    operators: Any = bpy.ops
    operators.physhdr.model_import("EXEC_DEFAULT", True, filepath=str(path))
    return time.perf_counter() - start


def main() -> None:
    after = sys.argv.index("--") + 1 if "--" in sys.argv else 1
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000, help="Gaussians")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args(sys.argv[after:])
    load_package()
    import physhdr

    physhdr.register()
    with tempfile.TemporaryDirectory() as folder:
        files = write_files(Path(folder), options.count)
        times: dict[str, list[float]] = {kind: [] for kind in files}
        for _ in range(options.rounds):
            for kind, path in files.items():
                times[kind].append(seconds_of_import(path))
        # The map of a model file ends with the models; Windows cannot delete a mapped file.
        bpy.ops.wm.read_factory_settings(use_empty=True)
    median = {kind: statistics.median(seconds) for kind, seconds in times.items()}
    sys.stdout.write(json.dumps({"count": options.count, "seconds": median}) + "\n")


if __name__ == "__main__":
    main()
