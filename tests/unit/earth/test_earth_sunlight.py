import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.earth.spectral import sunlight


def test_total_irradiance() -> None:
    # 1361 W m-2 in all, of which a 5772 K black body leaves 0.2 % below 250 nm and beyond 20 um; table bins: 1359.02.
    assert sunlight.band_irradiance(0.25, 20.0) == pytest.approx(1359.0, abs=0.2)


def test_share_of_the_visible() -> None:
    # ASTM E490 holds 759.6 W m-2 in 400 to 900 nm, NRL2 0.4 to 0.6 % less.
    assert sunlight.band_irradiance(0.4, 0.9) == pytest.approx(759.6 * 0.995, rel=0.002)


def test_bands_add_up() -> None:
    parts = sunlight.band_irradiance(0.4, 0.55123) + sunlight.band_irradiance(0.55123, 0.9)
    assert parts == pytest.approx(sunlight.band_irradiance(0.4, 0.9), rel=1e-13)


def test_inverse_square_and_disc() -> None:
    assert sunlight.irradiance(0.55, 2.0) == pytest.approx(sunlight.irradiance(0.55) / 4)
    # The disc's mean radiance does not change with distance; 2.0e7 W m-2 sr-1 in all (5772 K: sigma T^4 / pi).
    near = sunlight.band_irradiance(0.25, 20.0, 0.98) / sunlight.disc_projected_solid_angle(0.98)
    far = sunlight.band_irradiance(0.25, 20.0, 1.02) / sunlight.disc_projected_solid_angle(1.02)
    assert near == pytest.approx(far)
    assert near == pytest.approx(5.670374e-8 * 5772**4 / np.pi, rel=0.003)
    # 32.0 arc minutes across.
    assert sunlight.disc_projected_solid_angle() == pytest.approx(np.pi * np.radians(32.0 / 60 / 2) ** 2, rel=0.003)


@pytest.mark.parametrize("wavelength_um", [0.2499, 20.01, np.nan])
def test_outside_the_table(wavelength_um: float) -> None:
    with pytest.raises(UserError, match=r"within 0\.25 to 20 um"):
        sunlight.irradiance(wavelength_um)
