# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files, made from whole ones, with which every reader is tried.

A seed gives the same cases on every machine, so that a case that fails can be made again from its number.
Only the standard library, so that tests inside Blender have it too.
"""

import copy
import json
import random
import struct
from collections.abc import Iterator
from typing import Any

#: Values at the ends of what integers and floats of a binary header hold, little endian.
EXTREMES = [
    struct.pack(form, value)
    for form, values in {
        "<b": (-128, -1, 0, 1, 127),
        "<h": (-(2**15), -1, 0, 2**15 - 1),
        "<i": (-(2**31), -(2**31) + 1, -1, 0, 1, 2**24, 2**30, 2**31 - 1),
        "<q": (-(2**63), -1, 0, 2**31, 2**32, 2**62, 2**63 - 1),
        "<f": (float("nan"), float("inf"), -float("inf"), 3.0e38, -3.0e38, 1e-45, 0.0),
        "<d": (float("nan"), float("inf"), -float("inf"), 1.0e300, -1.0e300, 5e-324, 0.0),
    }.items()
    for value in values
]
EXTREMES += [extreme[::-1] for extreme in EXTREMES if len(extreme) > 1]  # PNG and TIFF have big endian too

#: What may stand in JSON where something else is expected. An integer of 400 digits is no float; NaN and
#: the infinities are not JSON, but Python's reader accepts them; a lone surrogate cannot be in a file's name
#: or a line of a log.
JSON_VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1.5,
    10**18,
    10**400,
    -(10**400),
    1e300,
    -1e300,
    5e-324,
    float("nan"),
    float("inf"),
    -float("inf"),
    "",
    "0.5",
    "nan",
    "text",
    "../../outside",
    "/dev/null",
    "nul\0byte",
    "lone \ud800 surrogate",
    "x" * 5000,
    [],
    [[]],
    [None],
    [1, 2, 3],
    [[1.0, 2.0], [3.0]],
    [[[[[[[[1]]]]]]]],
    ["a", 1],
    {},
    {"a": None},
    {"": {"": {}}},
)

#: Texts in place of a whole file of JSON.
JSON_TEXTS: tuple[bytes, ...] = (
    b"",
    b" ",
    b"\n",
    b"\0",
    b"null",
    b"true",
    b"7",
    b"1" * 5000,  # Python refuses to convert more than 4300 digits
    b'"text"',
    b"[]",
    b"[{}]",
    b"{}",
    b"{",
    b'{"a": 1} x',
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b"[" * 900 + b"]" * 900,
    b'{"a": NaN, "b": Infinity}',
    b'{"a": 1, "a": [], "a": null}',
    b'{"a": "\xff\xfe"}',
    b'{"a": "\\ud800"}',
    b"\xef\xbb\xbf{}",
    "{}".encode("utf-16"),
    b"\x80\x80\x80",
)


def mutations(data: bytes, count: int, seed: int) -> Iterator[bytes]:
    """``count`` damaged copies of ``data``: flipped bits, extremes of integers, cuts, repetitions, noise.

    Half of the places are among the first 512 bytes, where formats keep their headers.
    """
    generator = random.Random(seed)
    for _ in range(count):
        damaged = bytearray(data)
        for _ in range(generator.choice((1, 1, 1, 2, 4, 16))):
            _damage(damaged, generator)
        yield bytes(damaged)


def _damage(data: bytearray, generator: random.Random) -> None:
    if not data:
        data += generator.randbytes(generator.randrange(1, 64))
        return
    at = generator.randrange(min(len(data), 512) if generator.random() < 0.5 else len(data))
    match generator.choice(("bit", "byte", "extreme", "cut", "remove", "repeat", "noise", "swap", "append")):
        case "bit":
            data[at] ^= 1 << generator.randrange(8)
        case "byte":
            data[at] = generator.choice((0, 1, 0x7F, 0x80, 0xFF, generator.randrange(256)))
        case "extreme":
            extreme = generator.choice(EXTREMES)
            data[at : at + len(extreme)] = extreme
        case "cut":
            del data[at:]
        case "remove":
            del data[at : at + generator.choice((1, 2, 4, 8, 100))]
        case "repeat":
            length = generator.choice((1, 4, 16, 256))
            data[at:at] = data[at : at + length]
        case "noise":
            length = min(generator.choice((2, 8, 64)), len(data) - at)
            data[at : at + length] = generator.randbytes(length)
        case "swap":
            other = generator.randrange(len(data))
            data[at], data[other] = data[other], data[at]
        case "append":
            data += generator.randbytes(generator.choice((1, 8, 100)))


def json_mutations(value: Any, count: int, seed: int) -> Iterator[Any]:
    """``count`` damaged copies of a JSON value: somewhere in it another kind of value, one less or more."""
    generator = random.Random(seed)
    for _ in range(count):
        damaged = copy.deepcopy(value)
        for _ in range(generator.choice((1, 1, 1, 2, 3))):
            damaged = _damaged_json(damaged, generator)
        yield damaged


def json_bytes(value: Any) -> bytes:
    """A JSON value as a file's bytes; what JSON does not allow (NaN, lone surrogates) as Python has it."""
    return json.dumps(value).encode("ascii")


def _damaged_json(value: Any, generator: random.Random) -> Any:
    places = list(_places(value, None, None))
    holder, key = generator.choice(places)
    if holder is None:
        return copy.deepcopy(generator.choice(JSON_VALUES)) if generator.random() < 0.2 else value
    match generator.choice(("replace", "replace", "replace", "remove", "add", "rename", "repeat")):
        case "replace":
            holder[key] = copy.deepcopy(generator.choice(JSON_VALUES))
        case "remove":
            del holder[key]
        case "add" if isinstance(holder, list):
            holder.insert(key, copy.deepcopy(generator.choice(JSON_VALUES)))
        case "repeat" if isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        case "rename" if isinstance(holder, dict):
            holder[generator.choice(("", "text", "../x", "lone \ud800", "a\0b", "9" * 400))] = holder.pop(key)
        case _ if isinstance(holder, dict):
            holder[generator.choice(("", "extra", "lone \udfff"))] = copy.deepcopy(
                generator.choice(JSON_VALUES)
            )
    return value


def _places(value: Any, holder: Any, key: Any) -> Iterator[tuple[Any, Any]]:
    """Every (list or dict, index or key) under ``value``, and (None, None) for itself."""
    yield holder, key
    children = (
        enumerate(value) if isinstance(value, list) else value.items() if isinstance(value, dict) else ()
    )
    for name, child in children:
        yield from _places(child, value, name)
