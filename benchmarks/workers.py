# SPDX-License-Identifier: GPL-3.0-or-later
"""What is measured in a process of its own: ``python workers.py NAME ARGUMENT…`` prints one line of JSON.

Imports are inside the functions: the clock of a warm start runs while they are read.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any


def memory(preset: str, threads: str) -> dict[str, float]:
    """Peak resident MB of a training: 35 views × 5 exposures, 180 k Gaussians that become 200 k.

    Twenty real iterations at the SH degree of the preset, densification after the tenth, and the checkpoint.
    """
    import dataclasses
    import tempfile

    import torch
    from synthetic import untrained_state

    from physhdr.backend.rasterize import cpu
    from physhdr.backend.train import trainer
    from physhdr.backend.train.presets import PRESETS

    cpu.set_threads(int(threads))
    torch.set_num_threads(int(threads))
    config = PRESETS[preset]
    densify = dataclasses.replace(config.backbone, start=5, every=10, threshold=0.0, budget=200_000)
    config = dataclasses.replace(config, iterations=20, sh_degree_every=1, backbone=densify)
    state = untrained_state(
        dataclasses.replace(config, backbone=dataclasses.replace(densify, stop=0.6)), 180_000, views=35
    )
    pictures = sum(view.image(k).nbytes for view in state.views for k in range(len(view.exposures)))
    with tempfile.TemporaryDirectory() as folder:
        for _ in trainer.run(state, Path(folder)):
            pass
    return {"peak_mb": peak_mb(), "gaussians": len(state.method.gaussians), "pictures_mb": pictures / 1e6}


def peak_mb() -> float:
    """The most memory that this process has had resident, in MB.

    Not ``getrusage``'s: Linux hands a new program the peak of the process that started it.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) * 1024 / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def first_iteration(data: str, run: str) -> None:
    """``physhdr train`` until its first iteration is done; prints the time of day and ends at once."""
    from physhdr.backend.cli import main
    from physhdr.backend.train import trainer
    from physhdr.backend.train.forecast import duration
    from physhdr.backend.train.state import State

    step = trainer.step

    def step_and_stop(state: State) -> Any:
        step(state)
        report({"done": time.time()})
        os._exit(0)

    trainer.step = duration.step = step_and_stop
    main(["train", data, "--out", run, "--overwrite", "--device", "cpu"])


def report(result: dict[str, float]) -> None:
    """One line on the standard output, past any buffer."""
    sys.stdout.write(json.dumps(result) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    outcome = {"memory": memory, "first-iteration": first_iteration}[sys.argv[1]](*sys.argv[2:])
    if outcome is not None:
        report(outcome)
