# SPDX-License-Identifier: GPL-3.0-or-later
"""``python -m physhdr.lab.benchmark.child THREADS USAGE COMMAND…``: runs the command ``physhdr``, measured.

Computes with THREADS threads, ends when the benchmark that started it dies, and writes the process's peak
memory into the file USAGE.
"""

import json
import sys
from pathlib import Path
from typing import Any

import psutil

from ...backend.jobs.process import end_with_parent


def main(argv: list[str]) -> int:
    threads, usage, *command = argv
    end_with_parent()
    import torch

    from ...backend.cli import main as physhdr
    from ...backend.simd.threads import set_threads
    from .machine import this_machine

    machine = this_machine()  # now: the code on disk may change while this runs

    set_threads(int(threads))
    torch.set_num_threads(int(threads))
    status = physhdr(command)
    Path(usage).write_text(json.dumps(_usage() | {"machine": machine | _device()}), encoding="utf-8")
    return status


def _usage() -> dict[str, Any]:
    """Bytes: ``peak_memory`` of the process, ``peak_device_memory`` of a card."""
    import torch

    on_card = torch.cuda.is_available() and torch.cuda.is_initialized()
    return {
        "peak_memory": _peak_memory(),
        "peak_device_memory": torch.cuda.max_memory_allocated() if on_card else None,
    }


def _device() -> dict[str, str]:
    """``device``: where it was computed."""
    import torch

    on_card = torch.cuda.is_available() and torch.cuda.is_initialized()
    return {"device": torch.cuda.get_device_name() if on_card else "cpu"}


def _peak_memory() -> int:
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
