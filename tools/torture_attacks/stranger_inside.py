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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

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
from physhdr.bridge.probe import Probe

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "tests" / "fixtures" / "e7440a3" / "default" / "model.safetensors"
#: A computer that nobody has, as Windows names it.
COMPUTER = "nobodys-computer"
NETWORK = f"\\\\{COMPUTER}\\share"
#: Asked for as the file is about to be opened: who follows the system's calls begins here.
BEGIN = "/physhdr-begins"
LIVED = "LIVED"
#: What Python's audit hooks tell, and what they do not.
OPENED = ("open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename", "shutil.copyfile")
STARTED = (
    "subprocess.Popen",
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.system",
    "os.startfile",
    "os.fork",
)
ASKED = ("stat", "lstat", "access", "readlink")

_listeners: list[Callable[[str, object], None]] = []


# ---- what is seen ------------------------------------------------------------------------------------------


def _audited(event: str, arguments: tuple[Any, ...]) -> None:
    if _listeners and event in OPENED + STARTED:
        _listeners[-1](event, arguments[0] if arguments else "")


@contextmanager
def watched(*places: str) -> Iterator[list[str]]:
    """Within it, each look at a path with one of ``places`` in it is listed, and each start of a process."""
    found: list[str] = []

    def tell(what: str, path: object) -> None:
        named = os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else str(path)
        if what in STARTED or any(place in named for place in places):
            found.append(f"{what} {named}")

    def telling(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def told(path: Any, *arguments: Any, **more: Any) -> Any:
            tell(f"os.{name}", path)
            return call(path, *arguments, **more)

        return told

    if not hasattr(sys, "physhdr_audited"):  # a hook stays for good
        sys.addaudithook(_audited)
        setattr(sys, "physhdr_audited", True)  # noqa: B010
    before = {name: getattr(os, name) for name in ASKED}
    _listeners.append(tell)
    try:
        for name, call in before.items():
            setattr(os, name, telling(name, call))
        yield found
    finally:
        for name, call in before.items():
            setattr(os, name, call)
        _listeners.remove(tell)


# ---- the file ----------------------------------------------------------------------------------------------


def places(elsewhere: Path) -> tuple[str, ...]:
    """What is in each path that the file leads to, those included that are proposed for its data sets."""
    return str(elsewhere), COMPUTER, "data_run"


def make(file: Path, elsewhere: Path) -> None:
    """A .blend whose scenes name places in a folder, in a network and beside it; one leaves its run open."""
    homes = {"Folder": f"{elsewhere}/", "Network": f"{NETWORK}\\", "Beside": f"//{elsewhere.name}/"}
    for name, home in (homes | {"Proposed": homes["Folder"]}).items():
        scene = bpy.data.scenes.new(name)
        bpy.context.window.scene = scene
        name_everything(scene, home)
    with respelling():
        scene.physhdr.out = ""
    for scene in [each for each in bpy.data.scenes if not each.physhdr.data]:
        bpy.data.scenes.remove(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(file))


def name_everything(scene: bpy.types.Scene, home: str) -> None:
    """Let a scene name what lies in ``home``, a text: data set, run, photos, models, captures, pictures."""
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    groups: tuple[Any, ...] = scene.physhdr, scene.physhdr_dataset
    with respelling():  # as a file has it: nobody has chosen it
        for group in groups:
            for name in path_properties(group):
                setattr(group, name, f"{home}{name}")
    scene.physhdr.preview, scene.physhdr_dataset.response = True, "file"
    known = Probe((0.0, 0.0, 0.0), 64, (), 0.1, 0.1, 0, 1, "Blender", f"{home}model.safetensors")
    for name in ("whole", "damaged"):
        target = import_model(MODEL, name, scene.collection)
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
    with bpy.data.libraries.load(str(file), link=False) as (there, here):
        here.scenes = list(there.scenes)
    pass_time()


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
                panel.draw(drawn, bpy.context)
        for name in dir(bpy.ops.physhdr):
            getattr(bpy.ops.physhdr, name).poll()
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
