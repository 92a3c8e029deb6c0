# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr.dataset_render`` through a real child process: what a script and the panel call."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.capture import originals  # noqa: E402
from physhdr.addon.dataset import (  # noqa: E402
    dataset_command,
    dataset_dialog,
    dataset_folder,
    dataset_settings,
    denoiser,
    disk_caches,
    render_time,
    time_trial,
    unsaved,
)
from physhdr.addon.operators import afterwards, dataset  # noqa: E402
from physhdr.addon.session.state import DATASET  # noqa: E402
from physhdr.addon.session.task import TaskEnded  # noqa: E402
from physhdr.bridge.blend_file import MODEL_IDENTITY  # noqa: E402
from physhdr.bridge.errors import BadValueError, OutputError  # noqa: E402
from physhdr.synth import exr, scripts  # noqa: E402
from physhdr.synth.light_choice import candidates  # noqa: E402
from physhdr.synth.light_names import LightChoice  # noqa: E402

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
def room(extension):
    """A floor, a sun, a lamp and a camera, never saved; no copy of an earlier file is left."""
    dataset._remove_copies()
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


@pytest.mark.long
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


@pytest.mark.long
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


def paint(name):
    """A picture in a material of the floor, with colours that are in memory only."""
    image = bpy.data.images.new(name, 2, 2)
    image.pixels = [1.0, 0.25, 0.0, 1.0] * 4
    material = bpy.data.materials.new(name)
    material.node_tree.nodes.new("ShaderNodeTexImage").image = image
    bpy.data.meshes["floor"].materials.append(material)
    return image


def test_painted_pictures_are_to_be_saved_first(room, tmp_path):
    """In the file, and so in its copy, they are black: the dialog says so, and the operator refuses."""
    packed, file = paint("packed"), paint("file")
    scene_values = dataset_settings.chosen(room)
    scene_values.out = str(tmp_path / "data")
    problem, _ = dataset_dialog._judged(scene_values, room)
    assert problem and "'file', 'packed'" in problem.message and "Save All Images" in problem.hint
    with pytest.raises(RuntimeError, match="'file', 'packed'"):
        bpy.ops.physhdr.dataset_render(out=str(tmp_path / "data"), **SMALL)
    assert not (tmp_path / "data").exists() and not dataset._copies().exists()
    packed.pack()
    assert unsaved.images() == [file]
    file.filepath_raw, file.file_format = str(tmp_path / "file.png"), "PNG"
    file.save()
    assert dataset_dialog._judged(scene_values, room) == (None, "A new folder")
    file.pixels[0] = 0.5
    file.update()
    assert unsaved.images() == [file]


def test_pictures_that_no_render_shows_may_stay_unsaved(room):
    image = bpy.data.images.new("sketch", 2, 2)
    image.use_fake_user, image.pixels = True, [1.0] * 16
    reference = bpy.data.objects.new("reference", None)
    reference.empty_display_type, reference.data = "IMAGE", image
    room.collection.objects.link(reference)
    room.camera.data.background_images.new().image = image
    room.tool_settings.image_paint.canvas = image
    assert image.is_dirty and unsaved.images() == []
    room.world = bpy.data.worlds.new("sky")
    room.world.node_tree.nodes.new("ShaderNodeTexEnvironment").image = image
    assert unsaved.images() == [image]


@pytest.fixture
def flag(room, tmp_path):
    """A cloth that falls, baked to the disk beside the file, and another grid; the folder of the cache."""
    room.frame_start, room.frame_end = 1, 6
    for name in ("flag", "other"):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=3, y_subdivisions=3, location=(0, 0, 2))
        bpy.context.object.name = name
    cache = bpy.data.objects["flag"].modifiers.new("cloth", "CLOTH").point_cache
    cache.frame_start, cache.frame_end = 1, 6
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    cache.use_disk_cache = True
    with bpy.context.temp_override(point_cache=cache):
        bpy.ops.ptcache.bake(bake=True)
    room.frame_set(6)
    return tmp_path / "blendcache_mine"


def height():
    """Of the flag's lowest point."""
    flag = bpy.data.objects["flag"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    return min((flag.matrix_world @ vertex.co).z for vertex in flag.data.vertices)


#: How names of files begin that are of the object "other".
OTHER = b"other".hex().upper()


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def refuse(*_):
    raise OSError("this disk has no links")


@pytest.mark.parametrize("without", [(), ("symlink",), ("symlink", "link")])
def test_caches_on_disk_come_along_and_stay(flag, monkeypatch, without):
    """The copy shows the cloth where the file does; to remove it takes nothing of the file's own cache."""
    for name in without:
        monkeypatch.setattr(disk_caches.os, name, refuse)
    fallen, baked = height(), contents(flag)
    assert fallen < 1.95 and len(baked) == 6
    with dataset._copy_of_file() as copy:
        assert contents(copy.parent / flag.name) == baked
        kinds = {(path.is_symlink(), path.lstat().st_nlink) for path in (copy.parent / flag.name).iterdir()}
        assert kinds == {(not without, 2 if without == ("symlink",) else 1)}
        bpy.ops.wm.open_mainfile(filepath=str(copy))
        bpy.context.scene.frame_set(6)
        assert height() == pytest.approx(fallen, abs=1e-6)
    dataset._remove_copies()
    assert not copy.exists() and contents(flag) == baked


def test_a_cache_that_is_not_baked_is_not_simulated_into_the_files_of_the_user(flag):
    """Another cloth, played to its sixth frame and in the copy again, of another mesh."""
    cache = bpy.data.objects["other"].modifiers.new("cloth", "CLOTH").point_cache
    cache.use_disk_cache = True
    for frame in range(1, 7):
        bpy.context.scene.frame_set(frame)
    played = contents(flag)
    assert len(played) == 12
    with dataset._copy_of_file() as copy:
        folder = copy.parent / flag.name
        assert contents(folder) == played
        bpy.ops.wm.open_mainfile(filepath=str(copy))
        bpy.data.objects["other"].data = bpy.data.meshes["floor"]
        for frame in range(1, 7):
            bpy.context.scene.frame_set(frame)
        again = contents(folder)
    assert contents(flag) == played
    assert {name for name in played if again[name] != played[name]} == {
        name for name in played if OTHER in name
    }


@pytest.mark.long
def test_of_caches_on_disk_nothing_is_told_to_be_missing(flag, tmp_path):
    small = SMALL | {"views": 2, "lit_views": 0, "relit_views": 0}
    assert bpy.ops.physhdr.dataset_render(out="//data", **small) == {"FINISHED"}
    assert "simul" not in str(read(tmp_path / "data/dataset.json")["source"]["warnings"])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"exposures": "1 two"}, "'1 two' are not understood"),
        ({"exposures": "3 1"}, "not a rising list"),
        ({"out": " "}, "no folder is chosen"),
        ({"out": "//data"}, "not saved yet"),
        ({"response": "file"}, "no file of the camera's response"),
        ({"rig": "GRID", "rig_width": 1.0}, "the grid has only one side"),
        ({"ambient_levels": "1 2"}, "'At Levels': level 1 is the test split itself; leave it out"),
        ({"lit_levels": "four"}, "'Their Levels' 'four': 'four' is not a number"),
        ({"lit_levels": ""}, "'Views Under Other Light': needs at least one of 'Their Levels'"),
        ({"lights": "sky"}, "there is no light 'sky' in this scene"),
        ({"lights": "key=collection:Nowhere"}, "unknown collection of this file 'Nowhere'"),
        ({"lights": ";"}, "no light varies"),
        pytest.param({"rig": "PATH"}, "stands still over the frames", marks=pytest.mark.long),
        pytest.param({"out": "/proc/nowhere"}, "cannot write to the output folder", marks=pytest.mark.long),
    ],
)
def test_mistakes_are_reported(room, tmp_path, change, told):
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.physhdr.dataset_render(**{"out": str(tmp_path / "data"), **SMALL, **change})
    assert not (tmp_path / "data").exists() and not dataset._copies().exists()


def test_remedies_are_in_the_dialogs_words(room, monkeypatch, tmp_path):
    """Of what is found before anything starts, and of a trial."""

    def refuse(*_):
        raise BadValueError("--views: too many", "give --rig-distance")

    monkeypatch.setattr(dataset_command.user_camera, "checked", refuse)
    chosen = dataset_settings.chosen(room)
    chosen.out = str(tmp_path / "data")
    problem, _ = dataset_dialog._judged(chosen, room)
    assert problem and (problem.message, problem.hint) == ("'Views': too many", "give 'Distance'")
    trial = time_trial.TimeTrial()
    trial._finish(TaskEnded(time_trial.TRIAL, ok=False, message="--views: too many"))
    assert trial.problem == "'Views': too many"


def test_a_scene_without_a_camera_greys_the_button(room):
    assert bpy.ops.physhdr.dataset_render.poll()
    room.camera = None
    assert not bpy.ops.physhdr.dataset_render.poll()
    with pytest.raises(RuntimeError, match="Add a camera to the scene first"):
        bpy.ops.physhdr.dataset_render(out="/tmp/x")


def test_progress_cancel_and_resume_as_a_window_does(room, extension, tmp_path):
    """Not waiting, the operator returns at once; pumping shows progress; what is rendered is kept."""
    out = tmp_path / "data"
    slow = {**SMALL, "resolution_x": 96, "samples": 16, "views": 6}
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
    assert len(list(out.rglob("hdr_*.exr"))) == 6 + 1 + 1
    extension.pump()
    assert room.physhdr.data == str(out)  # the training's next
    assert extension.state.dataset.folder == str(out) and not extension.state.dataset.problem


def test_checking_a_folder_that_is_none(extension, tmp_path):
    with pytest.raises(RuntimeError, match="is not a data set"):
        bpy.ops.physhdr.dataset_check(folder=str(tmp_path))


def test_exposures_as_people_write_them():
    assert dataset_command.parse_evs("-3, -1 1") == [-3.0, -1.0, 1.0]
    assert dataset_command.parse_evs("-3:2:5") == [-3.0, -1.0, 1.0, 3.0, 5.0]
    assert dataset_command.parse_evs("-1:0.5:3") == [-1.0, -0.5, 0.0]
    for text in ("", "1 1", "2 1", "nan", "1:2", "1:0:3", "1:1:0", "1:1:2.5", "40", "1:2000:2"):
        with pytest.raises(BadValueError, match="exposures"):
            dataset_command.parse_evs(text)


def test_a_folder_of_other_things_is_refused_before_anything_starts(room, extension, tmp_path):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters/dear.txt").write_text("…")
    (tmp_path / "file").write_text("")
    for name, told in (("letters", "holds files but no data set"), ("file", "is a file")):
        with pytest.raises(RuntimeError, match=told):
            bpy.ops.physhdr.dataset_render(out=str(tmp_path / name), wait=False, **SMALL)
        assert not extension.state.tasks
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "letters"]


class TestFolder:
    """Which folder is proposed: one that is free, where it can be written."""

    def test_beside_the_file(self, room, tmp_path):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
        assert dataset_folder.proposed() == "//kitchen_dataset"
        (tmp_path / "kitchen_dataset").mkdir()
        assert dataset_folder.proposed() == "//kitchen_dataset"  # empty
        (tmp_path / "kitchen_dataset/dataset.json").write_text("{}")
        (tmp_path / "kitchen_dataset_2").write_text("")
        assert dataset_folder.proposed() == "//kitchen_dataset_3"

    @pytest.mark.parametrize("documents", [True, False])
    def test_of_a_file_that_was_never_saved(self, room, tmp_path, monkeypatch, documents):
        monkeypatch.setenv("HOME", str(tmp_path))
        if documents:
            (tmp_path / "Documents").mkdir()
        parent = tmp_path / "Documents/PhysHDR" if documents else tmp_path / "PhysHDR"
        assert dataset_folder.proposed() == str(parent / "untitled_dataset")
        (parent / "untitled_dataset").mkdir(parents=True)
        (parent / "untitled_dataset/dataset.partial.json").write_text("{}")
        assert dataset_folder.proposed() == str(parent / "untitled_dataset_2")

    def test_what_was_typed_stays_and_what_was_proposed_follows_the_file(self, room, tmp_path, monkeypatch):
        monkeypatch.setenv("HOME", str(tmp_path))
        settings = dataset_settings.settings_of(room)
        dataset_folder.propose(settings)
        assert settings.out == str(tmp_path / "PhysHDR/untitled_dataset")
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
        settings = dataset_settings.settings_of(bpy.context.scene)
        dataset_folder.propose(settings)
        assert settings.out == "//a_dataset"
        (tmp_path / "a_dataset").mkdir()
        (tmp_path / "a_dataset/dataset.partial.json").write_text("{}")
        dataset_folder.propose(settings)
        assert settings.out == "//a_dataset"  # to go on with what was begun
        settings.out = "//typed"
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b.blend"))
        settings = dataset_settings.settings_of(bpy.context.scene)
        dataset_folder.propose(settings)
        assert settings.out == "//typed"

    @pytest.mark.long
    def test_a_script_that_names_none_gets_one(self, room, tmp_path):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"))
        assert bpy.ops.physhdr.dataset_render(**SMALL) == {"FINISHED"}
        assert (tmp_path / "kitchen_dataset/dataset.json").is_file()
        assert dataset_settings.settings_of(bpy.context.scene).out == "//kitchen_dataset"


def fill(settings, values):
    for name, value in values.items():
        setattr(settings, name, value)


@pytest.mark.long
def test_what_was_typed_is_kept_in_the_scene_and_arguments_win(room, tmp_path):
    """Also after an error, and in the file; a script's arguments are not."""
    settings = dataset_settings.settings_of(room)
    fill(settings, {**SMALL, "out": str(tmp_path / "data"), "exposures": "3 1"})
    with pytest.raises(RuntimeError, match="not a rising list"):
        bpy.ops.physhdr.dataset_render()
    assert settings.exposures == "3 1" and settings.out == str(tmp_path / "data")
    assert bpy.ops.physhdr.dataset_render(exposures="-2 2", samples=3) == {"FINISHED"}
    told = read(tmp_path / "data/dataset.json")
    assert told["evs"] == [-2.0, 2.0] and told["samples"] == 3 and told["resolution"] == [32, 16]
    assert settings.exposures == "3 1" and settings.samples == SMALL["samples"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mine.blend"))
    settings = dataset_settings.settings_of(bpy.context.scene)
    assert settings.exposures == "3 1" and settings.rig == "ORBIT" and settings.views == 4


@pytest.mark.long
def test_without_a_denoiser_nothing_starts(room, extension, tmp_path, monkeypatch):
    """As in Debian's Blender: a script is told the remedy; the dialog has it off, and says why."""
    for module in (denoiser, dataset_settings):
        monkeypatch.setattr(module, "can_denoise", lambda: False)
    with pytest.raises(RuntimeError, match="without the denoiser") as raised:
        bpy.ops.physhdr.dataset_render(out=str(tmp_path / "data"), **{**SMALL, "denoise": True})
    assert "Switch Denoise off and take more samples" in str(raised.value)
    assert not (tmp_path / "data").exists() and not extension.state.tasks
    assert dataset_settings.settings_of(room).denoise
    dataset_settings.without_denoiser(room)
    assert not dataset_settings.settings_of(room).denoise
    settings = {name: value for name, value in SMALL.items() if name != "denoise"}
    assert bpy.ops.physhdr.dataset_render(out=str(tmp_path / "data"), **settings) == {"FINISHED"}


def test_what_blender_says_of_its_denoiser_agrees_with_its_own_menu(room):
    """``Scene.cycles.denoiser`` is a menu of those that there are; asking it is slow, but it knows."""
    denoiser.can_denoise.cache_clear()
    assert denoiser.can_denoise() == ("OPENIMAGEDENOISE" in room.cycles.denoiser)


def add_lanterns(scene):
    """A collection with a lamp of its own."""
    lanterns = bpy.data.collections.new("Lanterns, old")
    scene.collection.children.link(lanterns)
    item = bpy.data.objects.new("lantern", bpy.data.lights.new("lantern", "POINT"))
    item.data.energy, item.location = 50.0, (-1, 0, 1)
    lanterns.objects.link(item)
    bpy.context.view_layer.update()
    return item


@pytest.mark.long
def test_lights_are_ticked_or_named(room, tmp_path):
    """The lit views turn both, and truth is made of each alone: by ticks, and by a script's names."""
    add_lanterns(room)
    settings = dataset_settings.settings_of(room)
    dataset_settings.look_for_lights(room, bpy.context.view_layer)
    (entry,) = settings.lights
    assert (entry.name, entry.kind, entry.light) == ("Lanterns, old", "collection", "lanterns_old")
    assert entry.words == "1 lamp" and not entry.vary and settings.vary_ambient
    entry.vary = True
    dataset_settings.look_for_lights(room, bpy.context.view_layer)
    assert settings.lights[0].vary
    chosen = dataset_settings.chosen(room)
    assert chosen.lights == ("ambient", "lanterns_old") and dataset_command.combinations(chosen) == 4
    small = {**SMALL, "lit_views": 4, "lit_levels": "0.25 4"}
    for name, lights in (("ticked", ""), ("named", "lanterns_old; ambient")):
        assert bpy.ops.physhdr.dataset_render(out=str(tmp_path / name), lights=lights, **small) == {
            "FINISHED"
        }
        told = read(tmp_path / name / "dataset.json")
        assert told["lights"] == ["ambient", "lanterns_old", "lamps"]
        assert told["lit_lights"] == read(tmp_path / name / "transforms_lit.json")["lights"]
        assert told["lit_lights"] == ["ambient", "lanterns_old"]
        assert [entry["levels"] for entry in told["relit"]][:2] == [{"ambient": 0.5}, {"lanterns_old": 0.5}]
    settings.vary_ambient = settings.lights[0].vary = False
    with pytest.raises(RuntimeError, match="Tick one of the lights"):
        bpy.ops.physhdr.dataset_render(out=str(tmp_path / "none"), **small)


def test_names_of_lights_as_scripts_write_them(room):
    add_lanterns(room)
    known = [each.choice for each in candidates(room, bpy.context.view_layer)]
    key = LightChoice("key", "group", "Key; Light".replace(";", ","))
    assert dataset_settings.parse_lights("ambient; key=group:Key, Light", known) == (
        ["ambient", "key"],
        [key],
    )
    assert dataset_settings.parse_lights("lanterns_old", known) == (["lanterns_old"], known)
    for text in ("lantern", "key=lamp:Key", "key=Key"):
        with pytest.raises(BadValueError, match="there is no light"):
            dataset_settings.parse_lights(text, known)


@pytest.mark.long
def test_models_are_left_out_and_originals_photographed_though_hidden(room, tmp_path):
    """A second data set, with the originals hidden and their model in the scene, is the first one's."""
    first, second = tmp_path / "first", tmp_path / "second"
    assert bpy.ops.physhdr.dataset_render(out=str(first), **SMALL) == {"FINISHED"}
    cloud = bpy.data.pointclouds.new("splats")
    cloud.resize(8)
    cloud[MODEL_IDENTITY] = "some model"
    cloud["physhdr_capture"] = str(first)
    model = bpy.data.objects.new("splats", cloud)
    room.collection.objects.link(model)
    assert bpy.ops.physhdr.originals_hide() == {"FINISHED"}
    assert bpy.data.objects["floor"].hide_render and not model.hide_render
    assert bpy.ops.physhdr.dataset_render(out=str(second), **SMALL) == {"FINISHED"}
    assert bpy.data.objects["floor"].hide_render and bpy.data.objects["floor"].hide_viewport
    for path in sorted(first.rglob("hdr_*.exr")):
        assert (second / path.relative_to(first)).read_bytes() == path.read_bytes()
    assert read(second / "dataset.json")["source"]["left_out"] == ["splats"]
    assert dataset._left_out(room) == ["Left out of what is photographed, trained models: splats"]


@pytest.mark.long
def test_the_time_is_told_as_the_last_data_set_went(room, extension, tmp_path):
    """Twice the samples and half as many pictures more: from the rate that was measured, by hand."""
    chosen = dataset_settings.chosen(room)
    assert render_time.estimate(chosen, room, extension.home, None) == (-1.0, render_time.UNKNOWN)
    began = time.monotonic()
    assert bpy.ops.physhdr.dataset_render(out=str(tmp_path / "data"), **SMALL) == {"FINISHED"}
    took = time.monotonic() - began
    fill(dataset_settings.settings_of(room), {**SMALL, "samples": 4, "views": 7})
    chosen = dataset_settings.chosen(room)
    seconds, by = render_time.estimate(chosen, room, extension.home, None)
    assert (
        seconds == pytest.approx(2 * 9 / 6 * took, rel=0.1)
        and by == "as the last data set of this scene went"
    )
    assert render_time.estimate(chosen, room, extension.home, tmp_path / "data")[0] == pytest.approx(
        seconds * 4 / 9
    )  # 5 are there
    other = bpy.data.scenes.new("other")
    other.render.resolution_x, other.render.resolution_y = 200, 100
    again, by = render_time.estimate(chosen, other, extension.home, None)
    assert again == pytest.approx(seconds, rel=1e-6) and by == "as the last one went"
    chosen.device = "GPU"
    assert render_time.estimate(chosen, room, extension.home, None)[0] == -1.0
    (extension.home / render_time.RATES_FILE).write_text("[")
    chosen.device = "CPU"
    assert render_time.estimate(chosen, other, extension.home, None)[0] == -1.0


def test_about_how_long():
    told = {3.0: "10 s", 44.0: "40 s", 100.0: "2 min", 3000.0: "50 min", 5400.0: "1.5 h", 90000.0: "25 h"}
    assert {seconds: dataset_dialog.about(seconds) for seconds in told} == told


@pytest.mark.long
def test_the_time_is_tried(room, extension, tmp_path):
    """Two pictures with a quarter of the samples: the estimate is of the order of what it then takes."""
    values = {**SMALL, "resolution_x": 96, "samples": 64, "views": 3, "lit_views": 0}
    fill(dataset_settings.settings_of(room), {**values, "out": str(tmp_path / "data")})
    assert bpy.ops.physhdr.dataset_time() == {"FINISHED"}
    settings = dataset_settings.settings_of(room)
    assert settings.rate > 0.0 and settings.rate_by == "as two pictures went that were tried"
    assert not dataset._copies().exists() and not (tmp_path / "data").exists()
    chosen = dataset_settings.chosen(room)
    seconds, _ = render_time.estimate(chosen, room, extension.home, None)
    assert "4 pictures to render: about" in dataset_dialog.time_in_words(chosen, room)
    began = time.monotonic()
    assert bpy.ops.physhdr.dataset_render() == {"FINISHED"}
    took = time.monotonic() - began  # which has a start, and other programs beside it
    assert 0.05 * took < seconds < 2.0 * took
    assert settings.rate_by == "as the last data set of this scene went"


def test_a_trial_that_fails_says_why(room, extension):
    bpy.data.lights["sun"].energy = bpy.data.lights["lamp"].energy = 0.0
    with pytest.raises(RuntimeError, match="has no light"):
        bpy.ops.physhdr.dataset_time()
    assert dataset_settings.settings_of(room).rate == 0.0 and not dataset._copies().exists()


def test_a_trial_is_the_files_that_it_was_begun_in(room, extension, tmp_path):
    fill(dataset_settings.settings_of(room), {**SMALL, "out": str(tmp_path / "data")})
    assert bpy.ops.physhdr.dataset_time(wait=False) == {"FINISHED"}
    assert time_trial.trial().is_running and not bpy.ops.physhdr.dataset_time.poll()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not time_trial.trial().is_running and not time_trial.in_words()


#: What a text of the file gives its drivers, once it may run; then a lamp shines, and else it is dark.
SCRIPT = "import bpy\nbpy.app.driver_namespace['brightness'] = lambda: 3000.0\n"


@pytest.fixture
def scripted(room, tmp_path):
    """A file whose lamp is steered by its own Python, to be opened with or without leave for that."""
    text = bpy.data.texts.new("register.py")
    text.from_string(SCRIPT)
    text.use_module = True
    bpy.data.lights["lamp"].driver_add("energy").driver.expression = "brightness()"
    path = tmp_path / "scripted.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.app.driver_namespace.pop("brightness", None)
    yield lambda allowed: bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=allowed)
    bpy.app.driver_namespace.pop("brightness", None)


@pytest.mark.long
def test_the_files_python_runs_there_if_it_may_run_here(scripted, tmp_path):
    """What the drivers steer is in the pictures as it is in the window from which they were asked for."""
    light = {}
    for allowed in (True, False):
        scripted(allowed)
        bpy.context.view_layer.update()
        assert scripts.may_run() is allowed
        assert bpy.data.lights["lamp"].energy == (3000.0 if allowed else 0.0)
        out = tmp_path / f"allowed_{allowed}"
        small = SMALL | {"views": 2, "lit_views": 0, "relit_views": 0}
        assert bpy.ops.physhdr.dataset_render(out=str(out), **small) == {"FINISHED"}
        passes, _ = exr.read_channels(out / "passes/train_000.exr")
        light[allowed] = sum(float(plane.mean()) for name, plane in passes.items() if "lamps" in name)
        bpy.app.driver_namespace.pop("brightness", None)
    assert light[True] > 1.0 and light[False] == 0.0


def test_whether_python_may_run_is_asked_without_a_trace(scripted):
    """Neither what the preferences say nor that nothing was refused yet is a permission for this file."""
    before = {name: len(getattr(bpy.data, name)) for name in ("scenes", "objects", "actions")}
    for allowed in (False, True):
        scripted(allowed)
        scene, names = bpy.context.scene, set(bpy.app.driver_namespace)
        assert scripts.may_run() is allowed and bpy.context.scene == scene and not bpy.data.is_dirty
        assert bpy.app.autoexec_fail is not allowed
        assert set(bpy.app.driver_namespace) == names
        assert {name: len(getattr(bpy.data, name)) for name in before} == before


@pytest.mark.parametrize("allowed", [False, True])
@pytest.mark.parametrize("expression", ["", "frame + 2"])
def test_a_file_without_python_provokes_no_warning(room, tmp_path, expression, allowed):
    """Blender evaluates simple expressions itself: there is nothing to allow, and nothing to warn of."""
    if expression:
        bpy.data.lights["lamp"].driver_add("energy").driver.expression = expression
    path = tmp_path / "plain.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=allowed)
    assert scripts.switch() == "-Y" and not bpy.app.autoexec_fail


@pytest.mark.parametrize("allowed", [False, True])
def test_python_that_nothing_has_evaluated_yet_is_asked_for(room, tmp_path, allowed):
    """A driver of a material that no view shows: Blender has neither run nor refused it."""
    material = bpy.data.materials.new("unseen")
    material.use_fake_user = True
    roughness = material.node_tree.nodes["Principled BSDF"].inputs["Roughness"]
    roughness.driver_add("default_value").driver.expression = "rough()"
    path = tmp_path / "unseen.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=allowed)
    assert not bpy.app.autoexec_fail
    assert scripts.may_run() is allowed
    # What Blender's warning names is the file's own Python.
    assert ("rough()" in bpy.app.autoexec_fail_message) is bpy.app.autoexec_fail is not allowed


def test_blender_is_told_in_words_what_it_may_run(scripted):
    """Never left to the preferences: the copy lies where they may allow what they exclude at its place."""
    copy = Path("copy.blend")
    for allowed, switch in ((True, "-y"), (False, "-Y")):
        scripted(allowed)
        assert dataset._blender(copy, "blender")[:4] == ["blender", "-b", switch, "copy.blend"]


def remembered(scene):
    """What the scene's one data set shows, as the scene remembers it."""
    (entry,) = originals.originals_of(scene).datasets
    return {each.target.name for each in entry.objects}


@pytest.mark.long
def test_a_rendering_that_is_refused_leaves_what_the_data_set_shows(room, tmp_path):
    """A robot that came into the scene since is no original of the data set that is there."""
    small = {**SMALL, "out": str(tmp_path / "data"), "views": 2, "lit_views": 0, "relit_views": 0}
    assert bpy.ops.physhdr.dataset_render(**small) == {"FINISHED"}
    shown = {"floor", "sun", "lamp"}
    assert remembered(room) == shown
    room.collection.objects.link(bpy.data.objects.new("robot", bpy.data.meshes["floor"]))
    with pytest.raises(RuntimeError, match="have changed since: choose another folder, or delete"):
        bpy.ops.physhdr.dataset_render(**small)
    assert remembered(room) == shown


def test_a_data_set_is_chosen_though_an_operator_never_ends(room, extension, tmp_path, monkeypatch):
    """Such as one that shows the keys that are pressed; dragging is waited for."""
    timers, pushed = [], []
    monkeypatch.setattr(dataset.bpy.app.timers, "register", lambda look, **given: timers.append(look), False)
    monkeypatch.setattr(afterwards, "in_the_middle", lambda: True)
    monkeypatch.setattr(afterwards, "push_undo", pushed.append)
    done = TaskEnded(DATASET, ok=True, result={"folder": str(tmp_path)})
    monkeypatch.setattr(extension, "ended", lambda name: done)
    started = render_time.begun(dataset_settings.chosen(room), room, tmp_path, room.objects)
    dataset._choose_when_done(room.session_uid, started)
    room.collection.objects.link(bpy.data.objects.new("robot", bpy.data.meshes.new("robot")))
    bpy.data.objects.remove(bpy.data.objects["lamp"])
    bpy.data.objects["sun"].name = "moon"
    [look] = timers
    assert look() == afterwards.LOOK_SECONDS and not room.physhdr.data
    now = time.monotonic()
    monkeypatch.setattr(afterwards.time, "monotonic", lambda: now + afterwards.MODAL_SECONDS + 1.0)
    assert look() is None and room.physhdr.data == str(tmp_path) and not pushed
    assert remembered(room) == {"floor", "moon", "camera"}


@pytest.mark.long
def test_what_failed_or_was_cancelled_is_not_chosen_though_the_folder_holds_an_older_one(
    room, extension, tmp_path, monkeypatch
):
    out = tmp_path / "data"
    small = {**SMALL, "views": 2, "lit_views": 0, "relit_views": 0}
    assert bpy.ops.physhdr.dataset_render(out=str(out), **small) == {"FINISHED"}
    timers, pushed = [], []
    monkeypatch.setattr(dataset.bpy.app.timers, "register", lambda look, **given: timers.append(look), False)
    for given, cancel in (({"seed": 5}, False), ({}, True)):
        room.physhdr.data = ""
        assert bpy.ops.physhdr.dataset_render(out=str(out), wait=False, **(small | given)) == {"FINISHED"}
        monkeypatch.setattr(afterwards, "push_undo", pushed.append)
        if cancel:
            bpy.ops.physhdr.task_cancel(name=DATASET)
        assert extension.wait(lambda state: state.task(DATASET) is None, 60.0)
        assert timers.pop()() is None
        assert room.physhdr.data == "" and not pushed and (out / "dataset.json").is_file()
        with pytest.raises(RuntimeError, match="made with other options: seed is 0 there"):
            bpy.ops.physhdr.dataset_render(out=str(out), **(small | {"seed": 5}))
        assert room.physhdr.data == ""
    assert not timers and bpy.ops.physhdr.dataset_render(out=str(out), **small) == {"FINISHED"}
    assert room.physhdr.data == str(out)


def test_a_folder_that_nobody_may_look_into_is_refused_in_words(extension, tmp_path, monkeypatch):
    def refuse(folder):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(dataset_folder.os, "listdir", refuse)
    with pytest.raises(OutputError, match="cannot be opened: Permission denied"):
        dataset_folder.check(tmp_path)


def test_a_path_that_the_system_refuses_is_told_in_words(room, tmp_path):
    """In the dialog, which is drawn as it is typed, and by both operators."""
    long = str(tmp_path / ("x" * 300))
    told = "cannot be opened: File name too long"
    dataset_settings.settings_of(room).out = long
    problem, _ = dataset_dialog._judged(dataset_settings.chosen(room), room)
    assert isinstance(problem, OutputError) and told in problem.message
    with pytest.raises(OutputError, match=told):
        dataset_folder.check(Path(long))
    for asked in (
        lambda: bpy.ops.physhdr.dataset_render(out=long, **SMALL),
        lambda: bpy.ops.physhdr.dataset_check(folder=long),
    ):
        with pytest.raises(RuntimeError, match=told) as error:
            asked()
        assert "Traceback" not in str(error.value)
