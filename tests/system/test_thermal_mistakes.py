"""Mistakes in infrared scenes and cameras: one line that says where, what is expected, and no frame."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import Call, assert_one_line

CAMERA = '[camera]\nname = "t"\nwidth = 8\nheight = 8\nfov_deg = 10.0\n'
CO2 = '[[band]]\nname = "co2"\nkind = "thermal"\nlo_um = 14.0\nhi_um = 16.3\n'
SCENE = '[scene]\nname = "a"\n[camera]\nfile = "cam.toml"\n[platform]\naltitude_km = 500.0\n'


def band(text: str) -> str:
    return '[[band]]\nname = "e"\nkind = "thermal"\n' + text + "\n"


@pytest.mark.parametrize(
    ("camera", "scene", "parts"),
    [
        (CO2, "[atmosphere]\nco2_ppm = 0.0", ("atmosphere.co2_ppm", "280 to 560")),
        (CO2, "[atmosphere]\nco2_ppm = nan", ("atmosphere.co2_ppm", "280 to 560")),
        (CO2, '[atmosphere]\nco2_ppm = "lots"', ("atmosphere.co2_ppm", "280 to 560")),
        (CO2, '[atmosphere]\nprofile = "none"\nco2_ppm = 400.0', ("co2_ppm", "none")),
        (CO2, "[surface]\nemissivity = 1.5", ("surface.emissivity", "0 to 1")),
        (CO2, '[surface]\nkind = "earth"\nemissivity = 0.9', ("emissivity", "uniform")),
        (CO2, "[surface]\ntemperature_k = 0.0", ("surface.temperature_k", "above 0")),
        (CO2, "[clouds]\ncover = 0.5\nemissivity = 1.1", ("clouds.emissivity", "0 to 1")),
        (band("lo_um = 7.19\nhi_um = 8.0"), "", ("cam.toml: band[0]", "7.195 to 20 um")),
        (band("lo_um = 19.0\nhi_um = 20.01"), "", ("cam.toml: band[0]", "7.195 to 20 um")),
        (
            band("wavelength_um = [6.0, 8.0, 9.0, 21.0]\nresponse = [0.0, 0.0, 1.0, 0.0]"),
            "",
            ("cam.toml: band[0]", "8 to 21 um"),
        ),
        (band("wavelength_um = [9.0, 9.0]\nresponse = [1.0, 1.0]"), "", ("wavelength_um", "rise")),
        (band("wavelength_um = [9.0, 10.0]\nresponse = [0.0, 0.0]"), "", ("response", "above 0")),
    ],
)
def test_refused(horizonval: Call, tmp_path: Path, camera: str, scene: str, parts: tuple[str, ...]) -> None:
    (tmp_path / "cam.toml").write_text(CAMERA + camera)
    (tmp_path / "scene.toml").write_text(SCENE + scene + "\n")
    assert_one_line(horizonval("render", "scene.toml", "-o", "out.exr"), *parts)
    assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize(
    "text",
    [
        "lo_um = 7.1942447\nhi_um = 7.2042447",
        "lo_um = 19.99\nhi_um = 20.0",
        "wavelength_um = [8.0, 9.0, 10.0, 11.0, 12.0]\nresponse = [0.0, 1.0, 0.0, 0.0, 0.5]",
    ],
)
def test_bands_at_the_edges_of_what_is_known(horizonval: Call, tmp_path: Path, text: str) -> None:
    (tmp_path / "cam.toml").write_text(CAMERA + band(text))
    (tmp_path / "scene.toml").write_text(SCENE)
    done = horizonval("render", "scene.toml", "-o", "out.exr")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.exr").exists()
