# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that may use fewer cores than the machine has does not start a thread for each of them."""

import os
import subprocess
import sys

import pytest


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="only Linux keeps a process to some cores")
def test_kernels_have_a_thread_for_each_core_that_they_may_use():
    script = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from physhdr.backend.simd import thread_count\n"
        "from physhdr.bridge.cores import usable_cores\n"
        "print(thread_count(), usable_cores())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "1"]
