# SPDX-License-Identifier: GPL-3.0-or-later
"""Width and height of a picture, by its header alone. No bpy; no pixel is decoded."""

import struct
from pathlib import Path

from ...bridge.errors import PhysHDRError
from ...bridge.regular import regular_file

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_SIGNATURE = b"\xff\xd8\xff"


def picture_size(path: Path) -> tuple[int, int] | None:
    """Width and height by the header of a PNG or JPEG; None for others, of which only the trainer knows."""
    try:
        with open(regular_file(path), "rb") as file:
            head = file.read(1 << 16)
    except (OSError, PhysHDRError):
        return None
    if head[:8] == PNG_SIGNATURE and len(head) >= 24:
        return struct.unpack(">II", head[16:24])
    at = 2 if head[:3] == JPEG_SIGNATURE else len(head)
    while at + 9 <= len(head) and head[at] == 0xFF:  # segment by segment, up to a start of frame
        if 0xC0 <= head[at + 1] <= 0xCF and head[at + 1] not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        at += 2 + struct.unpack(">H", head[at + 2 : at + 4])[0]
    return None
