"""Files of earlier layouts, written by the code of their time, are as good as new ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from horizonval.frame import FRAME_SCHEMA, MAP_UNITS
from horizonval.store import exr
from horizonval.store.store import Store

OLD = Path(__file__).parents[2] / "data" / "archive-v1"
FRAME = "109ee1563c49f2ac38acd017b245c0de39346e469342e608b40d9043cc2a6dc6"
IMAGE = "c502a07baee02b78b5956dc66ba9872d9bf201c350a8d67566b0503f1e82dcff"


@pytest.fixture
def store(tmp_path) -> Store:
    return Store(shutil.copytree(OLD, tmp_path / "old"))


def test_an_archive_of_the_first_schema_reads_verifies_and_lists(store):
    assert [exr.read_header(store.path(a))["schema"] for a in (FRAME, IMAGE)] == [1, 1]
    assert store.verify() == []
    frame, image = store.index.select()
    assert (frame.address, frame.kind, frame.schema, frame.scene) == (FRAME, "frame", 1, "first-light")
    assert (image.address, image.kind, image.seed, image.epoch_utc) == (
        *(IMAGE, "image", str(2**40 + 1)),
        "2026-03-20T12:00:00+00:00",
    )


def test_what_the_first_schema_did_not_know_has_its_defaults(store):
    frame, image = store.read_frame(FRAME), store.read_image(IMAGE)
    for truth in (frame.truth, image.truth):
        assert (truth.schema, truth.moon_cam, truth.moon_visible_fraction) == (1, None, 0.0)
        assert truth.infrared_horizon == {}
        assert truth.altitude_m == 500e3
    assert (image.full_scale, image.dn.shape) == (1023, (48, 64))
    with OpenEXR.File(str(store.path(IMAGE)), separate_channels=True) as file:
        np.testing.assert_array_equal(image.dn, file.channels()["Y"].pixels)
    assert set(frame.maps) == set(MAP_UNITS)


def test_written_again_it_has_the_layout_of_today(store, tmp_path):
    """The truth stays what it was, with its own schema; masks and typed keys are added."""
    old = store.read_frame(FRAME)
    new = Store(tmp_path / "new")
    address = new.add_frame(old)
    assert address != FRAME
    assert exr.read_header(new.path(address))["schema"] == exr.FILE_SCHEMA > FRAME_SCHEMA
    again = new.read_frame(address)
    assert again.truth == old.truth
    np.testing.assert_array_equal(again.radiance["red"], old.radiance["red"])
    header = exr.exr_header.read_header(new.path(address)).attributes
    assert {"horizonval:itrs_to_camera", "worldToNDC"} <= set(header)
    assert b"mask.sunlit" in header["channels"].raw


def test_an_archive_of_the_fourth_schema_reads_as_it_was(tmp_path):
    """Its digital numbers are 32-bit integers, its frame is compressed by ZIP; both keep their addresses."""
    store = Store(shutil.copytree(OLD.with_name("archive-v4"), tmp_path / "old"))
    assert store.verify() == []
    frame_entry, image_entry = sorted(store.index.select(), key=lambda entry: entry.kind)
    assert (frame_entry.schema, image_entry.schema) == (4, 4)
    frame, image = store.read_frame(frame_entry.address), store.read_image(image_entry.address)
    assert (image.dn.dtype, image.full_scale, int(image.dn.sum())) == (np.uint16, 1023, 209628)
    np.testing.assert_array_equal(frame.radiance["red"], (image.dn * 0.01).astype(np.float32))
    new = Store(tmp_path / "new")
    again = new.read_image(new.add_image(image))
    np.testing.assert_array_equal(again.dn, image.dn)
    assert again.truth == image.truth == frame.truth
