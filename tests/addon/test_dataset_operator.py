# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr.dataset_render`` through a real child process: what a script and the panel call."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import dataset_command  # noqa: E402
from physhdr.addon.operators import dataset  # noqa: E402
from physhdr.bridge.errors import BadValueError  # noqa: E402

SMALL = {
    "rig": "ORBIT",
    "views": 4,
    "exposures": "-2 0 2",
    "resolution_x": 32,
    "samples": 2,
    "denoise": False,
    "lit_views": 1,
    "lit_levels": "4",
    "relit_views": 1,
    "ambient_levels": "1/2",
}


@pytest.fixture
def extension(tmp_path, monkeypatch):
    """The extension, registered, with a backend folder of its own; its session."""
    import physhdr
    from physhdr.addon import runtime, settings

    bpy.ops.wm.read_factory_settings(use_empty=True)
    monkeypatch.setattr(settings, "home_folder", lambda: tmp_path / "home")
    physhdr.register()
    try:
        yield runtime.session()
    finally:
        physhdr.unregister()


@pytest.fixture
def room(extension):
    """A floor, a sun, a lamp and a camera, never saved."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 200, 100
    floor = bpy.data.meshes.new("floor")
    floor.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    for name, data, place, turn in (
        ("floor", floor, (0, 0, 0), (0, 0, 0)),
        ("sun", bpy.data.lights.new("sun", "SUN"), (0, 0, 3), (0.5, 0, 0)),
        ("lamp", bpy.data.lights.new("lamp", "POINT"), (1, 0, 1), (0, 0, 0)),
        ("camera", bpy.data.cameras.new("camera"), (0, -4, 2), (1.1, 0, 0)),
    ):
        item = bpy.data.objects.new(name, data)
        item.location, item.rotation_euler = place, turn
        scene.collection.objects.link(item)
    bpy.data.lights["sun"].energy, bpy.data.lights["lamp"].energy = 2.0, 30.0
    scene.camera = bpy.data.objects["camera"]
    return scene


def read(path: Path):
    return json.loads(path.read_text(encoding="utf-8"))


def test_a_data_set_of_a_file_that_was_never_saved(room, tmp_path):
    out = tmp_path / "data"
    file, dirty = bpy.data.filepath, bpy.data.is_dirty
    assert bpy.ops.physhdr.dataset_render(out=str(out), **SMALL) == {"FINISHED"}
    assert (bpy.data.filepath, bpy.data.is_dirty) == (file, dirty)
    assert not dataset._copies().exists()
    told = read(out / "dataset.json")
    assert told["scene"] == "untitled" and told["resolution"] == [32, 16] and told["samples"] == 2
    assert told["exposures"] == [0.25, 1.0, 4.0] and told["splits"] == {"train": 2, "test": 2, "lit": 1}
    assert told["lighting_levels"] == {"lit": [4.0], "relit": [0.5], "relit_views": [1]}
    assert told["source"]["camera"] == "camera"
    assert bpy.ops.physhdr.dataset_check(folder=str(out)) == {"FINISHED"}


def test_changes_that_are_not_saved_count(room, tmp_path):
    """The file on disk has the lamp at 30, memory at 3000: the pictures are bright."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    room = bpy.context.scene
    on_disk = (tmp_path / "mine.blend").read_bytes()
    assert bpy.ops.physhdr.dataset_render(out="//saved", **SMALL) == {"FINISHED"}
    bpy.data.lights["lamp"].energy = 3000.0
    assert bpy.ops.physhdr.dataset_render(out="//changed", **SMALL) == {"FINISHED"}
    bright, dark = (
        read(tmp_path / name / "dataset.json")["dynamic_range"]["maximum"] for name in ("changed", "saved")
    )
    assert bright > 20 * dark
    assert bpy.data.filepath == str(tmp_path / "mine.blend") and room == bpy.context.scene
    assert (tmp_path / "mine.blend").read_bytes() == on_disk
    assert read(tmp_path / "saved/dataset.json")["scene"] == "mine"


def test_textures_beside_the_file_are_found(room, tmp_path):
    """A relative path stays right although the copy lies elsewhere."""
    image = bpy.data.images.new("paint", 4, 4, float_buffer=False)
    image.filepath_raw, image.file_format = str(tmp_path / "paint.png"), "PNG"
    image.save()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    image = bpy.data.images["paint"]
    image.filepath = "//paint.png"
    material = bpy.data.materials.new("painted")
    material.node_tree.nodes.new("ShaderNodeTexImage").image = image
    bpy.data.meshes["floor"].materials.append(material)
    assert bpy.ops.physhdr.dataset_render(out="//with", **SMALL) == {"FINISHED"}
    assert read(tmp_path / "with/dataset.json")["source"]["warnings"] == []
    (tmp_path / "paint.png").unlink()
    assert bpy.ops.physhdr.dataset_render(out="//without", **SMALL) == {"FINISHED"}
    (warning,) = read(tmp_path / "without/dataset.json")["source"]["warnings"]
    assert "missing files" in warning and "paint" in warning
    assert image.filepath == "//paint.png"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"exposures": "1 two"}, "'1 two' are not understood"),
        ({"exposures": "3 1"}, "no rising list"),
        ({"out": " "}, "no folder is chosen"),
        ({"out": "//data"}, "not saved yet"),
        ({"response": "file"}, "no file of the camera's response"),
        ({"rig": "GRID", "rig_width": 1.0}, "the grid has only one side"),
        ({"ambient_levels": "1 2"}, "leave it out"),
        ({"rig": "PATH"}, "stands still over the frames"),
        ({"out": "/proc/nowhere"}, "cannot write to the output folder"),
    ],
)
def test_mistakes_are_reported(room, tmp_path, change, told):
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.dataset_render(**{"out": str(tmp_path / "data"), **SMALL, **change})
    assert not (tmp_path / "data").exists() and not dataset._copies().exists()


def test_a_scene_without_a_camera_greys_the_button(room):
    assert bpy.ops.physhdr.dataset_render.poll()
    room.camera = None
    assert not bpy.ops.physhdr.dataset_render.poll()
    with pytest.raises(RuntimeError, match="Add a camera to the scene first"):
        bpy.ops.physhdr.dataset_render(out="/tmp/x")


def test_progress_cancel_and_resume_as_a_window_does(room, extension, tmp_path):
    """Not waiting, the operator returns at once; pumping shows progress; what is rendered is kept."""
    from physhdr.addon.session.state import DATASET

    out = tmp_path / "data"
    slow = {**SMALL, "resolution_x": 128, "samples": 16, "views": 8}
    began = time.monotonic()
    assert bpy.ops.physhdr.dataset_render(out=str(out), wait=False, **slow) == {"FINISHED"}
    assert time.monotonic() - began < 2.0 and extension.state.task(DATASET)
    assert not bpy.ops.physhdr.dataset_render.poll()  # one at a time
    assert extension.wait(lambda state: state.task(DATASET).fraction > 0.15, 60.0)
    assert "rendering" in extension.state.task(DATASET).message
    bpy.ops.physhdr.task_cancel(name=DATASET)
    assert extension.wait(lambda state: state.task(DATASET) is None, 30.0)
    kept = {path: path.stat().st_mtime_ns for path in out.rglob("hdr_*.exr")}
    assert kept and not (out / "dataset.json").exists()
    assert bpy.ops.physhdr.dataset_render(out=str(out), **slow) == {"FINISHED"}
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(list(out.rglob("hdr_*.exr"))) == 8 + 1 + 1
    extension.pump()
    assert room.physhdr.data == str(out)  # the training's next
    assert extension.state.dataset.folder == str(out) and not extension.state.dataset.problem


def test_checking_a_folder_that_is_none(extension, tmp_path):
    with pytest.raises(RuntimeError, match="is no data set"):
        bpy.ops.physhdr.dataset_check(folder=str(tmp_path))


def test_exposures_as_people_write_them():
    assert dataset_command.parse_evs("-3, -1 1") == [-3.0, -1.0, 1.0]
    assert dataset_command.parse_evs("-3:2:5") == [-3.0, -1.0, 1.0, 3.0, 5.0]
    assert dataset_command.parse_evs("-1:0.5:3") == [-1.0, -0.5, 0.0]
    for text in ("", "1 1", "2 1", "nan", "1:2", "1:0:3", "1:1:0", "1:1:2.5", "40"):
        with pytest.raises(BadValueError, match="exposures"):
            dataset_command.parse_evs(text)
