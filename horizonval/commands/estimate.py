"""One estimator on one image file, or on those of all heads of a housing, as the ``estimate`` command reports it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from horizonval.commands.picture import GreyImage, read_picture, refuse_other_size
from horizonval.commands.program import program_of
from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.earth.spectral.bands import limits_um, width_um
from horizonval.estimation import installed, registry
from horizonval.estimation.likelihood.templates import templates_of
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.onnx_model import is_model, model_estimator
from horizonval.estimation.prior import Prior
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.geometry.camera import camera_from_spec, check_invertible
from horizonval.scoring.bound import bound_of, together
from horizonval.scoring.errors import ARCSEC, score, sigma_nadir_rad
from horizonval.scoring.row import rounded
from horizonval.sensor.knowledge import refuse_unknown_climate, stated_prior
from horizonval.sensor.stated_lens import stated_lens
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.load import load_prior
from horizonval.spec.prior import PriorSpec, is_limb_table
from horizonval.suites.observation import band_of, known_of, observation_of, observation_of_heads, with_altitude_of

ERRORS = ("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec", "altitude_error_km", "false_valid")
"""What is said of an answer whose image carries the truth, named as the columns of the results."""

BOUNDS = ("bound_noise_arcsec", "bound_arcsec")
"""What the limb allows at best, of an image that carries its information; named alike."""


def estimator_of(name: str, suite: str | Path | None = None) -> Estimator:
    """Return an installed estimator, an ONNX file's, or with ``suite`` a program of that; ``UserError`` if none is."""
    if suite is None and is_model(name):
        return model_estimator(name)
    program = None if suite is None else program_of(suite, name)
    return installed.get(name) if program is None else program


def prior_from(path: str | Path) -> PriorSpec:
    """Return what a file of a table ``[prior]`` says."""
    spec = load_prior(path)
    try:
        refuse_unknown_climate(spec)
        if spec.climate is not None and is_limb_table(spec.climate):
            templates_of(Path(spec.climate))
    except UserError as e:
        raise e.inside(str(path)) from e
    return spec


def estimate_file(
    path: Path,
    estimator: Estimator,
    camera: CameraSpec | None,
    camera_file: str = "",
    known: PriorSpec | None = None,
) -> dict[str, Any]:
    """Return the estimate as plain data, with the keys of the command contract; ``None`` where a key does not apply.

    Parameters
    ----------
    path : Path
        Any picture :func:`horizonval.commands.picture.read_picture` reads. One that carries its truth has the errors
        against it as well (:data:`ERRORS`); the estimator is not given the truth.
    estimator : Estimator
    camera : CameraSpec or None
        May be left out for our own EXR files, which carry theirs.
    camera_file : str
        For error messages.
    known : PriorSpec, optional
        What is known beside the image, in place of what a file of ours says.

    Raises
    ------
    UserError
        Unreadable picture, no camera, or a camera of another size; a prior that does not go with the picture.
    """
    picture = read_picture(path, camera, camera_file)
    observation = observation_from(picture, estimator, str(path), camera, camera_file, known)
    start = time.perf_counter()
    result = registry.run_safely(estimator, observation)
    seconds = time.perf_counter() - start
    sources = () if picture.source is None else (picture.source,)
    return _report(estimator, result, seconds, sources, observation.prior)


def estimate_heads(paths: Sequence[Path], estimator: Estimator, known: PriorSpec | None = None) -> dict[str, Any]:
    """Return the estimate from the images of all heads of one housing, with the keys of :func:`estimate_file`.

    Parameters
    ----------
    paths : sequence of Path
        Our own EXR files, which say which head took them, one for every head.
    estimator : Estimator
    known : PriorSpec, optional
        What is known beside the images, in place of what they say.

    Raises
    ------
    UserError
        An estimator that takes a single image; a picture that is none of ours, two of one head, or images
        of different housings or instants.
    """
    sources = _sources_of_heads([(str(path), read_picture(path)) for path in paths], estimator)
    observation = observation_of_heads(sources, estimator, known)
    start = time.perf_counter()
    result = registry.run_safely(estimator, observation)
    seconds = time.perf_counter() - start
    return _report(estimator, result, seconds, tuple(sources.values()), observation.prior)


def observation_from_heads(
    pictures: Sequence[tuple[str, GreyImage]], estimator: Estimator, known: PriorSpec | Prior | None = None
) -> Observation:
    """Return what an estimator is given of the images of all heads of one housing.

    Parameters
    ----------
    pictures : sequence of (str, GreyImage)
        Each after the name that errors call it.
    estimator : Estimator
    known : PriorSpec or Prior, optional
        What is known beside the images, in place of what they say.

    Raises
    ------
    UserError
        An estimator that takes a single image; a picture that is none of ours, two of one head, or images of different
        housings or instants.
    """
    return observation_of_heads(_sources_of_heads(pictures, estimator), estimator, known)


def _sources_of_heads(
    pictures: Sequence[tuple[str, GreyImage]], estimator: Estimator
) -> dict[str, DetectorImage | RadianceFrame]:
    """Return what the pictures are made of, by head, in the order that decides whose camera frame the answer is in."""
    if estimator.needs != "heads":
        names = ", ".join(name for name, _ in pictures)
        raise UserError(f"estimator {estimator.name!r} takes one image, not {len(pictures)}", where=names)
    sources: dict[str, DetectorImage | RadianceFrame] = {}
    housing = None
    for where, picture in pictures:
        source = picture.source
        head = None if source is None else source.truth.head
        if source is None or head is None:
            raise UserError(
                "this image does not say which head took it", where=where, expected="an EXR file written by horizonval"
            )
        if head in sources:
            raise UserError(f"a second image of the head {head!r}", where=where, expected="one image for each head")
        angles = (source.truth.roll_rad, source.truth.pitch_rad, source.truth.yaw_rad)
        identity = (source.truth.camera, source.truth.r_itrs, source.truth.epoch_utc, angles)
        housing = identity if housing is None else housing
        if identity != housing:
            raise UserError(
                "another camera, place, time or attitude than the first image's",
                where=where,
                expected="one housing's heads",
            )
        sources[head] = source
    return _in_order(sources)


def _in_order(sources: Mapping[str, DetectorImage | RadianceFrame]) -> dict[str, DetectorImage | RadianceFrame]:
    """Return images in the camera file's order of heads, which decides whose camera frame the answer is in."""
    heads = [head.name for head in next(iter(sources.values())).truth.camera_spec.head]
    return {name: sources[name] for name in sorted(sources, key=heads.index)}


def observation_from(
    picture: GreyImage,
    estimator: Estimator,
    where: str,
    camera: CameraSpec | None,
    camera_file: str = "",
    known: PriorSpec | Prior | None = None,
) -> Observation:
    """Return what an estimator is given of one picture.

    Parameters
    ----------
    picture : GreyImage
    estimator : Estimator
    where : str
        What errors call the picture.
    camera : CameraSpec or None
        May be left out for our own frames and images, which carry theirs.
    camera_file : str
        For error messages.
    known : PriorSpec or Prior, optional
        What is known beside the image, in place of what a file of ours says.

    Raises
    ------
    UserError
        No camera, or one of another size; a prior that states a sigma alone for a picture without truth; an estimator
        that needs the true pose of such a picture.
    """
    if picture.source is None and estimator.needs == "pose":
        raise UserError(
            f"estimator {estimator.name!r} needs the true pose, which this image does not carry",
            where=where,
            expected="an EXR file written by horizonval",
        )
    if camera is None:
        if picture.source is None:
            raise UserError(
                "this image does not say which camera took it", where=where, fix="give --camera CAMERA.toml"
            )
        return observation_of(picture.source, estimator, known=known)
    height, width = picture.grey.shape
    refuse_other_size(width, height, camera, where, camera_file)
    intrinsics = camera_from_spec(camera.camera)
    check_invertible(intrinsics, where=camera_file)
    recorded = None if picture.source is None else observation_of(picture.source, estimator, known=known)
    if picture.source is not None:
        prior = known_of(picture.source.truth, band_of(picture.source), known)
    elif isinstance(known, Prior):
        prior = known
    else:
        prior = Prior() if known is None else stated_prior(known, where)
    return Observation(
        image=picture.grey,
        camera=intrinsics,
        q_cam_from_body=np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.q_cam_from_body,
        full_scale=_full_scale(picture, camera),
        prior=with_altitude_of(camera, prior),
        band_kind=_band_kind(camera) if recorded is None else recorded.band_kind,
        band_um=_band_um(camera) if recorded is None else recorded.band_um,
        band_width_um=_band_width_um(camera) if recorded is None else recorded.band_width_um,
        lens=None if isinstance(picture.source, RadianceFrame) else stated_lens(camera, _only_band(camera)),
        radiance_per_dn=None if recorded is None else recorded.radiance_per_dn,
        oracle=None if recorded is None else recorded.oracle,
    )


def _only_band(camera: CameraSpec) -> Band | None:
    return camera.band[0] if len(camera.band) == 1 else None


def _band_kind(camera: CameraSpec) -> Literal["solar", "thermal"] | None:
    kinds = {band.kind for band in camera.band}
    return kinds.pop() if len(kinds) == 1 else None


def _band_um(camera: CameraSpec) -> tuple[float, float] | None:
    band = _only_band(camera)
    return None if band is None else limits_um(band)


def _band_width_um(camera: CameraSpec) -> float | None:
    band = _only_band(camera)
    return None if band is None else width_um(band)


def _full_scale(picture: GreyImage, camera: CameraSpec) -> float | None:
    """A 12 bit converter saturates at 4095, also in a 16 bit file; the detector knows, the file does not."""
    if picture.full_scale is None or picture.source is not None or camera.detector is None:
        return picture.full_scale
    return min(picture.full_scale, float(2**camera.detector.bits - 1))


def _report(
    estimator: Estimator,
    result: Fit | Refusal,
    seconds: float,
    sources: Sequence[DetectorImage | RadianceFrame],
    prior: Prior,
) -> dict[str, Any]:
    """Return the keys of the command contract; the truth is used here alone, after the estimator has answered."""
    report: dict[str, Any] = {
        "estimator": estimator.name,
        "status": str(result.status),
        "reason": None,
        "nadir_cam": None,
        "roll_deg": None,
        "pitch_deg": None,
        "altitude_km": None,
        "angular_radius_deg": None,
        "sigma_nadir_arcsec": None,
        "n_points": len(result.points),
        "seconds": round(seconds, 6),
        "assumed": prior.in_words,
        **dict.fromkeys((*ERRORS, *BOUNDS)),
    }
    if sources:
        truth = sources[0].truth
        report |= _bounds(sources)
        errors = score(truth, estimator, result, earth_radius_m=prior.sphere_radius_m)
        report |= {name: getattr(errors, name) for name in ERRORS}
    if isinstance(result, Refusal):
        return report | {"reason": result.reason} | ({"output": result.output} if result.output else {})
    sigma = sigma_nadir_rad(result.nadir_cam, result.total_covariance_nadir_cam) / ARCSEC
    return report | {
        "nadir_cam": [float(x) for x in result.nadir_cam],
        "roll_deg": math.degrees(result.roll_rad),
        "pitch_deg": math.degrees(result.pitch_rad),
        "altitude_km": None if result.altitude_m is None else float(result.altitude_m) / 1e3,
        "angular_radius_deg": None if result.angular_radius_rad is None else math.degrees(result.angular_radius_rad),
        "sigma_nadir_arcsec": sigma if math.isfinite(sigma) else None,
    }


def _bounds(sources: Sequence[DetectorImage | RadianceFrame]) -> dict[str, Any]:
    images = [source for source in sources if isinstance(source, DetectorImage)]
    if not images:
        return {}
    bound = bound_of(together(images), images[0].truth, images[0].band)
    values = zip(BOUNDS, (bound.noise_arcsec, bound.known_arcsec), strict=True)
    return {name: rounded(name, value) for name, value in values}
