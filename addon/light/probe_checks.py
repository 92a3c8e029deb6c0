# SPDX-License-Identifier: GPL-3.0-or-later
"""What is to be said of a light probe: how much of it is a guess, and whether it is still of this model."""

import json
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...bridge.errors import PhysHDRError
from ...bridge.probe import MUCH_UNSEEN
from ..blender import add_handlers, cloud_of, remove_handlers
from ..layouts.cameras import Frame, read_frames
from ..model.drawn import drawn_of, fingerprint
from ..model.look import cleaning_of
from ..model.origin import data_of
from .probes import Place, has_moved, known

#: Custom properties of a probe: whether no camera saw its place, what of the model was hidden then, and what
#: its Gaussians drew (``model.drawn``).
OUTSIDE, HIDDEN, DRAWN = "physhdr_probe_outside", "physhdr_probe_hidden", "physhdr_probe_drawn"
#: What point clouds draw, and their ``fingerprint`` when that was found, by ``session_uid``.
_drawn: dict[int, tuple[tuple[int, ...], str]] = {}
#: Those of which Blender has reported a change since: perhaps of a modifier's input alone.
_suspects: set[int] = set()


def note(probe: bpy.types.Object, model: bpy.types.Object, drawn: str) -> None:
    """Remember of a probe whose light was just taken what cannot be found out later, or not while drawing.

    ``drawn``: what ``model.drawn`` says of the Gaussians that its light is of.
    """
    probe[OUTSIDE] = _is_outside(model, known(probe).at)
    probe[HIDDEN] = _hidden(model)
    probe[DRAWN] = drawn


def warnings_of(probe: bpy.types.Object, model: bpy.types.Object) -> list[str]:
    """Sentences for the panel, the gravest first; none where all is well."""
    found, warnings = known(probe), []
    if has_moved(probe):
        warnings.append("It was moved: take its light again")
    if _is_edited(probe, model) or probe.get(HIDDEN, "") != _hidden(model):
        warnings.append("The model was edited since: take its light again")
    if probe.get(OUTSIDE):
        warnings.append("No camera saw this place: what is around it may be far from true")
    if found.unseen > MUCH_UNSEEN:
        warnings.append(f"{found.unseen:.0%} of what is around was never seen: a guess from its rim")
    return warnings


def _is_edited(probe: bpy.types.Object, model: bpy.types.Object) -> bool:
    """Whether the model draws something else than when the light was taken; in Edit Mode its number of
    Gaussians alone tells."""
    cloud = cloud_of(model)
    if known(probe).gaussians != len(cloud.points):
        return True
    if model.mode != "OBJECT":
        return False
    return _drawn_now(cloud) != probe[DRAWN]


def _drawn_now(cloud: bpy.types.PointCloud) -> str:
    """``drawn_of`` a cloud, found anew where its Gaussians have changed."""
    uid = cloud.session_uid
    if uid not in _drawn or uid in _suspects:
        now = fingerprint(cloud)
        if uid not in _drawn or _drawn[uid][0] != now:
            _drawn[uid] = now, drawn_of(cloud)
        _suspects.discard(uid)
    return _drawn[uid][1]


def _hidden(model: bpy.types.Object) -> str:
    """What is hidden of a model from every side, as text; "" for nothing."""
    cleaning = cleaning_of(model)
    if not cleaning.by_itself:
        return ""
    limits = (
        cleaning.largest_size,
        cleaning.smallest_opacity,
        cleaning.largest_elongation,
        cleaning.largest_distance,
        cleaning.clear_of_photos,
        cleaning.smallest_confidence,
    )
    # The box in the model's space: numbers that change when a finger moves it, not when the model is moved.
    box = [] if cleaning.crop is None else [round(number, 4) for number in cleaning.crop]
    return json.dumps([box, cleaning.keep_outside, *limits])


def _is_outside(model: bpy.types.Object, at: Place) -> bool:
    """Whether no camera of the model's data set saw a place, and none stood near it; False if not known."""
    folder = data_of(model)
    if folder is None:
        return False
    try:
        frames = read_frames(folder).frames
    except (PhysHDRError, OSError):
        return False
    return is_outside(frames, np.array(at))


def is_outside(frames: tuple[Frame, ...] | list[Frame], at: np.ndarray) -> bool:
    """Whether a place ``[3]`` is in no camera's picture, and farther from all than they are apart."""
    if not frames or any(_sees(frame, at) for frame in frames):
        return False
    positions = np.array([frame.camera_to_world[:3, 3] for frame in frames])
    extent = np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()
    return bool(np.linalg.norm(positions - at, axis=1).min() > extent)


def _sees(frame: Frame, at: np.ndarray) -> bool:
    pose = frame.camera_to_world
    right, up, back = pose[:3, :3].T @ (at - pose[:3, 3])
    if back >= 0.0:
        return False
    x, y = frame.cx - frame.fx * right / back, frame.cy + frame.fy * up / back
    return bool(0.0 <= x <= frame.width and 0.0 <= y <= frame.height)


# ---- when --------------------------------------------------------------------------------------------------


@persistent
def _suspect_changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    for each in depsgraph.updates if _drawn else ():
        if isinstance(each.id, bpy.types.PointCloud):
            original: Any = each.id.original  # never None, whatever its type says
            _suspects.add(original.session_uid)


@persistent
def _suspect_all(*_: object) -> None:
    _suspects.update(_drawn)


@persistent
def _forget_all(*_: object) -> None:
    _drawn.clear()
    _suspects.clear()


_HANDLERS = (
    ("depsgraph_update_post", _suspect_changed),
    ("undo_post", _suspect_all),
    ("redo_post", _suspect_all),
    ("load_post", _forget_all),
)


def register() -> None:
    add_handlers(_HANDLERS)


def unregister() -> None:
    remove_handlers(_HANDLERS)
    _forget_all()
