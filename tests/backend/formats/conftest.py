# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians of all kinds, what other programs made of some, and those programs where they are installed.

splat-transform is found by PHYSHDR_SPLAT_TRANSFORM or on the PATH, Khronos' validator (npm's gltf-validator)
in the node_modules that PHYSHDR_NODE_MODULES names. Without them their tests are skipped, with the reason.
"""

import json
import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from physhdr.bridge.gaussian_ply import write_standard_ply
from physhdr.bridge.splat_files import SplatCloud

FIXTURES = Path(__file__).resolve().parents[2] / "fixtures"


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of what other programs wrote, all of the Gaussians in ``source.ply``."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("splat_files.zip", "other_formats.zip"):
        with zipfile.ZipFile(FIXTURES / name) as archive:
            archive.extractall(folder)
    return folder


def some_cloud(count: int = 300, degree: int = 3, seed: int = 0) -> SplatCloud:
    """Of all shapes; opacities of 0 and 1, a flat one, colours beyond 0…1."""
    rng = np.random.default_rng(seed)
    rotation = rng.standard_normal((count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    scale = np.exp(rng.uniform(-6.0, 0.0, (count, 3)))
    scale[0, 2] = 0.0
    opacity = rng.uniform(0.0, 1.0, count)
    opacity[:2] = 0.0, 1.0
    sh = 0.1 * rng.standard_normal((count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-2.0, 4.0, (count, 3))
    arrays = (rng.uniform(-3.0, 3.0, (count, 3)), rotation, scale, opacity, sh)
    return SplatCloud(*(array.astype(np.float32) for array in arrays))


@pytest.fixture
def cloud() -> SplatCloud:
    return some_cloud()


@pytest.fixture(scope="session")
def splat_transform() -> Callable[..., None]:
    """``splat_transform("in.ply", "out.sog")`` runs PlayCanvas's converter."""
    program = os.environ.get("PHYSHDR_SPLAT_TRANSFORM") or shutil.which("splat-transform")
    if program is None:
        pytest.skip(
            "there is no splat-transform: npm install @playcanvas/splat-transform, and set "
            "PHYSHDR_SPLAT_TRANSFORM"
        )

    def run(*words: object) -> None:
        subprocess.run([program, "-q", "-w", "-g", "cpu", *map(str, words)], check=True, capture_output=True)

    return run


@pytest.fixture(scope="session")
def validated() -> Callable[[Path], dict]:
    """What Khronos' validator says of a glTF file."""
    modules, node = os.environ.get("PHYSHDR_NODE_MODULES"), shutil.which("node")
    if modules is None or node is None or not (Path(modules) / "gltf-validator").is_dir():
        pytest.skip("there is no gltf-validator: npm install gltf-validator, and set PHYSHDR_NODE_MODULES")
    script = (
        "const v = require(process.argv[1] + '/gltf-validator'), fs = require('fs');"
        "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])), {maxIssues: 100})"
        ".then(r => console.log(JSON.stringify(r)));"
    )

    def run(path: Path) -> dict:
        words = [node, "-e", script, modules, str(path)]
        return json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)

    return run


@pytest.fixture
def physhdr_ply() -> Callable[[Path, SplatCloud], None]:
    """Writes a cloud as our standard PLY."""

    def write(path: Path, cloud: SplatCloud) -> None:
        arrays = (cloud.position, cloud.rotation, cloud.scale, cloud.opacity, cloud.colour_sh)
        write_standard_ply(path, *arrays, up=cloud.up)

    return write
