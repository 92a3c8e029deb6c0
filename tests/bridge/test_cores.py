# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that may use fewer cores than the machine has does not start a thread for each of them."""

import os
import subprocess
import sys

import pytest

from physhdr.bridge.cores import usable_cores


@pytest.mark.parametrize(
    ("told", "most"),
    [("150000 100000", 2), ("50000 100000", 1), ("max 100000", 10**6), ("", 10**6), ("1 0", 10**6)],
)
def test_a_container_s_share_of_time(told, most, tmp_path):
    (tmp_path / "cpu.max").write_text(told)
    free = usable_cores(tmp_path / "none")
    assert usable_cores(tmp_path / "cpu.max") == min(free, most)


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
