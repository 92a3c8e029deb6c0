# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set of a few Gaussians, small enough to train on in seconds, written in the documented layout.

Its truth is known in closed form: radiance(levels) = fixed + Σ level · light, response (x/(1+x))^(1/2.2).
"""

import json
import math
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from plyfile import PlyData, PlyElement

from physhdr.backend.rasterize.reference import rasterize
from physhdr.backend.scene.camera import Camera
from physhdr.backend.scene.pictures import write_exr

EXPOSURES = (0.125, 0.5, 2.0, 8.0, 32.0)
ANGLE_X = 0.9
RELIT_LEVELS = (0.5, 2.0)
LIT_LEVELS = (0.25, 4.0)
#: Of a scene with two lights: the levels of ambient and pendant in the lit views, and others to be judged by,
#: between and beyond those.
LIT_PAIRS = ((0.25, 1.0), (1.0, 4.0), (4.0, 1.0), (1.0, 0.25), (4.0, 0.25), (0.25, 4.0))
RELIT_PAIRS = ((0.5, 2.0), (2.0, 0.5), (8.0, 0.0), (0.0, 2.0), (1.0, 8.0), (0.125, 8.0))


def response(x: np.ndarray) -> np.ndarray:
    return (x / (1.0 + x)) ** (1.0 / 2.2)


def look_at_origin(x: float, y: float) -> np.ndarray:
    """A camera at (x, −4, y) that looks at the origin, Z up."""
    position = np.array([x, -4.0, y])
    backward = position / np.linalg.norm(position)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    pose[:3, 3] = position
    return pose


def write_tiny_scene(
    root: Path,
    size: int = 32,
    gaussians: int = 60,
    views: int = 6,
    seed: int = 0,
    lights: tuple[str, ...] = ("ambient",),
    validation: int = 0,
) -> Path:
    """Write the data set; half of ``views`` are for training, and two more lit views.

    ``validation``: so many views at poses of their own; all else is the same with them and without.
    With two ``lights`` there are lit and relit views at pairs of their levels, named as data sets name them
    (docs/formats.md): each Gaussian and channel has a share of each light, and a fixed one.
    """
    two = len(lights) == 2
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.2, 1.2, (gaussians, 3))
    quaternions = rng.normal(size=(gaussians, 4))
    scales = rng.uniform(0.1, 0.35, (gaussians, 3))
    opacities = rng.uniform(0.5, 0.95, gaussians)
    radiance = np.exp(rng.uniform(-3.0, 1.5, (gaussians, 3)))
    share = rng.uniform(0.1, 0.9, (gaussians, 1))
    fixed, ambient = radiance * (1.0 - share), radiance * share
    parts = np.stack([ambient])
    if two:
        # One light is on the left, the other on the right: a Gaussian has most of the nearer one.
        side = 2.5 * points[:, :1] + rng.normal(0.0, 0.5, (gaussians, 3))
        weights = np.exp(np.stack([-side, side, np.full_like(side, -0.5)], axis=-1))
        shares = weights / weights.sum(axis=-1, keepdims=True)
        fixed, parts = radiance * shares[..., 2], radiance * shares[..., :2].transpose(2, 0, 1)

    def render(pose: np.ndarray, *levels: float) -> np.ndarray:
        camera = Camera.from_field_of_view(pose, size, size, ANGLE_X)
        lit = fixed + sum(level * part for level, part in zip(levels, parts, strict=True))
        arrays = (points, quaternions, scales, opacities, lit)
        image = rasterize(*(torch.tensor(a) for a in arrays), camera).image
        return image.numpy().transpose(1, 2, 0) + 0.01  # a dim background: nothing is black

    def write_view(split: str, index: int, pose: np.ndarray, *levels: float) -> dict:
        hdr = render(pose, *levels)
        (root / f"{split}_hdr").mkdir(parents=True, exist_ok=True)
        (root / split).mkdir(exist_ok=True)
        write_exr(root / f"{split}_hdr" / f"hdr_{index:03d}.exr", hdr.astype(np.float32))
        for k, exposure in enumerate(EXPOSURES):
            codes = np.round(255.0 * response(hdr * exposure)).astype(np.uint8)
            Image.fromarray(np.dstack([codes, np.full_like(codes[..., 0], 255)])).save(
                root / split / f"r_{index}_{k}.png"
            )
        return {"file_path": f"./{split}/r_{index}", "transform_matrix": pose.tolist()}

    angles = np.linspace(-1.0, 1.0, views)
    poses = [look_at_origin(1.5 * a, 0.5 * math.sin(3.0 * a)) for a in angles]
    frames = {"train": [], "test": [], "lit": []}
    if validation:
        between = [look_at_origin(1.2 * a, -0.4) for a in np.linspace(-1.0, 1.0, validation)]
        frames["val"] = [write_view("val", i, p, *(1.0 for _ in lights)) for i, p in enumerate(between)]
    for i, pose in enumerate(poses):
        split = ("train", "test")[i % 2]
        frames[split].append(write_view(split, i // 2, pose, *(1.0 for _ in lights)))
    if two:
        for i, pair in enumerate(LIT_PAIRS):
            levels = dict(zip(lights, pair, strict=True))
            view = write_view("lit", i, poses[2 * i % views], *pair)
            frames["lit"].append(view | {"lighting_level": pair[0], "lighting_levels": levels})
    else:
        for i, level in enumerate(LIT_LEVELS):
            frames["lit"].append(write_view("lit", i, poses[2 * i], level) | {"lighting_level": level})
    for split, rows in frames.items():
        transforms = {"camera_angle_x": ANGLE_X, "frames": rows}
        if two and split == "lit":
            transforms["lights"] = list(lights)
        (root / f"transforms_{split}.json").write_text(json.dumps(transforms))
        exposures = {f"{row['file_path']}_{k}.png": t for row in rows for k, t in enumerate(EXPOSURES)}
        (root / f"exposure_{split}.json").write_text(json.dumps(exposures))
    listed = []
    for levels in RELIT_PAIRS if two else [(level,) for level in RELIT_LEVELS]:
        named = dict(zip(lights, levels, strict=True))
        name = "+".join(f"{light}_{level:g}" for light, level in named.items())
        folder = root / "relit" / (name if two else f"level_{levels[0]:g}")
        folder.mkdir(parents=True)
        write_exr(folder / "hdr_000.exr", render(poses[1], *levels).astype(np.float32))
        listed.append({"folder": f"relit/{folder.name}", "levels": named})

    columns = [(n, "f4") for n in ("x", "y", "z", "nx", "ny", "nz")]
    columns += [(n, "u1") for n in ("red", "green", "blue")]
    vertices = np.zeros(gaussians, dtype=columns)
    for axis, name in enumerate("xyz"):
        vertices[name] = points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = np.round(255.0 * response(radiance[:, channel] * 2.0))
    PlyData([PlyElement.describe(vertices, "vertex")]).write(str(root / "points3d.ply"))
    (root / "dataset.json").write_text(
        json.dumps(
            {
                "format": "physhdr-dataset",
                "version": 1,
                "scene": "tiny",
                "resolution": [size, size],
                "response": {"name": "reinhard-gamma", "anchor": [1.0, 0.5 ** (1.0 / 2.2)]},
                "exposures": list(EXPOSURES),
                "lighting_levels": {
                    "lit": list(LIT_LEVELS),
                    "relit": list(RELIT_LEVELS),
                    "relit_views": [0],
                },
            }
            | ({"lights": [*lights, "screen"], "lit_lights": list(lights), "relit": listed} if two else {})
        )
    )
    return root
