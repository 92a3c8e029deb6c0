# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user's choice sets off: the session follows the scene's data set and the preferences."""

import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

import physhdr  # noqa: E402
from physhdr.addon import changes, runtime, settings  # noqa: E402
from physhdr.bridge.messages import WhenClosed  # noqa: E402
from physhdr.bridge.presets import IN_PANEL  # noqa: E402


@pytest.fixture
def registered(registered, monkeypatch):
    monkeypatch.setattr("physhdr.addon.session.session.DATASET_SECONDS", 60.0)  # however busy the machine is
    return registered.physhdr


def test_a_chosen_data_set_is_looked_at(registered, tmp_path):
    registered.data = str(tmp_path)
    dataset = runtime.session().state.dataset
    assert dataset.folder == str(tmp_path) and dataset.problem is not None  # an empty folder is none


def test_what_becomes_of_a_training_is_told_to_the_session(registered, monkeypatch):
    assert runtime.session().when_closed.training == "keep"
    monkeypatch.setattr(settings, "when_closed", lambda: WhenClosed(training="stop"))
    settings._close_changed(None, bpy.context)
    assert runtime.session().when_closed.training == "stop"


def test_another_folder_of_the_backends_is_another_session(registered):
    before = runtime.session()
    settings._home_changed(None, bpy.context)
    assert runtime.session() is not before


def test_without_the_extension_nobody_follows(scene):
    physhdr.register()
    physhdr.unregister()
    assert not any(change._followers for change in (changes.home, changes.when_closed, changes.dataset))


def test_the_settings_list_the_presets_in_their_order(registered):
    items = registered.bl_rna.properties["preset"].enum_items
    shown = [(item.identifier, item.name, item.description) for item in items]
    assert shown == [(preset.name, preset.label, preset.description) for preset in IN_PANEL]
    assert registered.preset == "default"
