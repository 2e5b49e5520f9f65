"""An attitude controller in Basilisk that holds the nadir with our horizon sensor in the loop.

A satellite of 12 units tumbles in low orbit. Basilisk moves it, says where the nadir is to be (``hillPoint``,
``attTrackingError``) and asks for torque (``mrpFeedback``). What it knows of its attitude comes from a rate gyro, a
filter of six states, and once a minute an image of ours, rendered where it is and as it is turned, in which an
estimator finds the nadir or refuses. In eclipse a visible camera is blind, and the gyro alone goes on.

    python examples/basilisk/closed_loop.py results/in-the-loop

runs three loops, with a visible fisheye, two infrared cameras and the truth as a sensor, and writes a JSON file of
each and one figure. A loop that was finished is not run again; one that was stopped goes on from the images that it
has, which lie in ``.work`` (a loop asks for the same ones each time). Ctrl-C ends a loop with what was flown until
then.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from attitude_filter import Array, GyroNoise, NadirFilter
from Basilisk.architecture import messaging, sysModel
from Basilisk.fswAlgorithms import attTrackingError, hillPoint, mrpFeedback
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros, orbitalMotion, simIncludeGravBody
from scipy.spatial.transform import Rotation

from horizonval import __version__
from horizonval.bridges.attitudes import mrp_of_quaternion, quaternion_of_mrp
from horizonval.bridges.basilisk import AttitudeModule, CameraModule
from horizonval.core import atomic
from horizonval.geometry.camera import project
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.geometry.sun_and_moon import sun_angular_radius, sun_gcrs, sun_visible_fraction
from horizonval.serve.local import LocalClient
from horizonval.wire import pack, unpack

HERE = Path(__file__).parent
EPOCH = datetime(2026, 3, 20, 12, 0, tzinfo=UTC)
INERTIA_KG_M2 = (0.12, 0.10, 0.06)
TUMBLE_DEG_S = (2.0, -1.5, 2.5)
FIRST_SIGMA_DEG = 5.0
"""Of the attitude at the start, about each axis: what a Sun sensor and a magnetometer give together."""
POSITION_SIGMA_M = 20.0
GATE_SIGMAS = 5.0
FLOOR_DEG = 0.03
TRUTH_SIGMA_DEG = 0.001
"""What the filter takes the truth for."""
HELD_FROM_S = 1800.0
"""The tumble is over by then; what is held is counted from here."""
STEP_S = 1.0


@dataclass(frozen=True)
class Sensor:
    """What looks for the nadir: a scene with its camera, and a method; neither for the truth."""

    scene: str = ""
    estimator: str = ""
    heads: tuple[str, ...] = ()


SENSORS = {
    "visible": Sensor("visible.toml", "limb-ellipsoid"),
    "infrared": Sensor("infrared.toml", "limb-heads", ("right", "left")),
    "truth": Sensor(),
}


class KeptImages(LocalClient):
    """Renders each image once, also over several starts of the program."""

    def __init__(self, scene: Path, folder: Path) -> None:
        super().__init__(scene)
        self._folder, self._identity = folder, f"{__version__} {scene.read_text(encoding='utf-8')}"

    def _ask(self, kind: str, keys: Mapping[str, Any]) -> dict[str, Any]:
        text = f"{self._identity} {kind} {json.dumps(keys, sort_keys=True)}"
        path = self._folder / hashlib.sha256(text.encode()).hexdigest()
        if path.exists():
            return unpack(path.read_bytes())
        reply = super()._ask(kind, keys)
        self._folder.mkdir(parents=True, exist_ok=True)
        atomic.write_bytes(path, pack(reply))
        return reply


class RateGyro(sysModel.SysModel):
    """Integrates the true rate over each step, with a bias that walks and white noise."""

    def __init__(self, noise: GyroNoise, random: np.random.Generator) -> None:
        super().__init__()
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self._noise, self._random = noise, random
        self._before: Rotation | None = None
        self.bias = noise.bias_rad_s * random.standard_normal(3)
        self.angle = np.zeros(3)

    def Reset(self, CurrentSimNanos: int) -> None:
        self._before = None

    def UpdateState(self, CurrentSimNanos: int) -> None:
        now = Rotation.from_quat(quaternion_of_mrp(self.scStateInMsg().sigma_BN))
        self.angle = np.zeros(3)
        if self._before is not None:
            turned = -(now * self._before.inv()).as_rotvec()
            white = self._noise.angle_rad_sqrt_s * math.sqrt(STEP_S) * self._random.standard_normal(3)
            self.angle = turned + self.bias * STEP_S + white
            walk = self._noise.bias_walk_rad_s_sqrt_s * math.sqrt(STEP_S)
            self.bias = self.bias + walk * self._random.standard_normal(3)
        self._before = now


class PositionReceiver(sysModel.SysModel):
    """Position and velocity as satellite navigation has them."""

    def __init__(self, random: np.random.Generator) -> None:
        super().__init__()
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self.navTransOutMsg = messaging.NavTransMsg()
        self._random = random

    def Reset(self, CurrentSimNanos: int) -> None:
        """Nothing is kept."""

    def UpdateState(self, CurrentSimNanos: int) -> None:
        state = self.scStateInMsg()
        payload = messaging.NavTransMsgPayload()
        payload.timeTag = CurrentSimNanos * 1e-9
        payload.r_BN_N = (np.array(state.r_BN_N) + POSITION_SIGMA_M * self._random.standard_normal(3)).tolist()
        payload.v_BN_N = state.v_BN_N
        self.navTransOutMsg.write(payload, CurrentSimNanos, self.moduleID)


class FilterModule(sysModel.SysModel):
    """The filter's first half: turns the attitude on by the gyro, and publishes it."""

    def __init__(self, gyro: RateGyro, receiver: PositionReceiver, attitude_filter: NadirFilter) -> None:
        super().__init__()
        self._gyro, self._receiver, self.filter = gyro, receiver, attitude_filter
        self.navAttOutMsg = messaging.NavAttMsg()

    def Reset(self, CurrentSimNanos: int) -> None:
        """The first attitude stays."""

    def UpdateState(self, CurrentSimNanos: int) -> None:
        if CurrentSimNanos:
            self.filter.turn_on(self._gyro.angle, STEP_S)
        self.publish(CurrentSimNanos)

    def publish(self, nanoseconds: int) -> None:
        payload = messaging.NavAttMsgPayload()
        payload.timeTag = nanoseconds * 1e-9
        payload.sigma_BN = mrp_of_quaternion(self.filter.body_from_gcrs.as_quat()).tolist()
        payload.omega_BN_B = (self._gyro.angle / STEP_S - self.filter.bias).tolist()
        self.navAttOutMsg.write(payload, nanoseconds, self.moduleID)

    def nadir_gcrs(self) -> Array:
        r = np.array(self._receiver.navTransOutMsg.read().r_BN_N)
        return -r / np.linalg.norm(r)


class Correction(sysModel.SysModel):
    """The filter's second half: takes the nadir of the last image, if there is one, and keeps a record."""

    def __init__(self, module: FilterModule, measure: Callable[[], tuple[str, Array | None, Array | None]]) -> None:
        super().__init__()
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self._module, self._measure = module, measure
        self.record: list[dict[str, Any]] = []

    def Reset(self, CurrentSimNanos: int) -> None:
        self.record = []

    def UpdateState(self, CurrentSimNanos: int) -> None:
        status, nadir_body, covariance = self._measure()
        entry: dict[str, Any] = {"time_s": CurrentSimNanos * 1e-9, "status": status}
        if nadir_body is not None and covariance is not None:
            state = self.scStateInMsg()
            r = np.array(state.r_BN_N)
            true = Rotation.from_quat(quaternion_of_mrp(state.sigma_BN)).apply(-r / np.linalg.norm(r))
            entry["error_deg"] = _angle_deg(true, nadir_body)
            entry["sigma_deg"] = math.degrees(math.sqrt(np.trace(covariance) / 2.0))
            entry["taken"] = self._module.filter.correct(self._module.nadir_gcrs(), nadir_body, covariance)
            self._module.publish(CurrentSimNanos)
        self.record.append(entry)


class Recorder(sysModel.SysModel):
    """Writes down truth and knowledge at every step."""

    def __init__(self, module: FilterModule) -> None:
        super().__init__()
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self._module = module
        self.rows: list[tuple[float, ...]] = []

    def Reset(self, CurrentSimNanos: int) -> None:
        self.rows = []

    def UpdateState(self, CurrentSimNanos: int) -> None:
        state = self.scStateInMsg()
        known, r = self._module.filter, np.array(state.r_BN_N)
        down = -r / np.linalg.norm(r)
        true = Rotation.from_quat(quaternion_of_mrp(state.sigma_BN))
        nadir = true.apply(down)
        self.rows.append(
            (
                CurrentSimNanos * 1e-9,
                *r,
                *true.as_quat(),
                _angle_deg(nadir, np.array([0.0, 0.0, 1.0])),
                _angle_deg(nadir, known.body_from_gcrs.apply(down)),
                math.degrees(known.tilt_sigma_rad(down)),
                math.degrees(float(np.linalg.norm((true * known.body_from_gcrs.inv()).as_rotvec()))),
                math.degrees(float(np.linalg.norm(state.omega_BN_B))),
            )
        )


def _angle_deg(a: Array, b: Array) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


def run_loop(
    sensor: Sensor, seconds: float, cadence_s: float, seed: int, kept: Path, say: Callable[[str], None]
) -> dict[str, Any]:
    """Run one loop, and return what is known of it afterwards as plain data; ``kept`` is a folder for its images."""
    gyro_random, first_random, place_random = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("loop")
    for name, step_s, priority in (("move", 0.5, 9), ("know", STEP_S, 8), ("see", cadence_s, 7), ("steer", STEP_S, 6)):
        process.addTask(simulation.CreateNewTask(name, macros.sec2nano(step_s)), priority)

    craft = spacecraft.Spacecraft()
    gravity = simIncludeGravBody.gravBodyFactory()
    earth = gravity.createEarth()
    earth.isCentralBody = True
    gravity.addBodiesTo(craft)
    elements = orbitalMotion.ClassicElements()
    elements.a, elements.e = 6378.137e3 + 550e3, 0.001
    elements.i, elements.Omega, elements.omega, elements.f = (math.radians(x) for x in (51.6, 40.0, 0.0, 300.0))
    r, v = orbitalMotion.elem2rv(earth.mu, elements)
    craft.hub.mHub = 20.0
    craft.hub.IHubPntBc_B = np.diag(INERTIA_KG_M2).tolist()
    craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = r, v
    first = Rotation.random(rng=first_random)
    craft.hub.sigma_BNInit = mrp_of_quaternion(first.as_quat()).reshape(3, 1).tolist()
    craft.hub.omega_BN_BInit = np.radians(TUMBLE_DEG_S).reshape(3, 1).tolist()
    torque = extForceTorque.ExtForceTorque()
    craft.addDynamicEffector(torque)
    simulation.AddModelToTask("move", torque)
    simulation.AddModelToTask("move", craft)

    noise = GyroNoise()
    gyro, receiver = RateGyro(noise, gyro_random), PositionReceiver(place_random)
    sigma = math.radians(FIRST_SIGMA_DEG)
    known = Rotation.from_rotvec(sigma * first_random.standard_normal(3)) * first
    floor_rad = math.radians(FLOOR_DEG if sensor.scene else TRUTH_SIGMA_DEG)
    module = FilterModule(gyro, receiver, NadirFilter(known, sigma, noise, GATE_SIGMAS, floor_rad))
    for number, part in enumerate((gyro, receiver, module)):
        simulation.AddModelToTask("know", part, 9 - number)

    camera = None
    if sensor.scene:
        camera = CameraModule(KeptImages(HERE / sensor.scene, kept), EPOCH, heads=sensor.heads, seed=seed)
        horizon = AttitudeModule(
            camera, sensor.estimator, position_sigma_m=POSITION_SIGMA_M, attitude_sigma_deg=FIRST_SIGMA_DEG
        )
        camera.scStateInMsg.subscribeTo(craft.scStateOutMsg)
        horizon.attitudeInMsg.subscribeTo(module.navAttOutMsg)
        horizon.transInMsg.subscribeTo(receiver.navTransOutMsg)
        simulation.AddModelToTask("see", camera, 9)
        simulation.AddModelToTask("see", horizon, 8)

        def measure() -> tuple[str, Array | None, Array | None]:
            return str(horizon.fit.status), horizon.nadir_body, horizon.covariance_nadir_body
    else:

        def measure() -> tuple[str, Array | None, Array | None]:
            state = craft.scStateOutMsg.read()
            down = -np.array(state.r_BN_N) / np.linalg.norm(state.r_BN_N)
            return "valid", Rotation.from_quat(quaternion_of_mrp(state.sigma_BN)).apply(down), np.zeros((3, 3))

    correction = Correction(module, measure)
    simulation.AddModelToTask("see", correction, 7)

    point = hillPoint.hillPoint()
    point.transNavInMsg.subscribeTo(receiver.navTransOutMsg)
    error = attTrackingError.attTrackingError()
    # From Hill's axes (outwards, along the flight, along the orbit's normal) to ours: flight, against the normal, down.
    body_from_hill = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    error.sigma_R0R = (-np.array(RigidBodyKinematics.C2MRP(body_from_hill))).tolist()
    error.attRefInMsg.subscribeTo(point.attRefOutMsg)
    error.attNavInMsg.subscribeTo(module.navAttOutMsg)
    control = mrpFeedback.mrpFeedback()
    control.K, control.P, control.Ki = 4.0e-3, 2.0e-2, -1.0
    control.guidInMsg.subscribeTo(error.attGuidOutMsg)
    body = messaging.VehicleConfigMsgPayload(ISCPntB_B=np.diag(INERTIA_KG_M2).ravel().tolist())
    body_message = messaging.VehicleConfigMsg().write(body)
    control.vehConfigInMsg.subscribeTo(body_message)
    torque.cmdTorqueInMsg.subscribeTo(control.cmdTorqueOutMsg)
    recorder = Recorder(module)
    for number, part in enumerate((point, error, control, recorder)):
        simulation.AddModelToTask("steer", part, 9 - number)
    for part in (gyro, receiver, correction, recorder):
        part.scStateInMsg.subscribeTo(craft.scStateOutMsg)

    asked = control.cmdTorqueOutMsg.recorder(macros.sec2nano(STEP_S))
    simulation.AddModelToTask("steer", asked, 0)
    simulation.InitializeSimulation()
    began = time.monotonic()
    try:
        for second in np.arange(0.0, seconds, cadence_s):
            simulation.ConfigureStopTime(macros.sec2nano(float(second)))
            simulation.ExecuteSimulation()
            held = f"pointing {recorder.rows[-1][8]:.3f} deg, {correction.record[-1]['status']}"
            say(f"{second:.0f} of {seconds:.0f} s, {held}, {time.monotonic() - began:.0f} s")
    except KeyboardInterrupt:
        say("stopped")
    most_torque = float(np.abs(np.array(asked.torqueRequestBody)[:, :3]).max())
    return _result(np.array(recorder.rows), correction.record, camera, most_torque)


def _result(
    rows: Array, record: list[dict[str, Any]], camera: CameraModule | None, most_torque_nm: float
) -> dict[str, Any]:
    seconds, r, q = rows[:, 0], rows[:, 1:4], rows[:, 4:8]
    lit = np.empty(len(rows))
    in_frame = np.zeros(len(rows), bool)
    sun, distance = sun_gcrs(EPOCH)
    turns = itrs_from_gcrs(EPOCH, seconds)
    for k, turn in enumerate(turns):
        lit[k] = sun_visible_fraction(turn @ r[k], turn @ sun, float(sun_angular_radius(distance)))
    if camera is not None:
        sun_body = Rotation.from_quat(q).apply(sun)
        for served in camera.served:
            truth = served.image.truth
            model = truth.camera_model
            pixels, seen = project(model, Rotation.from_quat(np.array(truth.q_cam_from_body)).apply(sun_body))
            size = np.array([model.width, model.height])
            with np.errstate(invalid="ignore"):
                in_frame |= seen & ((pixels > -0.5) & (pixels < size - 0.5)).all(axis=1) & (lit > 0.0)
    kind = np.where(lit <= 0.0, "eclipse", np.where(in_frame, "Sun in frame", "sunlight"))
    held = seconds >= HELD_FROM_S
    summary = {}
    for name in ("sunlight", "Sun in frame", "eclipse"):
        here = held & (kind == name)
        if not here.any():
            continue
        instants = {float(t) for t in seconds[here]}
        images = [e for e in record if e["time_s"] in instants]
        answered = [e for e in images if "error_deg" in e]
        summary[name] = {
            "seconds": int(here.sum()),
            "pointing_rms_deg": _rms(rows[here, 8]),
            "pointing_max_deg": float(rows[here, 8].max()),
            "knowledge_rms_deg": _rms(rows[here, 9]),
            "knowledge_max_deg": float(rows[here, 9].max()),
            "claimed_rms_deg": _rms(rows[here, 10]),
            "images": len(images),
            "answered": len(answered),
            "taken": sum(e["taken"] for e in answered),
            "sensor_rms_deg": _rms(np.array([e["error_deg"] for e in answered])) if answered else None,
            "sensor_max_deg": max((e["error_deg"] for e in answered), default=None),
            "sensor_claimed_rms_deg": _rms(np.array([e["sigma_deg"] for e in answered])) if answered else None,
        }
    off = np.flatnonzero(rows[:, 8] > 1.0)
    every = slice(None, None, 10)
    return {
        "flown_s": float(seconds[-1]),
        "acquired_s": float(seconds[off[-1]] + STEP_S) if len(off) else 0.0,
        "most_torque_nm": most_torque_nm,
        "summary": summary,
        "images": record,
        "series": {
            "time_s": seconds[every].tolist(),
            "pointing_deg": rows[every, 8].round(6).tolist(),
            "knowledge_deg": rows[every, 9].round(6).tolist(),
            "claimed_deg": rows[every, 10].round(6).tolist(),
            "attitude_error_deg": rows[every, 11].round(6).tolist(),
            "rate_deg_s": rows[every, 12].round(6).tolist(),
            "kind": kind[every].tolist(),
        },
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _is_done(found: dict[str, Any], settings: dict[str, Any]) -> bool:
    last = settings["seconds"] - settings["cadence_s"]
    return bool(found["settings"] == settings and found["flown_s"] >= last)


def main() -> int:
    parser = argparse.ArgumentParser(description="A nadir held in Basilisk with a horizon sensor in the loop.")
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--sensor", choices=list(SENSORS), action="append", help="only this one; repeatable")
    parser.add_argument("--seconds", type=float, default=7560.0, help="of flight (an orbit takes 5739 s)")
    parser.add_argument("--cadence", type=float, default=60.0, help="seconds from image to image")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in options.sensor or SENSORS:
        path = options.out / f"{name}.json"
        settings = {"seconds": options.seconds, "cadence_s": options.cadence, "seed": options.seed}
        if path.exists() and _is_done(json.loads(path.read_text(encoding="utf-8")), settings):
            print(f"{path}: there already", file=sys.stderr)
            continue

        def say(line: str, name: str = name) -> None:
            print(f"{name}: {line}", file=sys.stderr, flush=True)

        kept = options.out / ".work"
        found = run_loop(SENSORS[name], options.seconds, options.cadence, options.seed, kept, say)
        options.out.mkdir(parents=True, exist_ok=True)
        atomic.write_text(path, json.dumps({"sensor": name, "settings": settings, **found}, indent=1) + "\n")
    if all((options.out / f"{name}.json").exists() for name in SENSORS):
        from figure import draw

        draw(options.out, options.out / "pointing.png")
        print(options.out / "pointing.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
