"""Emissivity against closed forms of the metal optics, energy and published values."""

import math

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.earth.surface.emissivity import emissivity, water_emissivity, water_index

THERMAL_UM = np.linspace(7.2, 20.0, 400)


def absorbing_reflectance(n: float, k: float, theta: float) -> float:
    """Real-valued Fresnel reflectance of an absorbing medium (Siegel and Howell, Thermal Radiation Heat Transfer)."""
    s = math.sin(theta)
    root = math.sqrt((n * n - k * k - s * s) ** 2 + 4 * n * n * k * k)
    a, b2 = math.sqrt((root + n * n - k * k - s * s) / 2), (root - (n * n - k * k - s * s)) / 2
    c = math.cos(theta)
    across = ((a - c) ** 2 + b2) / ((a + c) ** 2 + b2)
    t = s * math.tan(theta)
    along = across * ((a - t) ** 2 + b2) / ((a + t) ** 2 + b2)
    return (across + along) / 2


@pytest.mark.parametrize("wavelength", [8.0, 10.75, 12.0, 15.2, 19.9])
@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 53.0, 75.0, 89.0])
def test_water_obeys_fresnel(wavelength: float, zenith_deg: float) -> None:
    index = complex(water_index(wavelength))
    expected = 1 - absorbing_reflectance(index.real, index.imag, math.radians(zenith_deg))
    found = float(water_emissivity(wavelength, math.cos(math.radians(zenith_deg))))
    assert found == pytest.approx(expected, abs=1e-12)


def test_water_straight_down() -> None:
    # Emissivity of a calm sea in the splitting channels, 0.992 at 11 um and 0.988 at 12 um (K. Masuda et al., Remote
    # Sens. Environ. 24, 313 (1988)); sea water there, pure water here: 0.002.
    assert float(water_emissivity(11.0, 1.0)) == pytest.approx(0.992, abs=0.002)
    assert float(water_emissivity(12.0, 1.0)) == pytest.approx(0.988, abs=0.002)


def test_water_fades_towards_grazing() -> None:
    cosine = np.linspace(0.0, 1.0, 101)
    for wavelength in (8.5, 11.0, 15.0):
        found = water_emissivity(wavelength, cosine)
        assert found[0] == pytest.approx(0.0, abs=1e-12)
        assert (np.diff(found[:40]) > 0).all()
        assert found.max() < 1.0
    assert water_emissivity(THERMAL_UM[:, None], cosine).shape == (400, 101)


def test_kinds_lie_in_their_measured_ranges() -> None:
    window = (THERMAL_UM >= 10.5) & (THERMAL_UM <= 12.5)
    land, snow = emissivity("land", THERMAL_UM), emissivity("snow", THERMAL_UM)
    # Land surfaces over 10.5 to 12.5 um: 0.96 to 0.985, and lower by several hundredths in the quartz band.
    assert 0.96 < land[window].min() <= land[window].max() < 0.985
    assert 0.92 < float(emissivity("land", 8.6)) < float(emissivity("land", 11.0)) - 0.02
    assert 0.984 < snow.min() <= snow.max() < 0.996
    np.testing.assert_array_equal(emissivity("foam", THERMAL_UM), water_emissivity(THERMAL_UM, 1.0))


def test_unknown_kind() -> None:
    with pytest.raises(UserError, match="unknown kind of ground 'ice'; expected one of land, desert, snow, water"):
        emissivity("ice", 11.0)
