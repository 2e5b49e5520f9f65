"""Our modules in a simulation of Basilisk's, and their messages read by others: OpenCV, Basilisk's own limb finder.

Run them with the extra `basilisk`: `pip install -e '.[basilisk,test]'`, then `pytest tests/unit/bridges`; the limb
finder also wants `pip install bsk-opnav`.
"""

from __future__ import annotations

import ctypes
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("Basilisk", reason="needs the extra `basilisk`: pip install 'horizonval[basilisk]'")

from Basilisk.architecture import messaging
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros

import horizonval as hv
from horizonval.bridges.attitudes import mrp_of_quaternion, quaternion_of_mrp, request_of_state
from horizonval.bridges.basilisk import AttitudeModule, CameraModule
from horizonval.serve.local import LocalClient

EPOCH = datetime(2026, 3, 20, 12, 0, tzinfo=UTC)
SCENE = """
[camera]
file = "vis-fisheye-1024-190deg"
camera = { width = 96, height = 96, focal_length_mm = 0.1546875 }
[platform]
epoch_utc = 2026-03-20T12:00:00Z
altitude_km = 550.0
[render]
orders = "single"
nodes = 64
subsamples = 2
"""
R_N = np.array([6928e3, 0.0, 0.0])
V_N = np.array([0.0, 5400.0, 5300.0])


def down_sigma(tilt_deg: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """MRPs of a body that looks down, x along the velocity, tilted by a roll and a pitch."""
    z = -R_N / np.linalg.norm(R_N)
    y = np.cross(z, V_N / np.linalg.norm(V_N))
    matrix = np.array([np.cross(y, z), y, z])
    for axis, angle in zip(((1, 0, 0), (0, 1, 0)), np.radians(tilt_deg), strict=True):
        matrix = RigidBodyKinematics.PRV2C(np.array(axis) * angle) @ matrix
    return RigidBodyKinematics.C2MRP(matrix)


def state_message(sigma: np.ndarray) -> Any:
    return messaging.SCStatesMsg().write(
        messaging.SCStatesMsgPayload(r_BN_N=R_N.tolist(), v_BN_N=V_N.tolist(), sigma_BN=sigma.tolist())
    )


class Loop:
    """A simulation of one task with a camera, and an attitude of it."""

    def __init__(self, images: Any, sigma: np.ndarray, estimator: Any = "limb-ellipsoid", **keywords: Any):
        self.simulation = SimulationBaseClass.SimBaseClass()
        process = self.simulation.CreateNewProcess("p")
        process.addTask(self.simulation.CreateNewTask("t", macros.sec2nano(10.0)))
        self.camera = CameraModule(images, EPOCH, **keywords)
        self.attitude = AttitudeModule(self.camera, estimator)
        self.state = state_message(sigma)
        self.known = messaging.NavAttMsg().write(messaging.NavAttMsgPayload(sigma_BN=down_sigma((0.0, 0.0)).tolist()))
        self.place = messaging.NavTransMsg().write(messaging.NavTransMsgPayload(r_BN_N=R_N.tolist()))
        self.camera.scStateInMsg.subscribeTo(self.state)
        self.attitude.attitudeInMsg.subscribeTo(self.known)
        self.attitude.transInMsg.subscribeTo(self.place)
        self.simulation.AddModelToTask("t", self.camera, 2)
        self.simulation.AddModelToTask("t", self.attitude, 1)

    def run(self, seconds: float = 0.0) -> None:
        self.simulation.InitializeSimulation()
        self.simulation.ConfigureStopTime(macros.sec2nano(seconds))
        self.simulation.ExecuteSimulation()


def bytes_of(message: Any) -> bytes:
    payload = message.read()
    return ctypes.string_at(int(payload.imagePointer), payload.imageBufferLength)


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> LocalClient:
    path: Path = tmp_path_factory.mktemp("scene") / "loop.toml"
    path.write_text(SCENE)
    return LocalClient(path)


def test_basilisk_and_we_mean_the_same_attitude():
    for sigma in np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3)):
        # Scalar first, of the frame's turn: the inverse of the turn of vectors that ours is.
        scalar, *vector = RigidBodyKinematics.C2EP(RigidBodyKinematics.MRP2C(sigma))
        np.testing.assert_allclose(abs(quaternion_of_mrp(sigma) @ [*np.negative(vector), scalar]), 1.0, atol=1e-14)
        np.testing.assert_allclose(mrp_of_quaternion(quaternion_of_mrp(sigma)), sigma, atol=1e-14)


def test_the_message_points_to_the_image_of_the_state(images):
    sigma = down_sigma((3.0, -2.0))
    loop = Loop(images, sigma, seed=7)
    loop.run()
    payload = loop.camera.cameraImageOutMsg.read()
    assert (payload.valid, payload.timeTag, payload.cameraID) == (1, 0, 1)
    picture = cv2.imdecode(np.frombuffer(bytes_of(loop.camera.cameraImageOutMsg), np.uint8), cv2.IMREAD_UNCHANGED)
    asked = images.image(**request_of_state(EPOCH, R_N, V_N, sigma), seed=7)
    assert picture.dtype == np.uint8
    assert np.abs(picture - asked.dn * (255.0 / asked.full_scale)).max() <= 0.5 + 1e-9
    assert picture.max() > 60


def test_sixteen_bits_are_the_digital_numbers_and_every_image_has_noise_of_its_own(images):
    loop = Loop(images, down_sigma(), bits=16)
    loop.run(10.0)
    assert loop.camera.taken == 2
    assert loop.camera.time_ns == 10_000_000_000
    picture = cv2.imdecode(np.frombuffer(bytes_of(loop.camera.cameraImageOutMsg), np.uint8), cv2.IMREAD_UNCHANGED)
    pose = request_of_state(loop.camera.instant(10_000_000_000), R_N, V_N, down_sigma())
    np.testing.assert_array_equal(picture, images.image(**pose, seed=1).dn)
    assert (picture != images.image(**pose, seed=0).dn).any()


def test_the_attitude_has_the_nadir_of_the_image_and_the_turn_of_what_was_known(images):
    sigma = down_sigma((1.0, -0.6))
    loop = Loop(images, sigma)
    loop.run()
    assert loop.attitude.fit, loop.attitude.fit
    true = RigidBodyKinematics.MRP2C(sigma)
    down_n = -R_N / np.linalg.norm(R_N)
    found = RigidBodyKinematics.MRP2C(np.array(loop.attitude.navAttOutMsg.read().sigma_BN))
    # An eighth of a pixel of 2 deg; the tilt itself is 1.2 deg.
    assert np.degrees(np.arccos((found @ down_n) @ (true @ down_n))) < 0.25
    np.testing.assert_allclose(found @ down_n, loop.attitude.nadir_body, atol=1e-12)
    known = RigidBodyKinematics.MRP2C(down_sigma())
    axis = RigidBodyKinematics.C2PRV(found @ known.T)
    assert abs(axis @ (known @ down_n)) < 1e-9


def test_after_a_refusal_nothing_new_is_published(images):
    answers = iter(
        [
            hv.Fit(np.array([0.0, 0.0, 1.0]), np.zeros((3, 3)), 0.0, 0.0),
            hv.Refusal(hv.Outcome.DARK, "the second one"),
        ]
    )
    loop = Loop(images, down_sigma(), hv.Estimator("once", "Answers once", run=lambda observation: next(answers)))
    loop.run(10.0)
    assert loop.camera.taken == 2
    assert loop.attitude.fit.status == "dark"
    assert loop.attitude.nadir_body is None
    assert loop.attitude.navAttOutMsg.read().timeTag == 0.0
    np.testing.assert_allclose(loop.attitude.navAttOutMsg.read().sigma_BN, down_sigma(), atol=1e-12)


def test_mistakes_are_told():
    with pytest.raises(hv.UserError, match="bits"):
        CameraModule(None, EPOCH, bits=12)
    with pytest.raises(hv.UserError, match="scStateInMsg: not linked"):
        CameraModule(None, EPOCH).Reset(0)
    with pytest.raises(hv.UserError, match="geodetic"):
        AttitudeModule(
            CameraModule(None, EPOCH),
            hv.Estimator("other", "Other", run=lambda observation: None, estimates="geodetic"),
        )


def test_basilisk_finds_the_limb_in_the_message(images):
    limb_finding = pytest.importorskip(
        "Basilisk.fswAlgorithms.limbFinding", reason="needs Basilisk's image modules: pip install bsk-opnav"
    )
    loop = Loop(images, down_sigma())
    loop.run()
    finder = limb_finding.LimbFinding()
    finder.imageInMsg.subscribeTo(loop.camera.cameraImageOutMsg)
    finder.cannyThreshHigh, finder.cannyThreshLow, finder.blurrSize, finder.limbNumThresh = 200, 100, 3, 10
    finder.Reset(0)
    finder.UpdateState(0)
    limb = finder.opnavLimbOutMsg.read()
    points = np.array(limb.limbPoints[: 2 * limb.numLimbPoints]).reshape(-1, 2)
    truth = loop.camera.served[0].truth
    model = truth.camera_model
    radius_px = model.fx * truth.angular_radius_rad
    distance_px = np.hypot(points[:, 0] - model.cx, points[:, 1] - model.cy)
    assert limb.valid == 1
    assert np.median(np.abs(distance_px - radius_px)) < 2.0
