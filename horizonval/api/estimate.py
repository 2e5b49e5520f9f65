"""One estimator on any image, and how far its answer is from the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from horizonval.api.camera import Camera, camera_of
from horizonval.commands.estimate import estimator_of, observation_from, observation_from_heads, prior_from
from horizonval.commands.picture import GreyImage, picture_of_array, picture_of_source, read_picture
from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation import registry
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.scoring.errors import score as scored
from horizonval.scoring.row import Score
from horizonval.spec.camera import CameraSpec
from horizonval.suites.observation import method_radius_m

AnyImage: TypeAlias = DetectorImage | RadianceFrame | str | Path | NDArray[Any]
AnyEstimator: TypeAlias = str | Estimator | Callable[[Observation], Fit | Refusal]


def estimate(
    image: AnyImage | Sequence[DetectorImage | RadianceFrame | str | Path],
    estimator: AnyEstimator,
    *,
    camera: Camera | str | Path | Mapping[str, Any] | None = None,
    prior: Prior | str | Path | None = None,
) -> Fit | Refusal:
    """Run one estimator on an image: an attitude, or a refusal that says why.

    Parameters
    ----------
    image : Image, Frame, str, Path, ndarray, or a sequence of them
        One of ours; the file of one; a PNG, TIFF or JPEG; pixels of shape (H, W) or (H, W, channels). Of a method of
        several heads one of ours for each head.
    estimator : str, Estimator or callable
        A name (:func:`horizonval.list_estimators`), an ONNX file's path, or a method of your own: a function from an
        ``Observation`` to a ``Fit`` or a ``Refusal``, wrapped in an ``Estimator`` or not.
    camera : Camera, str, Path or mapping, optional
        Of an image that does not carry its own.
    prior : Prior, str or Path, optional
        What is known beside the image, or a file of a table ``[prior]``. In place of what an image of ours says of
        itself; a file may state a sigma alone for it, whose value is then drawn about the image's truth.

    Returns
    -------
    Fit or Refusal
        A refusal is false: ``if fit: ...``.

    Raises
    ------
    UserError
        No such estimator, no image, no camera or one of another size, a prior that does not go with the image.
        Whatever the estimator does, errors included, is a result.

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
    method = _estimator_of(estimator)
    known = prior_from(prior) if isinstance(prior, str | Path) else prior
    if isinstance(image, Sequence) and not isinstance(image, str):
        if camera is not None:
            raise UserError("used with several images", where="camera", expected="our own images, which carry theirs")
        return registry.run_safely(method, observation_from_heads(_named(image), method, known))
    camera_object = None if camera is None else camera_of(camera)
    spec, source = (None, "") if camera_object is None else (camera_object.spec, camera_object.source)
    observation = observation_from(_picture_of(image, spec, source), method, _name(image), spec, source, known)
    return registry.run_safely(method, observation)


def score(fit: Fit | Refusal, frame: RadianceFrame | DetectorImage) -> Score:
    """Compare an answer with the truth of its frame.

    Parameters
    ----------
    fit : Fit or Refusal
    frame : Frame or Image
        The frame, or an image made of it: both carry the truth.

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


def _estimator_of(estimator: AnyEstimator) -> Estimator:
    if isinstance(estimator, Estimator):
        return estimator
    if isinstance(estimator, str):
        return estimator_of(estimator)
    if callable(estimator):
        name = getattr(estimator, "__name__", type(estimator).__name__)
        return Estimator(name=name, title=name, run=estimator)
    raise UserError(
        f"found a {type(estimator).__name__}", where="estimator", expected="a name, an Estimator, or a function"
    )


def _named(images: Sequence[Any]) -> list[tuple[str, GreyImage]]:
    return [
        (str(image) if isinstance(image, str | Path) else f"image {number}", _picture_of(image))
        for number, image in enumerate(images, 1)
    ]


def _name(image: AnyImage) -> str:
    return str(image) if isinstance(image, str | Path) else "image"


def _picture_of(image: AnyImage, camera: CameraSpec | None = None, camera_file: str = "") -> GreyImage:
    if isinstance(image, str | Path):
        return read_picture(Path(image), camera, camera_file)
    if isinstance(image, DetectorImage | RadianceFrame):
        return picture_of_source(image)
    if isinstance(image, np.ndarray) and image.ndim in (2, 3) and image.size and image.dtype.kind in "uif":
        return picture_of_array(image)
    shape = f" of shape {image.shape}" if isinstance(image, np.ndarray) else ""
    raise UserError(
        f"found a {type(image).__name__}{shape}", where="image", expected="an image, its file, or an array (H, W)"
    )
