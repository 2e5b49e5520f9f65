"""Frames and images as labelled arrays of ``xarray``, which writes NetCDF and Zarr."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError
from horizonval.frame import MAP_UNITS, DetectorImage, FrameTruth, RadianceFrame

if TYPE_CHECKING:
    import xarray


def dataset_of(source: RadianceFrame | DetectorImage) -> xarray.Dataset:
    """Return a frame or an image with its coordinates and what it says of itself.

    Dimensions are ``row`` and ``column``, counted from the centre of the upper left pixel, and ``band`` of a frame.
    Attributes hold scene, camera, epoch, and the nadir and the Sun in camera axes.

    Raises
    ------
    UserError
        xarray is not installed.
    """
    try:
        import xarray
    except ImportError:
        raise UserError("xarray is not installed", fix='run `pip install "horizonval[xarray]"`') from None
    about = _attributes(source.truth)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]]
    coordinates: dict[str, object]
    if isinstance(source, DetectorImage):
        about |= {"band": source.band, "full_scale": int(source.full_scale)}
        variables = {"dn": (("row", "column"), source.dn, {"units": "1", "long_name": "digital number"})}
        coordinates = _places(source.dn.shape)
    else:
        bands = list(source.radiance)
        radiance = np.stack([source.radiance[band] for band in bands])
        variables = {"radiance": (("band", "row", "column"), radiance, {"units": "W m-2 sr-1"})}
        for name, values in source.maps.items():
            variables[name] = (("row", "column"), values, {"units": MAP_UNITS.get(name, "1")})
        coordinates = {"band": bands, **_places(radiance.shape[1:])}
    return xarray.Dataset(variables, coordinates, about)


def _places(shape: tuple[int, ...]) -> dict[str, object]:
    return {
        "row": ("row", np.arange(shape[0]), {"units": "px"}),
        "column": ("column", np.arange(shape[1]), {"units": "px"}),
    }


def _attributes(truth: FrameTruth) -> dict[str, object]:
    """Return what NetCDF can hold as attributes: texts and rows of numbers."""
    return {
        "scene": truth.scene_name,
        "camera": truth.camera_name,
        "epoch_utc": truth.epoch_utc,
        "r_itrs_m": list(truth.r_itrs),
        "q_cam_from_itrs": list(truth.q_cam_from_itrs),
        "nadir_geocentric_cam": list(truth.nadir_geocentric_cam),
        "sun_cam": list(truth.sun_cam),
    }
