# SPDX-License-Identifier: GPL-3.0-or-later
"""Edit Mode and instances in the 3D view: a selection is seen, instances are drawn, a saved file is clean."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
from driver import Window, drive
from mathutils import Euler


def test(window: Window) -> Iterator[float]:
    options = window.options
    yield from window.open()
    bpy.ops.physhdr.model_import(filepath=str(options.model))
    target = bpy.context.object
    view = window.region.data
    view.view_perspective = "PERSP"
    view.view_location, view.view_distance = (0.2, 1.4, 0.9), 3.4
    view.view_rotation = Euler((1.3, 0.0, 0.25)).to_quaternion()
    yield from window.drawn()
    window.screenshot("object_mode")
    bpy.ops.wm.save_as_mainfile(filepath=str(options.out / "saved.blend"))
    yield from window.redrawn()
    assert not bpy.data.is_dirty and target.display_type == "BOUNDS"

    with window.override():
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.pointcloud.select_all(action="DESELECT")
    yield from window.drawn()
    window.screenshot("nothing_selected")
    width, height = window.region.width, window.region.height
    box = {"xmin": width // 4, "xmax": width // 2, "ymin": height // 4, "ymax": height // 2}
    with window.override():
        bpy.ops.view3d.select_box(**box, wait_for_input=False)
    yield from window.drawn()
    window.screenshot("box_selected")
    inside = orange(window, "box_selected", box)
    before = orange(window, "nothing_selected", box)
    assert inside > 0.6 and before < 0.3, (inside, before)
    with window.override():
        bpy.ops.object.mode_set(mode="OBJECT")

    name = target.name
    yield from applied(window, target)
    target = bpy.data.objects[name]  # an undo makes it anew

    collection = bpy.data.collections.new("Set piece")
    for owner in target.users_collection:
        owner.objects.unlink(target)
    collection.objects.link(target)
    for place in (0.0, 6.0):
        empty = bpy.data.objects.new(f"at {place:g}", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location.x, empty.scale = place, (0.5, 0.5, 0.5)
        bpy.context.scene.collection.objects.link(empty)
    view.view_distance = 14.0
    yield from window.drawn()
    window.screenshot("instances")
    assert drawn(window) == 2
    bpy.context.view_layer.objects.active = empty
    empty.select_set(True)
    with window.override():
        bpy.ops.view3d.localview()
    yield from window.drawn()
    window.screenshot("local_view")
    assert drawn(window) == 1


def applied(window: Window, target: bpy.types.Object) -> Iterator[float]:
    """Ctrl+A, Scale, by keys as a user does it: the model keeps it, says so, and all can be undone."""
    name, place = target.name, tuple(target.data.points[7].co)
    with window.override():  # steps that what follows can be undone to
        bpy.ops.ed.undo_push(message="before")
        target.scale = (1.5, 1.5, 1.5)
        bpy.ops.ed.undo_push(message="scaled")
    yield from window.point(0.5, 0.5)
    before = window.grab()
    window.key("ctrl+a")
    yield from window.closes(before)  # and the menu is there
    window.screenshot("apply_menu")
    menu = window.grab()
    window.key("s")
    yield from window.closes(menu)
    window.screenshot("applied")

    def is_whole(scale: float) -> bool:
        found = bpy.data.objects.get(name)
        if found is None:
            return False
        near = max(abs(a - b) for a, b in zip(found.data.points[7].co, place, strict=True)) < 1e-5
        return near and max(abs(each - scale) for each in found.scale) < 1e-5

    assert is_whole(1.5), (tuple(target.scale), tuple(target.data.points[7].co), place)
    window.key("Escape")  # the message goes
    yield from window.still()
    # Before Apply, before the scale; again the scale, and Apply.
    for key, scale in (("ctrl+z", 1.5), ("ctrl+z", 1.0), ("ctrl+shift+z", 1.5), ("ctrl+shift+z", 1.5)):
        window.key(key)
        yield from window.still()
        yield from window.until(lambda scale=scale: is_whole(scale), 60, f"{key}: scale {scale}")
    window.screenshot("undone_and_redone")
    bpy.data.objects[name].scale = (1.0, 1.0, 1.0)


def drawn(window: Window) -> int:
    """How many models are shown in the view now."""
    shown = window.module("addon.viewport.splats").shown_objects
    layer = bpy.context.view_layer
    return len(list(shown(layer, layer.depsgraph, window.area.spaces.active)))


def orange(window: Window, name: str, box: dict[str, int]) -> float:
    """The share of a screenshot's pixels in a box of the region that have the selection's hue."""
    height = window.region.height
    left, top = window.on_screen(box["xmin"], height - box["ymax"])
    right, bottom = window.on_screen(box["xmax"], height - box["ymin"])
    red, green, blue = window.pixels(name)[top:bottom, left:right].transpose(2, 0, 1)
    return float(((red > green + 25) & (green > blue + 15) & (blue < 0.35 * red)).mean())


drive(test)
