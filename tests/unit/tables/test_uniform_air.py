"""Tables of one known air: what the renderer makes of it, and what a fit that leans on it reaches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.api.estimate import mission_table
from horizonval.core.errors import UserError
from horizonval.core.progress import Silent
from horizonval.earth.surface import surface_temperature
from horizonval.estimation.fit.templates import shipped_templates
from horizonval.spec.camera import Band
from horizonval.tables.uniform_air import UniformAir, ground_around_k, sunlit_in, thermal_in


@pytest.mark.parametrize(
    ("name", "says"),
    [("weather", "varies"), ("by_latitude_month", "varies"), ("nowhere", "unknown"), ("nothing.csv", "nothing.csv")],
)
def test_an_air_that_is_none_or_varies_is_refused(name: str, says: str) -> None:
    with pytest.raises(UserError, match=says) as e:
        mission_table("limb-night-ir", None, 0.005, name)
    assert "--air" in str(e.value)


def test_clear_needs_an_air() -> None:
    with pytest.raises(UserError, match="--air"):
        mission_table("limb-night-ir", None, 0.005, clear=True)


def test_a_profile_file_is_an_air(tmp_path) -> None:
    path = tmp_path / "air.csv"
    z = np.arange(0.0, 101.0, 5.0)
    temperature = np.interp(z, [0.0, 11.0, 20.0, 48.0, 86.0, 100.0], [288.0, 217.0, 217.0, 271.0, 187.0, 195.0])
    rows = [f"{h:g},{t:.2f},{1013.25 * np.exp(-h / 7.0):.4g},1" for h, t in zip(z, temperature, strict=True)]
    path.write_text("\n".join(["altitude_km,temperature_K,pressure_hPa,ozone_ppmv", *rows]))
    gases = UniformAir.named(str(path)).gases()
    assert np.interp(20e3, gases.altitude_m, gases.temperature_k[0]) == pytest.approx(217.0, abs=0.5)


@pytest.mark.parametrize("month", [1.5, 7.5])
def test_ground_round_a_circle_is_that_of_its_places(month: float) -> None:
    """Hardly any land lies at 56.5 deg south, and no sea ice; the pole is ice, at one height."""
    sea, _ = ground_around_k(-56.5, month)
    assert sea == pytest.approx(float(surface_temperature.sea_k(np.array([-56.5]), month)[0]), abs=0.1)
    pole, scatter = ground_around_k(-89.9, month)
    assert scatter < 3.0
    # Amundsen-Scott, monthly means of many years: -28 C in January, -60 C in July.
    assert pole == pytest.approx({1.5: 245.0, 7.5: 213.0}[month], abs=6.0)
    assert ground_around_k(-75.0, month)[1] > 10.0


FINER = 4
AXES_M = np.array([6378137.0, 6378137.0, 6356752.314245])


def test_a_frame_of_that_air_has_the_brightness_of_its_table() -> None:
    """8 to 14 um of the tropical air without clouds, 600 km, 6 km a pixel, pixel by pixel above the ground.

    Two ways of the renderer to the same light: rays through one column along a parallel, and a frame. The lines of
    sight are worked out here. Below the ground the frame's stands warmer than the climate's.
    """
    month, latitude, band = 4.5, 8.0, Band(name="lwir", kind="thermal", lo_um=8.0, hi_um=14.0)
    table = thermal_in(UniformAir({"profile": "tropical"}, clear=True), band, np.array([4.0, 5.0]), Silent())
    width, height, focal = 64, 40, 400.0
    camera = hv.Camera.from_file("ir-four-band-320-92deg").changed(
        camera={"width": width, "height": height, "fov_deg": None, "fx": focal, "fy": focal}
    )
    scene = hv.Scene(
        camera=camera, altitude_km=600, latitude_deg=latitude, epoch_utc="2026-04-30T12:00Z", mount_roll_deg=66,
        atmosphere={"profile": "tropical"}, render={"subsamples": FINER, "nodes": 128},
    )  # fmt: skip
    frame = hv.render(scene, progress=False)
    truth = frame.truth
    u, v = ((np.arange(n * FINER) + 0.5) / FINER - 0.5 for n in (width, height))
    x, y = np.meshgrid((u - 0.5 * (width - 1)) / focal, (v - 0.5 * (height - 1)) / focal)
    los = np.stack([x, y, np.ones_like(x)], axis=-1)
    los /= np.linalg.norm(los, axis=-1, keepdims=True)
    turn = Rotation.from_quat(truth.q_cam_from_itrs).as_matrix()
    e, p = los @ turn / AXES_M, np.array(truth.r_itrs) / AXES_M
    q = p - ((e @ p) / (e * e).sum(axis=-1))[..., None] * e
    distance = np.linalg.norm(q, axis=-1)
    above = (distance - 1.0) / np.linalg.norm(q / distance[..., None] / AXES_M, axis=-1)
    mean = table.at(np.radians(latitude), month)[0][0]
    expected = np.interp(above, table.height_m, mean, right=0.0).reshape(height, FINER, width, FINER).mean(axis=(1, 3))
    lowest = above.reshape(height, FINER, width, FINER).min(axis=(1, 3))
    found = frame.radiance["lwir"] / 6.0
    there = lowest > 4e3
    assert np.count_nonzero(there & (lowest < 40e3)) > 200
    off = (found - expected)[there] / mean.max()
    # the table's heights are a kilometre apart, on a profile that falls by an e-th in five: 0.5 % of it between them
    assert np.abs(off).max() < 4e-3
    assert abs(off[lowest[there] < 40e3].mean()) < 1e-3


@pytest.mark.slow
def test_the_air_of_the_shipped_tables_base_leaves_them_as_they_are() -> None:
    band = Band(name="red", kind="solar", lo_um=0.6, hi_um=0.7, nodes=1)
    whole = shipped_templates("solar", (0.6, 0.7))
    assert whole is not None
    same = sunlit_in(UniformAir({"profile": "us_standard"}), band, whole, Silent())
    zenith, azimuth = (axis.ravel() for axis in np.meshgrid(*same.axes, indexing="ij"))
    np.testing.assert_allclose(same.mean.reshape(len(zenith), -1), whole.at(zenith, azimuth)[0], rtol=1e-6)
    assert "air" not in same.mode_kinds
    assert set(same.mode_kinds) == set(whole.mode_kinds) - {"air"}
    clear = sunlit_in(UniformAir({"profile": "tropical"}, clear=True), band, whole, Silent())
    assert set(clear.mode_kinds) == {"haze", "ground"}
    assert (clear.left_sigma == 0.0).all()
