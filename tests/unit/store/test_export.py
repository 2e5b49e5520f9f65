"""Exported files, read by libraries that know nothing of us: astropy, OpenCV, OpenImageIO, tifffile, xarray."""

from __future__ import annotations

import json
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import cv2
import imageio.v3
import numpy as np
import OpenImageIO
import pytest
import tifffile
from astropy import units
from astropy.coordinates import GCRS, ITRS, SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.utils.iers import conf
from astropy.wcs import WCS, FITSFixedWarning
from PIL import Image
from synthetic import SOLAR_CAMERA, toy_image, truth_at

from horizonval.core.errors import UserError
from horizonval.frame import DetectorImage, FrameTruth, Hit
from horizonval.geometry import frames
from horizonval.geometry.camera import unproject
from horizonval.store import exr
from horizonval.store.export import CATEGORIES, dataset_of, export_file, masks_of, run_lengths, write_masks
from horizonval.store.fits import fits_bytes
from horizonval.store.store import Store

conf.auto_download = False

CAMERAS: dict[str, dict[str, Any]] = {
    "plain": {"fov_deg": 60.0},
    "off-centre": {"fx": 70.0, "fy": 90.0, "cx": 30.25, "cy": 41.5},
    "distorted": {"fov_deg": 60.0, "distortion": [-0.2, 0.05, 1e-3, -2e-3, 0.01]},
    "fisheye": {"fov_deg": 120.0, "projection": "fisheye", "distortion": [0.01, -0.002, 0.0, 0.0]},
    "unified": {"fov_deg": 90.0, "projection": "unified", "xi": 0.8, "distortion": [-0.02, 0.01]},
}


def blank(geometry: dict[str, Any]) -> DetectorImage:
    truth = truth_at(SOLAR_CAMERA | {"camera": {"name": "some", "width": 80, "height": 60, **geometry}}, roll_deg=66.0)
    dn = np.random.default_rng(2).integers(0, 1024, (60, 80)).astype(np.uint16)
    return DetectorImage(dn, "red", truth, 1023, {"seed": 5, "exposure_s": 0.002})


def opened(data: bytes) -> fits.HDUList:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fits.HDUList.fromstring(data)
        found.verify("exception")
    return found


def test_an_image_as_fits(tmp_path):
    image = toy_image(truth_at(roll_deg=66.0))
    data = fits_bytes(image, "ab" * 32)
    assert fits_bytes(image, "ab" * 32) == data
    first, saturated, text = opened(data)
    assert saturated.name == "MASK.SATURATED"
    np.testing.assert_array_equal(saturated.data, image.dn >= image.full_scale)
    assert Time(first.header["MJD-OBS"], format="mjd", scale="utc").isot == first.header["DATE-OBS"]
    np.testing.assert_array_equal(first.data, image.dn)
    header = first.header
    assert (header["BUNIT"], header["SATURATE"], header["FILTER"]) == ("adu", 1023, "red")
    assert (header["WAVEMIN"], header["WAVEMAX"], header["HVADDR"]) == (0.6, 0.7, "ab" * 32)
    assert units.Unit(header["BUNIT"], format="fits") == units.adu
    assert Time(header["DATE-OBS"], scale=header["TIMESYS"].lower()) == Time("2026-03-20T12:00:00", scale="utc")
    place = [header[f"OBSGEO-{axis}"] for axis in "XYZ"]
    np.testing.assert_array_equal(place, image.truth.r_itrs)
    truth = FrameTruth.from_dict(json.loads(text.data["truth"][0]))
    assert truth == image.truth


def test_a_frame_as_fits(make_frame):
    frame = make_frame({"vis": 3.0, "nir": np.linspace(0, 50, 1200).reshape(30, 40)})
    units_of = opened(fits_bytes(frame))
    assert [u.name for u in units_of] == [
        *("PRIMARY", "RADIANCE.VIS", "RADIANCE.NIR"),
        *("TRUTH.DISTANCE", "TRUTH.TANGENT_HEIGHT", "TRUTH.SOLAR_ZENITH", "TRUTH.HIT"),
        *("MASK.EARTH", "MASK.SUNLIT", "JSON"),
    ]
    np.testing.assert_array_equal(units_of["RADIANCE.NIR"].data, frame.radiance["nir"])
    np.testing.assert_array_equal(units_of["TRUTH.DISTANCE"].data, frame.maps["distance"])
    radiance = units.Unit(units_of["RADIANCE.VIS"].header["BUNIT"], format="fits")
    assert radiance == units.W / units.m**2 / units.sr
    assert units.Unit(units_of["TRUTH.DISTANCE"].header["BUNIT"], format="fits") == units.m


@pytest.mark.parametrize("name", CAMERAS)
def test_a_pixel_has_the_place_in_the_sky_that_astropy_works_out(name):
    """astropy's coordinate system of the file against its own way from Earth-fixed to celestial axes.

    20 arcsec: UT1 is taken as UTC here, which turns the sky by up to 13.5 arcsec, and the pole as fixed, 0.5 arcsec.
    The polynomials of the distortion stay within 0.1 px.
    """
    image = blank(CAMERAS[name])
    header = opened(fits_bytes(image))[0].header
    camera = image.truth.camera_model
    uv = np.stack(np.meshgrid(np.arange(0, 80, 13.0), np.arange(0, 60, 13.0)), axis=-1).reshape(-1, 2)
    itrs = frames.rotate(frames.inverse(image.truth.q_cam_from_itrs), unproject(camera, uv))
    time = Time("2026-03-20T12:00:00", scale="utc")
    expected = SkyCoord(ITRS(*itrs.T, obstime=time)).transform_to(GCRS(obstime=time))
    with warnings.catch_warnings():
        # It tells that it worked out further keywords of time and place.
        warnings.simplefilter("ignore", FITSFixedWarning)
        seen = WCS(header).pixel_to_world(*uv.T)
    apart = SkyCoord(expected.ra, expected.dec).separation(SkyCoord(seen.ra, seen.dec)).arcsec
    pixel_arcsec = np.degrees(1 / max(camera.fx, camera.fy)) * 3600
    assert header["WCSERR"] <= 0.1
    assert apart.max() < 20.0 + header["WCSERR"] * pixel_arcsec
    assert ("SIP" in header["CTYPE1"]) == (name in ("distorted", "fisheye", "unified"))


def test_no_coordinates_are_better_than_wrong_ones():
    header = opened(fits_bytes(blank({"fx": 400.0, "projection": "equal_angle"})))[0].header
    assert "CTYPE1" not in header
    assert header["PROJECTN"] == "equal_angle"


def test_without_astropy_there_is_one_line(monkeypatch, make_image):
    monkeypatch.setitem(sys.modules, "astropy.io", None)
    with pytest.raises(UserError, match="astropy is not installed; run `pip install") as caught:
        fits_bytes(make_image())
    assert "\n" not in str(caught.value)


@pytest.fixture
def out(tmp_path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_an_image_as_png_keeps_every_number(tmp_path, out, make_image):
    image = make_image()
    store = Store(tmp_path / "archive")
    address = store.add_image(image)
    picture, text = export_file(store.path(address), out, ["png"])
    assert picture.name == f"hand-vis-{address[:12]}.png"
    for pixels in _as_others_read_it(picture):
        assert pixels.dtype == np.uint16
        np.testing.assert_array_equal(pixels, image.dn)
    content = json.loads(text.read_text())
    assert (content["address"], content["unit"], content["scale"], content["full_scale"]) == (address, "DN", 1.0, 1023)
    assert FrameTruth.from_dict(content["truth"]) == image.truth


def test_a_frame_as_png_has_its_scale(tmp_path, out, make_frame):
    frame = make_frame({"vis": np.linspace(0, 37.5, 1200).reshape(30, 40), "dark": 0.0})
    exr.write_frame(tmp_path / "a.exr", frame)
    written = export_file(tmp_path / "a.exr", out, ["fits", "png"])
    names = ["a.fits", "a-vis.png", "a-vis.json", "a-dark.png", "a-dark.json"]
    assert [path.name for path in written] == names
    content = json.loads((out / "a-vis.json").read_text())
    pixels = cv2.imread(str(out / "a-vis.png"), cv2.IMREAD_UNCHANGED)
    assert (pixels.max(), content["unit"]) == (65535, "W m-2 sr-1")
    np.testing.assert_allclose(pixels * content["scale"], frame.radiance["vis"], atol=0.51 * content["scale"])
    assert not cv2.imread(str(out / "a-dark.png"), cv2.IMREAD_UNCHANGED).any()


def test_a_frame_as_exr_for_older_programs(tmp_path, out, make_frame):
    """Mitsuba's OpenEXR knows no HTJ2K; what it reads from the exported file is the frame."""
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    frame = make_frame()
    exr.write_frame(tmp_path / "a.exr", frame)
    assert re.search(r"OpenEXR: *NO", cv2.getBuildInformation()), "the docs say that its package reads no EXR"
    with pytest.raises(RuntimeError):
        mitsuba.Bitmap(str(tmp_path / "a.exr"))
    (written,) = export_file(tmp_path / "a.exr", out, zipped=True)
    channels = {name.removeprefix("<root>."): bitmap for name, bitmap in mitsuba.Bitmap(str(written)).split()}
    np.testing.assert_array_equal(np.array(channels["radiance"]).squeeze(), frame.radiance["vis"])
    back = exr.read_frame(written)
    assert back.truth == frame.truth
    with pytest.raises(UserError, match="the same file"):
        export_file(written, out, zipped=True)


def test_what_cannot_be_exported_is_said_in_a_line(tmp_path, out, make_image):
    import OpenEXR

    OpenEXR.File({}, {"Y": np.ones((4, 5), np.float32)}).write(str(tmp_path / "foreign.exr"))
    with pytest.raises(UserError, match="not written by horizonval"):
        export_file(tmp_path / "foreign.exr", out, ["png"])
    exr.write_image(tmp_path / "a.exr", make_image())
    with pytest.raises(UserError, match="no such folder"):
        export_file(tmp_path / "a.exr", tmp_path / "none", ["png"])
    assert list(out.iterdir()) == []


@pytest.fixture
def frame(make_frame):
    """A frame whose lower half is Earth, the left of it sunlit, with air above."""
    made = make_frame({"vis": np.linspace(0.0, 5.0, 1200).reshape(30, 40)})
    hit = np.full((30, 40), Hit.SPACE, np.float32)
    hit[12:15], hit[15:] = Hit.ATMOSPHERE, Hit.SURFACE
    zenith = np.where(np.arange(40) < 25, 30.0, 120.0) * np.ones((30, 1))
    made.maps["hit"], made.maps["solar_zenith"] = hit, zenith.astype(np.float32)
    return made


def _as_others_read_it(path: Path) -> list[np.ndarray]:
    read = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED), imageio.v3.imread(path), np.array(Image.open(path))]
    return read if path.suffix == ".png" else [*read, tifffile.imread(path)]


def test_an_image_as_tiff_and_arrays(tmp_path, make_image):
    image = make_image()
    exr.write_image(tmp_path / "a.exr", image)
    written = export_file(tmp_path / "a.exr", tmp_path, ["tiff", "npz"])
    assert sorted(path.name for path in written) == ["a.npz", "a.tif"]
    read = OpenImageIO.ImageInput.open(str(tmp_path / "a.tif"))
    assert str(read.spec().format) == "uint16"
    np.testing.assert_array_equal(np.asarray(read.read_image("uint16")).squeeze(), image.dn)
    for theirs in _as_others_read_it(tmp_path / "a.tif"):
        assert theirs.dtype == np.uint16
        np.testing.assert_array_equal(theirs, image.dn)
    about = json.loads(Image.open(tmp_path / "a.tif").tag_v2[270])
    assert (about["full_scale"], about["band"]) == (image.full_scale, image.band)
    with np.load(tmp_path / "a.npz") as arrays:
        np.testing.assert_array_equal(arrays["dn"], image.dn)
        assert json.loads(str(arrays["about"])) == about
    before = [path.read_bytes() for path in written]
    assert [path.read_bytes() for path in export_file(tmp_path / "a.exr", tmp_path, ["tiff", "npz"])] == before


def test_a_frame_as_tiff_and_arrays(tmp_path, frame):
    exr.write_frame(tmp_path / "a.exr", frame)
    export_file(tmp_path / "a.exr", tmp_path, ["tiff", "npz"])
    read = OpenImageIO.ImageInput.open(str(tmp_path / "a-vis.tif"))
    np.testing.assert_array_equal(np.asarray(read.read_image("float")).squeeze(), frame.radiance["vis"])
    for theirs in _as_others_read_it(tmp_path / "a-vis.tif"):
        assert theirs.dtype == np.float32
        np.testing.assert_array_equal(theirs, frame.radiance["vis"])
    with np.load(tmp_path / "a.npz") as arrays:
        assert sorted(arrays.files) == ["about", "distance", "hit", "radiance.vis", "solar_zenith", "tangent_height"]
        np.testing.assert_array_equal(arrays["hit"], frame.maps["hit"])


def test_masks_as_coco(tmp_path, frame, make_image):
    exr.write_frame(tmp_path / "a.exr", frame)
    exr.write_image(tmp_path / "b.exr", make_image())
    write_masks(tmp_path / "masks.json", [tmp_path / "a.exr", tmp_path / "b.exr"])
    content = json.loads((tmp_path / "masks.json").read_text())
    (png,) = (path for path in export_file(tmp_path / "a.exr", tmp_path, ["png"]) if path.suffix == ".png")
    assert [image["file_name"] for image in content["images"]] == [png.name]
    by_name = {CATEGORIES[one["category_id"] - 1]: one for one in content["annotations"]}
    assert {name: one["area"] for name, one in by_name.items()} == {"earth": 600, "sunlit_earth": 375, "limb": 120}
    assert by_name["sunlit_earth"]["bbox"] == [0, 15, 25, 15]
    masks = pytest.importorskip("pycocotools.mask", reason="the reader of COCO's masks: pip install pycocotools")
    for name, mask in masks_of(frame).items():
        code = by_name[name]["segmentation"]
        np.testing.assert_array_equal(masks.decode(masks.frPyObjects(code, *code["size"])), mask)
    with pytest.raises(UserError, match="no frame among the files"):
        write_masks(tmp_path / "none.json", [tmp_path / "b.exr"])


@pytest.mark.parametrize("seed", range(4))
def test_run_lengths_say_the_mask(seed):
    mask = np.random.default_rng(seed).random((7, 5)) < 0.5
    mask[0, 0] = seed % 2
    counts = run_lengths(mask)
    said = np.concatenate([np.full(n, k % 2, bool) for k, n in enumerate(counts)])
    np.testing.assert_array_equal(said.reshape(7, 5, order="F"), mask)


def test_labelled_arrays(tmp_path, frame, make_image):
    xarray = pytest.importorskip("xarray", reason="needs the extra `xarray`: pip install 'horizonval[xarray]'")
    made, image = dataset_of(frame), dataset_of(make_image())
    assert isinstance(made, xarray.Dataset)
    assert made.radiance.sel(band="vis", row=29, column=39) == pytest.approx(5.0)
    assert made.where(made.hit == Hit.SURFACE).radiance.count() == 600
    assert made.attrs["epoch_utc"] == frame.truth.epoch_utc
    assert image.dn.dims == ("row", "column")
