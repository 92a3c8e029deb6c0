# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the test truth that is stored in lab/data, a little better with every pass.

    .venvs/run-blender lab/tools/keep_truth.py -- bear dog --passes 256 --work FOLDER
    .venvs/run-blender lab/tools/keep_truth.py -- bear --passes 256,1024,1024 --reference --work FOLDER
    .venvs/run-blender lab/tools/keep_truth.py -- chair --passes 256,1024 --device GPU --work FOLDER

A pass (synth/truth.py) has so many samples and is denoised by itself; the truth is the mean of all, weighted
by their samples. Every test and validation view of a scene gets the first pass before any gets the second,
and so does the middle test view once more with other noise (``again``). So it may be stopped at any time, by
CTRL-C or a kill, and resumes where it stopped, even on another machine that has only lab/data. Several
may work at the same time. ``--reference`` then renders the middle test view twice without denoising, which
together show its limit. Both floors go into truth.json.

With ``--passes 1024,1024`` it is what ``make_scene.py --test-samples 2048`` makes, but for half floats.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from physhdr.bridge.data_set import TEST, VALIDATION
from physhdr.bridge.errors import PhysHDRError
from physhdr.bridge.lock import Claims
from physhdr.synth import dataset, device, exr, floors, folder, noise, rig, settings, stored_truth
from physhdr.synth.built_in import SCENES, built
from physhdr.synth.errors import ConflictError
from physhdr.synth.options import REFERENCE_FACTOR, Options, seconds
from physhdr.synth.passes import FACTS
from physhdr.synth.renderer import Renderer, renderer, view_seed
from physhdr.synth.response import by_name
from physhdr.synth.stage import CameraHints
from physhdr.synth.truth import PASS, TruthRenderer, pass_seed

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "lab" / "data"
SIZE, VIEWS, RIG, SEED, DENOISE = (200, 200), 35, "grid", 0, True
#: Of the scenes that choices are made on.
VALIDATION_VIEWS = {"interior": 4, "bathroom": 4, "sponza": 4}


@dataclass(frozen=True)
class View:
    """A pose and the mean of its passes so far: float32 in the work folder, half floats where it is kept."""

    name: str
    pose: np.ndarray
    work: Path
    target: Path | None = None
    denoised: bool = True
    #: What Cycles renders further passes with.
    device: str = Options.device

    def state(self) -> tuple[np.ndarray | None, dict[str, Any]]:
        """The mean so far and its facts; the kept one's where that has more passes."""
        there = [
            stored_truth.read(path) for path in (self.work, self.target) if path is not None and path.exists()
        ]
        best = max(there, key=lambda each: sum(each[1]["passes"]), default=None)
        return best or (None, {"passes": [], "cpu_seconds": 0.0})

    @property
    def mean(self) -> np.ndarray:
        mean, _ = self.state()
        assert mean is not None
        return mean

    @property
    def passes(self) -> list[int]:
        """Samples of each so far."""
        return self.state()[1]["passes"]

    def improve(self, camera: Renderer, samples: int) -> dict[str, Any]:
        """One pass more; the facts after it."""
        mean, facts = self.state()
        passes, began = facts["passes"], time.process_time()
        devices = {*facts.get("devices", [Options.device] if passes else []), self.device}
        seed = pass_seed(view_seed(SEED, self.name), len(passes))
        rendered = TruthRenderer(camera, samples).once(samples, self.pose, seed, folder.scratch(self.work))
        new = rendered.radiance({}) if self.denoised else rendered.raw
        assert new is not None
        total = samples * new.astype(np.float64)
        if mean is not None:
            total += sum(passes) * mean.astype(np.float64)
        mean = (total / (sum(passes) + samples)).astype(np.float32)
        facts = {
            "passes": [*passes, samples],
            "samples": sum(passes) + samples,
            "seed": SEED,
            "cpu_seconds": round(facts["cpu_seconds"] + time.process_time() - began, 1),
            "camera_to_world": self.pose.tolist(),
            **_devices_used(devices),
        }
        text = {FACTS: json.dumps(facts, sort_keys=True)}
        folder.write(self.work, exr.encode_rgb(mean, text))
        if self.target is not None:
            stored_truth.write(self.target, mean, facts)
        return facts

    def keep(self) -> None:
        """Update what is stored from the work folder: killed between the two, it lags behind."""
        mean, facts = self.state()
        if self.target is None or mean is None:
            return
        if not self.target.exists() or stored_truth.read(self.target)[1]["passes"] != facts["passes"]:
            stored_truth.write(self.target, mean, facts)


def _devices_used(devices: set[str]) -> dict[str, list[str]]:
    """What Cycles rendered with, where that was not the CPU alone."""
    return {} if devices == {Options.device} else {"devices": sorted(devices)}


class Scene:
    """The views of a scene: those that are stored, and those that show how good these are."""

    def __init__(self, name: str, cameras: CameraHints, work: Path, cycles_device: str) -> None:
        self.name, self.work, self.target = name, work / name, DATA / name
        self.device = cycles_device
        for place in (self.work, self.target):
            place.mkdir(parents=True, exist_ok=True)
        poses = rig.poses(RIG, cameras, VIEWS, 0, VALIDATION_VIEWS.get(name, 0))
        self.middle = len(poses.test) // 2
        self.stored = [
            View(f"{split}_{k:03d}", pose, self.work / file, self.target / file, device=cycles_device)
            for split, of_split in ((TEST, poses.test), (VALIDATION, poses.validation))
            for k, pose in enumerate(of_split)
            for file in [stored_truth.file_name(split, k)]
        ]
        self.again = self._beside("again", denoised=True, pose=poses.test[self.middle])
        self.halves = [
            self._beside(f"reference_{k}", denoised=False, pose=poses.test[self.middle]) for k in (0, 1)
        ]

    def _beside(self, name: str, denoised: bool, pose: np.ndarray) -> View:
        path = self.work / f"{name}.exr"
        return View(f"{TEST}_{self.middle:03d}/{name}", pose, path, None, denoised, self.device)

    def describe(self) -> dict[str, Any] | None:
        """The content of truth.json; None as long as not all views are there."""
        views = [*self.stored, self.again]
        passes = min((view.passes for view in views), key=sum)
        if not passes:
            return None
        exposures, response = seconds(SCENES[self.name].evs), by_name(Options.crf)
        truth = self.stored[self.middle].mean
        devices = {name for view in views for name in view.state()[1].get("devices", [Options.device])}
        description: dict[str, Any] = {
            "format": stored_truth.FORMAT,
            "version": stored_truth.VERSION,
            "generator": {**dataset.GENERATOR, "blender": bpy.app.version_string},
            "options": {
                "scene": self.name,
                "resolution": list(SIZE),
                "views": VIEWS,
                "camera_rig": RIG,
                "assets": False,
            },
            "validation_views": VALIDATION_VIEWS.get(self.name, 0),
            "seed": SEED,
            "passes": passes,
            "samples": sum(passes),
            "exposures": list(exposures),
            "cpu_seconds": round(sum(view.state()[1]["cpu_seconds"] for view in self.stored)),
            **_devices_used(devices),
            "noise_floor": {
                "view": self.middle,
                "response": Options.crf,
                **noise.floor(truth, self.again.mean, response, exposures),
            },
        }
        if all(half.passes for half in self.halves):
            description["reference_floor"] = {
                "view": self.middle,
                "response": Options.crf,
                "samples": sum(sum(half.passes) for half in self.halves),
                "cpu_seconds": round(sum(half.state()[1]["cpu_seconds"] for half in self.halves)),
                **floors.reference_floor(
                    truth, (self.halves[0].mean, self.halves[1].mean), response, exposures
                ),
            }
        return description


def work_on(
    name: str, passes: list[int], reference: bool, work: Path, cycles_device: str = Options.device
) -> None:
    """Render until all views have these passes, and the reference its own.

    Raises ``DeviceError`` if a GPU is requested and Cycles finds none.
    """
    with (
        device.chosen(cycles_device),
        built(name) as stage,
        settings.applied(stage.scene, settings.ground_truth(SIZE, PASS, cycles_device, threads=1)),
        renderer(stage, DENOISE) as camera,
    ):
        scene = Scene(name, stage.cameras, work, cycles_device)
        with Claims(scene.work / ".claims", print) as claims:
            for count in range(1, len(passes) + 1):
                for view in (*scene.stored, scene.again):
                    _improve(scene, view, passes[:count], camera, claims)
            of_a_half = REFERENCE_FACTOR * sum(passes) // 2 if reference else 0
            chunks = [PASS] * (of_a_half // PASS) + [of_a_half % PASS] * bool(of_a_half % PASS)
            for count in range(1, len(chunks) + 1):
                for half in scene.halves:
                    _improve(scene, half, chunks[:count], camera, claims)
            for view in scene.stored:
                view.keep()
            if description := scene.describe():
                folder.write_json(scene.target / stored_truth.TRUTH_FILE, description)
                floors = (json.dumps(description.get(key)) for key in ("noise_floor", "reference_floor"))
                print(f"{name}: {' '.join(floors)}")
            else:
                print(f"{name}: another process is at work on the rest; run this again when it has ended")


def _improve(scene: Scene, view: View, wanted: list[int], camera: Renderer, claims: Claims) -> None:
    """Those of the ``wanted`` passes that are missing, unless another process is at work on the view.

    Raises ``ConflictError`` where passes of other sizes are there.
    """
    claim = view.name.replace("/", "_")
    if len(view.passes) >= len(wanted) or not claims.take(claim):
        return
    try:
        while len(there := view.passes) < len(wanted):
            if there != wanted[: len(there)]:
                raise ConflictError(
                    f"{scene.name} {view.name} has the passes {there}, and {wanted} are requested",
                    "ask for those that are there and for further ones",
                )
            facts = view.improve(camera, wanted[len(there)])
            print(f"{scene.name} {view.name}: {facts['passes']}, {facts['cpu_seconds']} CPU s", flush=True)
    finally:
        claims.release(claim)


def sizes(text: str) -> list[int]:
    """Of ``256,1024,1024``; raises ``ValueError`` for what is no list of numbers above 0."""
    found = [int(word) for word in text.split(",")]
    if min(found) < 1:
        raise ValueError(text)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scenes", nargs="+", choices=list(SCENES))
    parser.add_argument("--passes", type=sizes, default=[PASS], metavar="N,N,…", help="samples of each")
    parser.add_argument("--reference", action="store_true")
    parser.add_argument("--device", choices=device.DEVICES, default=Options.device)
    parser.add_argument("--work", type=Path, required=True)
    given = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    try:
        for scene in given.scenes:
            work_on(scene, given.passes, given.reference, given.work, given.device)
    except PhysHDRError as error:
        sys.exit(f"error: {error.message}{': ' + error.hint if error.hint else ''}")


if __name__ == "__main__":
    main()
