# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp's kernels compiled for NVIDIA cards, on a machine that needs none, and what the CUBINs say of them.

Warp's wheel has NVRTC in it, NVIDIA's compiler. Registers, stack and shared memory of a kernel stand in the
CUBIN, an ELF file, in sections that NVIDIA's own tools print (``cuobjdump --dump-resource-usage``); those are
not in the wheel, so they are read here.
"""

import re
import struct
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from physhdr.backend.kernels.card import harmonics, networks, similarity
from physhdr.backend.rasterize.warp import arrays, projection, tiles

wp = arrays.wp

#: Turing, Ampere's data-centre and RTX 30 cards, RTX 40, Hopper, RTX 50.
ARCHITECTURES = (75, 80, 86, 89, 90, 120)

# Attributes in the section .nv.info: (symbol, value) pairs.
_ATTRIBUTES = {0x2F: "registers", 0x12: "stack", 0x11: "frame"}
_PAIR = 4  # form of an attribute whose value is a pair


@dataclass(frozen=True)
class Kernel:
    """One kernel in a CUBIN: registers a thread; bytes a thread of stack (spills are there); the block's
    shared memory and the code's size in bytes."""

    name: str
    registers: int
    stack: int
    shared: int
    code: int


def kernels_in(cubin: bytes) -> list[Kernel]:
    """What the sections of a CUBIN say of its kernels; raises ``ValueError`` if it is none."""
    if cubin[:4] != b"\x7fELF":
        raise ValueError("not an ELF file")
    (start,) = struct.unpack_from("<Q", cubin, 0x28)
    size, count, names_at = struct.unpack_from("<HHH", cubin, 0x3A)
    # name, type, flags, address, offset, size, link, info, alignment, entry size
    heads = [struct.unpack_from("<IIQQQQIIQQ", cubin, start + i * size) for i in range(count)]

    def text(table: int, at: int) -> str:
        begin = heads[table][4] + at
        return cubin[begin : cubin.index(b"\0", begin)].decode()

    sections = {text(names_at, head[0]): head for head in heads}
    symbols = sections[".symtab"]
    names = [
        text(symbols[6], struct.unpack_from("<I", cubin, at)[0])
        for at in range(symbols[4], symbols[4] + symbols[5], 24)
    ]
    found: dict[str, dict[str, int]] = {}
    at, end = sections[".nv.info"][4], sum(sections[".nv.info"][4:6])
    while at < end:
        form, attribute, length = struct.unpack_from("<BBH", cubin, at)
        at += 4
        if form == _PAIR:
            if attribute in _ATTRIBUTES and length == 8:
                symbol, value = struct.unpack_from("<II", cubin, at)
                found.setdefault(names[symbol], {})[_ATTRIBUTES[attribute]] = value
            at += length
    return [
        Kernel(
            name,
            values["registers"],
            max(values.get("stack", 0), values.get("frame", 0)),
            sections[f".nv.shared.{name}"][5] if f".nv.shared.{name}" in sections else 0,
            sections[f".text.{name}"][5],
        )
        for name, values in found.items()
        if "registers" in values
    ]


#: Networks of the presets: inputs, outputs, activation (response curves, fusion and composer, local curves).
NETWORKS = ((1, 1, 1), (6, 3, 0), (5, 1, 0))


def modules(channels: int) -> Iterator[tuple[str, int]]:
    """The rasteriser's Warp modules for so many channels, and the threads of a block of each."""
    yield projection.project.module.name, arrays.BLOCK
    yield tiles.draw_kernel(channels).module.name, arrays.BLOCK
    backward = tiles.draw_backward_kernel(channels).module.name
    yield backward, tiles.WARP
    yield backward, tiles.TILE_PIXELS


def other_modules() -> Iterator[tuple[str, int]]:
    """Those of ``backend.kernels.card``."""
    yield harmonics._evaluate.module.name, arrays.BLOCK
    yield similarity._along_rows.module.name, arrays.BLOCK
    for shape in NETWORKS:
        yield networks._kernels(*shape)[0].module.name, arrays.BLOCK


def compiled(module: str, block: int, architecture: int, folder: Path) -> list[Kernel]:
    """Compile a module for a card and read the CUBIN."""
    wp.get_module(module).options["block_dim"] = block
    into = folder / f"{module}_{block}"
    (path, *_) = wp.compile_aot_module(module, arch=architecture, module_dir=str(into), use_ptx=False)
    return kernels_in(Path(path).read_bytes())


def table(
    architectures: Sequence[int] = ARCHITECTURES, channels: Sequence[int] = (3, 6, 13, 32)
) -> Iterator[str]:
    """Markdown: of every kernel the registers on each card, and the stack and shared memory at most."""
    found: dict[tuple[str, int], list[Kernel]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for architecture in architectures:
            seen = list(dict.fromkeys(m for count in channels for m in modules(count))) + list(
                other_modules()
            )
            for module, block in seen:
                for kernel in compiled(module, block, architecture, Path(folder)):
                    name = re.sub(r"_[0-9a-f]{8}_cuda_kernel_forward$", "", kernel.name).split("__")[-1]
                    row = f"`{module.removeprefix('physhdr_')}`: {name}"
                    found.setdefault((row, block), []).append(kernel)
    yield "| module: kernel | block | " + " | ".join(f"sm_{a}" for a in architectures) + " | stack | shared |"
    yield "|---|---|" + "---|" * len(architectures) + "---|---|"
    for (row, block), kernels in found.items():
        registers = " | ".join(str(kernel.registers) for kernel in kernels)
        most = max(k.stack for k in kernels), max(k.shared for k in kernels)
        yield f"| {row} | {block} | {registers} | {most[0]} | {most[1]} |"
