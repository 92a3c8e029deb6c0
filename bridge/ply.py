# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading a PLY: its header in one go, and its rows by numpy, whatever letters the header has.

plyfile reads a header byte by byte (a second a megabyte), refuses letters beyond ASCII, and reads each value
of text, and of rows with lists, by a call of its own. Its classes say here which types there are.
"""

import io
import mmap
import re
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import plyfile

from .regular import LONGEST_HEADER, damaged_where_it_fails, regular_file

#: By the header's word: plyfile's mark of the byte order, and none for text.
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
#: 1.#INF, and of ``printf`` 1.#INF00 or 1.#INF00e+000; newer versions write inf as all do.
_MICROSOFTS_INFINITY = re.compile(r"([+-]?)1\.#INF0*(?:e[+-]\d+)?(?=\s|\Z)", re.IGNORECASE)
#: 1.#QNAN, 1.#SNAN and −1.#IND likewise; of newer versions nan(ind) and nan(snan).
_MICROSOFTS_NAN = re.compile(
    r"[+-]?(?:1\.#(?:QNAN|SNAN|IND)0*(?:e[+-]\d+)?|nan\((?:ind|snan)\))(?=\s|\Z)", re.IGNORECASE
)


@dataclass(frozen=True, eq=False)
class Ply:
    """``elements``: name → structured array ``[N]`` of its properties that are no lists, maybe a map of the
    file. ``comments``: those before the first element, in ASCII."""

    elements: dict[str, np.ndarray[Any, Any]]
    comments: list[str]


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[plyfile.PlyProperty]

    @property
    def has_lists(self) -> bool:
        return any(isinstance(each, plyfile.PlyListProperty) for each in self.properties)

    def row(self, order: str = "=") -> np.dtype[Any]:
        """A row without its lists."""
        return np.dtype(
            [
                (each.name, each.dtype(order))
                for each in self.properties
                if not isinstance(each, plyfile.PlyListProperty)
            ]
        )


def open_ply(path: Path, kind: str, remedy: str) -> Ply:
    """A PLY of anything; ``kind`` is what it should be, and ``remedy`` the hint, for the message.

    Elements with lists that come last, such as a mesh's faces, are left out. Raises what ``regular_file``
    raises, ``FileDamagedError`` where it cannot be read or claims more than it has bytes for.
    """
    regular_file(path, remedy)
    with damaged_where_it_fails(f"{path} is not a readable {kind}", remedy), open(path, "rb") as file:
        lines, start = _header(file.read(LONGEST_HEADER))
        order, comments, elements = _parsed(lines)
        while elements and elements[-1].has_lists and elements[-1].name != "vertex":
            elements.pop()
        if order:
            return Ply(_binary(file, start, order, elements), comments)
        file.seek(start)
        return Ply(_text(io.TextIOWrapper(file, "ascii"), elements), comments)


def _header(raw: bytes) -> tuple[list[str], int]:
    """The lines of the header that ``raw`` begins with, in ASCII, and how many bytes it has."""
    if raw[:3] != b"ply":
        raise ValueError("it does not begin with ply")
    ends = next((ends for ends in (b"\r\n", b"\n", b"\r") if raw.startswith(ends, 3)), None)
    if ends is None:
        raise ValueError("its first line is more than ply")
    last = ends + b"end_header" + ends
    at = raw.find(last)
    if at < 0:
        raise ValueError(f"its header does not end within {LONGEST_HEADER} bytes")
    try:
        text = raw[:at].decode("utf-8")
    except UnicodeDecodeError:  # a code page of Windows
        text = raw[:at].decode("latin-1")
    # A header is ASCII by the format; ours are escaped alike.
    return text.encode("ascii", "backslashreplace").decode().split(ends.decode())[1:], at + len(last)


def _parsed(lines: list[str]) -> tuple[str, list[str], list[_Element]]:
    """The byte order, the comments and the elements that a header's lines tell of; raises ``ValueError``."""
    order, comments, elements = None, list[str](), list[_Element]()
    for line in lines:
        line = line.strip()
        match line.split(None, 4):
            case [] | ["obj_info", *_]:
                pass
            case ["comment", *_]:
                if not elements:
                    comments.append(line[len("comment ") :])
            case ["format", word, "1.0"] if word in _ORDERS and not elements:
                order = _ORDERS[word]
            case ["element", name, count] if count.isdecimal() and order is not None:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, value, name] if elements:
                elements[-1].properties.append(plyfile.PlyListProperty(name, length, value))
            case ["property", value, name] if elements:
                elements[-1].properties.append(plyfile.PlyProperty(name, value))
            case _:
                raise ValueError(f"its header has the line {line!r:.80}")
    if order is None:
        raise ValueError("its header has no format")
    if len({each.name for each in elements}) < len(elements):
        raise ValueError("two of its elements have the same name")
    return order, comments, elements


def _binary(file: IO[bytes], at: int, order: str, elements: list[_Element]) -> dict[str, np.ndarray]:
    mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    found = {}
    for element in elements:
        row, buffer, start = element.row(order), mapped, at
        if element.has_lists:
            buffer, at = _without_lists(mapped, at, order, element)
            start = 0
        else:
            at += element.count * row.itemsize
        if at > len(mapped):
            raise ValueError(f"it claims {element.count} rows of {element.name} in {len(mapped)} bytes")
        found[element.name] = (
            np.frombuffer(buffer, row, element.count, start) if row.itemsize else np.zeros(element.count, row)
        )
    return found


def _without_lists(mapped: mmap.mmap, at: int, order: str, element: _Element) -> tuple[bytes, int]:
    """The rows of an element without its lists, and where it ends."""
    steps, width, widths = [], 0, []
    for each in element.properties:
        if isinstance(each, plyfile.PlyListProperty):
            length, value = map(np.dtype, each.list_dtype(order))
            # Without a sign: a length below zero is one beyond the end.
            unpack = struct.Struct(order + length.char.upper()).unpack_from
            steps.append((width, unpack, width + length.itemsize, value.itemsize))
            widths.append(width)
            width = 0
        else:
            width += np.dtype(each.dtype(order)).itemsize
    places = array("q")
    for _ in range(element.count):
        for before, unpack, with_length, size in steps:
            places.append(at)
            at += with_length + unpack(mapped, at + before)[0] * size  # raises beyond the end
        places.append(at)
        at += width
    if at > len(mapped):
        raise ValueError(f"it claims {element.count} rows of {element.name} in {len(mapped)} bytes")
    raw, starts = np.frombuffer(mapped, np.uint8), np.array(places).reshape(-1, len(steps) + 1)
    parts = [raw[starts[:, k, None] + np.arange(each)] for k, each in enumerate((*widths, width))]
    return np.concatenate(parts, axis=1).tobytes(), at


def _text(file: IO[str], elements: list[_Element]) -> dict[str, np.ndarray]:
    found = {}
    for element in elements:
        row, rows = element.row(), _rows(file, element)
        if element.count and row.names:
            found[element.name] = np.loadtxt(rows, row, comments=None, ndmin=1)
        else:
            found[element.name] = np.zeros(sum(1 for _ in rows), row)
    return found


def _rows(file: IO[str], element: _Element) -> Iterator[str]:
    """The lines of an element without its lists, with NaN and infinity as every C library reads them."""
    for number in range(element.count):
        line = file.readline()
        if not line.strip() and element.properties:
            raise ValueError(f"it claims {element.count} rows of {element.name} and has {number}")
        if "#" in line or "(" in line:
            line = _MICROSOFTS_NAN.sub("nan", _MICROSOFTS_INFINITY.sub(r"\1inf", line))
        # numpy counts the words of all rows, and the first is counted for its message
        yield " ".join(_numbers(line.split(), element)) if element.has_lists or not number else line


def _numbers(words: list[str], element: _Element) -> Iterator[str]:
    """The words of a row that belong to no list; raises where there are more or fewer than it needs."""
    at = 0
    for each in element.properties:
        if at >= len(words):
            raise ValueError(f"a row of {element.name} has only {len(words)} words")
        if isinstance(each, plyfile.PlyListProperty):
            at += max(int(words[at]), 0)
        else:
            yield words[at]
        at += 1
    if at != len(words):
        raise ValueError(f"a row of {element.name} has {len(words)} words, not {at}")
