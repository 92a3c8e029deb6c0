# SPDX-License-Identifier: GPL-3.0-or-later
"""Stands in for the child process where only scheduling is tested: ``THREADS USAGE train|evaluate …``.

The preset says how it behaves; a line of ``calls.txt`` beside the data says what was called.
"""

import argparse
import json
import sys
import time
from pathlib import Path


def cpu_seconds(preset: str, iterations: int) -> float:
    """What a training costs: dearer with its length for ``convex``, far too dear for ``slow``."""
    return {"convex": 0.002 * iterations**1.25, "slow": 0.7 * iterations}.get(preset, 0.01 * iterations)


def train(words: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--overwrite", action="store_true")
    for name in ("preset", "exposure-mode", "device"):
        parser.add_argument(f"--{name}", default="")
    parser.add_argument("--set", action="append", default=[])
    for name in ("iterations", "seed", "threads"):
        parser.add_argument(f"--{name}", type=int)
    given = parser.parse_args(words)
    with open(given.data.parent / "calls.txt", "a") as calls:
        calls.write(f"train {given.preset} {given.data.name} {given.seed} {given.iterations}\n")
    once = given.data.parent / "failed_once"
    if given.preset == "fails" or (given.preset == "fails_once" and not once.exists()):
        once.touch()
        print("it begins well\n\x1b[31merror: the flux is out of order\x1b[0m")
        return 3
    given.out.mkdir(exist_ok=True)
    settings = dict(text.split("=", 1) for text in given.set)
    config = {"strength": settings.get("strength", ""), "iterations": given.iterations, "seed": given.seed}
    config |= {"exposure_mode": given.exposure_mode}
    if given.preset == "hdr-nerf":
        config["method"] = {"name": "hdr-nerf"}
    (given.out / "config.json").write_text(json.dumps({"config": config}))
    events = [{"event": "progress", "iteration": 1, "iterations": given.iterations, "gaussians": 7}]
    (given.out / "log.jsonl").write_text(json.dumps(events[0]) + "\n")
    if given.preset == "hangs":
        time.sleep(1000)
    time.sleep(0.1)
    end = {"iteration": given.iterations, "seconds": 1.0, "stopped": False}
    end["cpu_seconds"] = cpu_seconds(given.preset, given.iterations)
    events.append({"event": "finished", **end})
    (given.out / "log.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    (given.out / "preset").write_text(given.preset)
    return 0


def evaluate(words: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path, nargs="?")
    for name in ("out", "device", "lpips-weights", "exposure-mode", "downscale"):
        parser.add_argument(f"--{name}")
    for name in ("pictures", "data"):
        parser.add_argument(f"--{name}", type=Path)
    parser.add_argument("--split", default="test")
    given = parser.parse_args(words)
    if given.pictures:
        return evaluate_pictures(given)
    config = json.loads((given.folder / "config.json").read_text())["config"]
    preset = (given.folder / "preset").read_text()
    if preset == "hangs_evaluated":
        time.sleep(1000)
    write_evaluation(given, 30.0 + len(preset) + 0.1 * config["seed"])
    return 0


def evaluate_pictures(given) -> int:
    """The one picture is its PSNR."""
    with open(given.data.parent / "calls.txt", "a") as calls:
        told = (given.pictures.name, given.data.name, given.exposure_mode, given.downscale)
        calls.write(f"evaluate {' '.join(map(str, told))}\n")
    picture = given.pictures / given.split / "r_0_0.png"
    if not picture.exists():
        print(f"error: {picture} is missing")
        return 1
    write_evaluation(given, float(picture.read_text()))
    return 0


def write_evaluation(given, base: float) -> None:
    means = {part: {"psnr": base, "ssim": 0.9} for part in ("LDR-OE", "LDR-NE", "HDR")}
    content = {"format": "physhdr-evaluation", "version": 1, "means": means}
    content["conditions"] = {"split": given.split}
    content |= {"scale_ratio": 1.0, "weights": given.lpips_weights, "messages": ["all was dark"]}
    if base >= 40.0:  # the longest name
        content["messages"].append("it has seen the truth")
    (Path(given.out or given.folder) / "evaluation.json").write_text(json.dumps(content))


if __name__ == "__main__":
    threads, usage, command, *words = sys.argv[1:]
    Path(usage).write_text(
        json.dumps({"peak_memory": 123_000_000, "machine": {"host": "here", "cpu": "one"}})
    )
    sys.exit({"train": train, "evaluate": evaluate}[command](words))
