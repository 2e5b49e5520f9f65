"""The energy radiance of solar bands through the files, beside the radiance that counts photons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.frame import RadianceFrame
from horizonval.store import exr
from horizonval.store.fits import fits_bytes, read_fits

TWO_KINDS = {
    "camera": {"name": "both", "width": 12, "height": 8, "fov_deg": 60.0},
    "band": [
        {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.7},
        {"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0},
    ],
}


@pytest.fixture
def frame(make_frame) -> RadianceFrame:
    made = make_frame({"vis": 3.0, "lwir": 20.0}, TWO_KINDS)
    energy = np.linspace(2.5, 3.5, 96, dtype=np.float32).reshape(8, 12)
    return replace(made, energy_radiance={"vis": energy, "lwir": made.radiance["lwir"]})


def assert_same_energy(read: RadianceFrame, frame: RadianceFrame) -> None:
    assert list(read.energy_radiance) == ["vis", "lwir"]
    np.testing.assert_array_equal(read.energy_radiance["vis"], frame.energy_radiance["vis"])
    assert read.energy_radiance["lwir"] is read.radiance["lwir"]


def test_energy_has_a_channel_and_a_unit_of_its_own(tmp_path, frame):
    import OpenEXR

    exr.write_frame(tmp_path / "a.exr", frame)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        header, channels = dict(file.header()), set(file.channels())
    assert {name for name in channels if "radiance" in name} == {
        "radiance.vis",
        "radiance.lwir",
        "energy_radiance.vis",
    }
    assert header["horizonval:unit.energy_radiance.vis"] == "W m-2 sr-1"
    assert header["horizonval:unit.radiance.lwir"] == "W m-2 sr-1"
    assert header["horizonval:unit.radiance.vis"] == "W m-2 sr-1 of as many photons of 0.6000 um"
    assert header["horizonval:unit.Y"] == header["horizonval:unit.radiance.vis"]
    assert_same_energy(exr.read_frame(tmp_path / "a.exr"), frame)


def test_a_frame_without_it_still_reads(tmp_path, frame):
    exr.write_frame(tmp_path / "a.exr", replace(frame, energy_radiance={}))
    read = exr.read_frame(tmp_path / "a.exr")
    assert list(read.energy_radiance) == ["lwir"]
    assert list(read.radiance) == ["vis", "lwir"]


def test_it_must_be_finite(tmp_path, frame):
    with pytest.raises(ValueError, match="not finite"):
        exr.write_frame(
            tmp_path / "a.exr", replace(frame, energy_radiance={"vis": np.full((8, 12), np.nan, np.float32)})
        )


def test_fits_keeps_it(tmp_path, frame):
    (tmp_path / "a.fits").write_bytes(fits_bytes(frame, ""))
    source = read_fits(tmp_path / "a.fits")[2]
    assert isinstance(source, RadianceFrame)
    assert_same_energy(source, frame)
