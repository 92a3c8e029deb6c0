# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's own numbers (``published.csv`` states their sources), and whether a scene is one of theirs.

They are shown only with results on the same data: not with a scene of ours that happens to be named bathroom,
nor with the original at another resolution.
"""

import csv
import functools
from dataclasses import dataclass
from pathlib import Path

from ...bridge.data_set import CAPTURE_FILE
from ..scene.scene import Scene

FIGURES_FILE = Path(__file__).with_name("published.csv")
#: The paper's name for its own method.
OURS = "Ours"
METHOD = "PhysHDR-GS"
ABLATION = "ablation:"
#: The file stores the paper's LPIPS, computed on 0…1 pictures.
METRICS = {"psnr": "psnr", "ssim": "ssim", "lpips_01": "lpips"}


@dataclass(frozen=True)
class Benchmark:
    """How to recognise a published data set: its scenes, (width, height) in its protocol, test views.

    ``layouts``: layouts in which it has the paper's split (HDR-GS's has another).
    """

    layouts: tuple[str, ...]
    scenes: tuple[str, ...]
    resolution: tuple[int, int]
    test_views: int


#: As packed by their authors, at the sizes used by GaussHDR and the paper: HDR-NeRF
#: (https://arxiv.org/abs/2111.14451), GaussHDR (https://arxiv.org/abs/2503.10143), HDR-Plenoxels
#: (https://arxiv.org/abs/2208.06787).
BENCHMARKS = {
    "HDR-NeRF-Syn": Benchmark(
        ("HDR-NeRF-Syn", "GaussHDR"),
        ("bathroom", "bear", "chair", "desk", "diningroom", "dog", "sofa", "sponza"),
        (400, 400),
        17,
    ),
    "HDR-NeRF-Real": Benchmark(
        ("HDR-NeRF-Real", "GaussHDR"), ("box", "computer", "flower", "luckycat"), (804, 534), 17
    ),
    "HDR-Plenoxels-Real": Benchmark(("GaussHDR",), ("character", "coffee", "desk", "plant"), (992, 746), 13),
}


def data_set_of(scene: Scene) -> str:
    """The published data set that ``scene`` belongs to, if read by its protocol, else ``""``.

    Never for our own data sets, whatever their name: they have another layout (with a ``dataset.json``).
    """
    if scene.info or not scene.test:
        return ""
    camera = scene.test[0].camera
    seen = (camera.width, camera.height), len(scene.test)
    for name, benchmark in BENCHMARKS.items():
        known = scene.layout in benchmark.layouts and scene.name.lower() in benchmark.scenes
        if known and seen == (benchmark.resolution, benchmark.test_views):
            return name
    return ""


def keeps_exposures_for_testing(scene: Scene) -> bool:
    """Whether ``scene`` has the layout of a published benchmark, with some exposures for testing only.

    For any name and size, to include benchmarks at half their size. Not for our own data sets, rendered or
    made by ``physhdr prepare``.
    """
    ours = bool(scene.info) or (scene.root / CAPTURE_FILE).is_file()
    return not ours and any(scene.layout in benchmark.layouts for benchmark in BENCHMARKS.values())


def published_means(data_set: str, scene: str, setting: str) -> dict[str, dict[str, dict[str, float]]]:
    """``{method: {"LDR-OE": {"psnr": …, "ssim": …, "lpips_01": …}, …}}``, as in an evaluation's ``means``.

    Empty where the paper has no figures. † marks the Scaffold-GS backbone, as in the paper.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    for row in _figures():
        if (row["dataset"], row["scene"], row["setting"]) != (data_set, scene.lower(), setting):
            continue
        method = row["method"]
        if not method.startswith(ABLATION):
            method = method.replace(OURS, METHOD)
        numbers = {name: float(row[theirs]) for name, theirs in METRICS.items() if row[theirs]}
        found.setdefault(method, {})[row["split"]] = numbers
    return found


@functools.cache
def _figures() -> tuple[dict[str, str], ...]:
    with FIGURES_FILE.open(encoding="utf-8", newline="") as file:
        return tuple(csv.DictReader(line for line in file if not line.startswith("#")))
