"""The physics anchors hold, and each fails when what it watches is wrong."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import horizonval.earth.spectral.planck
import horizonval.geometry.horizon
import horizonval.renderer.rays.radiance
import horizonval.renderer.rays.thermal_radiance
import horizonval.sensor.observe
from horizonval.plugins import registry
from horizonval.studies.regression import anchors

DATA = Path(__file__).parents[3] / "data"
CHECKS = {
    "furnace": anchors.furnace,
    "planck": anchors.planck,
    "exact-limb": anchors.exact_limb,
    "estimator-on-exact-limb": anchors.estimator_on_exact_limb,
    "photon-transfer": anchors.photon_transfer,
    "single-scatter": anchors.single_scatter,
}


@pytest.mark.parametrize("name", CHECKS)
def test_anchor_holds(name):
    found = CHECKS[name]()
    assert found["verdict"] == "PASS", found
    assert 0.0 <= found["found"] <= found["limit"]
    assert found["n"] >= 3


def scaled(function, factor):
    """A function whose result is that much too large."""

    def wrong(*arguments, **options):
        result = function(*arguments, **options)
        if isinstance(result, dict):
            return {key: value * factor for key, value in result.items()}
        return result * factor

    return wrong


@pytest.mark.parametrize(
    ("name", "module", "function", "factor"),
    [
        ("furnace", horizonval.renderer.rays.thermal_radiance, "thermal_radiance", 1 + 1e-5),
        ("planck", horizonval.earth.spectral.planck, "band_radiance", 1 + 1e-8),
        ("exact-limb", horizonval.geometry.horizon, "tangency_points", 1 + 1e-8),
        ("single-scatter", horizonval.renderer.rays.radiance, "radiance_along_rays", 1.003),
    ],
)
def test_anchor_fails_when_its_subject_is_wrong(monkeypatch, name, module, function, factor):
    monkeypatch.setattr(module, function, scaled(getattr(module, function), factor))
    assert CHECKS[name]()["verdict"] == "FAIL"


def test_photon_transfer_fails_for_doubled_read_noise(monkeypatch):
    observe = horizonval.sensor.observe.observe

    def noisier(frame, camera, **options):
        detector = camera.detector.model_copy(update={"read_noise_e": 2 * camera.detector.read_noise_e})
        return observe(frame, camera.model_copy(update={"detector": detector}), **options)

    monkeypatch.setattr(horizonval.sensor.observe, "observe", noisier)
    assert anchors.photon_transfer()["verdict"] == "FAIL"


def test_the_estimator_anchor_fails_for_a_biased_estimator(monkeypatch):
    from dataclasses import replace

    real = registry.get("altitude-free")

    def biased(lines, pixels, observation):
        fit = real.from_points(lines, pixels, observation)
        return replace(fit, nadir_cam=fit.nadir_cam + np.array([1e-6, 0.0, 0.0]))

    monkeypatch.setattr(registry, "get", lambda name: replace(real, from_points=biased))
    assert anchors.estimator_on_exact_limb()["verdict"] == "FAIL"


def test_an_anchor_that_cannot_be_checked_fails(monkeypatch):
    monkeypatch.setattr(anchors, "TABLE", Path("nowhere.csv"))
    for name in ("furnace", "planck", "exact_limb", "estimator_on_exact_limb", "photon_transfer"):
        monkeypatch.setattr(anchors, name, lambda: {"verdict": "PASS"})
    found = {one["name"]: one for one in anchors.anchors()}
    assert found["single-scatter"]["verdict"] == "FAIL"
    assert "nowhere.csv" in found["single-scatter"]["what"]


def test_the_shipped_table_is_that_of_the_reference():
    """Every ninth ray by day of the table of the other code, and its atmosphere at 550 nm."""
    with (DATA / "rayleigh_limb_sasktran2.csv").open() as file:
        day = [row for row in csv.DictReader(file) if float(row["sza_deg"]) < 80.0]
    with anchors.TABLE.open() as file:
        shipped = list(csv.DictReader(file))
    assert shipped == [{key: row[key] for key in shipped[0]} for row in day[::9]]
    whole = json.loads((DATA / "atm_rayleigh.json").read_text())
    whole["bands"] = [band for band in whole["bands"] if band["name"] == "550nm"]
    assert json.loads(anchors.ATMOSPHERE.read_text()) == whole
