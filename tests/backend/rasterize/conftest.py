# SPDX-License-Identifier: GPL-3.0-or-later
from collections.abc import Iterator

import pytest

#: Warp has two ways to run a block of threads on the CPU: one after the other, or as fibers that wait for
#: one another, as a card's threads do.
FLOAT32 = ("cpu", "warp", "warp in blocks")


@pytest.fixture(params=FLOAT32)
def implementation(request) -> Iterator[str]:
    """Every rasteriser of float32 that runs on the CPU; those in Warp skip where it is not installed."""
    name, _, mode = request.param.partition(" ")
    if name == "cpu":
        yield name
        return
    warp = pytest.importorskip("warp", reason="warp-lang is not installed")
    if mode and not hasattr(warp.config, "enable_cpu_blocks"):
        pytest.skip("before warp-lang 1.18 there are no blocks on the CPU")
    with pytest.MonkeyPatch.context() as patch:
        if mode:
            patch.setattr(warp.config, "enable_cpu_blocks", True)
        yield name
