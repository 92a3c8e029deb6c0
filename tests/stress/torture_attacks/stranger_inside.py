#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside Blender: makes a stranger's .blend, which names everything that can be named, and lives with it.

    stranger_inside.py make FILE.blend ELSEWHERE    names places in the folder ELSEWHERE, and in a network
    stranger_inside.py open FILE.blend ELSEWHERE    opens it, and lets Blender do all that it does by itself

The second prints a line for each look at such a place, and for each process that is started, and then LIVED.
"""

import inspect
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np

import physhdr
from physhdr.addon import runtime
from physhdr.addon.blender import path_properties
from physhdr.addon.dataset import dataset_dialog
from physhdr.addon.light.probes import mark
from physhdr.addon.model.attributes import CAPTURE, FILE
from physhdr.addon.model.model_import import import_model
from physhdr.addon.session.state import Backend, Link
from physhdr.addon.settings import respelling
from physhdr.bridge.messages import JobStatus
from physhdr.bridge.model_file import Model, write_model
from physhdr.bridge.probe import Probe

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from torture_attacks.watch import BEGIN, LIVED, NETWORK, places, watched

ROOT = Path(__file__).resolve().parents[3]
# ---- the file ----------------------------------------------------------------------------------------------


def make(file: Path, elsewhere: Path) -> None:
    """A .blend whose scenes name places in a folder, in a network and beside it; one leaves its run open."""
    homes = {"Folder": f"{elsewhere}/", "Network": f"{NETWORK}\\", "Beside": f"//{elsewhere.name}/"}
    model = file.with_suffix(".safetensors")
    write_model(model, a_model())
    first = list(bpy.data.scenes)
    for name, home in (homes | {"Proposed": homes["Folder"]}).items():
        scene: Any = bpy.data.scenes.new(name)
        bpy.context.window.scene = scene
        name_everything(scene, home, model)
        if name == "Proposed":
            with respelling():
                scene.physhdr.out = ""
    bpy.data.batch_remove(first)
    bpy.ops.wm.save_as_mainfile(filepath=str(file))


def a_model() -> Model:
    """Twenty Gaussians in a row."""
    count = 20
    position = np.zeros((count, 3), np.float32)
    position[:, 0] = np.arange(count)
    return Model(
        position=position,
        rotation=np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1)),
        scale=np.full((count, 3), 0.1, np.float32),
        opacity=np.full(count, 0.5, np.float32),
        log_radiance_sh=np.zeros((count, 4, 3), np.float32),
        light_share=np.full((count, 1, 3), 0.5, np.float32),
    )


def name_everything(scene: Any, home: str, model: Path) -> None:
    """Let a scene name what lies in ``home``, a text: data set, run, photos, captures, pictures.

    It holds copies of ``model``, a file.
    """
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    with respelling():  # as a file has it: nobody has chosen it
        for group in (scene.physhdr, scene.physhdr_dataset):
            for name in path_properties(group):
                setattr(group, name, f"{home}{name}")
    scene.physhdr.preview, scene.physhdr_dataset.response = True, "file"
    known = Probe((0.0, 0.0, 0.0), 64, (), 0.1, 0.1, 0, 1, "Blender", f"{home}model.safetensors")
    for name in ("whole", "damaged"):
        target = import_model(model, name, scene.collection)
        cloud: Any = target.data
        cloud[FILE], cloud[CAPTURE] = f"{home}run/model.safetensors", f"{home}capture"
        if name == "damaged":
            del cloud[CAPTURE]
        probe = bpy.data.objects.new(f"{name} probe", None)
        scene.collection.objects.link(probe)
        mark(probe, target, f"{home}probe", known)
    scene.physhdr.captures.add().name = scene.physhdr_originals.datasets.add().name = f"{home}capture"
    picture = bpy.data.images.new(f"{scene.name} picture", 4, 4)
    picture.source, picture.filepath, picture.use_fake_user = "FILE", f"{home}picture.exr", True


# ---- the life of a Blender ---------------------------------------------------------------------------------


class Anything:
    """A layout that takes whatever is drawn, and gives a head and a body where it is asked for those."""

    def __getattr__(self, name: str) -> Any:
        return self

    def __call__(self, *_: object, **__: object) -> Any:
        return self

    def __iter__(self) -> Iterator[Any]:
        return iter((self, self))

    def __setattr__(self, name: str, value: object) -> None: ...


def live(file: Path) -> None:
    """All that happens without a click: the file is opened, saved elsewhere and reverted, and its scenes are
    appended to another one; and each time time passes."""
    bpy.ops.wm.open_mainfile(filepath=str(file))
    pass_time()
    (file.parent / "copy").mkdir(exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(file.parent / "copy" / file.name))
    bpy.ops.wm.revert_mainfile()
    pass_time()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    append_scenes(file, link=False)
    pass_time()


def append_scenes(file: Path, *, link: bool) -> None:
    """Append all scenes of a file, or link them."""
    loading: Any = bpy.data.libraries.load(str(file), link=link)
    with loading as (there, here):
        here.scenes = list(there.scenes)


def pass_time() -> None:
    """In each scene: timers, another frame, undo, panels, buttons that ask whether they can be pressed."""
    for scene in bpy.data.scenes:
        bpy.context.window.scene = scene
        scene.frame_set(scene.frame_current + 1)
        for handler in (*bpy.app.handlers.undo_post, *bpy.app.handlers.redo_post):
            handler(scene)
        pretend()
        runtime._attend()  # what the timer calls
        for target in scene.objects:
            bpy.context.view_layer.objects.active = target
            bpy.context.view_layer.update()
            draw_all()


def pretend() -> None:
    """Let there be a trainer that holds a model: then there is most to do."""
    current = runtime.session()
    job = JobStatus(state="open", run="/held/run", data="/held/data", has_model=True, in_control=True)
    backend = Backend(sys.executable, {"versions": {}, "device": "cpu", "missing": []})
    current.state = replace(current.state, backend=backend, link=Link("connected"), job=job)


def draw_all() -> None:
    """Our panels and the dialog of a data set, and each operator's answer whether it can be called now."""
    window = bpy.context.window
    area = next(each for each in window.screen.areas if each.type == "VIEW_3D")
    override: Any = bpy.context.temp_override(window=window, area=area, region=area.regions[0])
    with override:
        for panel in bpy.types.Panel.__subclasses__():
            if panel.__module__.startswith("physhdr.") and getattr(panel, "poll", bool)(bpy.context):
                drawn: Any = SimpleNamespace(layout=Anything())
                for name, method in inspect.getmembers(panel, inspect.isfunction):
                    setattr(drawn, name, method.__get__(drawn))
                for name, text in inspect.getmembers(panel, lambda member: isinstance(member, str)):
                    setattr(drawn, name, text)
                panel.draw(drawn, bpy.context)
        operators: Any = getattr(bpy.ops, "physhdr")  # noqa: B009
        for name in dir(operators):
            getattr(operators, name).poll()
        layout: Any = Anything()
        dataset_dialog.draw(bpy.context, layout)


def main() -> None:
    what, file, elsewhere = sys.argv[-3], Path(sys.argv[-2]), Path(sys.argv[-1])
    physhdr.register()
    if what == "make":
        make(file, elsewhere)
        return
    os.path.exists(BEGIN)
    with watched(*places(elsewhere)) as found:
        try:
            live(file)
        finally:
            print(*found, sep="\n", flush=True)
    print(LIVED, flush=True)
    os._exit(0)  # what was started is not waited for


if __name__ == "__main__":
    main()
