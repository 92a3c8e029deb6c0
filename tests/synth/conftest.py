# SPDX-License-Identifier: GPL-3.0-or-later
"""A stage that renders in a blink, and readers of the files that share no code with synth."""

import json
import math
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs Blender: run with .venvs/blender/bin/python")


def build_ball(scene, assets):
    """A grey ball of radius 1 on the floor z = −1, sun (ambient) and a bulb (lamp), black sky."""
    from physhdr.synth.scenes import materials, props
    from physhdr.synth.scenes.lighting import Lighting
    from physhdr.synth.stage import CameraHints, Stage

    room = scene.collection
    grey = materials.plain("grey", (0.5, 0.4, 0.3), 1.0)
    props.ball(room, "ball", (0, 0, 0), 1.0, grey, subdivisions=5)
    props.box(room, "floor", (0, 0, -1.05), (12, 12, 0.1), grey)
    lighting = Lighting(scene)
    glow, strength = materials.emission("glow", (1, 1, 1), 50.0)
    lighting.glow("lamp", props.ball(room, "bulb", (1.6, -1.5, 0.2), 0.35, glow), strength)
    sun = lighting.sun((0, 0, -1), 2.0, (1.0, 1.0, 1.0), 0.526)
    sun.rotation_euler = (0.5, 0.3, 0.0)
    hints = CameraHints(
        centre=(0, -6, 1.0),
        target=(0, 0, 0),
        extent=(2.0, 1.0),
        angle_x=math.radians(50),
        orbit_radius=6.0,
        orbit_arc=1.5,
        elevation=(0.1, 0.6),
    )
    return Stage(scene=scene, cameras=hints, lights=lighting.groups)


@pytest.fixture(autouse=True)
def ball_scene(monkeypatch):
    """``--scene ball`` exists in every test."""
    from physhdr.synth.built_in import SCENES, BuiltInScene

    monkeypatch.setitem(SCENES, "ball", BuiltInScene(build_ball))


@pytest.fixture
def small():
    """Options of a data set of the ball that takes about a second."""
    from physhdr.synth.options import Options

    return Options(
        scene="ball",
        resolution=(32, 24),
        samples=4,
        views=5,
        lit_views=2,
        relit_views=1,
        ambient_levels=(0.5, 2.0),
        denoise=False,
    )


def read_png(path: Path) -> np.ndarray:
    """[height, width, 4] uint8 of an 8-bit RGBA PNG without row filters; asserts that it is one."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, packed, header = 8, b"", None
    while at < len(data):
        (size,) = struct.unpack_from(">I", data, at)
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        assert zlib.crc32(kind + body) == struct.unpack_from(">I", data, at + 8 + size)[0]
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        packed += body if kind == b"IDAT" else b""
        at += 12 + size
    width, height, *rest = header
    assert rest == [8, 6, 0, 0, 0]
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, -1)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 4)


def read_exr(path: Path) -> np.ndarray:
    """[height, width, 3] float32 by Blender's own reader, which synth does not use."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    assert image.is_float and width
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1, :, :3]


def read_ply(path: Path) -> np.ndarray:
    """Structured array of a binary little-endian PLY of one vertex element."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    (count,) = (int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    kinds = {"float": "<f4", "uchar": "u1"}
    columns = [(line.split()[2], kinds[line.split()[1]]) for line in lines if line.startswith("property")]
    assert len(body) == count * np.dtype(columns).itemsize
    return np.frombuffer(body, columns)


def read_json(path: Path):
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def readers() -> SimpleNamespace:
    """The readers above, for tests that need no import of this module."""
    return SimpleNamespace(exr=read_exr, png=read_png, ply=read_ply, json=read_json)
