# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of megabytes from small ones: headers, comments, names and numbers without end.

Each is what its format allows, or nearly: what it asks of a reader is time and memory, of which it must not
take more than a file of so many bytes is worth.
"""

import io
import random
import re
import struct
import zipfile
import zlib

#: Below the bound of a header, and far beyond it.
SIZES = ((1 << 21) - (1 << 14), 6 << 20)
#: Repeated somewhere in a file of any kind.
UNITS = (
    "a",
    "é",
    " ",
    "\n",
    "\r",
    "# x\n",
    "#",
    "0 ",
    "1.5\n",
    "x y ",
    "space: ",
    '"',
    "[",
    "(",
    "\\",
    "\0",
    "-",
)
#: Parts of an object in JSON, each with a number of its own where it has a place for one.
MEMBERS = ('"k%d": 0,', '"": 0,', '"é%d": "ü",', '"%d": [[], {}],', "\n ", '"k%d": 1e-300,')
VALUES = ('"%s"', "[%s 0]")


def stretched(whole: bytes, suffix: str, generator: random.Random) -> bytes:
    """A copy of a file whose name ends with ``suffix`` with megabytes more."""
    size = generator.choice(SIZES)
    if generator.random() < 0.8:
        match suffix:
            case ".ply":
                return _ply(whole, size, generator)
            case ".json" | ".gltf":
                return _json(whole, size, generator)
            case ".jsonl":
                return _json(whole, size, generator).replace(b"\n", b" ") + b"\n" + whole
            case ".glb":
                return _glb(whole, size, generator)
            case ".sog":
                return _sog(whole, size, generator)
            case ".safetensors":
                length = int.from_bytes(whole[:8], "little")
                text = _json(whole[8 : 8 + length], size, generator)
                return len(text).to_bytes(8, "little") + text + whole[8 + length :]
            case ".png":
                return _png(whole, size, generator)
    unit = generator.choice(UNITS).encode()
    at = generator.choice((0, len(whole), generator.randrange(len(whole) + 1), _line(whole, generator)))
    return whole[:at] + unit * (size // len(unit)) + whole[at:]


def _line(whole: bytes, generator: random.Random) -> int:
    """Where one of the first lines ends."""
    ends = [match.end() for match in re.finditer(rb"\n", whole[:4096])]
    return generator.choice(ends or [0])


def _many(form: str, size: int) -> bytes:
    """``form`` again and again, numbered where it has a place for that, in some ``size`` bytes."""
    once = form.encode()
    if "%d" not in form:
        return once * (size // len(once))
    return b"".join(once % number for number in range(size // (len(once) + 4)))


def _ply(whole: bytes, size: int, generator: random.Random) -> bytes:
    head, mark, rows = whole.partition(b"end_header\n")
    match generator.choice(("comments", "one comment", "properties", "elements", "lists", "rows", "no end")):
        case "comments":
            head = head.replace(b" 1.0\n", b" 1.0\n" + _many("comment é\n", size), 1)
        case "one comment":
            unit = generator.choice(UNITS).encode().translate(None, b"\r\n")
            head = head.replace(
                b" 1.0\n", b" 1.0\ncomment " + unit * (size // (len(unit) or size)) + b"\n", 1
            )
        case "properties":
            head += _many("property char a%d\n", size)
        case "elements":
            head += _many("element a%d 0\nproperty char x\n", size)
        case "lists":
            rows = b"element lists %d\nproperty list uchar char x\n" % size + mark + b"\1" * (2 * size) + rows
            first, element, others = head.partition(b"element")
            return first + rows.replace(mark, element + others + mark, 1)
        case "rows":
            times = max(1, size // max(1, len(rows)))
            head = re.sub(
                rb"(element vertex )(\d+)", lambda m: m[1] + b"%d" % (int(m[2]) * times), head
            ).replace(b" 1.0\n", " 1.0\ncomment Jürgen\n".encode(), 1)
            rows *= times
        case _:
            return head + _many("comment é\n", size)
    return head + mark + rows


def _json(whole: bytes, size: int, generator: random.Random) -> bytes:
    """Megabytes after one of the first brackets."""
    brackets = [match.end() for match in re.finditer(rb"\{", whole[:4096])]
    at = generator.choice(brackets or [0])
    if generator.random() < 0.6:
        more = _many(generator.choice(MEMBERS), size)
    else:
        inner = _many(generator.choice(("0,", "é", "[],", "1e5,", "9", "\\n")), size)
        more = b'"more": ' + generator.choice(VALUES).encode() % inner + b","
    return whole[:at] + more + whole[at:]


def _glb(whole: bytes, size: int, generator: random.Random) -> bytes:
    length = int.from_bytes(whole[12:16], "little")
    text = _json(whole[20 : 20 + length], size, generator)
    text += b" " * (-len(text) % 4)
    rest = whole[20 + length :]
    return b"glTF" + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest


def _sog(whole: bytes, size: int, generator: random.Random) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(whole)) as old, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            raw = old.read(name)
            new.writestr(name, _json(raw, size, generator) if name == "meta.json" else raw)
        if generator.random() < 0.3:
            for number in range(size // 200):
                new.writestr(f"{number}.webp", b"")
    return file.getvalue()


def _png(whole: bytes, size: int, generator: random.Random) -> bytes:
    """Chunks of text, one or many, after the header."""
    packed = zlib.compress(bytes(16 * size))
    chunks = {
        b"tEXt": b"Comment\0" + b"x" * size,
        b"zTXt": b"Comment\0\0" + packed,
        b"iTXt": b"Comment\0\1\0\0\0" + packed,
        b"iCCP": b"Profile\0\0" + packed,
        b"eXIf": b"MM\0*\0\0\0\x08\xff\xff" + b"\1\x0f\0\2\0\0\0\4abcd" * (size // 12),
        b"many": b"",
    }
    kind, payload = generator.choice(sorted(chunks.items()))
    times = 1
    if kind == b"many":
        kind, payload, times = b"tEXt", b"a\0" + b"b" * 30, size // 44
    chunk = struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", zlib.crc32(kind + payload))
    return whole[:33] + chunk * times + whole[33:]
