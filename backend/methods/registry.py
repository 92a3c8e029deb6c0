# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method by its name: ours, and those that packages add, as ``lab/`` does."""

from collections.abc import Callable
from typing import NamedTuple

from ..tables import Table
from .base import Method, MethodConfig
from .physhdr import PhysHDR
from .physhdr_common import PhysHDRConfig


class Registered(NamedTuple):
    """A method: its settings, and what makes it of them.

    ``make`` is called with the settings, a backbone without primitives, and the ``MethodSetup``.
    """

    config: type[MethodConfig]
    make: Callable[..., Method]


#: By the names that stand in files.
METHODS: Table[Registered] = Table("methods", {PhysHDRConfig.name: Registered(PhysHDRConfig, PhysHDR)})
