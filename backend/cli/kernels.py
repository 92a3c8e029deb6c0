# SPDX-License-Identifier: GPL-3.0-or-later
"""Compile the CPU kernels that a training calls, with progress; ``physhdr check`` compiles all of them."""

import time

from rich.progress import Progress

from ..kernels.ahead import Needs, are_cached, compile_ahead
from ..runs.terminal import aside

#: In less time than this nothing was compiled, and nothing is printed.
COMPILED_SECONDS = 5.0


def compile_kernels(needs: Needs) -> float:
    """Compile what is needed and not in the cache, with a bar; returns the seconds."""
    begun = time.perf_counter()
    with Progress(console=aside, transient=True, disable=not aside.is_terminal) as bar:
        task = bar.add_task("compiling kernels", total=None)
        compile_ahead(
            needs,
            lambda what, done, total: bar.update(
                task, completed=done, total=total, description=f"compiled {what}"
            ),
        )
    seconds = time.perf_counter() - begun
    if seconds > COMPILED_SECONDS:
        later = "; later starts find them in the cache" if are_cached() else ""
        aside.print(f"kernels compiled in {seconds:.0f} s{later}")
    return seconds
