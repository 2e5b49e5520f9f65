"""Pictures of other programs: the right grey levels or one line, whatever the layout."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import OpenImageIO as oiio  # noqa: N813
import pytest
import tifffile
from astropy.io import fits
from PIL import Image, ImageOps

from horizonval.api.camera import Camera
from horizonval.api.estimate import estimate
from horizonval.core.errors import UserError
from horizonval.spec.camera import CameraSpec
from horizonval.store.picture import read_picture
from horizonval.store.readers.part import turned

RNG = np.random.default_rng(5)
A8 = RNG.integers(0, 256, (12, 20), np.uint8)
A12 = RNG.integers(0, 4096, (12, 20), np.uint16)
A16 = RNG.integers(0, 65536, (12, 20), np.uint16)
F32 = RNG.normal(size=(12, 20)).astype(np.float32)
RGB16 = RNG.integers(0, 65536, (12, 20, 3), np.uint16)
PLANES = np.moveaxis(RGB16, -1, 0)
OPAQUE = np.full((12, 20), 65535, np.uint16)
PALETTE = RNG.integers(0, 256, (3, 256), np.uint16)


GREY = {"photometric": "minisblack"}


def camera(width: int, height: int) -> CameraSpec:
    return CameraSpec.model_validate({"camera": {"width": width, "height": height, "fov_deg": 60.0}})


def grey(path: Path, **options: Any) -> np.ndarray[Any, Any]:
    return read_picture(path, **options).grey


def by_oiio(path: Path, values: np.ndarray[Any, Any], kind: str, **attributes: Any) -> None:
    """Write with OpenImageIO, which packs samples of any number of bits."""
    values = values.reshape(*values.shape[:2], -1)
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("_", ":"), value)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec), out.geterror()
    assert out.write_image(np.ascontiguousarray(values))
    out.close()


TIFFS: dict[str, tuple[Any, dict[str, Any], np.ndarray[Any, Any], float | None]] = {
    "grey and opacity": (np.stack([A16, OPAQUE], -1), {"extrasamples": ["unassalpha"]}, A16, 65535),
    "planes apart": (PLANES, {"planarconfig": "separate", "photometric": "rgb"}, RGB16.mean(-1), 65535),
    "white is 0, 8 bit": (A8, {"photometric": "miniswhite"}, 255 - A8, 255),
    "white is 0, 16 bit": (A16, {"photometric": "miniswhite"}, 65535 - A16, 65535),
    "palette": (A8, {"photometric": "palette", "colormap": PALETTE * 257}, PALETTE[:, A8].mean(0), 255),
    "fine palette": (A8, {"photometric": "palette", "colormap": PALETTE * 99}, (PALETTE * 99)[:, A8].mean(0), 65535),
    "float16": (F32.astype(np.float16), {}, F32.astype(np.float16), None),
    "float64": (F32.astype(float), {}, F32, None),
    "float, predictor": (F32, {"compression": "zlib", "predictor": 3}, F32, None),
    "signed": (A16.astype(np.int16), {}, A16.astype(np.int16), 32767),
    "32 bit": (A16.astype(np.uint32) * 9, {}, A16 * 9.0, None),
    "1 bit": (A8 > 99, {}, 255.0 * (A8 > 99), 255),
    "tiles": (RGB16, {"tile": (16, 16), "photometric": "rgb"}, RGB16.mean(-1), 65535),
    "BigTIFF, big endian": (A16, {"bigtiff": True, "byteorder": ">"}, A16, 65535),
    "LZW, predictor": (A16, {"compression": "lzw", "predictor": 2}, A16, 65535),
    "zstd": (A16, {"compression": "zstd"}, A16, 65535),
}


@pytest.mark.parametrize("name", TIFFS)
def test_tiff(tmp_path, name):
    stored, options, expected, full_scale = TIFFS[name]
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stored, **({"photometric": "minisblack"} | options))
    picture = read_picture(path)
    np.testing.assert_array_equal(picture.grey, expected)
    assert picture.full_scale == full_scale
    # OpenImageIO leaves these out.
    if picture.full_scale == 65535 and name not in ("fine palette", "white is 0, 16 bit", "zstd"):
        theirs = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT16)
        np.testing.assert_array_equal(picture.grey, theirs[..., : 3 if theirs.shape[2] > 2 else 1].mean(-1))


@pytest.mark.parametrize("bits", [2, 4, 10, 12, 14])
def test_packed_samples(tmp_path, bits):
    """OpenImageIO packs them, scaled from the full range of 8 or 16 bits."""
    top, kind = 2**bits - 1, "uint8" if bits < 8 else "uint16"
    values = RNG.integers(0, top + 1, (12, 20))
    full = np.iinfo(kind).max
    by_oiio(tmp_path / "a.tif", np.rint(values * full / top).astype(kind), kind, oiio_BitsPerSample=bits)
    picture = read_picture(tmp_path / "a.tif")
    scale = 255 // top if bits < 8 else 1
    np.testing.assert_array_equal(picture.grey, values * scale)
    assert picture.full_scale == top * scale


def test_thumbnails_and_masks_are_no_pictures_of_their_own(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as tiff:
        tiff.write(A8[::2, ::2], subfiletype=1, photometric="minisblack")
        tiff.write(A16, photometric="minisblack")
        tiff.write(A8 > 9, subfiletype=4, photometric="minisblack")
    np.testing.assert_array_equal(grey(tmp_path / "a.tif"), A16)
    np.testing.assert_array_equal(grey(tmp_path / "a.tif", part="1"), A8[::2, ::2])


def several_pages(path: Path) -> None:
    tifffile.imwrite(path, np.stack([A16, A16[::-1]]), photometric="minisblack")


def exr_part(channels: dict[str, np.ndarray[Any, Any]], name: str = "", **header: Any) -> OpenEXR.Part:
    height, width = next(iter(channels.values())).shape[:2]
    window = (np.array([0, 0], np.int32), np.array([width - 1, height - 1], np.int32))
    kind = {"type": OpenEXR.scanlineimage, "dataWindow": window, "displayWindow": window}
    return OpenEXR.Part(kind | header, channels, name=name)


def exr_of(channels: dict[str, np.ndarray[Any, Any]]) -> Callable[[Path], None]:
    return lambda path: OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION}, channels).write(str(path))


def several_exr_parts(path: Path) -> None:
    parts = [exr_part({"Z": F32}, "depth"), exr_part(dict.fromkeys("RGB", F32 * 2), "beauty")]
    OpenEXR.File(parts).write(str(path))


def extensions(path: Path) -> None:
    units = [fits.PrimaryHDU(), fits.ImageHDU(A16, name="SCI"), fits.ImageHDU(A16[::-1], name="ERR")]
    fits.HDUList(units).writeto(path)


def moving_png(path: Path) -> None:
    frames = [Image.fromarray(A8), Image.fromarray(A8[::-1].copy())]
    frames[0].save(path, save_all=True, append_images=frames[1:])


def two_jpegs(path: Path) -> None:
    frames = [Image.new("RGB", (20, 12), (c, c, c)) for c in (10, 200)]
    frames[0].save(path, format="MPO", save_all=True, append_images=frames[1:])


def blocks(path: Path) -> None:
    np.savetxt(path, A8, fmt="%d", delimiter=",")
    path.write_text(path.read_text() + "\n" + path.read_text())


SEVERAL: dict[str, tuple[Callable[[Path], None], str, str, np.ndarray[Any, Any]]] = {
    "pages.tif": (several_pages, r"2 pictures: 1 \(20 x 12, uint16.*\), 2 \(20", "2", A16[::-1]),
    "samples.tif": (
        lambda p: tifffile.imwrite(p, np.stack([A8, A8, A8, A8, A8 // 2], -1), **GREY, planarconfig="contig"),
        r"5 pictures: 1:1 \(.*one of 5 samples",
        "1:5",
        A8 // 2,
    ),
    "parts.exr": (several_exr_parts, r"2 pictures: depth .* EXR, Z\), beauty .* EXR, R G B\)", "beauty", F32 * 2),
    "layers.exr": (
        exr_of({f"sun.{c}": F32 for c in "RGB"} | {"depth.Z": F32 * 2}),
        r"2 pictures: depth.Z .*, sun \(20 x 12, EXR, R G B\)",
        "depth.Z",
        F32 * 2,
    ),
    "units.fits": (extensions, r"2 pictures: SCI .*, ERR", "ERR", A16),
    "cube.fits": (
        lambda p: fits.PrimaryHDU(np.stack([A16, A16 // 2])).writeto(p),
        r"2 pictures: 0:1 .*, 0:2 ",
        "2",
        (A16 // 2)[::-1],
    ),
    "moving.png": (moving_png, r"2 pictures: 1 \(20 x 12, PNG, L\)", "2", A8[::-1]),
    "two.jpg": (two_jpegs, r"2 pictures: 1 \(20 x 12, MPO, RGB\)", "2", np.full((12, 20), 200)),
    "arrays.npz": (
        lambda p: np.savez(p, first=A16, second=F32, about=np.array("words")),
        r"2 pictures: first \(20 x 12, uint16.*\), second",
        "second",
        F32,
    ),
    "stack.npy": (lambda path: np.save(path, np.stack([F32, -F32])), r"2 pictures: 1 \(.*of shape 2x12x20", "2", -F32),
    "blocks.csv": (blocks, r"2 pictures: 1 \(20 x 12, numbers\)", "2", A8),
}


@pytest.mark.parametrize("name", SEVERAL)
def test_several_pictures_are_named_and_one_is_chosen(tmp_path, name):
    write, listed, part, expected = SEVERAL[name]
    path = tmp_path / name
    write(path)
    with pytest.raises(UserError, match=rf"{name}: holds {listed}.*; choose one with --part$"):
        read_picture(path)
    with pytest.raises(UserError, match=r"no part 'nine'; expected --part with one of "):
        read_picture(path, part="nine")
    np.testing.assert_allclose(grey(path, part=part), expected, rtol=1e-6)


def with_orientation(path: Path, tag: int) -> np.ndarray[Any, Any]:
    """Write a grey picture with an orientation tag; return what Pillow shows of it."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, A8, photometric="minisblack", extratags=[(274, "H", 1, tag, True)])
        shown = turned(A8, tag)
        if tag < 5:  # It turns no sides.
            theirs = oiio.ImageBufAlgo.reorient(oiio.ImageBuf(str(path))).get_pixels(oiio.UINT8)
            np.testing.assert_array_equal(theirs[..., 0], shown)
        return shown
    exif = Image.Exif()
    exif[274] = tag
    Image.fromarray(A8).save(path, exif=exif, **({"lossless": True} if path.suffix == ".webp" else {}))
    return np.asarray(ImageOps.exif_transpose(Image.open(path)).convert("L"))


@pytest.mark.parametrize("suffix", ["tif", "jpg", "png", "webp"])
@pytest.mark.parametrize("tag", range(1, 9))
def test_orientation_is_one_rule_for_every_format(tmp_path, suffix, tag):
    path = tmp_path / f"a.{suffix}"
    shown = with_orientation(path, tag)
    if tag == 1:
        assert grey(path).shape == (12, 20)
        return
    with pytest.raises(UserError, match=rf"orientation tag \({tag}\) says .*; give --orientation stored if"):
        read_picture(path)
    np.testing.assert_allclose(grey(path, orientation="shown", camera=camera(*shown.shape[::-1])), shown, atol=3)
    np.testing.assert_allclose(turned(grey(path, orientation="stored"), tag), shown, atol=3)


def test_an_orientation_that_is_none(tmp_path):
    with_orientation(tmp_path / "a.tif", 0)
    np.testing.assert_array_equal(grey(tmp_path / "a.tif"), A8)
    with pytest.raises(UserError, match="orientation: found 'up'; expected stored or shown"):
        read_picture(tmp_path / "a.tif", orientation="up")


def cropped(path: Path, left: int, top: int, width: int, height: int) -> None:
    """Write F32 with its data window at ``left``, ``top`` of a display window of so many pixels."""
    data = np.array([left, top], np.int32), np.array([left + 19, top + 11], np.int32)
    display = np.array([0, 0], np.int32), np.array([width - 1, height - 1], np.int32)
    OpenEXR.File([exr_part({"Y": F32}, dataWindow=data, displayWindow=display)]).write(str(path))


def test_windows_of_exr(tmp_path, caplog):
    path = tmp_path / "a.exr"
    cropped(path, -2, -1, 15, 9)
    np.testing.assert_array_equal(grey(path, camera=camera(15, 9)), F32[1:10, 2:17])
    assert not caplog.records
    np.testing.assert_array_equal(grey(path, camera=camera(20, 12)), F32)
    cropped(path, 3, 4, 40, 30)
    np.testing.assert_array_equal(grey(path, camera=camera(20, 12)), F32)
    assert caplog.messages[-1].endswith(
        "its pixels are columns 3 to 22 and rows 4 to 15 of an image of 40 x 30; the camera file is taken for them"
    )
    with pytest.raises(UserError, match=r"is a crop: .*; give a .* 20 x 12, with 3 less in cx and 4 less in cy"):
        read_picture(path, camera(40, 30))
    cropped(path, 3, 4, 20, 12)
    with pytest.raises(UserError, match=r"is a crop: columns 3 to 22 .*; save the whole image"):
        read_picture(path, camera(20, 12))


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        ({"front.half": F32}, F32),
        ({"Y": F32, "RY": F32 * 0, "BY": F32 * 0, "A": F32 * 0 + 1}, F32),
        ({"R": F32, "G": 2 * F32, "B": 3 * F32, "Z": F32}, (0.2126 + 2 * 0.7152 + 3 * 0.0722) * F32),
        ({"level": A16.astype(np.uint32)}, A16),
        ({"half": F32.astype(np.float16)}, F32.astype(np.float16)),
    ],
)
def test_channels_of_exr(tmp_path, channels, expected):
    exr_of(channels)(tmp_path / "a.exr")
    np.testing.assert_allclose(grey(tmp_path / "a.exr"), expected, rtol=1e-6)


def test_a_depth_is_no_picture_and_other_layers_are_named(tmp_path, caplog):
    path = tmp_path / "a.exr"
    exr_of({"Z": F32})(path)
    with pytest.raises(UserError, match=r"holds no light but Z \(20 x 12, EXR, Z\); choose one with --part$"):
        read_picture(path)
    np.testing.assert_array_equal(grey(path, part="Z"), F32)
    exr_of({"Y": F32, "left.Y": 2 * F32})(path)
    np.testing.assert_array_equal(grey(path), F32)
    assert caplog.messages[-1].endswith("its layer without a name is used, not left; --part takes another")


def test_tiles_and_smaller_copies_of_exr(tmp_path):
    buffer = oiio.ImageBuf(F32[..., None].copy())
    oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, buffer, str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(grey(tmp_path / "a.exr"), F32)


FITS = {
    "BZERO": (A16, {}, A16, 65535.0),
    "BSCALE": (A12 * 0.5 + 3.0, {}, A12 * 0.5 + 3.0, None),
    "int32": (A16.astype(np.int32), {}, A16, None),
    "float, SATURATE": (F32, {"SATURATE": 4095}, F32, 4095.0),
    "one plane": (A16[None], {}, A16, 65535.0),
    "colour": (PLANES, {"CTYPE3": "RGB"}, RGB16.mean(-1), 65535.0),
}


@pytest.mark.parametrize("name", FITS)
def test_fits(tmp_path, caplog, name):
    stored, cards, expected, full_scale = FITS[name]
    unit = fits.PrimaryHDU(stored)
    unit.header.update(cards)
    if name == "BSCALE":
        unit.scale("int16", bscale=0.5, bzero=3.0)
    path = tmp_path / "a.fits"
    unit.writeto(path)
    picture = read_picture(path)
    np.testing.assert_array_equal(picture.grey, expected[::-1])
    assert picture.full_scale == full_scale
    assert "no ROWORDER: the first row is taken for the lowest" in caplog.text


@pytest.mark.parametrize("kind", ["RICE_1", "GZIP_1", "GZIP_2", "HCOMPRESS_1"])
def test_packed_fits(tmp_path, kind):
    fits.CompImageHDU(A12.astype(np.int32), compression_type=kind).writeto(tmp_path / "a.fits")
    np.testing.assert_array_equal(grey(tmp_path / "a.fits"), A12[::-1])


def blank_fits(path: Path) -> None:
    unit = fits.PrimaryHDU(A16.astype(np.int16)[::-1])
    unit.header["BLANK"] = int(A16.astype(np.int16)[3, 4])
    unit.writeto(path)


@pytest.mark.parametrize(
    "write",
    [
        blank_fits,
        lambda p: tifffile.imwrite(p, F32, extratags=[(42113, "s", 0, str(float(F32[3, 4])), True)]),
    ],
)
def test_missing_data_of_fits_and_gdal_are_nan(tmp_path, write):
    write(tmp_path / "a")
    assert np.argwhere(np.isnan(grey(tmp_path / "a"))).tolist() == [[3, 4]]


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("la16.png", lambda p: by_oiio(p, np.stack([A16, OPAQUE], -1), "uint16", oiio_UnassociatedAlpha=1)),
        ("16.png", lambda p: Image.fromarray(A16).save(p)),
        ("16.npy", lambda p: np.save(p, A16)),
        ("flat.npy", lambda p: np.save(p, A16[..., None])),
        ("f.npy", lambda p: np.save(p, np.asfortranarray(A16.astype(">u2")))),
    ],
)
def test_sixteen_bits(tmp_path, name, write):
    write(tmp_path / name)
    picture = read_picture(tmp_path / name)
    np.testing.assert_array_equal(picture.grey, A16)
    assert picture.full_scale == 65535


@pytest.mark.parametrize("bits", [1, 2, 4])
def test_png_of_few_bits_and_palettes(tmp_path, bits):
    values = RNG.integers(0, 2**bits, (12, 20), np.uint8)
    image = Image.fromarray(values, "P")
    image.putpalette([c for v in range(2**bits) for c in (v * 15, v, 3)])
    image.save(tmp_path / "a.png", bits=bits)
    np.testing.assert_allclose(grey(tmp_path / "a.png"), (values * 16.0 + 3) / 3, rtol=1e-12)


@pytest.mark.parametrize("top", [200, 255, 4095, 65535])
def test_anymaps_keep_their_full_scale(tmp_path, top):
    values = RNG.integers(0, top + 1, (12, 20)).astype(">u2" if top > 255 else "u1")
    (tmp_path / "a.pgm").write_bytes(b"P5\n# by hand\n20 12\n%d\n" % top + values.tobytes())
    picture = read_picture(tmp_path / "a.pgm")
    np.testing.assert_array_equal(picture.grey, values)
    assert picture.full_scale == top


THERMAL = np.round(RNG.normal(-20.0, 30.0, (24, 32)), 2)


def table(delimiter: str, before: str = "", after: str = "") -> bytes:
    rows = (delimiter.join(map(str, row)) + after for row in THERMAL)
    return (before + "\n".join(rows) + "\n").encode()


@pytest.mark.parametrize(
    "content",
    [
        table(","),
        table(";", "\ufeffcolumn 1;column 2\n"),
        table("\t", after="\t"),
        table("  ", "# degrees Celsius\n\n"),
        table(", ").replace(b"\n", b"\r\n"),
    ],
)
def test_a_table_of_temperatures_is_a_picture(tmp_path, content):
    (tmp_path / "a.csv").write_bytes(content)
    picture = read_picture(tmp_path / "a.csv", camera(32, 24))
    np.testing.assert_array_equal(picture.grey, THERMAL)
    assert picture.full_scale is None


def opacity(values: int, suffix: str) -> Callable[[Path], None]:
    pixels = np.dstack([A8, A8, A8, np.full_like(A8, values)])
    return lambda path: Image.fromarray(pixels).save(path.with_suffix(suffix)) or path.with_suffix(suffix).rename(path)


def bytes_of(data: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(data) and None


def of_pillow(mode: str, suffix: str, **options: Any) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        buffer = io.BytesIO()
        Image.new(mode, (20, 12)).save(buffer, suffix, **options)
        path.write_bytes(buffer.getvalue())

    return write


def mosaic_tiff(path: Path) -> None:
    cells = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, b"\0\1\1\2", True)]
    tifffile.imwrite(path, A16, photometric="cfa", extratags=cells)


def mosaic(path: Path) -> None:
    unit = fits.PrimaryHDU(A16)
    unit.header["BAYERPAT"] = "RGGB"
    unit.writeto(path)


def sized(axis: str) -> bytes:
    """Return a FITS file whose first axis is as given."""
    cards = ("SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 2", f"NAXIS1  = {axis}", "NAXIS2  = 48", "END")
    return "".join(card.ljust(80) for card in cards).encode().ljust(2880) + b"\0" * 5760


def truncated(write: Callable[[Path], None], by: int) -> Callable[[Path], None]:
    def cut(path: Path) -> None:
        write(path)
        path.write_bytes(path.read_bytes()[:-by])

    return cut


def huge(shape: tuple[int, ...]) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return buffer.getvalue() + b"\0" * 64


def deep(path: Path) -> None:
    spec = oiio.ImageSpec(6, 5, 1, "float")
    spec.deep, pixels, out = True, oiio.DeepData(), oiio.ImageOutput.create("a.exr")
    pixels.init(30, 1, ["float"], ["Z"])
    assert out.open(str(path), spec)
    out.write_deep_image(pixels)
    out.close()


def jpeg_of_twelve_bits() -> bytes:
    done = cv2.imencode(".jpg", A8)[1].tobytes()
    return done.replace(b"\xff\xc0\x00\x0b\x08", b"\xff\xc0\x00\x0b\x0c")


REFUSED: dict[str, tuple[Callable[[Path], None], str]] = {
    "CMYK TIFF": (of_pillow("CMYK", "tiff"), "its pixels are CMYK; expected grey or RGB"),
    "Lab TIFF": (of_pillow("LAB", "tiff"), "PhotometricInterpretation 8"),
    "CFA TIFF": (mosaic_tiff, "a mosaic of a colour sensor"),
    "complex TIFF": (lambda p: tifffile.imwrite(p, F32 + 1j, photometric="minisblack"), "whole or floating-point"),
    "ImageJ stack": (lambda p: tifffile.imwrite(p, PLANES, imagej=True, truncate=True), "a stack of several images"),
    "cut TIFF": (truncated(several_pages, 700), "truncated, or a damaged list of pages"),
    "cut strip": (truncated(lambda p: tifffile.imwrite(p, A16), 20), "truncated, or parts of its pixels are missing"),
    "CMYK JPEG": (of_pillow("CMYK", "jpeg"), "its pixels are CMYK"),
    "JPEG of 12 bits": (bytes_of(jpeg_of_twelve_bits()), "a JPEG file that is damaged or has not 8 bits a sample"),
    "GIF": (of_pillow("L", "gif"), "format GIF, which is not read; .*convert it to PNG"),
    "transparent PNG": (opacity(200, ".png"), "240 pixels are transparent, wholly or in part"),
    "deep EXR": (deep, "holds deep pixels, which have several samples each; flatten it"),
    "floating-point anymap": (bytes_of(b"Pf\n20 12\n-1.0\n" + F32.tobytes()), "its pixels are floating-point numbers"),
    "mosaic": (mosaic, r"mosaic of a colour sensor \(BAYERPAT = RGGB\); .*average its cells"),
    "negative axis": (bytes_of(sized("-64")), "NAXIS1 = -64 is negative"),
    "huge axis": (bytes_of(sized("9999999999")), "announces 479999999952 bytes of data, 5760 follow"),
    "axis of words": (bytes_of(sized("'x'")), "NAXIS1 is no whole number"),
    "no END": (bytes_of(sized("64")[:240] + b" " * 9000), "a FITS head without an end"),
    "gzip": (bytes_of(b"\x1f\x8b\x08" + b"\0" * 90), "is packed with gzip; .*unpack it"),
    "objects": (lambda p: np.save(p.open("wb"), np.array([[{}]])), "holds Python objects, which are not read"),
    "one row": (lambda p: np.save(p.open("wb"), F32[0]), "its array of float32 of shape 20 is no image"),
    "complex": (lambda p: np.save(p.open("wb"), F32 + 1j), "of complex64 .* is no image; expected real"),
    "huge array": (bytes_of(huge((10**9, 10**9))), "truncated: 64 of 8000000000000000000 bytes of an array"),
    "ZIP": (bytes_of(b"PK\5\6".join([b"PK\3\4", bytes(18)])), "is a ZIP archive without arrays"),
    "decimal comma": (bytes_of(table(";").replace(b".", b",")), "line 1: numbers with a decimal comma"),
    "decimal comma, spaces": (bytes_of(table(" ").replace(b".", b",")), "line 1: numbers with a decimal comma"),
    "words in a table": (bytes_of(table(",") + b"1,2,three\n"), "line 25: is no row of numbers alone"),
    "short row": (bytes_of(table(",") + b"1,2\n"), "line 25: 2 numbers; expected 32, as in the rows above"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_read_is_named(tmp_path, name):
    write, words = REFUSED[name]
    path = tmp_path / "picture"
    write(path)
    with pytest.raises(UserError, match=words) as caught:
        read_picture(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["a.exr", "a.tif"])
def test_premultiplied_colours_are_over_black(tmp_path, caplog, name):
    path, half = tmp_path / name, np.where(A8 > 99, 1.0, 0.5).astype(np.float32)
    if name == "a.exr":
        exr_of({"Y": F32, "A": half})(path)
    else:
        pixels = np.stack([F32, half], -1)
        tifffile.imwrite(path, pixels, photometric="minisblack", extrasamples=["assocalpha"], planarconfig="contig")
    np.testing.assert_array_equal(grey(path), F32)
    assert f"{np.count_nonzero(A8 <= 99)} pixels are transparent, and are taken as over a black" in caplog.text


def test_estimate_takes_part_and_orientation(tmp_path):
    pages_file, turned_file = tmp_path / "a.tif", tmp_path / "b.png"
    several_pages(pages_file)
    with_orientation(turned_file, 6)
    upright = Camera(camera(12, 20))
    with pytest.raises(UserError, match="holds 2 pictures"):
        estimate(pages_file, "limb-sphere", camera=Camera(camera(20, 12)))
    estimate(pages_file, "limb-sphere", camera=Camera(camera(20, 12)), part=2)
    estimate(turned_file, "limb-sphere", camera=upright, orientation="shown")
    with pytest.raises(UserError, match="the image is 20 x 12 pixels, the camera 12 x 20"):
        estimate(turned_file, "limb-sphere", camera=upright, orientation="stored")
    with pytest.raises(UserError, match="part, orientation: given for an image that is no file"):
        estimate(A8, "limb-sphere", camera=Camera(camera(20, 12)), part=1)
