"""Land map, spectra, snow and the sea's reflectance, against closed forms, integrals and known places."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from earth_forms import is_land, snow_factor

from horizonval.earth.surface import surface
from horizonval.earth.surface.ground_map import NAMES, snow_line_deg, snow_share, spectrum
from horizonval.earth.surface.surface import SNOW_NODES, mean_snow_reflection

LATITUDE = np.arange(-89.875, 90.0, 0.25)
LONGITUDE = np.arange(-179.875, 180.0, 0.25)
CELL_KM2 = np.radians(0.25) ** 2 * 6371.0**2 * np.cos(np.radians(LATITUDE))


@cache
def _land() -> np.ndarray:
    return is_land(LATITUDE[:, None], LONGITUDE)


def test_share_of_land():
    """The textbook's 29.2 %, without lakes (0.9 %)."""
    share = float((_land().mean(axis=1) * CELL_KM2).sum() / CELL_KM2.sum())
    assert share == pytest.approx(0.29, abs=0.01)


@pytest.mark.parametrize(
    ("month", "extent"),
    list(enumerate([47.0, 46.0, 40.5, 30.5, 19.3, 9.7, 3.9, 2.9, 5.3, 18.4, 34.0, 43.6], start=1)),
)
def test_northern_snow_has_the_area_of_the_climatology(month, extent):
    """1 %, or 0.1 million km2: the line is given to a tenth of a degree."""
    line = snow_line_deg(month)
    land = _land().sum(axis=1) * CELL_KM2 * 1e-6
    snow = float((land * snow_share(LATITUDE, line))[LATITUDE > 0].sum())
    assert snow == pytest.approx(extent, rel=0.01, abs=0.1)


def test_snow_line_moves_without_jumps():
    days = [snow_line_deg(0.5 + (d / 30.0) % 12.0) for d in range(800)]
    assert np.abs(np.diff(days)).max() < 0.4
    assert snow_share(-80.0, 60.0) == 0.0
    assert snow_share([0.0, 58.0, 60.0, 62.0], 60.0) == pytest.approx([0.0, 0.0, 0.5, 1.0])


@pytest.mark.parametrize("name", NAMES)
def test_spectra_are_albedos(name):
    values = spectrum(name, np.linspace(0.2, 4.0, 400))
    assert values.min() >= 0.0
    assert values.max() < 0.99


def test_fresnel_limits():
    """Head on, grazing, and Brewster's angle, where only the polarisation across is reflected."""
    n = surface.WATER_INDEX
    assert surface.fresnel(1.0) == pytest.approx(((n - 1) / (n + 1)) ** 2, rel=1e-12)
    assert surface.fresnel(0.0) == pytest.approx(1.0)
    brewster = 1.0 / np.sqrt(1.0 + n * n)
    assert surface.fresnel(brewster) == pytest.approx(0.5 * ((n * n - 1) / (n * n + 1)) ** 2, rel=1e-12)
    assert surface.water_sky_albedo() == pytest.approx(0.067, abs=0.002)


def _direction(zenith_deg, azimuth_deg):
    z, a = np.radians(zenith_deg), np.radians(azimuth_deg)
    return np.stack(np.broadcast_arrays(np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)), axis=-1)


@pytest.mark.parametrize("zenith", [0.0, 20.0, 45.0])
def test_glint_is_brightest_at_the_mirror_and_has_its_height(zenith):
    """On a nearly calm sea: where incidence equals reflection, F / (4 pi s2 mu^2) there (nothing hidden)."""
    variance, sun = 1e-4, _direction(zenith, 0.0)
    zeniths, azimuths = np.linspace(0.0, 80.0, 1601)[:, None], np.linspace(170.0, 190.0, 81)
    view = _direction(zeniths, azimuths)
    f = surface.glint_brdf(sun[2], view[..., 2], view @ sun, variance)
    i, j = np.unravel_index(np.argmax(f), f.shape)
    assert zeniths[i, 0] == pytest.approx(zenith, abs=0.1)
    if zenith:
        assert azimuths[j] == pytest.approx(180.0, abs=0.3)
    mu = np.cos(np.radians(zenith))
    assert f.max() == pytest.approx(surface.fresnel(mu) / (4 * np.pi * variance * mu**2), rel=1e-3)


def test_glint_is_reciprocal_and_finite():
    rng = np.random.default_rng(np.random.SeedSequence(4))
    a, b = (_direction(np.degrees(np.arccos(rng.uniform(0, 1, 500))), rng.uniform(0, 360, 500)) for _ in range(2))
    cosine = np.sum(a * b, axis=1)
    there = surface.glint_brdf(a[:, 2], b[:, 2], cosine, 0.04)
    assert there == pytest.approx(surface.glint_brdf(b[:, 2], a[:, 2], cosine, 0.04), rel=1e-12)
    assert surface.glint_brdf(-0.1, 0.5, 0.2, 0.04) == 0.0
    grazing = surface.glint_brdf(*np.array([[1e-12, 0.0, 1.0], [1e-12, 0.3, 1e-9], [1.0, -1.0, 0.0]]), 0.04)
    assert np.all(np.isfinite(grazing))


@pytest.mark.parametrize("wind", [1.0, 7.0, 20.0])
@pytest.mark.parametrize("zenith", [0.0, 30.0, 60.0, 75.0, 85.0, 89.0])
def test_the_sea_reflects_no_more_than_it_gets(wind, zenith):
    """Glint, foam and water together, integrated over the hemisphere; overhead the glint is Fresnel's 2.1 %."""
    variance, sun = surface.slope_variance(wind), _direction(zenith, 0.0)
    x, w = np.polynomial.legendre.leggauss(300)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    azimuth = np.arange(0.5, 180.0)  # the other half is its mirror image
    view = _direction(np.degrees(np.arccos(mu))[:, None], azimuth)
    f = surface.glint_brdf(sun[2], mu[:, None], view @ sun, variance)
    glint = float(2.0 * np.pi * np.sum(w * mu * f.mean(axis=1)))
    foam, mean = surface.foam_share(wind), surface.water_sky_albedo()
    below = surface.spectrum("water", 0.4) * (1.0 - surface.fresnel(sun[2])) / (1.0 - mean)
    assert 0.0 < foam * surface.FOAM_ALBEDO + (1.0 - foam) * (glint + below) < 1.0
    if zenith == 0.0:
        assert glint == pytest.approx(float(surface.fresnel(1.0)), rel=0.03)
    assert glint < 2.0 * surface.fresnel(sun[2])


def _cosine(mu_sun: float, mu_view: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Between the directions to Sun and observer; azimuth 0 is on the Sun's side."""
    return mu_sun * mu_view + np.sqrt((1.0 - mu_sun**2) * (1.0 - mu_view**2)) * np.cos(azimuth)


@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 55.0, 70.0, 80.0, 88.0])
def test_snow_keeps_its_albedo(zenith_deg: float) -> None:
    """The hemispherical integral of ``factor cos / pi`` is 1 to 1 %: by a midpoint rule of our own."""
    theta = np.radians((np.arange(900) + 0.5) * 0.1)
    azimuth = np.radians(np.arange(0.5, 360.0, 1.0))
    mu = np.cos(theta)[:, None]
    factor = snow_factor(np.cos(np.radians(zenith_deg)), mu, _cosine(np.cos(np.radians(zenith_deg)), mu, azimuth))
    weight = mu * np.sin(theta)[:, None] * np.radians(0.1) * np.radians(1.0) / np.pi
    assert float((factor * weight).sum()) == pytest.approx(1.0, abs=0.01)


def test_snow_shines_forward_the_more_the_lower_the_sun() -> None:
    """Away from the Sun brighter than towards it, and nadir darker than a Lambert surface."""
    view = np.array(np.cos(np.radians(70.0)))
    forward = []
    for zenith_deg in (50.0, 60.0, 70.0, 80.0):
        sun = float(np.cos(np.radians(zenith_deg)))
        away, towards = (float(snow_factor(sun, view, _cosine(sun, view, np.array(a)))) for a in (np.pi, 0.0))
        assert away > towards
        forward.append(away)
    assert np.all(np.diff(forward) > 0.0)
    assert forward[-1] > 1.5
    low = np.cos(np.radians(67.0))
    assert 0.85 < float(snow_factor(low, 1.0, low)) < 0.97


def test_the_factor_is_nearly_reciprocal() -> None:
    """As far as N is the same at all heights of the Sun: 2 % above 9 deg."""
    mean = mean_snow_reflection()[np.linspace(0.0, 1.0, SNOW_NODES) > np.sin(np.radians(9.0))]
    assert 0.98 < mean.min() <= mean.max() < 1.02
