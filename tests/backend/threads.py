# SPDX-License-Identifier: GPL-3.0-or-later
"""The number of threads changes no bit of a kernel's results."""

from collections.abc import Callable, Sequence

import torch

from physhdr.backend.simd import set_threads, thread_count


def assert_same_bits(compute: Callable[[], Sequence[torch.Tensor]]) -> None:
    """``compute`` has the same results on one, two and three threads."""
    before, outcomes = thread_count(), []
    try:
        for count in (1, 2, 3):
            set_threads(count)
            outcomes.append(compute())
    finally:
        set_threads(before)
    assert len(outcomes[0]) > 0
    assert all(torch.equal(a, b) for other in outcomes[1:] for a, b in zip(outcomes[0], other, strict=True))
