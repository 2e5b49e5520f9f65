from typing import Any

import numpy as np
import pytest

from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band


def band(**values: Any) -> Band:
    return Band.model_validate({"name": "b", "kind": "solar", **values})


HAT = band(lo_um=0.4, hi_um=0.9)
TRIANGLE = band(wavelength_um=[0.3, 0.4, 0.5, 0.7, 0.8], response=[0.0, 0.0, 0.4, 0.0, 0.0])


def test_hat() -> None:
    np.testing.assert_array_equal(bands.response(HAT, [0.39, 0.4, 0.6, 0.9, 0.91]), [0, 1, 1, 1, 0])
    assert bands.limits_um(HAT) == (0.4, 0.9)
    assert bands.width_um(HAT) == pytest.approx(0.5, rel=1e-13)
    assert bands.reference_wavelength_um(HAT) == pytest.approx(0.65, rel=1e-13)


def test_table_has_peak_one_and_is_trimmed() -> None:
    np.testing.assert_allclose(bands.response(TRIANGLE, [0.35, 0.45, 0.5, 0.6, 0.75]), [0, 0.5, 1, 0.5, 0])
    assert bands.limits_um(TRIANGLE) == (0.4, 0.7)
    assert bands.width_um(TRIANGLE) == pytest.approx(0.15, rel=1e-13)
    # Centroid of a triangle: mean of its corners.
    assert bands.reference_wavelength_um(TRIANGLE) == pytest.approx((0.4 + 0.5 + 0.7) / 3, rel=1e-13)


def test_response_that_stops_at_full_height() -> None:
    step = band(wavelength_um=[0.5, 0.6], response=[0.5, 0.25])
    np.testing.assert_allclose(bands.response(step, [0.499, 0.5, 0.6, 0.601]), [0, 1, 0.5, 0])
    assert bands.limits_um(step) == (0.5, 0.6)


def test_sampled_honours_breaks() -> None:
    wavelength, weight = bands.sampled(HAT, [0.123, 0.5137])
    assert np.sum(weight * (wavelength > 0.5137)) == pytest.approx(0.9 - 0.5137, rel=1e-13)
