# SPDX-License-Identifier: GPL-3.0-or-later
"""What a HEIF or AVIF file states before its pixels (ISO/IEC 14496-12, 23008-12).

It is made of boxes. Its pictures are *items*: where their bytes are (``iloc``), of what kind each is
(``iinf``), which is the photo (``pitm``) and which properties it has (``iprp``). By hand, because no
library checks completeness (libheif decodes pictures of which half the tiles are missing) or reports an
AVIF's depth and code points (Pillow does not; OpenImageIO is built without HEIF).
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

#: Items, and parts of them, at most; 200 million pixels in tiles of 512 × 512 are 800.
MOST_PARTS = 1 << 14
#: Kinds of items whose bytes are HEVC or AV1, which no coded picture begins with zeros.
CODED = (b"hvc1", b"av01")
#: Where an item's parts are: counted from the file's beginning, not in another item or box.
IN_FILE = 0


@dataclass
class Item:
    """One of the file's items: its kind, where its parts are in the file, and its properties, as boxes."""

    kind: bytes = b""
    parts: list[tuple[int, int]] = field(default_factory=list)
    properties: list[tuple[bytes, bytes]] = field(default_factory=list)

    def property_named(self, kind: bytes) -> bytes | None:
        """The content of the first property of that kind."""
        return next((content for each, content in self.properties if each == kind), None)


@dataclass(frozen=True)
class Items:
    """All ``items`` by number, and the number of the ``primary`` one."""

    items: dict[int, Item]
    primary: int

    def property_named(self, kind: bytes) -> bytes | None:
        """That of the primary picture; of one in tiles, which may leave it to them, that of any."""
        first = self.items.get(self.primary, Item())
        found = (item.property_named(kind) for item in (first, *self.items.values()))
        return next((content for content in found if content is not None), None)


def read_items(content: bytes) -> Items:
    """The items of a file; raises ``ValueError``, ``struct.error`` or ``IndexError`` where it is damaged."""
    meta = dict(_boxes(content)).get(b"meta")
    if meta is None:
        raise ValueError("it has no picture")
    boxes = dict(_boxes(meta[4:]))
    if b"pitm" not in boxes:
        raise ValueError("it does not say which picture it is of")
    primary = struct.unpack_from(">H" if boxes[b"pitm"][0] == 0 else ">I", boxes[b"pitm"], 4)[0]
    items: dict[int, Item] = {}
    _read_kinds(boxes.get(b"iinf", b""), items)
    _read_places(boxes.get(b"iloc", b""), items)
    _read_properties(boxes.get(b"iprp", b""), items)
    return Items(items, primary)


def check_complete(content: bytes, items: Items) -> None:
    """Raises ``ValueError`` where a part lies beyond the file's end, or was never copied: it is zeros."""
    for item in items.items.values():
        for offset, size in item.parts:
            if offset + size > len(content):
                raise ValueError(f"it ends after {len(content)} of {offset + size} bytes or more")
            if item.kind in CODED and not any(content[offset : offset + min(size or 8, 8)]):  # 0: to the end
                raise ValueError("a part of it is empty")


def av1_bits(items: Items) -> int:
    """Bits a channel of an AVIF (AV1 Codec ISO Media File Format Binding, 2.3.3); 8 where it does not say."""
    told = items.property_named(b"av1C")
    if told is None or len(told) < 3 or not told[2] & 0x40:
        return 8
    return 12 if told[2] & 0x20 else 10


def code_points(items: Items) -> tuple[int, int] | None:
    """Primaries and transfer of a ``colr`` of code points (ITU-T H.273); None without one."""
    for item in (items.items.get(items.primary, Item()), *items.items.values()):
        for kind, content in item.properties:
            if kind == b"colr" and content[:4] == b"nclx":
                return struct.unpack_from(">HH", content, 4)
    return None


def _boxes(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        head = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", content, at + 8)
            head = 16
        elif size == 0:  # to the end
            size = len(content) - at
        if size < head:
            raise ValueError(f"a box of {size} bytes")
        yield kind, content[at + head : at + size]
        at += size


def _read_kinds(content: bytes, items: dict[int, Item]) -> None:
    if not content:
        return
    for kind, entry in _boxes(content[6 if content[0] == 0 else 8 :]):
        if kind == b"infe" and entry[0] >= 2:
            number, _, of = struct.unpack_from(">HH4s" if entry[0] == 2 else ">IH4s", entry, 4)
            _item(items, number).kind = of


def _item(items: dict[int, Item], number: int) -> Item:
    if len(items) > MOST_PARTS:
        raise ValueError(f"it claims more than {MOST_PARTS} items")
    return items.setdefault(number, Item())


class _Reader:
    """Numbers one after the other, of any size in bytes (0: nothing, and 0)."""

    def __init__(self, content: bytes, at: int) -> None:
        self.content, self.at = content, at

    def number(self, size: int) -> int:
        self.at += size
        if self.at > len(self.content):
            raise ValueError("a box is cut off")
        return int.from_bytes(self.content[self.at - size : self.at], "big")


def _read_places(content: bytes, items: dict[int, Item]) -> None:
    """``iloc``, versions 0 to 2 (ISO/IEC 14496-12, 8.11.3)."""
    if not content:
        return
    version = content[0]
    sizes = content[4] >> 4, content[4] & 15, content[5] >> 4, content[5] & 15 if version else 0
    offset_size, length_size, base_size, index_size = sizes
    read = _Reader(content, 6)
    wide = 4 if version == 2 else 2
    total = 0
    for _ in range(read.number(wide)):
        item = _item(items, read.number(wide))
        method = read.number(2) & 15 if version else IN_FILE
        elsewhere = read.number(2)
        base = read.number(base_size)
        count = read.number(2)
        total += count
        if total > MOST_PARTS:
            raise ValueError(f"it claims more than {MOST_PARTS} parts")
        for _ in range(count):
            read.number(index_size)
            place = base + read.number(offset_size), read.number(length_size)
            if method == IN_FILE and not elsewhere:
                item.parts.append(place)


def _read_properties(content: bytes, items: dict[int, Item]) -> None:
    """``iprp``: all properties, and of which items they are (ISO/IEC 23008-12, 9.3)."""
    boxes = list(_boxes(content))
    every = list(_boxes(next((inside for kind, inside in boxes if kind == b"ipco"), b"")))
    for inside in (inside for kind, inside in boxes if kind == b"ipma"):
        version, wide = inside[0], 2 if inside[3] & 1 else 1
        read = _Reader(inside, 4)
        for _ in range(read.number(4)):
            item = _item(items, read.number(4 if version else 2))
            for _ in range(read.number(1)):
                number = read.number(wide) & (0x7FFF if wide == 2 else 0x7F)
                if 1 <= number <= len(every):
                    item.properties.append(every[number - 1])
