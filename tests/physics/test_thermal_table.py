"""The absorption of six climates through the renderer, against the figures published with their tables.

``thermal_verification.csv`` holds four climates, 38 limb and ground rays and the nadir, 11 intervals. What was
published besides it for all six climates (plateau, height of half of it, brightness at the nadir) stands below.
"""

from __future__ import annotations

import csv
import functools
from pathlib import Path

import numpy as np
import pytest
from emission_reference import BAND_EDGES_PER_CM, INTERVALS_UM, RADIUS_M, Band, limits_um, planck_per_cm, radiance
from scipy.integrate import quad
from scipy.optimize import brentq
from thermal_model import key, model_of, radiances

DATA = Path(__file__).parents[1] / "data"
INTERVALS = (*BAND_EDGES_PER_CM, *INTERVALS_UM)
CLIMATES = (
    "tropical",
    "midlatitude_summer",
    "midlatitude_winter",
    "subarctic_summer",
    "subarctic_winter",
    "us_standard",
)
IN_FILE = ("tropical", "midlatitude_winter", "subarctic_summer", "us_standard")


@functools.cache
def published() -> list[dict[str, str]]:
    with (DATA / "thermal_verification.csv").open() as file:
        return list(csv.DictReader(file))


@functools.cache
def heights_m() -> tuple[float, ...]:
    """Every ray of the file; the nadir is an impact parameter of 0."""
    names = list(dict.fromkeys(row["tangent_height_km"] for row in published()))
    return tuple(-RADIUS_M if name == "nadir" else 1e3 * float(name) for name in names)


@functools.cache
def ours(climate: str, co2_ppm: int) -> dict[str, np.ndarray]:
    """The renderer's radiance of every interval along every ray."""
    model = model_of(INTERVALS, atmosphere={"profile": climate, "co2_ppm": co2_ppm})
    found = radiances(model, heights_m())
    return {name: found[key(name)] for name in INTERVALS}


@functools.cache
def table(climate: str, interval: str, column: str) -> np.ndarray:
    """A column of the file; nan where it is empty."""
    mine = [r for r in published() if r["atmosphere"] == climate and r["interval"] == interval]
    assert len(mine) == len(heights_m()) == 39
    return np.array([float(r[column] or "nan") for r in mine])


def most(interval: str) -> float:
    """Return the largest relative difference from the published figures."""
    return 2e-3 if interval in ("band6", "band8", "band9") else 1e-3


def with_jump(interval: str, z: np.ndarray) -> np.ndarray:
    """Whether the published figures know the absorption's jump near 16 km too coarsely to be compared with."""
    return (z >= 8e3) & (z <= 18e3) & (interval in ("band3", "band5", "band8", "band9", "8-14um", "10.5-12.5um"))


@pytest.mark.parametrize("co2_ppm", [420, 330])
@pytest.mark.parametrize("climate", IN_FILE)
def test_every_interval_and_height_as_published(climate: str, co2_ppm: int) -> None:
    """0.1 % from the nadir to 80 km, 0.2 % in 820 to 980 and 1080 to 1390 cm-1, both concentrations of CO2.

    Five figures are printed (5e-5); the file takes the Planck function at the middles of bins (2e-4) and steps of its
    own; the renderer takes extinction and source as linear over 100 m. In 820 to 980 cm-1 the renderer scales the map
    from g points to wavenumber so that no bin loses anything (0.45 % of one bin, 0.13 % of the band).

    The file's table has levels 500 m apart where its absorption jumps, at 95.58 hPa: there, and for all rays that look
    at the jump from below, its figures are off by up to 1.5 % in bands 3 and 5 and 9 % in bands 8 and 9, by its
    authors' own account. Bands with a jump are compared outside 8 to 18 km, the rest of them in the next test; rays
    that cross it from farther below see 0.16 % of it in the bands where it is largest.
    """
    z = np.array(heights_m())
    report = {}
    for interval in INTERVALS:
        expected = table(climate, interval, f"radiance_{co2_ppm}ppm_W_m2_sr")
        error = np.abs(ours(climate, co2_ppm)[interval] / expected - 1)
        error = np.where(with_jump(interval, z), 0.0, error)
        i = int(np.argmax(error))
        report[interval] = f"{error[i]:.1e} at {z[i] / 1e3} km"
        assert error[i] < most(interval), f"{climate}, {co2_ppm} ppm: {report}"


@pytest.mark.parametrize(
    "climate",
    [
        pytest.param(name, marks=() if name in ("tropical", "subarctic_winter") else pytest.mark.slow)
        for name in CLIMATES
    ],
)
def test_every_climate_equals_another_integrator(climate: str) -> None:
    """0.1 % from the nadir to 95 km, at heights between the table's, bands 8 and 9 0.2 %; four times as much below the
    jump at 95.58 hPa.

    One looks the absorption up and the other reads the published table; they share no code. The renderer takes the
    extinction as linear over 100 m between levels where the table means it to be exponential (2e-4 for water vapour),
    and smears the jump over 200 m, where the other carries the table's lines on to it from either side.
    """
    heights = [-RADIUS_M, -1000e3, -30e3, -300.0, 50.0, 1.3e3, 3.7e3, 7.1e3, 11.9e3, 15.3e3, 15.8e3, 16.2e3, 16.7e3]
    heights += [18.4e3, 22.2e3, 27.7e3, 33.3e3, 39.1e3, 44.4e3, 51.2e3, 58.8e3, 66.6e3, 75.3e3, 84.9e3, 94.9e3]
    near = (np.array(heights) > 15.5e3) & (np.array(heights) < 17.1e3)
    found = radiances(model_of(INTERVALS, atmosphere={"profile": climate}), heights)
    report = {}
    for interval in INTERVALS:
        band = Band(climate, *limits_um(interval), filled=True, seam=True)
        expected = np.array([radiance(band, h, cells=16) for h in heights])
        error = np.abs(found[key(interval)] / expected - 1) / np.where(near, 4.0, 1.0)
        i = int(np.argmax(error))
        report[interval] = (float(error[i]), heights[i] / 1e3)
        limit = 2e-3 if interval in ("band8", "band9") else 1e-3
        assert error[i] < limit, f"{climate} {interval}: {error[i]:.2e} at {heights[i] / 1e3} km; so far {report}"


@pytest.mark.parametrize("climate", IN_FILE)
def test_lowtran(climate: str) -> None:
    """Another spectroscopy at 330 ppm of CO2: within what the two are known to differ by, where both hold.

    14.0 to 16.3 um: 5 % from the ground at 20 km below the limb up to 24 km, 5.5 % at 50 km below it and at 26 km (the
    table itself as published stands 5.2 % above in the tropics, 5.3 % below in the winter), 8 % at 28 and 30 km. 8 to
    14 um: 6 % up to 6 km, 12 % from 8 to 30 km. In every interval the ratio is the published one to 0.1 % (0.2 % in 820
    to 980 and 1080 to 1390 cm-1). ``python tests/physics/make_tables.py thermal_ratios`` prints all ratios and
    says why they depart.
    """
    z = np.array(heights_m())
    limits = {
        "14.0-16.3um": [
            ((z >= -20e3) & (z <= 24e3), 0.05),
            ((z == -50e3) | (z == 26e3), 0.055),
            ((z > 26e3) & (z <= 30e3), 0.08),
        ],
        "8-14um": [((z >= -50e3) & (z <= 6e3), 0.06), ((z >= 8e3) & (z <= 30e3), 0.12)],
    }
    for interval in INTERVALS:
        ratio = ours(climate, 330)[interval] / table(climate, interval, "lowtran7_330ppm_W_m2_sr")
        drift = np.abs(ratio / table(climate, interval, "ratio_to_lowtran7") - 1)
        drift = np.where(with_jump(interval, z), np.nan, drift)
        # The ratio is printed with four decimals.
        room = most(interval) + 5e-5 / ratio
        assert not np.any(drift >= room), f"{climate} {interval}: {np.nanmax(drift):.1e}"
        for where, limit in limits.get(interval, []):
            assert np.any(where)
            i = int(np.argmax(np.where(where, np.abs(ratio - 1), 0.0)))
            assert abs(ratio[i] - 1) < limit, f"{climate} {interval}: {ratio[i]:.4f} at {z[i] / 1e3} km"


# 14.0 to 16.3 um, 420 ppm: height of half the plateau [km] and plateau [W m-2 sr-1], the largest of 10 to 24 km.
PLATEAU = {
    "tropical": (41.53, 5.79),
    "midlatitude_summer": (42.40, 6.23),
    "midlatitude_winter": (40.37, 4.89),
    "subarctic_summer": (42.64, 6.59),
    "subarctic_winter": (38.00, 4.53),
    "us_standard": (41.23, 5.54),
}


@pytest.mark.parametrize("climate", CLIMATES)
def test_plateau_and_height_of_half_of_it(climate: str) -> None:
    """1 % (0.2 % is what two decimals allow) and 0.2 km; the climates differ by 45 % and 4.6 km."""
    heights = np.concatenate([np.arange(10e3, 24.1e3, 500.0), np.arange(34e3, 48e3, 100.0)])
    model = model_of(["14.0-16.3um"], atmosphere={"profile": climate, "co2_ppm": 420})
    found = radiances(model, heights.tolist())[key("14.0-16.3um")]
    plateau = found[heights <= 24.05e3].max()
    high = heights > 30e3
    half = np.interp(-plateau / 2, -found[high], heights[high])
    expected_km, expected = PLATEAU[climate]
    assert abs(plateau / expected - 1) < 0.01, f"plateau {plateau:.4f}, published {expected}"
    assert abs(half / 1e3 - expected_km) < 0.2, f"half at {half / 1e3:.3f} km, published {expected_km}"


# Brightness temperature [K] at the nadir, 330 ppm, in the order of CLIMATES: LOWTRAN7's, and the table's minus that.
NADIR = {
    "band3": ((264.3, 263.8, 253.9, 259.3, 246.3, 258.8), (0.70, 0.60, 1.10, 0.70, 1.26, 0.85)),
    "band4": ((221.9, 228.3, 220.5, 232.1, 217.8, 223.9), (-1.11, -0.51, -0.39, -0.06, -0.22, -0.30)),
    "band5": ((272.8, 271.4, 256.2, 266.7, 245.7, 266.4), (3.30, 3.06, 3.05, 2.87, 2.64, 3.41)),
    "band6": ((294.9, 291.3, 271.3, 284.8, 256.8, 286.3), (0.11, 0.30, 0.36, 0.36, 0.22, 0.47)),
    "band7": ((284.7, 278.7, 258.4, 272.7, 246.3, 272.9), (-0.27, -0.57, -0.38, -0.55, -0.33, -0.39)),
    "band8": ((294.2, 290.0, 269.9, 283.5, 255.8, 284.7), (0.47, 0.53, 0.52, 0.57, 0.38, 0.60)),
    "band9": ((276.5, 274.6, 260.5, 269.2, 250.3, 269.4), (-0.64, -0.66, -0.47, -0.36, -0.52, -0.51)),
    "14.0-16.3um": ((227.0, 231.9, 223.9, 234.3, 220.7, 227.2), (2.10, 1.94, 1.90, 1.85, 1.72, 2.13)),
    "14.16-16.25um": ((225.6, 230.9, 223.0, 233.7, 219.9, 226.3), (0.87, 0.92, 1.08, 1.04, 1.07, 1.12)),
    "8-14um": ((288.6, 284.9, 265.8, 278.8, 252.7, 279.7), (0.38, 0.39, 0.56, 0.45, 0.49, 0.59)),
    "10.5-12.5um": ((294.3, 291.0, 271.2, 284.5, 256.8, 286.0), (0.43, 0.49, 0.39, 0.51, 0.22, 0.59)),
}


def brightness_k(value: float, interval: str) -> float:
    """Temperature of a black body of this radiance [W m-2 sr-1] in an interval; Planck's law by adaptive quadrature."""
    lo, hi = limits_um(interval)

    def excess(temperature: float) -> float:
        nu_lo, nu_hi = 1e4 / hi, 1e4 / lo
        return (
            float(quad(lambda nu: float(planck_per_cm(nu, np.array(temperature))), nu_lo, nu_hi, epsabs=0)[0]) - value
        )

    return float(brentq(excess, 150.0, 350.0, xtol=1e-4))


@pytest.mark.parametrize("climate", CLIMATES)
def test_brightness_at_the_nadir(climate: str) -> None:
    """0.2 K; rounding leaves 0.055 K. LOWTRAN7's rays see the same ground, straight through the same profiles."""
    found = ours(climate, 330)
    nadir = heights_m().index(-RADIUS_M)
    for interval, (lowtran, difference) in NADIR.items():
        i = CLIMATES.index(climate)
        kelvin = brightness_k(float(found[interval][nadir]), interval)
        assert abs(kelvin - lowtran[i] - difference[i]) < 0.2, f"{climate} {interval}: {kelvin:.3f} K"
