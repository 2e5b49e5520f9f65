"""Newton's method, the closed form and the orthogonal plane on the same noisy points: where each of them wins."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods import altitude_free, altitude_free_closed_form
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle
from horizonval.systems.a.bank import ARCSEC
from horizonval.systems.task_cache import rng_of

PIXEL_RAD = float(2 * np.tan(np.radians(30.0)) / 1024)
"""Of 1024 pixels over 60 deg, at the centre: what the noise is stated in."""
RADII_DEG = (31.0, 42.8, 62.7, 70.2, 80.0, 88.0)
ARCS_DEG = (20.0, 40.0, 90.0, 360.0)
NOISES_PX = (0.02, 0.1, 0.3)
DRAWS = 200
POINTS = 400


def conditions(seed: int) -> dict[str, JsonObject]:
    """Return the items by name: every radius and arc at a tenth of a pixel, every noise on 40 deg at 3000 km."""
    cells = [(rho, arc, 0.1) for rho in RADII_DEG for arc in ARCS_DEG]
    cells += [(42.8, 40.0, noise) for noise in NOISES_PX if noise != 0.1]
    return {
        f"rho {rho:g} deg, arc {arc:g} deg, noise {noise:g} px": {
            "rho_deg": rho,
            "arc_deg": arc,
            "noise_px": noise,
            "seed": seed,
        }
        for rho, arc, noise in cells
    }


def compare(item: JsonObject) -> JsonObject:
    """Return errors of the nadir [arcsec] of one condition, over 200 draws of 400 points evenly along the arc.

    ``_rms``; ``_bias``: the mean, along the arc's bisector; the closed form's bias as predicted; Newton's steps and
    failures; the largest angle between Newton's nadir and that of the orthogonal plane.
    """
    rng = rng_of(item["seed"], "altitude-free solvers", *(f"{item[k]:g}" for k in ("rho_deg", "arc_deg", "noise_px")))
    rho, sigma = np.radians(item["rho_deg"]), item["noise_px"] * PIXEL_RAD
    nadir = np.array([np.sin(rho), 0.0, np.cos(rho)])
    # towards the optical axis: the camera looks at the middle of the arc
    bisector, side = np.array([-np.cos(rho), 0.0, np.sin(rho)]), np.array([0.0, 1.0, 0.0])
    angle = np.radians(item["arc_deg"]) * (np.arange(POINTS) + 0.5 - POINTS / 2) / POINTS
    t = np.cos(angle)[:, None] * bisector + np.sin(angle)[:, None] * side
    errors: dict[str, list[float]] = {"newton": [], "closed": []}
    biases: dict[str, list[float]] = {"newton": [], "closed": []}
    steps, failed, apart = [], 0, [0.0]
    for _ in range(DRAWS):
        off = rho + rng.normal(0.0, sigma, POINTS)[:, None]
        los = np.cos(off) * nadir + np.sin(off) * t
        nadirs: dict[str, FloatArray] = {}
        try:
            nadirs["newton"], _, iterates = altitude_free.solve(los)
            steps.append(len(iterates) - 1)
            apart.append(float(off_axis_angle(fit_cone(los).axis_cam, nadirs["newton"])))
        except np.linalg.LinAlgError:
            failed += 1
        nadirs["closed"] = altitude_free_closed_form.solve(los)[0]
        for name, direction in nadirs.items():
            errors[name].append(float(off_axis_angle(direction, nadir)))
            biases[name].append(float(direction @ bisector))
    exact = np.cos(rho) * nadir + np.sin(rho) * t
    predicted = altitude_free_closed_form.attenuation(exact, nadir, float(rho), float(sigma)) * np.cos(rho)

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(errors[name])))) * ARCSEC

    return {
        **{k: item[k] for k in ("rho_deg", "arc_deg", "noise_px")},
        "newton_rms": rms("newton"),
        "newton_bias": float(np.mean(biases["newton"])) * ARCSEC,
        "closed_rms": rms("closed"),
        "closed_bias": float(np.mean(biases["closed"])) * ARCSEC,
        "predicted_closed_bias": float(predicted @ bisector) * ARCSEC,
        "newton_steps": float(np.mean(steps)) if steps else 0.0,
        "newton_failed": failed / DRAWS,
        "plane_difference": max(apart) * ARCSEC,
    }
