# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects that a data set was photographed from: remembered in the scene, and hidden where its model is
to be seen alone. What is pointed to keeps its identity through renaming, saving and undo, and a new object of
an old one's name is another.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...synth.in_render import in_layer
from ...synth.objects import SURFACES
from .. import outside
from ..blender import curve_of
from ..model.look import is_model, models_among
from ..model.origin import capture_of, key_of
from .placement import settings_of

#: The property of a scene that holds its ``PHYSHDR_Originals``.
ORIGINALS = "physhdr_originals"
LIGHT = "LIGHT"
#: How objects of other files were before this session hid them, by ``_key``.
_linked: dict[tuple[str, str], tuple[bool, bool]] = {}
#: The properties of an object that hide it.
SWITCHES = ("hide_viewport", "hide_render")


class PHYSHDR_Original(bpy.types.PropertyGroup):
    """An object that was photographed; of one that is hidden, how it was before."""

    target: bpy.props.PointerProperty(type=bpy.types.Object)
    was_hidden_in_viewports: bpy.props.BoolProperty()
    was_hidden_in_renders: bpy.props.BoolProperty()


class PHYSHDR_Photographed(bpy.types.PropertyGroup):
    """A data set of this scene (``name`` is its folder), and what it shows."""

    objects: bpy.props.CollectionProperty(type=PHYSHDR_Original)


class PHYSHDR_Originals(bpy.types.PropertyGroup):
    """What a scene remembers of its data sets."""

    datasets: bpy.props.CollectionProperty(type=PHYSHDR_Photographed)
    #: Those that are hidden now.
    hidden: bpy.props.CollectionProperty(type=PHYSHDR_Original)


def originals_of(scene: bpy.types.Scene) -> PHYSHDR_Originals:
    """A scene's own."""
    return getattr(scene, ORIGINALS)


def photographed(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
    """What renders of a layer show or are lit by now: surfaces, lights and instances; no model, no camera."""
    return [
        item
        for item in dict.fromkeys(in_layer(layer.layer_collection))
        if not is_model(item)
        and (item.type in SURFACES or item.type == LIGHT or item.instance_type != "NONE")
    ]


def remember(scene: bpy.types.Scene, items: Iterable[bpy.types.Object], out: Path) -> None:
    """The data set in ``out`` is photographed from these."""
    datasets, name = originals_of(scene).datasets, key_of(str(out))
    entry = datasets.get(name) or datasets.add()
    entry.name = name
    entry.objects.clear()
    for item in items:
        entry.objects.add().target = item


def is_remembered(scene: bpy.types.Scene, out: Path) -> bool:
    """Whether it is known what the data set in ``out`` is photographed from."""
    return key_of(str(out)) in originals_of(scene).datasets


def of_models(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The originals of what is shown of trained models: imported ones, and the live preview's.

    Where neither is of a data set of this scene, those of its data set chosen in the panel; each once.
    """
    datasets = originals_of(scene).datasets
    shown = {capture_of(item) for item in models_among(scene.objects)}
    settings = settings_of(scene)
    chosen = key_of(outside.chosen(settings.data))
    if settings.preview or not any(entry.name in shown for entry in datasets):
        shown.add(chosen)
    found: dict[bpy.types.Object, None] = {}
    for entry in datasets:
        if entry.name in shown:
            found.update(dict.fromkeys(each.target for each in entry.objects))
    inside = set(scene.objects)
    return [item for item in found if item is not None and item in inside and not is_model(item)]


def are_hidden(scene: bpy.types.Scene) -> bool:
    return len(originals_of(scene).hidden) > 0


def is_offered(scene: bpy.types.Scene) -> bool:
    """Whether the panel offers to hide the originals: there are some, and a model of them is shown."""
    datasets = originals_of(scene).datasets
    if are_hidden(scene):
        return True
    if not len(datasets):
        return False
    settings = settings_of(scene)
    if settings.preview and key_of(outside.chosen(settings.data)) in datasets:
        return True
    return any(capture_of(item) in datasets for item in models_among(scene.objects))


def hide(scene: bpy.types.Scene, lights: bool = True) -> int:
    """Hide the originals, in views and renders; returns how many.

    ``lights``: lights among them, too; what glows is hidden in any case.
    """
    for item in of_models(scene):
        if item.type == LIGHT and not lights:
            continue
        before = item.hide_viewport, item.hide_render
        if item.library is not None:
            before = _linked.setdefault(_key(item), before)
        _remember_hidden(scene, item, before)
        _set(item, True, True)
    return len(originals_of(scene).hidden)


def show(scene: bpy.types.Scene) -> int:
    """Show what ``hide`` hid: each object as it was before; returns how many."""
    hidden = originals_of(scene).hidden
    count = 0
    for entry in hidden:
        if entry.target is not None:
            _set(entry.target, entry.was_hidden_in_viewports, entry.was_hidden_in_renders)
            count += 1
    hidden.clear()
    return count


def shown_by_animation(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Those that were hidden and whose own keyframes or drivers say anew in each frame whether they are."""
    targets = (entry.target for entry in originals_of(scene).hidden if entry.target is not None)
    return [each for each in targets if any(_is_animated(each, path) for path in SWITCHES)]


def _is_animated(item: bpy.types.Object, path: str) -> bool:
    curve = curve_of(item, path)
    return curve is not None and not curve.mute


@contextmanager
def shown(scene: bpy.types.Scene) -> Iterator[None]:
    """The originals as they are photographed, for as long as a copy of the file is written.

    The copy tells of nothing hidden: the extension that opens it would hide other files' objects again.
    """
    hidden = originals_of(scene).hidden
    former = [
        (
            each.target,
            (each.was_hidden_in_viewports, each.was_hidden_in_renders),
            (each.target.hide_viewport, each.target.hide_render),
        )
        for each in hidden
        if each.target is not None
    ]
    try:
        hidden.clear()
        for item, before, _ in former:
            _set(item, *before)
        yield
    finally:
        for item, before, now in former:
            _remember_hidden(scene, item, before)
            _set(item, *now)


def _remember_hidden(scene: bpy.types.Scene, item: bpy.types.Object, before: tuple[bool, bool]) -> None:
    entry = originals_of(scene).hidden.add()
    entry.target = item
    entry.was_hidden_in_viewports, entry.was_hidden_in_renders = before


def _set(item: bpy.types.Object, in_viewports: bool, in_renders: bool) -> None:
    item.hide_viewport, item.hide_render = in_viewports, in_renders


def _key(item: bpy.types.Object) -> tuple[str, str]:
    """What a linked object is known by: undo makes another Python object of it."""
    assert item.library is not None
    return item.library.filepath, item.name


def _hidden_linked() -> dict[tuple[str, str], bpy.types.Object]:
    """The objects of other files that some scene of this one hides."""
    targets = (entry.target for scene in bpy.data.scenes for entry in originals_of(scene).hidden)
    return {_key(each): each for each in targets if each is not None and each.library is not None}


@persistent
def _hide_linked_again(*_: object) -> None:
    """Objects of other files come from there as they are there."""
    _linked.clear()
    for key, item in _hidden_linked().items():
        _linked[key] = item.hide_viewport, item.hide_render
        _set(item, True, True)


@persistent
def _follow_undo(*_: object) -> None:
    """Objects of other files are not part of Blender's undo, what this scene remembers of them is."""
    if not _linked:
        return
    hidden = _hidden_linked()
    for item in bpy.data.objects:
        if item.library is not None and (before := _linked.get(_key(item))) is not None:
            _set(item, *((True, True) if _key(item) in hidden else before))


@persistent
def _forget_deleted(*_: object) -> None:
    """What was deleted is not kept in the file for being pointed to."""
    for scene in bpy.data.scenes:
        if not scene.is_editable:
            continue
        inside = set(scene.objects)
        for entry in (*originals_of(scene).datasets, None):
            kept = originals_of(scene).hidden if entry is None else entry.objects
            for index in reversed(range(len(kept))):
                if kept[index].target not in inside:
                    kept.remove(index)


_CLASSES = (PHYSHDR_Original, PHYSHDR_Photographed, PHYSHDR_Originals)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    setattr(bpy.types.Scene, ORIGINALS, bpy.props.PointerProperty(type=PHYSHDR_Originals))
    bpy.app.handlers.save_pre.append(_forget_deleted)
    bpy.app.handlers.load_post.append(_hide_linked_again)
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.append(_follow_undo)


def unregister() -> None:
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.remove(_follow_undo)
    bpy.app.handlers.load_post.remove(_hide_linked_again)
    bpy.app.handlers.save_pre.remove(_forget_deleted)
    delattr(bpy.types.Scene, ORIGINALS)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
