"""Make a reference table of ``tests/data`` with another code.

    python tests/physics/make_tables.py NAME [ARGUMENT ...]

Without a name, the names are listed. Rows that a Monte Carlo table already has stay; delete the file to make all of
them again. ``PROCESSES`` sets how many rays run at a time. Numba and SASKTRAN2 are loaded only by the tables that need
them, because tests read the inputs of tables here.
"""

from __future__ import annotations

import csv
import json
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from reference_rays import DATA, RADIUS_KM, VECTORS, fill, limb_ray, vector

from horizonval.earth.column import OpticalModel, SpectralNode

if TYPE_CHECKING:
    import monte_carlo

Row = dict[str, Any]


def write(name: str, rows: list[Row]) -> None:
    """Write a table."""
    with (DATA / name).open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def texts(bands: Iterable[str], values: np.ndarray, prefix: str = "", digits: int = 8) -> Row:
    """Return a column for each band."""
    return {f"{prefix}{band}": f"{x:.{digits}g}" for band, x in zip(bands, values, strict=True)}


def answer_of(job: Row, air: monte_carlo.Air, seed: Any, plan: Any = None, **options: Any) -> monte_carlo.Answer:
    """Return the Monte Carlo's answer for the ray of a row; ``options``: ``paths``, ``goal`` and ``most``."""
    import monte_carlo

    start = time.perf_counter()
    answer = monte_carlo.radiance(
        air, vector(job, "obs"), vector(job, "dir"), vector(job, "sun"), options["paths"], seed, plan,
        se=options["goal"], max_paths=options["most"],
    )  # fmt: skip
    ray = " ".join(str(value) for key, value in job.items() if key not in VECTORS)
    print(
        f"{ray}: {answer.total:.5g}, se {answer.multiple_se / answer.total:.2%}, {answer.n_paths} paths, "
        f"{time.perf_counter() - start:.0f} s",
        flush=True,
    )
    return answer


def columns_of(answer: monte_carlo.Answer, suffix: str) -> Row:
    """Return total, its standard error, the first order and the number of paths."""
    return {
        f"radiance{suffix}": f"{answer.total:.6g}",
        "se": f"{answer.multiple_se:.2g}",
        f"single{suffix}": f"{answer.single_exact:.6g}",
        "n_paths": answer.n_paths,
    }


# -- Particles of asymmetry 0.7 among molecules

AEROSOL_HEIGHTS_KM = (2, 10, 20, 30, -1, -10, -100)
AEROSOL_ZENITHS = {"day": (30, 60, 85), "twilight": (90, 92, 95)}
AEROSOL_EFFORT: dict[str, Row] = {
    "day": {"paths": 20_000, "goal": 2e-3, "most": 2_000_000},
    "twilight": {"paths": 20_000, "goal": 1e-2, "most": 1_500_000},
}
AEROSOL_ALTITUDE_KM = np.concatenate([np.arange(0, 30, 0.25), np.arange(30, 50, 0.5), np.arange(50, 101, 1.0)])


def aerosol_atmosphere(case: str) -> Row:
    """Return the content of an atmosphere file: Rayleigh at 550 nm and particles, ``haze`` or ``volcanic``."""

    def layer(shape: np.ndarray, depth: float) -> np.ndarray:
        return shape * depth / np.trapezoid(shape, 1e3 * z)

    rayleigh = json.loads((DATA / "atm_rayleigh.json").read_text())
    z, levels = AEROSOL_ALTITUDE_KM, np.array(rayleigh["altitude_km"])
    molecules = next(b for b in rayleigh["bands"] if b["name"] == "550nm")["scattering_per_m"]
    if case == "haze":
        note = "tau 0.15 of scale height 2 km and tau 0.01 at 20 km (Gauss, 1 km); single scattering albedo 0.95"
        particles = layer(np.exp(-z / 2.0), 0.15) + layer(np.exp(-0.5 * (z - 20.0) ** 2), 0.01)
        albedo = 0.95
    else:
        note = "tau 0.1 from 12 to 25 km, edges 1 km wide; single scattering albedo 0.99"
        particles = layer(np.interp(z, [12, 13, 24, 25], [0, 1, 1, 0]), 0.1)
        albedo = 0.99
    return {
        "note": f"US Standard 1976 Rayleigh scattering, albedo of the ground 0.3; particles: {note}.",
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": z.tolist(),
        "temperature_K": np.interp(z, levels, rayleigh["temperature_K"]).tolist(),
        "bands": [
            {
                "name": "550nm",
                "wavelength_nm": 550.0,
                "scattering_per_m": np.exp(np.interp(z, levels, np.log(molecules))).tolist(),
                "absorption_per_m": ((1.0 - albedo) * particles).tolist(),
                "phase": "rayleigh",
                "particle_scattering_per_m": (albedo * particles).tolist(),
                "asymmetry": 0.7,
            }
        ],
        "surface": rayleigh["surface"],
    }


def _aerosol_row(job: Row, air: monte_carlo.Air, case: str, effort: Row) -> Row:
    import monte_carlo

    return job | columns_of(answer_of(job, air, monte_carlo.seed_of(case, job), **effort), "_550nm")


def aerosol(case: str, when: str) -> None:
    """``haze`` or ``volcanic``, ``day`` or ``twilight``: ``limb_aerosol_*_montecarlo.csv`` (minutes)."""
    import monte_carlo

    data = aerosol_atmosphere(case)
    (DATA / f"atm_aerosol_{case}.json").write_text(json.dumps(data) + "\n")
    air = monte_carlo.air_of(data, data["bands"][0])
    jobs = [limb_ray(*ray) for ray in product(AEROSOL_ZENITHS[when], (180, 90, 0), AEROSOL_HEIGHTS_KM)]
    work = partial(_aerosol_row, air=air, case=case, effort=AEROSOL_EFFORT[when])
    fill(DATA / f"limb_aerosol_{case}_{when}_montecarlo.csv", jobs, ("sza", "azimuth", "tangent_km"), work)


# -- LOWTRAN7's particles with the Sun set

HAZY_KEY = ("aerosol", "wavelength_nm", "sza", "azimuth", "tangent_km")
HAZY_WAVELENGTHS_NM = (450, 850)
ALBEDO = 0.3


@cache
def hazy_columns(aerosol: str) -> OpticalModel:
    """Return the columns of ``hazy_columns.npz`` with a model of particles, a node per wavelength, named after it.

    US standard air with ozone at 450 and 850 nm, as scenes had it when the file was written; the irradiance is 1.
    """
    with np.load(DATA / "hazy_columns.npz") as data:
        z = data["altitude_m"]
        nodes = [
            SpectralNode(
                name=str(w),
                band=str(w),
                weight=1.0,
                wavelength_um=1e-3 * w,
                extinction_per_m=data[f"{aerosol}_{w}_extinction_per_m"],
                molecular_per_m=data[f"{aerosol}_{w}_molecular_per_m"],
                molecular_cos2=float(data[f"{aerosol}_{w}_cos2"]),
                particle_per_m=data[f"{aerosol}_{w}_particle_per_m"],
                asymmetry=data[f"{aerosol}_{w}_asymmetry"],
                solar_irradiance=1.0,
                sun_radiance=0.0,
            )
            for w in HAZY_WAVELENGTHS_NM
        ]
    return OpticalModel(altitude_m=z, top_m=float(z[-1]), nodes=tuple(nodes), albedo=ALBEDO)


@cache
def _hazy_air(aerosol: str, wavelength_nm: int) -> monte_carlo.Air:
    import monte_carlo

    model = hazy_columns(aerosol)
    node = next(n for n in model.nodes if n.band == str(wavelength_nm))
    return monte_carlo.make_air(
        1e-3 * model.altitude_m,
        1e3 * node.molecular_per_m,
        1e3 * (node.extinction_per_m - node.scattering_per_m),
        [(1e3 * node.particle_per_m, node.asymmetry)],
        cos2=node.molecular_cos2,
        ground=monte_carlo.uniform(ALBEDO),
    )


def _hazy_row(job: Row) -> Row:
    import monte_carlo

    air = _hazy_air(job["aerosol"], job["wavelength_nm"])
    answer = answer_of(job, air, monte_carlo.seed_of("hazy twilight", job), paths=20_000, goal=0.01, most=300_000)
    return job | {"radiance": f"{answer.total:.6g}", "se": f"{answer.multiple_se:.2g}"}


def hazy_twilight() -> None:
    """``limb_hazy_twilight_montecarlo.csv``: the limb through LOWTRAN7's particles with the Sun set (an hour)."""
    rays = product((180, 0, 90), (20, 40, 10), (5, 8, 10, 12), ("background", "volcanic_high"), HAZY_WAVELENGTHS_NM)
    jobs = [
        {"aerosol": name, "wavelength_nm": wavelength} | limb_ray(90.0 + depression, azimuth, height)
        for azimuth, height, depression, name, wavelength in rays
    ]
    fill(DATA / "limb_hazy_twilight_montecarlo.csv", jobs, HAZY_KEY, _hazy_row)


# -- Molecules alone: twilight, the ellipsoid, chequered grounds

TWILIGHT_RAYS = (
    (92, 0, 2), (92, 90, 10), (92, 180, 20), (92, 0, -1), (92, 90, -10),
    (95, 0, 10), (95, 90, 2), (95, 180, 10), (95, 90, 30), (95, 180, -10),
    (98, 0, 20), (98, 90, 20), (98, 180, 10),
    (100, 0, 30), (100, 90, 20), (100, 180, 20),
)  # fmt: skip


def _rayleigh_row(job: Row) -> Row:
    import monte_carlo

    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", f"{job['wavelength_nm']}nm")
    seed = monte_carlo.seed_of("rayleigh twilight", job)
    return job | columns_of(answer_of(job, air, seed, paths=50_000, goal=1e-2, most=1_500_000), "")


def rayleigh_twilight() -> None:
    """``limb_rayleigh_twilight_montecarlo.csv``: ``atm_rayleigh.json`` at 450 and 850 nm, Sun below the horizon."""
    jobs = [{"wavelength_nm": nm} | limb_ray(*ray) for nm in (450, 850) for ray in TWILIGHT_RAYS]
    key = ("wavelength_nm", "sza", "azimuth", "tangent_km")
    fill(DATA / "limb_rayleigh_twilight_montecarlo.csv", jobs, key, _rayleigh_row)


AXES_KM = (6378.137, 6378.137 * (1.0 - 1.0 / 298.257223563))
OBLATE_LATITUDE_DEG, OBLATE_OBSERVER_KM, SUN_BESIDE_DEG = 45.0, 500.0, 60.0
OBLATE_VIEWS = {"north": 0.0, "south": 180.0, "east": 90.0}
OBLATE_GOAL = {60: 2e-3, 88: 4e-3}


def _oblate_ray(air: monte_carlo.Air, view: str, height_km: float, sza_deg: float) -> Row:
    """Return a row; the ray's lowest geodetic height is found by halving the angle of view."""
    import monte_carlo

    latitude = np.radians(OBLATE_LATITUDE_DEG)
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north, east = np.array([-np.sin(latitude), 0.0, np.cos(latitude)]), np.array([0.0, 1.0, 0.0])
    curvature = AXES_KM[0] / np.sqrt(1.0 - (1.0 - (AXES_KM[1] / AXES_KM[0]) ** 2) * np.sin(latitude) ** 2)
    observer = (curvature + OBLATE_OBSERVER_KM) * up
    observer[2] = (curvature * (AXES_KM[1] / AXES_KM[0]) ** 2 + OBLATE_OBSERVER_KM) * np.sin(latitude)
    azimuth = np.radians(OBLATE_VIEWS[view])
    level = np.cos(azimuth) * north + np.sin(azimuth) * east

    def lowest(dip: float) -> tuple[float, np.ndarray, np.ndarray]:
        direction = np.cos(dip) * level - np.sin(dip) * up

        def height(t: float) -> float:
            return float(monte_carlo._height(air, *(observer + t * direction)))

        lo, hi = 1000.0, 4500.0
        for _ in range(100):
            a, b = lo + (hi - lo) / 3.0, hi - (hi - lo) / 3.0
            lo, hi = (lo, b) if height(a) < height(b) else (a, hi)
        return height(0.5 * (lo + hi)), observer + 0.5 * (lo + hi) * direction, direction

    lo, hi = np.radians(15.0), np.radians(25.0)
    for _ in range(60):
        dip = 0.5 * (lo + hi)
        lo, hi = (dip, hi) if lowest(dip)[0] > height_km else (lo, dip)
    _, point, direction = lowest(0.5 * (lo + hi))
    vertical = monte_carlo._up(air, point)
    z, beside = np.radians([sza_deg, SUN_BESIDE_DEG])
    sun = np.cos(z) * vertical
    sun += np.sin(z) * (np.cos(beside) * direction + np.sin(beside) * np.cross(vertical, direction))
    numbers = [*(round(float(x), 9) for x in observer), *(round(float(x), 15) + 0.0 for x in (*direction, *sun))]
    return {"view": view, "sza": sza_deg, "tangent_km": height_km, **dict(zip(VECTORS, numbers, strict=True))}


def _oblate_row(job: Row, air: monte_carlo.Air) -> Row:
    import monte_carlo

    seed, effort = monte_carlo.seed_of("oblate", job), {"goal": OBLATE_GOAL[job["sza"]], "most": 1_000_000}
    return job | columns_of(answer_of(job, air, seed, monte_carlo.Plan(), paths=20_000, **effort), "_550nm")


def oblate() -> None:
    """``limb_oblate_montecarlo_550nm.csv``: the limb of the WGS84 ellipsoid.

    The air of ``atm_rayleigh.json`` with its heights geodetic; an observer 500 km above latitude 45 deg, longitude 0,
    looks north, south and east; the Sun has its zenith angle at the ray's lowest point, 60 deg from the direction of
    view. Axes as ITRS: z polar.
    """
    import monte_carlo

    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm", axes_km=AXES_KM)
    rays = product(OBLATE_GOAL, (2, 5, 10, 20, 30, 40), OBLATE_VIEWS)
    jobs = [_oblate_ray(air, view, height, sza) for sza, height, view in rays]
    table = DATA / "limb_oblate_montecarlo_550nm.csv"
    fill(table, jobs, ("view", "sza", "tangent_km"), partial(_oblate_row, air=air))


GROUND_PLACES = {
    50.0: (3.0, 5.0), 100.0: (21.0, -33.0), 300.0: (3.0, 5.0), 1000.0: (21.0, -33.0), 20_000.0: (40.0, 2.0),
}  # fmt: skip
GROUND_KEY = ("square_km", "sza_deg", "view", "number")


def _ground_row(job: Row) -> Row:
    import monte_carlo
    from varied_ground import BRIGHT, DARK, vectors_of

    ground = monte_carlo.chequered(job["square_km"], BRIGHT, DARK)
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm")._replace(ground=ground)
    seed = monte_carlo.seed_of("varied ground", job)
    answer = monte_carlo.radiance(air, *vectors_of(job), 12_800, seed, se=0.003, max_paths=200_000)
    return job | {"total_per_sr": f"{answer.total:.6e}", "se_per_sr": f"{answer.multiple_se:.2e}"}


def varied_ground() -> None:
    """``varied_ground_montecarlo_550nm.csv``: rays over chequered grounds of two albedos (a minute).

    Rayleigh air of ``atm_rayleigh.json``; places and directions are drawn from a seed. Squares of 20 000 km are halves
    of the globe that meet at the meridian 0. Standard errors are below 0.4 % but for a few limb rays.
    """
    from varied_ground import nadir_angle_deg

    rng = np.random.default_rng(20)
    jobs = []
    for square_km, (latitude, longitude) in GROUND_PLACES.items():
        for sza, view, number in product((20.0, 60.0), ("disc", "limb"), range(8)):
            angle = rng.uniform(0.0, 62.0) if view == "disc" else nadir_angle_deg(rng.uniform(2.0, 45.0))
            place = {"latitude_deg": latitude, "longitude_deg": longitude}
            direction = {"nadir_deg": round(angle, 6), "azimuth_deg": round(rng.uniform(0.0, 360.0), 6)}
            jobs.append(dict(zip(GROUND_KEY, (square_km, sza, view, number), strict=True)) | place | direction)
    fill(DATA / "varied_ground_montecarlo_550nm.csv", jobs, GROUND_KEY, _ground_row)


# -- Thin cirrus

CLOUD_TABLE = DATA / "limb_thin_cloud_montecarlo.csv"
CLOUD_BASE_KM, CLOUD_TOP_KM = 9.0, 11.0
CLOUD_SUNS = ((20.0, 90.0), (60.0, 30.0), (60.0, 150.0), (85.0, 60.0), (90.0, 120.0))
CLOUD_HEIGHTS_KM = (3.0, 9.3, 10.2, 13.0)


def cloudy_columns(optical_depth: float) -> OpticalModel:
    """Return our model of air with the cirrus, of unit irradiance."""
    from horizonval.earth.clouds.layers import layers_of
    from horizonval.earth.optical import optical_model
    from horizonval.spec.camera import CameraSpec
    from horizonval.spec.scene import SceneSpec

    layer = {"kind": "cirrus", "optical_depth": optical_depth, "base_km": CLOUD_BASE_KM, "top_km": CLOUD_TOP_KM}
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "platform": {"altitude_km": 500},
            "atmosphere": {"aerosol": "none", "refraction": False, "gases_in_sunlight": False},
            "layer": [layer] if optical_depth else [],
        }
    )
    green = {"name": "green", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
    camera = {"camera": {"name": "test", "width": 8, "height": 8, "fov_deg": 5.0}, "band": [green]}
    model = optical_model(scene, CameraSpec.model_validate(camera))
    assert not optical_depth or layers_of(scene)[0].particle == "ice 30"
    return replace(model, nodes=(replace(model.nodes[0], solar_irradiance=1.0),))


def _cloudy_air(optical_depth: float) -> monte_carlo.Air:
    """Return the same air for the Monte Carlo, the layer's edges a metre wide."""
    import monte_carlo

    from horizonval.earth.clouds import layers

    model = cloudy_columns(0.0)
    node, z = model.nodes[0], model.altitude_m / 1e3
    edges = [CLOUD_BASE_KM - 1e-3, CLOUD_BASE_KM + 1e-3, CLOUD_TOP_KM - 1e-3, CLOUD_TOP_KM + 1e-3]
    heights = np.unique(np.concatenate([z, edges]))
    extinction, scattering, g = (float(v) for v in layers.sunlit("ice 30", node.wavelength_um))
    inside = ((heights > CLOUD_BASE_KM) & (heights < CLOUD_TOP_KM)) * optical_depth / (CLOUD_TOP_KM - CLOUD_BASE_KM)
    gas = np.interp(heights, z, node.extinction_per_m - node.molecular_per_m)
    return monte_carlo.make_air(
        heights,
        1e3 * np.interp(heights, z, node.molecular_per_m),
        1e3 * gas + inside * (extinction - scattering),
        [(inside * scattering, g)],
        cos2=node.molecular_cos2,
        ground=monte_carlo.uniform(0.3),
    )


def thin_cloud(*optical_depths: str) -> None:
    """``limb_thin_cloud_montecarlo.csv``, with the optical depths given (40 minutes of processor time).

    US standard air with ozone at one wavelength, ice of one kind from 9 to 11 km with sharp edges, albedo 0.3.
    """
    import monte_carlo

    rows = []
    for depth in map(float, optical_depths):
        air = _cloudy_air(depth)
        for i, ((sun, azimuth), height) in enumerate(product(CLOUD_SUNS, CLOUD_HEIGHTS_KM)):
            seed = monte_carlo.seed_of(depth, i, "y")
            ray = limb_ray(sun, azimuth, height)
            answer = answer_of(ray, air, seed, paths=8000, goal=4e-3, most=200_000)
            row = {"optical_depth": depth, "sun_zenith_deg": sun, "azimuth_deg": azimuth, "height_km": height}
            row |= {"radiance_per_sr": f"{answer.total:.6g}", "standard_error": f"{answer.multiple_se:.2g}"}
            rows.append(row | {"single_per_sr": f"{answer.single_exact:.6g}"})
    write(CLOUD_TABLE.name, rows)


# -- SASKTRAN2

OZONE_BANDS = ("450nm", "550nm", "600nm")
OZONE_HEIGHTS_KM = (1, 2, 4, 6, 8, 10, 12, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80, 90, -1, -10, -100)


def ozone(directions: str = "302") -> None:
    """``atm_ozone.json`` and ``limb_ozone_sasktran2.csv``, successive orders in 302 directions unless given.

    Rayleigh scattering without depolarisation and ozone's absorption, US standard atmosphere, given to SASKTRAN2 as
    plain coefficients; 5 Sun angles, the file's 500 m shells.
    """
    sys.path.insert(0, str(DATA.parent))
    from earth_forms import rayleigh_air
    from sasktran import sasktran_limb

    points = int(directions)
    data = rayleigh_air("us_standard", [450, 550, 600])
    for band in data["bands"]:
        for key in ("scattering_per_m", "absorption_per_m"):
            band[key] = [float(f"{x:.7g}") for x in band[key]]
    (DATA / "atm_ozone.json").write_text(json.dumps(data) + "\n")
    rays = list(product((0, 90, 180), OZONE_HEIGHTS_KM))
    rows = []
    for sza in (60, 20, 85):
        single = sasktran_limb(data, OZONE_BANDS, sza, rays)
        every = sasktran_limb(data, OZONE_BANDS, sza, rays, orders="all", points=points)
        for ray, one, total in zip(rays, single, every, strict=True):
            row = limb_ray(sza, *ray) | texts(OZONE_BANDS, one, "single_") | {"directions": points}
            rows.append(row | texts(OZONE_BANDS, total, "radiance_"))
    write("limb_ozone_sasktran2.csv", rows)


REFRACTED_HEIGHTS_KM = (2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 25, 30)
WAVENUMBER2 = 1.0 / 0.55**2  # [um-2]
REFRACTIVITY = 1e-8 * (8060.51 + 2480990.0 / (132.274 - WAVENUMBER2) + 17455.7 / (39.32957 - WAVENUMBER2))


def refracted() -> None:
    """``limb_refraction_sasktran2.csv`` and ``refractive_index_550nm.csv`` (4 minutes).

    Single scattering of ``atm_rayleigh.json`` at 550 nm on 200 m shells, straight and with lines of sight and the Sun's
    rays bent. The refractive index minus 1 is proportional to the air's scattering coefficient, 2.7782e-4 at the ground
    (Peck and Reeder 1972, doi:10.1364/JOSA.62.000958, at 288.15 K and 101 325 Pa, which is the ground's air). Heights
    are those of the unbent rays. Shells of 500 and 200 m give the ratio of bent to straight of 100 m shells to 7e-5 and
    2e-5.
    """
    from sasktran import sasktran_limb

    data = json.loads((DATA / "atm_rayleigh.json").read_text())
    z = np.array(data["altitude_km"])
    k = np.array(next(b for b in data["bands"] if b["name"] == "550nm")["scattering_per_m"])
    refractivity = REFRACTIVITY * k / k[0]
    write(
        "refractive_index_550nm.csv",
        [{"altitude_km": f"{a:g}", "refractivity": f"{v:.12g}"} for a, v in zip(z, refractivity, strict=True)],
    )
    rays = list(product((0, 90, 180), REFRACTED_HEIGHTS_KM))
    rows = []
    for sza in (30, 60, 75):
        straight, bent = (
            sasktran_limb(data, ["550nm"], sza, rays, step_km=0.2, refractive_index=index, threads=2)[:, 0]
            for index in (None, (z, 1.0 + refractivity))
        )
        for ray, *pair in zip(rays, straight, bent, strict=True):
            rows.append(limb_ray(sza, *ray) | texts(("straight_550nm", "refracted_550nm"), np.array(pair)))
    write("limb_refraction_sasktran2.csv", rows)


SHELLS_M = np.linspace(0.0, 100e3, 1001)
EMISSION_HEIGHTS_KM = (0.5, 8.0, 16.0, 25.0, 40.0, 55.0, 70.0, 90.0, -1.0, -20.0)
EMISSION_CLIMATES = ("tropical", "subarctic_winter")
EMISSION_BANDS = ("band4", "band5", "band7")
GREY_HEIGHTS_KM = (0.25, 1, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40, 46, 52, 60, 70, 80, 90, 98, -0.5, -5, -100)
GREY_GROUND_K = 300.0


def band_absorption(climate: str, band: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return absorption [1/m] on the shells, shape (n, 16), temperature, shape (n,), and the middle wavelength [um]."""
    from emission_reference import BAND_EDGES_PER_CM, Band

    lo, hi = BAND_EDGES_PER_CM[band]
    table = Band(climate, 1e4 / hi, 1e4 / lo)
    return table.absorption(SHELLS_M), table.air_k(SHELLS_M), 2e4 / (lo + hi)


def correlated_k(climate: str, band: str, heights_km: tuple[float, ...] = EMISSION_HEIGHTS_KM) -> np.ndarray:
    """Return radiances [W m-2 sr-1 um-1] by SASKTRAN2, shape (rays, 16)."""
    from sasktran import sasktran_emission

    k, temperature, middle_um = band_absorption(climate, band)
    ground_k = float(temperature[0])
    return sasktran_emission(SHELLS_M, k, temperature, middle_um, heights_km, radius_km=RADIUS_KM, ground_k=ground_k)


def emission() -> None:
    """``grey_limb_thermal_10um.csv`` and ``thermal_ck_sasktran2.csv`` (100 m shells, a second).

    The first: the absorbers of ``atm_grey_15um.json`` at 10 um over a black ground of 300 K. The second: the shipped
    absorption table, 16 g points of three bands in two climates, each as if monochromatic with the Planck function at
    the middle of its band, over a black ground as warm as the lowest air. Absorption is taken from the table
    log-linearly at the shells and is linear between them.
    """
    from sasktran import sasktran_emission

    data = json.loads((DATA / "atm_grey_15um.json").read_text())
    names = [b["name"] for b in data["bands"]]
    grey = sasktran_emission(
        1e3 * np.array(data["altitude_km"]),
        np.array([b["absorption_per_m"] for b in data["bands"]]).T,
        np.array(data["temperature_K"]),
        10.0,
        GREY_HEIGHTS_KM,
        radius_km=RADIUS_KM,
        ground_k=GREY_GROUND_K,
    )
    rows = [{"tangent_km": height} | texts(names, row) for height, row in zip(GREY_HEIGHTS_KM, grey, strict=True)]
    write("grey_limb_thermal_10um.csv", rows)
    points = [f"g{g + 1:02d}" for g in range(16)]
    rows = [
        {"climate": climate, "band": band, "tangent_km": height} | texts(points, row, digits=7)
        for climate, band in product(EMISSION_CLIMATES, EMISSION_BANDS)
        for height, row in zip(EMISSION_HEIGHTS_KM, correlated_k(climate, band), strict=True)
    ]
    write("thermal_ck_sasktran2.csv", rows)


# -- Brute force

LATITUDE_HEIGHT_M, LATITUDE_GROUND_K = 900e3, 285.0
LATITUDE_PLACES = ((52.0, 20.0, 2), (-20.0, 179.0, 7), (88.0, -60.0, 10), (-72.0, 60.0, 9))
"""Latitude, longitude [deg], month."""
LATITUDE_BANDS = {"co2": (14.0, 16.3), "window": (10.5, 12.5)}
LATITUDE_KEY = ("latitude_deg", "longitude_deg", "month", "azimuth_deg", "height_km")


@cache
def _climate(lo_um: float, hi_um: float, month: int) -> Any:
    from latitude_limb import Climate

    return Climate(lo_um, hi_um, month)


def latitude_row(job: Row) -> Row:
    """Return one row."""
    from latitude_limb import aim, lowest_m, position

    observer = position(job["latitude_deg"], job["longitude_deg"], LATITUDE_HEIGHT_M)
    direction = aim(observer, job["azimuth_deg"], 1e3 * job["height_km"])
    row = job | {"lowest_km": round(lowest_m(observer, direction) / 1e3, 4)}
    row |= {f"obs_{axis}_m": f"{x:.4f}" for axis, x in zip("xyz", observer, strict=True)}
    row |= {f"dir_{axis}": f"{x:.15f}" for axis, x in zip("xyz", direction, strict=True)}
    for name, limits in LATITUDE_BANDS.items():
        radiance = _climate(*limits, job["month"]).radiance(observer, direction, LATITUDE_GROUND_K)
        row[f"radiance_{name}"] = f"{radiance:.7g}"
    return row


def latitude() -> None:
    """``limb_latitude_thermal.csv`` by :mod:`latitude_limb`: 10 m steps (4 minutes of processor time).

    Seen from 900 km over four places, through the climate of a month by latitude, WGS84, black ground of 285 K.
    """
    rays = product(LATITUDE_PLACES, (0.0, 100.0, 200.0, 290.0), (-20.0, -1.0, 6.0, 16.0, 30.0, 45.0))
    jobs = [dict(zip(LATITUDE_KEY, (*place, *ray), strict=True)) for place, *ray in rays]
    fill(DATA / "limb_latitude_thermal.csv", jobs, LATITUDE_KEY, latitude_row)


def thermal_ratios(*climates: str) -> None:
    """Print what the renderer's thermal radiance is of LOWTRAN7's and REPTRAN's, every interval and height.

    All at 330 ppm of CO2. Why they depart (US standard atmosphere where figures are given):

    - 14.0 to 16.3 um up to 26 km, 1 to 5 %: its middle (band 4) agrees within 2 %; the rest is 700 to 714 cm-1, where
      the table is 8 % brighter at the ground and 14 % darker on the limb than LOWTRAN7, 3 to 7 % darker than REPTRAN.
    - 28 to 46 km: up to 15 % darker than LOWTRAN7, up to 12 % brighter than REPTRAN. Lines are narrow there, and the
      two peers, of 20 and 15 cm-1 resolution, disagree by 30 % between themselves at 40 km.
    - Above 46 km: LOWTRAN7 has no Doppler broadening and too little absorption at low pressure, REPTRAN likewise from
      60 km on: ratios of 2 to 10 say nothing against the table. Above 75 km there is no local thermodynamic
      equilibrium.
    - 8 to 14 um from 8 to 30 km, up to 11 % darker: ozone itself (band 7) agrees within 2 % up to 24 km; it is 714 to
      980 cm-1 (bands 5 and 6) that is darker.
    - 10.5 to 12.5 um above 8 km, 10 to 30 % darker up to 28 km: less than 0.5 W m-2 sr-1; which part of its g points
      lies in the window is known no better.
    - 500 to 630 cm-1 (band 3), 10 to 13 % darker from 18 to 28 km: not explained; no third peer covers it.
    - 1080 to 1390 cm-1 (bands 8 and 9): brighter from 24 km on, N2O and CH4 at low pressure.
    - Nadir: within 1.3 K but for 700 to 820 cm-1 (+3 K), of which 14.0 to 16.3 um has its share (+2 K).
    """
    from test_thermal_table import IN_FILE, INTERVALS, RADIUS_M, heights_m, ours, table

    for climate, peer in product(climates or IN_FILE, ("lowtran7", "reptran")):
        expected = {name: table(climate, name, f"{peer}_330ppm_W_m2_sr") for name in INTERVALS}
        shown = [name for name in INTERVALS if np.any(np.isfinite(expected[name]))]
        print(f"\n{climate}, 330 ppm of CO2: ours / {peer}\n{'km':>6}" + "".join(f"{name:>14}" for name in shown))
        for i, z in enumerate(heights_m()):
            ratios = [ours(climate, 330)[name][i] / expected[name][i] for name in shown]
            if np.any(np.isfinite(ratios)):
                height = "nadir" if z == -RADIUS_M else f"{z / 1e3:g}"
                print(f"{height:>6}" + "".join(f"{r:14.3f}" if np.isfinite(r) else f"{'':>14}" for r in ratios))


MAKERS: dict[str, Callable[..., None]] = {
    maker.__name__: maker
    for maker in (
        aerosol, emission, hazy_twilight, latitude, oblate, ozone, rayleigh_twilight, refracted, thermal_ratios,
        thin_cloud, varied_ground,
    )
}  # fmt: skip

if __name__ == "__main__":
    if len(sys.argv) > 1:
        MAKERS[sys.argv[1]](*sys.argv[2:])
    else:
        print("\n".join(f"{name}: {(maker.__doc__ or '').splitlines()[0]}" for name, maker in MAKERS.items()))
