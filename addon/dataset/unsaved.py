# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted or baked images that are in memory only: a copy of the file does not have their pixels."""

import textwrap

import bpy

from ...bridge.errors import DataMismatchError

#: What uses images that renders show. Others use them to work with: brushes, background images, editors.
_SHOWN_BY = {"MATERIAL", "WORLD", "LIGHT", "NODETREE", "TEXTURE", "OBJECT"}
#: Characters of the images' names that are shown.
_NAMES = 100


def images() -> list[bpy.types.Image]:
    """Those of the open file that renders may show and whose pixels are neither saved nor packed."""
    unsaved = [image for image in bpy.data.images if image.is_dirty]
    if not unsaved:  # as mostly: who uses them takes a walk through the whole file
        return []
    users = bpy.data.user_map(subset=unsaved)
    return [image for image in unsaved if any(_shows(user) for user in users[image])]


def _shows(user: bpy.types.ID) -> bool:
    """Whether a render may show the images of a datablock; an empty's are for the 3D view alone."""
    return user.id_type in _SHOWN_BY and not (isinstance(user, bpy.types.Object) and user.type == "EMPTY")


def require_saved() -> None:
    """Raises ``DataMismatchError`` where images on disk are not what the user sees."""
    names = ", ".join(f"'{image.name}'" for image in images())
    if names:
        raise DataMismatchError(
            "images have changes that are not saved, and would be rendered without them: "
            + textwrap.shorten(names, _NAMES, placeholder=" …"),
            "Save or pack them: Image > Save All Images, in an Image Editor.",
        )
