# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF with Gaussians: what is written, read by hand and judged by Khronos; others' files, and bad ones."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.formats.gltf import EXTENSION, read_gltf, write_gltf
from physhdr.bridge import srgb
from physhdr.bridge.affine import matrices_of
from physhdr.bridge.errors import BadValueError, FileDamagedError, PhysHDRError
from physhdr.bridge.spherical_harmonics import basis, fibonacci_sphere
from physhdr.bridge.splat_files import read_splat_file, turned

HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def split(raw: bytes) -> tuple[dict, bytes]:
    """The JSON and the data of a GLB, by the container's own description."""
    assert struct.unpack("<4sII", raw[:12]) == (b"glTF", 2, len(raw))
    length, kind = struct.unpack("<I4s", raw[12:20])
    size, data = struct.unpack("<I4s", raw[20 + length : 28 + length])
    assert kind == b"JSON" and data == b"BIN\0" and len(raw) == 28 + length + size
    return json.loads(raw[20 : 20 + length]), raw[28 + length :]


def together(content: dict, data: bytes) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(data), b"BIN\0"), data
    return struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)) + b"".join(parts)


def values(content: dict, data: bytes, name: str) -> np.ndarray:
    """An attribute by the words of the specification, floats and 16-bit codes."""
    index = content["meshes"][0]["primitives"][0]["attributes"][name]
    accessor = content["accessors"][index]
    view = content["bufferViews"][accessor["bufferView"]]
    kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    found = np.frombuffer(data, kind, accessor["count"] * width, view["byteOffset"])
    assert found.nbytes == view["byteLength"] and view["byteOffset"] % 4 == 0
    return found.reshape(-1, width)


def assert_same(one, other, tolerance: float = 1e-6) -> None:
    for name in ("position", "scale", "opacity", "colour_sh"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=tolerance, atol=tolerance)
    turns = [c.rotation / np.linalg.norm(c.rotation, axis=1, keepdims=True) for c in (one, other)]
    np.testing.assert_allclose(*map(matrices_of, turns), atol=max(tolerance, 3e-6))


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
@pytest.mark.parametrize("space", ["srgb_rec709_display", "lin_rec709_display"])
def test_what_is_written_is_read(cloud, tmp_path: Path, name: str, space) -> None:
    write_gltf(tmp_path / name, cloud, space)
    read = read_gltf(tmp_path / name)
    assert_same(read.cloud, cloud, 0.0)
    assert read.color_space == space and read.cloud.up == "y"


def test_the_attributes_are_the_extensions(cloud, tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.glb", cloud)
    content, data = split((tmp_path / "a.glb").read_bytes())
    primitive = content["meshes"][0]["primitives"][0]
    assert content["extensionsUsed"] == [EXTENSION] and primitive["mode"] == 0
    assert primitive["extensions"][EXTENSION]["kernel"] == "ellipse"
    x, y, z, w = values(content, data, f"{EXTENSION}:ROTATION").T
    np.testing.assert_array_equal(np.stack([w, x, y, z], axis=1), cloud.rotation)
    position = values(content, data, "POSITION")
    accessor = content["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_array_equal(np.float32(accessor["min"]), position.min(axis=0))
    np.testing.assert_array_equal(np.float32(accessor["max"]), position.max(axis=0))
    # The specification's own sum for one coefficient of each degree, m from −l to l.
    terms = {"0_COEF_0": 0, "1_COEF_2": 3, "2_COEF_1": 5, "3_COEF_6": 15}
    for term, index in terms.items():
        found = values(content, data, f"{EXTENSION}:SH_DEGREE_{term}")
        np.testing.assert_array_equal(found, cloud.colour_sh[:, index])
    # Programs that know no Gaussians are given linear colours.
    plain = (0.2820947917738781 * cloud.colour_sh[:, 0].astype(np.float64) + 0.5).clip(0.0, 1.0)
    codes = values(content, data, "COLOR_0")
    np.testing.assert_allclose(codes[:, :3] / 65535.0, srgb.to_linear(plain), atol=1e-5)
    np.testing.assert_allclose(codes[:, 3] / 65535.0, cloud.opacity, atol=1e-5)


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_khronos_finds_nothing_wrong(cloud, tmp_path: Path, validated, name: str) -> None:
    """Version 2.0.0-dev.3.10 does not know the extension, so that its attributes' names are errors to it.

    All else of them it checks where they are called as those of applications are, beginning with "_".
    """
    write_gltf(tmp_path / name, cloud)
    issues = validated(tmp_path / name)["issues"]
    assert {each["code"] for each in issues["messages"] if each["severity"] < 2} == {
        "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
    }
    wrong = [each["pointer"] for each in issues["messages"] if each["severity"] < 2]
    assert all(f"/attributes/{EXTENSION}:" in pointer for pointer in wrong) and len(wrong) == 19
    if name == "a.glb":
        content, data = split((tmp_path / name).read_bytes())
        text = json.dumps(content).replace(f"{EXTENSION}:", "_")
        (tmp_path / "b.glb").write_bytes(together(json.loads(text), data))
        told = validated(tmp_path / "b.glb")
        assert told["issues"]["numErrors"] == told["issues"]["numWarnings"] == 0, told["issues"]
        assert told["info"]["totalVertexCount"] == cloud.count


def test_splat_transforms_file_is_its_source_in_gltfs_axes(files: Path) -> None:
    """It takes a PLY's axes for 3DGS's, and turns by half a turn about Z into glTF's."""
    source = read_splat_file(files / "source.ply")
    found = read_gltf(files / "gaussians.glb").cloud
    assert_same(found, turned(source, HALF_TURN), 1e-5)


def test_splat_transform_writes_what_we_write(cloud, tmp_path: Path, splat_transform, physhdr_ply) -> None:
    """Both make a GLB of one PLY; the attributes are the same numbers but for the axes."""
    physhdr_ply(tmp_path / "a.ply", cloud)
    splat_transform(tmp_path / "a.ply", tmp_path / "theirs.glb")
    write_gltf(tmp_path / "ours.glb", turned(cloud, HALF_TURN))
    assert_same(read_gltf(tmp_path / "theirs.glb").cloud, read_gltf(tmp_path / "ours.glb").cloud, 1e-5)


def test_integers_and_strides_are_read_as_the_specification_has_them(cloud, tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.glb", cloud)
    content, data = split((tmp_path / "a.glb").read_bytes())
    attributes = content["meshes"][0]["primitives"][0]["attributes"]

    def put(name: str, codes: np.ndarray, component: int, kind: str, stride: int) -> None:
        nonlocal data
        rows = np.zeros((len(codes), stride), np.uint8)
        rows[:, : codes[0].nbytes] = np.frombuffer(codes.tobytes(), np.uint8).reshape(len(codes), -1)
        content["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(data), "byteLength": rows.size, "byteStride": stride}
        )
        content["accessors"].append(
            {"bufferView": len(content["bufferViews"]) - 1, "componentType": component, "normalized": True}
            | {"count": len(codes), "type": kind}
        )
        attributes[name] = len(content["accessors"]) - 1
        data += rows.tobytes()

    x_y_z_w = cloud.rotation[:, [1, 2, 3, 0]]
    put(f"{EXTENSION}:ROTATION", np.rint(32767 * x_y_z_w).astype("<i2"), 5122, "VEC4", 12)
    put(f"{EXTENSION}:OPACITY", np.rint(255 * cloud.opacity)[:, None].astype("u1"), 5121, "SCALAR", 4)
    content["buffers"][0]["byteLength"] = len(data)
    (tmp_path / "b.glb").write_bytes(together(content, data))
    read = read_gltf(tmp_path / "b.glb").cloud
    np.testing.assert_allclose(read.rotation, cloud.rotation, atol=0.51 / 32767)
    np.testing.assert_allclose(read.opacity, cloud.opacity, atol=0.51 / 255)


def test_nodes_move_turn_and_scale(cloud, tmp_path: Path) -> None:
    """A parent that turns and a child that moves and scales, against the matrices' own product."""
    write_gltf(tmp_path / "a.glb", cloud)
    content, data = split((tmp_path / "a.glb").read_bytes())
    half = np.sqrt(0.5)
    content["nodes"] = [
        {"children": [1], "rotation": [0.0, 0.0, half, half]},
        {"mesh": 0, "translation": [1.0, 2.0, 3.0], "scale": [2.0, 2.0, 2.0]},
    ]
    (tmp_path / "b.glb").write_bytes(together(content, data))
    read = read_gltf(tmp_path / "b.glb").cloud
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        read.position, (2.0 * cloud.position + [1.0, 2.0, 3.0]) @ quarter.T, rtol=1e-5, atol=1e-5
    )
    np.testing.assert_allclose(read.scale, 2.0 * cloud.scale, rtol=1e-5)
    axes = quarter @ matrices_of(cloud.rotation)
    np.testing.assert_allclose(matrices_of(read.rotation), axes, atol=1e-5)
    # What is seen along a direction is seen along the turned direction afterwards.
    directions = fibonacci_sphere(20)
    before = np.einsum("dk,nkc->ndc", basis(directions, 3), cloud.colour_sh)
    after = np.einsum("dk,nkc->ndc", basis(directions @ quarter.T, 3), read.colour_sh)
    np.testing.assert_allclose(after, before, atol=1e-5)


# -- bad files -----------------------------------------------------------------------------------------------


@pytest.fixture
def spoilt(cloud, tmp_path: Path):
    """``spoilt(change)``: a GLB whose JSON ``change`` has changed."""

    def spoil(change) -> Path:
        write_gltf(tmp_path / "a.glb", cloud)
        content, data = split((tmp_path / "a.glb").read_bytes())
        change(content)
        (tmp_path / "b.glb").write_bytes(together(content, data))
        return tmp_path / "b.glb"

    return spoil


def accessor_of(content: dict, name: str) -> dict:
    return content["accessors"][content["meshes"][0]["primitives"][0]["attributes"][name]]


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda c: accessor_of(c, "POSITION").update(count=1 << 62), "count is"),
        (lambda c: accessor_of(c, "POSITION").update(count=1 << 39), "which are not there"),
        (lambda c: c["bufferViews"][0].update(byteStride=0), "which are not there"),
        (lambda c: c["bufferViews"][0].update(byteOffset=1 << 39), "which are not there"),
        (lambda c: c["nodes"][0].update(children=[0]), "in itself"),
        (lambda c: c["nodes"][0].update(matrix=[0.0] * 16), "flat"),
        (lambda c: c["nodes"][0].update(scale=[1.0, -1.0, 1.0]), "mirrors"),
        (lambda c: c["nodes"][0].update(mesh=[0]), "there is no meshes"),
        (lambda c: c["nodes"][0].update(mesh=7), "there is no meshes"),
        (lambda c: c["meshes"][0]["primitives"][0]["extensions"].clear(), "no Gaussians"),
        (lambda c: c["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"), "no POSITION"),
        (lambda c: c["buffers"][0].update(uri="../../../etc/passwd"), "not a file beside it"),
        (lambda c: c["buffers"][0].update(uri="file:///etc/passwd"), "not a file beside it"),
        (lambda c: c["asset"].update(version="1.0"), "version 2"),
    ],
)
def test_what_cannot_be_is_refused(spoilt, change, told: str) -> None:
    with pytest.raises(PhysHDRError, match=told) as caught:
        read_gltf(spoilt(change))
    assert caught.value.hint


def test_a_file_that_is_cut_off_is_refused_wherever(cloud, tmp_path: Path) -> None:
    write_gltf(tmp_path / "a.glb", replace(cloud, colour_sh=cloud.colour_sh[:, :1]))
    raw = (tmp_path / "a.glb").read_bytes()
    for size in [0, 3, 11, 19, 200, *range(300, len(raw), 997), len(raw) - 1]:
        (tmp_path / "b.glb").write_bytes(raw[:size])
        with pytest.raises(FileDamagedError):
            read_gltf(tmp_path / "b.glb")


def test_a_file_that_repeats_its_gaussians_for_ever_is_refused(spoilt) -> None:
    def repeat(content: dict) -> None:
        content["nodes"] = [{"mesh": 0} for _ in range(100_000)]
        content["scenes"][0]["nodes"] = list(range(100_000))

    with pytest.raises(BadValueError, match="repeats"):
        read_gltf(spoilt(repeat))
