# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures are read before a training asks for them, and are the same pictures."""

import dataclasses
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import pytest

from physhdr.backend.scene import View, read_scene
from physhdr.backend.scene.prefetch import AHEAD, reading_ahead
from physhdr.backend.scene.resize import Reduction
from physhdr.backend.scene.scene import PictureCache
from physhdr.backend.scene.source import Decoded
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.trainer import step


@dataclass
class OneAfterTheOther:
    """A training that sees its views in order, each at its first exposure."""

    views: list[View]
    iteration: int = 0
    drawn: list[int] = field(default_factory=list)

    def draw(self, iteration: int) -> tuple[View, tuple[int, ...]]:
        self.drawn.append(iteration)
        return self.views[iteration % len(self.views)], (0,)


def with_cache(views: list[View], budget: int) -> list[View]:
    cache = PictureCache(budget)
    return [dataclasses.replace(view, cache=cache) for view in views]


def until(condition, seconds: float = 5.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    return condition()


@pytest.fixture
def views(tiny_data) -> list[View]:
    return read_scene(tiny_data).train


def test_what_the_next_iterations_want_is_read_and_no_more(views):
    picture = views[0].image(0).nbytes
    training = OneAfterTheOther(with_cache(views, budget=(AHEAD + 1) * picture))
    cache = training.views[0].cache
    with reading_ahead(training, 1000):
        assert until(lambda: cache.bytes_held == (AHEAD + 1) * picture)
        assert max(training.drawn) == AHEAD
        training.iteration = 7
        assert until(lambda: training.drawn[-1] == 7 + AHEAD)
    assert 4 not in training.drawn  # what has been drawn meanwhile needs no reading


def test_it_ends_when_everything_is_in_the_cache(views):
    training = OneAfterTheOther(with_cache(views, budget=1 << 30))
    before = threading.active_count()
    with reading_ahead(training, 1000):
        training.iteration = len(views)
        assert until(lambda: threading.active_count() == before)


def test_it_ends_with_the_training(views):
    before = threading.active_count()
    with pytest.raises(ValueError), reading_ahead(OneAfterTheOther(with_cache(views, budget=1)), 1000):
        raise ValueError
    assert threading.active_count() == before


def test_a_picture_that_cannot_be_read_is_left_to_the_training(views, tmp_path):
    (tmp_path / "gone.png").write_bytes(b"no picture")
    source = dataclasses.replace(views[0].sources[0], path=tmp_path / "gone.png")
    broken = dataclasses.replace(views[0], sources=(source, *views[0].sources[1:]))
    before = threading.active_count()
    with reading_ahead(OneAfterTheOther([broken]), 10):
        assert until(lambda: threading.active_count() == before)


def test_a_training_from_a_cache_that_holds_one_bracket_is_the_same_to_the_bit(tiny_data):
    config = TrainConfig(iterations=20, initial_points="random", random_points=200)
    ends = []
    for budget in (1 << 30, 1):
        scene = read_scene(tiny_data)
        shared = with_cache([*scene.train, *scene.lit], budget)
        scene = dataclasses.replace(
            scene, train=shared[: len(scene.train)], lit=shared[len(scene.train) :], test=[]
        )
        state = begin(scene, config)
        with reading_ahead(state, config.iterations):
            for _ in range(config.iterations):
                step(state)
        ends.append({k: v.detach().numpy() for k, v in state.method.gaussians.parameters.items()})
    for name, values in ends[0].items():
        np.testing.assert_array_equal(values, ends[1][name])


@dataclass(frozen=True, eq=False)
class Slow:
    """A source whose reading waits for somebody."""

    key: str
    read_by: list[str]
    wait: Callable[[], object]

    def read(self, reduction: Reduction) -> Decoded:
        self.read_by.append(self.key)
        self.wait()
        return Decoded(np.zeros((2, 3, 3), np.uint8))


def all_of(cache, sources):
    """What threads find that ask for each of ``sources`` at the same time."""
    with ThreadPoolExecutor(len(sources)) as threads:
        return list(threads.map(cache.get, sources))


def test_two_pictures_are_decoded_at_the_same_time():
    cache, read, both = PictureCache(), [], threading.Barrier(2, timeout=5.0)
    all_of(cache, [Slow("a", read, both.wait), Slow("b", read, both.wait)])  # else the barrier breaks
    assert sorted(read) == ["a", "b"] and cache.bytes_held == 2 * 18


def test_one_picture_is_decoded_once_for_several_who_want_it():
    cache, read = PictureCache(), []
    source = Slow("a", read, lambda: time.sleep(0.1))
    first, *others = all_of(cache, [source] * 4)
    assert read == ["a"] and all(other is first for other in others) and cache.bytes_held == 18
