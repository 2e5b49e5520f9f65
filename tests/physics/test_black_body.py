"""Air and ground of one temperature shine as a black body in a thermal band, whatever absorbs and however much.

The authority is Planck's law, integrated over the response by adaptive quadrature here.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from emission_reference import RADIUS_M, C, H, K
from scipy.integrate import quad
from thermal_model import radiances

from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.earth.surface.ground_emission import uniform_ground
from horizonval.renderer.rays import thermal_radiance
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

RESPONSES: dict[str, tuple[list[float], list[float]]] = {
    "co2": ([14.0, 16.3], [1.0, 1.0]),
    "window": ([8.0, 14.0], [1.0, 1.0]),
    "everything": ([7.1943, 20.0], [1.0, 1.0]),
    "narrow": ([11.0, 11.01], [1.0, 1.0]),
    "very-narrow": ([15.0, 15.0001], [1.0, 1.0]),
    "blue-edge": ([7.1943, 7.2043], [1.0, 1.0]),
    "red-edge": ([19.99, 20.0], [1.0, 1.0]),
    "triangle": ([13.0, 14.2, 15.0, 16.0, 17.0], [0.0, 0.0, 1.0, 0.2, 0.0]),
    "gap": ([9.0, 9.5, 10.0, 11.0, 11.5, 12.0], [0.0, 0.8, 0.0, 0.0, 0.4, 0.0]),
    "teeth": ([14.0, 14.1, 14.1001, 14.5, 14.5001, 16.0], [0.0, 0.0, 1.0, 1.0, 0.3, 0.3]),
}
HEIGHTS_M = [-RADIUS_M, -500e3, -20e3, -1.0, 500.0, 12e3, 30e3, 60e3]
OPACITIES_PER_M = (1e-300, 1e-7, 1e-5, 1e-3, 1e-1)


def planck_per_um(wavelength_um: float, temperature_k: float) -> float:
    metres = wavelength_um * 1e-6
    return float(2e-6 * H * C**2 / metres**5 / np.expm1(H * C / (metres * K * temperature_k)))


def black(name: str, temperature_k: float) -> float:
    """Return the integral of R B [W m-2 sr-1]; the response is linear between its knots, its peak 1."""
    wavelength, response = RESPONSES[name]
    scaled = np.array(response) / max(response)
    return sum(
        float(
            quad(
                lambda w: float(np.interp(w, wavelength, scaled)) * planck_per_um(w, temperature_k),
                lo,
                hi,
                epsabs=0.0,
                epsrel=1e-11,
            )[0]
        )
        for lo, hi in pairwise(wavelength)
        if np.interp([lo, (lo + hi) / 2, hi], wavelength, scaled).any()
    )


def model(names: list[str], **atmosphere: Any) -> OpticalModel:
    bands = []
    for name in names:
        wavelength, response = RESPONSES[name]
        shape: dict[str, Any] = {"wavelength_um": wavelength, "response": response}
        if len(wavelength) == 2:
            shape = {"lo_um": wavelength[0], "hi_um": wavelength[1]}
        bands.append({"name": name, "kind": "thermal"} | shape)
    camera = CameraSpec.model_validate({"camera": {"width": 1, "height": 1, "fov_deg": 1}, "band": bands})
    scene = {
        "camera": {"file": "test"},
        "platform": {"altitude_km": 500},
        "atmosphere": {"refraction": False} | atmosphere,
    }
    return optical_model(SceneSpec.model_validate(scene), camera)


def even(original: OpticalModel, temperature_k: float, emissivity: float) -> OpticalModel:
    thermal = tuple(replace(b, temperature_k=np.full_like(b.temperature_k, temperature_k)) for b in original.thermal)
    return replace(original, thermal=thermal, emission=uniform_ground(temperature_k, emissivity))


def with_opacity(original: OpticalModel, per_m: float) -> OpticalModel:
    thermal = tuple(replace(b, ln_extinction=np.full_like(b.ln_extinction, np.log(per_m))) for b in original.thermal)
    return replace(original, thermal=thermal)


@pytest.mark.parametrize("temperature_k", [180.0, 250.0, 340.0])
def test_ground_rays_through_the_shipped_absorption(temperature_k: float) -> None:
    """1e-6 on every ray to a black ground, in ten bands: at the table's edges, 0.1 nm wide, with gaps and steps."""
    names = list(RESPONSES)
    found = radiances(even(model(names, profile="tropical"), temperature_k, 1.0), HEIGHTS_M)
    for name in names:
        error = np.abs(found[name][:4] / black(name, temperature_k) - 1)
        assert error.max() < 1e-6, f"{name} at {temperature_k} K: {error}"


@pytest.mark.parametrize("per_m", OPACITIES_PER_M)
def test_any_opacity(per_m: float) -> None:
    """1e-6: ground rays at every opacity, limb rays where the air is opaque; none above ``B (1 - exp(-tau))``."""
    names = ["co2", "window", "gap"]
    found = radiances(with_opacity(even(model(names), 270.0, 1.0), per_m), HEIGHTS_M)
    top = model(names).top_m
    for name in names:
        share = found[name] / black(name, 270.0)
        assert np.abs(share[:4] - 1).max() < 1e-6, f"{name}, {per_m} per m: {share}"
        for height, value in zip(HEIGHTS_M[4:], share[4:], strict=True):
            chord = 2 * np.sqrt((RADIUS_M + top) ** 2 - (RADIUS_M + height) ** 2)
            expected = -np.expm1(-per_m * chord)
            assert value == pytest.approx(expected, rel=1e-6, abs=1e-12), f"{name}, {per_m} per m, {height} m"


@pytest.mark.parametrize("emissivity", [0.0, 0.3, 1.0])
def test_emissivity_between_nothing_and_all(emissivity: float) -> None:
    """Opaque isothermal air hides the ground; without air the ground shines with its emissivity alone: 1e-6."""
    names = ["co2", "window"]
    hidden = radiances(with_opacity(even(model(names), 260.0, emissivity), 1e-1), HEIGHTS_M)
    bare = radiances(with_opacity(even(model(names), 260.0, emissivity), 1e-300), HEIGHTS_M)
    for name in names:
        assert np.abs(hidden[name] / black(name, 260.0) - 1).max() < 1e-6
        np.testing.assert_allclose(bare[name][:4], emissivity * black(name, 260.0), rtol=1e-6, atol=1e-12)
        assert np.abs(bare[name][4:]).max() < 1e-12


@pytest.mark.parametrize("emissivity", [0.0, 0.5])
def test_a_cavity(emissivity: float) -> None:
    """Grey ground under opaque air of its own temperature, seen from half a metre, reflects what it does not emit.

    1e-4, the quadrature over the sky's directions.
    """
    names = ["co2", "window"]
    thick = with_opacity(even(model(names), 260.0, emissivity), 1e-3)
    observer = np.array([[0.0, 0.0, RADIUS_M + 0.5], [0.0, 0.0, RADIUS_M + 0.5]])
    found = thermal_radiance(thick, RADIUS_M, observer, np.array([[0.0, 0.0, -1.0], [0.5, 0.0, -1.0]]))
    for name in names:
        error = np.abs(found[name] / black(name, 260.0) - 1)
        assert error.max() < 1e-4, f"{name}: {error}"
