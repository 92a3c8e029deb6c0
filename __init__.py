# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR: HDR, relightable 3D Gaussian splats from multi-exposure pictures, inside Blender.

This package is Blender's extension and the Python package ``physhdr`` at once. Blender calls
``register``; nothing of Blender or of torch is imported before that.
"""


def register() -> None:
    from . import addon

    addon.register()


def unregister() -> None:
    from . import addon

    addon.unregister()
