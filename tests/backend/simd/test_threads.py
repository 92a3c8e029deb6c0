# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that may use fewer cores than the machine has does not start a thread for each of them."""

import os
import platform
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


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
@pytest.mark.skipif(platform.machine() != "x86_64", reason="elsewhere torch computes with the same library")
def test_the_linear_algebra_of_numpy_and_scipy_starts_no_threads():
    """They would spin: where cores are busy, what takes a thread 0.2 s takes two 3."""
    script = (
        "import os, physhdr.backend, numpy, scipy.linalg\n"
        "numpy.linalg.solve(numpy.eye(512), numpy.ones(512))\n"
        "print(len(os.listdir('/proc/self/task')))"
    )
    theirs = {key: value for key, value in os.environ.items() if "NUM_THREADS" not in key}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=theirs
    )
    assert done.stdout.split() == ["1"]
