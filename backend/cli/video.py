# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render`` for videos: along a path of cameras, through exposures, or under changing light."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby, islice
from typing import Any, Literal

import numpy as np

from ...bridge.errors import BadValueError
from ...bridge.limits import EXPOSURE, LEVEL
from ...bridge.shots import Shots
from ..evaluate.camera_path import camera_of, levels_of, orbit_path, spline_path
from ..evaluate.renderer import Renderer, standard_of
from ..evaluate.sheets import as_picture
from ..evaluate.video import frames_writer, require_suffix, video_writer
from ..runs.files import writable_folder
from ..runs.run import open_run
from ..scene import Camera, Scene
from .lighting import requested_levels
from .options import changed_options, is_folder
from .output import printer, progress
from .rendering import CameraOptions, LookOptions, Rendering, camera_named

#: Default range of a lighting sweep: from an eighth to eight times, as the relit truth.
LIGHT_RANGE = (0.125, 8.0)


#: Maximum duration of a frame in seconds, and largest denominator of a frame rate.
SLOWEST = 1001
#: Maximum number of exposures of one view rendered together.
AT_ONCE = 16
#: Options that a file of cameras sets itself.
OF_A_PATH = ("path", "sweep", "lighting_level", "lighting_levels", "seconds", "fps")


@dataclass(frozen=True)
class Frame:
    """Content of one frame: camera, exposure in seconds, a level for each light."""

    camera: Camera
    exposure: float
    levels: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class VideoOptions:
    """A video, an animated WebP or a folder of numbered pictures, through the learned response: of --camera,
    or along a path while something changes."""

    #: Path through the training cameras, around their centre, or still (the default with a sweep).
    path: Literal["spline", "orbit", "still"] | None = None
    #: What changes: exposure from the shortest to the longest and back, one light's level, or both: exposure
    #: in the first half, light in the second, each from its present value to both ends and back.
    sweep: Literal["none", "exposure", "lighting", "both"] = "none"
    #: Ends of the sweep: seconds or levels, or four for both; default: the data set's exposures, and ⅛ and 8.
    sweep_range: tuple[float, float] | tuple[float, float, float, float] | None = None
    #: Which light a lighting sweep changes; default: the first.
    light: str | None = None
    #: Length in seconds.
    seconds: float = 6.0
    fps: int = 30


@dataclass(frozen=True, kw_only=True)
class Video(Rendering, CameraOptions, LookOptions, VideoOptions):
    """Render a video (H.264), an animated WebP, numbered pictures, or several of these."""

    def work(self) -> dict[str, Any]:
        self._check()
        say = printer(self.json)
        run = open_run(self.source, self.data, self.rasteriser, self.device, say, pictures=False)
        shots = self.shots_of(run.scene)
        frames = self.plan(run.scene, run.method, shots)
        # A fraction: 24 / 1.001 is no integer, nor is the rate if Blender renders every tenth frame.
        exact = Fraction(self.fps if shots is None else shots.fps)
        fps = max(exact.limit_denominator(SLOWEST), Fraction(1, SLOWEST))
        with ExitStack() as stack:
            sinks = []
            for out in self.out:
                if is_folder(out):
                    sink = frames_writer(writable_folder(out), len(frames))
                else:
                    sink = video_writer(out, fps)
                sinks.append(stack.enter_context(sink))
            show = stack.enter_context(progress("video", "frame", self.json))
            for done, picture in enumerate(pictures(run.method, frames), 1):
                for sink in sinks:
                    sink(picture)
                show(done, len(frames), "")
        say(f"wrote {' and '.join(map(str, self.out))}: {len(frames)} frames")
        return {"out": str(self.out[0]), "frames": len(frames)}

    def _check(self) -> None:
        for out in self.out:
            if not is_folder(out):
                require_suffix(out)
        if not (0.0 < self.seconds < 3600.0) or not 1 <= self.fps <= 240:
            raise BadValueError(
                f"--seconds {self.seconds:g} at --fps {self.fps}", "Seconds: up to an hour; fps: 1 to 240."
            )
        if self.camera is None and self._count < 2:
            raise BadValueError(
                f"--seconds {self.seconds:g} at --fps {self.fps} is too short: a video needs 2 frames",
                "Raise one of them.",
            )
        if self.exposure is not None:
            EXPOSURE.check(self.exposure, "--exposure")
        if self.sweep_range is not None:
            wanted = {"none": 0, "both": 4}.get(self.sweep, 2)
            if len(self.sweep_range) != wanted or not min(self.sweep_range) > 0.0:
                ends = " ".join(f"{end:g}" for end in self.sweep_range)
                raise BadValueError(
                    f"--sweep-range {ends} with --sweep {self.sweep}",
                    "It needs --sweep exposure or lighting and two values above 0, or --sweep both and four: "
                    "the exposures, then the levels.",
                )
            for number, end in enumerate(self.sweep_range):
                is_level = self.sweep == "lighting" or number >= 2
                (LEVEL if is_level else EXPOSURE).check(end, "an end of --sweep-range")
        self.require_file()
        if self.camera is not None and (changed := changed_options(self, *OF_A_PATH)):
            raise BadValueError(
                f"--{changed[0]} has no effect: --camera sets every frame's camera, light and time",
                "Leave it out.",
            )
        if not (self.lighting_level or 0.0) >= 0.0:
            raise BadValueError(f"--lighting-level must be 0 or more, got {self.lighting_level}")
        if self.view is not None and (self.camera is not None or self._path != "still"):
            raise BadValueError(
                "--view is for a still camera, and this one moves",
                "Leave it out, or give --path still and a --sweep.",
            )
        if self.light is not None and self.sweep not in ("lighting", "both"):
            raise BadValueError("--light only works with --sweep lighting", "Add --sweep lighting.")

    @property
    def _path(self) -> Literal["spline", "orbit", "still"]:
        """How the camera moves without shots."""
        return self.path or ("spline" if self.sweep == "none" else "still")

    @property
    def _count(self) -> int:
        """The number of frames without shots."""
        return round(self.seconds * self.fps)

    def shots_of(self, scene: Scene) -> Shots | None:
        """The file's frames in the scene's world; None without a file."""
        return None if self.camera is None else self.shots(scene, self.camera, fewest=2)

    def plan(self, scene: Scene, method: Renderer, shots: Shots | None = None) -> list[Frame]:
        """Every frame, from ``shots`` if given.

        Raises ``BadValueError`` where the scene or the method cannot do what was requested.
        """
        exposures = sorted({seconds for view in scene.train for seconds in view.exposures})
        exposure = self.exposure or scene.middle_exposure
        standard = standard_of(method, scene)
        if shots is not None:
            return [
                Frame(
                    camera_of(shot, shots, self.width),
                    exposure * 2.0**shot.exposure_ev,
                    levels_of(shot, method.lights, standard),
                )
                for shot in shots.frames
            ]
        count = self._count
        if self._path == "still":
            if self.sweep == "none":
                raise BadValueError("a still camera needs a sweep", "Add --sweep exposure or lighting.")
            cameras = [camera_named(scene, self.view)] * count
        else:
            standing = [view.camera for view in scene.train]
            cameras = (spline_path if self._path == "spline" else orbit_path)(standing, count)
        if self.width is not None:
            cameras = [camera.resized(self.width) for camera in cameras]
        levels = requested_levels(self.lighting_level, self.lighting_levels, method.lights, standard)
        times, lit = [exposure] * count, [levels] * count
        ends: tuple[float, ...] = self.sweep_range or ()
        low, high = ends[:2] or (LIGHT_RANGE if self.sweep == "lighting" else (exposures[0], exposures[-1]))
        if self.sweep == "exposure":
            times = there_and_back(low, high, count)
        elif self.sweep == "lighting":
            lit = self._lit(method, levels, there_and_back(low, high, count))
        elif self.sweep == "both":
            half = count // 2
            times[:half] = round_trip(exposure, low, high, half)
            darkest, brightest = ends[2:] or LIGHT_RANGE
            turned = round_trip(levels[self._light(method)], darkest, brightest, count - half)
            lit[half:] = self._lit(method, levels, turned)
        poses = {camera.camera_to_world.tobytes() for camera in cameras}
        if len(poses) == len(set(times)) == len(set(lit)) == 1:
            raise self._unchanging()
        return [Frame(*each) for each in zip(cameras, times, lit, strict=True)]

    def _unchanging(self) -> BadValueError:
        """An error explaining why every frame would be the same, and what to do."""
        reasons, remedy = [], "Add --sweep exposure or lighting."
        if self._path != "still":
            reasons.append(f"the training cameras are all in one place, where --path {self._path} stays")
        if self.sweep != "none":
            why = (
                "the ends of --sweep-range are equal" if self.sweep_range else "the data set has one exposure"
            )
            reasons.append(why)
            remedy = "Give a --sweep-range whose ends differ."
        return BadValueError(f"all frames would be the same: {', and '.join(reasons)}", remedy)

    def _lit(
        self, method: Renderer, levels: tuple[float, ...], swept: Sequence[float]
    ) -> list[tuple[float, ...]]:
        """``levels`` with each of ``swept`` for the light that changes."""
        which = self._light(method)
        return [(*levels[:which], level, *levels[which + 1 :]) for level in swept]

    def _light(self, method: Renderer) -> int:
        """Index of the light that changes."""
        if not method.can_relight:
            raise BadValueError(
                "this method cannot relight: a lighting level would only scale the picture, as exposure does",
                "Use --sweep exposure, or train a preset with light (default).",
            )
        if self.light is None:
            return 0
        if self.light not in method.lights:
            raise BadValueError(
                f"this model has no light '{self.light}'", f"The lights are: {', '.join(method.lights)}."
            )
        return method.lights.index(self.light)


def pictures(method: Renderer, frames: list[Frame]) -> Iterator[np.ndarray]:
    """``[H, W, 3]`` uint8 of each frame; frames that differ in exposure alone are rendered together."""
    for _, alike in groupby(frames, key=lambda frame: (id(frame.camera), frame.levels)):
        for some in batched(alike, AT_ONCE):
            first = some[0]
            for ldr in method.ldr_bracket(first.camera, [frame.exposure for frame in some], first.levels):
                yield as_picture(ldr)


def batched(items: Iterable[Frame], size: int) -> Iterator[list[Frame]]:
    """Lists of up to ``size`` items (Python 3.11 has no ``itertools.batched``)."""
    iterator = iter(items)
    while some := list(islice(iterator, size)):
        yield some


def there_and_back(low: float, high: float, count: int) -> list[float]:
    """``count`` values from ``low`` to ``high`` and back, even in stops, so that the video can be looped."""
    share = 1.0 - np.abs(np.linspace(-1.0, 1.0, count, endpoint=False))
    return [float(low * (high / low) ** s) for s in share]


def round_trip(start: float, low: float, high: float, count: int) -> list[float]:
    """``count`` values from ``start`` up to ``high``, down to ``low`` and back, even in stops.

    The next one would be ``start`` again, or the nearer end if it lies outside.
    """
    stops = float(np.log2(high / low))
    begin = float(np.clip(np.log2(max(start, min(low, high)) / low) / stops, 0.0, 1.0)) if stops else 0.0
    # A triangle of period 2, which rises through ``begin`` at 0.
    at = (begin + 2.0 * np.arange(count) / max(count, 1)) % 2.0
    return [float(low * (high / low) ** (1.0 - abs(1.0 - each))) for each in at]
