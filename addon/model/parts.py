# SPDX-License-Identifier: GPL-3.0-or-later
"""What Edit Mode separates from a model is a model, too.

Blender gives the new object the points with their attributes, the modifier and the custom properties of the
object, and none of the point cloud's: no lights, no response, not where it comes from. So an object remembers
which model it shows, and the part takes these from there.
"""

import uuid

import bpy

from ..blender import cloud_of
from .attributes import BASE, IDENTITY, POSITION, ROTATION, SCALE, SHOWS

#: What every model's points have.
_NEEDED = (POSITION, SCALE, ROTATION, BASE)


def note(target: bpy.types.Object) -> None:
    """Let a model's object remember what it shows."""
    identity = cloud_of(target).get(IDENTITY)
    if identity and target.library is None and target.get(SHOWS) != identity:
        target[SHOWS] = identity


def adopt(cloud: bpy.types.PointCloud) -> bool:
    """Make a model of a cloud that was separated from one, while that one is there; whether it was such."""
    if (
        IDENTITY in cloud
        or not cloud.is_editable
        or not all(each.name in cloud.attributes for each in _NEEDED)
    ):
        return False
    users = [each for each in bpy.data.objects if each.type == "POINTCLOUD" and each.data == cloud]
    shown = {each[SHOWS] for each in users if SHOWS in each}
    source = next((each for each in bpy.data.pointclouds if each.get(IDENTITY) in shown), None)
    if source is None:
        return False
    for key, value in source.items():
        cloud[key] = value
    cloud[IDENTITY] = uuid.uuid4().hex
    for each in users:
        note(each)
    return True
