# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``physhdr render`` of a video would show, frame by frame."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from physhdr.backend.cli.video import Frame, Video, pictures, round_trip, there_and_back
from physhdr.backend.evaluate.renderer import Renderer
from physhdr.backend.scene import Camera, read_scene
from physhdr.bridge.errors import BadValueError


class Grey(Renderer):
    """Shows its exposure as grey: a quarter of it, and how often it was asked for brackets."""

    lights = ("ambient", "lamp")
    can_relight = True

    def __init__(self) -> None:
        self.brackets = 0

    def hdr(self, camera: Camera, lighting_level=1.0) -> torch.Tensor:
        return torch.ones(3, camera.height, camera.width)

    def ldr(self, camera: Camera, exposure: float, lighting_level=1.0) -> torch.Tensor:
        return self.hdr(camera) * min(exposure / 4.0, 1.0)

    def ldr_bracket(self, camera: Camera, exposures, lighting_level=1.0) -> list[torch.Tensor]:
        self.brackets += 1
        return [self.ldr(camera, exposure) for exposure in exposures]


def video(**options) -> Video:
    return Video(source=Path("run"), out=[Path("a.mp4")], seconds=1.0, fps=20, **options)


def test_sweeps_go_there_and_back_in_even_stops() -> None:
    values = np.log2(there_and_back(0.125, 8.0, 12))
    np.testing.assert_allclose(values, [-3, -2, -1, 0, 1, 2, 3, 2, 1, 0, -1, -2], atol=1e-12)


def test_a_round_trip_begins_and_ends_where_things_stand() -> None:
    stops = np.log2(round_trip(2.0, 0.125, 8.0, 12))
    np.testing.assert_allclose(stops, [1, 2, 3, 2, 1, 0, -1, -2, -3, -2, -1, 0], atol=1e-12)
    down_first = np.log2(round_trip(2.0, 8.0, 0.125, 12))
    np.testing.assert_allclose(down_first, [1, 0, -1, -2, -3, -2, -1, 0, 1, 2, 3, 2], atol=1e-12)
    assert round_trip(0.0, 0.125, 8.0, 12)[0] == 0.125  # a lamp that is off in the photos
    assert round_trip(100.0, 1.0, 4.0, 4)[0] == 4.0, "from the nearer end where it stands outside"
    assert round_trip(1.0, 3.0, 3.0, 2) == [3.0, 3.0]


def test_a_path_shows_the_middle_exposure(data_set: Path) -> None:
    scene = read_scene(data_set)
    for path in ("spline", "orbit"):
        frames = video(path=path, width=24).plan(scene, Grey())
        assert len(frames) == 20 and len({id(frame.camera) for frame in frames}) == 20
        assert {(frame.exposure, frame.levels, frame.camera.width) for frame in frames} == {
            (2.0, (1.0, 1.0), 24)
        }


def test_an_exposure_sweep_stands_still_and_is_rendered_in_few_passes(data_set: Path) -> None:
    frames = video(sweep="exposure", view="test/3").plan(read_scene(data_set), Grey())
    assert {tuple(frame.camera.position) for frame in frames} == {(3.0, -5.0, 1.0)}
    assert (frames[0].exposure, max(frame.exposure for frame in frames)) == (0.125, pytest.approx(32.0))
    method = Grey()
    shown = list(pictures(method, frames))
    assert len(shown) == 20 and method.brackets == 2
    expected = [np.floor(255 * min(frame.exposure / 4, 1) + 0.5) for frame in frames]
    np.testing.assert_array_equal([picture[0, 0, 0] for picture in shown], expected)


def test_a_lighting_sweep_turns_one_light(data_set: Path) -> None:
    frames = video(
        sweep="lighting", light="lamp", sweep_range=(0.5, 2.0), lighting_levels=("ambient=3",)
    ).plan(read_scene(data_set), Grey())
    assert {frame.levels[0] for frame in frames} == {3.0} and {frame.exposure for frame in frames} == {2.0}
    assert (frames[0].levels[1], frames[10].levels[1]) == (0.5, pytest.approx(2.0))


def test_a_sweep_of_both_turns_the_exposure_and_then_the_light(data_set: Path) -> None:
    frames = video(sweep="both", path="orbit", lighting_levels=("ambient=2", "lamp=3")).plan(
        read_scene(data_set), Grey()
    )
    assert len({id(frame.camera) for frame in frames}) == 20, "along a path, if one is asked for"
    first, second = frames[:10], frames[10:]
    assert {frame.levels for frame in first} == {(2.0, 3.0)} and {f.exposure for f in second} == {2.0}
    assert [frame.exposure for frame in first] == round_trip(2.0, 0.125, 32.0, 10)
    assert [frame.levels for frame in second] == [(level, 3.0) for level in round_trip(2.0, 0.125, 8.0, 10)]

    ends = (0.5, 4.0, 0.25, 4.0)
    frames = video(sweep="both", sweep_range=ends, light="lamp").plan(read_scene(data_set), Grey())
    assert [frame.exposure for frame in frames[:10]] == round_trip(2.0, 0.5, 4.0, 10)
    assert [frame.levels for frame in frames[10:]] == [(1.0, x) for x in round_trip(1.0, 0.25, 4.0, 10)]


def test_frames_that_differ_in_light_are_not_one_bracket(data_set: Path) -> None:
    camera, method = read_scene(data_set).test[0].camera, Grey()
    assert len(list(pictures(method, [Frame(camera, 1.0, (1.0,)), Frame(camera, 1.0, (2.0,))]))) == 2
    assert method.brackets == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": "still"}, "still camera needs a sweep"),
        ({"sweep": "lighting", "light": "sun"}, r"has no light 'sun'\n.*ambient, lamp"),
        ({"sweep": "exposure", "view": "test/9"}, "no pose 9"),
        ({"lighting_levels": ("sun=3",)}, "sun"),
    ],
)
def test_what_cannot_be_shown(data_set: Path, options, message) -> None:
    with pytest.raises(BadValueError, match=message):
        video(**options).plan(read_scene(data_set), Grey())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"in one place, where --path spline stays\n.*--sweep exposure or lighting"),
        ({"path": "orbit"}, "in one place, where --path orbit stays"),
        ({"sweep": "exposure"}, r"would be the same: the data set has one exposure\n.*--sweep-range"),
        ({"sweep": "exposure", "path": "orbit"}, "--path orbit stays, and the data set has one exposure"),
        ({"sweep": "exposure", "sweep_range": (3.0, 3.0)}, "the ends of --sweep-range are equal"),
        ({"sweep": "lighting", "sweep_range": (1.0, 1.0)}, "the ends of --sweep-range are equal"),
    ],
)
def test_a_video_in_which_nothing_changes_is_refused(data_set: Path, options, message) -> None:
    """Of one training view at one exposure, which may be a whole data set."""
    scene = read_scene(data_set)
    view = scene.train[0]
    one = replace(view, exposures=view.exposures[:1], sources=view.sources[:1], bracket=view.bracket[:1])
    with pytest.raises(BadValueError, match=message):
        video(**options).plan(replace(scene, train=[one]), Grey())
    assert video(sweep="lighting").plan(replace(scene, train=[one]), Grey())


def test_a_method_that_cannot_relight(data_set: Path) -> None:
    method = Grey()
    method.can_relight = False
    for sweep in ("lighting", "both"):
        with pytest.raises(BadValueError, match=r"cannot relight[\s\S]*--sweep exposure"):
            video(sweep=sweep).plan(read_scene(data_set), method)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"out": [Path("a.gif")]}, r"must end in .*\.webp, got a\.gif\n.*a folder"),
        ({"fps": 0}, "--fps 0"),
        (
            {"seconds": 0.01, "sweep": "exposure"},
            "0.01 at --fps 30 is too short: a video needs 2 frames",
        ),
        ({"seconds": 1.0, "fps": 1}, "needs 2 frames"),
        ({"exposure": -1.0}, "--exposure is -1 s: it must be from"),
        ({"exposure": float("inf")}, "--exposure is inf s: it must be from"),
        ({"exposure": float("nan")}, "--exposure is nan s"),
        ({"sweep_range": (1.0, 2.0)}, "with --sweep none"),
        ({"sweep": "exposure", "sweep_range": (0.0, 2.0)}, "two values above 0"),
        ({"sweep": "exposure", "sweep_range": (1.0, float("inf"))}, "--sweep-range is inf s"),
        ({"sweep": "lighting", "sweep_range": (1.0, 1e9)}, "is 1e.09 times the standard light"),
        ({"sweep": "both", "sweep_range": (1.0, 2.0, 1.0, float("inf"))}, "inf times the standard light"),
        ({"sweep": "both", "sweep_range": (1.0, 2.0)}, r"1 2 with --sweep both[\s\S]*four"),
        ({"sweep": "exposure", "sweep_range": (1.0, 2.0, 1.0, 2.0)}, "1 2 1 2 with --sweep exposure"),
        ({"light": "lamp"}, "--light only works with"),
        ({"camera_prim": "camera"}, "--camera-prim only works with --camera"),
        ({"camera_space": Path("d.json")}, "--camera-space only works with --camera"),
        ({"camera": Path("s.json"), "seconds": 2.0}, "--seconds has no effect: --camera"),
        ({"camera": Path("s.json"), "fps": 12}, "--fps has no effect: --camera"),
        ({"camera": Path("s.json"), "view": "test/1"}, "--view is for a still camera"),
        ({"path": "orbit", "sweep": "exposure", "view": "test/1"}, "--view is for a still camera"),
        ({"view": "test/1"}, "--view is for a still camera"),
    ],
)
def test_options_that_mean_nothing(options, message) -> None:
    """Said before the run is opened."""
    with pytest.raises(BadValueError, match=message):
        Video(**({"source": Path("none"), "out": [Path("a.mp4")]} | options)).work()
