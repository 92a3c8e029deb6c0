# SPDX-License-Identifier: GPL-3.0-or-later
"""What a web page keeps of a model: how much each number is off, at most, reckoned in closed form."""

import math
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from physhdr.backend.export.quantised import BASE_STEP, CHUNK, REST_STEP, Quantised, quantised, restored
from physhdr.bridge.errors import BadValueError
from physhdr.bridge.model_file import Model
from physhdr.bridge.spherical_harmonics import C0, basis, fibonacci_sphere
from physhdr.bridge.splatting import ALPHA_MIN

EPSILON = 1e-5


def some_model(
    count: int = 700, degree: int = 3, lights: int = 2, seed: int = 0, spread: float = 0.12
) -> Model:
    """Gaussians whose numbers are spread as a trained model's are."""
    rng = np.random.default_rng(seed)
    sh = spread * rng.standard_normal((count, (degree + 1) ** 2, 3))
    sh[:, 0] = rng.uniform(-12.0, 9.0, (count, 3))
    shares = rng.dirichlet(0.4 * np.ones(lights + 1), (count, 3))[..., :lights].transpose(0, 2, 1)
    return Model(
        position=rng.uniform(-5.0, 9.0, (count, 3)).astype(np.float32),
        rotation=rng.standard_normal((count, 4)).astype(np.float32),
        scale=np.exp(rng.uniform(-6.0, 0.0, (count, 3))).astype(np.float32),
        opacity=rng.uniform(ALPHA_MIN, 1.0, count).astype(np.float32),
        log_radiance_sh=sh.astype(np.float32),
        light_share=shares.astype(np.float32),
        lights=tuple(f"light {k}" for k in range(lights)),
        confidence=rng.uniform(0.0, 1.0, count).astype(np.float32),
    )


def matched(model: Model) -> tuple[Quantised, Model, np.ndarray]:
    """What is kept, the model that it makes, and which Gaussian of ``model`` each of its is."""
    packed = quantised(model)
    kept = restored(packed)
    # By place: the boxes are so small that no two change places.
    gaps = np.linalg.norm(kept.position[:, None] - model.position[None], axis=2)
    of = gaps.argmin(axis=1)
    assert len(set(of.tolist())) == kept.count
    return packed, kept, of


def boxes(values: np.ndarray) -> np.ndarray:
    """The extent of each row's chunk, ``[N, 3]``."""
    return np.concatenate(
        [
            np.broadcast_to(np.ptp(c, axis=0), c.shape)
            for c in np.split(values, range(CHUNK, len(values), CHUNK))
        ]
    )


def test_no_number_is_off_by_more_than_half_its_step():
    model = some_model()
    _, kept, of = matched(model)

    box = boxes(model.position[of].astype(np.float64))
    assert (np.abs(kept.position - model.position[of]) <= 0.5 * box / 65535 + 1e-6).all()

    largest = model.scale[of].max(axis=1, keepdims=True)
    logs = np.log(np.maximum(model.scale[of], 1e-3 * largest).astype(np.float64))
    assert (np.abs(np.log(kept.scale) - logs) <= 0.5 * boxes(logs) / 255 + EPSILON).all()

    assert np.abs(kept.opacity - model.opacity[of]).max() <= 0.5 / 255 + EPSILON
    assert np.abs(kept.confidence - model.confidence[of]).max() <= 0.5 / 255 + EPSILON

    base = np.abs(kept.log_radiance_sh[:, 0] - model.log_radiance_sh[of, 0])
    assert base.max() <= 0.5 * BASE_STEP + EPSILON
    rest = np.abs(kept.log_radiance_sh[:, 1:] - model.log_radiance_sh[of, 1:])
    assert 0.4 * REST_STEP < rest.max() <= 0.5 * REST_STEP + EPSILON

    # s = sin² u, |ds/du| ≤ 1, and u has steps of π/510.
    assert np.abs(kept.light_share - model.light_share[of]).max() <= 0.5 * np.pi / 510 * 1.001 + EPSILON


def test_rotations_are_those_that_were_given():
    model = some_model()
    _, kept, of = matched(model)
    given = model.rotation[of] / np.linalg.norm(model.rotation[of], axis=1, keepdims=True)
    # q and −q are one rotation. Three components are off by half of 1/723, the fourth follows: the angle
    # between both is 2 |Δq|, at most, and the largest component is at least ½: |Δq₀| ≤ Σ|qᵢ Δqᵢ| / q₀.
    step = 0.5 / (1023 * math.sqrt(0.5))
    cosine = np.abs((given * kept.rotation).sum(axis=1)).clip(0.0, 1.0)
    assert 2.0 * np.arccos(cosine).max() <= 2.0 * 2.0 * math.sqrt(3.0) * step
    assert 2.0 * np.arccos(cosine).max() > 0.5 * step  # it is not compared with itself


def test_radiance_in_any_direction_is_within_the_bound():
    model = some_model()
    _, kept, of = matched(model)
    directions = fibonacci_sphere(64)
    Y = basis(directions, 3)
    change = np.einsum("dk,nkc->dnc", Y, kept.log_radiance_sh - model.log_radiance_sh[of])
    most = 0.5 * BASE_STEP * C0 + 0.5 * REST_STEP * np.abs(Y[:, 1:]).sum(axis=1).max()
    assert np.abs(change).max() <= most + 1e-4
    # Root mean square: steps Δ make Δ²/12 each, and Σ Y² over k ≥ 1 is 15/4π.
    expected = math.sqrt(REST_STEP**2 / 12 * 15 / (4 * math.pi) + BASE_STEP**2 / 12 * C0**2)
    assert np.sqrt(np.mean(change**2)) == pytest.approx(expected, rel=0.03)


def test_coefficients_of_any_size_have_a_step_that_holds_them():
    model = some_model(count=600, spread=0.1)
    sh = model.log_radiance_sh.copy()
    sh[5, 3, 1] = -19.0
    _, kept, of = matched(Model(**{**vars(model), "log_radiance_sh": sh}))
    error = np.abs(kept.log_radiance_sh - sh[of])[:, 1:]
    # Steps are 2^(code/4) of 0.03: never more than a fourth root of 2 above what 127 of them need.
    assert error.max() <= 0.5 * 19.0 / 127 * 2.0**0.25 + EPSILON
    # Only its own chunk, and only that coefficient, has the larger step.
    chunk = np.flatnonzero(of == 5)[0] // CHUNK
    others = np.ones(error.shape[:2], bool)
    others[chunk * CHUNK : (chunk + 1) * CHUNK, 2] = False
    assert error[others].max() <= 0.5 * REST_STEP + EPSILON


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 255, 256, 257])
def test_any_degree_and_any_count(degree, count):
    model = some_model(count=count, degree=degree, lights=1)
    packed, kept, _ = matched(model)
    assert kept.count == count and kept.sh_degree == degree and packed.omitted == 0
    assert sum(size for _, size in packed.header["planes"]) == len(packed.raw())


def test_shares_near_both_ends_keep_what_is_left():
    # What a light leaves when it is switched off, or is when it is turned up, is a small share.
    share = np.array([0.0, 1e-6, 0.003, 0.997, 1.0 - 1e-6, 1.0], np.float32)
    model = some_model(count=len(share), lights=1)
    shares = np.repeat(share[:, None, None], 3, axis=2)
    _, kept, of = matched(Model(**{**vars(model), "light_share": shares}))
    error = np.abs(kept.light_share - shares[of])[:, 0, 0]
    at = np.sqrt(np.minimum(share, 1.0 - share))[of]
    step = np.pi / 510
    assert (error <= at * step + step**2).all()  # |sin²(u+h) − sin² u| ≤ |sin 2u| h + h², h half a step


def test_baked_levels_are_kept():
    base = some_model(count=300, lights=1)
    rng = np.random.default_rng(3)
    levels = (0.25, 1.0, 4.0)
    gain = (0.5 * rng.standard_normal((3, 300, 3))).astype(np.float32)
    model = Model(**{**vars(base), "light_share": None, "level_log_gain": gain, "levels": levels})
    _, kept, of = matched(model)
    assert kept.levels == levels and kept.light_share is None
    assert np.abs(kept.level_log_gain - gain[:, of]).max() <= 0.5 * REST_STEP + EPSILON


def test_what_cannot_be_seen_is_left_out_and_counted():
    model = some_model(count=20)
    opacity = model.opacity.copy()
    opacity[:8] = ALPHA_MIN * 0.99
    packed = quantised(Model(**{**vars(model), "opacity": opacity}))
    assert (packed.header["count"], packed.omitted) == (12, 8)
    assert packed.planes["opacity"].min() >= 1  # what is drawn stays drawn
    with pytest.raises(BadValueError, match="no Gaussian"):
        quantised(Model(**{**vars(model), "opacity": np.zeros_like(opacity)}))


def test_gaussians_of_no_size_and_at_one_place():
    model = some_model(count=10, lights=1)
    flat = {"scale": np.zeros((10, 3), np.float32), "position": np.ones((10, 3), np.float32)}
    kept = restored(quantised(Model(**{**vars(model), **flat})))
    assert np.isfinite(kept.scale).all() and kept.scale.max() < 1e-8
    np.testing.assert_allclose(kept.position, 1.0, atol=1e-6)


@pytest.mark.parametrize("far", [[1e4], [9e5], [1e3, 1e4, 1e5]])
@pytest.mark.parametrize("count", [5000, 4096 + 3])
def test_runaways_displace_nobody(far, count):
    """Everything else is where it is without them, and they are off by no more than their distance asks."""
    model = some_model(count)
    position = model.position.copy()
    position[: len(far)] = np.array(far)[:, None] * [1.0, -0.5, 0.25]
    lost = replace(model, position=position.astype(np.float32))
    kept = restored(quantised(lost))
    kept = kept.position[kept.opacity > 0.0]
    assert len(kept) == count
    gaps, _ = cKDTree(kept).query(lost.position)
    assert gaps[len(far) :].max() < 14.0 / 65535.0  # the scene has 14 m a side
    assert (gaps[: len(far)] < 2e-5 * max(far)).all()


def test_too_many_lights_are_refused():
    with pytest.raises(BadValueError, match="65"):
        quantised(some_model(count=4, lights=65))


def test_a_model_is_as_small_as_was_asked():
    # 8 MB for 60,000 and 50 MB for a million before base64, for degree 3 and one light.
    model = some_model(count=20_000, lights=1)
    size = len(zlib.compress(quantised(model).raw(), 9)) / model.count
    assert size * 60_000 < 8e6 and size * 1_000_000 < 50e6
