# SPDX-License-Identifier: GPL-3.0-or-later
"""The SH basis against its definition, the fit of linear SH against integrals that have a closed form."""

import math

import numpy as np
import pytest

from physhdr.bridge import spherical_harmonics as sh


def random_directions(count: int, seed: int = 0) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_basis_is_orthonormal_on_the_sphere():
    directions, weights = sh.quadrature(8)
    Y = sh.basis(directions, 3)
    np.testing.assert_allclose(Y.T @ (Y * weights[:, None]), np.eye(16), atol=1e-12)


def test_values_and_signs_are_those_of_3dgs():
    """Constants copied from 3DGS' ``sh_utils.py``; formulae of ``eval_sh`` at one direction."""
    x, y, z = 0.36, -0.48, 0.8
    expected = [
        0.28209479177387814,
        *(-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x),
        *(1.0925484305920792 * x * y, -1.0925484305920792 * y * z),
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        *(-1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)),
        *(-0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z),
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        *(1.445305721320277 * z * (x * x - y * y), -0.5900435899266435 * x * (x * x - 3 * y * y)),
    ]
    np.testing.assert_allclose(sh.basis(np.array([[x, y, z]]), 3)[0], expected, rtol=1e-14)


def test_each_degree_is_the_beginning_of_the_next():
    directions = random_directions(20)
    for degree in range(3):
        count = sh.coefficient_count(degree)
        np.testing.assert_array_equal(sh.basis(directions, degree), sh.basis(directions, 3)[:, :count])


@pytest.mark.parametrize("count", [0, 2, 8, 25])
def test_a_count_that_no_degree_has_is_refused(count: int):
    with pytest.raises(ValueError, match="SH coefficients"):
        sh.degree_of(count)


def fit_linear(log_radiance: np.ndarray) -> np.ndarray:
    """SH of the linear radiance: its orthogonal projection onto the same basis."""
    directions, weights = sh.quadrature(8)
    Y = sh.basis(directions, sh.degree_of(log_radiance.shape[1]))
    return sh.refit(log_radiance, sh.exponential, Y, (Y * weights[:, None]).T)


def test_fit_linear_of_degree_0_is_exact():
    log_radiance = np.array([[[math.log(7.0) / sh.C0, 0.0, -1.0]]], np.float32)
    fitted = fit_linear(log_radiance)
    np.testing.assert_allclose(fitted[0, 0] * sh.C0, [7.0, 1.0, math.exp(-sh.C0)], rtol=1e-6)


def test_fit_linear_of_degree_1_matches_the_closed_form():
    """∫ exp(a·ω) dΩ = 4π sinh(a)/a and ∫ exp(a·ω) ω dΩ = 4π (a cosh a − sinh a)/a² · â."""
    rng = np.random.default_rng(1)
    log_radiance = rng.normal(0.0, 0.6, (5000, 4, 3)).astype(np.float32)
    fitted = fit_linear(log_radiance)

    wide = log_radiance.astype(np.float64)
    a = sh.C1 * np.stack([-wide[:, 3], -wide[:, 1], wide[:, 2]], axis=-1)  # [N, colour, xyz]
    length = np.linalg.norm(a, axis=-1)
    constant = 4 * math.pi * np.exp(sh.C0 * wide[:, 0])
    mean = constant * np.sinh(length) / length
    slope = constant * (length * np.cosh(length) - np.sinh(length)) / length**2
    along = slope[..., None] * a / length[..., None]
    expected = np.stack(
        [sh.C0 * mean, -sh.C1 * along[..., 1], sh.C1 * along[..., 2], -sh.C1 * along[..., 0]], axis=1
    )
    assert np.abs(fitted - expected).max() < 2e-5 * np.abs(expected).max()


@pytest.mark.parametrize("degree", [2, 3])
def test_fit_linear_matches_a_finer_quadrature(degree: int):
    log_radiance = np.random.default_rng(2).normal(0.0, 0.25, (300, (degree + 1) ** 2, 3))
    directions, weights = sh.quadrature(30)
    Y = sh.basis(directions, degree)
    expected = np.einsum("qk,nqc->nkc", Y * weights[:, None], np.exp(Y @ log_radiance))
    assert np.abs(fit_linear(log_radiance) - expected).max() < 1e-4 * np.abs(expected).max()


def test_fit_linear_survives_absurd_values():
    assert np.isfinite(fit_linear(np.full((2, 4, 3), 1e4, np.float32))).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_turned_coefficients_are_the_function_turned(degree: int):
    """By direct evaluation in float64: f'(ω) is f where ω was before the turn."""
    rng = np.random.default_rng(degree)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    coefficients = rng.normal(size=(5, sh.coefficient_count(degree), 3))
    turned = sh.rotated(coefficients, turn)
    directions = random_directions(50)
    before = np.einsum("dk,nkc->dnc", sh.basis(directions @ turn, degree), coefficients)  # at turn⁻¹ ω
    after = np.einsum("dk,nkc->dnc", sh.basis(directions, degree), turned)
    np.testing.assert_allclose(after, before, atol=1e-13)
    np.testing.assert_allclose(sh.rotated(turned, turn.T), coefficients, atol=1e-13)
    assert sh.rotated(coefficients.astype(np.float32), turn).dtype == np.float32
