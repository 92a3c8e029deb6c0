# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked for: the options of a data set, their defaults and their limits."""

import math
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

from ..bridge.lights import AMBIENT
from ..bridge.limits import PARTS_MAX, THREADS_MAX
from .built_in import SCENES
from .camera_model import CameraModel
from .device import DEVICES
from .errors import OptionError, UnknownNameError
from .light_names import LightChoice
from .rig import PATH, RIGS

#: Of a user's scene; a built-in one brings its own.
USERS_EVS = (-3.0, -1.0, 1.0, 3.0, 5.0)
LARGEST_EV = 19.0
MOST_EXPOSURES = 64
LARGEST_SIDE = 8192
LARGEST_LEVEL = 1024.0
#: The least beside 0 that the trainer's reader takes (bridge/limits.py).
LEAST_LEVEL = 1e-6
#: Degrees: nearer to the zenith the direction of 'up' is lost.
LARGEST_ELEVATION = 85.0
#: Of the undenoised reference: how many times the samples of what it checks. Its two halves need no more.
REFERENCE_FACTOR = 2
#: The height of a resolution that follows the aspect of the user's scene.
FOLLOW = 0
#: Options that are left out of what is remembered where they are not used.
_OPTIONAL = ("test_samples", "reference_samples", "validation_views")
#: The value of ``--scene`` that means every built-in one.
ALL = "all"
#: The value of ``from_file`` that means the file that is open.
CURRENT = "current"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Everything that changes what is in the folder. Two runs with equal options make the same data set."""

    scene: str = "interior"
    resolution: tuple[int, int] = (200, 200)
    #: At most so many a pixel.
    samples: int = 32
    #: Of the test and the validation views, whose radiance methods are measured against; as ``samples`` if
    #: ``None``.
    test_samples: int | None = None
    #: Of one test view without denoising, against which the truth is checked; ``REFERENCE_FACTOR`` ×
    #: ``test_samples`` if ``None``, 0: not checked.
    reference_samples: int | None = None
    #: A folder of true radiance (``stored_truth.py``): its views are not rendered again.
    test_truth: str | None = None
    #: A data set of the same scene whose renders are taken: only what the camera makes of them differs.
    renders_of: str | None = None
    #: Where Cycles stops sampling a pixel earlier; 0 never.
    noise_threshold: float = 0.0
    views: int = 35
    #: Further poses, neither trained nor tested: choices are made with these.
    validation_views: int = 0
    #: Seconds, shortest first; the scene's own if ``None``.
    exposures: tuple[float, ...] | None = None
    crf: str = "reinhard-gamma"
    seed: int = 0
    #: Of the relit truth, the ambient light alone; further lights that vary get the same. The default lies
    #: between and beyond ``lit_levels``, those that are trained.
    ambient_levels: tuple[float, ...] = (0.125, 0.5, 2.0, 8.0)
    #: Test poses that get the relit truth; all if ``None``.
    relit_views: int | None = None
    #: Relit truth with several lights at once; by itself (``plan.mixtures``) if ``None``.
    mixed_levels: tuple[tuple[tuple[str, float], ...], ...] | None = None
    lit_levels: tuple[float, ...] = (0.25, 4.0)
    lit_views: int = 12
    #: The lights that vary in the lit views.
    lit_lights: tuple[str, ...] = (AMBIENT,)
    camera_rig: str = "grid"
    denoise: bool = True
    device: str = "CPU"
    #: Processes that render at the same time, this one included.
    workers: int = 1
    #: Threads of each of them; 0: all of the processor's, shared out.
    threads: int = 0
    #: (k, n): only the k-th of n parts of the poses, and nothing that needs them all; all if ``None``.
    part: tuple[int, int] | None = None
    #: Noise and other faults of the camera that takes the brackets.
    camera: CameraModel = field(default_factory=CameraModel)
    #: A folder of models for the furniture of built-in scenes.
    assets: str | None = None
    #: A .blend file, or ``CURRENT``: the data set is made of the user's scene in it instead of ``scene``.
    from_file: str | None = None
    #: Whether that file's Python may run, drivers above all; as Blender was started if not.
    allow_scripts: bool = False
    #: The scene in that file; its active one if empty.
    scene_name: str = ""
    #: The lights of that scene that are distinguished, beside the ambient one; its light groups if empty.
    light_choices: tuple[LightChoice, ...] = ()
    #: Metres from the user's camera to what the rig looks at; found by itself if ``None``.
    rig_distance: float | None = None
    #: Width and height of the grid in metres; a share of the distance if ``None``.
    rig_extent: tuple[float, float] | None = None
    #: Degrees of azimuth of orbit and hemisphere.
    rig_arc: float | None = None
    #: Lowest and highest degrees above the horizon of the hemisphere.
    rig_elevation: tuple[float, float] | None = None

    @property
    def bracket(self) -> tuple[float, ...]:
        """The exposures in seconds, which are known once there is a scene."""
        assert self.exposures is not None
        return self.exposures

    def check(self) -> None:
        """Raise ``OptionError`` or ``UnknownNameError`` for the first option that cannot be."""
        rigs = [*RIGS, PATH] if self.from_file else list(RIGS)
        if not self.from_file and self.scene not in SCENES:
            raise UnknownNameError("scene", self.scene, list(SCENES))
        if not self.from_file and not SCENES[self.scene].is_here:
            raise OptionError(
                f"--scene {self.scene}: the built-in scenes come with the project's repository, and the "
                "installed extension leaves them out",
                "render a scene of your own with --from-file, or run make_scene.py in the repository",
            )
        if self.camera_rig not in rigs:
            raise UnknownNameError("camera rig", self.camera_rig, rigs)
        if self.device not in DEVICES:
            raise UnknownNameError("device", self.device, list(DEVICES))
        for side in self.resolution:
            if side != FOLLOW or not self.from_file:
                within("--resolution", side, 8, LARGEST_SIDE)
        within("--samples", self.samples, 1, 2**20)
        within("--noise-threshold", self.noise_threshold, 0.0, 1.0)
        within("--views", self.views, 2, 10_000)
        within("--seed", self.seed, 0, 2**31 - 1)
        within("--workers", self.workers, 1, THREADS_MAX)
        within("--threads", self.threads, 0, THREADS_MAX)
        if self.part is not None:
            within("--part: the number of parts", self.part[1], 1, PARTS_MAX)
            within(f"--part: of {self.part[1]} parts", self.part[0], 1, self.part[1])
        within("--lit-views", self.lit_views, 0, 10_000)
        within("--validation-views", self.validation_views, 0, 10_000)
        self._check_truth()
        if self.relit_views is not None:
            within("--relit-views", self.relit_views, 0, self.views // 2)
        self.camera.check()
        self._check_rig()
        self._check_exposures()
        self._check_levels()
        if self.light_choices and not self.from_file:
            raise OptionError("--light is for --from-file: the built-in scenes bring their own lights")
        for choice in self.light_choices:
            choice.check()
        if len({choice.name for choice in self.light_choices}) != len(self.light_choices):
            raise OptionError(f"--light {', '.join(map(str, self.light_choices))}: each name once")
        if self.assets and self.from_file:
            raise OptionError("--assets is for the built-in scenes, and --from-file asks for your own")

    def _check_truth(self) -> None:
        if self.test_samples is not None:
            within("--test-samples", self.test_samples, 1, 2**20)
        if self.reference_samples is not None:
            within("--reference-samples", self.reference_samples, 0, 2**24)
            if self.test_samples is None:
                raise OptionError("--reference-samples is a check of --test-samples: give that, too")
        if self.test_truth is not None and self.test_samples is not None:
            raise OptionError(
                "--test-samples: the test views of --test-truth are not rendered; give one of them"
            )
        if self.test_truth is not None and self.from_file:
            raise OptionError("--test-truth is for the built-in scenes, and --from-file asks for your own")
        if self.test_truth is not None and self.relit_views != 0:
            raise OptionError(
                "--test-truth: truth that was kept is under the standard light alone",
                "give --relit-views 0, or render the test views here, without --test-truth",
            )

    @property
    def reference(self) -> int:
        """Samples of the reference; 0: there is none."""
        if self.test_samples is None:
            return 0
        chosen = self.reference_samples
        return REFERENCE_FACTOR * self.test_samples if chosen is None else chosen

    def _check_exposures(self) -> None:
        if self.exposures is None:
            return
        if not self.exposures:
            raise OptionError("--exposures: at least one is needed")
        if len(self.exposures) > MOST_EXPOSURES:
            raise OptionError(f"--exposures: {len(self.exposures)} are too many; at most {MOST_EXPOSURES}")
        for value in self.exposures:
            within("--exposures (seconds: EV −3 is 0.125; --evs takes EV)", value, 1e-6, 1e6)
        if any(b <= a for a, b in pairwise(self.exposures)):
            raise OptionError(f"--exposures {join(self.exposures)}: must rise, shortest first")

    def _check_levels(self) -> None:
        named = (("--ambient-levels", self.ambient_levels), ("--train-ambient-levels", self.lit_levels))
        for name, levels in named:
            for level in levels:
                _check_level(name, level)
            if len(set(levels)) != len(levels):
                raise OptionError(f"{name} {join(levels)}: each level once")
        if 1.0 in self.ambient_levels:
            raise OptionError("--ambient-levels: level 1 is the test split itself; leave it out")
        if self.lit_views and not self.lit_levels:
            raise OptionError("--lit-views: needs at least one of --train-ambient-levels (or --lit-views 0)")
        if self.lit_views and not self.lit_lights:
            raise OptionError("--lit-views: needs at least one of --lit-lights (or --lit-views 0)")
        if len(set(self.lit_lights)) != len(self.lit_lights):
            raise OptionError(f"--lit-lights {','.join(self.lit_lights)}: each light once")
        for levels in self.mixed_levels or ():
            for name, level in levels:
                _check_level(f"--mixed-levels: {name}", level)
            if len({name for name, _ in levels}) != len(levels):
                raise OptionError(f"--mixed-levels: a light is named twice in {dict(levels)}")

    def _check_rig(self) -> None:
        numbers = {
            "--rig-distance": self.rig_distance,
            "--rig-extent": self.rig_extent,
            "--rig-arc": self.rig_arc,
            "--rig-elevation": self.rig_elevation,
        }
        rig_options = [name for name, value in numbers.items() if value is not None]
        if rig_options and not self.from_file:
            raise OptionError(f"{rig_options[0]} is for --from-file: the built-in scenes bring their own rig")
        if self.rig_distance is not None:
            within("--rig-distance (metres)", self.rig_distance, 1e-3, 1e6)
        for side in self.rig_extent or ():
            within("--rig-extent (metres)", side, 0.0, 1e6)
        if self.rig_arc is not None:
            within("--rig-arc (degrees)", self.rig_arc, 0.1, 360.0)
        for angle in self.rig_elevation or ():
            within("--rig-elevation (degrees)", angle, -LARGEST_ELEVATION, LARGEST_ELEVATION)
        if self.rig_elevation and self.rig_elevation[0] > self.rig_elevation[1]:
            raise OptionError(f"--rig-elevation {join(self.rig_elevation)}: the lower one first")

    def as_json(self) -> dict[str, Any]:
        """What a resumed run must have in common with the first; where the file lies is no part of it."""
        values = {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}
        values["camera"] = self.camera.describe()
        for name in ("workers", "threads", "part", "renders_of", "test_truth", "allow_scripts"):
            del values[name]
        if self.mixed_levels is not None:
            values["mixed_levels"] = [dict(levels) for levels in self.mixed_levels]
        values["light_choices"] = [str(choice) for choice in self.light_choices]
        if not self.light_choices:
            del values["light_choices"]
        values["assets"] = self.assets is not None
        for name in _OPTIONAL:
            if values[name] == getattr(Options, name):
                del values[name]
        if not self.from_file:
            del values["from_file"], values["scene_name"]
        else:
            values["from_file"] = True
        unused = ("rig_distance", "rig_extent", "rig_arc", "rig_elevation")
        values = {key: value for key, value in values.items() if key not in unused or value is not None}
        if self.device == Options.device:
            del values["device"]
        return values


def seconds(evs: tuple[float, ...]) -> tuple[float, ...]:
    """Exposures of EVs: EV 0 is one second, each EV doubles it."""
    return tuple(2.0**ev for ev in evs)


def evs(exposures: tuple[float, ...]) -> list[float]:
    """EVs of exposures in seconds."""
    return [round(math.log2(value), 6) for value in exposures]


def within(name: str, value: float, low: float, high: float) -> None:
    """Raise ``OptionError`` where the value of the option ``name`` is out of range."""
    if not low <= value <= high:  # also catches NaN
        raise OptionError(f"{name}: {value:g} is not within {low:g} … {high:g}")


def _check_level(name: str, level: float) -> None:
    if level != 0.0:
        within(name, level, LEAST_LEVEL, LARGEST_LEVEL)


def join(values: tuple[float, ...]) -> str:
    """Numbers as they are written on the command line."""
    return ",".join(f"{value:g}" for value in values)
