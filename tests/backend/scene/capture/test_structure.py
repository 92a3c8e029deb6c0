# SPDX-License-Identifier: GPL-3.0-or-later
"""Which photos share a camera, and which reconstructions belong to photos that EXIF turns."""

import numpy as np
import pytest

from physhdr.backend.scene.capture import structure
from physhdr.backend.scene.capture.brackets import Bracket
from physhdr.backend.scene.capture.photos import find_photos
from physhdr.bridge.errors import DataMismatchError


def test_digitally_zoomed_photos_have_a_camera_of_their_own(room, tmp_path, monkeypatch):
    """One size and one focal length, but every other photo was cropped and enlarged to its size."""
    photos, work, jobs = tmp_path / "photos", tmp_path / "work", []
    for folder in (photos, work):
        folder.mkdir()
    for k in range(4):
        zoom = 1 + k % 2
        more = {"FocalLength": 6.8, "FocalLengthIn35mmFilm": 24 * zoom, "DigitalZoomRatio": zoom}
        room.write_photo(photos / f"{k}.jpg", np.full((20, 30, 3), 90, np.uint8), **more)

    def instead_of_colmap(job, *_, **__):
        jobs.append(job)
        (work / "pieces.json").write_text("[]")

    monkeypatch.setattr(structure, "run_colmap", instead_of_colmap)
    with pytest.raises(structure.StructureError):
        structure.recover(dict(enumerate(find_photos(photos).photos)), work, "PINHOLE")
    groups = jobs[0]["groups"]
    assert [group["names"] for group in groups] == [
        ["0/00000.png", "0/00002.png"],
        ["1/00001.png", "1/00003.png"],
    ]
    focal = [float(group["camera_params"].split(",")[0]) for group in groups]
    assert focal == pytest.approx([24 / 36 * 30, 48 / 36 * 30])  # film is 36 mm wide, the pictures 30 pixels


def reconstruction_of(room, folder, orientation, stored, seen):
    """Of three photos of ``stored`` pixels, of which COLMAP saw ``seen``: width, height."""
    (folder / "photos").mkdir()
    images = []
    for k in range(3):
        pixels = np.full((stored[1], stored[0], 3), 90, np.uint8)
        room.write_photo(folder / "photos" / f"{k}.jpg", pixels, Orientation=orientation)
        images.append(f"{k + 1} 1 0 0 0 {k} 0 0 1 {k}.jpg\n\n")
    width, height = seen
    (folder / "cameras.txt").write_text(f"1 PINHOLE {width} {height} 30 30 {width / 2} {height / 2}\n")
    (folder / "images.txt").write_text("".join(images))
    (folder / "points3D.txt").write_text("")
    photos = find_photos(folder / "photos").photos
    return structure.existing(folder, [Bracket(photo.path.stem, (photo,), (1.0,)) for photo in photos])


@pytest.mark.parametrize("orientation", range(2, 9))
def test_photos_that_may_have_been_seen_another_way_up_are_refused(room, tmp_path, orientation):
    """Of square ones no size tells a turn, of others not that by 180° nor a mirror."""
    stored = (30, 30) if orientation > 4 else (30, 20)
    with pytest.raises(DataMismatchError, match=r"EXIF turns 3 of 3 photos.*: 0\.jpg, 1\.jpg") as caught:
        reconstruction_of(room, tmp_path, orientation, stored, stored)
    assert "COLMAP does not obey EXIF's orientation" in caught.value.hint and "--poses" in caught.value.hint


def test_sizes_tell_of_a_quarter_turn(room, tmp_path):
    for name in ("upright", "stored"):
        (tmp_path / name).mkdir()
    assert len(reconstruction_of(room, tmp_path / "upright", 6, (30, 20), (20, 30)).registered) == 3
    with pytest.raises(DataMismatchError, match="of pictures of 30×20, the photos are 20×30"):
        reconstruction_of(room, tmp_path / "stored", 6, (30, 20), (30, 20))
