"""Our camera and our attitude as modules of Basilisk (AVS Lab).

:class:`CameraModule` reads the spacecraft's state, asks for the image of it, and publishes a ``CameraImageMsg`` for
each head: the bytes of a PNG in memory, as Basilisk's image modules take them. :class:`AttitudeModule` hands the
images to an estimator and publishes a ``NavAttMsg``: the prior attitude, tilted so that its nadir is
the measured one. A horizon does not measure the turn about the nadir; that is unchanged.

Needs the package ``bsk`` (extra ``basilisk``). A simulation whose central body is not the frame's origin links
``planetInMsg``. Times are the simulation's, counted from ``epoch_utc``; Basilisk's orientation of the Earth is not
used.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.api.client import Client, ServedImage
from horizonval.bridges.attitudes import mrp_of_quaternion, quaternion_of_mrp, request_of_state
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit
from horizonval.estimation.prior import Prior
from horizonval.geometry import clock
from horizonval.geometry.frames import rotate
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.plugins import registry, supervisor
from horizonval.spec.base import in_utc
from horizonval.suites.observation import observation_of

try:
    from Basilisk.architecture import messaging, swig_common_model, sysModel
except ImportError:
    raise UserError(
        "the package bsk is not installed",
        where="Basilisk",
        fix="install the extra `basilisk`: pip install 'horizonval[basilisk]'",
    ) from None

_DOUBLE_BYTES = 8


class CameraModule(sysModel.SysModel):
    """Publishes the detector image of the spacecraft's state at every tick of its task.

    Parameters
    ----------
    images : Client or LocalClient
        The server, or its form in this process.
    epoch_utc : datetime
        Start of the simulation; without a time zone it is UTC. Also an attribute.
    heads : sequence of str, optional
        Of a camera with several, those to ask for.
    seed : int
        Image ``k`` of the simulation has the noise of seed ``seed + k``.
    bits : {8, 16}
        Of the PNG: 8 as Basilisk's modules expect, the digital numbers scaled to 255; 16 for the numbers as they are.

    Attributes
    ----------
    scStateInMsg : SCStatesMsgReader
    planetInMsg : SpicePlanetStateMsgReader
        The Earth, where the frame's origin is elsewhere.
    cameraImageOutMsg : CameraImageMsg
        Of the first head.
    cameraImageOutMsgs : list of CameraImageMsg
        Of every head. The memory that a message points to lasts until the next image.
    served : list of ServedImage
        The last images, with their truth, of every head.
    time_ns : int
        Of them; -1 before the first.
    taken : int
        How many instants have had their images.

    Raises
    ------
    UserError
        Other bits; from the simulation's steps no linked state, and what the server refuses.
    """

    def __init__(
        self,
        images: Client,
        epoch_utc: datetime,
        *,
        heads: Sequence[str] = (),
        seed: int = 0,
        bits: int = 8,
    ) -> None:
        super().__init__()
        self.ModelTag = "horizonCamera"
        if bits not in (8, 16):
            raise UserError(f"found {bits!r}", where="CameraModule: bits", expected="8 or 16")
        self._images, self._seed, self._bits = images, seed, bits
        self.epoch_utc = in_utc(epoch_utc)
        self._heads: tuple[str | None, ...] = tuple(heads) or (None,)
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self.planetInMsg = messaging.SpicePlanetStateMsgReader()
        self.cameraImageOutMsgs = [messaging.CameraImageMsg() for _ in self._heads]
        self.cameraImageOutMsg = self.cameraImageOutMsgs[0]
        self._buffers: list[Any] = [None] * len(self._heads)
        self.served: list[ServedImage] = []
        self.time_ns, self.taken = -1, 0

    def Reset(self, CurrentSimNanos: int) -> None:
        """Start again; the first image has the first seed."""
        if not self.scStateInMsg.isLinked():
            raise UserError(
                "not linked", where="CameraModule: scStateInMsg", fix="subscribe it to the spacecraft's scStateOutMsg"
            )
        self.served, self.time_ns, self.taken = [], -1, 0

    def UpdateState(self, CurrentSimNanos: int) -> None:
        """Ask for the images of the state, and publish them."""
        state = self.scStateInMsg()
        r, v = np.array(state.r_BN_N), np.array(state.v_BN_N)
        if self.planetInMsg.isLinked():
            planet = self.planetInMsg()
            r, v = r - np.array(planet.PositionVector), v - np.array(planet.VelocityVector)
        pose = request_of_state(self.instant(CurrentSimNanos), r, v, state.sigma_BN, state.omega_BN_B)
        self.served = [
            self._images.image(**pose, seed=self._seed + self.taken, head=head, truth=True) for head in self._heads
        ]
        self.time_ns, self.taken = CurrentSimNanos, self.taken + 1
        for number, image in enumerate(self.served):
            self._publish(number, image, CurrentSimNanos)

    def instant(self, nanoseconds: int) -> datetime:
        """Return the instant of a simulation's time, to the microsecond."""
        return clock.utc_at(clock.tai_of(self.epoch_utc) + nanoseconds)

    def _publish(self, number: int, image: ServedImage, nanoseconds: int) -> None:
        png = png_of(image.dn, image.full_scale, self._bits)
        # The bindings take an address for `void *` only from an array that they allocated themselves.
        buffer = swig_common_model.new_doubleArray(-(-len(png) // _DOUBLE_BYTES))
        ctypes.memmove(int(buffer), png, len(png))
        payload = messaging.CameraImageMsgPayload()
        payload.timeTag, payload.valid, payload.cameraID = nanoseconds, 1, number + 1
        payload.imagePointer, payload.imageBufferLength, payload.imageType = buffer, len(png), 1
        self.cameraImageOutMsgs[number].write(payload, nanoseconds, self.moduleID)
        self._free(number)
        self._buffers[number] = buffer

    def _free(self, number: int) -> None:
        if self._buffers[number] is not None:
            swig_common_model.delete_doubleArray(self._buffers[number])
            self._buffers[number] = None


class AttitudeModule(sysModel.SysModel):
    """Publishes the attitude that an estimator finds in a camera's new images; after a refusal nothing new.

    Stands after its camera in the same task. The message's ``timeTag`` is that of the image, so that readers see
    whether it is new.

    Parameters
    ----------
    camera : CameraModule
    estimator : str or Estimator
        One that claims the geocentric nadir. Of a camera with several heads one that takes all of them.
    position_sigma_m : float
        Standard deviation of each component of ``transInMsg``.
    attitude_sigma_deg : float
        Standard deviation of ``attitudeInMsg`` about each axis, as the estimator gets it: large, so that the image
        decides the answer; the estimator searches for the nadir around it.

    Attributes
    ----------
    attitudeInMsg : NavAttMsgReader
        The attitude as it is known without the images, for instance propagated by a gyro.
    transInMsg : NavTransMsgReader
        The position as it is known.
    navAttOutMsg : NavAttMsg
    fit : Fit or Refusal
        The last answer.
    nadir_body : ndarray, shape (3,), or None
        Measured unit vector; None after a refusal.
    covariance_nadir_body : ndarray, shape (3, 3), or None
        As the estimator claims it, noise and model [rad^2].
    time_ns : int
        Of the image that was last estimated.

    Raises
    ------
    UserError
        No such estimator, or one that claims the geodetic vertical; from the simulation's steps inputs that are not
        linked.
    """

    def __init__(
        self,
        camera: CameraModule,
        estimator: str | Estimator,
        *,
        position_sigma_m: float = 50.0,
        attitude_sigma_deg: float = 3.0,
    ) -> None:
        super().__init__()
        self.ModelTag = "horizonAttitude"
        self._camera = camera
        self._estimator = supervisor.get(estimator) if isinstance(estimator, str) else estimator
        if self._estimator.estimates != "geocentric":
            raise UserError(
                f"{self._estimator.name!r} claims the {self._estimator.estimates} vertical",
                where="AttitudeModule: estimator",
                expected="one that claims the geocentric nadir",
            )
        self._position_sigma_m = position_sigma_m
        self._attitude_sigma_rad = np.full(3, np.radians(attitude_sigma_deg))
        self.attitudeInMsg = messaging.NavAttMsgReader()
        self.transInMsg = messaging.NavTransMsgReader()
        self.navAttOutMsg = messaging.NavAttMsg()
        self.Reset(0, linked=False)

    def Reset(self, CurrentSimNanos: int, *, linked: bool = True) -> None:
        """Forget the last answer."""
        for name in ("attitudeInMsg", "transInMsg"):
            if linked and not getattr(self, name).isLinked():
                raise UserError("not linked", where=f"AttitudeModule: {name}", fix="subscribe it to a message")
        self.fit: Fit | Refusal = Refusal(Outcome.NO_LIMB, "no image yet")
        self.nadir_body: FloatArray | None = None
        self.covariance_nadir_body: FloatArray | None = None
        self.time_ns = -1

    def UpdateState(self, CurrentSimNanos: int) -> None:
        """Estimate, and publish what was found."""
        if self._camera.time_ns in (-1, self.time_ns):
            return
        self.time_ns = self._camera.time_ns
        known, place = self.attitudeInMsg(), self.transInMsg()
        body_from_gcrs = Rotation.from_quat(quaternion_of_mrp(known.sigma_BN))
        self.fit = self._estimate(body_from_gcrs, np.array(place.r_BN_N))
        if isinstance(self.fit, Refusal):
            self.nadir_body = self.covariance_nadir_body = None
            return
        body_from_cam = Rotation.from_quat(self._mounting(self._camera.served[0])).inv().as_matrix()
        self.nadir_body = body_from_cam @ self.fit.nadir_cam
        self.covariance_nadir_body = body_from_cam @ self.fit.total_covariance_nadir_cam @ body_from_cam.T
        down_gcrs = -np.array(place.r_BN_N) / np.linalg.norm(place.r_BN_N)
        tilted = _least_turn(body_from_gcrs.apply(down_gcrs), self.nadir_body) * body_from_gcrs
        payload = messaging.NavAttMsgPayload()
        payload.timeTag = self.time_ns * 1e-9
        payload.sigma_BN = mrp_of_quaternion(tilted.as_quat()).tolist()
        payload.omega_BN_B = known.omega_BN_B
        self.navAttOutMsg.write(payload, CurrentSimNanos, self.moduleID)

    @staticmethod
    def _mounting(image: ServedImage) -> FloatArray:
        return np.array(image.image.truth.q_cam_from_body)

    def _estimate(self, body_from_gcrs: Rotation, r_gcrs: NDArray[np.float64]) -> Fit | Refusal:
        """Return the estimator's answer. Of the truth in an image it gets camera and mounting, and a coarse Sun."""
        instant = self._camera.instant(self.time_ns)
        turn = itrs_from_gcrs(instant)
        body_from_itrs = body_from_gcrs * Rotation.from_matrix(turn.T)
        observations = {}
        for image in self._camera.served:
            cam_from_itrs = Rotation.from_quat(self._mounting(image)) * body_from_itrs
            prior = Prior(
                shape="wgs84",
                r_itrs=rotate(Rotation.from_matrix(turn).as_quat(), r_gcrs),
                position_sigma_m=self._position_sigma_m,
                q_cam_from_itrs=cam_from_itrs.as_quat(canonical=True),
                attitude_sigma_rad=self._attitude_sigma_rad,
                epoch_utc=instant,
            )
            observations[image.head or ""] = observation_of(image.image, self._estimator, known=prior)
        first = next(iter(observations.values()))
        return registry.run_safely(
            self._estimator, replace(first, heads=observations) if self._estimator.needs == "heads" else first
        )


def png_of(dn: NDArray[np.uint16], full_scale: int, bits: int) -> bytes:
    """Return digital numbers, shape (H, W), as a PNG of 16 bits, or of 8 with the full scale as 255."""
    grey = dn if bits == 16 else np.rint(dn * (255.0 / full_scale)).astype(np.uint8)
    data: bytes = cv2.imencode(".png", np.ascontiguousarray(grey))[1].tobytes()
    return data


def _least_turn(start: FloatArray, end: FloatArray) -> Rotation:
    """Return the shortest rotation that takes one unit vector to another; of opposite ones any of them."""
    axis = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(axis)), float(start @ end)
    if sine < 1e-15:
        axis, sine = np.cross(start, np.eye(3)[np.argmin(np.abs(start))]), 0.0
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arctan2(sine, cosine))
