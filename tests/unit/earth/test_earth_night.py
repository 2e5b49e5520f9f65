"""Moonlight, airglow and the Sun's limb darkening against published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from earth_forms import model_of

from horizonval.earth.light import sky
from horizonval.earth.spectral import bands, sunlight
from horizonval.spec.camera import Band

MEAN_MOON_AU = 384_400e3 / sunlight.ASTRONOMICAL_UNIT_M


@pytest.mark.parametrize(("phase_deg", "expected"), [(0.0, -12.74), (90.0, -10.1), (120.0, -8.8), (150.0, -6.8)])
def test_magnitude_of_the_moon(phase_deg: float, expected: float) -> None:
    """Full, quarter and crescent after Allen (section 66, table of V(phase)): 0.1 mag."""
    assert sky.moon_magnitude(math.radians(phase_deg), 1.0, MEAN_MOON_AU) == pytest.approx(expected, abs=0.1)
    assert sky.moon_magnitude(math.radians(-phase_deg), 1.0, MEAN_MOON_AU) == pytest.approx(expected, abs=0.1)


def test_full_moon_lights_the_ground_with_a_quarter_of_a_lux() -> None:
    """0.31 lx above the air, at the mean distance; 1 to 3 mW m-2 below 1.1 um.

    Krisciunas and Schaefer 1991, eq. 8: 10^(-0.4 (V + 16.57)) foot candles. Extinction of 0.25 mag leaves 0.25 lx.
    """
    wavelength = np.linspace(0.30, 1.10, 801)
    ratio = sky.irradiance_ratio(wavelength, 0.0, 1.0, MEAN_MOON_AU, 1.0)
    spectrum = sunlight.irradiance(wavelength) * ratio
    eye = 1.019 * np.exp(-285.4 * (wavelength - 0.559) ** 2)
    lux = 683.0 * np.trapezoid(eye * spectrum, wavelength)
    published = 10.764 * 10.0 ** (-0.4 * (-12.74 + 16.57))
    assert published == pytest.approx(0.316, abs=0.002)
    assert lux == pytest.approx(published, rel=0.06)
    assert 0.24 < lux * 10.0 ** (-0.4 * 0.25) < 0.28
    assert 1e-3 < np.trapezoid(spectrum, wavelength) < 3e-3


def test_colour_of_the_moon() -> None:
    """B - V of the Moon is 0.92, of the Sun 0.65 (Allen; Ramirez et al. 2012)."""
    redder = -2.5 * math.log10(float(sky.moon_colour(0.4361) / sky.moon_colour(0.5448)))
    assert redder == pytest.approx(0.92 - 0.65, abs=0.02)
    assert float(sky.moon_colour(0.55)) == 1.0


def test_a_rayleigh() -> None:
    """1 R at 557.7 nm is 2.83e-10 W m-2 sr-1 (1.8e-11 at 7774: Baker and Romick, Appl. Opt. 15, 1966 (1976))."""
    assert float(sky.airglow_radiance(1.0, 0.5577)) == pytest.approx(2.834e-10, rel=1e-3)


def _band(**keys: object) -> Band:
    return Band.model_validate({"name": "n", "kind": "solar", **keys})


def _night(band: Band):
    model = model_of(band)
    return model, sky.with_night(model, [band], 1.0, airglow=True, sky=True)


def test_the_energy_of_a_line_is_in_its_band_and_in_no_other() -> None:
    """A line between spectral nodes adds column x response x lambda / lambda_ref, however the nodes lie: 1e-12."""
    band = _band(wavelength_um=[0.50, 0.54, 0.57, 0.62], response=[0.0, 1.0, 0.8, 0.0], nodes=3)
    line = sky.LAYERS[0]
    _, energy = sky.band_energy(band, line)
    response = 1.0 + (0.8 - 1.0) * (0.5577 - 0.54) / 0.03
    expected = float(sky.airglow_radiance(250.0, 0.5577)) * response * 0.5577 / bands.reference_wavelength_um(band)
    assert energy.sum() == pytest.approx(expected, rel=1e-12)
    assert sky.band_energy(_band(lo_um=0.7, hi_um=0.8), line)[1].sum() == 0.0


def test_nodes_hold_the_columns_of_all_layers() -> None:
    band = _band(lo_um=0.5, hi_um=0.8, nodes=4)
    day, night = _night(band)
    z = night.glow_altitude_m
    column = sum(n.weight * np.trapezoid(n.glow_per_m, z) for n in night.nodes)
    assert column == pytest.approx(sum(sky.band_energy(band, x)[1].sum() for x in sky.LAYERS), rel=1e-12)
    assert (night.glow_top_m, night.top_m, day.glow_top_m) == (120e3, 100e3, 100e3)
    assert not any(len(n.glow_per_m) for n in day.nodes)


@pytest.mark.parametrize(
    ("name", "centre_um", "width_um", "zero", "dark"),
    [("V", 0.545, 0.085, 3.63e-8, 21.6), ("R", 0.64, 0.13, 2.18e-8, 20.9), ("I", 0.80, 0.15, 1.13e-8, 19.7)],
)
def test_the_night_sky_is_as_dark_as_on_paranal(
    name: str, centre_um: float, width_um: float, zero: float, dark: float
) -> None:
    """Patat, A&A 400, 1183 (2003), table 4; zero points of Bessell (1979) [W m-2 um-1]. Airglow varies as much: 0.6."""
    band = _band(lo_um=centre_um - width_um / 2, hi_um=centre_um + width_um / 2)
    layers = [x for x in sky.LAYERS if x.wavelength_um != (0.762,)]  # its light does not reach the ground
    glow = sum(sky.band_energy(band, x)[1].sum() for x in layers) / width_um
    sun = float(np.mean(sunlight.irradiance(np.linspace(centre_um - 0.04, centre_um + 0.04, 9))))
    behind = sun * 10.0 ** (0.4 * (sky.V_SUN - sky.SKY_V)) / sky.ARCSEC2_SR
    magnitude = -2.5 * math.log10((glow + behind) * sky.ARCSEC2_SR / zero)
    assert magnitude == pytest.approx(dark, abs=0.6), name


@pytest.mark.parametrize(("zenith_deg", "night"), [(40.0, False), (76.0, False), (78.0, True), (150.0, True)])
def test_night_begins_nine_degrees_below_the_farthest_horizon(zenith_deg: float, night: bool) -> None:
    assert sky.night_in_view(math.radians(zenith_deg), math.radians(22.0)) is night


def test_solar_nodes_know_moon_and_limb_darkening() -> None:
    both = [_band(lo_um=0.5, hi_um=0.6), Band(name="t", kind="thermal", lo_um=10.0, hi_um=11.0)]
    moon = sky.Moonlight(0.0, 1.0, MEAN_MOON_AU, 1.0)
    model = sky.with_sky(model_of(*both), both, sun_distance_au=1.0, moon=moon, airglow=True, background=True)
    assert model.nodes
    assert {node.band for node in model.nodes} == {"n"}
    for node in model.nodes:
        assert len(node.limb_darkening) == 6
        assert node.moon_irradiance > 0.0
        assert node.glow_per_m.any()
        assert node.sky_radiance > 0.0
    assert [band.name for band in model.thermal] == ["t"]


WAVELENGTHS = [0.3, 0.35, 0.372, 0.38, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0, 1.1, 2.0]


def law(coefficients: tuple[float, ...], mu: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(mu, coefficients)


@pytest.mark.parametrize("wavelength_um", WAVELENGTHS)
def test_the_middle_of_the_disc_is_one_and_the_edge_is_darker(wavelength_um: float) -> None:
    a = sky.limb_darkening_of(wavelength_um)
    values = law(a, np.linspace(0.05, 1.0, 50))
    assert values[-1] == pytest.approx(1.0, abs=2e-5)
    assert np.all(np.diff(values) > 0.0)


@pytest.mark.parametrize(
    ("wavelength_um", "u", "v"), [(0.45, 0.99, -0.17), (0.50, 0.97, -0.22), (0.60, 0.88, -0.23), (0.80, 0.73, -0.22),
                                  (1.00, 0.64, -0.20)]
)  # fmt: skip
def test_the_disc_is_as_dark_as_allens(wavelength_um: float, u: float, v: float) -> None:
    """C. W. Allen, *Astrophysical Quantities*, section 81: ``1 - u - v + u mu + v mu^2``; 2 % of the centre."""
    a = sky.limb_darkening_of(wavelength_um)
    mu = np.linspace(0.2, 1.0, 30)
    assert np.abs(law(a, mu) - (1 - u - v + u * mu + v * mu**2)).max() < 0.02
    mean = sum(2.0 * c / (k + 2.0) for k, c in enumerate(a))
    assert mean == pytest.approx(1.0 - u / 3.0 - v / 2.0, rel=0.01)


@pytest.mark.parametrize("wavelength_um", [0.45, 0.55, 0.7, 0.9])
def test_the_power_law_of_hestroffer_and_magnan(wavelength_um: float) -> None:
    """A&A 333, 338 (1998): ``I = mu^alpha``, ``alpha = -0.023 + 0.292 / lambda``; 1.5 % of the centre.

    From mu = 0.5 inwards, three quarters of the disc: one exponent is too dark towards the edge, by 4 % at mu = 0.2.
    """
    mu = np.linspace(0.5, 1.0, 30)
    power = mu ** (-0.023 + 0.292 / wavelength_um)
    assert np.abs(law(sky.limb_darkening_of(wavelength_um), mu) - power).max() < 0.015
