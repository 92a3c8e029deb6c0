# SPDX-License-Identifier: GPL-3.0-or-later
"""A run as a whole: its data set, its configuration and its trained method."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...bridge.camera_list import ListedCamera
from ...bridge.errors import DataMismatchError
from ...bridge.model_file import PHOTOGRAPHED_EV, Model
from ...bridge.photographed_light import (
    PHOTOGRAPHED_LIGHT,
    STANDARD,
    Found,
    PhotographedLight,
    photographed_light_text,
)
from ..device import DeviceName, choose_device
from ..export.blender_model import on_gaussians, to_model
from ..export.confidence import ViewInTraining, confidence_of
from ..methods.base import Method
from ..rasterize import Implementation
from ..scene import Scene, View, read_scene
from ..train.config import CONFIG_FILE, RunConfig, TrainConfig, read_config
from ..train.learned_lens import LearnedLenses, lenses_of
from ..train.learned_poses import LearnedPoses, moved
from ..train.light_levels import LightLevels, how_found, with_levels
from ..train.nuisances import Nuisances
from ..train.saver import learned_levels, learned_of_photographs, load_method
from ..train.state import State
from ..train.views import seen_exposures, training_views
from .display_scale import display_scale
from .terminal import console
from .views import as_trained, has_its_pictures, read_views


@dataclass(frozen=True)
class Run:
    """What ``physhdr train --out`` left behind, or has under its hands.

    ``lenses``: what it has learned of the photographs' lenses; None where there was nothing to learn.
    ``twists``: ``[V, 6]``, how it has moved its views' cameras (``LearnedPoses.twists``); None: not at all.
    ``found``: of each light group the lights whose levels it has found, and how.
    """

    folder: Path
    preset: str
    config: TrainConfig
    scene: Scene
    method: Method
    iteration: int
    lenses: LearnedLenses | None = None
    twists: np.ndarray | None = None
    found: Mapping[str, Mapping[str, Found]] = field(default_factory=dict)

    @property
    def provenance(self) -> dict[str, str]:
        """Where an exported file comes from, for its metadata."""
        told = {
            "scene": self.scene.name,
            "method": f"{self.config.method.name}, preset {self.preset}",
            "iteration": str(self.iteration),
        }
        if ev := self.photographed_ev:
            told[PHOTOGRAPHED_EV] = f"{ev:.4f}"
        if light := photographed_light_text(self.photographed_light()):
            told[PHOTOGRAPHED_LIGHT] = light
        return told

    @property
    def photographed_ev(self) -> float:
        """At which EV (log2 of seconds) radiance looks as photographs do, 0 for renders: theirs is a scene's.

        Photographs of a hundredth of a second are of radiance about a hundred, which is white as it is.
        """
        return math.log2(self.scene.middle_exposure) if self.scene.photographs else 0.0

    def photographed_light(self) -> list[PhotographedLight]:
        """The light of its standard photographs, then of each group that it was trained on."""
        lights = self.method.lights
        groups = {view.group: view for view in training_views(self.scene, self.config) if view.group}
        found = [PhotographedLight(STANDARD, dict(zip(lights, self.method.standard_levels, strict=True)))]
        for name, view in groups.items():
            levels = dict(zip(lights, view.known_levels, strict=True))
            found.append(PhotographedLight(name, levels, self.found.get(name, {})))
        return found

    @cached_property
    def radiance_scale(self) -> float:
        """What the method's radiance is multiplied by wherever it leaves the run (``display_scale``).

        1 for renders, whose radiance is a scene's, and where the response is known.
        """
        if not (self.scene.photographs and self.method.learns_response):
            return 1.0
        exposure = self.scene.middle_exposure
        views = [each for each in self.trained_views() if each.is_standard and exposure in each.exposures]
        return display_scale(self.method, views[len(views) // 2].camera, exposure)

    def on_gaussians(self) -> Method:
        """The method on plain Gaussians on the CPU, as files hold it."""
        return on_gaussians(self.method, [view.camera for view in self.scene.train])

    def trained_views(self) -> list[View]:
        """The views of the training, their cameras where it has found them to be."""
        views = training_views(self.scene, self.config)
        if self.twists is None:
            return views
        each = zip(views, self.twists, strict=True)
        return [replace(view, camera=moved(view.camera, twist)) for view, twist in each]

    def camera_list(self) -> list[ListedCamera]:
        """What ``cameras.json`` says: of the pictures as they were trained, in size and place."""
        listed = []
        for view in self.trained_views():
            camera = view.camera
            size, lens = (camera.width, camera.height), (camera.fx, camera.fy, camera.cx, camera.cy)
            is_learned = self.twists is not None
            listed.append(ListedCamera(view.name, camera.camera_to_world, *size, *lens, is_learned))
        return listed

    def seen(self) -> list[ViewInTraining] | None:
        """The pictures that training saw, as ``confidence_of`` wants them.

        None where they are not there, or others are in their place.
        """
        views = self.trained_views()
        positions = seen_exposures(views, self.config)
        named = (view.sources[k].path for view, which in zip(views, positions, strict=True) for k in which)
        if not (all(path.is_file() for path in named) and has_its_pictures(self.folder, self.scene)):
            return None
        photos, lenses = self.scene.photographs, self.lenses
        effects = (None if lenses is None else lenses.falloff(view.camera) for view in views)
        each = zip(views, positions, effects, strict=True)
        return [ViewInTraining(view, which, effect, photos) for view, which, effect in each]

    def confidence(
        self, method: Method, show: Callable[[int, int, str], None] | None = None
    ) -> np.ndarray | None:
        """``[N]`` of ``on_gaussians()``; None where ``seen()`` has no pictures to tell it."""
        seen = self.seen()
        return None if seen is None else confidence_of(method, seen, show)

    def model(
        self, show: Callable[[int, int, str], None] | None = None, *, with_confidence: bool = True
    ) -> Model:
        """The model file's content, for Blender: the method as it is now.

        With its confidence where the training pictures are there, which takes a while: ``show`` is told.
        """
        viewpoint = np.mean([view.camera.position for view in self.scene.train], axis=0)
        exposures = self.scene.train[0].exposures
        method = self.on_gaussians()
        return to_model(
            method,
            viewpoint,
            exposures,
            self.provenance,
            self.confidence(method, show) if with_confidence else None,
            self.radiance_scale,
            self.camera_list(),
        )


def open_run(
    folder: Path,
    data: Path | None = None,
    rasteriser: Implementation = "auto",
    device: DeviceName = "cpu",
    report: Callable[[str], None] = console.print,
    pictures: bool = True,
) -> Run:
    """Open a trained run; ``data`` stands in for the folder it was trained on, where that has moved.

    ``pictures``: whether those of the data set are wanted. Without them, for looking and exporting, it opens
    by what it keeps of its data set (``views``) where that is not there, or is another by now;
    ``scene.root`` is where it was. Its training and test views are those that it had (``views.as_trained``).

    Raises what reading raises, and ``DataMismatchError`` where the data set is not what it was trained on.
    """
    written = read_config(folder / CONFIG_FILE)
    config = written.config
    scene = _scene(folder, data, written, pictures, report)
    method, iteration = load_method(
        folder,
        config,
        scene.response_anchor,
        rasteriser,
        choose_device(device)[0],
        written.fingerprint,
    )
    views = training_views(scene, config)
    found = how_found(views, scene.lights)
    scene = _at_levels(scene, learned_levels(folder, views, scene.lights))
    learned, twists = learned_of_photographs(folder)
    lenses = lenses_of(learned, [view.camera for view in scene.train])
    return Run(folder, written.preset, config, scene, method, iteration, lenses, twists, found)


def as_learned(run: Run, state: State) -> Run:
    """The run as its training is now, whatever it has learned of the photographs with it."""
    nuisances, poses, light = state.part(Nuisances), state.part(LearnedPoses), state.part(LightLevels)
    learned = {} if nuisances is None else nuisances.tensors()
    cameras = [view.camera for view in run.scene.train]
    return replace(
        run,
        scene=run.scene if light is None else _at_levels(state.plan.seen.scene, light.levels),
        iteration=state.iteration,
        lenses=lenses_of((learned.get("vignetting"), learned.get("reach")), cameras),
        twists=None if poses is None else poses.twists,
        found={} if light is None else how_found(light.views, light.lights),
    )


def _at_levels(scene: Scene, found: Mapping[tuple[str, int], float]) -> Scene:
    """``scene`` with the levels that a training has found for groups and lights where none is stated."""
    if not found:
        return scene
    return replace(scene, lit=with_levels(scene.lit, found), lit_test=with_levels(scene.lit_test, found))


def _scene(
    folder: Path, data: Path | None, written: RunConfig, pictures: bool, report: Callable[[str], None]
) -> Scene:
    """The run's data set, or what it keeps of it where that is not there and no pictures are wanted."""
    config = written.config
    if data is None and not pictures and not written.data.exists():
        report(f"{written.data} is not there: opened by what the run keeps of its cameras")
        return read_views(folder, written.data)
    scene = read_scene(data or written.data, config.downscale, config.color_space)
    try:
        return as_trained(folder, scene, report, pictures)
    except DataMismatchError as error:
        if data is not None or pictures:
            raise
        report(f"{error.message}; opened by what the run keeps of its cameras")
        # None of the pictures that are there now is taken for one of its own.
        return replace(read_views(folder, folder), root=written.data)
