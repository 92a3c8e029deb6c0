# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that a user can cause: each message says what was wrong and what to do next."""

from __future__ import annotations


class SynthError(Exception):
    """Base of all errors that end in one line on stderr and exit code 1."""


class UnknownNameError(SynthError):
    """No scene, response or rig has this name."""

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        super().__init__(f"unknown {kind} '{name}': choose one of {', '.join(sorted(known))}")


class OptionError(SynthError):
    """An option's value is out of range or not understood."""


class ResponseFileError(SynthError):
    """The file of a camera response is missing or holds no rising curve."""


class OutputFolderError(SynthError):
    """The output folder cannot be written, or belongs to something else."""


class ConflictError(SynthError):
    """The output folder holds a data set made with other options."""


class DamagedFileError(SynthError):
    """A file of the data set exists but is not whole."""


class RenderError(SynthError):
    """Blender did not produce the picture."""
