# SPDX-License-Identifier: GPL-3.0-or-later
"""Light probes in the scene: empties that say where the light of which model was taken, and what came of it.

All of it stands in custom properties, so that it is saved, undone, copied and appended with the empty. What
is known of a probe's panoramas is kept as text (``bridge.probe``), so that panels read no files.
"""

import json
import uuid
from dataclasses import asdict
from pathlib import Path
from typing import TypeGuard

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...bridge.blend_file import PROBE
from ...bridge.probe import Probe
from ..blender import (
    add_handlers,
    animated_paths,
    collection_beside,
    put_at,
    remove_handlers,
    to_matrix,
    world_of,
)
from ..model.look import is_model
from ..similarity import scale_of

#: Metres.
Place = tuple[float, float, float]

#: Custom properties of an empty: its model, the folder of its panoramas, and what is in it.
MODEL, FOLDER, KNOWN = "physhdr_probe_model", "physhdr_probe_folder", PROBE
#: Beside the .blend: the folders of all probes, below the file's name.
ROOT = "PhysHDR_light"
#: What a new one is called, and how large it is drawn, metres.
NEW, SIZE = "Light Probe", 0.1
#: So far may a probe be from where its light was taken: metres, or shares of its distance to the model's
#: origin where that is more.
MOVED = 1e-4
#: Where an object stands in its parent; setting ``matrix_world`` changes one of the rotations.
_TRANSFORM = ("location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale")
#: Probes and their deleted models, while the file is written, and how they hung on them (None: they did not).
_of_deleted: list[tuple[bpy.types.Object, bpy.types.Object, dict[str, tuple[float, ...]] | None]] = []


def is_probe(target: bpy.types.Object | None) -> TypeGuard[bpy.types.Object]:
    """Whether an object is an empty at which light was taken."""
    return target is not None and target.type == "EMPTY" and KNOWN in target


def probes_of(scene: bpy.types.Scene, model: bpy.types.Object) -> list[bpy.types.Object]:
    """The scene's probes of a model, by name."""
    found = (each for each in scene.objects if is_probe(each) and each.get(MODEL) == model)
    return sorted(found, key=lambda probe: probe.name)


def known(probe: bpy.types.Object) -> Probe:
    """What is known of its panoramas."""
    content = json.loads(probe[KNOWN])
    return Probe(**{**content, "at": tuple(content["at"]), "lights": tuple(content["lights"])})


def into_model(model: bpy.types.Object, place: Place) -> Place:
    """A place of the world in the model's own space, where its panoramas are drawn.

    Raises ``DataMismatchError`` where the model is sheared, mirrored or scaled differently along its axes:
    directions would not only turn.
    """
    to_world = np.array(world_of(model), np.float64)
    scale_of(to_world)
    x, y, z = (np.linalg.inv(to_world) @ np.array([*place, 1.0]))[:3]
    return float(x), float(y), float(z)


def in_world(model: bpy.types.Object, there: Place) -> Place:
    """Where a place of the model's own space is in the world."""
    x, y, z = (np.array(world_of(model), np.float64) @ np.array([*there, 1.0]))[:3]
    return x, y, z


def is_at(probe: bpy.types.Object, there: Place) -> bool:
    """Whether a probe's light was taken ``there``, in the model's space."""
    taken = np.array(known(probe).at)
    return bool(np.linalg.norm(taken - there) <= MOVED * max(1.0, float(np.linalg.norm(taken))))


def has_moved(probe: bpy.types.Object) -> bool:
    """Whether the probe stands elsewhere in its model than where its light was taken."""
    model = probe.get(MODEL)
    if not isinstance(model, bpy.types.Object) or not is_model(model):
        return False
    to_world = np.array(world_of(model))
    if not np.linalg.det(to_world):  # flat: a place of the world is at none of the model's
        return False
    x, y, z = (np.linalg.inv(to_world) @ np.array([*world_of(probe).translation, 1.0]))[:3]
    return not is_at(probe, (x, y, z))


def mark(probe: bpy.types.Object, model: bpy.types.Object, folder: str, found: Probe) -> None:
    """Remember at an empty what light was taken there."""
    probe[MODEL], probe[FOLDER], probe[KNOWN] = model, folder, json.dumps(asdict(found))


def new_probe(scene: bpy.types.Scene, model: bpy.types.Object, place: Place) -> bpy.types.Object:
    """An empty at a place of the world; it hangs on the model, and moves with the capture."""
    probe = bpy.data.objects.new(NEW, None)
    probe.empty_display_type, probe.empty_display_size = "SPHERE", SIZE
    collection_beside(model, scene).objects.link(probe)
    probe.parent = model
    scale = scale_of(np.array(world_of(model)))
    probe.matrix_local = to_matrix(np.diag([1.0 / scale] * 3 + [1.0]))
    probe.location = into_model(model, place)
    return probe


def new_folder(name: str) -> str:
    """A folder for panoramas that are about to be taken at a probe: beside the .blend, ``//`` and all.

    Never a former one, which an undo, a copy of this file or a probe of the same name may still name.
    Before the .blend is saved, it is in Blender's own for temporary files, from which they are packed.
    """
    own = f"{bpy.path.clean_name(name) or 'probe'}_{uuid.uuid4().hex[:12]}"
    if bpy.data.filepath:
        return f"//{ROOT}/{bpy.path.clean_name(Path(bpy.data.filepath).stem)}/{own}"
    return str(Path(bpy.app.tempdir) / ROOT / own)


# ---- what was deleted --------------------------------------------------------------------------------------


@persistent
def _forget_deleted(*_: object) -> None:
    """A model that was deleted is not kept in the file for its probes alone; once that is opened, the point
    cloud has no user, and the next save leaves it out. The probes stay where they are.

    One that lights a world is kept: what its light is multiplied by are its sliders. So is one that says
    where something else stands, such as its children: without it, they would jump.
    """
    probes = [each for each in bpy.data.objects if is_probe(each) and each.library is None]
    pointing = [(probe, probe.get(MODEL)) for probe in probes]
    pairs = [(probe, model) for probe, model in pointing if isinstance(model, bpy.types.Object)]
    for model in {each[1] for each in pairs if not each[1].users_scene and each[1].library is None}:
        own = [probe for probe, each in pairs if each == model]
        if _is_for(own, model):
            _of_deleted.extend((probe, model, _take_off(probe, model)) for probe in own)


def _is_for(own: list[bpy.types.Object], model: bpy.types.Object) -> bool:
    """Whether a model is there for its ``own`` probes alone, and they stand still.

    ``users`` counts no parents, targets of constraints or drivers, and the map of users says neither how
    often nor for what something is used: both are asked. What views remember of an object moves nothing.
    """
    users = bpy.data.user_map(subset=[model])[model] - {model, *own}
    if model.users != len(own) or not all(isinstance(user, bpy.types.Screen) for user in users):
        return False
    if any(probe.constraints or probe.animation_data for probe in own):
        return False
    moves = any(not path.startswith("modifiers[") for path in animated_paths(model))
    return model.parent is None and not model.constraints and not moves


def _take_off(probe: bpy.types.Object, model: bpy.types.Object) -> dict[str, tuple[float, ...]] | None:
    """Let a probe know nothing of its model, and stand where it does; returns its former transform."""
    del probe[MODEL]
    if probe.parent != model:
        return None
    before = {name: tuple(getattr(probe, name)) for name in _TRANSFORM}
    there = world_of(probe)
    probe.parent = None
    put_at(probe, there)
    return before


@persistent
def _remember_again(*_: object) -> None:
    """An undo may bring back in the open file what was deleted."""
    for probe, model, before in _of_deleted:
        probe[MODEL] = model
        if before is not None:
            probe.parent = model
            for name, value in before.items():
                setattr(probe, name, value)
    _of_deleted.clear()


_HANDLERS = (
    ("save_pre", _forget_deleted),
    ("save_post", _remember_again),
    ("save_post_fail", _remember_again),
)


def register() -> None:
    add_handlers(_HANDLERS)


def unregister() -> None:
    remove_handlers(_HANDLERS)
