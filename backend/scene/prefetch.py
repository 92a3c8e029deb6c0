# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes pictures before an iteration asks for them, in a thread beside the training's.

Views come in an order that is known ahead (a shuffle of each epoch), so where not all pictures fit into the
cache, what the next iterations want can be read while this one computes. What is read is the same either way.
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from ...bridge.errors import PhysHDRError
from .scene import View

#: How many iterations ahead pictures are read: the next one's are ready when it begins.
AHEAD = 2
#: Seconds between two looks at how far the training is; where reading takes long, iterations do, too.
LOOK_SECONDS = 0.01


class Schedule(Protocol):
    """A training, as the reading thread sees it. ``iteration``: the one it is at, counted from 0."""

    iteration: int

    @property
    def views(self) -> Sequence[View]:
        """Those that are drawn."""
        ...

    def draw(self, iteration: int) -> tuple[View, tuple[int, ...]]:
        """The view of an iteration, and the positions in its bracket that are compared."""
        ...


@contextmanager
def reading_ahead(schedule: Schedule, iterations: int) -> Iterator[None]:
    """While active, pictures of ``iterations`` are read ahead, as long as not all are in the cache."""
    stop = threading.Event()
    thread = threading.Thread(
        target=_read, args=(schedule, iterations, stop), name="reading ahead", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _read(schedule: Schedule, iterations: int, stop: threading.Event) -> None:
    first = wanted = schedule.iteration
    while wanted < iterations and not stop.is_set():
        if wanted > schedule.iteration + AHEAD:
            stop.wait(LOOK_SECONDS)
            continue
        wanted = max(wanted, schedule.iteration)  # what has been drawn needs no reading
        view, places = schedule.draw(wanted)
        try:
            read = [view.image(k) for k in places]
        except (PhysHDRError, OSError, MemoryError):
            return  # the training meets the same, and tells
        largest = max(picture.nbytes for picture in read)
        if wanted - first >= len(schedule.views) and view.cache.bytes_held + largest <= view.cache.budget:
            return  # every view has been read, and none was forgotten
        wanted += 1
