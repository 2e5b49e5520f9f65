import numpy as np
import pytest

from horizonval.earth.spectral.quadrature import Orthonormal, composite_gauss


def test_composite_rule_is_exact_on_every_interval() -> None:
    x, w = composite_gauss(np.array([0.0, 0.1, 1.0, 3.0]), 3)
    assert x.shape == w.shape == (3, 3)
    assert np.sum(w * x**5) == pytest.approx(3.0**6 / 6, rel=1e-14)


def test_flat_measure_gives_gauss_legendre() -> None:
    x, w = composite_gauss(np.linspace(-1, 1, 40), 8)
    nodes, weights = Orthonormal.of(x.ravel(), w.ravel(), 7).rule(7)
    expected_nodes, expected_weights = np.polynomial.legendre.leggauss(7)
    np.testing.assert_allclose(nodes, expected_nodes, atol=1e-13)
    np.testing.assert_allclose(weights, expected_weights, atol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 5, 64])
def test_jagged_measure_is_integrated_exactly(n: int) -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.4, 0.9, 1500)
    w = rng.uniform(0, 1, x.size) * (x > 0.45)
    nodes, weights = Orthonormal.of(x, w, 64).rule(n)
    assert nodes.min() > 0.45
    assert (weights > 0).all()
    for degree in {0, 1, n, 2 * n - 1}:
        assert weights @ nodes**degree == pytest.approx(w @ x**degree, rel=1e-12)


def test_smoothed_keeps_the_integrals_of_a_jagged_function() -> None:
    rng = np.random.default_rng(4)
    x = np.linspace(0.4, 0.9, 1500)
    w, values = rng.uniform(0, 1, x.size), 5 + rng.uniform(-1, 1, x.size)
    polynomials = Orthonormal.of(x, w, 9)
    nodes, weights = polynomials.rule(4)
    stand_in = polynomials.smoothed(polynomials.moments(values), nodes)
    for degree in range(4):
        assert weights @ (stand_in * nodes**degree) == pytest.approx(np.sum(w * values * x**degree), rel=1e-11)


def test_smoothed_is_never_negative() -> None:
    x = np.linspace(0.0, 1.0, 500)
    polynomials = Orthonormal.of(x, np.ones_like(x), 3)
    nodes, _ = polynomials.rule(3)
    values = np.where(x > 0.8, 1.0, 0.0)
    line = np.polynomial.Polynomial.fit(x, values, 2)
    assert line(nodes).min() < 0
    assert polynomials.smoothed(polynomials.moments(values), nodes).min() == 0


def test_smoothed_is_the_least_squares_polynomial() -> None:
    rng = np.random.default_rng(5)
    x = np.linspace(0.4, 0.9, 1500)
    w, values = rng.uniform(0, 1, x.size), 5 + rng.uniform(-1, 1, x.size)
    polynomials = Orthonormal.of(x, w, 12)
    nodes, _ = polynomials.rule(6)
    fit = np.polynomial.Polynomial.fit(x, values, 5, w=np.sqrt(w))
    np.testing.assert_allclose(polynomials.smoothed(polynomials.moments(values), nodes), fit(nodes), rtol=1e-11)
