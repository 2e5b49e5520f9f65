"""TIFF, NumPy, COCO and xarray: what other libraries read of what we write."""

from __future__ import annotations

import json

import numpy as np
import OpenImageIO
import pytest
import tifffile
from PIL import Image

from horizonval.core.errors import UserError
from horizonval.frame import Hit
from horizonval.store import exr
from horizonval.store.export import CATEGORIES, dataset_of, export_file, masks_of, run_lengths, write_masks


@pytest.fixture
def frame(make_frame):
    """A frame whose lower half is Earth, the left of it sunlit, with air above."""
    made = make_frame({"vis": np.linspace(0.0, 5.0, 1200).reshape(30, 40)})
    hit = np.full((30, 40), Hit.SPACE, np.float32)
    hit[12:15], hit[15:] = Hit.ATMOSPHERE, Hit.SURFACE
    zenith = np.where(np.arange(40) < 25, 30.0, 120.0) * np.ones((30, 1))
    made.maps["hit"], made.maps["solar_zenith"] = hit, zenith.astype(np.float32)
    return made


def test_an_image_as_tiff_and_arrays(tmp_path, make_image):
    image = make_image()
    exr.write_image(tmp_path / "a.exr", image)
    written = export_file(tmp_path / "a.exr", tmp_path, ["tiff", "npz"])
    assert sorted(path.name for path in written) == ["a.npz", "a.tif"]
    read = OpenImageIO.ImageInput.open(str(tmp_path / "a.tif"))
    assert str(read.spec().format) == "uint16"
    np.testing.assert_array_equal(np.asarray(read.read_image("uint16")).squeeze(), image.dn)
    theirs = tifffile.imread(tmp_path / "a.tif")
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
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a-vis.tif"), frame.radiance["vis"])
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
