# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures are read before a training asks for them, and are the same pictures."""

import dataclasses
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from physhdr.backend.scene import View, read_scene
from physhdr.backend.scene.prefetch import AHEAD, reading_ahead
from physhdr.backend.scene.scene import PictureCache
from physhdr.backend.train.config import TrainConfig
from physhdr.backend.train.trainer import Trainer


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
        trainer = Trainer(scene, config)
        with reading_ahead(trainer, config.iterations):
            for _ in range(config.iterations):
                trainer.step()
        ends.append({k: v.detach().numpy() for k, v in trainer.method.gaussians.parameters.items()})
    for name, values in ends[0].items():
        np.testing.assert_array_equal(values, ends[1][name])
