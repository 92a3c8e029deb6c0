# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``make fuzz`` has found stays fixed: every case in ``tests/fixtures/fuzz`` is tried again.

What was found in binary USD, over which OpenUSD may end the process, is tried in another way below.
"""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from physhdr.backend.evaluate.camera_file import read_camera_file
from physhdr.backend.formats.gltf import EXTENSION, read_gltf, write_gltf
from physhdr.backend.formats.placed import moved
from physhdr.backend.formats.usd_stage import camera_of
from physhdr.backend.scene.camera import Camera
from physhdr.bridge.errors import BadValueError, FileDamagedError
from physhdr.bridge.regular import damaged_where_it_fails
from physhdr.bridge.splat_files import SplatCloud

ROOT = Path(__file__).resolve().parents[2]
FINDINGS = sorted((ROOT / "tests" / "fixtures" / "fuzz").glob("*.json"))
#: Large ones are made small before they are kept.
LARGEST = 50_000


@pytest.fixture(scope="module")
def told() -> dict[str, str]:
    """What the tool says of each case: one process tries them all, for any of them may kill it."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "stress" / "fuzz.py"), "--replay", *map(str, FINDINGS)],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    lines = [line.partition(".json: ") for line in done.stdout.splitlines() if ".json: " in line]
    return {f"{name}.json": outcome for name, separator, outcome in lines if separator}


@pytest.mark.long
@pytest.mark.parametrize("path", FINDINGS, ids=[path.stem for path in FINDINGS])
def test_a_case_that_was_found_is_answered(path: Path, told: dict[str, str]) -> None:
    """In one clear error, or it is understood: no crash, no hang, nothing that is none of ours."""
    assert path.stat().st_size < LARGEST
    assert told[path.name].startswith("right"), told[path.name]


def test_an_error_that_cannot_be_said_is_one_all_the_same() -> None:
    """OpenUSD's repeat a file's bytes, and fail at it where those are no UTF-8."""

    class UnsaidError(Exception):
        def __str__(self) -> str:
            return b"\x96".decode()

    told = pytest.raises(FileDamagedError, match=r"a\.usdc is torn \(UnsaidError\)")
    with told, damaged_where_it_fails("a.usdc is torn"):
        raise UnsaidError


STAGE = """#usda 1.0
(
    startTimeCode = 1
    endTimeCode = 2
)
def Camera "camera"
{
    float horizontalAperture.timeSamples = { 1: 36, 2: 36 }
    float verticalAperture = 24
    float horizontalApertureOffset = 3
}
"""


def cameras_of(folder: Path, text: str):
    (folder / "a.usda").write_text(text)
    return read_camera_file(folder / "a.usda", Camera.from_field_of_view(np.eye(4), 64, 48, 0.8))


def test_cameras_of_a_stage(tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="needs usd-core (the extra usd)")
    assert len(cameras_of(tmp_path, STAGE).frames) == 2


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("2: 36", "2: 0", "an aperture of 0×24"),
        ("2: 36", "2: nan", "an aperture of nan×24"),
        ("Aperture = 24", "Aperture = 1e30", "gives 1.77778e+30 rows of pixels"),
        ("Offset = 3", "Offset = 1e30", "the principal point at 1 is -1.77778e+30 pixels"),
    ],
)
def test_cameras_of_a_stage_that_nobody_could_draw(tmp_path: Path, old: str, new: str, told: str) -> None:
    pytest.importorskip("pxr", reason="needs usd-core (the extra usd)")
    assert STAGE.count(old) == 1
    with pytest.raises(BadValueError) as caught:
        cameras_of(tmp_path, STAGE.replace(old, new))
    assert told in str(caught.value) and "a.usda" in str(caught.value) and caught.value.hint


def test_a_camera_whose_values_openusd_cannot_unpack(tmp_path: Path, monkeypatch) -> None:
    """A damaged binary stage opens, and its values fail one by one."""
    geometry = pytest.importorskip("pxr.UsdGeom", reason="needs usd-core (the extra usd)")
    from pxr import Tf

    def damaged(*_) -> None:
        raise Tf.ErrorException("Attempted to unpack unsupported type enum value 0")

    monkeypatch.setattr(geometry.Camera, "GetCamera", damaged)
    (tmp_path / "a.usda").write_text(STAGE)
    with pytest.raises(
        FileDamagedError, match=r"no USD stage that can be read[^.]*unsupported type"
    ) as caught:
        camera_of(str(tmp_path / "a.usda"), None, 10, "Export it again.")  # in this process
    assert caught.value.hint


@pytest.mark.parametrize(
    ("extensions", "error", "message"),
    [
        (5, BadValueError, "compressed or changed by .*5"),
        (["EXT"], BadValueError, "compressed or changed by .*EXT"),
        ("EXT_\ud800", FileDamagedError, "surrogates not allowed"),
        ({"\ud800": {}}, FileDamagedError, "surrogates not allowed"),
    ],
)
def test_extensions_that_are_none_are_told(
    tmp_path: Path, extensions: object, error: type[Exception], message: str
) -> None:
    """In a GLB, whose JSON may hold halves of characters."""
    one = np.ones((1, 3), np.float32)
    cloud = SplatCloud(one, np.ones((1, 4), np.float32), one, one[:, 0], one[:, None])
    write_gltf(tmp_path / "a.gltf", cloud)
    content = json.loads((tmp_path / "a.gltf").read_text())
    content["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["extensions"] = extensions
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")
    (tmp_path / "a.glb").write_bytes(head + text)
    with pytest.raises(error, match=message) as caught:
        read_gltf(tmp_path / "a.glb")
    str(caught.value).encode("utf-8")


def test_ellipsoids_that_are_none_leave_a_node_as_they_came() -> None:
    """To be left out later, and the others are not touched by them."""
    rng = np.random.default_rng(0)
    count = 7
    rotation, scale = rng.standard_normal((count, 4)), rng.uniform(0.1, 1.0, (count, 3))
    rotation[1, 2], rotation[2] = np.nan, 3e38
    scale[3, 0], scale[4, 1], scale[5, 2] = np.nan, np.inf, -1.0
    arrays = (np.zeros((count, 3)), rotation, scale, np.ones(count), np.zeros((count, 1, 3)))
    cloud = SplatCloud(*(array.astype(np.float32) for array in arrays))
    matrix = np.diag([1.0, 2.0, 3.0, 1.0])
    found = moved(Path("a.glb"), cloud, matrix)
    assert np.isnan(found.scale).any(axis=1).tolist() == [False, True, False, True, True, True, False]
    whole = [0, 6]
    alone = moved(Path("a.glb"), SplatCloud(*(array.astype(np.float32)[whole] for array in arrays)), matrix)
    np.testing.assert_array_equal(found.rotation[whole], alone.rotation)
    np.testing.assert_array_equal(found.scale[whole], alone.scale)
    np.testing.assert_allclose(np.linalg.norm(found.rotation[2]), 1.0, rtol=1e-6)
