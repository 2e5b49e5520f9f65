"""Physics anchors: what every night must find again without any baseline, because an authority outside says so.

================  =====================================================================================================
furnace           air and black ground of one temperature shine as a black body on every ray
planck            the integral of Planck's law over all wavelengths is sigma T^4 / pi, in a band it is its quadrature
exact limb        points of the horizon lie on the ellipsoid with the line of sight in the tangent plane; above a
                  sphere the horizon's angle is asin(R / r); an estimator given exact points finds the nadir
photon transfer   variance against mean of flat fields is (electrons + read noise^2) / gain^2 + 1 / 12
single scatter    radiances of a Rayleigh limb, against another code's (SASKTRAN2), whose table ships with this room
================  =====================================================================================================

Each takes a second at most. Tolerances stand beside the checks with their reasons.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy import constants, integrate

from horizonval.geometry.rotation import angle_between
from horizonval.studies.regression.statistics.decide import Verdict

Anchor = dict[str, Any]
_FOLDER = Path(__file__).parent
SCATTER_NODES = 256
"""Leaves 1e-5; the default of eight times as many costs seconds."""
TABLE, ATMOSPHERE = _FOLDER / "single_scatter.csv", _FOLDER / "single_scatter_atmosphere.json"


def anchors() -> list[Anchor]:
    """Return every anchor: ``{name, verdict, found, limit, unit, n, what}``; ``found`` is the largest deviation.

    An anchor that raises is a FAIL whose ``what`` says why.
    """
    checks: dict[str, Callable[[], Anchor]] = {
        "furnace": furnace,
        "planck": planck,
        "exact-limb": exact_limb,
        "estimator-on-exact-limb": estimator_on_exact_limb,
        "photon-transfer": photon_transfer,
        "single-scatter": single_scatter,
    }
    found = []
    for name, check in checks.items():
        try:
            found.append({"name": name, **check()})
        except Exception as e:
            what = f"could not be checked: {type(e).__name__}: {e}"
            found.append(
                {"name": name, "verdict": str(Verdict.FAIL), "found": None, "limit": None, "unit": "", "n": 0}
                | {"what": " ".join(what.split())}
            )
    return found


def _anchor(deviations: Any, limit: float, unit: str, what: str) -> Anchor:
    values = np.abs(np.asarray(deviations, dtype=np.float64)).ravel()
    worst = float(values.max()) if values.size and np.isfinite(values).all() else None
    verdict = Verdict.PASS if worst is not None and worst <= limit else Verdict.FAIL
    return {
        "verdict": str(verdict),
        "found": worst,
        "limit": limit,
        "unit": unit,
        "n": int(values.size),
        "what": what,
    }


def furnace() -> Anchor:
    """Isothermal air over black ground, 8 to 14 um and the 15 um band: 1e-6, the quadrature's own accuracy."""
    from horizonval.earth.optical import optical_model
    from horizonval.earth.surface.ground_emission import uniform_ground
    from horizonval.renderer.rays.thermal_radiance import thermal_radiance
    from horizonval.spec.camera import CameraSpec
    from horizonval.spec.scene import SceneSpec

    bands = {"window": (8.0, 14.0), "co2": (14.0, 16.3)}
    temperature_k, radius_m, distance_m = 250.0, 6371e3, 6871e3
    camera = {
        "camera": {"width": 1, "height": 1, "fov_deg": 1},
        "band": [{"name": n, "kind": "thermal", "lo_um": lo, "hi_um": hi} for n, (lo, hi) in bands.items()],
    }
    scene = {"camera": {"file": "furnace"}, "platform": {"altitude_km": 500}, "atmosphere": {"profile": "tropical"}}
    model = optical_model(SceneSpec.model_validate(scene), CameraSpec.model_validate(camera))
    thermal = tuple(replace(b, temperature_k=np.full_like(b.temperature_k, temperature_k)) for b in model.thermal)
    model = replace(model, thermal=thermal, emission=uniform_ground(temperature_k, 1.0))
    impact = radius_m + np.array([-radius_m, -3000e3, -500e3, -20e3, -1.0])
    observer = np.stack([-np.sqrt(distance_m**2 - impact**2), np.zeros(5), impact], axis=1)
    radiance = thermal_radiance(model, radius_m, observer, np.tile([1.0, 0.0, 0.0], (5, 1)))
    black = {name: _black(lo, hi, temperature_k) for name, (lo, hi) in bands.items()}
    return _anchor(
        [radiance[name] / black[name] - 1.0 for name in bands],
        1e-6,
        "relative",
        "radiance of isothermal air and black ground over Planck's law, minus 1",
    )


def planck() -> Anchor:
    """The package's Planck functions against Stefan and Boltzmann's law and adaptive quadrature: 1e-9."""
    from horizonval.earth.spectral.planck import band_radiance, radiance_per_um

    found = []
    for temperature in (180.0, 250.0, 300.0):
        total = constants.sigma * temperature**4 / math.pi
        # In the logarithm of the wavelength the integrand is smooth from 0.5 um to 5 mm.
        whole, _ = integrate.quad(
            lambda u, t=temperature: math.exp(u) * float(radiance_per_um(math.exp(u), t)),
            math.log(0.5),
            math.log(5e4),
            epsabs=0.0,
            epsrel=1e-11,
            limit=400,
        )
        found.append(whole / total - 1.0)
        for lo, hi in ((8.0, 14.0), (14.0, 16.3)):
            found.append(float(band_radiance(lo, hi, temperature)) / _black(lo, hi, temperature) - 1.0)
    return _anchor(found, 1e-9, "relative", "integrals of the spectral radiance over their closed form, minus 1")


def _black(lo_um: float, hi_um: float, temperature_k: float) -> float:
    """Return the band's black-body radiance [W m-2 sr-1] by quadrature of Planck's law as written here."""
    h, c, k = constants.h, constants.c, constants.k

    def spectral(w_um: float) -> float:
        w = w_um * 1e-6
        return 2e-6 * h * c**2 / w**5 / math.expm1(h * c / (w * k * temperature_k))

    return float(integrate.quad(spectral, lo_um, hi_um, epsabs=0.0, epsrel=1e-12)[0])


def exact_limb() -> Anchor:
    """Tangency by the ellipsoid's own equation: 1e-9 rad, 2 mm at the horizon; a part in 1e9 is what float64 leaves."""
    from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic, sphere
    from horizonval.geometry.horizon import angular_radius, horizon_directions, tangency_points

    found: list[float] = []
    t = np.linspace(0.0, 2 * math.pi, 73)
    for latitude, height in ((0.0, 400e3), (0.8, 500e3), (-1.2, 800e3), (0.3, 35786e3)):
        r = np.asarray(itrs_from_geodetic(latitude, 0.4, height, WGS84), dtype=np.float64)
        points, directions = tangency_points(r, WGS84, t), horizon_directions(r, WGS84, t)
        axes = np.array([WGS84.a_m, WGS84.a_m, WGS84.b_m])
        found += list(np.sum((points / axes) ** 2, axis=1) - 1.0)
        normal = points / axes**2
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        found += list(np.sum(normal * directions, axis=1))
        line = points - r
        found += list(np.linalg.norm(np.cross(line / np.linalg.norm(line, axis=1)[:, None], directions), axis=1))
        ball = sphere(6371008.8)
        found.append(angular_radius(r, ball) - math.asin(6371008.8 / float(np.linalg.norm(r))))
    return _anchor(found, 1e-9, "rad", "deviation of the horizon from tangency to WGS84, and from asin(R / r)")


def estimator_on_exact_limb() -> Anchor:
    """The altitude-free method on exact points of a sphere's limb: 0.01 arcsec, a ten-thousandth of a pixel."""
    from horizonval.estimation.observation import Fit, Observation
    from horizonval.geometry.camera import CameraModel, project
    from horizonval.geometry.frames import rotate
    from horizonval.plugins import registry

    camera = CameraModel(512, 512, 500.0, 500.0, 255.5, 255.5)
    found: list[float] = []
    estimator = registry.get("altitude-free")
    assert estimator.from_points is not None
    for tilt, height in ((1.0, 400e3), (1.15, 600e3), (1.3, 800e3)):
        radius, angle = math.asin(6371008.8 / (6371008.8 + height)), np.linspace(-0.35, 0.35, 200)
        side = math.sin(radius)
        cone = np.stack([side * np.sin(angle), -side * np.cos(angle), np.full(200, math.cos(radius))], axis=1)
        # The camera looks at the limb: nadir by `tilt` below the boresight.
        q = np.array([-math.sin(tilt / 2), 0.0, 0.0, math.cos(tilt / 2)])
        nadir, lines = rotate(q, np.array([0.0, 0.0, 1.0])), rotate(q, cone)
        result = estimator.from_points(lines, project(camera, lines)[0], Observation(np.zeros((512, 512)), camera))
        if not isinstance(result, Fit):
            found.append(math.inf)
            continue
        found.append(math.degrees(angle_between(nadir, result.nadir_cam)) * 3600)
    return _anchor(found, 0.01, "arcsec", "nadir error of the altitude-free method on exact points of a sphere's limb")


def photon_transfer() -> Anchor:
    """Flat fields at four levels, 65 536 pixels: the variance's standard error is 0.55 %, the limit four of them."""
    from horizonval.frame import MAP_UNITS, RadianceFrame
    from horizonval.sensor.observe import observe
    from horizonval.spec.camera import CameraSpec
    from horizonval.spec.scene import SceneSpec
    from horizonval.truth.frame_truth import truth_of

    size, gain, read_noise, dark = 256, 4.0, 12.0, 40.0
    spec = CameraSpec.model_validate(
        {
            "camera": {"name": "bench", "width": size, "height": size, "fov_deg": 0.1},
            "optics": {"f_number": 4.0, "transmission": 0.8},
            "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
            "detector": {
                "kind": "cmos",
                "pixel_pitch_um": 5.5,
                "exposure_s": 2e-4,
                "quantum_efficiency": 0.6,
                "full_well_e": 60000,
                "read_noise_e": read_noise,
                "dark_current_e_per_s": dark / 2e-4,
                "bits": 14,
                "black_level_dn": 100,
                "gain_e_per_dn": gain,
            },
        }
    )
    place = {"altitude_km": 500.0, "epoch_utc": datetime(2026, 3, 20, 12, tzinfo=UTC)}
    scene = SceneSpec.model_validate({"scene": {"name": "bench"}, "camera": {"file": "bench"}, "platform": place})
    truth = truth_of(scene, spec)
    maps = {name: np.zeros((size, size), np.float32) for name in MAP_UNITS}
    # Photoelectrons of unit radiance: pi tau p^2 / (4 N^2) t QE lambda / (h c) at the band's 0.55 um.
    power = math.pi * 0.8 * (5.5e-6) ** 2 / (4 * 4.0**2)
    per_radiance = power * 2e-4 * 0.6 * 0.55e-6 / (constants.h * constants.c)
    found = []
    for radiance in (0.0, 3.0, 30.0, 100.0):
        frame = RadianceFrame({"vis": np.full((size, size), radiance, np.float32)}, maps, truth)
        dn = observe(frame, spec, seed=1).dn.astype(np.float64)
        electrons = per_radiance * radiance + dark
        variance = (electrons + read_noise**2) / gain**2 + 1 / 12
        found.append(dn.var() / variance - 1.0)
        # The mean is known far better: as a share of the noise it must be within the same limit.
        found.append((dn.mean() - 100 - electrons / gain) / math.sqrt(variance))
    return _anchor(
        found, 4 * math.sqrt(2 / size**2), "relative", "variance of flat fields over photon transfer's, minus 1"
    )


def single_scatter() -> Anchor:
    """A Rayleigh limb by day at 550 nm: 0.2 %; the table is good to 0.02 %."""
    from horizonval.earth.atmosphere_file import file_model, read_atmosphere
    from horizonval.renderer.plugin.backend import activate
    from horizonval.renderer.rays.radiance import radiance_along_rays

    with TABLE.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))

    def vectors(name: str, unit: str) -> np.ndarray:
        return np.array([[float(row[f"{name}_{axis}{unit}"]) for axis in "xyz"] for row in rows])

    activate()
    atmosphere = read_atmosphere(ATMOSPHERE)
    model = file_model(atmosphere, thermal=False)
    ours = radiance_along_rays(
        model,
        atmosphere.planet_radius_m,
        vectors("obs", "_km") * 1e3,
        vectors("dir", ""),
        vectors("sun", ""),
        nodes=SCATTER_NODES,
    )["550nm"]
    authority = np.array([float(row["ss_550nm"]) for row in rows])
    return _anchor(ours / authority - 1.0, 2e-3, "relative", "single-scatter radiance over SASKTRAN2's, minus 1")
