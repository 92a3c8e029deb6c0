# SPDX-License-Identifier: GPL-3.0-or-later
"""The configurations of a plan's methods on one data set, because training finds sizes from the data."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path

from ...backend.scene import Scene, read_scene
from ...backend.train.config import TrainConfig
from ...backend.train.forecast import size
from ...bridge.errors import PhysHDRError


def sized(
    configs: Mapping[str, TrainConfig], typed: Mapping[str, Collection[str]], data: Path
) -> dict[str, TrainConfig]:
    """``configs``, by method, with sizes as in ``physhdr train`` on the data set in ``data``.

    ``typed``: the settings that the plan sets, by method. If the data set cannot be read, they stay
    unchanged: training will report the error.
    """
    scenes: dict[tuple[float | None, str | None], Scene] = {}
    found = dict(configs)
    for name, config in configs.items():
        how = (config.downscale, config.color_space)
        try:
            if how not in scenes:
                scenes[how] = read_scene(data, *how)
        except PhysHDRError:
            return dict(configs)
        with suppress(PhysHDRError):  # a missing file of points only affects this method
            found[name], _ = size.sized(scenes[how], config, typed[name])
    return found
