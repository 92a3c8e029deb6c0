# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a scene's run: the one that is chosen, else one that is proposed for its data set."""

import os
import time
from pathlib import Path

import bpy

from ..bridge.run_folder import data_of, same_folder
from . import outside
from .paths import absolute, first_free, is_free
from .settings import RUN, PHYSHDR_Settings

#: Seconds for which a proposal stands before the disk is looked at again: panels ask at every redraw.
PROPOSAL_SECONDS = 1.0

_proposals: dict[tuple[str, str], tuple[float, str]] = {}


def run_of(settings: PHYSHDR_Settings) -> str:
    """The run's folder that is chosen, else the one that is proposed; empty where there are neither, or the
    user has not chosen them since the file was opened (``outside``)."""
    if settings.out:
        return settings.out if outside.chosen(settings.out) else ""
    return proposed_run(outside.chosen(settings.data))


def proposed_run(data: str) -> str:
    """Where a training on ``data`` may go, so that nothing must be typed; empty where no data set is chosen.

    Beside the .blend; before that is saved, beside the data set, or where one may not write there in the
    user's own folder. One that holds a run of this data set is proposed again, one that holds anything else
    never.
    """
    if not data:
        return ""
    key, now = (data, bpy.data.filepath), time.monotonic()
    found = _proposals.get(key)
    if found is None or now > found[0] + PROPOSAL_SECONDS:
        _proposals[key] = found = now, _free_run(data)
    return found[1]


def _free_run(data: str) -> str:
    name = f"{os.path.basename(data) or 'data'}{RUN}"
    if bpy.data.filepath:
        return f"//{_own_or_free(Path(absolute('//')) / name, data).name}"
    beside = Path(data).parent
    is_beside = beside != Path(data) and os.access(beside, os.W_OK)  # a whole card has nothing beside it
    return str(_own_or_free((beside if is_beside else Path.home()) / name, data))


def _own_or_free(folder: Path, data: str) -> Path:
    """The folder, or the same with a number where it holds something that is no run of ``data``."""
    return first_free(folder, fits=lambda each: is_free(each) or is_run_of(each, data))


def is_run_of(folder: Path, data: str) -> bool:
    """Whether ``folder`` holds a run that was trained on the data set in ``data``."""
    trained_on = data_of(folder)
    return trained_on is not None and outside.may_follow(trained_on) and same_folder(trained_on, data)
