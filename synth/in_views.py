# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered but hidden in 3D views is shown there meanwhile: rays meet only what views show."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy

from .in_render import instanced_by, rendered


@contextmanager
def shown(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Iterator[None]:
    """Show all that a layer renders in views, too; hidden again on the way out.

    What belongs to a linked library, and cannot be written to, stays as it is.
    """
    found, own = list(rendered(scene, layer)), set(layer.objects)
    with ExitStack() as undo:
        _show_parts(layer.layer_collection, undo)
        for item in found:
            _show(item, undo)
            if item in own and item.hide_get(view_layer=layer):
                undo.callback(item.hide_set, True, view_layer=layer)
                item.hide_set(False, view_layer=layer)
            if (collection := instanced_by(item)) is not None:
                _show_collection(collection, undo)
        yield


def _show_parts(part: bpy.types.LayerCollection, undo: ExitStack) -> None:
    """Of a layer's collections those in which anything may be rendered."""
    if part.collection.hide_render:
        return
    _show(part.collection, undo)
    if not part.exclude:
        _show(part, undo)
    for child in part.children:
        _show_parts(child, undo)


def _show_collection(collection: bpy.types.Collection, undo: ExitStack) -> None:
    if not collection.hide_render:
        _show(collection, undo)
        for child in collection.children:
            _show_collection(child, undo)


def _show(owner: Any, undo: ExitStack) -> None:
    if not owner.hide_viewport:
        return
    try:
        owner.hide_viewport = False
    except (AttributeError, RuntimeError):
        return
    undo.callback(setattr, owner, "hide_viewport", True)
