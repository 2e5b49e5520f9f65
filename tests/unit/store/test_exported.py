"""Exported files are as good as what they were made of, and nothing else is taken for them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from astropy.io import fits
from synthetic import toy_image, truth_at

from horizonval.core.errors import UserError
from horizonval.store import exr
from horizonval.store.export import export_file
from horizonval.store.picture import read_picture


@pytest.fixture
def image_path(tmp_path) -> Path:
    exr.write_image(tmp_path / "image.exr", toy_image(truth_at(roll_deg=66.0)))
    return tmp_path / "image.exr"


@pytest.fixture
def exported(image_path, tmp_path) -> Path:
    (tmp_path / "out").mkdir()
    export_file(image_path, tmp_path / "out", ["fits", "png"], zipped=True)
    return tmp_path / "out"


@pytest.mark.parametrize("suffix", [".png", ".fits", ".exr"])
def test_what_is_read_back_is_the_whole_image(image_path, exported, suffix):
    image = exr.read_image(image_path)
    source = read_picture(exported / f"image{suffix}").source
    np.testing.assert_array_equal(source.dn, image.dn)
    assert source.dn.dtype == np.uint16
    assert source.truth == image.truth
    assert (source.band, source.full_scale, source.observation) == (image.band, image.full_scale, image.observation)


def test_a_frame_is_read_back(tmp_path, make_frame, caplog):
    """From FITS every bit; from PNG one band to 16 bits."""
    frame = make_frame({"vis": np.linspace(0, 37.5, 1200).reshape(30, 40), "Red": 1.0})
    exr.write_frame(tmp_path / "a.exr", frame)
    export_file(tmp_path / "a.exr", tmp_path, ["fits", "png"])
    for name in ("a.fits", "a.exr"):
        sources = [read_picture(tmp_path / name, part=part).source for part in (None, "Red")]
        assert [list(source.radiance) for source in sources] == [["vis"], ["Red"]]
        assert "of the bands vis, Red the first is used; --part takes another" in caplog.messages.pop()
        assert all((source.truth, source.render) == (frame.truth, frame.render) for source in sources)
        read = sources[0].radiance | sources[1].radiance | sources[0].maps
        for map_name, values in (frame.radiance | frame.maps).items():
            assert read[map_name].tobytes() == values.tobytes(), map_name
    rough = read_picture(tmp_path / "a-vis.png").source
    assert rough.truth == frame.truth
    np.testing.assert_allclose(rough.radiance["vis"], frame.radiance["vis"], atol=37.5 / 65535)


def test_changed_pixels_or_truth_are_said(exported):
    picture, beside = exported / "image.png", exported / "image.json"
    good = beside.read_bytes()
    content = json.loads(good)
    for change in ({"truth": content["truth"] | {"altitude_m": 1.0}}, {"full_scale": 4095}, {"sha256": "0" * 64}):
        beside.write_text(json.dumps(content | change))
        with pytest.raises(UserError, match="changed since they were exported"):
            read_picture(picture)
    beside.write_bytes(good[:-20])
    with pytest.raises(UserError, match="cannot be read as JSON"):
        read_picture(picture)
    beside.write_bytes(good)
    pixels = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(picture), pixels + 1)
    with pytest.raises(UserError, match="changed since they were exported"):
        read_picture(picture)
    with fits.open(exported / "image.fits", mode="update") as units:
        units[0].data[3, 4] += 1
    with pytest.raises(UserError, match="changed since they were exported"):
        read_picture(exported / "image.fits")


@pytest.mark.parametrize("text", ["[1]", "no json", '{"truth": 3}', ""])
def test_a_json_file_that_is_none_of_ours_says_nothing(exported, text):
    (exported / "image.json").write_text(text)
    assert read_picture(exported / "image.png").source is None


def test_a_foreign_fits_image_is_the_right_way_up(tmp_path):
    """Without a word about it the first row is the lower one, as every viewer of FITS draws it."""
    values = np.arange(12, dtype=np.int16).reshape(3, 4)
    fits.PrimaryHDU(values).writeto(tmp_path / "up.fits")
    unit = fits.PrimaryHDU(values.astype(np.float32))
    unit.header["ROWORDER"], unit.header["SATURATE"] = "TOP-DOWN", 4095
    unit.writeto(tmp_path / "down.fits")
    up, down = read_picture(tmp_path / "up.fits"), read_picture(tmp_path / "down.fits")
    np.testing.assert_array_equal(up.grey, values[::-1])
    np.testing.assert_array_equal(down.grey, values)
    assert (up.full_scale, down.full_scale, up.source) == (32767.0, 4095.0, None)
    fits.PrimaryHDU().writeto(tmp_path / "empty.fits")
    with pytest.raises(UserError, match="holds no image"):
        read_picture(tmp_path / "empty.fits")


@pytest.mark.parametrize("name", ["image.json", "image.fits"])
def test_damage_is_a_line(exported, name):
    """Flips and truncations: refused in a line, or what they say of nothing that is read (padding, a comment)."""
    image = read_picture(exported / "image.png").source
    good = (exported / name).read_bytes()
    picture = exported / ("image.png" if name.endswith("json") else name)
    rng = np.random.default_rng(3)
    refused = asked = 0
    header = 2880 * 3
    for number in range(60):
        bad = bytearray(good)
        position = int(rng.integers(header if number % 2 and name.endswith("fits") else len(good)))
        bad[position] ^= 1 << int(rng.integers(8))
        (exported / name).write_bytes(bad[:position] if number % 5 == 0 else bad)
        asked += 1
        try:
            source = read_picture(picture).source
        except UserError as error:
            refused += len(str(error).splitlines())
            continue
        assert source is None or (source.truth == image.truth and np.array_equal(source.dn, image.dn))
    assert 20 < refused <= asked == 60
