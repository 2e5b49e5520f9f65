"""What an estimator is given, and what it gives back.

An estimator is a function of an :class:`Observation` that returns a :class:`Fit` or a
:class:`horizonval.core.outcome.Refusal`. It never sees the renderer or the truth, with one exception by definition: the
ideal sensor module, whose input *is* the pose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import roll_pitch_of_nadir


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of a camera's calibration errors.

    ``focal_length_sigma``: common relative error of both focal lengths; ``principal_point_sigma_px``: column and row;
    ``distortion_sigma_px``: radial, at the farthest corner; ``mounting_sigma_rad``: turn about body x, y, z;
    ``exposure_offset_sigma_s``, ``clock_sigma_s``: delay of the image after its stamp, and the clock.
    """

    focal_length_sigma: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion_sigma_px: float = 0.0
    mounting_sigma_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exposure_offset_sigma_s: float = 0.0
    clock_sigma_s: float = 0.0

    @property
    def in_words(self) -> str:
        """What is uncertain of the camera itself, as one line; empty where it is exact."""
        parts = []
        if self.focal_length_sigma > 0.0:
            parts.append(f"focal length to {100.0 * self.focal_length_sigma:g} %")
        if self.principal_point_sigma_px > 0.0:
            parts.append(f"principal point to {self.principal_point_sigma_px:g} px")
        if self.distortion_sigma_px > 0.0:
            parts.append(f"distortion to {self.distortion_sigma_px:g} px")
        return ", ".join(parts)


@dataclass(frozen=True, eq=False)
class Lens:
    """Blur of a lens over the field; by default uniform, with a wide aperture.

    Fits take the overall blur from the image; the guard compares it with ``blur_px``.

    ``angles_rad``: shape (b,), from the axis, rising; ``ratios``: shape (b,), blur without diffraction over its root
    mean square, with light shared linearly between two angles; ``diffraction_px``: mean wavelength times f-number, 0 if
    negligible; ``blur_px``: stated blur, root mean square over the field, None if nothing is stated.
    """

    angles_rad: FloatArray = field(default_factory=lambda: np.zeros(1))
    ratios: FloatArray = field(default_factory=lambda: np.ones(1))
    diffraction_px: float = 0.0
    blur_px: float | None = None

    def shares(self, off_axis_rad: FloatArray) -> FloatArray:
        """Return the weights of the blurs at angles (m,), shape (b, m), linear between angles and clamped."""
        return np.array([np.interp(off_axis_rad, self.angles_rad, one) for one in np.eye(len(self.angles_rad))])

    def in_wider_pixels(self, scale: int) -> Lens:
        """Return the same lens before pixels ``scale`` times as wide."""
        blur = None if self.blur_px is None else self.blur_px / scale
        return replace(self, diffraction_px=self.diffraction_px / scale, blur_px=blur)


@dataclass(frozen=True)
class OraclePose:
    """Pose for sensors that are ideal by definition: where the Earth is, exactly.

    ``r_itrs`` [m] position of the camera, ``q_cam_from_itrs`` scalar-last quaternion, ``radius_m`` Earth radius.
    """

    r_itrs: FloatArray
    q_cam_from_itrs: FloatArray
    radius_m: float


@dataclass(frozen=True)
class Observation:
    """One image and what a flight computer would know beside it.

    Attributes
    ----------
    image : ndarray, shape (H, W)
        Digital numbers, or any grey level that rises or falls with radiance, float64.
    camera : CameraModel
        Intrinsics; ``calibration`` states their errors.
    q_cam_from_body : ndarray, shape (4,)
        Mounting, scalar last. Identity when camera and body axes coincide.
    full_scale : float or None
        Digital number at which the converter saturates.
    prior : Prior
        Knowledge before the image, each value with its standard deviation.
    band_kind : {"solar", "thermal"} or None
        Scattered sunlight or the Earth's own emission.
    band_um : tuple of two floats or None
        First and last wavelength of the band [um].
    band_width_um : float or None
        Integral of the response over wavelength, its peak 1 [um]: band radiance over it is the mean over the band.
    radiance_per_dn : float or None
        Band radiance on the axis per digital number [W m-2 sr-1], from the calibration of a thermal detector or from
        lens, exposure, quantum efficiency and converter of a visible camera.
    lens : Lens or None
        Blur over the field and aperture.
    sun_cam : ndarray, shape (3,), or None
        Direction to the Sun in camera axes, with an error of ``prior.sun_sigma_rad``, or of a coarse sensor without it.
    calibration : Calibration or None
        Errors of camera, mounting and time; None for an exact camera.
    oracle : OraclePose or None
        Only for estimators with ``needs = "pose"``.
    heads : mapping of str to Observation
        Only for estimators with ``needs = "heads"``: images of all heads of one housing at one instant, in the camera
        file's order. The other fields and ``nadir_cam`` of a fit are then those of the first head.

    Examples
    --------
    >>> import horizonval as hv
    >>> def my_method(observation: hv.Observation) -> hv.Fit | hv.Refusal:
    ...     return hv.Refusal(hv.Outcome.NO_LIMB, f"tried {observation}")
    >>> hv.estimate("image.exr", my_method)
    <Refusal no_limb: tried <Observation 64 x 64 px, solar band>>
    """

    image: FloatArray
    camera: CameraModel
    q_cam_from_body: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))
    full_scale: float | None = None
    prior: Prior = field(default_factory=Prior)
    band_kind: Literal["solar", "thermal"] | None = None
    band_um: tuple[float, float] | None = None
    band_width_um: float | None = None
    radiance_per_dn: float | None = None
    lens: Lens | None = None
    sun_cam: FloatArray | None = None
    calibration: Calibration | None = None
    oracle: OraclePose | None = None
    heads: Mapping[str, Observation] = field(default_factory=dict)

    def __repr__(self) -> str:
        height, width = self.image.shape
        heads = f", heads {', '.join(self.heads)}" if self.heads else ""
        return f"<Observation {width} x {height} px, {self.band_kind or 'unknown'} band{heads}>"


@dataclass(frozen=True)
class Fit:
    """A claimed attitude, with the uncertainty it claims.

    Attributes
    ----------
    nadir_cam : ndarray, shape (3,)
        Unit vector in camera axes towards the Earth's centre, or along the geodetic vertical: see ``estimates``.
    covariance_nadir_cam : ndarray, shape (3, 3)
        Covariance [rad^2] of ``nadir_cam`` from the noise of its points; singular along ``nadir_cam`` itself.
    roll_rad, pitch_rad : float
        Body attitude against lvlh: ``nadir_body = (-sin pitch, cos pitch sin roll, cos pitch cos roll)``.
    angular_radius_rad : float or None
        Fitted angular radius rho of the Earth.
    altitude_m, sigma_altitude_m : float or None
    points : ndarray, shape (n, 2)
        Limb points used, (column, row) pixels.
    residuals_rad : ndarray, shape (n,)
        Angular distance of each point from the fitted limb.
    steps : ndarray, shape (k, m)
        Iterates of an iterative method (empty for closed forms), for convergence plots.
    systematic_nadir_cam : ndarray, shape (3, 3), or None
        Covariance [rad^2] of what the method's model leaves out (oblateness, height of the visible limb), which more
        points do not reduce; None if nothing is claimed about it.
    estimates : {"geocentric", "geodetic"}
        Which vertical ``nadir_cam`` is: that of the estimator, set by whoever runs it.

    Examples
    --------
    >>> import horizonval as hv
    >>> import numpy as np
    >>> hv.Fit(nadir_cam=np.array([0.0, 0.0, 1.0]), covariance_nadir_cam=np.zeros((3, 3)), roll_rad=0.0, pitch_rad=0.0)
    <Fit nadir (0.00000, 0.00000, 1.00000), 0 points>
    """

    nadir_cam: FloatArray
    covariance_nadir_cam: FloatArray
    roll_rad: float
    pitch_rad: float
    angular_radius_rad: float | None = None
    altitude_m: float | None = None
    sigma_altitude_m: float | None = None
    points: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    residuals_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    steps: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    systematic_nadir_cam: FloatArray | None = None
    estimates: Literal["geocentric", "geodetic"] = "geocentric"

    @property
    def status(self) -> Outcome:
        return Outcome.VALID

    @property
    def total_covariance_nadir_cam(self) -> FloatArray:
        """Noise and model error together, shape (3, 3)."""
        if self.systematic_nadir_cam is None:
            return self.covariance_nadir_cam
        return self.covariance_nadir_cam + self.systematic_nadir_cam

    def __repr__(self) -> str:
        x, y, z = self.nadir_cam
        altitude = "" if self.altitude_m is None else f", altitude {self.altitude_m / 1e3:.1f} km"
        return f"<Fit nadir ({x:.5f}, {y:.5f}, {z:.5f}), {len(self.points)} points{altitude}>"


def fit_of_nadir(
    observation: Observation,
    nadir_cam: FloatArray,
    covariance: FloatArray,
    rho_rad: float | None = None,
    sigma_rho_rad: float | None = None,
    **others: Any,
) -> Fit:
    """Return the fit that a nadir in camera axes means: attitude of the body, and altitude ``R / sin rho - R``.

    ``covariance``: shape (3, 3); ``rho_rad``: angular radius of the Earth; ``others``: further fields of the fit.
    """
    roll, pitch = roll_pitch_of_nadir(Rotation.from_quat(observation.q_cam_from_body).inv().apply(nadir_cam))
    radius, altitude, sigma = observation.prior.sphere_radius_m, None, None
    if rho_rad is not None and 0.0 < rho_rad < 0.5 * np.pi:
        altitude = float(radius / np.sin(rho_rad) - radius)
        if sigma_rho_rad is not None:
            sigma = float(radius * np.cos(rho_rad) / np.sin(rho_rad) ** 2 * sigma_rho_rad)
    given = {name: value for name, value in others.items() if value is not None}
    return Fit(nadir_cam, covariance, float(roll), float(pitch), rho_rad, altitude, sigma, **given)


@dataclass(frozen=True)
class Estimator:
    """A named method. ``run`` must not raise for any image.

    Attributes
    ----------
    name, title : str
    run : callable
    estimates : {"geocentric", "geodetic"}
        Which vertical is claimed.
    needs : {"image", "pose", "heads"}
    claim : {"cone", "likelihood"}
        By which rule a claim is judged false (:func:`horizonval.scoring.limits.claim_limits`): as the fit of a cone to
        points, whose covariance may leave out the height of the limb, or more strictly as a likelihood fit, whose
        covariance claims everything.
    from_points : callable, optional
        The method behind its own search for points: (lines of sight (n, 3), pixels (n, 2), observation) to a result.
        A guard that has found limb points it trusts hands them over here.
    from_heads : callable, optional
        The same of a method of several heads: (pixels (n, 2) by the heads' names, observation) to a result.

    Examples
    --------
    >>> import horizonval as hv
    >>> never = hv.Estimator("never", "Refuses", run=lambda observation: hv.Refusal(hv.Outcome.NO_LIMB, "as always"))
    >>> hv.estimate("image.exr", never)
    <Refusal no_limb: as always>
    """

    name: str
    title: str
    run: Callable[[Observation], Fit | Refusal]
    estimates: Literal["geocentric", "geodetic"] = "geocentric"
    needs: Literal["image", "pose", "heads"] = "image"
    claim: Literal["cone", "likelihood"] = "cone"
    from_points: Callable[[FloatArray, FloatArray, Observation], Fit | Refusal] | None = None
    from_heads: Callable[[Mapping[str, FloatArray], Observation], Fit | Refusal] | None = None

    def __repr__(self) -> str:
        return f"<Estimator {self.name}: {self.title}>"
