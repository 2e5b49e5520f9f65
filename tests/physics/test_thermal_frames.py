"""Thermal frames, pixel by pixel, against the direct march of the same rays, brute force and Planck's law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from emission_reference import RADIUS_M, Band, limits_um, planck_per_cm
from frame_rays import BANDS, camera_of, directions, march_frame, scene_of
from latitude_limb import Climate
from scipy.integrate import quad
from thermal_model import limb_rays, model_of

from horizonval.renderer.frame import render_frame
from horizonval.renderer.rays import thermal_radiance

BY_LATITUDE = {"profile": "by_latitude_month", "month": 2}
# name: scene, camera. Each looks across the limb, from the ground up to space.
VIEWS: dict[str, tuple[dict[str, Any], tuple[int, int, float]]] = {
    "500 km": ({"attitude": {"roll_deg": 68.0}}, (3, 160, 0.09)),
    "900 km, by latitude": (
        {
            "atmosphere": BY_LATITUDE,
            "platform": {"altitude_km": 900.0, "latitude_deg": 52.0, "longitude_deg": 20.0},
            "attitude": {"roll_deg": 61.0, "yaw_deg": 30.0},
            "surface": {"temperature_k": 285.0},
        },
        (4, 60, 0.25),
    ),
    "36 000 km": (
        {
            "atmosphere": BY_LATITUDE,
            "platform": {"altitude_km": 35_786.0, "longitude_deg": 140.0},
            "attitude": {"roll_deg": 8.7},
        },
        (6, 80, 0.01),
    ),
    "120 km": ({"platform": {"altitude_km": 120.0}, "attitude": {"roll_deg": 80.0}}, (3, 120, 0.3)),
    "101 km": ({"platform": {"altitude_km": 101.0}, "attitude": {"roll_deg": 80.0}}, (3, 120, 0.3)),
    "80 km, in the air": ({"platform": {"altitude_km": 80.0}, "attitude": {"roll_deg": 81.0}}, (3, 120, 0.3)),
    "20 km, in the air": ({"platform": {"altitude_km": 20.0}, "attitude": {"roll_deg": 85.0}}, (3, 120, 0.3)),
    "1 km, upwards": ({"platform": {"altitude_km": 1.0}, "attitude": {"roll_deg": 120.0}}, (3, 90, 0.4)),
    "over the pole": (
        {"atmosphere": BY_LATITUDE, "platform": {"altitude_km": 500.0, "latitude_deg": 90.0}}
        | {"attitude": {"roll_deg": 68.0}},
        (6, 80, 0.3),
    ),
    "over the date line": (
        {
            "atmosphere": BY_LATITUDE,
            "platform": {"altitude_km": 500.0, "latitude_deg": -30.0, "longitude_deg": -180.0},
            "attitude": {"roll_deg": 68.0, "yaw_deg": 90.0},
        },
        (6, 80, 0.3),
    ),
    "sphere": ({"earth": {"shape": "sphere"}, "attitude": {"roll_deg": 68.0}}, (3, 100, 0.12)),
    "volcanic": (
        {"atmosphere": {"aerosol": "volcanic_high"}, "attitude": {"roll_deg": 68.0}},
        (3, 100, 0.12),
    ),
    "refraction": ({"atmosphere": {"refraction": True}, "attitude": {"roll_deg": 68.0}}, (3, 100, 0.12)),
}
BANDS_UM = {name: (shape["lo_um"], shape["hi_um"]) for name, shape in BANDS.items()}
QUICK = ("500 km", "101 km", "20 km, in the air", "over the pole")


@pytest.mark.parametrize("view", [v if v in QUICK else pytest.param(v, marks=pytest.mark.slow) for v in VIEWS])
def test_pixels_equal_the_march_of_their_rays(view: str) -> None:
    """2e-3 of the bright limb at worst, with a median of 1e-4, for the default ``render.accuracy`` of 1e-3."""
    tables, (width, height, fov_deg) = VIEWS[view]
    marched = march_frame(scene_of(**tables), camera_of(width, height, fov_deg))
    for band in BANDS:
        theirs = marched.radiance[band]
        brightest = theirs[marched.clear & (marched.height_m > 0.0)].max()
        error = np.abs(marched.frame.radiance[band] - theirs)[marched.clear] / brightest
        assert len(error) > 50
        assert error.max() < 2e-3, f"{view}: {marched.worst(band, 1e-3)}"
        assert np.median(error) < 1e-4


@pytest.mark.slow
def test_pixels_equal_brute_force() -> None:
    """0.1 %: 10 m steps through the exact climate of every latitude, straight, of the gases of the climates alone."""
    tables, (width, height, fov_deg) = VIEWS["900 km, by latitude"]
    gases_alone = {**BY_LATITUDE, "aerosol": "none", "halocarbons": False, "refraction": False}
    tables = {**tables, "atmosphere": gases_alone}
    scene, camera = scene_of(**tables), camera_of(width, height, fov_deg)
    frame = render_frame(scene, camera)
    d, observer = directions(frame, camera), np.array(frame.truth.r_itrs)
    heights = frame.maps["tangent_height"]
    for band, shape in BANDS.items():
        climate = Climate(shape["lo_um"], shape["hi_um"], 2)
        for column, wanted in ((0, 20e3), (2, 35e3), (3, -60e3)):
            row = int(np.argmin(np.abs(heights[:, column] - wanted)))
            expected = climate.radiance(observer, d[row, column], 285.0)
            found = float(frame.radiance[band][row, column])
            assert found == pytest.approx(expected, rel=1e-3), f"{band} at {heights[row, column]} m"


def test_bent_rays_equal_brute_force() -> None:
    """0.1 %: Bouguer's law ``n r sin = const`` in half a million steps, for impact parameters of 4 to 50 km.

    The index is the model's own; 10.5 to 12.5 um at 4 km is 20 % darker than along the straight ray.
    """
    model = model_of(["14.0-16.3um", "10.5-12.5um"], atmosphere={"refraction": True})
    assert model.refractivity is not None
    impacts = [4e3, 8e3, 15e3, 30e3, 50e3]
    observer, direction = limb_rays(impacts)
    found = thermal_radiance(model, RADIUS_M, observer, direction)
    for interval in ("14.0-16.3um", "10.5-12.5um"):
        band = Band("us_standard", *limits_um(interval), filled=True, seam=True)
        for i, impact in enumerate(impacts):
            expected = bent_radiance(band, model.altitude_m, model.refractivity, impact)
            value = float(found[interval.replace(".", "-")][i])
            assert value == pytest.approx(expected, rel=1e-3), f"{interval} at {impact / 1e3} km"


def bent_radiance(band: Band, z_m: np.ndarray, refractivity: np.ndarray, impact_m: float, count: int = 60_000) -> float:
    """Return the radiance of a limb ray with an impact parameter in vacuum; ``r = r_0 + x^2`` from its lowest point."""
    c = RADIUS_M + impact_m

    def index(h: np.ndarray) -> np.ndarray:
        log = np.interp(h, z_m, np.log(np.maximum(refractivity, 1e-30)))
        return np.asarray(1.0 + np.where(h < z_m[-1], np.exp(log), 0.0))

    lo, hi = 0.0, impact_m
    while hi - lo > 1e-7:
        middle = (lo + hi) / 2
        above = float(index(np.array(middle))) * (RADIUS_M + middle) > c
        lo, hi = (lo, middle) if above else (middle, hi)
    edges = np.linspace(0.0, np.sqrt(z_m[-1] - hi), count + 1)
    x, step = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    h = hi + x**2
    n, r = index(h), RADIUS_M + h
    # (n r)^2 - c^2 by difference from the lowest point, where both are equal
    excess = (n * r - c) * (n * r + c)
    ds = 2 * x * n * r / np.sqrt(np.maximum(excess, 1e-300)) * step
    total, depth = 0.0, np.zeros(band.ln_k.shape[1])
    for half in (slice(None, None, -1), slice(None)):
        for first in range(0, count, 10_000):
            part = np.arange(count)[half][first : first + 10_000]
            k, source = band.absorption(h[part]), band.source(band.air_k(h[part]))
            step_depth = k * ds[part, None]
            tau = depth + np.cumsum(step_depth, axis=0)
            total += float(np.sum(np.exp(step_depth - tau) * -np.expm1(-step_depth) * source))
            depth = tau[-1]
    return total


@pytest.mark.parametrize("temperature_k", [10.0, 180.0, 340.0, 1000.0])
def test_bare_ground_of_any_temperature(temperature_k: float) -> None:
    """Planck's law to 1e-6 (single precision of frames) without air, colder and warmer than any Earth."""
    scene = scene_of(atmosphere={"profile": "none"}, surface={"temperature_k": temperature_k, "emissivity": 0.8})
    frame = render_frame(scene, camera_of(5, 4, 20.0))
    for band, shape in BANDS.items():
        black = quad(
            lambda nu: float(planck_per_cm(np.array(nu), np.array(temperature_k))),
            1e4 / shape["hi_um"],
            1e4 / shape["lo_um"],
            epsabs=0.0,
        )[0]
        np.testing.assert_allclose(frame.radiance[band], 0.8 * black, rtol=1e-6, atol=1e-30)


def test_the_sun_seen_away_from_the_earth_is_not_dimmed() -> None:
    """The disc above a camera at 500 km, straight away from the Earth, has all its radiance: 1e-4."""
    scene = scene_of(sun={"zenith_deg": 0.0}, attitude={"roll_deg": 180.0})
    frame = render_frame(scene, camera_of(40, 40, 2.0))
    bands = model_of(BANDS_UM).thermal
    for band in bands:
        assert float(frame.radiance[band.name].max()) == pytest.approx(float(band.sun_radiance.sum()), rel=1e-4)


def test_the_year_closes() -> None:
    """From December to January, and from month to month, the limb changes by no more than a second's worth: 1e-4."""
    heights = [-20e3, 10e3, 30e3, 45e3]
    observer, direction = limb_rays(heights)
    observer, direction = observer[:, [2, 1, 0]], direction[:, [2, 1, 0]]
    for before, after in (
        ("2026-12-31T23:59:59", "2027-01-01T00:00:01"),
        ("2027-01-31T23:59:59", "2027-02-01T00:00:01"),
    ):
        pair = []
        for epoch in (before, after):
            model = model_of(
                BANDS_UM,
                atmosphere={"profile": "by_latitude_month"},
                platform={"altitude_km": 500.0, "latitude_deg": 50.0, "epoch_utc": epoch},
                surface={"temperature_k": 280.0},
            )
            pair.append(thermal_radiance(model, RADIUS_M, observer, direction))
        for band in BANDS_UM:
            np.testing.assert_allclose(pair[1][band], pair[0][band], rtol=1e-4)
