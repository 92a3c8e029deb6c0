# SPDX-License-Identifier: GPL-3.0-or-later
"""Bad files from whole ones: bytes as ``damage.py`` damages them, and damage that a format's own
checks (a CRC, a length, JSON's grammar) would hide, done where they are right again.

Case ``number`` of a seed is the same on every machine, whichever cases were made before it.
"""

import functools
import importlib.util
import io
import json
import math
import os
import random
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .cases import Case, Form, Target
from .stretch import stretched

_TESTS = Path(__file__).resolve().parents[2]


def tests_module(path: str) -> Any:
    """A module of ``tests/``, which is no package."""
    spec = importlib.util.spec_from_file_location(f"fuzz_{Path(path).stem}", _TESTS / path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def once(folder: Path, make: Callable[[Path], Any]) -> None:
    """Let ``make`` fill a folder, which appears when it is whole; if two processes make it, one wins."""
    work = folder.with_name(f".{folder.name}.{os.getpid()}")
    make(work)
    try:
        work.rename(folder)
    except OSError:  # another process was first
        shutil.rmtree(work)


damage = tests_module("stress/damage.py")

#: Shares of cases in which there is no file, or something else than a file.
ODD_FORMS: tuple[Form, ...] = ("gone", "folder", "fifo", "loop")
ODD_SHARE = 0.02
#: One case in so many is megabytes long, the eleventh first: one at least of each row, even in short.
STRETCHED_EVERY = 50
#: Of a file's name: formats of text in which words may be exchanged.
TEXTS = (".txt", ".toml", ".ply", ".jsonl", ".csv", ".usda")
#: Words in place of a word of a text.
WORDS = (
    *("nan", "inf", "-inf", "1e400", "-1", "0", "-0.0", "1e300", "1e-320", "9" * 30, "9" * 5000, "0x10"),
    *("2147483647", "2147483648", "-2147483648", "4294967296", "9223372036854775807", "18446744073709551616"),
    *("", " ", "text", "../../x", "/dev/zero", "\0", "é", "char", "double", "list", "end_header", "½", "١"),
)
#: Values in place of a float of a binary array.
FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 2.0, 88.8, -200.0, 1e30, -1e30, 3.4e38, 1e-45)


def make_case(target: Target, seeds: dict[str, dict[str, bytes]], seed: int, number: int) -> Case:
    """Case ``number`` of ``target``; ``seeds``: variant → file → its bytes."""
    generator = random.Random(f"{seed}/{target.name}/{number}")
    variant = generator.choice(sorted(seeds))
    file = _file(target, sorted(seeds[variant]), generator)
    if not target.in_memory and generator.random() < ODD_SHARE:
        return Case(variant, file, generator.choice(ODD_FORMS))
    whole = seeds[variant][file]
    change = stretched if number % STRETCHED_EVERY == 10 else damaged
    return Case(variant, file, "bytes", change(whole, Path(file).suffix, generator))


def _file(target: Target, files: list[str], generator: random.Random) -> str:
    """A file of those that the target lets change: each folder's files of a kind count as much as one."""
    groups, weights = _groups(target, tuple(files))
    return generator.choice(generator.choices(groups, weights)[0])


@functools.cache
def _groups(target: Target, files: tuple[str, ...]) -> tuple[list[list[str]], list[int]]:
    """Files by folder and kind, and weights: what is no picture is where readers are most often wrong."""
    groups: dict[str, list[str]] = {}
    for file in files:
        if target.may_change(file):
            path = Path(file)
            alone = len(path.parts) == 1 or path.parent.name == "0"  # COLMAP's sparse/0
            groups.setdefault(file if alone else f"{path.parent}/*{path.suffix}", []).append(file)
    names = sorted(groups)
    return [groups[name] for name in names], [1 if "*" in name else 4 for name in names]


def damaged(whole: bytes, suffix: str, generator: random.Random) -> bytes:
    """A damaged copy of a file whose name ends with ``suffix``."""
    blindly = generator.random() < 0.4
    if not blindly:
        match suffix:
            case ".json" | ".gltf":
                return _json(whole, generator)
            case ".glb":
                return _glb(whole, generator)
            case ".sog":
                return _sog(whole, generator)
            case ".frame":
                return _frame(whole, generator)
            case ".safetensors":
                return _safetensors(whole, generator)
            case ".png":
                return _png(whole, generator)
            case suffix if suffix in TEXTS:
                return _words(whole, generator)
    return next(damage.mutations(whole, 1, generator.getrandbits(32)))


def _json(whole: bytes, generator: random.Random) -> bytes:
    if generator.random() < 0.05:
        return generator.choice(damage.JSON_TEXTS)
    value = next(damage.json_mutations(json.loads(whole), 1, generator.getrandbits(32)))
    try:
        return damage.json_bytes(value)
    except (TypeError, ValueError):  # a number of more digits than Python writes
        return whole[: len(whole) // 2]


def _words(whole: bytes, generator: random.Random) -> bytes:
    """A word or a line of the first kilobytes is another one, gone or there twice."""
    lines = whole.split(b"\n")
    for _ in range(generator.choice((1, 1, 2, 3))):
        at = generator.randrange(min(len(lines), 40))
        words = lines[at].split(b" ")
        place = generator.randrange(len(words))
        match generator.choice(("word", "word", "word", "drop", "double", "no line", "line twice")):
            case "word":
                words[place] = generator.choice(WORDS).encode()
            case "drop":
                del words[place]
            case "double":
                words.insert(place, words[place])
            case "no line" if len(lines) > 1:
                del lines[at]
                continue
            case "line twice":
                lines.insert(at, lines[at])
                continue
        lines[at] = b" ".join(words)
    return b"\n".join(lines)


def _frame(whole: bytes, generator: random.Random) -> bytes:
    """A preview's frame with a damaged header whose length is right, and perhaps its pixels' too."""
    length = int.from_bytes(whole[:4], "little")
    header = json.loads(whole[4 : 4 + length])
    pixels = whole[4 + length :]
    if generator.random() < 0.5:
        sides = generator.choices((0, -1, -5, 1, 2, 3, 8, 4096, 4097, 1 << 31, 1 << 62), k=2)
        header["request"]["camera"]["width"], header["request"]["camera"]["height"] = sides
        size = 12 * sides[0] * sides[1]
        pixels = generator.randbytes(size) if 0 <= size < 4096 else pixels
    else:
        header = next(damage.json_mutations(header, 1, generator.getrandbits(32)))
    try:
        text = damage.json_bytes(header)
    except (TypeError, ValueError):
        text = b"{}"
    return len(text).to_bytes(4, "little") + text + pixels


def _safetensors(whole: bytes, generator: random.Random) -> bytes:
    """Another header, or other numbers, in a container that is whole."""
    length = int.from_bytes(whole[:8], "little")
    header, data = json.loads(whole[8 : 8 + length]), bytearray(whole[8 + length :])
    tensors = sorted(name for name in header if name != "__metadata__")
    match generator.choice(("header", "metadata", "values", "values", "remove", "rename", "reshape", "type")):
        case "header":
            header = next(damage.json_mutations(header, 1, generator.getrandbits(32)))
        case "metadata":
            changed = next(
                damage.json_mutations(header.get("__metadata__", {}), 1, generator.getrandbits(32))
            )
            if isinstance(changed, dict) and generator.random() < 0.8:  # the library wants texts
                changed = {
                    key: value if isinstance(value, str) else _text(value) for key, value in changed.items()
                }
            header["__metadata__"] = changed
        case "values" if len(data) >= 4:
            name = generator.choice(tensors)
            start, end = header[name]["data_offsets"]
            value = struct.pack("<f", generator.choice(FLOATS))
            if generator.random() < 0.3:  # the whole tensor
                data[start:end] = value * ((end - start) // 4)
            elif end - start >= 4:
                for _ in range(generator.choice((1, 1, 5))):
                    at = start + 4 * generator.randrange((end - start) // 4)
                    data[at : at + 4] = value
        case "remove":
            del header[generator.choice(tensors)]
            header, data = _packed(header, data)
        case "rename":
            name, other = generator.choice(tensors), generator.choice((*tensors, "extra", "", "é", "x" * 300))
            header[other + generator.choice(("", "", "_"))] = header.pop(name)
            header, data = _packed(header, data)
        case "reshape":
            entry = header[generator.choice(tensors)]
            count = math.prod(entry["shape"])
            shapes = [[count], [1, count], [count, 1], [1] * 20 + [count], [*entry["shape"], 1]]
            shapes += (
                [entry["shape"][::-1], [0], [max(entry["shape"][0] - 1, 0), *entry["shape"][1:]]]
                if (entry["shape"])
                else [[0]]
            )
            entry["shape"] = generator.choice(shapes)
            width = (entry["data_offsets"][1] - entry["data_offsets"][0]) // max(count, 1)
            entry["data_offsets"][1] = entry["data_offsets"][0] + width * math.prod(entry["shape"])
            header, data = _packed(header, data)
        case "type":
            entry = header[generator.choice(tensors)]
            entry["dtype"] = generator.choice(("I32", "U32", "F16", "BF16", "F64", "I64", "U8", "BOOL"))
            widths = {"I32": 4, "U32": 4, "F16": 2, "BF16": 2, "F64": 8, "I64": 8, "U8": 1, "BOOL": 1}
            size = widths[entry["dtype"]] * math.prod(entry["shape"])
            start = entry["data_offsets"][0]
            entry["data_offsets"][1] = start + size
            data += bytes(max(0, start + size - len(data)))
            header, data = _packed(header, data)
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    if isinstance(metadata, dict) and metadata.get("digest") and generator.random() < 0.5:
        metadata["digest"] = ""  # so that the other checks are reached
    try:
        text = damage.json_bytes(header)
    except (TypeError, ValueError):
        text = b"{}"
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + bytes(data)


def _glb(whole: bytes, generator: random.Random) -> bytes:
    """Another JSON, or other numbers, in a container whose lengths are right."""
    length = int.from_bytes(whole[12:16], "little")
    text, data = whole[20 : 20 + length], bytearray(whole[28 + length :])
    if generator.random() < 0.3:
        for _ in range(generator.choice((1, 1, 5))):
            struct.pack_into("<f", data, 4 * generator.randrange(len(data) // 4), generator.choice(FLOATS))
    else:
        text = _json(text, generator)
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(data)
    head = b"glTF" + struct.pack("<III", 2, total, len(text)) + b"JSON"
    return head + text + struct.pack("<I", len(data)) + b"BIN\0" + data


def _sog(whole: bytes, generator: random.Random) -> bytes:
    """One member of the zip is damaged, gone or has another name; the CRC of each is right."""
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = "meta.json" if generator.random() < 0.5 else generator.choice(sorted(members))
    match generator.choice(("damage",) * 8 + ("drop", "rename", "exchange")):
        case "damage" if name == "meta.json" and generator.random() < 0.8:
            members[name] = _sog_meta(members[name], generator)
        case "damage":
            members[name] = damaged(members[name], Path(name).suffix, generator)
        case "drop":
            del members[name]
        case "rename":
            members[generator.choice((" ", "../x", "x" * 300, "é"))] = members.pop(name)
        case "exchange":
            members[name] = members[generator.choice(sorted(members))]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", generator.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for name, raw in members.items():
            archive.writestr(name, raw)
    return file.getvalue()


def _sog_meta(whole: bytes, generator: random.Random) -> bytes:
    """Damaged elsewhere than in its codebooks, which are nearly all of its numbers."""
    content = json.loads(whole)
    books = {
        name: part.pop("codebook")
        for name, part in content.items()
        if isinstance(part, dict) and "codebook" in part
    }
    changed = next(damage.json_mutations(content, 1, generator.getrandbits(32)))
    if isinstance(changed, dict):
        for name, book in books.items():
            if isinstance(changed.get(name), dict):
                changed[name]["codebook"] = book
    try:
        return damage.json_bytes(changed)
    except (TypeError, ValueError):  # a number of more digits than Python writes
        return b"{}"


def _text(value: Any) -> str:
    """As metadata hold what is no text."""
    try:
        return json.dumps(value)
    except ValueError:
        return "9" * 400


def _packed(header: dict[str, Any], data: bytes | bytearray) -> tuple[dict[str, Any], bytearray]:
    """The tensors of ``header`` one after the other, as the library wants them."""
    packed, made = bytearray(), {}
    for name, entry in header.items():
        if name == "__metadata__":
            made[name] = entry
            continue
        start, end = entry["data_offsets"]
        made[name] = {**entry, "data_offsets": [len(packed), len(packed) + end - start]}
        packed += data[start:end].ljust(end - start, b"\0")
    return made, packed


def _png(whole: bytes, generator: random.Random) -> bytes:
    """Chunks are damaged, dropped, doubled; the CRC of each is right."""
    chunks, at = [], 8
    while at + 8 <= len(whole):
        (length,) = struct.unpack_from(">I", whole, at)
        chunks.append((whole[at + 4 : at + 8], whole[at + 8 : at + 8 + length]))
        at += 12 + length
    place = generator.randrange(len(chunks))
    kind, payload = chunks[place]
    match generator.choice(("payload", "payload", "payload", "pixels", "kind", "drop", "double")):
        case "payload":
            chunks[place] = kind, next(damage.mutations(payload, 1, generator.getrandbits(32)))
        case "pixels" if kind == b"IDAT":
            try:
                pixels = zlib.decompress(payload)
            except zlib.error:  # one of several chunks
                pixels = payload
            chunks[place] = kind, zlib.compress(next(damage.mutations(pixels, 1, generator.getrandbits(32))))
        case "kind":
            chunks[place] = generator.choice((b"IHDR", b"PLTE", b"tRNS", b"eXIf", b"iCCP", b"zTXt")), payload
        case "drop":
            del chunks[place]
        case "double":
            chunks.insert(place, chunks[place])
    return whole[:8] + b"".join(
        struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", zlib.crc32(kind + payload))
        for kind, payload in chunks
    )
