# SPDX-License-Identifier: GPL-3.0-or-later
"""Inspects a data set of another layout through the scene returned by its reader.

The reader has checked every header by then; here each picture is decoded, and the truth, if any.
"""

import numpy as np

from ...bridge.data_set import LIT, LIT_TEST, TRAIN
from ...bridge.errors import PhysHDRError
from ...bridge.light_groups import LightGroup, LightGroups
from ...bridge.light_report import light_report
from ..evaluate import truth
from ..evaluate.published import keeps_exposures_for_testing
from ..scene import Scene, View
from ..scene.held_out_views import same_places
from ..scene.source import exr_rec709
from .findings import Inspection, Split, add_exposures, warn_of_exposures
from .pixels import TrainingPixels


def look_at_scene(scene: Scene, found: Inspection) -> None:
    """Add the views and their truth to ``found``; every fault is an entry of ``found.errors``."""
    found.scene = scene.name
    splits = {name: views for name, views in scene.splits.items() if views}
    found.splits = {name: Split(len(views)) for name, views in splits.items()}
    brackets = {  # other light has other exposures
        name: [dict(zip(view.bracket, view.exposures, strict=True)) for view in views]
        for name, views in splits.items()
        if name not in (LIT, LIT_TEST)
    }
    add_exposures(found, brackets, scene.photographs and not keeps_exposures_for_testing(scene))
    if scene.response_anchor is not None:
        light, code = scene.response_anchor
        found.response = f"response of {code:g} at exposure × radiance = {light:g}"
    pixels = TrainingPixels()
    for name, views in splits.items():
        for view in views:
            for i, seconds in enumerate(view.exposures):
                picture = _picture(view, i, found)
                if picture is None or name != TRAIN:
                    continue
                mask, encoding = view.mask(i), view.encodings[i]
                if encoding.is_known and not encoding.clips:
                    exposed = encoding.exposed(picture if mask is None else picture[mask])
                    pixels.add_radiance(exposed, seconds)
                else:
                    pixels.add_picture(picture, view.bracket[i], seconds, mask)
    _look_at_truth(scene, found, pixels)
    _look_at_lights(scene, found)
    pixels.summarise(found)
    if found.points is None:
        found.warnings.append(
            "there are no first points: training will find some by stereo "
            "(physhdr prepare --triangulate finds some by structure from motion)"
        )
    if not all(encoding.is_known for view in scene.train for encoding in view.encodings):
        warn_of_exposures(found)  # pictures of radiance need no bracket


def _look_at_lights(scene: Scene, found: Inspection) -> None:
    """Which lights can be turned afterwards, and from how many places each was seen to differ."""
    by_group: dict[str, list[View]] = {}
    for view in (*scene.lit, *scene.lit_test):
        by_group.setdefault(view.group, []).append(view)
    if not by_group:
        return
    standard = dict(zip(scene.lights, scene.standard_levels, strict=True))
    groups, places = [], {}
    for name, views in by_group.items():
        levels = dict(zip(scene.lights, views[0].lighting_levels, strict=True))
        changed = {light: level for light, level in levels.items() if level != standard[light]}
        groups.append(LightGroup(name, changed, ()))
        poses = np.array([view.camera.camera_to_world for view in views], np.float64)
        places[name] = len(same_places(poses[:, :3, 3], -poses[:, :3, 2]))
    found.lights = list(scene.lights)
    found.turnable, warnings = light_report(LightGroups(scene.lights, tuple(groups), standard), places)
    found.warnings += warnings


def _picture(view: View, i: int, found: Inspection) -> np.ndarray | None:
    try:
        return view.image(i)
    except PhysHDRError as error:
        found.add_fault(error.message, error.hint)
        return None


def _look_at_truth(scene: Scene, found: Inspection, pixels: TrainingPixels) -> None:
    """Count the true pictures."""
    for name, split in found.splits.items():
        for view in scene.splits[name] if truth.has_hdr_truth(scene.root, name) else []:
            try:
                radiance = exr_rec709(truth.hdr_truth_path(scene.root, name, view.index))
            except PhysHDRError as error:
                found.add_fault(error.message, error.hint)
                continue
            split.hdr += 1
            if name == TRAIN:
                pixels.add_truth(radiance)
