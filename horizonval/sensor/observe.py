"""A frame as a detector sees it: radiance to digital numbers.

The order of the stages is that of the light and the charge::

    lens        radiance -> power on the pixel, spread and scattered        (image_plane)
    detector    cmos: electrons, charge, numbers; thermal: warmth, offsets, numbers

Every random stage draws from its own stream (:mod:`horizonval.sensor.streams`); the same frame, camera, band and seed
give the same bytes.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.geometry.camera import camera_from_spec, check_invertible
from horizonval.sensor.detector import cmos, readout, thermal
from horizonval.sensor.lens import lens_spread
from horizonval.sensor.streams import noise_identity, stream
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos, ThermalDetector


def observe(
    frame: RadianceFrame, camera: CameraSpec, band: str | None = None, seed: int = 0, *, noise: bool = True
) -> DetectorImage:
    """Return what the camera's detector makes of one band of a frame.

    Parameters
    ----------
    frame : RadianceFrame
    camera : CameraSpec
        Must see what the frame's own camera saw; lens speed, blur, response table and detector may differ.
    band : str, optional
        The camera's first band by default.
    seed : int
        Replicate: another seed is another, independent draw of all noise.
    noise : bool
        False gives the expected signal, still saturated and quantised: what is left of an estimator's error on such
        images is bias.

    Raises
    ------
    UserError
        The camera has no detector or no such band, the two do not fit each other, the frame lacks the band or was
        made for another image geometry, or its radiance is negative or not finite.
    """
    spec = band_named(camera, band)
    geometry = camera_from_spec(camera.camera)
    check_invertible(geometry)

    # The colours of a mosaic are one reading of one array.
    mosaic = isinstance(camera.detector, Cmos) and camera.detector.bayer is not None
    reading = "+".join(one.name for one in camera.band) if mosaic else spec.name

    identity = noise_identity(frame.truth)

    def rng(stage: str) -> np.random.Generator | None:
        return stream(identity, camera.camera.name, reading, stage, seed) if noise else None

    def radiance(of: Band) -> FloatArray:
        return checked_radiance(frame, camera, of.name)

    def behind(of: Band) -> FloatArray:
        return np.asarray(frame.behind[of.name], dtype=np.float64)

    parts = behind if frame.behind else None

    if isinstance(camera.detector, Cmos):
        _require_kind(spec, "solar", camera.detector.kind)
        dn, settings = cmos.respond(radiance, frame.truth, geometry, camera, camera.detector, spec, rng, parts)
    elif isinstance(camera.detector, ThermalDetector):
        _require_kind(spec, "thermal", camera.detector.kind)
        back = None if parts is None else parts(spec)
        dn, settings = thermal.respond(radiance(spec), frame.truth, geometry, camera, camera.detector, spec, rng, back)
    else:
        raise UserError("the camera has no detector", where="detector", expected="a [detector] table")
    return DetectorImage(
        dn=dn,
        band=spec.name,
        truth=frame.truth,
        full_scale=readout.full_scale(camera.detector.bits),
        observation={"seed": seed, "noise": noise, "camera": camera.model_dump(mode="json"), **settings},
    )


def check_camera(camera: CameraSpec) -> None:
    """Raise UserError if a camera cannot observe a band: no detector, a wrong kind, a too wide point spread."""
    detector = camera.detector
    if detector is None:
        raise UserError("the camera has no detector", where="detector", expected="a [detector] table")
    for band in camera.band:
        _require_kind(band, "solar" if isinstance(detector, Cmos) else "thermal", detector.kind)
        lens_spread.check(camera.optics, band, detector.pixel_pitch_um * 1e-6)


def band_named(camera: CameraSpec, name: str | None) -> Band:
    """Return a camera's band of a name, its first one without; UserError where there is none."""
    if not camera.band:
        raise UserError("the camera has no band", where="band", expected="at least one [[band]] table")
    if name is None:
        return camera.band[0]
    for band in camera.band:
        if band.name == name:
            return band
    raise UserError(
        f"no band {name!r}", where="band.name", expected=" or ".join(repr(band.name) for band in camera.band)
    )


def checked_radiance(frame: RadianceFrame, camera: CameraSpec, band: str) -> FloatArray:
    """Return the band's radiance in float64, after checking that it is one and that the camera fits the frame."""
    if band not in frame.radiance:
        raise UserError(
            f"the frame has no radiance for band {band!r}",
            where="band.name",
            expected=" or ".join(repr(name) for name in frame.radiance),
            fix="render the scene again with this camera",
        )
    made_for = frame.truth.camera_model
    intrinsics = camera_from_spec(camera.camera)
    for key in (
        "width",
        "height",
        "fx",
        "fy",
        "cx",
        "cy",
        "distortion",
        "projection",
        "image_circle_rad",
        "skew",
        "shape",
    ):
        if getattr(intrinsics, key) != getattr(made_for, key):
            raise UserError(
                f"the camera's {key} is {getattr(intrinsics, key)}, the frame was made for {getattr(made_for, key)}",
                where=f"camera.{key}",
                fix="render the scene again with this camera",
            )
    radiance = np.asarray(frame.radiance[band], dtype=np.float64)
    if radiance.shape != (intrinsics.height, intrinsics.width):
        raise UserError(
            f"the frame's pixels have shape {radiance.shape}", expected=f"{intrinsics.height, intrinsics.width}"
        )
    bad = ~(np.isfinite(radiance) & (radiance >= 0))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise UserError(
            f"radiance of band {band!r} is {radiance[row, column]} at column {column}, row {row}",
            where="frame",
            expected="finite values, none below 0",
        )
    return radiance


def _require_kind(band: Band, kind: str, detector: str) -> None:
    if band.kind != kind:
        raise UserError(
            f"a {detector} cannot see band {band.name!r} of kind {band.kind!r}",
            where="detector.kind",
            expected=f"a band of kind {kind!r}",
        )
