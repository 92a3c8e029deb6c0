# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a model stands is its object's to say: what Blender writes of that into the points goes back into the
object.

*Apply* (Ctrl+A), *Set Origin*, and a turn of all points in Edit Mode move the points, and leave the axes,
sizes and colours by direction of the Gaussians as they were. Besides, the points' space is the data set's:
cameras, probes and limits in metres are in it. So the object takes the change, which looks the same and
is exact.

Each point cloud remembers a few of its Gaussians (``WITNESS``). What is compared stands in the file and in
each step of the undo, so that whichever of them comes back is set right by what it says itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import bpy
import mathutils
import numpy as np

from ..blender import add_handlers, layout_of, remove_handlers
from . import parts
from .attributes import IDENTITY, MOVED, POSITION, ROTATION, SCALE, TYPES, WITNESS
from .point_cloud import read_attribute, write_attribute

#: So many Gaussians are remembered.
WITNESSES = 32
#: Coordinates that were moved together in float32 agree to this, of the largest.
ROUNDING = 1e-6
#: A matrix is sheared where what it does to axes is off by this share of its largest number.
SHEAR = 1e-4
#: Points are on a line, or in a plane, where they spread less than this beside it, of how far along.
FLATTEST = 1e-4


@dataclass(frozen=True)
class Notice:
    """What the user reads of a change that is not what Blender's own would have been."""

    title: str
    lines: tuple[str, ...]


KEPT = Notice(
    "The model keeps its transform",
    (
        "Its Gaussians stay in the space of their data set, and look the same.",
        "To write them where the object stands: Save Edited Model, Apply Transform.",
    ),
)
JOINED = Notice(
    "Joined models are not turned into one",
    (
        "Join moves the points of the others and leaves their axes, sizes, lights and response as they were.",
        "Undo it, and keep the models as objects of their own, in one collection or under one parent.",
    ),
)


def remember(cloud: bpy.types.PointCloud) -> None:
    """Take the Gaussians as they are now for whole."""
    cloud[WITNESS] = _read(cloud).reshape(-1).tolist()
    cloud.pop(MOVED, None)


def settle(cloud: bpy.types.PointCloud) -> Notice | None:
    """Let the objects of a model's cloud take what all of its points have done together since, and its
    Gaussians' axes and sizes have not; what there is to tell of it. Other edits stay, and in Edit Mode
    nothing is taken yet."""
    if IDENTITY not in cloud or not cloud.is_editable or not _is_whole(cloud):
        return None
    now, before = _read(cloud), np.array(cloud.get(WITNESS, ()), np.float64)
    if np.array_equal(now.reshape(-1), before):
        cloud.pop(MOVED, None)  # it was undone
        return None
    users = [each for each in bpy.data.objects if each.type == "POINTCLOUD" and each.data == cloud]
    # The number of points is in the first column.
    added = now[0, 0] - before[0] if before.size else 0.0
    if any(each.mode == "EDIT" for each in users):
        if not added:
            cloud[MOVED] = True
        elif MOVED not in cloud:  # what the rest does from here on can be detected
            remember(cloud)
        return None
    change = None
    if before.size == now.size:
        then = before.reshape(now.shape)
        # Who has turned the Gaussians' axes, too, knew what they did; of another number of points nothing is
        # known.
        if np.array_equal(then[:, [0, *range(4, 11)]], now[:, [0, *range(4, 11)]]):
            change = moved_by(then[:, 1:4], now[:, 1:4])
    took = change is not None and _take(cloud, users, change)
    remember(cloud)
    return KEPT if took else JOINED if added > 0 else None


def moved_by(before: np.ndarray, after: np.ndarray) -> np.ndarray | None:
    """``[4, 4]``: the map that took points ``[K, 3]`` to where they are: a shift, a similarity, or any affine
    one, the first that fits. None where none does, or the points lie too flat to tell it."""
    rounding = ROUNDING * max(np.abs(before).max(), np.abs(after).max())
    middle, middle_after = before.mean(axis=0), after.mean(axis=0)
    a, b = before - middle, after - middle_after
    for linear in _fits(a, b):
        if np.abs(b - a @ linear.T).max() <= rounding and np.linalg.det(linear) != 0.0:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = linear, middle_after - linear @ middle
            return matrix
    return None


def _fits(a: np.ndarray, b: np.ndarray) -> Iterator[np.ndarray]:
    """``[3, 3]`` each: what could have taken centred points ``a`` to ``b``, as far as they tell it."""
    lengths = np.linalg.svd(a, compute_uv=False)
    if len(a) < 3 or lengths[1] <= FLATTEST * lengths[0]:
        return
    yield np.eye(3)
    # The best rotation (Kabsch) and scale (Umeyama).
    left, spread, right = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    yield (left * signs) @ right * (spread @ signs / np.square(a).sum())
    if lengths[2] > FLATTEST * lengths[0]:
        yield np.linalg.lstsq(a, b)[0].T


def _take(cloud: bpy.types.PointCloud, users: list[bpy.types.Object], change: np.ndarray) -> bool:
    """Give ``change`` ``[4, 4]`` from the points to the objects; what hangs on these stays where it is.

    False, and nothing is done, where an object's transform cannot hold it: it has no shear.
    """
    own = [each for each in users if each.library is None]
    if any(_is_sheared(each.matrix_basis @ _matrix(change)) for each in own):
        return False
    back = np.linalg.inv(change)
    position = read_attribute(cloud, POSITION.name).astype(np.float64)
    write_attribute(cloud, POSITION, position @ back[:3, :3].T + back[:3, 3])
    for each in own:
        each.matrix_basis = each.matrix_basis @ _matrix(change)
        for child in each.children:
            child.matrix_parent_inverse = _matrix(back) @ child.matrix_parent_inverse
    cloud.update_tag()
    return True


def _is_sheared(matrix: mathutils.Matrix) -> bool:
    """Whether a place, a rotation and a scale are not all of a matrix."""
    parts: Any = matrix.decompose()
    again = np.array(mathutils.Matrix.LocRotScale(*parts), np.float64)
    return float(np.abs(again - np.array(matrix)).max()) > SHEAR * float(np.abs(again[:3, :3]).max())


def _matrix(values: np.ndarray) -> mathutils.Matrix:
    return mathutils.Matrix(values.tolist())


def _is_whole(cloud: bpy.types.PointCloud) -> bool:
    there = [cloud.attributes.get(each.name) for each in (POSITION, SCALE, ROTATION)]
    return len(cloud.points) > 0 and all(
        found is not None and cast(Any, found).data_type == each.type
        for found, each in zip(there, (POSITION, SCALE, ROTATION), strict=True)
    )


def _read(cloud: bpy.types.PointCloud) -> np.ndarray:
    """``[K, 11]``: the number of points, and position, scale and rotation of some of them."""
    count = len(cloud.points)
    chosen = np.unique(np.linspace(0, count - 1, WITNESSES).round().astype(int)).tolist()
    columns = [np.full((len(chosen), 1), count, np.float64)]
    for attribute in (POSITION, SCALE, ROTATION):
        data: Any = cast(Any, cloud.attributes[attribute.name]).data
        key = TYPES[attribute.type][1]
        columns.append(np.array([getattr(data[index], key) for index in chosen], np.float64))
    return np.concatenate(columns, axis=1)


# ---- when --------------------------------------------------------------------------------------------------


@bpy.app.handlers.persistent
def _settle_changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    clouds = [each.id.original for each in depsgraph.updates if isinstance(each.id, bpy.types.PointCloud)]
    notices = [_settled(cast(bpy.types.PointCloud, each)) for each in clouds]
    for notice in dict.fromkeys(filter(None, notices)):
        if not bpy.app.background:
            bpy.app.timers.register(partial(_tell, notice))  # nothing opens while Blender tells of a change


def _settled(cloud: bpy.types.PointCloud) -> Notice | None:
    if parts.adopt(cloud):
        remember(cloud)
    return settle(cloud)


def _tell(notice: Notice) -> None:
    """Say why the model is not as was asked for."""

    def draw(menu: bpy.types.UIPopupMenu, context: bpy.types.Context) -> None:
        for line in notice.lines:
            layout_of(menu).label(text=line)

    manager = bpy.context.window_manager
    if manager is not None and manager.windows:
        override: Any = bpy.context.temp_override(window=manager.windows[0])
        with override:
            manager.popup_menu(draw, title=notice.title, icon="INFO")


@bpy.app.handlers.persistent
def _settle_all(*_: Any) -> None:
    for target in getattr(bpy.data, "objects", ()):  # none yet while Blender starts
        if target.type == "POINTCLOUD":
            parts.note(target)
    for cloud in getattr(bpy.data, "pointclouds", ()):
        _settled(cloud)


_HANDLERS = (
    ("depsgraph_update_post", _settle_changed),
    ("undo_post", _settle_all),
    ("redo_post", _settle_all),
    ("load_post", _settle_all),
    ("blend_import_post", _settle_all),
)


def register() -> None:
    add_handlers(_HANDLERS)
    _settle_all()


def unregister() -> None:
    remove_handlers(_HANDLERS)
