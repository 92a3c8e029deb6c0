# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that draws Gaussians in the 3D viewport: bpy, gpu and numpy.

* ``camera``: the view as a pinhole in pixels; ``schedule``: when to ask the backend for which picture;
* ``overlay``: pictures (the backend's or our own) into the 3D view, scene-linear and by depth;
* ``splats``: imported Gaussians drawn here, with no backend; ``splat_data``, ``splat_renderer`` and
  ``depth_order`` do the work.
"""

from . import overlay, splats

_MODULES = (overlay, splats)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
