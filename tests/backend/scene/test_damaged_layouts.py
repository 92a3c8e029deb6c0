# SPDX-License-Identifier: GPL-3.0-or-later
"""Each layout damaged in each way: one message that names the thing and the remedy."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from physhdr.backend.inspect import inspect
from physhdr.backend.scene import read_scene
from physhdr.backend.scene.colmap_model import read_model
from physhdr.bridge.errors import (
    BadValueError,
    DataMismatchError,
    FileDamagedError,
    FileMissingError,
    PhysHDRError,
)

Damage = Callable[[ModuleType, Path], object]
Case = tuple[str, Damage, type[PhysHDRError], tuple[str, ...]]


def edit(path: str, change: Callable[[dict], object]) -> Damage:
    """Change a JSON file."""

    def damage(_: ModuleType, root: Path) -> None:
        content = json.loads((root / path).read_text())
        change(content)
        (root / path).write_text(json.dumps(content))

    return damage


def write(path: str, content: bytes) -> Damage:
    return lambda _, root: (root / path).write_bytes(content)


def remove(path: str) -> Damage:
    return lambda _, root: (root / path).unlink()


def wrong_size(path: str) -> Damage:
    return lambda _, root: Image.new("RGB", (8, 9)).save(root / path)


def change_bytes(path: str, change: Callable[[bytes], bytes]) -> Damage:
    return lambda _, root: (root / path).write_bytes(change((root / path).read_bytes()))


def change_rows(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(_: ModuleType, root: Path) -> None:
        path = root / "poses_bounds_exps.npy"
        np.save(path, change(np.load(path)))

    return damage


def put(row: int, column: int, value: float) -> Damage:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[row, column] = value
        return rows

    return change_rows(change)


def sparse(**arguments) -> Damage:
    """Write the model of ``write_colmap`` again, otherwise."""
    images = {f"shot_{i:02d}_1.jpg": i for i in range(3)}
    return lambda layouts, root: layouts.write_sparse(root / "sparse" / "0", images, **arguments)


def strip_exif(names: str) -> Damage:
    def damage(layouts: ModuleType, root: Path) -> None:
        for path in (root / "images").glob(names):
            layouts.save(path, layouts.draw(int(path.stem[5:7]), int(path.stem[-1])))

    return damage


def frame(number: int, **entries) -> Damage:
    """Change a frame of transforms.json; None takes an entry away."""

    def change(content: dict) -> None:
        content["frames"][number] |= entries
        for key, value in entries.items():
            if value is None:
                del content["frames"][number][key]

    return edit("transforms.json", change)


REAL: list[Case] = [
    ("text", write("poses_bounds_exps.npy", b"no array"), FileDamagedError, ("not a readable array",)),
    ("empty", write("poses_bounds_exps.npy", b""), FileDamagedError, ("not a readable array",)),
    (
        "cut",
        change_bytes("poses_bounds_exps.npy", lambda raw: raw[:-8]),
        FileDamagedError,
        ("not a readable array",),
    ),
    (
        "bomb",
        change_bytes("poses_bounds_exps.npy", lambda raw: raw.replace(b"(6, 18), ", b"(999999999999, 18), ")),
        FileDamagedError,
        ("not a readable array",),
    ),
    (
        "pickle",
        lambda _, root: np.save(root / "poses_bounds_exps.npy", np.array([{}], dtype=object)),
        FileDamagedError,
        ("not a readable array",),
    ),
    ("LLFF's 17 columns", change_rows(lambda r: r[:, :17]), FileDamagedError, ("(6, 17)", "row of 18")),
    ("row missing", change_rows(lambda r: r[:-1]), DataMismatchError, ("5 rows", "6 pictures")),
    ("NaN", put(3, 5, np.nan), BadValueError, ("row 3", "NaN")),
    ("no exposure", put(4, 17, 0.0), BadValueError, ("row 4", "0 s", "longer than 0 s")),
    ("not rigid", put(1, 0, 5.0), BadValueError, ("pose 0", "not a rotation")),
    ("no focal length", put(1, 14, 0.0), BadValueError, ("pose 0", "focal length 0")),
    ("another shape", put(1, 4, 999.0), DataMismatchError, ("999", "another shape", "neither cropped")),
    ("no pictures", lambda _, r: (r / "input_images").rename(r / "x"), FileMissingError, ("input_images",)),
    ("picture missing", remove("input_images/001_2.jpg"), DataMismatchError, ("6 rows", "5 pictures")),
    ("name", lambda _, r: (r / "input_images/000_0.jpg").rename(r / "input_images/a.jpg"), DataMismatchError,
     ("a.jpg", "003_1.jpg")),
    ("none to train", lambda _, r: [change_rows(lambda rows: rows[3:])(_, r),
        *(p.unlink() for p in r.glob("input_images/000_*"))], DataMismatchError,
     ("no pose for training", "it has 001", "Copy the even poses")),
    ("no picture", write("input_images/001_2.jpg", b"jpeg"), FileDamagedError,
     ("001_2.jpg is not a readable",)),
    ("size", wrong_size("input_images/001_2.jpg"), DataMismatchError, ("001_2.jpg is 8×9", "one size")),
]  # fmt: skip

GAUSSHDR: list[Case] = [
    ("no model", remove("sparse/0/cameras.bin"), FileMissingError, ("cameras.bin is missing",)),
    ("picture missing", remove("images/train_r_2_3.png"), FileMissingError, ("train_r_2_3.png is missing",)),
    ("empty", write("images/train_r_2_3.png", b""), FileDamagedError, ("train_r_2_3.png is not a readable",)),
    ("size", wrong_size("images/train_r_2_3.png"), DataMismatchError, ("train_r_2_3.png is 8×9",)),
    ("no first", edit("exposure.json", lambda c: c.pop("test_r_1_0.png")), DataMismatchError,
     ("no exposure for 'test_r_1_0'", "exposure 0 must be there")),
    ("zero", edit("exposure.json", lambda c: c.update({"test_r_1_0.png": 0})), BadValueError,
     ("test_r_1_0.png", "0 s")),
    ("text", edit("exposure.json", lambda c: c.update({"test_r_1_0.png": "1/8"})), BadValueError,
     ("test_r_1_0.png", "'1/8'", "finite number")),
    ("huge", edit("exposure.json", lambda c: c.update({"test_r_1_0.png": 10**400})), BadValueError,
     ("test_r_1_0.png", "finite number")),
    ("no number", lambda L, r: [edit("exposure.json", lambda c: c.update({"train_new_0.png": 1.0}))(L, r),
        L.save(r / "images/train_new_0.png", L.draw(0, 0)), L.write_sparse(r / "sparse/0",
        {"train_r_0_0.png": 0, "train_new_0.png": 0})], DataMismatchError,
     ("'train_new' has no number", "images_hdr/", "as r_3")),
    ("no place", edit("exposure.json", lambda c: c.update({"train_r.png": 1})), DataMismatchError,
     ("'train_r.png'", "<pose>_<exposure>")),
    ("twice", edit("exposure.json", lambda c: c.update({"test_r_1_0.jpg": 1})), DataMismatchError,
     ("test_r_1_0.jpg", "same exposure of one pose")),
    ("outside", edit("exposure.json", lambda c: c.update({"../../train_r_1_0.png": 1})), BadValueError,
     ("../../train_r_1_0.png", "without '..'")),
    ("two of a pose",
     lambda L, r: L.write_sparse(r / "sparse/0", {"train_r_0_0.png": 0, "train_r_0_1.png": 1}),
     DataMismatchError, ("two pictures of the pose 'train_r_0'",)),
    ("no pose", lambda L, r: L.write_sparse(r / "sparse/0", {"train_r_9_0.png": 0}), DataMismatchError,
     ("no exposure for 'train_r_9_0'",)),
    ("none to train", lambda L, r: L.write_sparse(r / "sparse/0", {"test_r_1_0.png": 0}), DataMismatchError,
     ("'train' or 'test'", "none is for training")),
]  # fmt: skip

HDR_GS: list[Case] = [
    ("one number", lambda L, r: [(r / "images/1_0.png").rename(r / "images/b_0_0.png"),
        edit("exposure.json", lambda c: c.update({"b_0_0.png": 1.0}))(L, r),
        L.write_sparse(r / "sparse/0", {"0_0.png": 0, "b_0_0.png": 1})],
     DataMismatchError, ("'0', 'b_0' have one number, 0", "the number names the truth")),
    ("no number", lambda L, r: [(r / "images/1_0.png").rename(r / "images/b_0.png"),
        edit("exposure.json", lambda c: c.update({"b_0.png": 1.0}))(L, r),
        L.write_sparse(r / "sparse/0", {"0_0.png": 0, "b_0.png": 1})],
     DataMismatchError, ("'b' has no number", "exr/")),
]  # fmt: skip

COLMAP: list[Case] = [
    ("no lens", sparse(model="SIMPLE_RADIAL", params=(90.0, 48.0, 36.0, 40.0)), BadValueError,
     ("implausible", "SIMPLE_RADIAL 90, 48, 36, 40", "--camera")),
    ("panorama", sparse(model="EQUIRECTANGULAR", params=(96.0, 72.0)), BadValueError,
     ("camera 7", "360°", "views of 90°")),
    ("focal length", sparse(params=(-90.0, 90.0, 48.0, 36.0)), BadValueError,
     ("focal length of camera 7 is -90",)),
    ("NaN", sparse(params=(np.nan, 90.0, 48.0, 36.0)), FileDamagedError, ("cameras.bin", "nan")),
    ("another shape", sparse(size=(96, 96)), DataMismatchError, ("96×96", "96×72", "another shape")),
    ("cameras cut", change_bytes("sparse/0/cameras.bin", lambda raw: raw[:-1]), FileDamagedError,
     ("cameras.bin is damaged at byte", "too early")),
    ("images cut", change_bytes("sparse/0/images.bin", lambda raw: raw[:-1]), FileDamagedError,
     ("images.bin is damaged at byte",)),
    ("points cut", change_bytes("sparse/0/points3D.bin", lambda raw: raw[:-1]), FileDamagedError,
     ("points3D.bin is damaged at byte",)),
    ("left over", change_bytes("sparse/0/images.bin", lambda raw: raw + b"x"), FileDamagedError,
     ("images.bin is damaged", "1 bytes are left over")),
    ("unknown model",
     change_bytes("sparse/0/cameras.bin", lambda raw: raw[:12] + struct.pack("<i", 99) + raw[16:]),
     FileDamagedError, ("model number 99", "unknown")),
    ("no cameras", write("sparse/0/cameras.bin", struct.pack("<Q", 0)), DataMismatchError,
     ("has camera 7, which is not there",)),
    ("no pictures", write("sparse/0/images.bin", struct.pack("<Q", 0)), FileDamagedError, ("no pictures",)),
    ("pose", change_bytes("sparse/0/images.bin", lambda raw: raw[:12] + bytes(32) + raw[44:]),
     FileDamagedError, ("picture 1", "has the pose [0.0, 0.0, 0.0, 0.0")),
    ("picture twice", lambda L, r: (r / "sparse/0/images.bin").write_bytes(
        (r / "sparse/0/images.bin").read_bytes().replace(b"shot_01", b"shot_00")), DataMismatchError,
     ("'shot_00_1.jpg' twice",)),
    ("outside", lambda L, r: L.write_sparse(r / "sparse/0", {"../x.jpg": 0, "y.jpg": 1}), BadValueError,
     ("../x.jpg", "without '..'")),
    ("several", lambda L, r: [p.unlink() for p in r.glob("images/shot_0[01]*")], FileMissingError,
     ("2 of 5 pictures of the model have no picture that can be used", "shot_00_1.jpg is missing")),
    ("all damaged", lambda L, r: [p.write_bytes(b"JPEG") for p in r.glob("images/*")], FileDamagedError,
     ("9 of 9 pictures of the model", "shot_00_0.jpg is not a readable", "copy it again")),
    ("size", wrong_size("images/shot_02_0.jpg"), DataMismatchError, ("shot_02_0.jpg is 8×9",)),
    ("no exposures", strip_exif("*"), DataMismatchError, ("are named as brackets", "exposure.json")),
    ("some EXIF", strip_exif("*_2.jpg"), DataMismatchError,
     ("has no exposure time", "6 of 9 pictures", "exposure.json")),
    ("some ISO",
     lambda L, r: [L.save(p, L.draw(0, 2), exif=L.camera_exif(1.0, None)) for p in r.glob("images/*_2.jpg")],
     DataMismatchError, ("shot_00_2.jpg has no ISO", "6 of 9 pictures")),
    ("not stated", write("exposure.json", b'{"shot_00_0.jpg": 1, "shot_01_0.jpg": 1}'), DataMismatchError,
     ("no exposure for 'shot_02_0.jpg'",)),
]  # fmt: skip

NERFSTUDIO: list[Case] = [
    ("broken", write("transforms.json", b"{\n oops"), FileDamagedError, ("line 2", "Fix that line")),
    ("list", write("transforms.json", b"[]"), FileDamagedError, ("holds a list",)),
    ("no frames", edit("transforms.json", lambda c: c.pop("frames")), FileDamagedError, ("no 'frames'",)),
    ("empty", edit("transforms.json", lambda c: c.update(frames=[])), FileDamagedError,
     ("at least one frame",)),
    ("frame", edit("transforms.json", lambda c: c["frames"].append(3)), FileDamagedError,
     ("frame 3 is not an object",)),
    ("twice", edit("transforms.json", lambda c: c["frames"].append(c["frames"][0])), DataMismatchError,
     ("two frames have the picture",)),
    ("no pose", frame(1, transform_matrix=None), FileDamagedError, ("no 'transform_matrix'", "frame_00001")),
    ("scaled", frame(1, transform_matrix=(2.0 * np.eye(4)).tolist()), BadValueError, ("not a rotation",)),
    ("huge", edit("transforms.json", lambda c: c.update(w=10**400)), BadValueError, ("'w'", "finite number")),
    ("huge pose", frame(1, transform_matrix=[[10**400, 0, 0, 0]] * 4), BadValueError, ("not a 4×4 matrix",)),
    ("endless", write("transforms.json", b'{"w": ' + b"9" * 5000 + b"}"), FileDamagedError,
     ("transforms.json cannot be read as JSON",)),
    ("no number", lambda _, r: [(r / "test_hdr").mkdir(),
        (r / "images/frame_00001.png").rename(r / "images/a.png"),
        frame(1, file_path="images/a.png")(_, r)], DataMismatchError,
     ("'images/a' has no number", "test_hdr/")),
    ("no file", frame(1, file_path=None), FileDamagedError, ("no 'file_path'",)),
    ("outside", frame(1, file_path="/etc/passwd"), BadValueError, ("/etc/passwd", "without '..'")),
    ("missing", lambda L, r: [(r / f"images/frame_0000{k}.png").unlink() for k in (0, 2)], FileMissingError,
     ("2 of 3 frames have no picture", "frame_00000.png is missing")),
    ("no mask", frame(1, mask_path="masks/1.png"), FileMissingError,
     ("masks/1.png is missing", "remove 'mask_path' of frame 'images/frame_00001'")),
    ("EXIF of some", lambda L, r: [L.save(r / "images/1.jpg", L.draw(1, 0), exif=L.camera_exif(0.1)),
        frame(1, file_path="images/1.jpg")(L, r)], DataMismatchError,
     ("(1 of 3 pictures have)", "transforms.json an 'exposure_time'")),
    ("mask", frame(1, mask_path=3), BadValueError, ("'mask_path' is 3",)),
    ("mask outside", frame(1, mask_path="../1.png"), BadValueError, ("../1.png", "without '..'")),
    ("size", wrong_size("images/frame_00001.png"), DataMismatchError, ("frame_00001.png is 8×9",)),
    ("no lens", edit("transforms.json", lambda c: c.update(k1=-40.0)), BadValueError,
     ("implausible", "OPENCV", "-40")),
    ("k4", edit("transforms.json", lambda c: c.update(k4=0.01)), BadValueError,
     ("k4 = 0.01 without k5 and k6", "undistort")),
    ("panorama", edit("transforms.json", lambda c: c.update(camera_model="EQUIRECTANGULAR")), BadValueError,
     ("360°", "views of 90°")),
    ("model", edit("transforms.json", lambda c: c.update(camera_model="VR180_L")), BadValueError,
     ("camera model 'VR180_L'", "OPENCV_FISHEYE", "sparse/0")),
    ("distortion", edit("transforms.json", lambda c: c.update(k1="much")), BadValueError,
     ("'k1'", "'much'", "finite number")),
    ("no focal", edit("transforms.json", lambda c: [c.pop("fl_x"), c.pop("fl_y")]), FileDamagedError,
     ("no focal length", "camera_angle_x")),
    ("focal", edit("transforms.json", lambda c: c.update(fl_x=0)), BadValueError, ("'fl_x' is 0",)),
    ("angle", edit("transforms.json", lambda c: [c.pop("fl_x"), c.update(camera_angle_x=4)]), BadValueError,
     ("'camera_angle_x' is 4",)),
    ("shape", edit("transforms.json", lambda c: c.update(w=200)), DataMismatchError, ("200×72", "96×72")),
    ("some exposures", frame(1, exposure_time=0.5), DataMismatchError, ("no 'exposure_time', others have",)),
    ("bad exposure", edit("transforms.json", lambda c: [f.update(exposure_time=-1) for f in c["frames"]]),
     BadValueError, ("-1 s", "longer than 0 s")),
    ("list of names", edit("transforms.json", lambda c: c.update(train_filenames="x")), BadValueError,
     ("'train_filenames' is not a list",)),
    ("nothing to train", edit("transforms.json", lambda c: c.update(train_filenames=["x.png"])),
     DataMismatchError, ("no frame is in 'train_filenames'",)),
    ("nothing to test", edit("transforms.json", lambda c: c.update(test_filenames=["x.png"])),
     DataMismatchError, ("no frame is in 'test_filenames'",)),
    ("all to test", edit("transforms.json", lambda c: c.update(
        train_filenames=None, test_filenames=[f["file_path"] for f in c["frames"]])),
     DataMismatchError, ("no frame is left for training: all are in 'test_filenames'",)),
    ("both", edit("transforms.json", lambda c: c.update(
        train_filenames=["images/frame_00001.png"], val_filenames=["images/frame_00001.png"])),
     DataMismatchError, ("'images/frame_00001' is in 'train_filenames' and in 'val_filenames'",)),
    ("no points", edit("transforms.json", lambda c: c.update(ply_file_path="gone.ply")), FileMissingError,
     ("gone.ply is missing", "remove 'ply_file_path' from transforms.json")),
]  # fmt: skip


def parameters(writer: str, cases: list[Case], **arguments):
    kind = writer.removeprefix("write_")
    return [pytest.param(writer, arguments, *case[1:], id=f"{kind}: {case[0]}") for case in cases]


@pytest.mark.parametrize(
    ("writer", "arguments", "damage", "kind", "words"),
    [
        *parameters("write_real", REAL, poses=2, scale=1.0),
        *parameters("write_gausshdr", GAUSSHDR),
        *parameters("write_hdr_gs", HDR_GS, poses=2),
        *parameters("write_colmap", COLMAP, poses=3),
        *parameters("write_nerfstudio", NERFSTUDIO, poses=3),
    ],
)
def test_damage_is_named_with_a_remedy(
    layouts: ModuleType, tmp_path: Path, writer: str, arguments, damage: Damage, kind, words
) -> None:
    root = getattr(layouts, writer)(tmp_path / "data", **arguments)
    read_scene(root)
    damage(layouts, root)
    with pytest.raises(kind) as caught:
        read_scene(root)
    text = str(caught.value)
    for word in words:
        assert word in text, f"'{word}' is not in: {text}"
    assert caught.value.hint, f"no remedy in: {text}"


def test_inspect_names_what_the_reader_refuses(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_real(tmp_path / "odd", poses=2, scale=1.0)
    for path in root.glob("input_images/000_*"):
        path.unlink()
    change_rows(lambda rows: rows[3:])(layouts, root)
    assert "no pose for training" in " ".join(inspect(root).errors)


def test_exposures_of_hdr_gs_are_never_assumed(layouts: ModuleType, tmp_path: Path) -> None:
    root = layouts.write_hdr_gs(tmp_path / "dog", poses=2)
    (root / "exposure.json").unlink()
    with pytest.raises(DataMismatchError, match=r"nothing states their exposures[\s\S]*exposure.json"):
        read_scene(root)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_truncated_picture_is_found_by_the_time_it_is_decoded(
    layouts: ModuleType, tmp_path: Path, suffix
) -> None:
    root = layouts.write_gausshdr(tmp_path / "data", suffix=suffix)
    path = root / "images" / f"train_r_2_1.{suffix}"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileDamagedError, match=rf"train_r_2_1.{suffix} is not a readable"):
        read_scene(root).find("train", 2).image(1)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("seed", range(4))
def test_no_count_of_a_damaged_model_is_believed(layouts: ModuleType, tmp_path: Path, name, seed) -> None:
    """Huge counts at every place end in one message, at once; so does any other nonsense."""
    layouts.write_sparse(tmp_path, {"a.jpg": 0, "b.jpg": 1})
    path = tmp_path / f"{name}.bin"
    whole = path.read_bytes()
    for at in range(0, len(whole) - 8, 3):
        path.write_bytes(whole[:at] + struct.pack("<Q", (1 << 62) + seed) + whole[at + 8 :])
        try:
            read_model(tmp_path)
        except PhysHDRError as error:
            assert name in error.message and error.hint
    rng = np.random.default_rng(seed)
    for length in rng.integers(0, 200, 20):
        path.write_bytes(struct.pack("<Q", 1) + rng.bytes(int(length)))
        with pytest.raises(PhysHDRError):
            read_model(tmp_path)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("cameras.txt", "7 PINHOLE 96 72 90\n"),
        ("cameras.txt", "7 NONSENSE 96 72 90 90 48 36\n"),
        ("cameras.txt", "7\n"),
        ("images.txt", "1 1 0 0 0 0 0 0 7\n"),
        ("images.txt", "1 1 0 0 x 0 0 0 7 a.jpg\n\n"),
        ("images.txt", "1 1 0 0 0 0 0 0 7 a.jpg\n1.5 2.5\n"),
        ("points3D.txt", "1 0 0 0 255 255\n"),
        ("points3D.txt", "1 0 0 0 255 255 256 0.1\n"),
    ],
)
def test_lines_that_mean_nothing(layouts: ModuleType, tmp_path: Path, file: str, text: str) -> None:
    layouts.write_sparse(tmp_path, {"a.jpg": 0, "b.jpg": 1}, "txt")
    read_model(tmp_path)
    (tmp_path / file).write_text("# a comment\n" + text)
    with pytest.raises(FileDamagedError, match=rf"{file}: line 2 means nothing[\s\S]*COLMAP again"):
        read_model(tmp_path)
