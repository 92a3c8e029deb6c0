# SPDX-License-Identifier: GPL-3.0-or-later
"""What memory this process may have, and which errors mean that it was not enough.

Asked before torch is imported, and when hardly anything can be allocated: standard library alone at the top.
"""

import errno
import functools
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..bridge.errors import PhysHDRError

#: Bytes of addresses below which no command is begun, without what each core takes. On two cores the
#: libraries load in 1010 MB and the smallest evaluation takes 1270 MB. With little more than that libraries
#: fail in ways of their own: OpenMP, OpenBLAS and C++ end the process, and some crash as it ends.
LEAST_ADDRESSES = 1_300_000_000
#: Bytes of addresses that a core takes: a thread in each of the pools of OpenMP, of OpenBLAS and of our own,
#: and each has a stack of 8 MB (16 threads: 2.5 GB in all, 64: 3.7 GB).
ADDRESSES_A_CORE = 24_000_000
#: Bytes of addresses that a training reserves and never touches, beside ``ADDRESSES_A_CORE``: libraries and
#: heaps of threads. Measured on two cores: the peak of addresses less that of memory is 925 to 945 MB.
UNTOUCHED_ADDRESSES = 900_000_000

#: Bytes of pictures that are kept in any case: all of HDR-NeRF-Syn at 400×400 (84 MB) with room to spare.
LEAST_OF_PICTURES = 1 << 30

#: Windows' numbers for a lack of memory: too little, none, and a paging file that cannot grow, which is
#: no ENOMEM. Their words are in the system's language.
OUT_OF_MEMORY_ON_WINDOWS = (8, 14, 1455)
#: How libraries say, in errors of no class of their own, that there is no memory: torch, CUDA's libraries,
#: the dynamic linker, Python's threads, C++, Windows' loader.
OUT_OF_MEMORY_WORDS = (
    "can't allocate memory",
    "cannot allocate memory",
    "not enough memory",
    "out of memory",
    "failed to map segment",
    "can't start new thread",
    "std::bad_alloc",
    "alloc_failed",
    "paging file is too small",
)


class NotEnoughMemoryError(PhysHDRError):
    """What is asked for takes more memory than there is."""


@dataclass(frozen=True)
class Room:
    """What this process may have in all, what it has included: ``bytes``, and who sets that bound.

    ``container``: the limit of a control group; ``addresses``: ``ulimit -v``; ``card``: a CUDA card's memory.
    """

    bytes: int
    bound: Literal["machine", "container", "addresses", "card"]

    @property
    def in_words(self) -> str:
        """As the end of a sentence."""
        size = gigabytes(self.bytes)
        return {
            "machine": f"{size} are free",
            "container": f"the container's limit leaves {size}",
            "addresses": f"ulimit -v leaves {size}",
            "card": f"{size} are free on the card",
        }[self.bound]

    @property
    def remedy(self) -> str:
        """What makes more room, as a sentence."""
        return {
            "machine": "Close other programs.",
            "container": "Raise the container's memory limit.",
            "addresses": "Lift the shell's limit: ulimit -v unlimited.",
            "card": "End what else computes on the card, or train with --device cpu.",
        }[self.bound]


def gigabytes(size: float) -> str:
    """In words; small sizes with enough digits to differ from nothing."""
    return f"{size / 1e9:.0f} GB" if size >= 9.95e9 else f"{size / 1e9:.1f} GB"


# -- limits of the process -----------------------------------------------------------------------------------


def address_limit() -> int | None:
    """Bytes of addresses that the process may have (``ulimit -v``); None: as many as it wants."""
    if sys.platform == "win32":
        return None
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit


def cores() -> int:
    """How many threads the pools of libraries have: one a core, unless OpenMP is told otherwise."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    return int(told) if told.isdigit() and int(told) else os.cpu_count() or 1


def refuse_too_few_addresses() -> None:
    """Raises ``NotEnoughMemoryError`` where ``ulimit -v`` is below what the libraries need to load at all."""
    limit, least = address_limit(), LEAST_ADDRESSES + cores() * ADDRESSES_A_CORE
    if limit is not None and limit < least:
        fewer = " Fewer threads take less: OMP_NUM_THREADS=2 in the environment." if cores() > 2 else ""
        raise NotEnoughMemoryError(
            f"there is not enough memory: ulimit -v leaves {gigabytes(limit)} of addresses; with {cores()} "
            f"threads the program needs {gigabytes(least)}, and a training more",
            f"Lift the shell's limit: ulimit -v unlimited.{fewer}",
        )


def room() -> Room:
    """The least of what the machine, the process's cgroup and its addresses leave it."""
    import psutil

    process = psutil.Process().memory_info()
    rooms = [Room(psutil.virtual_memory().available + process.rss, "machine")]
    group = cgroup_left()
    if group is not None:
        rooms.append(Room(group + process.rss, "container"))
    limit = address_limit()
    if limit is not None:
        untouched = max(process.vms - process.rss, UNTOUCHED_ADDRESSES + cores() * ADDRESSES_A_CORE)
        rooms.append(Room(max(limit - untouched, 0), "addresses"))
    return min(rooms, key=lambda each: each.bytes)


@functools.cache
def picture_room() -> int:
    """Bytes that pictures of a kind (decoded ones; merged ones) are kept in: a quarter of the ``room``.

    1 GiB at least, and what it was when it was first asked for: a training is told before how much it will
    take.
    """
    return max(LEAST_OF_PICTURES, room().bytes // 4)


def cgroup_left(
    membership: Path = Path("/proc/self/cgroup"), mount: Path = Path("/sys/fs/cgroup")
) -> int | None:
    """Bytes that the process's control group may still take; None where nothing limits it (or not Linux).

    ``membership``: the kernel's list of the groups that the process is in; ``mount``: where groups are files.
    A group's limit binds those within it, so all groups up to the root count.
    """
    try:
        lines = membership.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    left = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:  # version 2
            names = ("memory.max", "memory.current", "inactive_file")
            left += _left_of_groups(mount, path, *names)
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            left += _left_of_groups(mount / "memory", path, *names)
    return min(left, default=None)


def _left_of_groups(root: Path, path: str, limit: str, usage: str, cached: str) -> Iterator[int]:
    """What is left in the group ``path`` and in each that holds it, where those have a limit."""
    group = root / path.strip("/")
    for folder in (group, *group.parents):
        try:
            most, used = ((folder / name).read_text(encoding="utf-8").strip() for name in (limit, usage))
            statistics = dict(
                line.split() for line in (folder / "memory.stat").read_text(encoding="utf-8").splitlines()
            )
            # Files that nobody reads just now are given back when memory is wanted.
            yield max(int(most) - int(used) + int(statistics.get(cached, 0)), 0)
        except (OSError, ValueError):  # no such group in this container's view, or "max": no limit
            pass
        if folder == root:
            return


# -- errors --------------------------------------------------------------------------------------------------


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether the error, or one that it came of, is a lack of memory, whoever noticed it."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        if getattr(error, "winerror", None) in OUT_OF_MEMORY_ON_WINDOWS:  # of Windows' OSError alone
            return True
        if isinstance(error, (RuntimeError, ImportError, OSError)):
            said = str(error).lower()
            if any(words in said for words in OUT_OF_MEMORY_WORDS):
                return True
        error = error.__cause__ or error.__context__
    return False
