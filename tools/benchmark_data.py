# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the data sets of the comparison of methods, as far as they are not there: data/benchmark/SCENE.

    .venvs/backend/bin/python tools/benchmark_data.py

About 15 minutes of two cores each. 200×200, 35 poses, no lit views: every method trains on the same pictures.
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "data" / "benchmark"
COMMON = ("--resolution", "200", "--lit-views", "0", "--relit-views", "0", "--workers", "2")
#: Name → what make_scene.py is told beside that.
DATA = {
    "interior": ("--scene", "interior", "--samples", "64"),
    "bathroom": ("--scene", "bathroom", "--samples", "32"),
    "sponza": ("--scene", "sponza", "--samples", "64"),
    # The same renders through a camera that lifts shadows and holds lights back, as phones do.
    "bathroom-local": ("--scene", "bathroom", "--samples", "32", "--local-response", "0.7"),
}


def main() -> int:
    argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0]).parse_args()
    for name, options in DATA.items():
        folder = FOLDER / name
        begun = time.perf_counter()
        script = ROOT / "synth" / "make_scene.py"
        command = [ROOT / ".venvs" / "run-blender", script, "--", "--out", folder, *options, *COMMON]
        if status := subprocess.run(command, check=False).returncode:
            return status
        print(f"[data] {folder} ready after {time.perf_counter() - begun:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
