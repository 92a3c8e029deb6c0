# SPDX-License-Identifier: GPL-3.0-or-later
"""How many cores this process may use, which are not always all that the machine has."""

import math
import os
from pathlib import Path

#: Microseconds of CPU time in a period, and the period's length; "max" where there is no limit (cgroup v2).
QUOTA = Path("/sys/fs/cgroup/cpu.max")


def usable_cores(quota: Path = QUOTA) -> int:
    """Cores by the process's affinity (``taskset``, SLURM) and its container's share of CPU time; at least 1.

    ``quota``: where the kernel tells that share. More threads than that only wait for each other.
    """
    # On Linux alone; elsewhere nothing keeps a process from a core.
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    try:
        share, period = quota.read_text(encoding="ascii").split()
        cores = min(cores, math.ceil(int(share) / int(period)))
    except (OSError, ValueError, ZeroDivisionError):  # no such group, or "max"
        pass
    return max(1, cores)
