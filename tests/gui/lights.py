# SPDX-License-Identifier: GPL-3.0-or-later
"""One slider a light, in a real window: of a training under way, and of the model that it gives.

The data set is the demo's with a second light named in its lit views: sliders are looked at here, and what
they do to the picture; how well lights are told apart is the benchmark's matter.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import bpy
import numpy as np
from driver import Window, drive

LIGHTS = ["ambient", "pendant"]
#: Until the model can be seen, and relit, and is imported.
ITERATIONS = 400


def test(window: Window) -> Iterator[float]:
    options = window.options
    yield from window.open()
    runtime = window.module("addon.runtime")
    session, settings = runtime.session(), bpy.context.scene.physhdr
    settings.data = str(with_two_lights(options.data, options.out / "data"))
    settings.out = str(Path.home() / "training")
    settings.iterations = ITERATIONS
    assert not settings.further_levels
    bpy.ops.physhdr.train_start()
    yield from window.until(lambda: session.state.job.has_model, 300, "begun")
    window.look_through(options.data / "transforms_test.json", 8)
    settings.preview = True
    yield from window.until(lambda: "pendant" in settings.further_levels, 10, "a slider for the pendant")
    assert list(session.state.job.lights) == LIGHTS
    yield from window.until(lambda: session.state.job.state == "finished", 600, "finished")
    yield from window.show_panels("capture", "model")
    pictures = []
    for level in (1.0, 3.0):
        settings.further_levels["pendant"].level = level
        yield from window.sharp()
        pictures.append(shown(window))
        window.screenshot(f"preview_{level:g}")
    assert pictures[1] > 1.05 * pictures[0], f"the slider changes nothing: means {pictures}"

    with window.override():
        bpy.ops.physhdr.result_import("INVOKE_DEFAULT")
    yield from window.until(lambda: bpy.context.object is not None, 60, "imported")
    nodes = window.module("addon.model.nodes")
    nodes.set_input(nodes.find_modifier(bpy.context.object), "Level of pendant", 0.5)
    yield from window.drawn()
    window.screenshot("imported")
    yield from window.shut_down()


def with_two_lights(source: Path, folder: Path) -> Path:
    """The data set ``source`` by links, but every second lit view says that its level is the pendant's."""
    folder.mkdir()
    for path in source.iterdir():
        if path.name != "transforms_lit.json":
            (folder / path.name).symlink_to(path)
    content = json.loads((source / "transforms_lit.json").read_text())
    content["lights"] = LIGHTS
    for index, frame in enumerate(content["frames"]):
        named = {LIGHTS[index % 2]: frame["lighting_level"]}
        frame |= {"lighting_level": named.get("ambient", 1.0), "lighting_levels": named}
    (folder / "transforms_lit.json").write_text(json.dumps(content))
    return folder


def shown(window: Window) -> float:
    """The mean radiance of the picture that the live preview shows."""
    overlay = window.module("addon.viewport.overlay")
    (picture,) = overlay._runtime.pictures.values()
    return float(np.mean(np.asarray(picture.rgba, np.float32)[..., :3]))


drive(test)
