"""FITS files of frames and detector images, for astronomers' programs.

An image has its digital numbers in the first unit; a frame has one extension for each band (``RADIANCE.<band>``) and
each truth map (``TRUTH.<map>``). Masks (``MASK.EARTH``, ``MASK.SUNLIT``, of an image ``MASK.SATURATED``) are 1 and 0.
Standard keywords state time, place (``OBSGEO-*``), units and detector, and a celestial coordinate system: ``TAN`` for
pinholes and ``ARC`` for fisheyes, after Calabretta and Greisen 2002 (A&A 395, 1077), with the lens distortion as SIP
polynomials (Shupe et al. 2005, ASP 347, 491) fitted to the exact model; ``WCSERR`` is the largest difference. If it
exceeds 0.1 px, and for equal-angle grids, there is no coordinate system. The last extension holds the full truth as
JSON with a digest of everything, so that the file can be read back.

The upper row of the image comes first (``ROWORDER``). Programs that draw the first row at the bottom show the picture
upside down, with correct coordinates.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import warnings
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.frame import MAP_UNITS, DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry import frames
from horizonval.geometry.camera import CameraModel, camera_from_spec, unproject
from horizonval.geometry.clock import julian_utc
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.store.attributes import camera_of, earth_mask, saturated_mask, sunlit_mask
from horizonval.store.exported import of_fits, sealed, text_of
from horizonval.store.fits_heads import refuse_impossible_sizes
from horizonval.store.readers.part import native

Cards = dict[str, tuple[Any, str]]

SIP_ORDER = 7
SIP_GRID = 33
LARGEST_SIP_ERROR_PX = 0.1


def fits_bytes(source: RadianceFrame | DetectorImage, address: str = "") -> bytes:
    """Return a FITS file; ``UserError`` if astropy is not installed."""
    fits = _astropy()
    observation = source.observation if isinstance(source, DetectorImage) else None
    spec = camera_of(source.truth, observation)
    common = _keywords(source.truth, spec, address)
    coordinates = _coordinates(source.truth, camera_from_spec(spec.camera))
    if isinstance(source, DetectorImage):
        cards = common | _image_keywords(source, spec) | coordinates
        units = [_with(fits.PrimaryHDU(source.dn), cards)]
        saturated = saturated_mask(source.dn, source.full_scale).astype(np.uint8)
        meaning = {"BUNIT": ("", "1 where the converter is at its end, else 0")}
        units.append(_with(fits.ImageHDU(saturated, name="MASK.SATURATED"), meaning | coordinates))
    else:
        units = [_with(fits.PrimaryHDU(), common)]
        for band, values in source.radiance.items():
            cards = {"BUNIT": ("W m-2 sr-1", "radiance; of solar bands counted by photons")} | _band(spec, band)
            units.append(_with(fits.ImageHDU(values, name=f"RADIANCE.{band}"), common | cards | coordinates))
        for band, values in source.energy_radiance.items():
            if values is not source.radiance.get(band):
                cards = {"BUNIT": ("W m-2 sr-1", "integral over wavelength")} | _band(spec, band)
                units.append(_with(fits.ImageHDU(values, name=f"ENERGY.{band}"), common | cards | coordinates))
        for band, values in source.behind.items():
            cards = {"BUNIT": ("W m-2 sr-1", "radiance without parts of the spacecraft")} | _band(spec, band)
            units.append(_with(fits.ImageHDU(values, name=f"BEHIND.{band}"), common | cards | coordinates))
        for name, values in source.maps.items():
            unit = {"BUNIT": (MAP_UNITS[name], "")} if MAP_UNITS.get(name) in ("m", "deg") else {}
            units.append(_with(fits.ImageHDU(values, name=f"TRUTH.{name}"), unit | coordinates))
        for name, mask in (
            ("EARTH", earth_mask(source.maps)),
            ("SUNLIT", sunlit_mask(source.maps, source.truth)),
        ):
            meaning = {"BUNIT": ("", "1 where the pixel's centre is in it, else 0")}
            units.append(_with(fits.ImageHDU(mask.astype(np.uint8), name=f"MASK.{name}"), meaning | coordinates))
    arrays = {unit.name: np.asarray(unit.data) for unit in units if unit.data is not None}
    units.append(_json_table(fits, sealed(arrays, json.loads(text_of(_content(source))))))
    buffer = io.BytesIO()
    fits.HDUList(units).writeto(buffer, checksum=False)
    return buffer.getvalue()


def is_own(units: Any) -> bool:
    """Return whether an opened FITS file is one that :func:`fits_bytes` made."""
    return "JSON" in units and "format" in units["JSON"].columns.names


def bands_of(units: Any) -> list[str]:
    """Return the bands that an opened FITS file of ours holds."""
    return [str(band) for band in json.loads(str(units["JSON"].data["bands"][0]))]


def read_own(path: Path) -> RadianceFrame | DetectorImage:
    """Return the whole content of a FITS file of ours; ``UserError``: no FITS file, or changed after its export."""
    with opened(path) as units:
        table = units["JSON"]
        content = {name: json.loads(str(table.data[name][0])) for name in table.columns.names}
        arrays = {unit.name: native(unit.data) for unit in units if unit.is_image and unit.data is not None}
    return of_fits(arrays, content, str(path))


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a FITS file whose heads have been checked; what goes wrong inside is a ``DamagedFileError``."""
    fits = _astropy(str(path))
    with warnings.catch_warnings(), files.open_file(path, expected="a FITS file") as file:
        # It warns of what it mends by itself; what it cannot mend raises.
        warnings.simplefilter("ignore")
        refuse_impossible_sizes(file, path)
        try:
            with fits.open(file, memmap=False, lazy_load_hdus=False) as units:
                yield units
        except UserError:
            raise
        except Exception:
            # A damaged file comes out of the library as whatever went wrong inside.
            raise DamagedFileError("not an image that can be read: a damaged FITS file", where=str(path)) from None


def _content(source: RadianceFrame | DetectorImage) -> dict[str, Any]:
    """Return what units and their keywords cannot say, or not exactly."""
    if isinstance(source, RadianceFrame):
        return {"truth": source.truth.to_dict(), "bands": list(source.radiance), "render": source.render}
    more = {"full_scale": source.full_scale, "observation": source.observation}
    return {"truth": source.truth.to_dict(), "bands": [source.band], **more}


def _astropy(where: str = "--fits") -> Any:
    try:
        from astropy.io import fits
    except ImportError:
        raise UserError(
            "astropy is not installed",
            where=where,
            fix='run `pip install "horizonval[fits]"` or `pip install astropy`',
        ) from None
    return fits


def _with(unit: Any, cards: Mapping[str, tuple[Any, str]]) -> Any:
    for key, (value, comment) in cards.items():
        unit.header[key] = (value, comment) if comment else value
    return unit


def _json_table(fits: Any, content: Mapping[str, Any]) -> Any:
    columns = []
    for name, value in content.items():
        text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
        columns.append(fits.Column(name=name, format=f"{len(text)}A", array=np.array([text])))
    return fits.BinTableHDU.from_columns(columns, name="JSON")


def _keywords(truth: FrameTruth, spec: CameraSpec, address: str) -> Cards:
    epoch = datetime.fromisoformat(truth.epoch_utc).astimezone(UTC)
    camera = camera_from_spec(spec.camera)
    cards: Cards = {
        "ORIGIN": ("horizonval", "a simulation"),
        "INSTRUME": (spec.camera.name, "camera"),
        "OBJECT": (truth.scene_name, "scene"),
        "DATE-OBS": (epoch.replace(tzinfo=None).isoformat(timespec="milliseconds"), ""),
        "MJD-OBS": (_modified_julian_day(epoch), "[d] of DATE-OBS"),
        "TIMESYS": ("UTC", ""),
        "OBSGEO-X": (truth.r_itrs[0], "[m] camera, ITRS"),
        "OBSGEO-Y": (truth.r_itrs[1], "[m]"),
        "OBSGEO-Z": (truth.r_itrs[2], "[m]"),
        "ROWORDER": ("TOP-DOWN", "the first row is the upper one"),
        "PROJECTN": (camera.projection, "of the camera"),
        "FX_PX": (camera.fx, "[pixel] focal length along rows"),
        "FY_PX": (camera.fy, "[pixel] along columns"),
        "FNUMBER": (spec.optics.f_number, ""),
    }
    for axis, sun, nadir in zip("XYZ", truth.sun_cam, truth.nadir_geocentric_cam, strict=True):
        cards[f"SUN_{axis}"] = (sun, "Sun, camera axes: right, down, forward")
        cards[f"NADIR_{axis}"] = (nadir, "Earth's centre, camera axes")
    if spec.detector is not None:
        pitch = spec.detector.pixel_pitch_um
        cards |= {"XPIXSZ": (pitch, "[um] pitch"), "YPIXSZ": (pitch, "[um] pitch")}
        if camera.projection != "equal_angle":
            cards["FOCALLEN"] = (camera.fx * pitch * 1e-3, "[mm]")
    if address:
        cards["HVADDR"] = (address, "")
    return cards


def _modified_julian_day(epoch: datetime) -> float:
    """Return the days since 1858-11-17, 0 h; a day with a leap second is longer, as everywhere in this count."""
    day, fraction = julian_utc(epoch)
    return day - 2400000.5 + float(fraction)


def _image_keywords(image: DetectorImage, spec: CameraSpec) -> Cards:
    cards: Cards = {"BUNIT": ("adu", "digital numbers"), "SATURATE": (image.full_scale, "[adu] largest number")}
    cards |= _band(spec, image.band)
    if isinstance(spec.detector, Cmos):
        exposure_s = image.observation.get("exposure_s")
        cards["EXPTIME"] = (spec.detector.exposure_s if exposure_s is None else exposure_s, "[s]")
    return cards


def _band(spec: CameraSpec, name: str) -> Cards:
    cards: Cards = {"FILTER": (name, "band")}
    for band in spec.band:
        if band.name == name:
            lo = band.wavelength_um[0] if band.lo_um is None else band.lo_um
            hi = band.wavelength_um[-1] if band.hi_um is None else band.hi_um
            cards |= {"WAVEMIN": (lo, "[um]"), "WAVEMAX": (hi, "[um]")}
    return cards


def _coordinates(truth: FrameTruth, camera: CameraModel) -> Cards:
    """Return the celestial coordinate system, or nothing where none is good to a tenth of a pixel."""
    if camera.projection == "equal_angle" or camera.skew:
        return {}
    sip, error_px = _distortion(camera)
    if error_px > LARGEST_SIP_ERROR_PX:
        return {}
    epoch = datetime.fromisoformat(truth.epoch_utc)
    gcrs_from_cam = itrs_from_gcrs(epoch).T @ frames.rotate(frames.inverse(truth.q_cam_from_itrs), np.eye(3)).T
    right, down, boresight = gcrs_from_cam.T
    east = np.cross([0.0, 0.0, 1.0], boresight)
    east /= np.linalg.norm(east)
    north = np.cross(boresight, east)
    per_px = np.degrees([1 / camera.fx, 1 / camera.fy])
    projection = ("TAN" if camera.projection == "pinhole" else "ARC") + ("-SIP" if sip else "")
    return {
        "WCSAXES": (2, ""),
        "RADESYS": ("ICRS", "seen from the camera; aberration is left out"),
        "CTYPE1": (f"RA---{projection}", ""),
        "CTYPE2": (f"DEC--{projection}", ""),
        "CUNIT1": ("deg", ""),
        "CUNIT2": ("deg", ""),
        "CRPIX1": (camera.cx + 1, "the first pixel's centre is 1"),
        "CRPIX2": (camera.cy + 1, ""),
        "CRVAL1": (math.degrees(math.atan2(boresight[1], boresight[0])) % 360.0, "boresight"),
        "CRVAL2": (math.degrees(math.asin(boresight[2])), ""),
        "CD1_1": (float(right @ east) * per_px[0], ""),
        "CD1_2": (float(down @ east) * per_px[1], ""),
        "CD2_1": (float(right @ north) * per_px[0], ""),
        "CD2_2": (float(down @ north) * per_px[1], ""),
        "WCSERR": (round(error_px, 6), "[pixel] at most, from the exact lens"),
        **sip,
    }


def _distortion(camera: CameraModel) -> tuple[Cards, float]:
    """Return SIP polynomials from the image to that of the undistorted lens, and their largest error in pixels."""
    if camera.projection != "unified" and not any(camera.distortion):
        return {}, 0.0
    side = [np.linspace(-0.5, size - 0.5, SIP_GRID) for size in (camera.width, camera.height)]
    uv = np.stack(np.meshgrid(*side), axis=-1).reshape(-1, 2)
    d = unproject(camera, uv)
    good = np.isfinite(d).all(axis=1)
    uv, d = uv[good], d[good]
    if camera.projection == "pinhole":
        ideal = d[:, :2] / d[:, 2:]
    else:
        across = np.hypot(d[:, 0], d[:, 1])
        stretch = np.arctan2(across, d[:, 2]) / np.where(across > 0, across, 1.0)
        ideal = stretch[:, None] * d[:, :2]
    offset = uv - [camera.cx, camera.cy]
    wanted = ideal * [camera.fx, camera.fy] - offset
    scale = float(np.abs(offset).max())
    powers = [(p, q) for p in range(SIP_ORDER + 1) for q in range(SIP_ORDER + 1 - p) if p + q >= 2]
    x, y = (offset / scale).T
    design = np.stack([x**p * y**q for p, q in powers], axis=-1)
    solution = np.linalg.lstsq(design, wanted, rcond=None)[0]
    error_px = float(np.hypot(*(design @ solution - wanted).T).max())
    cards: Cards = {}
    for axis, letter in enumerate("AB"):
        cards[f"{letter}_ORDER"] = (SIP_ORDER, "")
        for (p, q), value in zip(powers, solution[:, axis], strict=True):
            cards[f"{letter}_{p}_{q}"] = (float(value) / scale ** (p + q), "")
    return cards, error_px
