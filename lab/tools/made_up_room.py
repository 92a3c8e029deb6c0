# SPDX-License-Identifier: GPL-3.0-or-later
"""A made-up room as a data set of any size, in seconds: what sizes and times are measured on.

    .venvs/backend/bin/python lab/tools/made_up_room.py OUT --width 1600 --height 1067

A box with furniture (boxes and balls), cast by rays: solid textures with detail down to millimetres, so that
larger pictures show more, sharp edges, highlights that move with the camera, lamps 1,000 times as bright as
walls, no noise. Nothing casts shadows: that is what Cycles is for (synth/make_scene.py), which takes an hour
for what this does in a minute. Written in HDR-NeRF-Syn's layout, without true radiance.
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np
from numba import njit, prange
from PIL import Image

#: Rays a pixel on each side.
SUPERSAMPLES = 2
FIELD_OF_VIEW = math.radians(65.0)
#: The room, metres; furniture: boxes (least, most corner) and balls (centre, radius).
ROOM = np.array([[-3.0, -2.2, 0.0], [3.0, 2.2, 2.6]])
BOXES = np.array(
    [
        [[-0.8, -0.5, 0.0], [0.8, 0.5, 0.75]],
        [[-2.9, -2.1, 0.0], [-2.3, 0.4, 1.9]],
        [[1.9, 1.2, 0.0], [2.9, 2.1, 1.0]],
        [[-0.3, 1.7, 0.0], [0.9, 2.1, 1.3]],
        [[2.2, -1.9, 0.0], [2.8, -1.0, 0.5]],
    ]
)
BALLS = np.array(
    [
        [0.4, 0.1, 0.95, 0.2],
        [-0.4, -0.2, 0.87, 0.12],
        [2.4, 1.6, 1.2, 0.2],
        [1.2, -1.4, 0.35, 0.35],
        [0.0, 0.0, 2.3, 0.12],
    ]
)
#: Number of the ball that is a lamp, its radiance, and that of the window in the wall y = 2.2.
LAMP, LAMP_RADIANCE, WINDOW_RADIANCE = 4, 60.0, 8.0
WINDOW = np.array([-2.2, -0.8, 0.9, 2.1])  # x, x, z, z
#: Cycles a metre of the textures' octaves: the finest is half a millimetre wide.
OCTAVES = 11


@njit(cache=True, inline="always")
def _hash(x: int, y: int, z: int) -> float:
    h = (x * 374761393 + y * 668265263 + z * 2147483647 + 1013904223) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967296.0


@njit(cache=True)
def _noise(x: float, y: float, z: float) -> float:
    """Value noise in [0, 1], one cell a unit."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
                total += weight * _hash(i + a, j + b, k + c)
    return total


@njit(cache=True)
def _texture(p: np.ndarray, kind: int) -> float:
    """Brightness about 1 of a surface at ``p``: octaves, each 0.75 times as strong as the one before."""
    total, strength, frequency = 0.0, 0.5, 2.0
    for _ in range(OCTAVES):
        total += strength * (_noise(p[0] * frequency + 17 * kind, p[1] * frequency, p[2] * frequency) - 0.5)
        strength, frequency = strength * 0.75, frequency * 2.0
    tiles = 0.0
    if kind % 2 == 0:  # tiles with joints of 4 mm, every second one darker
        size = 0.12 + 0.05 * (kind % 3)
        joint, odd = False, 0
        for axis in range(3):
            at = (p[axis] + 10.013) / size
            joint |= (at - math.floor(at)) * size < 0.004
            odd += math.floor(at)
        tiles = -0.5 if joint else (-0.15 if odd % 2 else 0.1)
    return max(0.08, 1.0 + total + tiles)


@njit(cache=True)
def _radiance(o, d, room, boxes, balls, window, out) -> None:
    """Radiance ``out`` ``[3]`` along the ray from ``o`` ``[3]`` in direction ``d`` ``[3]``, of length 1."""
    nearest, kind = 1e9, 0
    n0, n1, n2 = 0.0, 0.0, 0.0
    for axis in range(3):  # walls, seen from within
        if d[axis] != 0.0:
            side = 1 if d[axis] > 0 else 0
            t = (room[side, axis] - o[axis]) / d[axis]
            if 0 < t < nearest:
                nearest, kind = t, 2 * axis + side
                sign = -1.0 if side else 1.0
                n0, n1, n2 = sign * (axis == 0), sign * (axis == 1), sign * (axis == 2)
    for b in range(boxes.shape[0]):
        enter, leave, face = -1e9, 1e9, 0
        for axis in range(3):
            step = 1.0 / d[axis] if d[axis] != 0.0 else 1e12
            t0, t1 = (boxes[b, 0, axis] - o[axis]) * step, (boxes[b, 1, axis] - o[axis]) * step
            if t0 > t1:
                t0, t1 = t1, t0
            if t0 > enter:
                enter, face = t0, axis
            leave = min(leave, t1)
        if 1e-6 < enter < leave and enter < nearest:
            nearest, kind = enter, 6 + b
            sign = -1.0 if d[face] > 0 else 1.0
            n0, n1, n2 = sign * (face == 0), sign * (face == 1), sign * (face == 2)
    for s in range(balls.shape[0]):
        x, y, z = o[0] - balls[s, 0], o[1] - balls[s, 1], o[2] - balls[s, 2]
        along = x * d[0] + y * d[1] + z * d[2]
        root = along * along - (x * x + y * y + z * z - balls[s, 3] ** 2)
        if root > 0 and 1e-6 < -along - math.sqrt(root) < nearest:
            nearest, kind = -along - math.sqrt(root), 20 + s
            n0, n1, n2 = (x + nearest * d[0]), (y + nearest * d[1]), (z + nearest * d[2])
            n0, n1, n2 = n0 / balls[s, 3], n1 / balls[s, 3], n2 / balls[s, 3]
    p = o + nearest * d
    if kind == 20 + LAMP:
        out[:] = np.array([1.0, 0.85, 0.6]) * LAMP_RADIANCE
        return
    if kind == 3 and window[0] < p[0] < window[1] and window[2] < p[2] < window[3]:
        sky = 0.6 + 0.8 * _noise(p[0] * 3, 0.0, p[2] * 3)
        out[:] = np.array([0.8, 0.95, 1.1]) * WINDOW_RADIANCE * sky
        return
    # Light of the lamp and of the window, without shadows, and a little from everywhere.
    light = np.array([0.05, 0.055, 0.06])
    shine = 0.0
    for source in range(2):
        if source == 0:
            tx, ty, tz, power = balls[LAMP, 0] - p[0], balls[LAMP, 1] - p[1], balls[LAMP, 2] - p[2], 0.9
        else:
            tx, ty, tz, power = -1.5 - p[0], 2.15 - p[1], 1.5 - p[2], 1.6
        distance = tx * tx + ty * ty + tz * tz + 0.05
        cosine = (tx * n0 + ty * n1 + tz * n2) / math.sqrt(distance)
        if cosine > 0:
            light[0] += power * cosine / distance * (1.0 if source == 0 else 0.8)
            light[1] += power * cosine / distance * 0.9
            light[2] += power * cosine / distance * (0.65 if source == 0 else 1.05)
        facing = d[0] * n0 + d[1] * n1 + d[2] * n2
        r0, r1, r2 = d[0] - 2 * facing * n0, d[1] - 2 * facing * n1, d[2] - 2 * facing * n2
        mirrored = (tx * r0 + ty * r1 + tz * r2) / math.sqrt(distance)
        if mirrored > 0 and (kind >= 20 or kind % 4 == 0):
            shine += power * mirrored**40 / distance
    bright = _texture(p, kind)
    for c in range(3):
        albedo = 0.25 + 0.55 * _hash(kind, c, 7)
        out[c] = light[c] * albedo * bright + 0.4 * shine


@njit(cache=True, parallel=True)
def _picture(pose, width, height, focal, room, boxes, balls, window) -> np.ndarray:
    """Radiance ``[H, W, 3]`` as a camera at ``pose`` ``[4, 4]`` (camera to world, OpenGL axes) sees it."""
    image = np.zeros((height, width, 3))
    for row in prange(height):
        out = np.zeros(3)
        for column in range(width):
            for i in range(SUPERSAMPLES):
                for j in range(SUPERSAMPLES):
                    x = (column + (i + 0.5) / SUPERSAMPLES - 0.5 * width) / focal
                    y = -(row + (j + 0.5) / SUPERSAMPLES - 0.5 * height) / focal
                    length = math.sqrt(x * x + y * y + 1.0)
                    d = (pose[:3, 0] * x + pose[:3, 1] * y - pose[:3, 2]) / length
                    _radiance(pose[:3, 3].copy(), d, room, boxes, balls, window, out)
                    for c in range(3):
                        image[row, column, c] += out[c] / SUPERSAMPLES**2
    return image


def poses(count: int, turn: float) -> list[np.ndarray]:
    """Cameras to world ``[4, 4]`` on a wavy walk round the table, begun at ``turn`` (radians)."""
    found = []
    for i in range(count):
        angle = turn + 2.0 * math.pi * i / count
        height = 1.45 + 0.35 * math.sin(5.0 * angle)
        place = np.array([1.75 * math.cos(angle), 1.25 * math.sin(angle), height])
        across = angle + math.pi + 0.5 * math.sin(3.0 * angle)
        target = np.array([1.2 * math.cos(across), 0.9 * math.sin(across), 0.9 + 0.3 * math.cos(4.0 * angle)])
        back = (place - target) / np.linalg.norm(place - target)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([right, np.cross(back, right), back], axis=1), place
        found.append(pose)
    return found


def response(exposed: np.ndarray) -> np.ndarray:
    """Code values in [0, 1] of exposure × radiance: 0.73 at 1, as HDR-NeRF-Syn's anchor says."""
    return (exposed / (1.0 + exposed)) ** (1.0 / 2.2)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--width", type=int, default=800)
    parser.add_argument("--height", type=int, default=533)
    parser.add_argument("--views", type=int, default=50)
    parser.add_argument("--test-views", type=int, default=8)
    parser.add_argument("--exposures", type=int, default=3, help="from 1/8 s to 8 s")
    given = parser.parse_args()
    focal = 0.5 * given.width / math.tan(0.5 * FIELD_OF_VIEW)
    times = np.geomspace(0.125, 8.0, given.exposures)
    # Test views lie between the training views, each as far from its two neighbours.
    for split, count, turn in (
        ("train", given.views, 0.0),
        ("test", given.test_views, math.pi / given.views),
    ):
        (given.out / split).mkdir(parents=True, exist_ok=True)
        frames, exposures = [], {}
        for i, pose in enumerate(poses(count, turn)):
            image = _picture(pose, given.width, given.height, focal, ROOM, BOXES, BALLS, WINDOW)
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()})
            for k, seconds in enumerate(times):
                codes = np.rint(255.0 * response(seconds * image)).astype(np.uint8)
                Image.fromarray(codes).save(given.out / split / f"r_{i}_{k}.png", compress_level=1)
                exposures[f"{split}/r_{i}_{k}.png"] = float(seconds)
        transforms = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
        (given.out / f"transforms_{split}.json").write_text(json.dumps(transforms), encoding="utf-8")
        (given.out / f"exposure_{split}.json").write_text(json.dumps(exposures), encoding="utf-8")


if __name__ == "__main__":
    main()
