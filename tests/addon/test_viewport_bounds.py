# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender frames what a capture shows, not the few Gaussians far away."""

import dataclasses

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Python 3.13 with the bpy wheel, or Blender's own Python")

from physhdr.addon import viewport  # noqa: E402
from physhdr.addon.model import model_import  # noqa: E402
from physhdr.addon.model.attributes import POSITION  # noqa: E402
from physhdr.addon.model.point_cloud import read_attribute, write_attribute  # noqa: E402
from physhdr.addon.viewport import bounds  # noqa: E402

ROOM = 5.0


@pytest.fixture
def shown(scene):
    viewport.register()
    yield
    viewport.unregister()


@pytest.fixture
def target(shown, make_model, write):
    """A room of 5 m with a Gaussian at 88 m and one at 145 m."""
    model = make_model(count=200)
    position = np.random.default_rng(3).uniform(-0.5 * ROOM, 0.5 * ROOM, (200, 3)).astype(np.float32)
    position[:2] = (88.0, 0.0, 0.0), (0.0, -145.0, 20.0)
    target = model_import.import_model(write(dataclasses.replace(model, position=position)))
    target.physhdr_viewport = "SPLATS"
    return target


def size(target) -> float:
    """The largest side of the box that Blender frames, metres."""
    bpy.context.view_layer.update()
    return float(np.ptp(np.array(target.bound_box), axis=0).max())


def test_blender_takes_it_for_as_large_as_the_room(target):
    assert size(target) <= ROOM
    assert size(target) > 0.9 * ROOM


def test_all_of_it_is_there_for_edits_and_renders_and_for_who_wants_instances(target):
    assert len(target.data.points) == 200
    (modifier,) = (each for each in target.modifiers if each.name == bounds.NAME)
    assert not modifier.show_render and not modifier.show_in_editmode
    target.physhdr_viewport = "NODES"
    assert [each.name for each in target.modifiers] == ["PhysHDR"]


def test_what_is_saved_knows_nothing_of_it(target, tmp_path):
    path = tmp_path / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert size(target) <= ROOM
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path)) as (there, _):
        assert there.pointclouds and bounds.NAME not in there.node_groups


def test_where_nothing_is_far_away_nothing_is_added(target):
    position = read_attribute(target.data, POSITION.name)
    position[:2] = 0.0
    write_attribute(target.data, POSITION, position)
    bounds.limit(target)
    assert [each.name for each in target.modifiers] == ["PhysHDR"]
    assert bounds.box_of(position) is None and bounds.box_of(position[:0]) is None


def test_a_long_corridor_is_near_to_its_end():
    along = np.linspace(0.0, 60.0, 4000)
    position = np.stack([along, np.sin(17.0 * along), np.cos(11.0 * along)], axis=1)
    assert bounds.box_of(position) is None
    low, high = bounds.box_of(np.concatenate([position, [[30.0, 0.0, 900.0]]]))
    np.testing.assert_array_equal((low, high), (position.min(axis=0), position.max(axis=0)))
