# SPDX-License-Identifier: GPL-3.0-or-later
"""The vectors' own functions against numpy, the heap setting against the system's count of page faults."""

import dataclasses
import resource
import sys

import numpy as np
import pytest
import torch
from numba import njit

from physhdr.backend import simd
from physhdr.backend.scene import read_scene
from physhdr.backend.simd import (
    LANES,
    denormals,
    exp2_of_8,
    exp_of_negative,
    load,
    load_each,
    log1p_of_fraction,
    log2_of_positive,
    span_bits,
    store,
    store_totals,
    store_transposed,
    total,
)
from physhdr.backend.train.begin import begin
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step


def lane_by_lane(function):
    """``function`` of vectors as a function of arrays whose size is a multiple of ``LANES``."""

    @njit
    def run(x, y):
        for i in range(0, x.size, LANES):
            store(function(load(x, i)), y, i)

    def apply(x):
        x = x.astype(np.float32)
        y = np.empty_like(x)
        run(x, y)
        return y.astype(np.float64), x.astype(np.float64)

    return apply


@pytest.mark.parametrize(
    ("function", "truth", "low", "high", "error"),
    [
        (exp2_of_8, lambda t: 2.0 ** (8.0 * t), -1.0, 0.0, 3e-6),  # rounding, raised to the eighth power
        (exp_of_negative, np.exp, -87.0, 0.0, 1e-5),  # of x up to 87, whose own rounding is 4e-6
        (log1p_of_fraction, np.log1p, 1e-4, 1.0, 2e-7),
    ],
)
def test_powers(function, truth, low, high, error):
    y, x = lane_by_lane(function)(np.linspace(low, high, 80_000))
    assert np.abs(y / truth(x) - 1.0).max() <= error


def test_logarithm_over_all_magnitudes():
    y, x = lane_by_lane(log2_of_positive)(np.exp2(np.linspace(-126.0, 127.9, 160_000)))
    assert np.abs(y - np.log2(x)).max() <= 1e-5  # of numbers up to 127
    near_one, x = lane_by_lane(log2_of_positive)(np.linspace(0.9, 1.1, 8000))
    assert np.abs(near_one - np.log2(x)).max() <= 2e-8


def test_transposed():
    rows = np.arange(LANES * LANES, dtype=np.float32)
    stride = LANES + 3
    result = np.zeros(LANES * stride, np.float32)
    count = (0,) * LANES

    @njit
    def run(count, rows, result):
        store_transposed(load_each(count, rows, 0, LANES), result, 0, stride)

    run(count, rows, result)
    assert np.array_equal(result.reshape(LANES, stride)[:, :LANES], rows.reshape(LANES, LANES).T)


@pytest.mark.parametrize("count", [1, 7, 12, 22])
def test_totals(count):
    values = np.random.default_rng(count).integers(-100, 100, (count, LANES)).astype(np.float32)
    result = np.full(-(-count // LANES) * LANES, 7.0, np.float32)

    @njit
    def run(marker, values, result):
        store_totals(load_each(marker, values, 0, LANES), result, 0)
        return total(load(values, 0))

    assert run((0,) * count, values.reshape(-1), result) == values[0].sum()
    assert np.array_equal(result[:count], values.sum(1))
    assert not result[count:].any()


def test_spans():
    first, last = np.array([0, 3, 8, 5, 0, 2, 7, 0]), np.array([8, 5, 8, 2, 0, 3, 8, 1])

    @njit
    def run(first, last):
        return span_bits(load(first, 0), load(last, 0))

    padded = [np.resize(v, LANES).astype(np.float32) for v in (first, last)]
    bits = int(run(*padded))
    for row, (a, b) in enumerate(zip(first, last, strict=True)):
        assert (bits >> (8 * row)) & 255 == sum(1 << k for k in range(a, b))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's setting")
def test_freed_memory_is_kept():
    if not simd.keep_freed_memory():
        pytest.skip("another C library than glibc")

    def faults(megabytes):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.empty(megabytes << 18, np.float32)[::1024] = 1.0  # touch every page
        return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

    pages = (40 << 20) // resource.getpagesize()
    faults(40)
    assert min(faults(40) for _ in range(5)) < pages / 10


TINY = np.float32(1e-30), np.float32(1e-10)  # their product is a denormal number


@simd.kernel
def products(first, last, x, y):
    for i in range(first, last):
        y[i] = x[i] * TINY[1]


def flushed_by_kernels(threads):
    before = simd.thread_count()
    simd.set_threads(threads)
    try:
        x = np.full(1 << 16, TINY[0])
        y = np.ones_like(x)
        simd.run_ranges(products, x.size, x, y)
        few = np.ones(8, np.float32)
        simd.run_ranges(products, few.size, x, few)
        # One result a thread, whichever thread takes a job.
        jobs = simd.run_parallel(lambda i: TINY[0] * TINY[1])
        return not (y.any() or few.any() or any(jobs))
    finally:
        simd.set_threads(before)


@pytest.mark.skipif(not denormals.FLUSHING, reason="a processor whose setting is not known here")
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_every_kernel_thread_flushes_denormals_and_the_callers_is_as_before(threads):
    kept = torch.set_flush_denormal(False)
    assert kept and TINY[0] * TINY[1] > 0.0
    assert flushed_by_kernels(threads)
    assert TINY[0] * TINY[1] > 0.0
    before = simd.flush_denormals()
    assert TINY[0] * TINY[1] == 0.0 and flushed_by_kernels(threads)
    assert TINY[0] * TINY[1] == 0.0  # a thread that flushed goes on doing so
    simd.restore_denormals(before)


@pytest.mark.skipif(not denormals.FLUSHING, reason="a processor whose setting is not known here")
def test_a_failing_job_leaves_the_callers_thread_as_it_was():
    torch.set_flush_denormal(False)

    def fail(_):
        raise KeyError("no work")

    with pytest.raises(KeyError):
        simd.run_parallel(fail)
    assert TINY[0] * TINY[1] > 0.0


def test_denormals_are_left_to_all_but_kernels(tiny_data):
    """SciPy's KDTree never ends where they are flushed: what it takes for the next number above 0 is one."""
    state = begin(read_scene(tiny_data), dataclasses.replace(PRESETS["default"], iterations=9))
    step(state)
    assert TINY[0] * TINY[1] > 0.0 and torch.tensor(TINY).prod() > 0.0
