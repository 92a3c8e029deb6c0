#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Is what a card computes right, and how fast? Runs by itself on a machine with a card, torch and warp-lang.

    make gpu-check
    python3 tools/gpu_check.py --json gpu.json --profile

Compares pictures, gradients, whole iterations and short trainings by Warp's kernels with the CPU's, then
measures. Ends with 0 where all comparisons hold, with 1 where one fails or the kernels do not work; where
there is no card it says so and ends with 0. ``--rehearse`` runs every line of it on the CPU in small sizes,
without a card.
"""

import argparse
import json
import platform
import sys
import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Sizes:
    """How much is computed."""

    channels: tuple[int, ...] = (1, 3, 4, 6, 7, 10, 13)
    gaussians: int = 5000
    picture: int = 64
    training_gaussians: int = 400
    iterations: int = 300
    trainings: int = 5
    figure_gaussians: int = 200_000
    figure_picture: int = 400
    figure_views: int = 35
    repeats: int = 200
    #: (Gaussians, pixels of a side): 1307² are as many pixels as 1600×1067.
    grid: tuple[tuple[int, int], ...] = (
        *((50_000, 400), (200_000, 400), (1_000_000, 400)),
        *((50_000, 1307), (200_000, 1307), (1_000_000, 1307)),
    )
    grid_repeats: int = 30


#: Without Numba the oracle is plain torch, which is slow.
PLAIN = Sizes(gaussians=600, picture=40, training_gaussians=150)
REHEARSAL = Sizes(
    channels=(3, 10),
    gaussians=60,
    picture=16,
    training_gaussians=30,
    iterations=4,
    trainings=1,
    figure_gaussians=60,
    figure_picture=16,
    figure_views=2,
    repeats=2,
    grid=((60, 16),),
    grid_repeats=2,
)
PRESET_NAMES = ("default", "paper")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=Path, help="also write everything to this file")
    parser.add_argument("--profile", action="store_true", help="also say which kernels take the time")
    parser.add_argument("--rehearse", action="store_true", help="everything on the CPU, in small sizes")
    parser.add_argument("--bare", action="store_true", help="as if only torch and NumPy were installed")
    parser.add_argument("--cubins", action="store_true", help="only print what Warp's CUBINs say; no card")
    arguments = parser.parse_args()

    from card.loading import DISPENSABLE, find_physhdr, load_physhdr

    find_physhdr()
    try:
        import torch
    except ImportError:
        return _skip(f"this Python has no torch ({sys.executable})")
    if not (arguments.rehearse or arguments.cubins) and not torch.cuda.is_available():
        return _skip("torch sees no CUDA device")

    absent = load_physhdr(without=DISPENSABLE if arguments.bare else ())
    if absent:
        _say(f"not installed, not needed: {', '.join(absent)}")
    if arguments.cubins:
        from card import cubins

        for line in cubins.table():
            _say(line)
        return 0
    started = time.perf_counter()
    sides = _rehearsed() if arguments.rehearse else _usable()
    if not sides:
        _say("FAILED: nothing can be computed on this card")
        return 1
    report: dict[str, Any] = {"machine": _machine(), "kernels_ready_s": time.perf_counter() - started}
    _say(f"{report['machine']}; kernels ready after {report['kernels_ready_s']:.0f} s")

    passed = True
    for side in sides:
        report[side.name] = {}
        passed &= _check(side, arguments, "numba" not in absent, report[side.name])
    if arguments.json:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    _say("all comparisons hold" if passed else "FAILED: the card does not compute what the CPU computes")
    return 0 if passed else 1


def _check(side: Any, arguments: argparse.Namespace, has_numba: bool, report: dict[str, Any]) -> bool:
    """Compare, then measure; fills ``report`` and says whether every comparison holds."""
    from card import figures, parity
    from card.side import oracle

    judge = oracle(has_numba)
    sizes = REHEARSAL if arguments.rehearse else PLAIN if judge.plain else Sizes()
    findings: list[parity.Finding] = []

    def found(finding: parity.Finding) -> None:
        findings.append(finding)
        verdict = "ok" if finding.passed else "FAILED"
        _say(f"{finding.what:<72} {finding.error:9.2g} ≤ {finding.allowed:g} {finding.unit:<2} {verdict}")

    _say(f"\n{side.name} against {judge.name}: relative errors")
    for channels in sizes.channels:
        for finding in parity.rasteriser(side, judge, sizes.gaussians, channels):
            found(finding)
    if side.implementation == "warp":
        found(parity.same_bits(side, sizes.gaussians, 6))
    picture, count = sizes.picture, sizes.training_gaussians
    for name in PRESET_NAMES:
        for finding in parity.iteration(side, judge, name, picture, count):
            found(finding)
    for name in PRESET_NAMES:
        found(parity.training(side, judge, name, picture, count, sizes.iterations, sizes.trainings))
    report["parity"] = [asdict(f) | {"passed": f.passed} for f in findings]

    measured: list[figures.Figure] = []

    def show(figure: figures.Figure) -> None:
        measured.append(figure)
        _say(f"{figure.what:<72} {figure.value:10.3g} {figure.unit:<6} {figure.target}")

    size = sizes.figure_picture
    _say(f"\n{side.name}: {sizes.figure_gaussians} Gaussians, {size}×{size} pixels")
    for name in PRESET_NAMES:
        for figure in figures.preset(
            side, name, sizes.figure_gaussians, size, sizes.figure_views, sizes.repeats
        ):
            show(figure)
    _say(f"\n{side.name}: by size")
    for gaussians, pixels in sizes.grid:
        for figure in figures.rasteriser(side, gaussians, pixels, sizes.grid_repeats):
            show(figure)
        for name in PRESET_NAMES:
            for figure in figures.iterations(side, name, gaussians, pixels, 2, sizes.grid_repeats):
                show(figure)
    report["figures"] = [asdict(f) | {"target": f.target} for f in measured]
    if arguments.profile:
        report["profile"] = {}
        for name in PRESET_NAMES:
            table = figures.profile(side, name, sizes.figure_gaussians, size)
            report["profile"][name] = table
            _say(f"\npreset {name}, ten iterations\n{table}")
    return all(f.passed for f in findings)


def _usable() -> list[Any]:
    """The card's side, its kernels made ready; none where they do not work, and says why."""
    import torch
    from card.side import Side

    from physhdr.backend.rasterize import card

    reason = card.unavailable_reason()
    if reason is None:
        return [Side("Warp", torch.device("cuda"), "warp")]
    _say(f"not by Warp: {reason}")
    return []


def _rehearsed() -> list[Any]:
    """In place of a card the reference, and Warp's own kernels where it is installed."""
    from importlib.util import find_spec

    import torch
    from card.side import Side

    cpu = torch.device("cpu")
    sides = [Side("rehearsal", cpu, "reference", plain=True)]
    return [*sides, Side("rehearsal by Warp", cpu, "warp")] if find_spec("warp") else sides


def _machine() -> str:
    import torch

    def version(package: str) -> str:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return "none"

    card = torch.cuda.get_device_name() if torch.cuda.is_available() else "no card"
    warp = version("warp-lang")
    return f"{card}, torch {torch.__version__}, warp-lang {warp}, Python {platform.python_version()}"


def _skip(why: str) -> int:
    _say(f"skipped: {why}")
    return 0


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()  # the next step may take minutes


if __name__ == "__main__":
    sys.exit(main())
