# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a training is said to take: by a clock that is made up, and that saying it changes nothing.

Against real trainings it is measured (docs/performance.md), not tested: a test's machine is busy.
"""

import dataclasses
import gc
import math
import weakref

import pytest
import torch

from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.forecast import duration
from physhdr.backend.train.forecast.course import Course
from physhdr.backend.train.forecast.duration import Cost, Duration, about, time_training
from physhdr.backend.train.nuisances import Nuisances
from physhdr.backend.train.presets import PRESETS
from physhdr.backend.train.state import State

PLAN = Course(iterations=1000, first=100, most=500, grows_from=100, grows_until=600, half_until=300)
#: Made-up seconds of an iteration: of itself, of a pixel, of a Gaussian; and of a picture's decoding.
OF_ITSELF, OF_PIXEL, OF_GAUSSIAN, OF_DECODING = 0.01, 3e-6, 2e-4, 0.5


class MadeUpClock:
    """Stands still but for iterations of a state and pictures that it decodes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.seen, self.steps = 0.0, set(), 0
        step, batch = duration.step, State.batch

        def seeing(state, iteration):
            made = batch(state, iteration)
            for k in state.draw(iteration)[1]:
                if (where := (state.draw(iteration)[0].name, k)) not in self.seen:
                    self.seen.add(where)
                    self.now += OF_DECODING
            return made

        def stepping(state):
            camera = state.batch(state.iteration).camera
            self.now += iteration_seconds(camera.width * camera.height, state.method.size)
            self.steps += 1
            return step(state)

        monkeypatch.setattr(State, "batch", seeing)
        monkeypatch.setattr(duration, "step", stepping)

    def __call__(self) -> float:
        return self.now


def iteration_seconds(pixels: int, gaussians: float) -> float:
    return OF_ITSELF + OF_PIXEL * pixels + OF_GAUSSIAN * gaussians


def short(preset: str, **changes):
    config = PRESETS[preset]
    density = dataclasses.replace(config.backbone, budget=600)
    changes = {"initial_points": "random", "random_points": 200, "backbone": density} | changes
    return dataclasses.replace(config, iterations=1000, **changes)


def test_the_sum_over_a_training_whose_cost_is_known(monkeypatch, tiny_data):
    scene, clock = read_scene(tiny_data), MadeUpClock(monkeypatch)
    state = begin(scene, short("default", half_size_until=0.0))
    told = time_training(state, clock)
    pixels = scene.train[0].camera.width * scene.train[0].camera.height
    # 200 Gaussians become 600 from iteration 100 to 600.
    counts = [min(max(200 + 400 * (i - 100) / 500, 200), 600) for i in range(1000)]
    expected = duration.BESIDE * sum(iteration_seconds(pixels, count) for count in counts)
    pictures = sum(len(places) for places in state.data.exposures)
    assert told.seconds == pytest.approx(expected + OF_DECODING * pictures, rel=1e-6)
    assert clock.steps == 2 * (duration.TIMED + 1)  # as many as there are at first, and in the end


def test_time_left_follows_what_later_iterations_cost():
    told = Duration(PLAN, Cost(0.1), Cost(0.2, 1e-3))
    half, full = 0.1, [0.2 + 1e-3 * min(100 + 400 * (i - 100) / 500, 500) for i in range(300, 1000)]
    assert told.seconds == pytest.approx(duration.BESIDE * (300 * half + sum(full)))
    # 200 iterations have been done, a busy machine needed twice the time for each.
    assert told.left(200, rate=1 / (2 * half)) == pytest.approx(2 * (100 * half + sum(full)))
    assert told.left(1000, rate=5.0) == 0.0 and told.left(5, rate=0.0) == 0.0


def test_a_training_that_goes_on_takes_what_is_left():
    whole, rest = Duration(PLAN, Cost(0.1), Cost(0.2)), Duration(PLAN, Cost(0.1), Cost(0.2), begun=300)
    assert rest.seconds == pytest.approx(duration.BESIDE * 700 * 0.2)
    assert whole.seconds - rest.seconds == pytest.approx(duration.BESIDE * 300 * 0.1)


def test_a_short_training_is_not_timed(tiny_data):
    """Eight iterations would be more than a fiftieth of it."""
    state = begin(read_scene(tiny_data), dataclasses.replace(short("default"), iterations=399))
    assert time_training(state, lambda: pytest.fail("timed")) is None


def numbers_of(state: State) -> list[torch.Tensor]:
    """All numbers of a training, and torch's random state."""
    groups = state.method.parameter_groups().values()
    numbers = [tensor.detach().clone() for group in groups for tensor in group]
    photos = {} if state.part(Nuisances) is None else state.part(Nuisances).tensors()
    optimiser = state.optimiser.state_tensors()
    return [*numbers, *(t.clone() for t in (*optimiser.values(), *photos.values())), torch.get_rng_state()]


@pytest.mark.parametrize(
    ("preset", "nuisances"),
    [
        ("default", "on"),
        *(
            pytest.param(preset, "off", marks=pytest.mark.long)
            for preset in ("default", "default-scaffold", "gausshdr-short", "hdr-nerf-small")
        ),
    ],
)
def test_a_training_that_was_timed_ends_as_one_that_was_not(preset, nuisances, tiny_data, monkeypatch):
    monkeypatch.setattr(duration, "SHARE", math.inf)
    scene, ends = read_scene(tiny_data), []
    half = 0.5 if PRESETS[preset].half_size_until else 0.0
    start = {"start": 4} if PRESETS[preset].backbone.name == "gaussians" else {}
    density = dataclasses.replace(PRESETS[preset].backbone, every=4, stop=0.9, threshold=1e-6, **start)
    config = dataclasses.replace(
        short(preset, backbone=density, half_size_until=half),
        iterations=12,
        nuisances=nuisances,
    )
    for timed in (False, True):
        state = begin(scene, config)
        if timed:
            before = numbers_of(state)
            assert time_training(state) is not None
            assert all(map(torch.equal, before, numbers_of(state))) and state.iteration == 0
        for iteration in range(config.iterations):
            if timed and iteration == 6:
                assert time_training(state) is not None  # as where it is resumed
            duration.step(state)
        ends.append(numbers_of(state))
    assert len(ends[0]) == len(ends[1]) and all(map(torch.equal, *ends))


@pytest.mark.parametrize("preset", ["default", pytest.param("hdr-nerf-small", marks=pytest.mark.long)])
def test_the_copy_is_gone_when_the_training_begins(preset, tiny_data, monkeypatch):
    monkeypatch.setattr(duration, "SHARE", math.inf)
    copies, copy = [], duration._copy

    def copied(state):
        made = copy(state)
        copies.append(weakref.ref(made))
        return made

    monkeypatch.setattr(duration, "_copy", copied)
    state = begin(read_scene(tiny_data), dataclasses.replace(short(preset), iterations=12))
    gc.disable()  # not by chance
    try:
        assert time_training(state) is not None
        assert [each() for each in copies] == [None]
    finally:
        gc.enable()


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (2.0, "about 5 seconds"),
        (62.0, "about 60 seconds"),
        (100.0, "about 2 minutes"),
        (3400.0, "about 57 minutes"),
        (7900.0, "about 2 h 10 min"),
        (30_000.0, "about 8 h 20 min"),
    ],
)
def test_a_time_has_no_more_digits_than_are_known(seconds, words):
    assert about(seconds) == words
