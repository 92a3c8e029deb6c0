# SPDX-License-Identifier: GPL-3.0-or-later
"""Every row of the table that a worker can try."""

from . import files, formats, frames, runs, scenes

#: The slow ones last: what others leave of the time is theirs.
TARGETS = (*frames.TARGETS, *files.TARGETS, *formats.TARGETS, *scenes.TARGETS, *runs.TARGETS)
