# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a small data set in the documented layout (docs/formats.md), by means independent of the reader."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
RELIT_LEVELS = (0.25, 4.0)
WIDTH, HEIGHT = 48, 36


def camera_to_world(index: int) -> np.ndarray:
    """A camera at (index, −5, 1) that looks along +Y."""
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    pose[:3, 3] = (float(index), -5.0, 1.0)
    return pose


def radiance(
    index: int, level: float = 1.0, lamp_level: float = 1.0, width: int = WIDTH, height: int = HEIGHT
) -> np.ndarray:
    """``[H, W, 3]`` float32: ambient light that scales with ``level`` and lamps with ``lamp_level``."""
    y, x = np.mgrid[0:height, 0:width]
    ambient = np.stack([0.2 + 0.01 * x, 0.3 + 0.01 * y, 0.2 + 0.02 * index + 0 * x], axis=-1)
    lamp = np.exp(-((x - width / 2) ** 2 + (y - height / 2) ** 2) / 8.0)[..., None] * (6.0, 4.0, 2.0)
    return (level * ambient + lamp_level * lamp).astype(np.float32)


def response(light: np.ndarray) -> np.ndarray:
    """The camera of HDR-NeRF-Syn: (x / (1 + x))^(1/2.2)."""
    return (light / (1.0 + light)) ** (1.0 / 2.2)


def to_8_bit(code: np.ndarray) -> np.ndarray:
    return np.round(np.clip(code, 0.0, 1.0) * 255.0).astype(np.uint8)


def write_exr(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": picture.astype(np.float32)}).write(str(path))


def write_split(root: Path, split: str, poses: dict[int, float], dotted_keys: bool) -> None:
    """Write one split; ``poses`` maps the pose's number to its lighting level."""
    frames, exposures = [], {}
    (root / split).mkdir(parents=True)
    for index, level in poses.items():
        frame = {
            "file_path": f"./{split}/r_{index}",
            "transform_matrix": camera_to_world(index).tolist(),
        }
        if split == "lit":
            frame["lighting_level"] = level
        frames.append(frame)
        picture = radiance(index, level)
        write_exr(root / f"{split}_hdr" / f"hdr_{index:03d}.exr", picture)
        for k, seconds in enumerate(EXPOSURES):
            code = to_8_bit(response(picture * seconds))
            rgba = np.dstack([code, np.full_like(code[..., :1], 255)])
            Image.fromarray(rgba).save(root / split / f"r_{index}_{k}.png")
            exposures[f"{'./' if dotted_keys else ''}{split}/r_{index}_{k}.png"] = seconds
    (root / f"transforms_{split}.json").write_text(
        json.dumps({"camera_angle_x": 0.8, "frames": frames}, indent=1), encoding="utf-8"
    )
    (root / f"exposure_{split}.json").write_text(json.dumps(exposures, indent=1), encoding="utf-8")


def write_points(path: Path) -> None:
    """Four points, binary, with normals, as ``synth`` writes them."""
    columns = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("nx", "f4"), ("ny", "f4"), ("nz", "f4")]
    columns += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    names = {"f4": "float", "u1": "uchar"}
    header = "".join(f"property {names[kind]} {name}\n" for name, kind in columns)
    points = np.zeros(4, dtype=[(name, "<" + kind) for name, kind in columns])
    points["x"], points["z"], points["red"], points["blue"] = (0, 1, 2, 3), 0.5, (0, 51, 102, 255), 255
    text = f"ply\nformat binary_little_endian 1.0\nelement vertex 4\n{header}end_header\n"
    path.write_bytes(text.encode() + points.tobytes())


def write_data_set(root: Path, original: bool = False) -> Path:
    """A data set of 3 training, 2 test and 2 lit poses; ``original``: as HDR-NeRF's authors left it."""
    write_split(root, "train", {0: 1.0, 2: 1.0, 4: 1.0}, dotted_keys=not original)
    write_split(root, "test", {1: 1.0, 3: 1.0}, dotted_keys=not original)
    if original:
        return root
    write_split(root, "lit", {0: 0.25, 1: 4.0}, dotted_keys=True)
    for level in RELIT_LEVELS:
        write_exr(root / "relit" / f"level_{level:g}" / "hdr_003.exr", radiance(3, level))
    write_points(root / "points3d.ply")
    info = {
        "format": "physhdr-dataset",
        "version": 1,
        "scene": "small",
        "resolution": [WIDTH, HEIGHT],
        "response": {"name": "reinhard-gamma", "anchor": [1.0, 0.5 ** (1.0 / 2.2)]},
        "exposures": list(EXPOSURES),
        "lighting_levels": {"lit": [0.25, 4.0], "relit": list(RELIT_LEVELS), "relit_views": [3]},
    }
    (root / "dataset.json").write_text(json.dumps(info), encoding="utf-8")
    return root
