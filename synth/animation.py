# SPDX-License-Identifier: GPL-3.0-or-later
"""The animation of settings, out of the way while they have values of ours.

Blender evaluates keyframes and drivers once more for every render: they would win over what was set.
"""

from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy

#: Where drivers point meanwhile. What even a muted driver points at, Blender carries from one evaluation to
#: the next as a float: of a seed of 31 bits the last ones were lost (measured, 5.2.3).
_NOWHERE = "physhdr_muted"


@contextmanager
def muted(owner: bpy.types.Scene | bpy.types.Object, paths: Collection[str]) -> Iterator[None]:
    """Mute what animates these RNA paths under the owner; on the way out all is as before, also on error.

    F-curves of its action and of the strips of its NLA tracks, and drivers. What was muted already stays so.
    Put the former values back within: they are evaluated anew afterwards.
    """
    found = owner.animation_data
    with ExitStack() as undo:
        for curve in _curves(found):
            if curve.data_path in paths and not curve.mute:
                undo.callback(setattr, curve, "mute", False)
                curve.mute = True
        for driver in found.drivers if found else ():
            if driver.data_path in paths:
                undo.callback(setattr, driver, "data_path", driver.data_path)
                driver.data_path = _NOWHERE
        yield


def layer_paths(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, names: Iterable[str]) -> set[str]:
    """The RNA paths under the scene of properties of a view layer, by its name and by its index."""
    index = list(scene.view_layers).index(layer)
    holders = layer.path_from_id(), f"view_layers[{index}]"
    return {f"{holder}.{name}" for name in names for holder in holders}


def _curves(animation: bpy.types.AnimData | None) -> Iterator[bpy.types.FCurve]:
    """All F-curves and drivers, those of muted NLA tracks too: to mute them harms nothing."""
    if animation is None:
        return
    yield from animation.drivers
    yield from _of_action(animation.action, animation.action_slot_handle)
    # While a strip is tweaked, its action stands in the place of the scene's own, which is kept here.
    yield from _of_action(animation.action_tweak_storage, animation.action_slot_handle_tweak_storage)
    for track in animation.nla_tracks:
        yield from _of_strips(track.strips)


def _of_strips(strips: Iterable[bpy.types.NlaStrip]) -> Iterator[bpy.types.FCurve]:
    for strip in strips:
        yield from _of_action(strip.action, strip.action_slot_handle)
        yield from _of_strips(strip.strips)  # of a meta strip


def _of_action(action: bpy.types.Action | None, slot: int) -> Iterator[bpy.types.FCurve]:
    """The F-curves of one slot: other slots of the action animate other data."""
    strip: Any  # strips of the one kind that there is have channelbags
    for layer in action.layers if action else ():
        for strip in layer.strips:
            for bag in strip.channelbags:
                if bag.slot_handle == slot:
                    yield from bag.fcurves
