# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without distortion on disk: kept once, made again where stale or damaged, safe to share."""

import json
import logging
import os
import shutil
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.scene import Scene, read_scene, undistorted
from physhdr.backend.scene.lens import Lens
from physhdr.bridge.errors import OutputError

BENT = {"k1": 0.08, "k2": -0.05}


@pytest.fixture
def bent(layouts: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    return layouts.write_nerfstudio(tmp_path / "data", **BENT)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """One entry for each picture that was made, not read."""
    calls: list[int] = []
    make = Lens.picture
    monkeypatch.setattr(Lens, "picture", lambda self, *codes: [make(self, *codes), calls.append(1)][0])
    return calls


def kept(root: Path) -> list[Path]:
    return sorted((root / ".physhdr" / "undistorted").glob("*"))


def pictures(scene: Scene) -> list[np.ndarray]:
    return [view.image(k) for view, k in scene.pictures()]


def test_a_picture_is_made_once(bent: Path, made: list[int]) -> None:
    first = pictures(read_scene(bent))
    assert len(made) == len(first) == len(kept(bent)) == 9
    again = pictures(read_scene(bent))
    assert len(made) == 9
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_nothing_is_written_before_a_picture_is_asked_for(bent: Path) -> None:
    scene = read_scene(bent)
    assert not (bent / ".physhdr").exists()
    (told,) = (message for message in scene.messages if "are cached in" in message)
    assert str(bent / ".physhdr" / "undistorted") in told and "9 pictures, 0 MB" in told
    assert "may be deleted" in told


def test_what_is_stale_is_made_again(layouts: ModuleType, bent: Path, made: list[int]) -> None:
    """Another picture, another lens, another size; the folder moved with all that is in it is not stale."""
    before = pictures(read_scene(bent))
    picture = bent / "images" / "frame_00000.png"
    Image.fromarray(255 - np.array(Image.open(picture))).save(picture)
    changed = read_scene(bent).train[0].image(0)
    assert len(made) == 10 and not np.array_equal(changed, before[0])
    content = json.loads((bent / "transforms.json").read_text())
    (bent / "transforms.json").write_text(json.dumps(content | {"k1": -0.08}))
    pictures(read_scene(bent))
    assert len(made) == 19
    assert len({path.name.split("-")[0] for path in kept(bent)}) == 9
    pictures(read_scene(bent, 2.0))
    assert len(made) == 28
    pictures(read_scene(bent.rename(bent.with_name("moved"))))
    assert len(made) == 28


def test_pictures_of_a_lens_of_one_size_replace_each_other(bent: Path) -> None:
    """The folder does not grow with every reconstruction."""
    content = json.loads((bent / "transforms.json").read_text())
    for k2 in (-0.05, -0.05001, -0.05002):
        (bent / "transforms.json").write_text(json.dumps(content | {"k2": k2}))
        pictures(read_scene(bent))
    assert len(kept(bent)) == 9


@pytest.mark.parametrize("harm", ["cut", "bit", "empty", "text", "folder", "bomb"])
def test_a_damaged_entry_is_made_again(bent: Path, made: list[int], harm: str) -> None:
    scene = read_scene(bent)
    right = scene.train[0].image(0)
    (entry,) = kept(bent)
    raw = bytearray(entry.read_bytes())
    if harm == "cut":
        entry.write_bytes(raw[: len(raw) // 2])
    elif harm == "bit":
        raw[len(raw) // 2] ^= 1
        entry.write_bytes(raw)
    elif harm == "empty":
        entry.write_bytes(b"")
    elif harm == "text":
        entry.write_text("no picture")
    elif harm == "folder":
        entry.unlink()
        entry.mkdir()
    else:
        entry.write_bytes(bytes(raw).replace(b'"shape": [', b'"shape": [9999999999'))
    np.testing.assert_array_equal(read_scene(bent).train[0].image(0), right)
    assert len(made) == 2


def test_masks_and_16_bits_are_kept_too(layouts: ModuleType, bent: Path, made: list[int]) -> None:
    store = undistorted.UndistortedPictures(bent, [bent / "kept"], bent / "kept")
    source = read_scene(bent).train[0].sources[0]
    rng = np.random.default_rng(0)
    for kind in (np.uint8, np.uint16):
        codes = rng.integers(0, np.iinfo(kind).max, (7, 5, 3), dtype=kind)
        for mask in (None, rng.random((7, 5)) > 0.5):
            store.save(source, undistorted.Decoded(codes, mask))
            found = store.load(source)
            assert found is not None and found.codes.dtype == kind
            np.testing.assert_array_equal(found.codes, codes)
            assert (mask is None) == (found.mask is None)
            if mask is not None:
                np.testing.assert_array_equal(found.mask, mask)


def test_a_folder_that_cannot_be_written(bent: Path, made: list[int], monkeypatch, tmp_path: Path) -> None:
    """The user's cache folder takes them; without that, memory alone, and both are told."""
    closed = [bent]
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: access(path, mode) and not any(Path(path) == c for c in closed)
    )
    scene = read_scene(bent)
    pictures(scene)
    users = tmp_path / "users" / "physhdr" / "undistorted"
    assert not (bent / ".physhdr").exists() and len(list(users.rglob("*.picture"))) == 9
    assert any(f"are cached in {users}" in message for message in scene.messages)
    pictures(read_scene(bent))
    assert len(made) == 9
    shutil.rmtree(users)
    closed += [tmp_path, tmp_path / "users", tmp_path / "users" / "physhdr"]
    scene = read_scene(bent)
    pictures(scene)
    assert len(made) == 18 and not users.exists() and not (bent / ".physhdr").exists()
    (told,) = (message for message in scene.messages if "undistorted again at each start" in message)
    assert told.count("cannot be written") == 2


def test_what_somebody_made_is_read_where_nothing_can_be_written(bent: Path, made, monkeypatch) -> None:
    pictures(read_scene(bent))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    pictures(read_scene(bent))
    assert len(made) == 9


def test_a_disk_that_is_nearly_full(bent: Path, made: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(1 << 40, (1 << 40) - 1000, 1000))
    scene = read_scene(bent)
    assert any(
        "undistorted again at each start" in m and "the disk has 0 MB left" in m for m in scene.messages
    )
    pictures(scene)
    assert not (bent / ".physhdr").exists()


def test_a_disk_that_becomes_full_is_told_once(bent: Path, made, monkeypatch, caplog) -> None:
    def full(path: Path, **options):
        del options
        raise OutputError(f"cannot write {path}: No space left on device", "Make room.")

    scene = read_scene(bent)
    monkeypatch.setattr(undistorted, "atomic_path", full)
    with caplog.at_level(logging.WARNING):
        assert len(pictures(scene)) == 9
    (record,) = caplog.records
    assert "No space left on device: pictures are undistorted again" in record.getMessage()


READ_ALL = """
import sys
from pathlib import Path
import numpy as np
from physhdr.backend.scene import read_scene
np.save(sys.argv[2], np.stack([view.image(k) for view, k in read_scene(Path(sys.argv[1])).pictures()]))
"""


@pytest.mark.long
def test_two_processes_at_once(bent: Path, tmp_path: Path) -> None:
    outs = [tmp_path / f"{k}.npy" for k in range(2)]
    processes = [subprocess.Popen([sys.executable, "-c", READ_ALL, str(bent), str(out)]) for out in outs]
    assert [process.wait(120) for process in processes] == [0, 0]
    right = np.stack(pictures(read_scene(bent)))
    for out in outs:
        np.testing.assert_array_equal(np.load(out), right)
    assert len(kept(bent)) == 9, "and nothing half is left"


def test_reading_one_is_not_slower_than_decoding_its_jpeg(layouts: ModuleType, tmp_path: Path) -> None:
    """A picture of a phone's proportions, of noise as a camera's, at JPEG quality 90."""
    rng = np.random.default_rng(0)
    photo = (120 + 40 * rng.standard_normal((960, 540, 3))).clip(0, 255).astype(np.uint8)
    pose = layouts.camera_to_world_opengl(0).tolist()
    (tmp_path / "images").mkdir()
    Image.fromarray(photo).save(tmp_path / "images" / "0001.jpg", quality=90)
    content = {"fl_x": 688.0, "w": 540, "h": 960, **BENT}
    frames = [{"file_path": "images/0001.jpg", "transform_matrix": pose}]
    (tmp_path / "transforms.json").write_text(json.dumps(content | {"frames": frames}))
    source = read_scene(tmp_path).train[0].sources[0]
    source.read()

    def seconds(action) -> float:
        times = []
        for _ in range(7):
            start = time.process_time()
            action()
            times.append(time.process_time() - start)
        return min(times)

    decoding = seconds(lambda: np.array(Image.open(source.path).convert("RGB")))
    assert seconds(source.read) < decoding
