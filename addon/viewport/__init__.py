# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that draws Gaussians in the 3D viewport: bpy, gpu and numpy.

* ``camera``: the view as a pinhole in pixels; ``schedule``: when to ask the backend for which picture;
* ``overlay``: pictures (the backend's or our own) into the 3D view, scene-linear and by depth;
* ``splats``: imported Gaussians drawn here, with no backend; ``splat_data``, ``chunks``, ``splat_renderer``
  and ``depth_order`` do the work; ``instances`` finds those that other objects show, ``edit_points`` draws
  what is selected in Edit Mode;
* ``stand_in``: what Blender itself shows of a model where nothing here draws it.
"""

from . import overlay, splats

_MODULES = (overlay, splats)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
