# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a model is from: the capture that it is of.

A capture is known by its data set's folder, which a run's configuration names; a model file of which nobody
knows the run is a capture of its own.
"""

import os
from pathlib import Path

import bpy

from ...bridge.run_folder import data_of as data_of_run
from .. import outside
from ..blender import cloud_of
from .attributes import CAPTURE


def capture_of(target: bpy.types.Object) -> str:
    """The capture that a model is of: its data set's folder, else the model's file. As its import found it:
    panels ask at every redraw, and nothing is read."""
    return str(cloud_of(target).get(CAPTURE, ""))


def capture_of_file(path: Path) -> str:
    """The capture of a model file: the data set of the run in whose folder it lies, else the file."""
    return key_of(str(data_of_run(path.parent) or path))


def data_of(target: bpy.types.Object) -> Path | None:
    """The folder of a model's data set; None where it is not known, or not there any more."""
    capture = capture_of(target)
    return Path(capture) if capture and outside.is_folder(Path(capture)) else None


def key_of(data: str) -> str:
    """A data set's folder as scenes and models remember it. Links are followed where one may look."""
    if not data:
        return ""
    return os.path.realpath(data) if outside.may_follow(data) else os.path.normpath(data)
