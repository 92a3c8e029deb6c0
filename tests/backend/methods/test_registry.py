# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method keeps to what its settings declare of it."""

import dataclasses

import pytest

from physhdr.backend.methods.base import MethodConfig, MethodSetup
from physhdr.backend.methods.registry import METHODS
from physhdr.backend.model.backbone import BackboneConfig
from physhdr.backend.scene import read_scene
from physhdr.backend.train.backbones import BACKBONES, new_method
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import method_of
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.trainer import step
from physhdr.bridge.errors import BadValueError

#: Presets with small networks, one of each method, and both forms of PhysHDR-GS.
SMALL = ("default", "baseline", "paper", "default-scaffold", "gausshdr", "hdr-gs", "hdr-nerf-small")


def test_a_name_leads_to_the_settings_and_back():
    for table, kind in ((METHODS, MethodConfig), (BACKBONES, BackboneConfig)):
        for name, row in table.items():
            assert issubclass(row.config, kind) and row.config.name == name
    assert {config.method.name for config in PRESETS.values()} == METHODS.keys()
    assert {config.backbone.name for config in PRESETS.values()} == BACKBONES.keys()
    with pytest.raises(BadValueError, match=r"no method 'nerf'[\s\S]*hdr-nerf"):
        method_of({"name": "nerf"})


@pytest.mark.parametrize(
    "preset",
    [pytest.param(name, marks=[pytest.mark.long] * (name == "hdr-nerf-small")) for name in SMALL],
)
def test_what_is_declared_is_so(preset, tiny_data):
    config = PRESETS[preset]
    traits = config.method.traits
    method = new_method(config.method, config.backbone, MethodSetup())
    if traits.splats:
        wanted = config.method.attributes(("ambient",))
        assert method.has_light_share == (wanted.lights > 0)
    else:
        assert method.size == 0
        with pytest.raises(BadValueError, match=f"{config.method.name} has no Gaussians"):
            method.preview(read_scene(tiny_data).train[0].camera)
    # Who follows the view's light learns from lit views at their own levels; who does not never sees one.
    scene = read_scene(tiny_data)
    supervision = "bracket" if traits.brackets_at_once else "one"
    state = begin(scene, dataclasses.replace(config, iterations=9, supervision=supervision))
    batches = [state.batch(i) for i in range(len(state.views))]
    levels = {batch.levels for batch in batches}
    assert levels == ({(1.0,), (0.25,), (4.0,)} if traits.light == "view" else {(1.0,)})
    assert {len(batch.recordings) for batch in batches} == ({3} if supervision == "bracket" else {1})
    assert step(state).keys()
    if traits.light == "view":
        assert method.can_relight


def test_half_sizes_and_first_colours_are_declared_where_they_differ(tmp_path):
    published = PRESETS["hdr-gs"].method
    supervised = dataclasses.replace(published, hdr_supervision=True, hdr_truth=str(tmp_path))
    assert published.traits.half_sizes and not supervised.traits.half_sizes
    assert published.traits.initial_radiance == "points"
    assert PRESETS["hdr-gs-short"].method.traits.initial_radiance == "merged"
