# SPDX-License-Identifier: GPL-3.0-or-later
"""A training of large pictures gives back what its heap keeps; one of small ones is left alone."""

import dataclasses
import subprocess
import sys

import pytest
import torch

from physhdr.backend.runs import tidy
from physhdr.backend.scene import read_scene
from physhdr.backend.train.begin import begin
from physhdr.backend.train.config import TrainConfig

#: A block is kept after it was freed, and given back; prints the megabytes held before and after, and then.
FREED = """
import numpy as np, psutil
from physhdr.backend.simd import give_back_freed_memory

def held():
    return psutil.Process().memory_info().rss / 1e6

before = held()
large = [np.ones(1_000_000) for _ in range(100)]  # 800 MB
between = [np.ones(10) for _ in range(1000)]  # above them, so that the heap cannot simply end below
del large
kept = held() - before
give_back_freed_memory()
print(kept, held() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="of glibc's heap")
def test_what_is_freed_is_kept_until_it_is_given_back():
    done = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True)
    kept, then = map(float, done.stdout.split())
    assert kept > 700.0 and then < 100.0


@pytest.mark.parametrize(("pixels", "times"), [(500_000, 3), (499_999, 0)])
def test_every_hundred_iterations_of_large_pictures(pixels, times, tiny_data, monkeypatch):
    given_back = []
    monkeypatch.setattr(tidy, "give_back_freed_memory", lambda: given_back.append(state.iteration))
    scene = read_scene(tiny_data)
    camera = dataclasses.replace(scene.train[0].camera, width=pixels, height=1)
    state = begin(scene, TrainConfig(iterations=300, initial_points="random", random_points=100))
    state.views[0] = dataclasses.replace(state.views[0], camera=camera)
    tidying = tidy.Tidying(state)
    for state.iteration in range(1, 301):
        assert tidying() == 0.0
    assert given_back == [100, 200, 300][:times]
    assert state.device == torch.device("cpu")
