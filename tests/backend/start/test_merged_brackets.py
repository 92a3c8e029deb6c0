# SPDX-License-Identifier: GPL-3.0-or-later
"""Merged brackets against the noise-free pictures of a camera that is known here, and its known noise."""

import numpy as np
import pytest

from physhdr.backend.start.merged_brackets import CODES, Tables, tables_of

EXPOSURES = (0.05, 0.8, 12.8)
#: Electrons of exposure × radiance 1, and of reading.
ELECTRONS, READ = 900.0, 2.0


def response(x: np.ndarray) -> np.ndarray:
    return 255.0 * np.clip(x, 0.0, 1.0) ** (1.0 / 2.2)


def bracket(pixels: int, seed: int, electrons: float = ELECTRONS) -> tuple[np.ndarray, np.ndarray]:
    """Codes ``[K, P, 3]`` of a noisy camera, rounded, and unrounded codes without its noise."""
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.uniform(np.log(2e-3), np.log(8.0), (pixels, 3)))
    light = np.stack([radiance * t for t in EXPOSURES])
    counted = (rng.poisson(light * electrons) + rng.normal(0.0, READ, light.shape)) / electrons
    return np.rint(response(counted)).astype(np.float32), response(light)


@pytest.fixture(scope="module")
def tables() -> Tables:
    found = tables_of([bracket(200_000, seed)[0] for seed in (1, 2)])
    assert found is not None
    return found


def test_the_noise_of_the_codes_is_found(tables):
    """Against the camera's own: of a code's light many pictures are taken.

    Of dark codes, which longer exposures tell of; in brighter ones it is told by what is brighter yet.
    """
    for code in (30.0, 45.0, 60.0):
        light = (code / 255.0) ** 2.2
        rng = np.random.default_rng(5)
        counted = (rng.poisson(light * ELECTRONS, 100_000) + rng.normal(0.0, READ, 100_000)) / ELECTRONS
        assert np.sqrt(tables.noise[int(code)]) == pytest.approx(response(counted).std(), rel=0.15)


def test_mapping_is_the_cameras(tables):
    """From the longest exposure, where it does not clip, to the others: the codes of the same light."""
    codes = np.array([60, 100, 150, 200, 240])
    light = (codes / 255.0) ** 2.2
    for k in (0, 1):
        wanted = response(light * EXPOSURES[k] / EXPOSURES[2])
        assert np.abs(tables.mapping[2, k, :, codes] - wanted[:, None]).max() < 2.5


def test_merging_takes_noise_away(tables):
    noisy, clean = bracket(50_000, seed=3)
    before, after = (((codes - clean) ** 2).mean(axis=(1, 2)) for codes in (noisy, tables.merged(noisy)))
    assert after[0] < before[0] / 8.0 and after[1] < before[1] / 3.0  # the shortest has most to gain
    assert after[2] < before[2] * 1.05


def test_codes_of_a_good_camera_stay():
    stacks = [bracket(100_000, seed, electrons=1e9)[0] for seed in (1, 2)]
    found = tables_of(stacks)
    assert found is not None and found.worst < 1.0
    assert np.abs(found.merged(stacks[0]) - stacks[0]).max() < 3.0
    assert np.abs(found.merged(stacks[0]) - stacks[0]).mean() < 0.3


def test_what_moved_between_exposures_is_not_mixed(tables):
    noisy, clean = bracket(2_000, seed=4)
    noisy[1] = 250.0 - noisy[1]  # the second picture shows something else
    far = np.abs(noisy[1] - clean[1]) > 150.0
    merged = tables.merged(noisy)
    assert np.abs(merged[1] - noisy[1])[far].max() < 60.0


def test_the_result_is_the_same_for_any_number_of_threads(tables):
    from physhdr.backend.simd import set_threads, thread_count

    noisy, _ = bracket(30_000, seed=6)
    count = thread_count()
    try:
        results = []
        for threads in (1, 3):
            set_threads(threads)
            results.append(tables.merged(noisy))
    finally:
        set_threads(count)
    assert np.array_equal(*results)


def test_brackets_that_do_not_overlap_tell_nothing():
    black, white = np.zeros((1000, 3), np.float32), np.full((1000, 3), CODES - 1, np.float32)
    assert tables_of([np.stack([black, white])]) is None
