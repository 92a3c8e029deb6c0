#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Train presets on one data set at equal CPU seconds and write the table docs/results.md quotes.

    .venvs/backend/bin/python tools/compare_presets.py DATA --seconds 150 --seeds 0 1 --out runs/compare

The number of iterations of each preset is found by trial: schedules depend on it, so a run that was cut
short would not be the preset. Finished runs are not repeated.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PHYSHDR = ROOT / ".venvs" / "backend" / "bin" / "physhdr"
#: A run counts as equal when its CPU seconds are this near to the budget.
TOLERANCE = 0.1
TRIALS = 4


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "compare")
    parser.add_argument("--seconds", type=float, default=150.0, help="CPU seconds of every run")
    parser.add_argument("--presets", nargs="+", default=["default", "paper", "baseline"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    arguments = parser.parse_args()
    rows = []
    for preset in arguments.presets:
        iterations = 1000
        for seed in arguments.seeds:
            folder = arguments.out / f"{preset}-{seed}"
            if not (folder / "evaluation.json").exists():
                budget = arguments.seconds
                iterations = train_to_budget(arguments.data, folder, preset, seed, budget, iterations)
                subprocess.check_call([PHYSHDR, "evaluate", folder], stdout=subprocess.DEVNULL)
            rows.append(summary(folder, preset, seed))
    table = markdown(rows)
    (arguments.out / "table.md").write_text(table, encoding="utf-8")
    sys.stdout.write(table)
    return 0


def train_to_budget(data: Path, folder: Path, preset: str, seed: int, seconds: float, iterations: int) -> int:
    """Train until the CPU seconds of a whole run match; returns the iterations that did."""
    for _ in range(TRIALS):
        command = [PHYSHDR, "train", data, "--out", folder, "--overwrite", "--preset", preset]
        command += ["--iterations", iterations, "--seed", seed]
        subprocess.check_call([str(part) for part in command], stdout=subprocess.DEVNULL)
        used = finished(folder)["cpu_seconds"]
        sys.stdout.write(f"{preset}, seed {seed}: {iterations} iterations, {used:.0f} CPU seconds\n")
        sys.stdout.flush()
        if abs(used / seconds - 1.0) < TOLERANCE:
            break
        iterations = max(100, round(iterations * seconds / used / 10) * 10)
    return iterations


def finished(folder: Path) -> dict:
    lines = (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    return json.loads(lines[-1])


def summary(folder: Path, preset: str, seed: int) -> dict:
    evaluation = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    last = [line for line in lines if line["event"] == "progress"][-1]
    return {
        "preset": preset,
        "seed": seed,
        "means": evaluation["means"],
        "scale": evaluation["scale_ratio"],
        "relit": evaluation.get("relit_means", {}),
        "iterations": lines[-1]["iteration"],
        "cpu": lines[-1]["cpu_seconds"],
        "gaussians": last["gaussians"],
    }


def markdown(rows: list[dict]) -> str:
    columns = ["preset", "seed", "iterations", "CPU s", "Gaussians", "LDR-OE", "LDR-NE", "HDR", "aligned"]
    columns += ["scale", "relit", "gain"]
    lines = ["| " + " | ".join(columns) + " |", "|---|" + "---:|" * (len(columns) - 1)]
    for row in rows:
        psnr = {name: metrics["psnr"] for name, metrics in row["means"].items()}
        relit = row["relit"].get("all", {})
        cells = [
            row["preset"], row["seed"], row["iterations"], f"{row['cpu']:.0f}", row["gaussians"],
            *(f"{psnr[name]:.2f}" for name in ("LDR-OE", "LDR-NE", "HDR", "HDR, scale aligned")),
            f"{row['scale']:.3f}",
            f"{relit.get('ours', float('nan')):.2f}",
            f"{relit.get('gain_over_scaled_truth', float('nan')):+.2f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
