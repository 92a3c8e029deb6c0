# SPDX-License-Identifier: GPL-3.0-or-later
"""How many cores a process may use, by its container's share; by its affinity: tests/backend/simd."""

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
