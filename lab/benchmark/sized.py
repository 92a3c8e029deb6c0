# SPDX-License-Identifier: GPL-3.0-or-later
"""What the methods of a plan are trained with on one data set: a training finds its size from the data."""

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
    """``configs``, by method, as ``physhdr train`` makes them of the data set in ``data``.

    ``typed``: the settings that the plan sets, by method. Of a data set that cannot be read they stay as they
    are: the training says what is wrong with it.
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
        with suppress(PhysHDRError):  # a method's file of points that is not there is that method's alone
            found[name], _ = size.sized(scenes[how], config, typed[name])
    return found
