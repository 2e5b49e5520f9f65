"""One estimator on any image, the error of its answer, and the readings of an ideal sensor there."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from horizonval.api.camera import Camera, camera_of
from horizonval.core.errors import UserError, nearest
from horizonval.core.outcome import Refusal
from horizonval.earth.spectral.bands import limits_um, width_um
from horizonval.estimation.fit.templates import templates_of
from horizonval.estimation.methods.ideal import ReadingStatus, horizon_sensor
from horizonval.estimation.observation import Calibration, Estimator, Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.camera import camera_from_spec, check_invertible
from horizonval.plugins import registry, supervisor
from horizonval.plugins.onnx_model import is_model, model_estimator
from horizonval.plugins.supervisor import Limits
from horizonval.scoring.bound import NO_BOUND, known_bound
from horizonval.scoring.errors import ARCSEC, sigma_nadir_rad
from horizonval.scoring.errors import score as scored
from horizonval.scoring.row import Score, rounded
from horizonval.sensor.expected_image import stated_lens
from horizonval.sensor.knowledge import calibration_of_camera, refuse_unknown_climate, stated_prior
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import find
from horizonval.spec.load import load_frames, load_prior, read_toml, validate
from horizonval.spec.prior import PriorSpec, is_limb_table
from horizonval.spec.suite import StudyHead, StudySpec, SuiteHead, SuiteSpec
from horizonval.store import exr
from horizonval.store.picture import GreyImage, picture_of_array, picture_of_source, read_picture, refuse_other_size
from horizonval.suites.observation import (
    band_of,
    known_of,
    method_radius_m,
    observation_of,
    observation_of_heads,
    oracle_pose,
    with_altitude_of,
)

if TYPE_CHECKING:
    from horizonval.core.progress import Progress
    from horizonval.tables.mission import MissionTable

AnyImage: TypeAlias = DetectorImage | RadianceFrame | str | Path | NDArray[Any]
AnyEstimator: TypeAlias = str | Estimator | Callable[[Observation], Fit | Refusal]
AnyCamera: TypeAlias = Camera | str | Path | Mapping[str, Any]
AnyPrior: TypeAlias = Prior | PriorSpec | str | Path
Source: TypeAlias = DetectorImage | RadianceFrame

ERRORS = ("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec", "altitude_error_km", "false_valid")
"""Keys of an answer whose image carries the truth, named as the columns of the results."""

BOUNDS = ("bound_noise_arcsec", "bound_arcsec")
"""Keys of the smallest errors that the limb allows, named as the columns of the results."""


def estimate(
    image: AnyImage | Sequence[Source | str | Path],
    estimator: AnyEstimator,
    *,
    camera: AnyCamera | None = None,
    prior: AnyPrior | None = None,
    part: str | int | None = None,
    orientation: str | None = None,
) -> Fit | Refusal:
    """Run one estimator on an image: an attitude, or a refusal with its reason.

    Parameters
    ----------
    image : Image, Frame, str, Path, ndarray, or a sequence of them
        An image or frame; the file of one; another program's picture; pixels of shape (H, W) or (H, W, channels). A
        method of several heads takes one image or frame for each head.
    estimator : str, Estimator or callable
        A name (:func:`horizonval.list_estimators`), the path of an ONNX file, or a function from an ``Observation`` to
        a ``Fit`` or a ``Refusal``, as it is or wrapped in an ``Estimator``.
    camera : Camera, str, Path or mapping, optional
        The camera of a foreign image; images of this package carry theirs.
    prior : Prior, str or Path, optional
        What is known in addition to the image, or a file with a table ``[prior]``. Replaces the prior that the image
        carries. A file may state a sigma without a value, which is then sampled about the image's truth.
    part : str or int, optional
        The picture of a file that holds several: its name, or its number from 1.
    orientation : {"stored", "shown"}, optional
        Whether the camera describes the stored pixels of a file whose tag turns them, or what viewers show.

    Raises
    ------
    UserError
        No such estimator, no image, no camera or one of another size, a prior that does not go with the image.
        Errors inside the estimator are results, not exceptions.

    Examples
    --------
    >>> import horizonval as hv
    >>> image = hv.open_image("image.exr")
    >>> fit = hv.estimate(image, "altitude-free")
    >>> str(fit.status), fit.nadir_cam.shape
    ('valid', (3,))
    >>> small = hv.Prior(shape="sphere", radius_m=6300e3)
    >>> hv.estimate(image, "altitude-free", prior=small).altitude_m < fit.altitude_m
    True
    >>> refusal = hv.estimate(image.dn * 0, "altitude-free", camera="mycam.toml")
    >>> str(refusal.status), bool(refusal)
    ('dark', False)
    """
    method = estimator_of(estimator)
    return registry.run_safely(method, _observed(image, method, camera, prior, part, orientation)[0])


def estimate_report(
    image: AnyImage | Sequence[Source | str | Path],
    estimator: AnyEstimator,
    *,
    camera: AnyCamera | None = None,
    prior: AnyPrior | None = None,
    part: str | int | None = None,
    orientation: str | None = None,
) -> dict[str, Any]:
    """Run one estimator on an image and return the content of ``horizonval estimate --json``.

    Parameters as for :func:`estimate`. An image with its truth also has the errors against it (:data:`ERRORS`,
    :data:`BOUNDS`); the estimator does not receive the truth. Keys that do not apply are None.
    """
    method = estimator_of(estimator)
    observation, sources = _observed(image, method, camera, prior, part, orientation)
    start = time.perf_counter()
    result = registry.run_safely(method, observation)
    return _report(method, result, time.perf_counter() - start, sources, observation)


def score(fit: Fit | Refusal, frame: RadianceFrame | DetectorImage) -> Score:
    """Compare an answer with the truth that a frame, or an image of it, carries.

    Returns
    -------
    Score
        Errors of nadir, roll, pitch and altitude, consistency with the claimed covariance, and whether the claim is
        false; None for what does not apply, as all errors of a refusal.

    Examples
    --------
    >>> import horizonval as hv
    >>> image = hv.open_image("image.exr")
    >>> hv.score(hv.estimate(image, "ideal"), image).nadir_error_deg < 1e-9
    True
    """
    return scored(frame.truth, None, fit, earth_radius_m=method_radius_m(frame.truth))


def horizon_report(image: Source | FrameTruth | str | Path) -> dict[str, Any]:
    """Return what :func:`horizonval.horizon_sensor` reads [deg] at the pose of an image, truth or image file.

    The Earth is the sphere with the mean angular radius of the horizon. None where the sensor reads nothing. Pixels are
    not used.
    """
    if isinstance(image, str | Path):
        truth = FrameTruth.from_dict(exr.read_header(Path(image))["truth"])
    else:
        truth = image if isinstance(image, FrameTruth) else image.truth
    pose = oracle_pose(truth)
    found = horizon_sensor(pose.r_itrs, pose.q_cam_from_itrs, pose.radius_m)
    defined = found.status is ReadingStatus.DEFINED

    def degrees(angle_rad: float) -> float | None:
        return math.degrees(angle_rad) if defined else None

    return {
        "status": str(found.status),
        "roll_error_deg": degrees(found.roll_error_rad),
        "pitch_error_deg": degrees(found.pitch_error_rad),
        "roll_elevation_deg": degrees(found.roll_elevation_rad),
        "pitch_elevation_deg": degrees(found.pitch_elevation_rad),
        "horizon_cam": np.asarray(found.horizon_cam).tolist() if defined else None,
        "nadir_cam": list(truth.nadir_geocentric_cam),
        "angular_radius_deg": math.degrees(truth.angular_radius_rad),
        "roll_deg": math.degrees(truth.roll_rad),
        "pitch_deg": math.degrees(truth.pitch_rad),
        "altitude_km": truth.altitude_m / 1e3,
    }


def mission_table(
    target: str,
    band: str | None = None,
    error: float = 0.005,
    air: str | None = None,
    clear: bool = False,
    progress: Progress | None = None,
) -> MissionTable:
    """Return the table of limb profiles that a fit needs for the frames of a suite or scene.

    Raises ``UserError``: no such file; several bands; no table for the band; no limb in view; an unknown or varying
    air.

    Parameters
    ----------
    target : str
        File or shipped name of a suite or scene.
    band : str, optional
        Required where the cameras have several bands.
    error : float
        Largest difference to the full table, as a share of a profile's largest value.
    air : str, optional
        Name of an atmosphere, or a profile file: a table for this known air instead of the shipped climate.
    clear : bool
        Whether the table has no clouds.
    progress : Progress, optional
    """
    from horizonval.api.check import kind_of
    from horizonval.suites.suite import load_suite
    from horizonval.tables import mission

    kind, path = kind_of(target)
    if kind == "study":
        raise UserError("is a study", where=target, expected="a suite or a scene")
    cases = load_suite(path).cases if kind == "suite" else load_frames(path)
    return mission.mission_table(cases, target, band, error, air, clear, progress)


def estimator_of(estimator: AnyEstimator, suite: str | Path | None = None) -> Estimator:
    """Return an estimator from an estimator, a name, an ONNX file or a function.

    ``suite``: suite or study whose programs (``[[estimator]]``) a name may be. Raises ``UserError``: an unknown name or
    an invalid file.
    """
    if isinstance(estimator, Estimator):
        return estimator
    if isinstance(estimator, str):
        if suite is not None:
            return _program_of(suite, estimator)
        return model_estimator(estimator) if is_model(estimator) else supervisor.get(estimator)
    if callable(estimator):
        name = getattr(estimator, "__name__", type(estimator).__name__)
        return Estimator(name=name, title=name, run=estimator)
    raise UserError(
        f"found a {type(estimator).__name__}", where="estimator", expected="a name, an Estimator, or a function"
    )


def _program_of(suite: str | Path, name: str) -> Estimator:
    """Return an estimator of a suite or study: one of its programs, or an installed one."""
    path = find("suite", suite)
    data = read_toml(path)
    head: StudyHead | SuiteHead
    if "study" in data:
        study = validate(StudySpec, data, str(path))
        head, programs = study.study, study.estimator
    else:
        spec = validate(SuiteSpec, data, str(path))
        head, programs = spec.suite, spec.estimator
    for program in programs:
        if program.name == name:
            return supervisor.get(
                name, Limits(head.time_limit_s, head.memory_limit_mb, (program,), path.resolve().parent)
            )
    if name in head.estimators:
        return supervisor.get(name)
    known = nearest(name, [*(program.name for program in programs), *head.estimators])
    raise UserError(f"no estimator {name!r}", where=str(path), expected=f"one of {', '.join(known)}")


def prior_from(path: str | Path) -> PriorSpec:
    """Return the content of a file with a table ``[prior]``."""
    spec = load_prior(path)
    try:
        refuse_unknown_climate(spec)
        if spec.climate is not None and is_limb_table(spec.climate):
            templates_of(Path(spec.climate))
    except UserError as e:
        raise e.inside(str(path)) from e
    return spec


def _observed(
    image: AnyImage | Sequence[Source | str | Path],
    estimator: Estimator,
    camera: AnyCamera | None,
    prior: AnyPrior | None,
    part: str | int | None,
    orientation: str | None,
) -> tuple[Observation, list[Source]]:
    """Return the observation for an estimator, and the images and frames of this package among the sources."""
    known = prior_from(prior) if isinstance(prior, str | Path) else prior
    if not isinstance(image, Sequence) or isinstance(image, str):
        taken_by = None if camera is None else camera_of(camera)
        return observation_from(image, estimator, taken_by, known, part, orientation)
    if camera is not None:
        raise UserError("used with several images", where="camera", expected="our own images, which carry theirs")
    pictures = [
        (str(one) if isinstance(one, str | Path) else f"image {number}", _picture_of(one, None, part, orientation))
        for number, one in enumerate(image, 1)
    ]
    sources = sources_of_heads(pictures, estimator)
    return observation_of_heads(sources, estimator, known), list(sources.values())


def sources_of_heads(pictures: Sequence[tuple[str, GreyImage]], estimator: Estimator) -> dict[str, Source]:
    """Return the images of all heads of one housing by head, in the camera file's order.

    The answer is in the camera frame of the first. ``pictures``: name for errors, and picture.
    """
    if estimator.needs != "heads":
        names = ", ".join(name for name, _ in pictures)
        raise UserError(f"estimator {estimator.name!r} takes one image, not {len(pictures)}", where=names)
    sources: dict[str, Source] = {}
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
    heads = [head.name for head in next(iter(sources.values())).truth.camera_spec.head]
    return {name: sources[name] for name in sorted(sources, key=heads.index)}


def observation_from(
    image: AnyImage,
    estimator: Estimator,
    camera: Camera | None = None,
    known: PriorSpec | Prior | None = None,
    part: str | int | None = None,
    orientation: str | None = None,
) -> tuple[Observation, list[Source]]:
    """Return the observation of one image, and the image if it is of this package; as :func:`estimate`."""
    where = str(image) if isinstance(image, str | Path) else "image"
    picture = _picture_of(image, camera, part, orientation)
    source = picture.source
    if source is None and estimator.needs == "pose":
        raise UserError(
            f"estimator {estimator.name!r} needs the true pose, which this image does not carry",
            where=where,
            expected="an EXR file written by horizonval",
        )
    recorded = None if source is None else observation_of(source, estimator, known=known)
    if camera is None:
        if source is None or recorded is None:
            raise UserError(
                "this image does not say which camera took it", where=where, fix="give --camera CAMERA.toml"
            )
        return recorded, [source]
    spec = camera.spec
    height, width = picture.grey.shape
    refuse_other_size(width, height, spec, where, camera.source)
    intrinsics = camera_from_spec(spec.camera)
    check_invertible(intrinsics, where=camera.source)
    if source is not None:
        prior = known_of(source.truth, band_of(source), known)
    elif isinstance(known, Prior):
        prior = known
    else:
        prior = Prior() if known is None else stated_prior(known, where)
    band = spec.band[0] if len(spec.band) == 1 else None
    exact = source is not None and spec.camera.uncertainty is None
    return Observation(
        image=picture.grey,
        camera=intrinsics,
        q_cam_from_body=np.array([0.0, 0.0, 0.0, 1.0]) if recorded is None else recorded.q_cam_from_body,
        full_scale=_full_scale(picture, spec),
        prior=with_altitude_of(spec, prior),
        band_kind=_band_kind(spec) if recorded is None else recorded.band_kind,
        band_um=(None if band is None else limits_um(band)) if recorded is None else recorded.band_um,
        band_width_um=(None if band is None else width_um(band)) if recorded is None else recorded.band_width_um,
        lens=None if isinstance(source, RadianceFrame) else stated_lens(spec, band),
        radiance_per_dn=None if recorded is None else recorded.radiance_per_dn,
        calibration=None if exact else calibration_of_camera(spec.camera),
        oracle=None if recorded is None else recorded.oracle,
    ), [] if source is None else [source]


def _picture_of(image: AnyImage, camera: Camera | None, part: str | int | None, orientation: str | None) -> GreyImage:
    if isinstance(image, str | Path):
        spec, source = (None, "") if camera is None else (camera.spec, camera.source)
        wanted = None if part is None else str(part)
        return read_picture(Path(image), spec, source, part=wanted, orientation=orientation)
    if part is not None or orientation is not None:
        raise UserError("given for an image that is no file", where="part, orientation", expected="the path of a file")
    if isinstance(image, DetectorImage | RadianceFrame):
        return picture_of_source(image)
    if isinstance(image, np.ndarray) and image.ndim in (2, 3) and image.size and image.dtype.kind in "uif":
        return picture_of_array(image)
    shape = f" of shape {image.shape}" if isinstance(image, np.ndarray) else ""
    raise UserError(
        f"found a {type(image).__name__}{shape}", where="image", expected="an image, its file, or an array (H, W)"
    )


def _band_kind(camera: CameraSpec) -> Literal["solar", "thermal"] | None:
    kinds = {band.kind for band in camera.band}
    return kinds.pop() if len(kinds) == 1 else None


def _full_scale(picture: GreyImage, camera: CameraSpec) -> float | None:
    """A 12 bit converter saturates at 4095 even in a 16 bit file, which does not state it."""
    if picture.full_scale is None or picture.source is not None or camera.detector is None:
        return picture.full_scale
    return min(picture.full_scale, float(2**camera.detector.bits - 1))


def _report(
    estimator: Estimator,
    result: Fit | Refusal,
    seconds: float,
    sources: Sequence[Source],
    observation: Observation,
) -> dict[str, Any]:
    """Return the keys of the command contract; only this function, after the answer, uses the truth."""
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
        "assumed": "; ".join(
            filter(None, [observation.prior.in_words, (observation.calibration or Calibration()).in_words])
        ),
        **dict.fromkeys((*ERRORS, *BOUNDS)),
    }
    if sources:
        truth = sources[0].truth
        report |= _bounds(sources)
        errors = scored(truth, estimator, result, earth_radius_m=observation.prior.sphere_radius_m)
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


def _bounds(sources: Sequence[Source]) -> dict[str, Any]:
    images = [source for source in sources if isinstance(source, DetectorImage)]
    if not images:
        return {}
    bound = known_bound(images, images[0].truth, images[0].band) or NO_BOUND
    values = zip(BOUNDS, (bound.noise_arcsec, bound.known_arcsec), strict=True)
    return {name: rounded(name, value) for name, value in values}
