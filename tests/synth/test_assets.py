# SPDX-License-Identifier: GPL-3.0-or-later
"""Models from catalogues and folders: found by kind, fitted into their place, or an error that names them."""

import math
import zipfile
from pathlib import Path

import bpy
import pytest
from mathutils import Vector

from physhdr.synth.assets import Assets, _plain
from physhdr.synth.errors import AssetError

#: A wedge 2 wide (x), 4 high (y), 1 deep (z), its high edge at the back (−z): SH3D's front is +z.
WEDGE = """
mtllib wedge.mtl
o wedge
v 0 0 0
v 2 0 0
v 2 0 1
v 0 0 1
v 0 4 0
v 2 4 0
usemtl red
f 1 2 3 4
f 1 5 6 2
f 4 3 6 5
f 1 4 5
f 2 6 3
"""
MATERIALS = "newmtl red\nKd 0.8 0.1 0.1\n"


@pytest.fixture
def scene():
    made = bpy.data.scenes.new("room")
    yield made
    bpy.data.scenes.remove(made)


def catalogue(path: Path, name: str, licence: str, rotation: str = "", obj: str = WEDGE) -> None:
    lines = [f"license={licence}", f"name#1={name}", "model#1=/things/wedge/wedge.obj", "width#1=200"]
    if rotation:
        lines.append(f"modelRotation#1={rotation}")
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("PluginFurnitureCatalog.properties", "\n".join(lines))
        file.writestr("things/wedge/wedge.obj", obj)
        file.writestr("things/wedge/wedge.mtl", MATERIALS)
        file.writestr("../evil.txt", "must not be unpacked")


def vertices(scene) -> list[Vector]:
    scene.view_layers[0].update()
    found = [o.matrix_world @ v.co for o in scene.collection.all_objects for v in o.data.vertices]
    assert len(found) == 6
    return found


def never():
    raise AssertionError("there is a model: the stand-in must not be built")


def test_without_a_folder_the_stand_in_is_built(scene):
    assets, built = Assets(), []
    assets.place("sofa", scene.collection, (0, 0, 0), (1, 1, 1), 0.0, lambda: built.append(1))
    assert built == [1] and assets.used == {"sofa": "built-in"}


def test_a_model_is_fitted_turned_and_stood_on_its_foot(tmp_path, scene):
    catalogue(tmp_path / "a.sh3f", "Sofa", "Public domain")
    assets = Assets(tmp_path)
    assets.place("sofa", scene.collection, (5, 6, 1), (9.0, 9.0, 2.0), math.pi / 2, never)
    points = vertices(scene)
    # 4 high must fit into 2: half size, so 1 wide and 0.5 deep; turned by 90° the width lies along Y.
    for axis, (low, high) in enumerate([(4.75, 5.25), (5.5, 6.5), (1.0, 3.0)]):
        values = [point[axis] for point in points]
        assert min(values) == pytest.approx(low, abs=1e-5)
        assert max(values) == pytest.approx(high, abs=1e-5)
    top = [point for point in points if point.z > 2.9]
    assert all(point.x == pytest.approx(4.75, abs=1e-5) for point in top)  # it faces +X: its back is at −X
    assert assets.used == {"sofa": "a.sh3f:things/wedge/wedge.obj"}
    (item,) = scene.collection.all_objects
    assert tuple(item.active_material.diffuse_color)[:3] == pytest.approx((0.8, 0.1, 0.1), abs=0.2)
    assert not (tmp_path.parent / "evil.txt").exists()


def test_what_things_stand_on_fills_its_place(tmp_path, scene):
    catalogue(tmp_path / "a.sh3f", "Table", "CC0")
    Assets(tmp_path).place("table", scene.collection, (1, 1, 0), (3, 2, 0.7), 0.0, never, fill=True)
    points = vertices(scene)
    for axis, (low, high) in enumerate([(-0.5, 2.5), (0.0, 2.0), (0.0, 0.7)]):
        assert min(point[axis] for point in points) == pytest.approx(low, abs=1e-5)
        assert max(point[axis] for point in points) == pytest.approx(high, abs=1e-5)


def test_turn_zero_faces_the_camera_and_a_stated_rotation_is_applied(tmp_path, scene):
    catalogue(tmp_path / "a.sh3f", "Chair", "CC0", "1 0 0 0 0 1 0 -1 0")  # lies on its back edge: y ↔ z
    Assets(tmp_path).place("chair", scene.collection, (0, 0, 0), (2, 4, 1), 0.0, never)
    points = vertices(scene)
    height = max(point.z for point in points) - min(point.z for point in points)
    depth = max(point.y for point in points) - min(point.y for point in points)
    assert (height, depth) == pytest.approx((1.0, 4.0), abs=1e-5)


def test_public_domain_comes_first_and_single_files_before_catalogues(tmp_path, scene):
    catalogue(tmp_path / "a.sh3f", "Teddy bear", "CC-BY 3.0")
    catalogue(tmp_path / "b.sh3f", "Teddy bear", "Public domain")
    assets = Assets(tmp_path)
    assets.place("teddy", scene.collection, (0, 0, 0), (1, 1, 1), 0.0, never)
    assert assets.used["teddy"].startswith("b.sh3f")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "TeddyBear_2.obj").write_text(WEDGE)
    assets = Assets(tmp_path)
    assets.place("teddy", scene.collection, (0, 0, 0), (1, 1, 1), 0.0, never)
    assert assets.used["teddy"].endswith("TeddyBear_2.obj")


def test_names_of_files():
    assert [_plain(name) for name in ("TeddyBear_2", "sofa", "oak-chair 12")] == [
        "teddy bear",
        "sofa",
        "oak chair",
    ]


def test_errors_name_the_file(tmp_path, scene):
    with pytest.raises(AssetError, match="nowhere"):
        Assets(tmp_path / "nowhere")
    (tmp_path / "a.sh3f").write_bytes(b"PK no zip at all")
    with pytest.raises(AssetError, match=r"a\.sh3f"):
        Assets(tmp_path).place("sofa", scene.collection, (0, 0, 0), (1, 1, 1), 0.0, never)
    catalogue(tmp_path / "a.sh3f", "Sofa", "CC0", obj="o nothing\n")
    with pytest.raises(AssetError, match=r"wedge\.obj"):
        Assets(tmp_path).place("sofa", scene.collection, (0, 0, 0), (1, 1, 1), 0.0, never)
