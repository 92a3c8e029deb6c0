# SPDX-License-Identifier: GPL-3.0-or-later
"""Inspects a data set of another layout through the scene returned by its reader.

The reader has checked every header by then; here each picture is decoded, and the truth, if any.
"""

import numpy as np

from ...bridge.data_set import TRAIN
from ...bridge.errors import PhysHDRError
from ..evaluate import truth
from ..evaluate.published import keeps_exposures_for_testing
from ..scene import Scene, View
from ..scene.source import exr_rec709
from .findings import Inspection, Split, add_exposures, warn_of_exposures
from .pixels import TrainingPixels


def look_at_scene(scene: Scene, found: Inspection) -> None:
    """Add the views and their truth to ``found``; every fault is an entry of ``found.errors``."""
    found.scene = scene.name
    splits = {name: views for name, views in scene.splits.items() if views}
    found.splits = {name: Split(len(views)) for name, views in splits.items()}
    brackets = {
        name: [dict(zip(view.bracket, view.exposures, strict=True)) for view in views]
        for name, views in splits.items()
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
    pixels.summarise(found)
    if found.points is None:
        found.warnings.append(
            "there are no first points: training will find some by stereo "
            "(physhdr prepare --triangulate finds some by structure from motion)"
        )
    if not all(encoding.is_known for view in scene.train for encoding in view.encodings):
        warn_of_exposures(found)  # pictures of radiance need no bracket


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
