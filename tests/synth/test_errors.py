# SPDX-License-Identifier: GPL-3.0-or-later
"""What programs that start make_scene.py read of an error: its code stays what it was (--progress-json)."""

import pytest

from physhdr.bridge.errors import PhysHDRError
from physhdr.synth import errors


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errors.OptionError("x"), "option"),
        (errors.UnknownNameError("scene", "x", ["y"]), "unknown-name"),
        (errors.ResponseFileError("x"), "response-file"),
        (errors.OutputFolderError("x"), "output-folder"),
        (errors.ConflictError("x"), "conflict"),
        (errors.DamagedFileError("x"), "damaged-file"),
        (errors.NotFiniteError("x"), "damaged-file"),
        (errors.SceneFileError("x"), "scene-file"),
        (errors.SceneError("x"), "scene"),
        (errors.DeviceError("x"), "device"),
        (errors.RenderError("x"), "render"),
        (errors.NotFiniteRenderError("x"), "render"),
        (errors.AssetError("x"), "assets"),
    ],
)
def test_codes(error, code):
    assert isinstance(error, PhysHDRError) and error.code == code
