# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the data sets that methods are compared on, as far as they are not there: data/benchmark/NAME.

    .venvs/backend/bin/python lab/tools/benchmark_data.py                     the seven open scenes
    .venvs/backend/bin/python lab/tools/benchmark_data.py dog dog-iso1600     these alone
    .venvs/backend/bin/python lab/tools/benchmark_data.py --plans lab/plans/exp1.toml   what plans ask for

200×200, 35 poses, no lit views (SCENE-lit has them): every method trains on the same pictures. Training views
are rendered (2 to 5 minutes of two cores a scene); the truth of test and validation views is taken from
lab/data. A name SCENE-CAMERA is the scene as another camera takes it, from the same renders (CAMERAS).
Beside the exact points of the renders each folder has those of structure from motion (``physhdr
triangulate``).
"""

import argparse
import subprocess
import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "data" / "benchmark"
KEPT = ROOT / "lab" / "data"
COMMON = ("--resolution", "200", "--workers", "2")
PLAIN = ("--lit-views", "0", "--relit-views", "0")
#: SCENE-lit: training views under other light as well, and truth at levels that none of them has. Test views
#: are as noisy as training views, for the truth that is kept is of one light.
LIT, LIT_VIEWS = "lit", ("--lit-views", "12", "--relit-views", "8")
#: Scene → samples of its training views.
SAMPLES = {
    "interior": 64,
    "bathroom": 32,
    "sponza": 64,
    "bear": 64,
    "diningroom": 64,
    "dog": 64,
    "sofa": 64,
    "chair": 64,
    "desk": 64,
}
#: Rendered only when they are named (lab/plans/README.md).
SEALED = ("chair", "desk")
#: Validation views of the scenes that choices are made on, as lab/tools/keep_truth.py has them.
VALIDATION_VIEWS = {"interior": 4, "bathroom": 4, "sponza": 4}
#: What is made without a name: the open scenes, and what lab/plans/ladder.toml asks for beside them.
USUAL = (*(name for name in SAMPLES if name not in SEALED), "bathroom-local")
#: What real cameras do (docs/photos.md#faults-of-a-rendered-camera): options of make_scene.py.
CAMERAS = {
    "srgb": ("--crf", "srgb"),
    "filmic": ("--crf", "filmic"),
    "measured": ("--crf", str(ROOT / "lab" / "curves" / "olympus-e-m10-ii.txt")),
    "local": ("--local-response", "0.7"),
    "iso100": ("--iso", "100"),
    "iso1600": ("--iso", "1600"),
    "iso6400": ("--iso", "6400"),
    "iso25600": ("--iso", "25600"),
    "white-balance": ("--white-balance-jitter", "0.1"),
    "vignetting": ("--vignetting", "1.5"),
    "exposure": ("--exposure-jitter", "0.1"),
}


def main() -> int:
    variants = (*CAMERAS, LIT)
    known = {*SAMPLES, *(f"{scene}-{variant}" for scene in SAMPLES for variant in variants)}
    listed = ", ".join([*SAMPLES, *(f"SCENE-{variant}" for variant in variants)])
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", default=USUAL, metavar="NAME", help=f"of: {listed}")
    parser.add_argument("--plans", nargs="+", type=Path, metavar="FILE", help="what these plans ask for")
    arguments = parser.parse_args()
    names = _asked_for(arguments.plans) if arguments.plans else arguments.names
    for name in names:  # all, before the first is rendered
        if name not in known:
            parser.error(f"there is no data set '{name}'; there are {listed}")
    for name in names:
        scene, _, camera = name.partition("-")
        parts = (scene, name) if camera in CAMERAS else (name,)  # a camera's set needs the scene's renders
        if status := next((status for each in parts if (status := _make(each))), 0):
            return status
    return 0


def _asked_for(plans: list[Path]) -> list[str]:
    """The data sets of plans (TOML), by name, each once."""
    scenes = [scene for plan in plans for scene in tomllib.loads(plan.read_text(encoding="utf-8"))["scenes"]]
    return list(dict.fromkeys(Path(scene).name for scene in scenes))


def _make(name: str) -> int:
    """Exit status of the first command that fails."""
    scene, _, camera = name.partition("-")
    folder, begun = FOLDER / name, time.perf_counter()
    words = [
        "--out",
        str(folder),
        "--scene",
        scene,
        "--samples",
        str(SAMPLES[scene]),
        *COMMON,
        *(LIT_VIEWS if camera == LIT else (*PLAIN, *_truth(scene))),
    ]
    if camera in CAMERAS:
        words += [*CAMERAS[camera], "--renders-of", str(FOLDER / scene)]
    commands = [[ROOT / ".venvs" / "run-blender", ROOT / "synth" / "make_scene.py", "--", *words]]
    if not (folder / "points3d_sfm.ply").exists():
        commands.append([Path(sys.executable).parent / "physhdr", "prepare", folder, "--triangulate"])
    for command in commands:
        if status := subprocess.run(command, check=False).returncode:
            return status
    print(f"[data] {folder} ready after {time.perf_counter() - begun:.0f} s", flush=True)
    return 0


def _truth(scene: str) -> list[str]:
    """Where the truth of test and validation views comes from."""
    validation = ["--validation-views", str(VALIDATION_VIEWS.get(scene, 0))]
    if (KEPT / scene / "truth.json").exists():
        return ["--test-truth", str(KEPT / scene), *validation]
    print(f"[data] {scene}: no truth of it is kept yet, so its test views have the noise of training views")
    return validation


if __name__ == "__main__":
    sys.exit(main())
