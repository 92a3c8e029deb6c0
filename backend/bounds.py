# SPDX-License-Identifier: GPL-3.0-or-later
"""What a whole number in a configuration may be, as the type of its field says."""

from typing import Annotated, Any, NamedTuple

#: The most of any: what NumPy's and torch's generators both take as a seed.
WHOLE_MAX = 2**32 - 1
#: The most of a network's sizes: ten times what any system has.
SIZE_MAX = 4096


class Bounds(NamedTuple):
    """A number is from ``least`` to ``most``."""

    least: int = 1
    most: int = WHOLE_MAX


#: A number that may be 0: none, no bound, from the start.
FromZero = Annotated[int, Bounds(0)]
#: The size of a network, or of what it makes.
Size = Annotated[int, Bounds(1, SIZE_MAX)]
#: The same, where there may be none.
SizeFromZero = Annotated[int, Bounds(0, SIZE_MAX)]


def bounds_of(annotation: Any) -> Bounds:
    """Those that a field's type declares; a size or an interval, 1 at least, where it declares none."""
    declared = getattr(annotation, "__metadata__", ())
    return next((each for each in declared if isinstance(each, Bounds)), Bounds())
