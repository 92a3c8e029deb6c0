# SPDX-License-Identifier: GPL-3.0-or-later
"""What a picture shows outside of Cycles' light groups: no light would have it, and the last one too much.

Light that is seen through a shadow catcher, and Grease Pencil, which Blender draws over what Cycles rendered.
"""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import bpy

from . import animation
from .own_objects import photographed
from .progress import Report

_CATCHES = "is_shadow_catcher"
#: The type of objects that are drawn; ``compositor.connected`` switches them off.
DRAWN = "GREASEPENCIL"


@contextmanager
def taken_in(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, report: Report) -> Iterator[None]:
    """Let shadow catchers be ordinary surfaces until the way out; report them and what is not drawn."""
    found = list(photographed(scene, layer))
    # Of a light it says that it lights catchers.
    catchers = [item for item in found if item.type != "LIGHT" and item.is_shadow_catcher]
    if catchers:
        report.warn(
            "Cycles cannot separate the lights that are seen through a shadow catcher. These objects are "
            f"rendered as ordinary surfaces (hide them in renders to leave them out): {_names(catchers)}"
        )
    if drawings := [item for item in found if item.type == DRAWN]:
        report.warn(
            "Grease Pencil is left out of what is photographed, because it belongs to no light: "
            f"{_names(drawings)}"
        )
    with ExitStack() as undo:
        for item in catchers:
            undo.enter_context(animation.muted(item, {_CATCHES}))
            undo.callback(setattr, item, _CATCHES, True)
            setattr(item, _CATCHES, False)
        yield


def _names(items: list[bpy.types.Object]) -> str:
    return ", ".join(item.name for item in items)
