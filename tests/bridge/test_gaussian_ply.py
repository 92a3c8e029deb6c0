# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY files of Gaussians, read back by a parser that knows only the format's own rules."""

import struct
from pathlib import Path

import numpy as np
import plyfile
import pytest

from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    OutputError,
)
from physhdr.bridge.gaussian_ply import (
    SH_C0,
    read_ply,
    standard_columns,
    standard_names,
    write_lossless_ply,
    write_standard_ply,
)

COUNT = 50


@pytest.fixture
def gaussians() -> dict[str, np.ndarray]:
    """50 Gaussians of SH degree 2, natural values, float32."""
    rng = np.random.default_rng(0)
    rotations = rng.normal(size=(COUNT, 4))
    arrays = {
        "positions": rng.normal(size=(COUNT, 3)),
        "rotations": rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        "scales": rng.lognormal(-4.0, 1.0, size=(COUNT, 3)),
        "opacities": rng.uniform(0.01, 0.99, size=COUNT),
        "colour_sh": rng.normal(size=(COUNT, 9, 3)),
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def parse(path: Path) -> tuple[list[str], dict[str, list[float]], list[str]]:
    """(names, values, comments) of a little-endian PLY of floats: an independent minimal parser."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    words = [line.split() for line in lines[2:]]
    (element,) = [line for line in words if line[0] == "element"]
    assert element[1] == "vertex"
    names = [line[2] for line in words if line[0] == "property"]
    assert all(line[1] in ("float", "float32") for line in words if line[0] == "property")
    rows = list(struct.iter_unpack(f"<{len(names)}f", body))
    assert len(rows) == int(element[2])
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]
    return names, {name: [row[i] for row in rows] for i, name in enumerate(names)}, comments


def test_the_standard_layout_column_by_column(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    path = tmp_path / "new" / "splat.ply"
    write_standard_ply(path, **gaussians, comments=["exposure 2 s", "level 1"])
    names, values, comments = parse(path)
    assert names == (
        ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
        + [f"f_rest_{i}" for i in range(24)]
        + ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    )
    for i, axis in enumerate("xyz"):
        np.testing.assert_array_equal(values[axis], gaussians["positions"][:, i])
        np.testing.assert_array_equal(values["n" + axis], 0.0)
        np.testing.assert_allclose(np.exp(values[f"scale_{i}"]), gaussians["scales"][:, i], rtol=1e-6)
    for i in range(4):
        np.testing.assert_array_equal(values[f"rot_{i}"], gaussians["rotations"][:, i])
    np.testing.assert_allclose(
        1 / (1 + np.exp(-np.array(values["opacity"]))), gaussians["opacities"], rtol=1e-6
    )
    for channel in range(3):
        np.testing.assert_array_equal(values[f"f_dc_{channel}"], gaussians["colour_sh"][:, 0, channel])
        for k in range(1, 9):  # channel-major: 8 of red, 8 of green, 8 of blue
            column = values[f"f_rest_{8 * channel + k - 1}"]
            np.testing.assert_array_equal(column, gaussians["colour_sh"][:, k, channel])
    assert comments[-2:] == ["exposure 2 s", "level 1"]
    assert any("display-referred" in line and "0.28209479" in line for line in comments)
    assert pytest.approx(0.5 / np.sqrt(np.pi), abs=1e-8) == SH_C0
    assert [file.name for file in path.parent.iterdir()] == ["splat.ply"], "no temporary file is left"


def test_round_trip_is_bit_exact(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    write_standard_ply(tmp_path / "a.ply", **gaussians)
    expected = standard_columns(**gaussians)
    read = read_ply(tmp_path / "a.ply")
    assert list(read.columns) == list(expected)
    for name, column in expected.items():
        assert column.tobytes() == read.columns[name].tobytes(), name


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_every_degree(gaussians: dict[str, np.ndarray], tmp_path: Path, coefficients: int) -> None:
    gaussians["colour_sh"] = np.ones((COUNT, coefficients, 3), np.float32)
    write_standard_ply(tmp_path / "a.ply", **gaussians)
    names, _, _ = parse(tmp_path / "a.ply")
    assert names == standard_names(coefficients) and len(names) == 14 + 3 * coefficients


def test_no_gaussians(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    write_standard_ply(tmp_path / "a.ply", **{name: array[:0] for name, array in gaussians.items()})
    assert len(read_ply(tmp_path / "a.ply").columns["x"]) == 0


def test_opacities_of_zero_and_one_stay_finite(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    gaussians["opacities"][:2] = (0.0, 1.0)
    write_standard_ply(tmp_path / "a.ply", **gaussians)
    opacity = read_ply(tmp_path / "a.ply").columns["opacity"]
    assert -17 < opacity[0] < -15 and 15 < opacity[1] < 17


def test_lossless_keeps_our_columns_after_the_standard_ones(
    gaussians: dict[str, np.ndarray], tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    extra = {f"phys_ambient_share_{i}": rng.normal(size=COUNT).astype(np.float32) * 10.0**i for i in range(3)}
    extra["phys_tiny"] = np.full(COUNT, 1e-42, np.float32)  # denormal: kept, too
    standard = standard_columns(**gaussians)
    comments = ["phys_ambient_share: s in 0..1", "scene Küche\nsecond line"]
    write_lossless_ply(tmp_path / "a.ply", standard, extra, comments)
    names, values, written = parse(tmp_path / "a.ply")
    assert names == [*standard, *extra]
    read = read_ply(tmp_path / "a.ply")
    assert list(read.extra) == list(extra)
    for name, column in {**standard, **extra}.items():
        assert column.tobytes() == read.columns[name].tobytes() == np.float32(values[name]).tobytes(), name
    assert written[-3:] == read.comments[-3:]
    assert written[-3:] == ["phys_ambient_share: s in 0..1", "scene K\\xfcche", "second line"]


# ---- bad input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("positions", np.nan, "column 'x' holds NaN"),
        ("colour_sh", np.inf, "column 'f_dc_0' holds NaN or infinity"),
        ("scales", -1.0, "scales must be 0 or more"),
        ("scales", np.nan, "scales must be 0 or more"),
        ("opacities", 1.5, "opacities in 0…1"),
    ],
)
def test_values_that_no_viewer_can_draw(
    gaussians: dict[str, np.ndarray], tmp_path: Path, name: str, value: float, words: str
) -> None:
    gaussians[name][(0,) * gaussians[name].ndim] = value
    with pytest.raises(BadValueError, match=words) as caught:
        write_standard_ply(tmp_path / "a.ply", **gaussians)
    assert caught.value.hint
    assert not list(tmp_path.iterdir()), "nothing is written"


def test_shapes_that_do_not_match(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    gaussians["scales"] = gaussians["scales"][:-1]
    with pytest.raises(DataMismatchError, match=r"scales are \(49, 3\), expected \(50, 3\)"):
        write_standard_ply(tmp_path / "a.ply", **gaussians)


def test_five_coefficients(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    gaussians["colour_sh"] = gaussians["colour_sh"][:, :5]
    with pytest.raises(BadValueError, match=r"5 SH coefficients\n.*degrees 0 to 3"):
        write_standard_ply(tmp_path / "a.ply", **gaussians)


def test_extra_columns_must_be_ours(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    standard = standard_columns(**gaussians)
    for name in ("share", "phys_", "phys_a b"):
        with pytest.raises(BadValueError, match=f"'{name}' cannot be the name"):
            write_lossless_ply(tmp_path / "a.ply", standard, {name: standard["x"]})
    with pytest.raises(DataMismatchError, match=r"'phys_a' is float64 \(50,\), expected float32"):
        write_lossless_ply(tmp_path / "a.ply", standard, {"phys_a": np.zeros(COUNT)})
    del standard["rot_3"]
    with pytest.raises(DataMismatchError, match=r"rot_3[\s\S]*standard_columns"):
        write_lossless_ply(tmp_path / "a.ply", standard, {})


@pytest.mark.parametrize("spoil", ["empty", "truncated", "text", "bomb", "ascii bomb"])
def test_damaged_ply(gaussians: dict[str, np.ndarray], tmp_path: Path, spoil: str) -> None:
    path = tmp_path / "a.ply"
    write_standard_ply(path, **gaussians)
    raw = path.read_bytes()
    damaged = {
        "empty": b"",
        "truncated": raw[:-7],
        "text": b"hello\n",
        "bomb": raw.replace(b"vertex 50\n", b"vertex 4000000000\n"),
        "ascii bomb": raw.replace(b"vertex 50\n", b"vertex 4000000000\n").replace(
            b"binary_little_endian", b"ascii"
        ),
    }
    path.write_bytes(damaged[spoil])
    with pytest.raises(FileDamagedError, match=r"a.ply is not a readable PLY[\s\S]*cut off"):
        read_ply(path)


def write_table(
    path: Path, names: list[str], types: str = "<f4", text: bool = False, order: str = "<"
) -> None:
    """A PLY of 3 vertices by plyfile itself, with those columns, all 0.25."""
    table = np.full(3, 0.25, dtype=np.dtype([(name, types) for name in names]))
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], text=text, byte_order=order).write(str(path))


def without(*names: str) -> list[str]:
    return [name for name in standard_names(4) if name not in names]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["x", "y", "z"], r"no f_dc_0.*opacity.*is it a mesh or a plain point cloud\?"),
        (["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"], "mesh or a plain point cloud"),
        ([n for n in standard_names(4) if n != "rot_3"], r"it has no rot_3\."),
        ([*without("f_dc_1", "f_dc_2"), "red", "green", "blue"], r"it has no f_dc_1, f_dc_2\."),
        ([*without("f_dc_0"), "red", "green", "blue"], r"it has no f_dc_0\."),
        ([n for n in standard_names(4) if n != "f_rest_8"], "8 f_rest_ columns"),
        ([*standard_names(4), "f_rest_11"], "10 f_rest_ columns"),
        (["packed_position", "packed_scale"], "compressed PLY.*it has no columns"),
    ],
)
def test_a_ply_of_something_else_says_what_it_may_be(tmp_path: Path, names: list[str], words: str) -> None:
    write_table(tmp_path / "a.ply", names)
    with pytest.raises(FileDamagedError, match=words) as caught:
        read_ply(tmp_path / "a.ply")
    assert "a.ply" in caught.value.message and caught.value.hint


def test_a_mesh_without_vertices_and_a_folder(tmp_path: Path) -> None:
    table = np.zeros(2, dtype=[("a", "<f4")])
    plyfile.PlyData([plyfile.PlyElement.describe(table, "face")]).write(str(tmp_path / "a.ply"))
    with pytest.raises(FileDamagedError, match="no vertex element"):
        read_ply(tmp_path / "a.ply")
    with pytest.raises(FileMissingError, match="is a folder"):
        read_ply(tmp_path)


@pytest.mark.parametrize(
    ("types", "text", "order"),
    [("<f4", True, "="), (">f4", False, ">"), ("<f8", False, "<"), (">f8", False, ">"), ("<f8", True, "=")],
)
@pytest.mark.parametrize("coefficients", [1, 16])
def test_every_container_and_number_type(
    tmp_path: Path, types: str, text: bool, order: str, coefficients: int
) -> None:
    names = [n for n in standard_names(coefficients) if n not in ("nx", "ny", "nz")]
    write_table(tmp_path / "a.ply", [*reversed(names), "confidence"], types, text, order)
    read = read_ply(tmp_path / "a.ply")
    assert set(read.columns) == {*names, "confidence"}
    for column in read.columns.values():
        assert column.dtype == np.float32 and column.flags.c_contiguous
        np.testing.assert_array_equal(column, 0.25)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("nan", np.nan),
        ("-nan(ind)", np.nan),
        ("nan(snan)", np.nan),
        ("-1.#IND", np.nan),
        ("1.#QNAN00", np.nan),
        ("1.#SNAN0e+000", np.nan),
        ("-inf", -np.inf),
        ("1.#INF", np.inf),
        ("-1.#INF00", -np.inf),
    ],
)
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("comment", ["#1 (of 2) 1.#INF", "Jürgen"])
def test_text_has_nan_and_infinity_as_every_c_library_writes_them(
    tmp_path: Path, word: str, value: float, end: bytes, comment: str
) -> None:
    write_table(tmp_path / "a.ply", standard_names(1), text=True)
    head, end_header, rows = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    first, rest = rows.split(b"\n", 1)
    odd = b" ".join([word.encode(), *first.split()[1:-1], word.encode()])
    head = head.replace(b"element", f"comment {comment}\nelement".encode())
    raw = head + end_header + odd + b"\n" + rest
    (tmp_path / "a.ply").write_bytes(raw.replace(b"\n", end))
    read = read_ply(tmp_path / "a.ply")
    for name, column in read.columns.items():
        odd_one = value if name in ("x", "rot_3") else 0.25
        np.testing.assert_array_equal(column, [odd_one, 0.25, 0.25], err_msg=name)
    # In the header nothing but letters beyond ASCII is changed.
    assert read.comments == [comment.encode("ascii", "backslashreplace").decode()]


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "1.#INF"])
def test_the_last_word_of_a_text_needs_no_end_of_line(tmp_path: Path, word: str) -> None:
    write_table(tmp_path / "a.ply", standard_names(1), text=True)
    raw = (tmp_path / "a.ply").read_bytes().rstrip()
    (tmp_path / "a.ply").write_bytes(raw[: raw.rindex(b" ") + 1] + word.encode())
    assert not np.isfinite(read_ply(tmp_path / "a.ply").columns["rot_3"][-1])


def test_bytes_of_a_binary_file_are_no_words(tmp_path: Path) -> None:
    """Three floats can be the letters of a NaN."""
    write_table(tmp_path / "a.ply", standard_names(1))
    raw = (tmp_path / "a.ply").read_bytes()
    head, end, rows = raw.partition(b"end_header\n")
    letters = b"-nan(ind) 11"
    (tmp_path / "a.ply").write_bytes(
        head + b"comment format ascii 1.0\n" + end + letters + rows[len(letters) :]
    )
    read = read_ply(tmp_path / "a.ply")
    assert np.stack([read.columns[axis][0] for axis in "xyz"]).tobytes() == letters


def test_plain_colours_in_place_of_f_dc(tmp_path: Path) -> None:
    """nerfstudio without SH."""
    names = [n for n in standard_names(1) if not n.startswith("f_dc")]
    table = np.zeros(1, dtype=[*((n, "<f4") for n in names), *((c, "u1") for c in ("red", "green", "blue"))])
    table["red"], table["blue"] = 255, 51
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")]).write(str(tmp_path / "a.ply"))
    columns = read_ply(tmp_path / "a.ply").columns
    colour = [0.5 + SH_C0 * columns[f"f_dc_{c}"][0] for c in range(3)]
    np.testing.assert_allclose(colour, [1.0, 0.0, 0.2], atol=1e-6)


@pytest.mark.parametrize(("kind", "codes"), [("<f4", (1.0, 0.0, 0.2)), (">u2", (65535, 0, 13107))])
def test_plain_colours_are_as_wide_as_their_type(tmp_path: Path, kind: str, codes: tuple[float, ...]) -> None:
    names = [n for n in standard_names(1) if not n.startswith("f_dc")]
    channels = ("red", "green", "blue")
    table = np.zeros(1, dtype=[*((n, ">f4") for n in names), *((channel, kind) for channel in channels)])
    for channel, code in zip(channels, codes, strict=True):
        table[channel] = code
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], byte_order=">").write(str(tmp_path / "a.ply"))
    columns = read_ply(tmp_path / "a.ply").columns
    colour = [0.5 + SH_C0 * columns[f"f_dc_{c}"][0] for c in range(3)]
    np.testing.assert_allclose(colour, [1.0, 0.0, 0.2], atol=1e-6)


def test_missing_ply(tmp_path: Path) -> None:
    with pytest.raises(FileMissingError, match=r"gone.ply is missing\n.*Check the path"):
        read_ply(tmp_path / "gone.ply")


def test_a_folder_in_the_way(gaussians: dict[str, np.ndarray], tmp_path: Path) -> None:
    (tmp_path / "a.ply").mkdir()
    with pytest.raises(OutputError, match=r"a.ply: a folder is there\n.*another file name"):
        write_standard_ply(tmp_path / "a.ply", **gaussians)


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_other_programs_write_the_letters_of_a_users_folder(tmp_path: Path, gaussians, encoding: str) -> None:
    """A header is ASCII by the format, and plyfile refuses what is not."""
    plain = tmp_path / "plain.ply"
    write_standard_ply(plain, **gaussians, comments=["made in C:/Users/Juergen"])
    raw = plain.read_bytes()
    named = tmp_path / "named.ply"
    named.write_bytes(raw.replace(b"Juergen", "Jürgen".encode(encoding)))
    read, expected = read_ply(named), read_ply(plain)
    for name, column in expected.columns.items():
        np.testing.assert_array_equal(read.columns[name], column)
    assert read.comments[-1] == r"made in C:/Users/J\xfcrgen"
    named.write_bytes(named.read_bytes()[:-10])
    with pytest.raises(FileDamagedError):
        read_ply(named)
