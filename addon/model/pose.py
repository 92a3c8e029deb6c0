# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a model stands is its object's to say: what Blender writes of that into the points goes back into the
object.

*Apply* (Ctrl+A), *Set Origin*, and a turn of all points in Edit Mode move the points, and leave the axes,
sizes and colours by direction of the Gaussians as they were. Besides, the points' space is the data set's:
cameras, probes and limits in metres are told in it. So the object takes the change, which looks the same and
is exact.

Each point cloud remembers a few of its Gaussians (``WITNESS``). What is compared stands in the file and in
each step of the undo, so that whichever of them comes back is set right by what it says itself.
"""

from collections.abc import Iterator
from typing import Any, cast

import bpy
import mathutils
import numpy as np

from ..blender import layout_of
from .attributes import IDENTITY, POSITION, ROTATION, SCALE, TYPES, WITNESS
from .point_cloud import read_attribute, write_attribute

#: So many Gaussians are remembered.
WITNESSES = 32
#: Coordinates that were moved together in float32 agree to this, of the largest.
ROUNDING = 1e-6
#: What the user reads then.
TOLD = (
    "Its Gaussians stay in the space of their data set, and look the same.",
    "To write them where the object stands: Save Edited Model, Apply Transform.",
)
#: Points are on a line, or in a plane, where they spread less than this beside it, of how far along.
FLATTEST = 1e-4


def remember(cloud: bpy.types.PointCloud) -> None:
    """Take the Gaussians as they are now for whole."""
    cloud[WITNESS] = _read(cloud).reshape(-1).tolist()


def settle(cloud: bpy.types.PointCloud) -> bool:
    """Let the objects of a model's cloud take what all of its points have done together since, and its
    Gaussians' axes and sizes have not; whether there was such. Other edits stay, and in Edit Mode nothing is
    done yet."""
    if IDENTITY not in cloud or not cloud.is_editable or not _is_whole(cloud):
        return False
    now, before = _read(cloud), np.array(cloud.get(WITNESS, ()), np.float64)
    if np.array_equal(now.reshape(-1), before):
        return False
    users = [each for each in bpy.data.objects if each.type == "POINTCLOUD" and each.data == cloud]
    if any(each.mode == "EDIT" for each in users):
        return False
    change = None
    if before.size == now.size:
        then = before.reshape(now.shape)
        # Who has turned the Gaussians' axes, too, knew what they did; of another number of points nothing is
        # known. The number is in the first column.
        if np.array_equal(then[:, [0, *range(4, 11)]], now[:, [0, *range(4, 11)]]):
            change = moved_by(then[:, 1:4], now[:, 1:4])
    if change is not None:
        _take(cloud, users, change)
    remember(cloud)
    return change is not None


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


def _take(cloud: bpy.types.PointCloud, users: list[bpy.types.Object], change: np.ndarray) -> None:
    """Give ``change`` ``[4, 4]`` from the points to the objects; what hangs on these stays where it is."""
    back = np.linalg.inv(change)
    position = read_attribute(cloud, POSITION.name).astype(np.float64)
    write_attribute(cloud, POSITION, position @ back[:3, :3].T + back[:3, 3])
    for each in users:
        if each.library is None:
            each.matrix_basis = each.matrix_basis @ _matrix(change)
            for child in each.children:
                child.matrix_parent_inverse = _matrix(back) @ child.matrix_parent_inverse
    cloud.update_tag()


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
    if any([settle(cast(bpy.types.PointCloud, each)) for each in clouds]) and not bpy.app.background:
        bpy.app.timers.register(_tell)  # nothing opens while Blender tells of a change


def _tell() -> None:
    """Say why the numbers of the transform are not what was asked for."""
    manager = bpy.context.window_manager
    if manager is not None and manager.windows:
        override: Any = bpy.context.temp_override(window=manager.windows[0])
        with override:
            manager.popup_menu(_draw_told, title="The model keeps its transform", icon="INFO")


def _draw_told(menu: bpy.types.UIPopupMenu, context: bpy.types.Context) -> None:
    for line in TOLD:
        layout_of(menu).label(text=line)


@bpy.app.handlers.persistent
def _settle_all(*_: Any) -> None:
    for cloud in getattr(bpy.data, "pointclouds", ()):  # none yet while Blender starts
        settle(cloud)


_HANDLERS = (
    ("depsgraph_update_post", _settle_changed),
    ("undo_post", _settle_all),
    ("redo_post", _settle_all),
    ("load_post", _settle_all),
    ("blend_import_post", _settle_all),
)


def register() -> None:
    for event, handler in _HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)
    _settle_all()


def unregister() -> None:
    for event, handler in _HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
