# SPDX-License-Identifier: GPL-3.0-or-later
"""What every CPU kernel is written with: explicit SIMD inside Numba, threads, a cache of compiled kernels.

Numba's auto-vectoriser is unreliable, so the kernels say what they mean: ``vector`` is LLVM's
``<LANES x float>``, ``mask`` is ``<LANES x i1>``. Functions that end in ``_each`` work on a tuple of vectors.
Array arguments are one-dimensional and contiguous.

``vector`` the types · ``operators`` · ``memory`` loads and stores · ``maths`` · ``powers`` exponentials and
logarithms · ``tuples`` · ``bits`` · ``compiling`` · ``threads`` · ``denormals`` · ``heap``.
"""

from . import operators as operators  # registers + − < … with Numba
from .bits import lowest_bit, span_bits, take_ticket
from .compiling import kernel
from .denormals import flush_denormals, restore_denormals
from .heap import give_back_freed_memory, keep_freed_memory
from .maths import (
    absolute,
    any_lane,
    ceil,
    floor,
    fma,
    maximum,
    minimum,
    select,
    square_root,
    total,
)
from .memory import (
    add_powers,
    lane_numbers,
    load,
    load_halves,
    load_quads,
    load_strided,
    peek,
    prefetch,
    splat,
    store,
    store_halves,
    store_strided,
)
from .powers import exp, exp2_of_8, exp_of_negative, log1p_of_fraction, log2_of_positive
from .threads import ranges, run_parallel, run_ranges, set_threads, thread_count
from .tuples import (
    dot_each,
    fma_each,
    load_each,
    load_triples,
    positive_each,
    repeat_each,
    splat_each,
    store_each,
    store_totals,
    store_transposed,
    store_triples,
    where_positive_each,
    zero_each,
)
from .vector import LANES

__all__ = [
    "LANES",
    "absolute",
    "add_powers",
    "any_lane",
    "ceil",
    "dot_each",
    "exp",
    "exp2_of_8",
    "exp_of_negative",
    "floor",
    "flush_denormals",
    "fma",
    "fma_each",
    "give_back_freed_memory",
    "keep_freed_memory",
    "kernel",
    "lane_numbers",
    "load",
    "load_each",
    "load_halves",
    "load_quads",
    "load_strided",
    "load_triples",
    "log1p_of_fraction",
    "log2_of_positive",
    "lowest_bit",
    "maximum",
    "minimum",
    "peek",
    "positive_each",
    "prefetch",
    "ranges",
    "repeat_each",
    "restore_denormals",
    "run_parallel",
    "run_ranges",
    "select",
    "set_threads",
    "span_bits",
    "splat",
    "splat_each",
    "square_root",
    "store",
    "store_each",
    "store_halves",
    "store_strided",
    "store_totals",
    "store_transposed",
    "store_triples",
    "take_ticket",
    "thread_count",
    "total",
    "where_positive_each",
    "zero_each",
]

keep_freed_memory()
