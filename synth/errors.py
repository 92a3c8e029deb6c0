# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that a user can cause: each message says what was wrong and what to do next."""

from __future__ import annotations


class SynthError(Exception):
    """Base of all errors that end in one line on stderr and exit code 1.

    ``hint`` says what to do next where ``message`` does not say it already; ``code`` names the cause for
    programs (``--progress-json``).
    """

    code = "error"

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}: {self.hint}" if self.hint else self.message


class UnknownNameError(SynthError):
    """No scene, response or rig has this name."""

    code = "unknown-name"

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        super().__init__(f"unknown {kind} '{name}'", f"choose one of {', '.join(sorted(known))}")


class OptionError(SynthError):
    """An option's value is out of range or not understood."""

    code = "option"


class ResponseFileError(SynthError):
    """The file of a camera response is missing or holds no rising curve."""

    code = "response-file"


class OutputFolderError(SynthError):
    """The output folder cannot be written, or belongs to something else."""

    code = "output-folder"


class ConflictError(SynthError):
    """The output folder holds a data set made with other options, or of a scene that has changed since."""

    code = "conflict"


class DamagedFileError(SynthError):
    """A file of the data set exists but is not whole."""

    code = "damaged-file"


class NotFiniteError(DamagedFileError):
    """A picture is whole, but holds NaN or infinity."""


class SceneFileError(SynthError):
    """A .blend file is missing, damaged, or has no scene of the name asked for."""

    code = "scene-file"


class SceneError(SynthError):
    """The user's scene lacks what a data set needs: a camera that we can follow, or any light."""

    code = "scene"


class DeviceError(SynthError):
    """This Blender lacks what was asked for: a GPU that Cycles can use, or the denoiser."""

    code = "device"


class RenderError(SynthError):
    """Blender did not produce the picture."""

    code = "render"


class NotFiniteRenderError(RenderError):
    """Blender produced a picture that holds NaN or infinity."""


class AssetError(SynthError):
    """The folder of models is missing, or a model in it cannot be read."""

    code = "assets"
