# SPDX-License-Identifier: GPL-3.0-or-later
"""A .blend that commit e7440a3 saved renders today as it did then."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.model import look  # noqa: E402
from physhdr.addon.rendering import render  # noqa: E402

EARLIER = Path(__file__).parent.parent / "fixtures" / "e7440a3"


def test_it_opens_and_renders_as_it_did(scene, tmp_path):
    """The scene that addon/scripts/relight.py --blend left, and the picture that it made."""
    bpy.ops.wm.open_mainfile(filepath=str(EARLIER / "model.blend"))
    (model,) = (each for each in bpy.data.objects if look.is_model(each))
    render.render_exr(bpy.context.scene, tmp_path / "now.exr")
    now, then = (
        render.read_exr(path).astype(float) for path in (tmp_path / "now.exr", EARLIER / "model.exr")
    )
    assert then.max() > 0.1 and now.shape == then.shape
    error = np.mean((now - then) ** 2) / then.max() ** 2
    assert -10.0 * np.log10(error + 1e-12) > 40.0
    assert model.modifiers
