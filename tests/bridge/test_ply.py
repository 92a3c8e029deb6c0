# SPDX-License-Identifier: GPL-3.0-or-later
"""Our reader of PLY against plyfile's, and against headers that were made to take for ever."""

import time
from pathlib import Path

import numpy as np
import plyfile
import pytest

from physhdr.bridge.errors import BadValueError, FileDamagedError
from physhdr.bridge.gaussian_ply import read_ply, write_standard_ply
from physhdr.bridge.ply import open_ply
from physhdr.bridge.ply_model import read_ply_model
from physhdr.bridge.regular import LONGEST_HEADER

TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")


def noise(count: int, types: tuple[str, ...] = TYPES) -> np.ndarray:
    """Rows of random bytes, of which a float is none that is NaN: text has one NaN for all of them."""
    rng = np.random.default_rng(3)
    table = np.empty(count, [(f"of_{kind}", kind) for kind in types])
    for kind in types:
        raw = rng.bytes(count * np.dtype(kind).itemsize)
        table[f"of_{kind}"] = np.nan_to_num(np.frombuffer(raw, kind))
    return table


def lists(count: int) -> np.ndarray:
    """Rows with a list of its own length each, between numbers."""
    table = np.empty(count, [("before", "f4"), ("seen", object), ("after", "u2")])
    for row in range(count):
        table[row] = (0.5 * row, np.arange(row % 4, dtype="i4"), row)
    return table


@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
def test_values_are_plyfiles(tmp_path: Path, text: bool, order: str, end: bytes) -> None:
    """Every number type and byte order, several elements, one with lists before another."""
    tables = {"first": noise(7), "lists": lists(9), "vertex": noise(5, TYPES[::-1]), "none": noise(0)}
    elements = [plyfile.PlyElement.describe(table, name) for name, table in tables.items()]
    path, comments = tmp_path / "a.ply", ["made by plyfile", " as  it is"]
    plyfile.PlyData(elements, text=text, byte_order=order, comments=comments).write(str(path))
    head, mark, rows = path.read_bytes().partition(b"end_header\n")
    path.write_bytes((head + mark).replace(b"\n", end) + (rows.replace(b"\n", end) if text else rows))
    expected = plyfile.PlyData.read(str(path))
    read = open_ply(path, "PLY", "")
    assert read.comments == expected.comments == comments
    assert list(read.elements) == list(tables)
    for name, table in read.elements.items():
        kept = [p.name for p in expected[name].properties if not isinstance(p, plyfile.PlyListProperty)]
        assert list(table.dtype.names or ()) == kept
        for column in kept:
            np.testing.assert_array_equal(table[column], expected[name][column], err_msg=f"{name} {column}")
            assert table.dtype[column].newbyteorder("=") == expected[name].data.dtype[column].newbyteorder(
                "="
            )


@pytest.mark.parametrize("text", [True, False])
def test_a_meshs_faces_are_left_out_and_its_vertices_lists_too(tmp_path: Path, text: bool) -> None:
    elements = [plyfile.PlyElement.describe(lists(3), name) for name in ("vertex", "face")]
    plyfile.PlyData(elements, text=text).write(str(tmp_path / "a.ply"))
    read = open_ply(tmp_path / "a.ply", "PLY", "")
    assert list(read.elements) == ["vertex"] and read.elements["vertex"]["after"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("name", ["numbers", "lists"])
def test_rows_that_are_cut_off(tmp_path: Path, order: str, name: str) -> None:
    table = noise(5) if name == "numbers" else lists(5)
    path = tmp_path / "a.ply"
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")], byte_order=order).write(str(path))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(
        FileDamagedError, match=r"a\.ply is not a readable PLY .(it claims 5 rows|unpack_from)"
    ):
        open_ply(path, "PLY", "")


def gaussians(count: int) -> dict[str, np.ndarray]:
    return {
        "positions": np.zeros((count, 3), np.float32),
        "rotations": np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        "scales": np.full((count, 3), 0.01, np.float32),
        "opacities": np.full(count, 0.5, np.float32),
        "colour_sh": np.zeros((count, 1, 3), np.float32),
    }


def with_header(path: Path, count: int, more: bytes, end: bytes = b"\n") -> Path:
    """A PLY of Gaussians with ``more`` after its format's line."""
    write_standard_ply(path, **gaussians(count))
    head, mark, rows = path.read_bytes().partition(b"end_header\n")
    head = head.replace(b" 1.0\n", b" 1.0\n" + more, 1) + mark
    path.write_bytes(head.replace(b"\n", end) + rows)
    return path


def test_a_letter_beyond_ascii_costs_no_time(tmp_path: Path) -> None:
    """100,000 Gaussians took 7 s, row by row."""
    path = with_header(tmp_path / "a.ply", 100_000, "comment Jürgen\n".encode())
    begun = time.perf_counter()
    read = read_ply(path)
    assert time.perf_counter() - begun < 2.0
    assert len(read.columns["x"]) == 100_000 and read.comments[0] == r"J\xfcrgen"


ROOM = LONGEST_HEADER - 2000
LONG = {
    "a comment": b"comment " + b"x" * ROOM + b"\n",
    "comments": b"comment x\n" * (ROOM // 10),
    "empty comments": b"comment\n" * (ROOM // 8),
    "axes": b"comment " + b"space: " * (ROOM // 7) + b"\n",
    "elements": b"".join(b"element a%d 0\n" % number for number in range(ROOM // 18)),
    "properties": b"element a 0\n"
    + b"".join(b"property char a%d\n" % number for number in range(ROOM // 23)),
}


@pytest.mark.parametrize(
    ("kind", "end"),
    [*((kind, b"\n") for kind in LONG), pytest.param("elements", b"\r", marks=pytest.mark.long)],
)
def test_a_long_header_is_read_in_seconds(tmp_path: Path, kind: str, end: bytes) -> None:
    """1 s a megabyte of comments, 24 s of 100,000 elements, and for ever of "space: space: …"."""
    path = with_header(tmp_path / "a.ply", 3, LONG[kind], end)
    begun = time.perf_counter()
    assert read_ply_model(path).model.count == 3
    assert time.perf_counter() - begun < 12.0


@pytest.mark.parametrize("end", [b"end_header\n", b""])
def test_a_header_of_more_than_two_megabytes_is_refused(tmp_path: Path, end: bytes) -> None:
    head = b"ply\nformat ascii 1.0\n" + b"comment x\n" * (LONGEST_HEADER // 10) + end
    (tmp_path / "a.ply").write_bytes(head)
    with pytest.raises(FileDamagedError, match="its header does not end within 2097152 bytes"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (b"plx\n", "does not begin with ply"),
        (b"ply format ascii 1.0\n", "its first line"),
        (b"ply\nelement vertex 1\nend_header\n", "the line 'element vertex 1'"),
        (b"ply\nend_header\n", "no format"),
        (b"ply\nformat ascii 2.0\nend_header\n", "the line 'format ascii 2.0'"),
        (b"ply\nformat ascii 1.0\nelement v -1\nend_header\n", "the line 'element v -1'"),
        (b"ply\nformat ascii 1.0\nproperty char x\nend_header\n", "the line 'property char x'"),
        (b"ply\nformat ascii 1.0\nelement v 1\nproperty odd x\nend_header\n", "field type 'odd'"),
        (b"ply\nformat ascii 1.0\nelement v 1\nelement v 2\nend_header\n", "same name"),
        (b"ply\nformat ascii 1.0\nelement v 1\nproperty char x\nproperty char x\nend_header\n1 1", "'x'"),
    ],
)
def test_a_header_that_is_none_says_which_line(tmp_path: Path, header: bytes, words: str) -> None:
    (tmp_path / "a.ply").write_bytes(header)
    with pytest.raises(FileDamagedError, match=words):
        open_ply(tmp_path / "a.ply", "PLY", "")


def test_no_header_is_written_that_could_not_be_read(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_standard_ply(path, **gaussians(3), comments=["x" * (LONGEST_HEADER - 2000)])
    assert len(read_ply(path).columns["x"]) == 3
    with pytest.raises(BadValueError, match=r"a header of 209\d{4} bytes"):
        write_standard_ply(path, **gaussians(3), comments=["x" * LONGEST_HEADER])
