"""What headers tell other programs, against astropy and our own geometry."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import EarthLocation
from astropy.time import Time
from astropy.utils.iers import conf
from synthetic import CMOS, truth_at

from horizonval.frame import FrameTruth, Hit
from horizonval.geometry.ellipsoid import WGS84
from horizonval.store import attributes
from horizonval.store.attributes import camera_of, own_attributes, standard_attributes

conf.auto_download = False

CAMERA: dict[str, Any] = {
    "camera": {"name": "off", "width": 80, "height": 60, "fx": 70.0, "fy": 90.0, "cx": 30.25, "cy": 41.5},
    "optics": {"f_number": 4.0, "transmission": 0.64},
    "band": [
        {"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7},
        {"name": "free", "kind": "solar", "wavelength_um": [0.4, 0.45, 0.5], "response": [0.1, 1.0, 0.3]},
    ],
    "detector": CMOS,
}


@pytest.fixture
def truth() -> FrameTruth:
    return truth_at(CAMERA, roll_deg=55.0, yaw_deg=20.0, latitude_deg=-33.0, altitude_km=700.0)


def test_time_and_place_are_astropys(truth: FrameTruth) -> None:
    found, own = standard_attributes(truth, truth.camera_spec), own_attributes(truth, truth.camera_spec)
    place = EarthLocation.from_geocentric(*truth.r_itrs, unit=units.m).to_geodetic("WGS84")
    assert (found["longitude"], found["latitude"]) == pytest.approx((place.lon.deg, place.lat.deg), abs=1e-9)
    assert found["altitude"] == pytest.approx(place.height.to_value(units.m), abs=1e-3)
    assert truth.ellipsoid_a_m == WGS84.a_m
    time = Time("2026-03-20T12:00:00", scale="utc")
    assert own["epoch_tai_mjd"][0] == pytest.approx(time.tai.mjd, abs=1e-9)
    assert (found["capDate"], found["utcOffset"]) == ("2026:03:20 12:00:00", 0.0)
    shifted = dataclasses.replace(truth, epoch_utc="2026-03-20T14:30:00+02:30")
    assert standard_attributes(shifted, truth.camera_spec)["capDate"] == found["capDate"]


def test_an_exposure_replaces_the_cameras_and_a_fisheye_is_no_pinhole(truth: FrameTruth) -> None:
    assert standard_attributes(truth, truth.camera_spec, 1e-3)["expTime"] == 1e-3
    assert own_attributes(truth, truth.camera_spec, 1e-3)["exposure_s"] == 1e-3
    fisheye = truth_at(
        CAMERA | {"camera": {"name": "f", "width": 80, "height": 60, "fov_deg": 120.0, "projection": "fisheye"}}
    )
    wide = standard_attributes(fisheye, fisheye.camera_spec)
    assert "pinholeFocalLength" not in wide
    assert "screenWindowWidth" not in wide
    assert "worldToNDC" not in wide
    assert wide["effectiveFocalLength"] > 0


def test_what_has_no_detector_has_no_sensor(truth: FrameTruth) -> None:
    spec = truth.camera_spec.model_copy(update={"detector": None})
    found = standard_attributes(truth, spec)
    assert not {"expTime", "sensorPhotositePitch", "effectiveFocalLength"} & set(found)
    assert "exposure_s" not in own_attributes(truth, spec)
    assert camera_of(truth, {"camera": spec.model_dump(mode="json")}).detector is None
    assert camera_of(truth, {}) == camera_of(truth) == truth.camera_spec


def test_masks_follow_the_maps(truth: FrameTruth) -> None:
    """A ray through air 30 km up sees the Sun until 5.6 deg below the horizon: acos(R / (R + h)), the sky never."""
    radius = (2 * truth.ellipsoid_a_m + truth.ellipsoid_b_m) / 3
    dip = math.degrees(math.acos(radius / (radius + 30e3)))
    kinds = [Hit.SURFACE, Hit.CLOUD, Hit.ATMOSPHERE, Hit.ATMOSPHERE, Hit.SURFACE, Hit.SPACE, Hit.SUN, Hit.MOON]
    maps = {
        "hit": np.array([kinds], dtype=np.float32),
        "tangent_height": np.array([[-5e4, -1e4, 30e3, 30e3, 30e3, np.inf, 2e5, 3e5]]),
        "solar_zenith": np.array([[89.0, 91.0, 90.0 + dip - 0.1, 90.0 + dip + 0.1, 91.0, 10.0, 10.0, 10.0]]),
    }
    assert attributes.earth_mask(maps).tolist() == [[1, 1, 0, 0, 1, 0, 0, 0]]
    assert attributes.sunlit_mask(maps, truth).tolist() == [[1, 0, 1, 0, 0, 0, 0, 0]]
    assert attributes.saturated_mask(np.array([[0, 1022, 1023, 1024]]), 1023).tolist() == [[0, 0, 1, 1]]


def test_the_ideal_sensors_reading_is_in_the_header(truth: FrameTruth) -> None:
    """By both readings; the boresight's elevation over the plane at the horizon point is its angle from the horizon."""
    own = own_attributes(truth, truth.camera_spec)
    roll, pitch = (own[f"horizon_{axis}_error_deg"][0] for axis in ("roll", "pitch"))
    boresight = math.degrees(math.acos(truth.nadir_geocentric_cam[2]))
    assert pitch == pytest.approx(boresight - math.degrees(truth.angular_radius_rad), abs=1e-9)
    lift = math.sin(math.radians(roll)) * math.cos(math.radians(pitch))
    assert own["horizon_roll_elevation_deg"][0] == pytest.approx(math.degrees(math.asin(lift)), abs=1e-9)
    down = truth_at(CAMERA, pitch_deg=0.0, roll_deg=0.0)
    if abs(down.nadir_geocentric_cam[2]) == 1.0:
        assert "horizon_roll_error_deg" not in own_attributes(down, down.camera_spec)
