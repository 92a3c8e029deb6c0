# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians as PLY: the standard 3DGS layout for every viewer, and a lossless one with our own columns.

The standard layout is 3DGS's: one element ``vertex``, float32 ``x y z``, ``nx ny nz`` (zero), ``f_dc_0…2``,
``f_rest_*`` channel-major (all red, then green, then blue), ``opacity`` (logit), ``scale_0…2`` (natural
logarithm, metres), ``rot_0…3`` (wxyz). Its colour 0.28209479·f_dc + 0.5 + … is display-referred: scene-linear
radiance must be baked at an exposure before it comes here.

The lossless layout has the same columns first, so that viewers draw it, then the trained parameters as
``phys_…`` columns. What they mean stands in comment lines and, for programs that drop those, in the names of
further columns (``lossless_form``). We write binary little endian; whatever plyfile reads, we read (``ply``).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import plyfile

from .atomic import atomic_path
from .axes import Up
from .errors import BadValueError, DataMismatchError, FileDamagedError
from .lossless_form import form_columns
from .ply import Ply, open_ply
from .regular import LONGEST_HEADER, regular_file

#: The constant spherical harmonic Y_0, with the digits that 3DGS's viewers use.
SH_C0 = 0.28209479
#: What our own columns begin with, so that no other program's are taken for ours.
EXTRA_PREFIX = "phys_"
#: Opacities are kept this far from 0 and 1, where the logit is infinite: ±15.9 in float32.
OPACITY_MARGIN = 1.2e-7
#: A flat Gaussian's scale of 0, whose logarithm is infinite, is written as this, float32's smallest.
SMALLEST_SCALE = float(np.finfo(np.float32).tiny)
COLOUR_COMMENT = "colour = 0.28209479 * f_dc + 0.5 + higher SH, display-referred, floor at 0"
#: What a header says of the axes, by which is up; ``splat_files.standard_ply`` knows these lines again.
UP_WORDS: dict[Up, str] = {
    "z": "Z up (Blender's world)",
    "y": "Y up (glTF's axes)",
    "colmap": "Y down, Z forward (COLMAP's axes)",
}
SPACE_COMMENT = "space: metres, {}; rot_0..3 = w x y z; scale = ln(metres); opacity = logit"
#: f_rest columns of SH degree 0 to 3, and what they are together with f_dc.
REST_COUNTS = (0, 9, 24, 45)
REST_OF_DEGREE_4 = 72
#: Gaussians at a time where rows become columns: a block stays in the CPU's cache.
_BLOCK = 2048


@dataclass(frozen=True, eq=False)
class GaussianPly:
    """A PLY of Gaussians as it is on disk: ``columns`` in order, each ``[N]`` float32, and comment lines."""

    columns: dict[str, np.ndarray]
    comments: list[str] = field(default_factory=list)

    @property
    def extra(self) -> dict[str, np.ndarray]:
        """Our own columns, ``phys_…``."""
        return {name: column for name, column in self.columns.items() if name.startswith(EXTRA_PREFIX)}


def standard_names(sh_coefficients: int) -> list[str]:
    """The standard columns, in order, for K = ``sh_coefficients`` (1, 4, 9 or 16)."""
    rest = [f"f_rest_{i}" for i in range(3 * (sh_coefficients - 1))]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity"]
    return [*names, "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def standard_columns(
    positions: np.ndarray,
    rotations: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    colour_sh: np.ndarray,
) -> dict[str, np.ndarray]:
    """The standard columns, each ``[N]`` float32, from natural values.

    ``positions`` ``[N, 3]`` metres; ``rotations`` ``[N, 4]`` wxyz; ``scales`` ``[N, 3]`` standard deviations,
    metres, 0 where flat; ``opacities`` ``[N]`` 0…1; ``colour_sh`` ``[N, K, 3]`` display-referred, colour =
    SH_C0·sh_0 + 0.5 + higher. Raises ``DataMismatchError`` for shapes, ``BadValueError`` for values.
    """
    count = len(positions)
    shapes = {
        "positions": (positions, (count, 3)),
        "rotations": (rotations, (count, 4)),
        "scales": (scales, (count, 3)),
        "opacities": (opacities, (count,)),
    }
    for name, (array, shape) in shapes.items():
        if array.shape != shape:
            raise DataMismatchError(f"PLY export: {name} are {array.shape}, expected {shape}")
    if colour_sh.ndim != 3 or colour_sh.shape[0] != count or colour_sh.shape[2] != 3:
        raise DataMismatchError(f"PLY export: colour_sh is {colour_sh.shape}, expected ({count}, K, 3)")
    if colour_sh.shape[1] not in (1, 4, 9, 16):
        raise BadValueError(
            f"PLY export: {colour_sh.shape[1]} SH coefficients", "Viewers read degrees 0 to 3: 1, 4, 9 or 16."
        )
    if count and not (scales.min() >= 0.0 and opacities.min() >= 0.0 and opacities.max() <= 1.0):
        raise BadValueError(
            "PLY export: scales must be 0 or more and opacities in 0…1 (natural values, not log and logit)",
            "Apply the activations before exporting; NaN means that training diverged.",
        )
    # float64, so that the logarithm and logit are the nearest float32
    opacity = np.clip(opacities.astype(np.float64), OPACITY_MARGIN, 1.0 - OPACITY_MARGIN)
    # [N, K−1, 3] → [N, 3, K−1]: all coefficients of red, then green, then blue
    rest = colour_sh[:, 1:].transpose(0, 2, 1).reshape(count, 3 * (colour_sh.shape[1] - 1))
    blocks = [
        positions,
        np.zeros((count, 3)),
        colour_sh[:, 0],
        rest,
        np.log(opacity / (1.0 - opacity))[:, None],
        np.log(np.maximum(scales.astype(np.float64), SMALLEST_SCALE)),
        rotations,
    ]
    names = standard_names(colour_sh.shape[1])
    columns = [column for block in blocks for column in np.asarray(block).T]
    return {name: column.astype(np.float32) for name, column in zip(names, columns, strict=True)}


def write_standard_ply(
    path: Path,
    positions: np.ndarray,
    rotations: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    colour_sh: np.ndarray,
    comments: Sequence[str] = (),
    up: Up = "z",
) -> None:
    """Write the standard 3DGS PLY, atomically; arguments and errors as ``standard_columns``, ``OutputError``.

    ``comments``: lines for the header, such as the exposure and lighting level that were baked; ``up``: what
    is said there of the axes.
    """
    columns = standard_columns(positions, rotations, scales, opacities, colour_sh)
    _write(path, columns, [COLOUR_COMMENT, SPACE_COMMENT.format(UP_WORDS[up]), *comments])


def write_lossless_ply(
    path: Path,
    columns: Mapping[str, np.ndarray],
    extra: Mapping[str, np.ndarray],
    comments: Sequence[str] = (),
) -> None:
    """Write the standard ``columns`` (of ``standard_columns``), then ``extra`` ones, bit for bit, atomically.

    Each column is ``[N]``, float32; the names of ``extra`` begin with ``phys_``. ``comments`` say what
    the extra columns mean; what ``lossless_form`` knows of it is written as columns, too. Raises
    ``BadValueError``, ``DataMismatchError`` or ``OutputError``.
    """
    expected = standard_names(1 + sum(name.startswith("f_rest_") for name in columns) // 3)
    if list(columns) != expected:
        missing = sorted(set(expected) ^ set(columns)) or "in another order"
        raise DataMismatchError(
            f"PLY export: these standard columns are missing or unknown: {missing}", "Use standard_columns()."
        )
    for name in extra:
        if re.fullmatch(EXTRA_PREFIX + r"\w+", name, re.ASCII) is None:
            raise BadValueError(
                f"PLY export: '{name}' cannot be the name of an extra column",
                "Name it phys_… in letters and digits.",
            )
    saying = form_columns(comments, len(columns["x"]))
    _write(
        path, {**columns, **extra, **saying}, [COLOUR_COMMENT, SPACE_COMMENT.format(UP_WORDS["z"]), *comments]
    )


def _write(path: Path, columns: Mapping[str, np.ndarray], comments: Sequence[str]) -> None:
    count = len(columns["x"])
    for name, column in columns.items():
        if column.shape != (count,) or column.dtype != np.float32:
            raise DataMismatchError(
                f"PLY export: column '{name}' is {column.dtype} {column.shape}, expected float32 ({count},)"
            )
        if not np.isfinite(column).all():
            raise BadValueError(
                f"PLY export: column '{name}' holds NaN or infinity",
                "Use a checkpoint before training diverged.",
            )
    rows = np.empty((count, len(columns)), "<f4")
    for start in range(0, count, _BLOCK):
        block = slice(start, start + _BLOCK)
        rows[block] = np.stack([column[block] for column in columns.values()], axis=1)
    table = rows.reshape(-1).view([(name, "<f4") for name in columns])
    # A PLY header is ASCII, and a comment is one line of it.
    lines = [
        " ".join(line.split()).encode("ascii", "backslashreplace").decode("ascii")
        for comment in comments
        for line in comment.splitlines()
    ]
    element = plyfile.PlyElement.describe(table, "vertex")
    ply = plyfile.PlyData([element], text=False, byte_order="<", comments=[line for line in lines if line])
    if (size := len(ply.header)) >= LONGEST_HEADER:
        raise BadValueError(
            f"PLY export: a header of {size} bytes, of which readers take {LONGEST_HEADER}",
            "Its comment lines are too long: export a model.safetensors.",
        )
    with atomic_path(path) as temporary:
        ply.write(str(temporary))


def read_ply(path: Path) -> GaussianPly:
    """Read a standard or lossless PLY of Gaussians, ours or another program's; values as they are on disk.

    ASCII or binary of either byte order, columns of any number type, in any order, with or without normals
    and ``f_rest_*``; columns that we do not know are kept. Where a file has ``red green blue`` in place of
    ``f_dc_*`` (nerfstudio without SH), those are made from them: floats are colours of 0…1, whole numbers
    codes of 8 or 16 bits; where it has no ``scale_2`` (2DGS), that is ln 0; of SH degree 4 the highest band
    is left out. Raises ``FileMissingError``; ``FileDamagedError`` if it is no PLY, truncated, or holds no
    Gaussians.
    """
    return gaussians_in(Path(path), open_gaussians(Path(path)))


def open_gaussians(path: Path) -> Ply:
    """A PLY of Gaussians of any layout, compressed or not; raises what ``open_ply`` raises."""
    regular_file(path, "Check the path, or choose another PLY.")
    return open_ply(path, "PLY", "Copy or export it again: it may be cut off.")


def is_compressed(ply: Ply) -> bool:
    """Whether it is PlayCanvas' compressed layout, which ``splat_files.compressed_ply`` reads."""
    return "chunk" in ply.elements or any(
        "packed_position" in (table.dtype.names or ()) for table in ply.elements.values()
    )


def gaussians_in(path: Path, ply: Ply) -> GaussianPly:
    """The Gaussians of an opened PLY that is not compressed, as ``read_ply``; ``path`` is for messages."""
    if "vertex" not in ply.elements:
        raise FileDamagedError(f"{path} is not a PLY of Gaussians: it has no vertex element", _GAUSSIANS_HINT)
    if is_compressed(ply):
        raise FileDamagedError(
            f"{path} is a compressed PLY (PlayCanvas, SuperSplat): it has no columns of Gaussians",
            "Convert it: physhdr export IN OUT.ply",
        )
    vertex = ply.elements["vertex"]
    names: list[str] = [*(vertex.dtype.names or ())]
    _check_names(path, names)
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinite: its Gaussian is of no use
        columns = _columns(vertex)
    if "f_dc_0" not in columns:
        for index, name in enumerate(("red", "green", "blue")):
            unit = _unit_of(vertex.dtype[name])
            columns[f"f_dc_{index}"] = ((columns[name] / unit - 0.5) / SH_C0).astype(np.float32)
    if "scale_2" not in columns:
        columns["scale_2"] = np.full(len(columns["x"]), -np.inf, np.float32)
    return GaussianPly(_up_to_degree_3(columns), ply.comments)


_GAUSSIANS_HINT = (
    "Gaussians have x y z, f_dc_0…2, opacity, scale_0…2 and rot_0…3. For a mesh or a plain point cloud "
    "use Blender's own File > Import > Stanford PLY."
)


def _check_names(path: Path, names: list[str]) -> None:
    """Every column that a Gaussian needs is there."""
    have = set(names)
    colours = {"f_dc_0", "f_dc_1", "f_dc_2"}
    if {"red", "green", "blue"} <= have and not have & colours:
        have |= colours
    if {"scale_0", "scale_1", "rot_3"} <= have:
        have |= {"scale_2"}
    lacking = [n for n in standard_names(1) if n not in have and n not in ("nx", "ny", "nz")]
    if lacking:
        kind = ": is it a mesh or a plain point cloud?" if "opacity" in lacking else "."
        raise FileDamagedError(
            f"{path} is not a PLY of Gaussians: it has no {', '.join(lacking)}{kind}", _GAUSSIANS_HINT
        )
    rest = {name for name in names if re.fullmatch(r"f_rest_\d+", name)}
    if len(rest) not in (*REST_COUNTS, REST_OF_DEGREE_4) or rest != {
        f"f_rest_{index}" for index in range(len(rest))
    }:
        raise FileDamagedError(
            f"{path} is not a PLY of Gaussians of SH degree 0 to 3: it has {len(rest)} f_rest_ columns",
            "Those degrees have 0, 9, 24 or 45, numbered from 0.",
        )


def _unit_of(kind: np.dtype[Any]) -> float:
    """What stands for 1 in a column of colours: floats are colours as they are, other types 8 or 16 bits."""
    return 1.0 if kind.kind == "f" else 65535.0 if (kind.kind, kind.itemsize) == ("u", 2) else 255.0


def _up_to_degree_3(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``columns`` without the fourth band, channel by channel as they are."""
    if f"f_rest_{REST_OF_DEGREE_4 - 1}" not in columns:
        return columns
    kept = {name: column for name, column in columns.items() if not re.fullmatch(r"f_rest_\d+", name)}
    wide, narrow = REST_OF_DEGREE_4 // 3, REST_COUNTS[-1] // 3
    for index in range(REST_COUNTS[-1]):
        kept[f"f_rest_{index}"] = columns[f"f_rest_{wide * (index // narrow) + index % narrow}"]
    return kept


def _columns(table: np.ndarray[Any, Any]) -> dict[str, np.ndarray]:
    """The columns of a structured array, each a contiguous float32 ``[N]``."""
    names = table.dtype.names or ()
    if any(table.dtype[name] != np.dtype("<f4") for name in names):
        return {name: np.array(table[name], dtype=np.float32) for name in names}
    # One pass over the file by blocks of rows; column by column each pass would touch all of it.
    rows = np.ascontiguousarray(table).view("<f4").reshape(len(table), len(names))
    columns = np.empty((len(names), len(table)), np.float32)
    for start in range(0, len(table), _BLOCK):
        columns[:, start : start + _BLOCK] = rows[start : start + _BLOCK].T
    return dict(zip(names, columns, strict=True))
