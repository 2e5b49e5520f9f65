"""``horizonval radiance --thermal`` as a user calls it, against codes of others, brute force and Planck's law."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emission_reference import march, planck_per_cm
from make_tables import GREY_GROUND_K
from reference_rays import RADIUS_KM, limb_ray

from horizonval import cli

DATA = Path(__file__).parents[1] / "data"
OPACITIES = ("k1e-06", "k1e-05", "k1e-04", "k1e-03")
LIMB = [0.25, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0]
GROUND = [-0.5, -2.0, -10.0, -100.0, -1000.0, -6000.0]


def planck_per_um(wavelength_um: float, temperature_k: np.ndarray) -> np.ndarray:
    """Return B_lambda [W m-2 sr-1 um-1]."""
    return planck_per_cm(np.array(1e4 / wavelength_um), temperature_k) * 1e4 / wavelength_um**2


def rows_of(name: str) -> list[dict[str, str]]:
    with (DATA / name).open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def air() -> dict[str, Any]:
    return dict(json.loads((DATA / "atm_grey_15um.json").read_text()))


def command(folder: Path, atmosphere: dict[str, Any], heights_km: list[float]) -> dict[str, np.ndarray]:
    """Return what the command writes for rays of these heights (negative: to the ground), by band."""
    rays = [limb_ray(60.0, 0.0, height) for height in heights_km]
    with (folder / "rays.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rays[0]))
        writer.writeheader()
        writer.writerows(rays)
    (folder / "atm.json").write_text(json.dumps(atmosphere))
    paths = [str(folder / name) for name in ("rays.csv", "atm.json", "out.csv")]
    assert cli.run_command_line(["radiance", paths[0], "--atmosphere", paths[1], "-o", paths[2], "--thermal"]) == 0
    with (folder / "out.csv").open() as file:
        out = list(csv.DictReader(file))
    return {b["name"]: np.array([float(row[f"radiance_{b['name']}"]) for row in out]) for b in atmosphere["bands"]}


def worst(found: np.ndarray, expected: np.ndarray, heights_km: list[float]) -> str:
    """Say how far two columns are apart, and where."""
    error = np.abs(found / expected - 1.0)
    return f"worst {error.max():.2e} at {heights_km[int(np.argmax(error))]} km"


def test_every_opacity_equals_two_other_codes(air: dict[str, Any], tmp_path: Path) -> None:
    """1e-4; the tables of the two codes agree to 2e-5. Limb from 0.25 to 98 km and rays to the ground."""
    rows = rows_of("grey_limb_thermal_15um.csv")
    heights = list(dict.fromkeys(float(r["tangent_or_impact_km"]) for r in rows))
    assert len(heights) == 60
    ours = command(tmp_path, air, heights)
    assert tuple(ours) == OPACITIES
    for name in OPACITIES:
        mine = [r for r in rows if f"k{float(r['k0_per_m']):.0e}" == name]
        assert [float(r["tangent_or_impact_km"]) for r in mine] == heights
        for column in ("radiance_sasktran2_dz100m_W_m2_sr_um", "radiance_independent_quadrature"):
            table = np.array([float(r[column]) for r in mine])
            assert np.abs(ours[name] / table - 1.0).max() < 1e-4, (
                f"{name} {column}: {worst(ours[name], table, heights)}"
            )


def test_another_wavelength_and_a_warm_ground_equal_another_code(air: dict[str, Any], tmp_path: Path) -> None:
    """1e-4, as above: 10 um, black ground of 300 K."""
    rows = rows_of("grey_limb_thermal_10um.csv")
    heights = [float(r["tangent_km"]) for r in rows]
    changed = air | {
        "bands": [b | {"wavelength_nm": 10_000.0} for b in air["bands"]],
        "surface": {"albedo": 0.0, "temperature_K": GREY_GROUND_K, "emissivity": 1.0},
    }
    ours = command(tmp_path, changed, heights)
    for name in OPACITIES:
        table = np.array([float(r[name]) for r in rows])
        assert np.abs(ours[name] / table - 1.0).max() < 1e-4, f"{name}: {worst(ours[name], table, heights)}"


def test_extreme_opacities_equal_brute_force(air: dict[str, Any], tmp_path: Path) -> None:
    """1e-4; the brute force moves by less than 1e-5 with twice the cells. Vertical depths from 7e-6 to 700."""
    shape = np.array(air["bands"][2]["absorption_per_m"]) / 1e-4
    k0s = (1e-9, 1e-7, 3e-5, 1e-2, 1e-1)
    bands = [air["bands"][0] | {"name": f"k{k0:g}", "absorption_per_m": (k0 * shape).tolist()} for k0 in k0s]
    heights = [0.25, 5.0, 15.0, 30.0, 50.0, 70.0, 90.0, -0.5, -100.0, -6000.0]
    ours = command(tmp_path, air | {"bands": bands}, heights)
    z, temperature, k = 1e3 * np.array(air["altitude_km"]), np.array(air["temperature_K"]), np.outer(shape, k0s)
    expected = np.stack([brute_force(z, temperature, k, 15.0, height, 288.15) for height in heights])
    for i, name in enumerate(ours):
        assert np.abs(ours[name] / expected[:, i] - 1.0).max() < 1e-4, (
            f"{name}: {worst(ours[name], expected[:, i], heights)}"
        )


def brute_force(
    z_m: np.ndarray,
    temperature_k: np.ndarray,
    k: np.ndarray,
    wavelength_um: float,
    height_km: float,
    ground_k: float | None,
    cells: int = 16,
    *,
    upwards: bool = False,
) -> np.ndarray:
    """Return radiances [W m-2 sr-1 um-1] of absorbers (n, m) linear between levels, shape (m,).

    ``upwards``: not from space down to the ground but from the ground up, on the same line.
    """
    radius, b = 1e3 * RADIUS_KM, 1e3 * (RADIUS_KM + height_km)
    half = np.sqrt((radius + z_m[z_m > 1e3 * height_km]) ** 2 - b**2)
    edges = half[::-1] if height_km < 0 else np.concatenate([half[::-1], [0.0], -half])
    s = np.concatenate([*(np.linspace(p, q, cells, endpoint=False) for p, q in pairwise(edges)), edges[-1:]])

    def row(z: np.ndarray) -> np.ndarray:
        i = np.clip(np.searchsorted(z_m, z, side="right") - 1, 0, len(z_m) - 2)
        w = ((z - z_m[i]) / (z_m[i + 1] - z_m[i]))[:, None]
        return (1 - w) * k[i] + w * k[i + 1]

    def source(z: np.ndarray) -> np.ndarray:
        return np.repeat(planck_per_um(wavelength_um, np.interp(z, z_m, temperature_k))[:, None], k.shape[1], axis=1)

    warm = height_km < 0 and ground_k is not None and not upwards
    ground = np.full(k.shape[1], planck_per_um(wavelength_um, np.array(ground_k))) if warm else None
    path = s[::-1] if upwards else s
    return march(path, lambda x: (x**2 + b**2 - radius**2) / (np.hypot(x, b) + radius), row, source, ground)


def test_a_grey_ground_reflects_the_sky(air: dict[str, Any], tmp_path: Path) -> None:
    """1e-4 of brute force: ``emissivity B + (1 - emissivity) E / pi``, the sky's irradiance E from 24 directions.

    Twelve directions change it by 2e-7, finer cells by 4e-7.
    """
    heights = [-0.5, -20.0, -1000.0, -6000.0]
    emissivity, ground_k = 0.4, 290.0
    surface = {"albedo": 0.0, "temperature_K": ground_k, "emissivity": emissivity}
    ours = command(tmp_path, air | {"surface": surface}, heights)
    z, temperature = 1e3 * np.array(air["altitude_km"]), np.array(air["temperature_K"])
    k = np.array([b["absorption_per_m"] for b in air["bands"]]).T

    def ray(height_km: float, warmth: float | None, *, upwards: bool = False) -> np.ndarray:
        return brute_force(z, temperature, k, 15.0, height_km, warmth, cells=4, upwards=upwards)

    x, w = np.polynomial.legendre.leggauss(24)
    # mu = t^2: the horizon's brightness changes fast.
    t, w = (x + 1) / 2, w / 2
    down = np.stack([ray(RADIUS_KM * (np.sqrt(1 - t_**4) - 1), None, upwards=True) for t_ in t])
    sky = 2 * np.pi * np.sum((w * 2 * t * t**2)[:, None] * down, axis=0)
    black = float(planck_per_um(15.0, np.array(ground_k)))
    for height, i in zip(heights, range(len(heights)), strict=True):
        bare, lit = ray(height, None), ray(height, ground_k)
        passed = (lit - bare) / black
        expected = bare + passed * (emissivity * black + (1 - emissivity) * sky / np.pi)
        found = np.array([ours[name][i] for name in OPACITIES])
        assert np.abs(found / expected - 1.0).max() < 1e-4, f"{height} km: {found / expected - 1.0}"


@pytest.mark.parametrize("wavelength_um", [7.5, 15.0])
def test_isothermal_air_and_ground_are_a_black_body(air: dict[str, Any], tmp_path: Path, wavelength_um: float) -> None:
    """1e-6 on every ray to the ground whatever the opacity; on the limb ``B (1 - exp(-tau))`` to 1e-5 of tables."""
    bands = [b | {"wavelength_nm": 1e3 * wavelength_um} for b in air["bands"]]
    surface = {"albedo": 0.0, "temperature_K": 250.0, "emissivity": 1.0}
    even = air | {"bands": bands, "temperature_K": [250.0] * len(air["altitude_km"]), "surface": surface}
    ours = command(tmp_path, even, LIMB + GROUND)
    black = float(planck_per_um(wavelength_um, np.array(250.0)))
    z = 1e3 * np.array(air["altitude_km"])
    for band in bands:
        found = ours[band["name"]] / black
        ground = found[len(LIMB) :]
        assert np.abs(ground - 1.0).max() < 1e-6, f"{band['name']}: {worst(ground, np.ones(len(GROUND)), GROUND)}"
        depth = np.array([optical_depth(z, np.array(band["absorption_per_m"]), height) for height in LIMB])
        opaque = depth > 20.0
        assert np.abs(found[: len(LIMB)][opaque] - 1.0).max(initial=0.0) < 1e-6
        expected = -np.expm1(-depth)
        assert np.abs(found[: len(LIMB)] / expected - 1.0).max() < 1e-5, worst(found[: len(LIMB)], expected, LIMB)


def optical_depth(z_m: np.ndarray, k: np.ndarray, height_km: float) -> float:
    """Return the depth of a whole limb path, midpoints of 400 000 steps (1e-7)."""
    b = 1e3 * (RADIUS_KM + height_km)
    end = np.sqrt((1e3 * RADIUS_KM + z_m[-1]) ** 2 - b**2)
    x = (np.arange(400_000) + 0.5) / 400_000
    # Dense about the lowest point: s = end x^2.
    s = end * x**2
    height = np.sqrt(s**2 + b**2) - 1e3 * RADIUS_KM
    return float(2 * np.sum(np.interp(height, z_m, k) * 2 * end * x) / 400_000)
