# SPDX-License-Identifier: GPL-3.0-or-later
"""A photographer's way in a real window: photos, data set, training, model; then its scale and ground.

The photos are of the room that the tests of ``physhdr prepare`` ray cast: nine places, three exposures each.
"""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import Window, drive
from mathutils import Vector

ROOM = Path(__file__).resolve().parents[1] / "backend" / "scene" / "capture" / "room.py"
#: Run by the trainer's Python, which has what writes JPEG with EXIF.
TAKE_PHOTOS = """
import importlib.util, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("room", sys.argv[1])
room = sys.modules["room"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(room)
room.write_brackets(Path(sys.argv[2]), room.photograph(9))
"""
#: Until the room can be seen.
ITERATIONS = 400
#: Places in the 3D view, of its width and height, where the floor is seen from the middle camera.
FLOOR = ((0.25, 0.8), (0.6, 0.8), (0.45, 0.93), (0.3, 0.9), (0.55, 0.9), (0.4, 0.82))


def test(window: Window) -> Iterator[float]:
    options = window.options
    # Short and of no machine in particular: the pictures are in the guide.
    photos = Path.home() / "holiday"
    subprocess.run([options.python, "-c", TAKE_PHOTOS, ROOM, photos], check=True)
    yield from window.open()
    session = window.module("addon.runtime").session()
    advice, choices = window.module("addon.session.advice"), window.module("addon.operators.base").choices
    settings = bpy.context.scene.physhdr
    assert session.state.backend.missing == (), session.state.backend

    bpy.ops.physhdr.photos_look(directory=str(photos))
    yield from window.until(lambda: session.state.photos.lines, 60, "looked at")
    yield from window.redrawn()
    window.screenshot("1_understood")
    assert advice.next_step(session.state, choices(bpy.context)) == "Prepare the photos"
    bpy.ops.physhdr.photos_prepare()
    yield from window.until(
        lambda: any(task.fraction > 0.3 for task in session.state.tasks), 300, "preparing"
    )
    yield from window.redrawn()
    window.screenshot("2_preparing")
    yield from window.until(lambda: settings.data, 300, "prepared")
    yield from window.until(lambda: session.state.dataset.lines, 10, "summarised")
    yield from window.redrawn()
    window.screenshot("3_ready")
    assert advice.next_step(session.state, choices(bpy.context)) == "Start the training"
    assert not advice.why_not(session.state, "start", choices(bpy.context))

    settings.iterations = ITERATIONS
    bpy.ops.physhdr.train_start()
    yield from window.until(lambda: session.state.job.state == "finished", 600, "trained")
    with window.override():
        bpy.ops.physhdr.result_import("INVOKE_DEFAULT")
    yield from window.until(lambda: bpy.context.object is not None, 60, "imported")
    target = bpy.context.object
    yield from window.drawn()
    yield from window.show_panels("model", "scale")
    window.screenshot("4_imported")
    yield from find(window, target)

    yield from set_ground(window, target)
    yield from window.shut_down()


def find(window: Window, target: bpy.types.Object) -> Iterator[float]:
    """The view is where a picture was taken; *View Selected* frames the room, *Look Through* a picture."""
    view, position = window.region.data, target.data.attributes["position"].data
    places = window.module("addon.layouts.cameras").camera_places(Path(target.data["physhdr_capture"]))
    at = np.array(view.view_matrix.inverted().translation)
    assert min(np.linalg.norm(places - at, axis=1)) < 0.05, (places, at)
    with window.override():
        bpy.ops.view3d.view_selected()
    yield from window.still()
    window.screenshot("4_view_selected")
    points = np.array([each.vector for each in position])
    room = np.linalg.norm(np.ptp(np.quantile(points, (0.02, 0.98), axis=0), axis=0))
    assert 0.3 * room < view.view_distance < 3.0 * room, (view.view_distance, room)
    with window.override():
        bpy.ops.physhdr.look_through(step=0)
    yield from window.drawn()
    assert view.view_perspective == "CAMERA"
    window.screenshot("4_looked_through")


def set_ground(window: Window, target: bpy.types.Object) -> Iterator[float]:
    """Pick three points of the floor with the mouse; then the height of the cameras sets the scale."""
    view = window.region.data
    places = window.module("addon.layouts.cameras").camera_places(Path(target.data["physhdr_capture"]))
    position = window.module("addon.model.point_cloud").read_attribute(target.data, "position")
    # From the middle one of its cameras, to the middle of what they saw.
    place = places[len(places) // 2]
    ahead = Vector(np.median(position, axis=0) - place)
    view.view_perspective = "PERSP"
    view.view_rotation = ahead.to_track_quat("-Z", "Y")
    view.view_location, view.view_distance = Vector(place) + 0.01 * ahead, 0.01 * ahead.length
    target.select_set(False)
    yield from window.drawn()
    with window.override():
        bpy.ops.physhdr.capture_floor("INVOKE_DEFAULT")
    yield from window.redrawn()
    width, height = window.region.width, window.region.height
    captures = bpy.context.scene.physhdr.captures
    for x, y in FLOOR:  # a ray may meet nothing
        before = window.grab()
        click(*window.on_screen(x * width, y * height))
        yield from window.until(lambda before=before: window.changed(before) > 0.0, 20, "clicked")
        yield from window.still()
        if len(captures):
            break
    yield from window.until(lambda: len(captures) == 1 and captures[0].has_floor, 20, "set to the floor")
    bpy.ops.physhdr.capture_height(height=1.5, sets="SCALE")
    heights = window.module("addon.operators.capture").camera_heights(bpy.context, target)
    assert abs(np.median(heights) - 1.5) < 1e-3, heights
    yield from window.drawn()
    window.screenshot("5_scale_and_ground")


def click(column: int, row: int) -> None:
    """Press and release the left button there, as a hand does."""
    subprocess.run(["xdotool", "mousemove", str(column), str(row), "sleep", "0.2", "click", "1"], check=True)


if __name__ == "__main__":
    drive(test)
