"""Derivatives of frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.api.scene import Scene
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.geometry.ellipsoid import Ellipsoid, surface_normal
from horizonval.geometry.frames import north_east
from horizonval.jobs.progress import shown

if TYPE_CHECKING:
    from horizonval.core.progress import Progress
    from horizonval.renderer.description import Described

ROTATIONS, SHIFTS = ("rotation_x", "rotation_y", "rotation_z"), ("east", "north", "up")
AIR_STEPS = {
    "limb_height": ("raised_m", 10.0),
    "temperature": ("warmer_k", 0.5),
    "density": ("denser", 0.003),
    "aerosol": ("dustier", 0.01),
}
"""Field of ``AirChange`` and step of the difference [m, K, relative, relative]."""
ACCURACY = 1e-4
"""Largest ``render.accuracy`` of the differenced frames, which show where patches of tables meet."""
ROTATION_STEP_PX = 1e-3
"""Step of rotations. Rotated frames share the view tables, so that the errors of the tables cancel."""
SHIFT_STEP_PX, LARGEST_SHIFT_M = 0.02, 30.0
"""Step of shifts, in pixels at the limb, and its upper limit."""
SKYLIGHT_FACTOR = 10.0
"""Factor of the steps of shifts with multiple scattering.

Each position has separate tables in single precision, whose rounding errors reach 1 % of the derivative at shorter
steps.
"""
LARGEST_BEND = 0.2
"""Difference of the slopes to both sides that counts as a jump, as a share of their sum; 0.02 at a limb 8 km wide."""
_RADIANCE = "W m-2 sr-1"
UNITS = (
    dict.fromkeys(ROTATIONS, f"{_RADIANCE} rad-1")
    | dict.fromkeys((*SHIFTS, "limb_height"), f"{_RADIANCE} m-1")
    | {"gain": _RADIANCE, "temperature": f"{_RADIANCE} K-1", "density": _RADIANCE, "aerosol": _RADIANCE}
)
Images = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class FrameDerivatives:
    """Derivatives of the radiance of every pixel of a frame; made by :meth:`horizonval.Frame.derivatives`.

    ========================= ================ =====================================================================
    parameter                 unit             what changes
    ========================= ================ =====================================================================
    ``rotation_x`` ``_y _z``  rad              the camera turns about its own axes (x right, y down, z along the
                                               boresight), right-handed
    ``east north up``         m                the camera moves along its local geodetic directions; its attitude, the
                                               Sun and the air stay in Earth-fixed axes
    ``limb_height``           m                the whole air is raised over the ground
    ``gain``                  1                all radiance grows by the same factor
    ``temperature``           K                the air is warmer at all heights, in hydrostatic balance over the same
                                               pressure at the ground; the ground stays
    ``density``               1                all gases grow denser by the same factor
    ``aerosol``               1                all particles grow more by the same factor
    ========================= ================ =====================================================================

    Attributes
    ----------
    images : dict of dict of ndarray, shape (H, W), float32
        By parameter and band: W m-2 sr-1 per unit of the parameter.
    units : dict of str
        By parameter.

    Notes
    -----
    Central differences of whole frames in double precision, over steps of 1e-3 pixel (rotations), 0.02 pixel at the
    limb but at most 30 m (positions; ten times as much in sunlight of all orders), 10 m (height of the limb), 0.5 K,
    0.3 % of density and 1 % of particles.

    Error of the difference, as a share of the largest derivative: with a third of the step 95 % of all pixels agree
    to 4e-4, for positions in the infrared to 1e-3 (its tables are marched in single precision) and in sunlight of all
    orders to 3e-3. Most other pixels have a cell that the hard edge enters or
    leaves between two frames. The tables of light, made to a ``render.accuracy`` of 1e-4 at most, add an error: slopes
    of marched frames differ by 1e-3 in a field of 60 deg and by 3e-2 in one of 0.5 deg.

    A jump has no derivative. Where the differences to both sides disagree, as where a coast or the edge of a cloud
    passes the ray of a cell, a pixel has the smaller of both.

    Examples
    --------
    >>> import horizonval as hv
    >>> frame = hv.open_frame("frame.exr")
    >>> slopes = frame.derivatives(parameters=["rotation_x", "up"])
    >>> slopes.images["up"]["vis"].shape
    (64, 64)
    >>> slopes.jacobian("vis").shape
    (64, 64, 2)
    """

    images: dict[str, dict[str, NDArray[np.float32]]]
    units: dict[str, str]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters in the requested order."""
        return tuple(self.images)

    def jacobian(self, band: str) -> NDArray[np.float32]:
        """Return the derivatives of a band stacked, shape (H, W, parameters); ``UserError`` for an unknown band."""
        for images in self.images.values():
            if band not in images:
                raise UserError(
                    f"no band {band!r}", where="band", expected="one of " + ", ".join(nearest(band, images))
                )
        return np.stack([images[band] for images in self.images.values()], axis=-1)

    def __repr__(self) -> str:
        return f"<FrameDerivatives by {', '.join(self.images)}>"


def derivatives_of(scene: Scene, parameters: Sequence[str] | None, progress: bool | Progress) -> FrameDerivatives:
    """Return the derivatives of the frame of a scene; see :meth:`horizonval.Frame.derivatives`."""
    chosen = tuple(UNITS) if parameters is None else tuple(dict.fromkeys(parameters))
    for name in chosen:
        if name not in UNITS:
            raise UserError(
                f"unknown parameter {name!r}",
                where="Frame.derivatives: parameters",
                expected="some of " + ", ".join(nearest(name, UNITS)),
            )
    with shown(progress) as listener:
        images = image_derivatives(scene, chosen, progress=listener)
    rounded = {p: {band: image.astype(np.float32) for band, image in bands.items()} for p, bands in images.items()}
    return FrameDerivatives(rounded, {p: UNITS[p] for p in chosen})


def image_derivatives(
    scene: Scene, parameters: Sequence[str], *, scale: float = 1.0, progress: Progress | None = None
) -> dict[str, Images]:
    """Return the derivatives of every band by parameters of :data:`UNITS`, in double precision.

    ``scale``: factor of all steps, for error estimates. Raises ``UserError``: a scene with parts, whose illumination
    would change too; else as :func:`horizonval.render`.
    """
    from horizonval.earth.atmosphere.air import AirChange
    from horizonval.renderer.description import describe

    spec, camera = scene.spec, scene.camera.spec
    if spec.part:
        raise UserError(
            "derivatives of frames with parts of the spacecraft in view are not known",
            where="part",
            expected="a scene without [[part]]",
        )
    accuracy = min(spec.render.accuracy, ACCURACY)
    spec = spec.model_copy(update={"render": spec.render.model_copy(update={"accuracy": accuracy})})
    described = describe(spec, camera)
    middle = _radiance(described, progress)
    out: dict[str, Images] = {}
    for parameter in parameters:
        if parameter == "gain":
            out[parameter] = middle
            continue
        if parameter in AIR_STEPS:
            key, step = AIR_STEPS[parameter]
            sides = [describe(spec, camera, AirChange(**{key: s * scale * step})) for s in (1.0, -1.0)]
        else:
            step = _pose_step(described, parameter, spec.render.orders == "all")
            sides = [_displaced(described, parameter, s * scale * step) for s in (1.0, -1.0)]
        above, below = (_radiance(side, progress) for side in sides)
        out[parameter] = {
            band: _difference(above[band], value, below[band], scale * step, parameter not in AIR_STEPS)
            for band, value in middle.items()
        }
    return out


def level_axes(r_itrs: FloatArray, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the unit vectors to the geodetic east, north and zenith at a position, shape (3, 3), one a row."""
    up, east = surface_normal(r_itrs, ellipsoid), north_east(r_itrs)[1]
    return np.stack([east, np.cross(up, east), up])


def _pose_step(described: Described, parameter: str, all_orders: bool) -> float:
    """Return the step of a parameter of the pose [rad or m]."""
    pixel_rad = 1.0 / described.camera.fx
    if parameter in ROTATIONS:
        return ROTATION_STEP_PX * pixel_rad
    r = float(np.linalg.norm(described.sensor.r_itrs))
    to_limb_m = math.sqrt(max(r**2 - described.truth.ellipsoid_b_m**2, 1.0))
    step = min(SHIFT_STEP_PX * pixel_rad * to_limb_m, LARGEST_SHIFT_M)
    return SKYLIGHT_FACTOR * step if all_orders and described.model.nodes else step


def _displaced(described: Described, parameter: str, step: float) -> Described:
    """Return the scene with its camera rotated or moved by a step [rad or m]; Sun, Moon and air stay."""
    sensor = described.sensor
    if parameter in ROTATIONS:
        turn = Rotation.from_rotvec(step * np.eye(3)[ROTATIONS.index(parameter)]).as_matrix()
        return replace(described, sensor=replace(sensor, itrs_from_cam=sensor.itrs_from_cam @ turn))
    axis = level_axes(sensor.r_itrs, described.truth.ellipsoid)[SHIFTS.index(parameter)]
    return replace(described, sensor=replace(sensor, r_itrs=sensor.r_itrs + step * axis))


def _radiance(described: Described, progress: Progress | None) -> Images:
    """Return the radiance of every band before rounding to single precision."""
    from horizonval.renderer.plugins import mitsuba_scene, prepare

    prepare(described.limb, progress)
    scene = mitsuba_scene(described.limb, described.sensor)
    radiance, _ = scene.integrator().radiance(scene.sensors()[0])
    shape = described.camera.height, described.camera.width
    return {band: np.array(values, dtype=np.float64).reshape(shape) for band, values in radiance.items()}


def _difference(above: FloatArray, middle: FloatArray, below: FloatArray, step: float, moves: bool) -> FloatArray:
    """Return the central difference; for moving rays with a jump on one side, the difference to the other."""
    forward, backward = (above - middle) / step, (middle - below) / step
    central = 0.5 * (forward + backward)
    if not moves:
        return central
    jumps = np.abs(forward - backward) > LARGEST_BEND * (np.abs(forward) + np.abs(backward))
    return np.where(jumps, np.where(np.abs(forward) < np.abs(backward), forward, backward), central)
