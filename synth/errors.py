# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that a user can cause: each message says what was wrong and what to do next."""

from ..bridge.errors import PhysHDRError


class SynthError(PhysHDRError):
    """Base of all errors of making data; they end in one line on stderr and exit code 1."""

    #: The cause, where programs know it by another name than the class's.
    _code = ""

    @property
    def code(self) -> str:
        """The cause for programs (``--progress-json``): ``UnknownNameError`` → ``unknown-name``."""
        return self._code or super().code.replace("_", "-")


class UnknownNameError(SynthError):
    """No scene, response or rig has this name."""

    def __init__(self, kind: str, name: str, known: list[str]) -> None:
        super().__init__(f"unknown {kind} '{name}'", f"choose one of {', '.join(sorted(known))}")


class OptionError(SynthError):
    """An option's value is out of range or not understood."""


class ResponseFileError(SynthError):
    """The file of a camera response is missing or holds no rising curve."""


class OutputFolderError(SynthError):
    """The output folder cannot be written, or belongs to something else."""


class ConflictError(SynthError):
    """The output folder holds a data set made with other options, or of a scene that has changed since."""


class DamagedFileError(SynthError):
    """A file of the data set exists but is not whole."""


class NotFiniteError(DamagedFileError):
    """A picture is whole, but holds NaN or infinity."""

    _code = "damaged-file"


class SceneFileError(SynthError):
    """A .blend file is missing, damaged, or has no scene of the name asked for."""


class SceneError(SynthError):
    """The user's scene lacks what a data set needs: a camera that we can follow, or any light."""


class DeviceError(SynthError):
    """This Blender lacks what was asked for: a GPU that Cycles can use, or the denoiser."""


class RenderError(SynthError):
    """Blender did not produce the picture."""


class NotFiniteRenderError(RenderError):
    """Blender produced a picture that holds NaN or infinity."""

    _code = "render"


class AssetError(SynthError):
    """The folder of models is missing, or a model in it cannot be read."""

    _code = "assets"
