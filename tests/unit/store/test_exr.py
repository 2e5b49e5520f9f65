"""The EXR gate: exact round trips, and one clear line for every kind of damage."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.files import UnreadableFileError
from horizonval.frame import FRAME_SCHEMA, FrameTruth, RadianceFrame
from horizonval.store import exr
from horizonval.store.fits import fits_bytes, read_own


@pytest.fixture
def stored(tmp_path, make_frame) -> Path:
    path = tmp_path / "frame.exr"
    exr.write_frame(path, make_frame())
    return path


def refuses(path: Path, capfd, expected: str = ".") -> str:
    """Check that reading fails with one line that names the file, and that nothing else reaches the terminal."""
    with pytest.raises(DamagedFileError, match=expected) as caught:
        exr.read_frame(path)
    line = str(caught.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    assert capfd.readouterr() == ("", "")
    return line


def rewrite(path: Path, *, drop: str | None = None, **changes) -> None:
    """Write the file again through the library, as a stranger would, with header keys dropped or changed."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = {k: v for k, v in file.header().items() if k != drop} | changes
        OpenEXR.File(header, {k: v.pixels for k, v in file.channels().items()}).write(str(path))


def reseal(path: Path, channels: dict[str, np.ndarray], **changes) -> None:
    """Write a file whose digests are right but whose content is not, as a defect of our own writer would."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        own = {k.removeprefix("horizonval:"): v for k, v in file.header().items() if k.startswith("horizonval:")}
        pixels = {k: v.pixels for k, v in file.channels().items()} | channels
    own = {k: v for k, v in own.items() if isinstance(v, int | str) and k not in ("sha256", "body", "seal")}
    exr._write_sealed(path, pixels, own | changes, {})


def test_frame_survives_bit_by_bit(tmp_path, make_frame):
    frame = make_frame({"vis": np.random.default_rng(1).normal(0, 1e3, (30, 40)), "B": 1e-30, "G": 6e6, "R": 0.0})
    exr.write_frame(tmp_path / "a.exr", frame)
    back = exr.read_frame(tmp_path / "a.exr")
    assert list(back.radiance) == ["vis", "B", "G", "R"]
    for name, values in (frame.radiance | frame.maps).items():
        other = (back.radiance | back.maps)[name]
        assert other.dtype == np.float32
        assert other.flags.c_contiguous
        assert other.tobytes() == values.tobytes()
    assert np.isinf(back.maps["distance"]).any()
    assert back.truth == frame.truth
    assert back.render == frame.render


@pytest.mark.parametrize("value", [0.1, 1 / 3, np.nextafter(1.0, 2.0), 5e-324, 1.7976931348623157e308, -0.0])
def test_truth_keeps_every_bit_of_a_float(tmp_path, make_frame, value):
    exr.write_frame(tmp_path / "a.exr", make_frame(altitude_m=float(value)))
    assert exr.read_frame(tmp_path / "a.exr").truth.altitude_m.hex() == float(value).hex()


def test_large_integers_survive(tmp_path, make_frame):
    frame = make_frame()
    frame = replace(frame, render={"seed": 2**63 + 1}, truth=replace(frame.truth, scene={"seed": 2**40}))
    exr.write_frame(tmp_path / "a.exr", frame)
    back = exr.read_frame(tmp_path / "a.exr")
    assert back.render["seed"] == 2**63 + 1
    assert back.truth.scene["seed"] == 2**40


def test_header_integers_beyond_32_bits_are_refused(tmp_path, make_image):
    """The library would store 0 without a word."""
    with pytest.raises(ValueError, match="32-bit"):
        exr.write_image(tmp_path / "a.exr", replace(make_image(), full_scale=2**31))


@pytest.mark.parametrize("view", ["fortran", "flipped", "strided", "float64"])
def test_memory_layout_does_not_matter(tmp_path, make_frame, view):
    frame = make_frame()
    values = frame.radiance["vis"]
    exr.write_frame(tmp_path / "plain.exr", frame)
    other = {
        "fortran": np.asfortranarray(values),
        "flipped": values[::-1, ::-1].copy()[::-1, ::-1],
        "strided": np.repeat(values, 3, axis=1)[:, ::3],
        "float64": values.astype(np.float64),
    }[view]
    exr.write_frame(tmp_path / "view.exr", replace(frame, radiance={"vis": other}))
    assert (tmp_path / "view.exr").read_bytes() == (tmp_path / "plain.exr").read_bytes()


def test_equal_content_gives_equal_bytes(tmp_path, make_frame):
    frame = make_frame()
    exr.write_frame(tmp_path / "a.exr", frame)
    shuffled = replace(
        frame,
        maps=dict(reversed(frame.maps.items())),
        truth=replace(frame.truth, scene=dict(reversed(frame.truth.scene.items()))),
    )
    exr.write_frame(tmp_path / "b.exr", shuffled)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_header_is_read_without_pixels(stored, make_frame):
    header = exr.read_header(stored)
    assert FrameTruth.from_dict(header["truth"]) == make_frame().truth
    assert (header["kind"], header["bands"], header["width"], header["height"]) == ("frame", ["vis"], 40, 30)
    data = bytearray(stored.read_bytes())
    data[-5] ^= 1
    stored.write_bytes(data)
    assert exr.read_header(stored) == header


def test_kinds_are_told_apart(tmp_path, stored, make_image):
    exr.write_image(tmp_path / "image.exr", make_image())
    OpenEXR.File({}, {"Y": np.ones((4, 5), np.float32)}).write(str(tmp_path / "foreign.exr"))
    assert [exr.kind(tmp_path / f"{name}.exr") for name in ("frame", "image", "foreign")] == [
        "frame",
        "image",
        "foreign",
    ]
    with pytest.raises(UserError, match="holds a detector image; expected a frame"):
        exr.read_frame(tmp_path / "image.exr")
    with pytest.raises(UserError, match="holds a frame"):
        exr.read_image(stored)
    with pytest.raises(DamagedFileError, match="not written by horizonval"):
        exr.read_frame(tmp_path / "foreign.exr")


def test_every_flipped_byte_is_noticed(stored, capfd):
    good = stored.read_bytes()
    rng = np.random.default_rng(20260320)
    ends = [*range(24), len(good) - 1]
    for position in [*ends, *rng.integers(0, len(good), 300).tolist()]:
        bad = bytearray(good)
        bad[position] ^= 1 << int(rng.integers(8))
        stored.write_bytes(bad)
        refuses(stored, capfd)
    stored.write_bytes(good)
    exr.read_frame(stored)


def test_every_flipped_header_byte_is_noticed_without_the_pixels(stored):
    good = stored.read_bytes()
    end = len(exr.exr_header.read_header(stored).data)
    for position in range(0, end, 7):
        bad = bytearray(good)
        bad[position] ^= 0x20
        stored.write_bytes(bad)
        with pytest.raises(DamagedFileError):
            exr.read_header(stored)


def test_truncation_and_foreign_bytes_are_noticed_everywhere(stored, capfd):
    good = stored.read_bytes()
    for size in [*range(0, 40), *np.linspace(40, len(good) - 1, 60).astype(int).tolist()]:
        stored.write_bytes(good[:size])
        line = refuses(stored, capfd)
        assert "truncated" in line or size < 8, line
    stored.write_bytes(good + b"\0")
    refuses(stored, capfd, "1 foreign bytes")


KEYS = ["schema", "kind", "bands", "truth", "render", "sha256", "body", "seal"]


@pytest.mark.parametrize("key", KEYS)
def test_a_missing_header_key_is_named(stored, capfd, key):
    rewrite(stored, drop=f"horizonval:{key}")
    refuses(stored, capfd, f"no header key 'horizonval:{key}'")


def test_a_stranger_cannot_change_the_truth_nor_the_schema(stored, capfd):
    with OpenEXR.File(str(stored)) as file:
        truth = file.header()["horizonval:truth"]
    assert '"altitude_m":500000.0' in truth
    rewrite(stored, **{"horizonval:truth": truth.replace('"altitude_m":500000.0', '"altitude_m":510000.0')})
    refuses(stored, capfd, "seal")
    rewrite(stored, **{"horizonval:schema": 99})
    refuses(stored, capfd, "schema 99; expected schema 1 or 2 or 3 or 4 or 5")


@pytest.mark.parametrize(("schema", "unknown"), [(1, ("moon_", "infrared_")), (2, ("infrared_",))])
def test_files_from_before_the_moon_and_the_infrared_horizon_still_read(
    tmp_path, make_frame, monkeypatch, schema, unknown
):
    """The truth comes back without what its schema did not know, and keeps its schema."""
    frame = make_frame(schema=schema)
    sound = FrameTruth.to_dict

    def old(truth):
        return {key: value for key, value in sound(truth).items() if not key.startswith(unknown)}

    monkeypatch.setattr(FrameTruth, "to_dict", old)
    monkeypatch.setattr(exr, "FILE_SCHEMA", schema)
    exr.write_frame(tmp_path / "old.exr", frame)
    monkeypatch.undo()
    assert exr.read_header(tmp_path / "old.exr")["schema"] == schema
    again = exr.read_frame(tmp_path / "old.exr")
    assert again.truth == frame.truth
    assert (again.truth.schema, again.truth.infrared_horizon) == (schema, {})
    assert (again.truth.moon_itrs, again.truth.moon_visible_fraction) == (None, 0.0) or schema > 1
    assert np.array_equal(again.radiance["vis"], frame.radiance["vis"])


INFRARED = {
    "co2": {
        "kind": "opaque",
        "azimuth_deg": [0.0, 180.0],
        "plateau_radiance": [5.54255, 4.52685],
        "half_plateau_height_m": [41218.2, 38002.4],
        "half_plateau_angle_rad": [1.190123456789, 1.19],
        "maximum_gradient_height_m": [38291.0, 33808.7],
        "accuracy": {"plateau": 0.04, "note": None},
    }
}


def test_the_infrared_horizon_survives(tmp_path, make_frame):
    frame = make_frame(infrared_horizon=INFRARED)
    exr.write_frame(tmp_path / "a.exr", frame)
    again = exr.read_frame(tmp_path / "a.exr").truth
    assert again == frame.truth
    assert again.infrared_horizon == INFRARED
    assert again.schema == FRAME_SCHEMA


def test_pixels_are_checked_against_what_entered_the_library(stored, capfd, monkeypatch):
    """As if the library had scrambled the array on the way: all seals are right."""
    sound = exr.content_digest
    monkeypatch.setattr(exr, "content_digest", lambda channels, own: sound(channels, own)[::-1])
    reseal(stored, {})
    monkeypatch.undo()
    refuses(stored, capfd, "do not match their sha256")


def test_nan_radiance_is_refused_both_ways(tmp_path, stored, make_frame, capfd):
    values = make_frame().radiance["vis"]
    values[3, 4] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        exr.write_frame(tmp_path / "b.exr", make_frame(values))
    assert [p.name for p in tmp_path.iterdir()] == ["frame.exr"]
    reseal(stored, {"radiance.vis": values})
    refuses(stored, capfd, "radiance of band 'vis' is not finite in 1 pixels")


@pytest.mark.parametrize("value", [0.5, -1.0, 1024.0, np.nan, np.inf])
def test_digital_numbers_that_are_none_are_refused(tmp_path, make_image, value):
    """As a defect of our own writer would leave them: floating point can hold more than digital numbers."""
    image = make_image()
    exr.write_image(tmp_path / "a.exr", image)
    dn = image.dn.astype(np.float16)
    dn[3, 4] = value
    reseal(tmp_path / "a.exr", {"dn.vis": dn})
    with pytest.raises(DamagedFileError, match=r"digital numbers outside 0\.\.1023"):
        exr.read_image(tmp_path / "a.exr")


def test_incomplete_truth_is_named(stored, capfd, make_frame):
    truth = make_frame().truth.to_dict()
    del truth["nadir_geocentric_cam"]
    reseal(stored, {}, truth=exr._dumps(truth))
    refuses(stored, capfd, "the truth has no 'nadir_geocentric_cam'")
    reseal(stored, {}, truth="[1, 2]")
    refuses(stored, capfd, "truth. is no JSON object")
    reseal(stored, {}, truth="{")
    refuses(stored, capfd, "no JSON")


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", "empty"), (b"v/1\x01", "truncated"), (b"\0" * 99, "not an"), (b"\x89PNG\r\n\x1a\n", "a PNG")],
)
def test_other_files_are_refused(tmp_path, capfd, content, expected):
    path = tmp_path / "a.exr"
    path.write_bytes(content)
    refuses(path, capfd, expected)


def test_missing_files_and_folders_are_user_errors(tmp_path, make_frame):
    with pytest.raises(UserError, match="no such file"):
        exr.read_frame(tmp_path / "none.exr")
    with pytest.raises(UserError, match="is a folder"):
        exr.read_header(tmp_path)
    with pytest.raises(UserError, match="create it first"):
        exr.write_frame(tmp_path / "none" / "a.exr", make_frame())
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file; expected a folder"):
        exr.write_frame(tmp_path / "file" / "a.exr", make_frame())


def test_written_files_have_ordinary_permissions(stored):
    mask = os.umask(0)
    os.umask(mask)
    assert stored.stat().st_mode & 0o777 == 0o666 & ~mask


def test_frames_that_are_none_are_not_written(tmp_path, make_frame):
    frame = make_frame()
    path = tmp_path / "a.exr"
    for bad, expected in [
        (replace(frame, radiance={}), "at least one band"),
        (replace(frame, radiance={"vis": np.zeros((2, 3), np.float32)}), "shape"),
        (replace(frame, radiance={"vis": np.full((30, 40), 1e39)}), "too large"),
        (replace(frame, radiance={"a.b": frame.radiance["vis"]}), "band name"),
        (replace(frame, maps={}), "truth maps missing"),
        (replace(frame, energy_radiance={"vis": np.full((30, 40), np.nan, np.float32)}), "not finite"),
        (replace(frame, truth=replace(frame.truth, altitude_m=float("nan"))), "JSON"),
    ]:
        with pytest.raises(ValueError, match=expected):
            exr.write_frame(path, bad)
        assert not path.exists()


TWO_KINDS = {
    "camera": {"name": "both", "width": 12, "height": 8, "fov_deg": 60.0},
    "band": [
        {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.7},
        {"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0},
    ],
}


@pytest.fixture
def both_kinds(make_frame) -> RadianceFrame:
    made = make_frame({"vis": 3.0, "lwir": 20.0}, TWO_KINDS)
    energy = np.linspace(2.5, 3.5, 96, dtype=np.float32).reshape(8, 12)
    return replace(made, energy_radiance={"vis": energy, "lwir": made.radiance["lwir"]})


def assert_same_energy(read: RadianceFrame, frame: RadianceFrame) -> None:
    assert list(read.energy_radiance) == ["vis", "lwir"]
    np.testing.assert_array_equal(read.energy_radiance["vis"], frame.energy_radiance["vis"])
    assert read.energy_radiance["lwir"] is read.radiance["lwir"]


def test_energy_has_a_channel_and_a_unit_of_its_own(tmp_path, both_kinds):
    exr.write_frame(tmp_path / "a.exr", both_kinds)
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
    assert_same_energy(exr.read_frame(tmp_path / "a.exr"), both_kinds)


def test_a_frame_without_it_still_reads_and_fits_keeps_it(tmp_path, both_kinds):
    exr.write_frame(tmp_path / "a.exr", replace(both_kinds, energy_radiance={}))
    read = exr.read_frame(tmp_path / "a.exr")
    assert list(read.energy_radiance) == ["lwir"]
    assert list(read.radiance) == ["vis", "lwir"]
    (tmp_path / "a.fits").write_bytes(fits_bytes(both_kinds, ""))
    source = read_own(tmp_path / "a.fits")
    assert isinstance(source, RadianceFrame)
    assert_same_energy(source, both_kinds)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_a_path_that_is_not_utf8_is_named_as_the_cause(tmp_path, make_frame):
    exr.write_frame(tmp_path / "a.exr", make_frame())
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/n\xff"))
    folder.mkdir()
    (tmp_path / "a.exr").rename(folder / "a.exr")
    with pytest.raises(UnreadableFileError, match="its path is not UTF-8"):
        exr.read_frame(folder / "a.exr")
