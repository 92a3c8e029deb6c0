# SPDX-License-Identifier: GPL-3.0-or-later
"""The light switch in a real window: photos of a room under three lights, sliders, rendered pictures.

The photos are of the room that the tests of ``physhdr prepare`` ray cast: nine places as usual, then six of
them without the pendant, and six when a fifth of the daylight comes in. (As *evening*, its level could only
be estimated: no surface here is lit by daylight alone.)
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import Window, drive

ROOM = Path(__file__).resolve().parents[1] / "backend" / "scene" / "capture" / "room.py"
#: Run by the trainer's Python, which has what writes JPEG with EXIF; prints the means of both lights.
TAKE_PHOTOS = """
import importlib.util, json, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("room", sys.argv[1])
room = sys.modules["room"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(room)
folder, rays, means = Path(sys.argv[2]), room.rays_of_lens(), []
for place, pose in enumerate(room.arc(9)):
    daylight, pendant = room.pictures(pose, rays, room.WIDTH, room.HEIGHT, (room.LAMP, room.PENDANT))
    room.write_bracket(folder / "standard", place, daylight + pendant)
    if place in (1, 2, 4, 5, 6, 7):
        room.write_bracket(folder / "pendant off", place, daylight)
        room.write_bracket(folder / "daylight 0.2x", place, 0.2 * daylight + pendant)
    means.append([float(daylight.mean()), float(pendant.mean())])
print(json.dumps(means))
"""
LIGHTS = ["ambient", "daylight", "pendant"]
#: Until the lights are told apart.
ITERATIONS = 600
#: By how much a rendered picture may differ from the share of its light, which varies by place, too.
TOLERANCE = 0.1
#: What may be left with both lights off, of the standard light: so short a training leaves an eighth of it to
#: *ambient*, of which the room has none.
AMBIENT = 0.2


def test(window: Window) -> Iterator[float]:
    options = window.options
    # Short and of no machine in particular: the pictures are in the guide.
    photos = Path.home() / "kitchen"
    taking = [options.python, "-c", TAKE_PHOTOS, ROOM, photos]
    means = np.array(json.loads(subprocess.run(taking, check=True, capture_output=True, text=True).stdout))
    yield from window.open()
    session, settings = window.session, bpy.context.scene.physhdr

    bpy.ops.physhdr.photos_look(directory=str(photos / "standard"))
    yield from window.until(lambda: session.state.photos.lines, 60, "looked at")
    yield from window.redrawn()
    window.screenshot("1_understood")
    lines = " ".join(session.state.photos.lines)
    assert "pendant off: 6 places" in lines and "daylight 0.2" in lines, lines
    bpy.ops.physhdr.photos_prepare()
    yield from window.until(lambda: settings.data, 600, "prepared")
    yield from window.until(lambda: session.state.dataset.lines, 10, "summarised")
    yield from window.redrawn()
    window.screenshot("1_ready")
    lines = " ".join(session.state.dataset.lines)
    assert "pendant can be turned afterwards: off from 6 views" in lines, lines

    settings.iterations = ITERATIONS
    bpy.ops.physhdr.train_start()
    yield from window.until(lambda: session.state.job.has_model, 300, "begun")
    yield from window.until(lambda: "daylight" in settings.further_levels, 10, "sliders of the lights")
    assert list(session.state.job.lights) == LIGHTS
    yield from window.until(lambda: session.state.job.state == "finished", 900, "finished")
    with window.override():
        bpy.ops.physhdr.result_import("INVOKE_DEFAULT")
    yield from window.until(lambda: bpy.context.object is not None, 60, "imported")
    with window.override():
        bpy.ops.physhdr.look_through(step=0)
    bpy.ops.physhdr.render_setup(use_size=True)
    yield from render_each(window, means)
    yield from window.shut_down()


def render_each(window: Window, means: np.ndarray) -> Iterator[float]:
    """F12 under both lights and without each: what is gone is that light's share, and they add up."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 4
    scene.render.resolution_percentage = 25
    yield from window.show_panels("model")
    seen = {}
    for name in ("standard", "pendant", "daylight"):
        if name != "standard":
            set_level(window, name, 0.0)
        yield from window.drawn()
        window.screenshot(f"2_{name}")
        seen[name] = rendered(window.options.out / f"3_{name}")
        if name != "standard":
            set_level(window, name, 1.0)
    shares = means / means.sum(axis=1, keepdims=True)
    for column, name in ((1, "pendant"), (0, "daylight")):
        gone = 1.0 - seen[name] / seen["standard"]
        least, most = shares[:, column].min() - TOLERANCE, shares[:, column].max() + TOLERANCE
        assert least < gone < most, (name, gone, shares)
    both = seen["pendant"] + seen["daylight"]
    assert -0.02 < both / seen["standard"] - 1.0 < AMBIENT, seen


def set_level(window: Window, light: str, level: float) -> None:
    nodes = window.module("addon.model.nodes")
    nodes.set_input(nodes.find_modifier(bpy.context.object), f"Level of {light}", level)
    bpy.context.object.update_tag()


def rendered(path: Path) -> float:
    """Mean radiance of the picture that F12 gives; ``path``.png shows it, ``path``.exr holds it."""
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(path.with_suffix(".exr"))
    bpy.ops.render.render(write_still=True)
    scene.render.image_settings.file_format = "PNG"
    bpy.data.images["Render Result"].save_render(str(path.with_suffix(".png")))
    picture = bpy.data.images.load(str(path.with_suffix(".exr")))
    mean = float(np.asarray(picture.pixels[:]).reshape(-1, 4)[:, :3].mean())
    bpy.data.images.remove(picture)
    return mean


drive(test)
