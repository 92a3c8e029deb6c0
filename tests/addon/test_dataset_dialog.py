# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialog of a data set of the open scene: what it shows at once, what is folded, and its presets."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon.dataset import dataset_dialog, dataset_presets  # noqa: E402
from physhdr.addon.dataset.dataset_settings import OPTIONS, settings_of  # noqa: E402


class Recorder:
    """A layout that keeps the names of what is drawn."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def row(self, **_):
        return self

    column = box = split = row

    def prop(self, data, name, **_):
        assert name in data.bl_rna.properties
        self.shown.append(name)

    def operator(self, name, **_):
        self.shown.append(name)

    def popover(self, panel, **_):
        assert getattr(bpy.types, panel).is_registered
        self.shown.append(panel)

    def label(self, text="", icon="NONE"):
        pass


@pytest.fixture
def scene(registered, monkeypatch, tmp_path):
    """A scene whose presets are kept in a folder of the test's own."""
    monkeypatch.setattr(bpy.utils, "user_resource", lambda *_, path="", **__: _made(tmp_path / path))
    monkeypatch.setattr(bpy.utils, "preset_paths", lambda folder: [_made(tmp_path / "presets" / folder)])
    return registered


def _made(folder):
    folder.mkdir(parents=True, exist_ok=True)
    return str(folder)


def shown(advanced, rig="GRID", response="srgb"):
    settings = settings_of(bpy.context.scene)
    settings.rig, settings.response, settings.show_advanced = rig, response, advanced
    layout = Recorder()
    dataset_dialog.draw(bpy.context, layout)
    return layout.shown


def test_few_things_are_asked_at_once(scene):
    """Folder with its presets, cameras, views, width, lights that vary, and how long it takes."""
    first = [
        "out",
        "PHYSHDR_PT_dataset_presets",
        "rig",
        "views",
        "resolution_x",
        "vary_ambient",
        "show_advanced",
    ]
    assert [name for name in shown(False) if name != "physhdr.dataset_time"] == first


def test_everything_else_is_one_fold_away(scene):
    every = {
        *shown(True, "GRID"),
        *shown(True, "ORBIT", "file"),
        *shown(True, "HEMISPHERE"),
        *shown(True, "PATH"),
    }
    assert {*OPTIONS, "vary_ambient", "show_cameras"} <= every
    assert not {*OPTIONS, "show_cameras"}.isdisjoint(set(shown(True)) - set(shown(False)))


def test_a_preset_keeps_all_that_is_chosen_but_the_folder(scene):
    settings = settings_of(bpy.context.scene)
    settings.out, settings.rig, settings.views = "/tmp/kitchen", "ORBIT", 60
    settings.exposures, settings.vary_ambient = "-2 2", False
    assert bpy.ops.physhdr.dataset_preset_add(name="night shift") == {"FINISHED"}
    path = bpy.utils.preset_find("night_shift", dataset_presets.FOLDER)
    assert path
    settings.out, settings.rig, settings.views = "/tmp/garage", "GRID", 12
    settings.exposures, settings.vary_ambient = "0", True
    bpy.ops.script.execute_preset(filepath=path, menu_idname="PHYSHDR_PT_dataset_presets")
    kept = SimpleNamespace(
        **{name: getattr(settings, name) for name in ("out", "rig", "views", "exposures", "vary_ambient")}
    )
    assert kept == SimpleNamespace(
        out="/tmp/garage", rig="ORBIT", views=60, exposures="-2 2", vary_ambient=False
    )


def test_a_preset_can_be_removed(scene):
    bpy.ops.physhdr.dataset_preset_add(name="night shift")
    bpy.ops.physhdr.dataset_preset_add(name="night_shift", remove_name=True)
    assert not bpy.utils.preset_find("night_shift", dataset_presets.FOLDER)
