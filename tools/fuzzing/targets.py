# SPDX-License-Identifier: GPL-3.0-or-later
"""Every row of the table that a worker can try."""

from . import files, frames, runs, scenes

TARGETS = (*scenes.TARGETS, *files.TARGETS, *runs.TARGETS, *frames.TARGETS)
