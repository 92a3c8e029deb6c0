# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes small data sets in every layout, by means independent of the readers.

Three points of the world are seen as a red, a green and a blue spot, drawn where the plain pinhole formula
puts them: whoever misreads an axis, a quaternion or a principal point does not find them there.
"""

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image
from scipy.spatial.transform import Rotation

EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
WIDTH, HEIGHT = 96, 72
FX, FY, CX, CY = 90.0, 84.0, 50.0, 33.0
#: One point a colour channel, [3, 3], in the world's units.
POINTS = np.array([[0.1, 0.2, 0.0], [-0.7, 0.1, 0.45], [0.6, -0.3, -0.35]])
#: Standard deviation of a spot, and how much brighter than the background it is.
SPOT, PEAK = 2.0, 120.0


def world_to_camera(index: float) -> tuple[np.ndarray, np.ndarray]:
    """R and t of camera ``index``, OpenCV axes: it stands askew on a ring and looks near the origin."""
    angle = 0.25 * index - 0.6
    centre = np.array([3.0 * np.sin(angle), -3.0 * np.cos(angle), 0.4 + 0.1 * index])
    forward = np.array([0.05, 0.0, 0.02 * index]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.1, 0.05 * index, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def project(index: int, fx=FX, fy=FY, cx=CX, cy=CY) -> np.ndarray:
    """``[3, 2]``: where the points are in picture ``index``, pixels; the first pixel's centre is at ½."""
    rotation, translation = world_to_camera(index)
    x, y, z = rotation @ POINTS.T + translation[:, None]
    return np.stack([fx * x / z + cx, fy * y / z + cy], axis=1)


def background(k: int) -> int:
    return 10 + 20 * k


def draw(index: int, k: int, scale: float = 1.0, intrinsics=(FX, FY, CX, CY)) -> np.ndarray:
    """``[H, W, 3]`` uint8; ``k`` sets the background, so that each exposure can be told."""
    width, height = round(WIDTH * scale), round(HEIGHT * scale)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    picture = np.empty((height, width, 3))
    for channel, (u, v) in enumerate(project(index, *intrinsics) * scale):
        distance = ((x - u) ** 2 + (y - v) ** 2) / (SPOT * scale) ** 2
        picture[..., channel] = background(k) + PEAK * np.exp(-0.5 * distance)
    return np.round(picture).astype(np.uint8)


def spots(picture: np.ndarray, k: int) -> np.ndarray:
    """``[3, 2]``: the centre of gravity of each channel's spot, pixels."""
    y, x = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]] + 0.5
    light = np.clip(picture.astype(float) - background(k) - 8.0, 0.0, None)
    return np.stack([(light * x[..., None]).sum((0, 1)), (light * y[..., None]).sum((0, 1))], 1) / light.sum(
        (0, 1)
    ).reshape(3, 1)


def save(path: Path, picture: np.ndarray, alpha: bool = False, exif: dict[int, object] | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if alpha:
        picture = np.dstack([picture, np.full_like(picture[..., :1], 255)])
    options: dict = {"quality": 97, "subsampling": 0} if path.suffix == ".jpg" else {}
    if exif is not None:
        tags = Image.Exif()
        tags.get_ifd(0x8769).update(exif)
        options["exif"] = tags.tobytes()  # an Exif of inner tags alone counts as none for PNG and TIFF
    Image.fromarray(picture).save(path, **options)


def camera_exif(seconds: float, iso: int | None = 100, f_number: float | None = 8.0) -> dict[int, object]:
    """What a camera writes: ExposureTime, ISOSpeedRatings, FNumber."""
    tags: dict[int, object] = {0x829A: seconds}
    if iso is not None:
        tags[0x8827] = iso
    if f_number is not None:
        tags[0x829D] = f_number
    return tags


def write_truth(path: Path, value: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    picture = np.full((HEIGHT, WIDTH, 3), value, np.float32)
    OpenEXR.File(header, {"RGB": picture}).write(str(path))


# ---- COLMAP (its documentation, "Output Format") -----------------------------------------------------


def quaternion(rotation: np.ndarray) -> list[float]:
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return [w, x, y, z]


#: Model's name → number in the binary form.
MODELS = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 1,
    "SIMPLE_RADIAL": 2,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 5,
    "EQUIRECTANGULAR": 17,
}


def write_sparse(
    folder: Path,
    images: Mapping[str, float],
    form: str = "bin",
    model: str = "PINHOLE",
    params: tuple[float, ...] = (FX, FY, CX, CY),
    size: tuple[int, int] = (WIDTH, HEIGHT),
    observations: dict[str, int] | None = None,
) -> None:
    """COLMAP's three files; ``images``: name → camera of ``world_to_camera``; 2.1 is beside 2."""
    folder.mkdir(parents=True, exist_ok=True)
    observations = observations or {}
    colours = ((255, 0, 0), (0, 255, 0), (0, 0, 51))
    if form == "bin":
        camera = struct.pack("<QiiQQ", 1, 7, MODELS[model], *size)
        camera += struct.pack(f"<{len(params)}d", *params)
        (folder / "cameras.bin").write_bytes(camera)
        raw = struct.pack("<Q", len(images))
        for number, (name, index) in enumerate(images.items(), start=1):
            rotation, translation = world_to_camera(index)
            raw += struct.pack("<i7di", number, *quaternion(rotation), *translation, 7)
            raw += name.encode() + b"\0"
            seen = observations.get(name, 2)
            raw += struct.pack("<Q", seen + 1) + struct.pack("<ddq", 1.5, 2.5, 3) * seen
            raw += struct.pack("<ddq", 3.5, 4.5, -1)
        (folder / "images.bin").write_bytes(raw)
        raw = struct.pack("<Q", len(POINTS))
        for number, (point, colour) in enumerate(zip(POINTS, colours, strict=True)):
            raw += struct.pack("<Q3d3BdQ", number, *point, *colour, 0.7, number)
            raw += struct.pack("<ii", 1, 0) * number
        (folder / "points3D.bin").write_bytes(raw)
        return
    numbers = " ".join(f"{value!r}" for value in params)
    (folder / "cameras.txt").write_text(f"# Camera list\n7 {model} {size[0]} {size[1]} {numbers}\n")
    lines = ["# Image list with two lines of data per image:"]
    for number, (name, index) in enumerate(images.items(), start=1):
        rotation, translation = world_to_camera(index)
        pose = " ".join(repr(float(value)) for value in (*quaternion(rotation), *translation))
        seen = "1.5 2.5 3 " * observations.get(name, 2)
        lines += [f"{number} {pose} 7 {name}", f"{seen}3.5 4.5 -1" if number > 1 else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = ["# 3D point list"]
    for number, (point, colour) in enumerate(zip(POINTS, colours, strict=True)):
        place = " ".join(repr(float(value)) for value in point)
        lines.append(f"{number} {place} {' '.join(map(str, colour))} 0.7" + " 1 0" * number)
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")


# ---- layouts -----------------------------------------------------------------------------------------


def camera_to_world_opengl(index: int) -> np.ndarray:
    rotation, translation = world_to_camera(index)
    right, down, forward = rotation
    pose = np.eye(4)
    pose[:3] = np.stack([right, -down, -forward, -rotation.T @ translation], axis=1)
    return pose


def write_syn(root: Path, scale: float = 1.0, exposures=EXPOSURES) -> Path:
    """HDR-NeRF-Syn as it is downloaded: poses 0, 2, 4 for training, 1, 3 for testing."""
    angle = 2.0 * np.arctan(0.5 * WIDTH / FX)
    for split, poses in (("train", (0, 2, 4)), ("test", (1, 3))):
        frames, seconds = [], {}
        for index in poses:
            frames.append(
                {
                    "file_path": f"./{split}/r_{index}",
                    "transform_matrix": camera_to_world_opengl(index).tolist(),
                }
            )
            for k, t in enumerate(exposures):
                picture = draw(index, k, scale, (FX, FX, WIDTH / 2, HEIGHT / 2))
                save(root / split / f"r_{index}_{k}.png", picture, alpha=True)
                seconds[f"{split}/r_{index}_{k}.png"] = t
            write_truth(root / f"{split}_hdr" / f"hdr_{index:03d}.exr", 10.0 + index)
        (root / f"transforms_{split}.json").write_text(
            json.dumps({"camera_angle_x": angle, "frames": frames})
        )
        (root / f"exposure_{split}.json").write_text(json.dumps(seconds))
    return root


def write_nerf(root: Path, splits: Mapping[str, tuple[int, ...]] | None = None) -> Path:
    """NeRF's synthetic scenes: a picture a pose, of RGBA, the left eighth of which is transparent."""
    splits = splits or {"train": (0, 2, 4, 10), "val": (5,), "test": (1, 3)}
    for split, poses in splits.items():
        frames = []
        for index in poses:
            picture = draw(index, 0, 1.0, (FX, FX, WIDTH / 2, HEIGHT / 2))
            alpha = np.full_like(picture[..., :1], 255)
            alpha[:, : WIDTH // 8] = 0
            path = root / split / f"r_{index}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.dstack([picture, alpha])).save(path)
            pose = camera_to_world_opengl(index).tolist()
            frames.append({"file_path": f"./{split}/r_{index}", "rotation": 0.01, "transform_matrix": pose})
        content = {"camera_angle_x": 2.0 * float(np.arctan(0.5 * WIDTH / FX)), "frames": frames}
        (root / f"transforms_{split}.json").write_text(json.dumps(content))
    return root


def llff_row(index: int, seconds: float, scale: float = 1.0) -> np.ndarray:
    """A row of ``poses_bounds_exps.npy``: axes down, right, backwards; the principal point is the centre."""
    rotation, translation = world_to_camera(index)
    right, down, forward = rotation
    hwf = np.array([HEIGHT, WIDTH, FX]) * scale
    matrix = np.stack([down, right, -forward, -rotation.T @ translation, hwf], axis=1)
    return np.concatenate([matrix.ravel(), [1.5, 9.0, seconds]])


def write_real(root: Path, poses: int = 5, scale: float = 4.0) -> Path:
    """HDR-NeRF-Real; exposure 0 is the longest there."""
    exposures = (2.0, 0.5, 0.125)
    rows = []
    for index in range(poses):
        for k, t in enumerate(exposures):
            picture = draw(index, k, scale, (FX, FX, WIDTH / 2, HEIGHT / 2))
            save(root / "input_images" / f"{index:03d}_{k}.jpg", picture)
            rows.append(llff_row(index, t, scale))
    np.save(root / "poses_bounds_exps.npy", np.array(rows))
    return root


def write_gausshdr(
    root: Path,
    missing: dict[int, tuple[int, ...]] | None = None,
    suffix: str = "png",
    form: str = "bin",
    poses: int = 5,
) -> Path:
    """GaussHDR's packaging: even poses for training, ``missing``: pose → exposures that were not taken."""
    missing = missing or {}
    images, seconds = {}, {}
    for index in range(poses):
        split = ("train", "test")[index % 2]
        base = f"{split}_r_{index}"
        for k, t in enumerate(EXPOSURES):
            if k not in missing.get(index, ()):
                save(root / "images" / f"{base}_{k}.{suffix}", draw(index, k))
                seconds[f"{base}_{k}.{suffix}"] = t
        # The model may be of any exposure of a pose.
        images[f"{base}_{2 if index == 0 else 0}.{suffix}"] = index
        if suffix == "png":
            write_truth(root / "images_hdr" / f"{split}_hdr_{index:03d}.exr", 10.0 + index)
    write_sparse(root / "sparse" / "0", images, form)
    (root / "exposure.json").write_text(json.dumps(seconds))
    return root


def write_hdr_gs(root: Path, poses: int = 12) -> Path:
    """HDR-GS's packaging, to which the exposures were added."""
    seconds = {}
    for index in range(poses):
        for k, t in enumerate(EXPOSURES[:3]):
            save(root / "images" / f"{index}_{k}.png", draw(index, k))
            seconds[f"{index}_{k}.png"] = t
        write_truth(root / "exr" / f"{index}.exr", 10.0 + index)
    write_sparse(root / "sparse" / "0", {f"{index}_0.png": index for index in range(poses)})
    (root / "exposure.json").write_text(json.dumps(seconds))
    return root


def write_colmap(
    root: Path,
    *,
    poses: int = 10,
    registered: tuple[int, ...] = (1,),
    suffix: str = "jpg",
    form: str = "bin",
    exif: bool = True,
    **sparse,
) -> Path:
    """A user's brackets: ``images/shot_03_1.jpg``, of which the model has those of ``registered``."""
    images = {}
    for index in range(poses):
        for k, t in enumerate(EXPOSURES[:3]):
            name = f"shot_{index:02d}_{k}.{suffix}"
            save(root / "images" / name, draw(index, k), exif=camera_exif(t) if exif else None)
            if k in registered:
                images[name] = index
    write_sparse(root / "sparse" / "0", images, form, **sparse)
    return root


def write_nerfstudio(root: Path, poses: int = 9, masks: bool = False, **top) -> Path:
    """nerfstudio's ``transforms.json`` with the intrinsics at its top; ``top``: further entries there.

    ``masks``: each picture has one, all white.
    """
    frames = []
    for index in range(poses):
        save(root / "images" / f"frame_{index:05d}.png", draw(index, 0))
        pose = camera_to_world_opengl(index).tolist()
        frames.append({"file_path": f"images/frame_{index:05d}.png", "transform_matrix": pose})
        if masks:
            frames[-1]["mask_path"] = f"masks/frame_{index:05d}.png"
            save(root / frames[-1]["mask_path"], np.full((HEIGHT, WIDTH), 255, np.uint8))
    content = {"camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT}
    content |= {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY}
    content |= {"k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "frames": frames[::-1]} | top
    (root / "transforms.json").write_text(json.dumps(content))
    return root
