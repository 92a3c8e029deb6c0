# SPDX-License-Identifier: GPL-3.0-or-later
"""What renders show is shown in 3D views meanwhile, and shaped as it is there: rays meet what views show."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy

from .in_render import instanced_by, rendered

_SUBDIVIDE = {"SUBSURF", "MULTIRES"}


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


@contextmanager
def shaped(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Iterator[None]:
    """Let views have the modifiers and the subdivision of renders, too; put back on the way out.

    What belongs to a linked library, and cannot be written to, stays as it is.
    """
    layer.update()  # without it a layer that nothing has been rendered of has no collections yet
    with ExitStack() as undo:
        undo.callback(layer.update)
        _set(scene.render, "simplify_subdivision", scene.render.simplify_subdivision_render, undo)
        modifier: Any  # only some kinds have levels
        for item in rendered(scene, layer):
            for modifier in item.modifiers:
                _set(modifier, "show_viewport", modifier.show_render, undo)
                if modifier.type in _SUBDIVIDE:
                    _set(modifier, "levels", modifier.render_levels, undo)
        layer.update()
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
    _set(owner, "hide_viewport", False, undo)


def _set(owner: Any, name: str, value: Any, undo: ExitStack) -> None:
    former = getattr(owner, name)
    if former == value:
        return
    try:
        setattr(owner, name, value)
    except (AttributeError, RuntimeError):
        return
    undo.callback(setattr, owner, name, former)
