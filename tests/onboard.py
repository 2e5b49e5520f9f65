"""The fit in C and `limb-profile`: stored frames of a suite that both see, images drawn from its tables, the program.

``python tests/onboard.py`` renders the suite anew and keeps the second frame of every place and band.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from horizonval.api.estimate import mission_table
from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.climate import month_of
from horizonval.estimation.fit import known_profile
from horizonval.estimation.fit.air import KnownAir, common_air
from horizonval.estimation.fit.pixels import level_distance, ray_height
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.templates import templates_of
from horizonval.estimation.methods import limb_profile
from horizonval.estimation.observation import Observation
from horizonval.estimation.prior import GAIN_SIGMA, Prior
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.rotation import tangent_basis
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.load import Case
from horizonval.suites.observation import observation_of
from horizonval.suites.suite import load_suite
from horizonval.tables.mission import write_table

SOURCE = Path(__file__).parents[1] / "examples" / "onboard" / "limb_fit.c"
KEPT = Path(__file__).parent / "data" / "onboard_frames.npz"
BANDS = ("lwir", "co2", "vis")
ERROR = 0.005
"""Of the cut tables, share of a profile's largest value."""
PER_PLACE = 4
BLUR_PX, BLUR_LOG_SIGMA, LIFT_SIGMA_M = 0.7, 0.3, 300.0
"""What `limb-profile` takes for known where nobody says it."""

SEASONS = """list = [
  { scene.name = "january", platform.epoch_utc = 2026-01-15T12:00:00Z, platform.latitude_deg = 50.0, platform.altitude_km = 500.0, camera.mount_roll_deg = 66.0 },
  { scene.name = "april", platform.epoch_utc = 2026-04-15T12:00:00Z, platform.latitude_deg = -35.0, platform.altitude_km = 800.0, camera.mount_roll_deg = 61.0 },
  { scene.name = "july", platform.epoch_utc = 2026-07-15T12:00:00Z, platform.latitude_deg = 5.0, platform.altitude_km = 1400.0, camera.mount_roll_deg = 53.0 },
]
"""  # noqa: E501  (rows of a table)
TILTS = f"""sobol = {{ n = {PER_PLACE}, ranges = {{ "attitude.roll_deg" = [-3.0, 3.0], "attitude.pitch_deg" = [-3.0, 3.0] }} }}
"""  # noqa: E501
SUITE = f"""
[suite]
name = "onboard"
seed = 11
estimators = ["limb-profile"]

[defaults]
camera = {{ file = "ir-bolometer-160-57deg" }}
platform = {{ longitude_deg = 10.0, heading_deg = 350.0 }}
atmosphere = {{ profile = "weather" }}
surface = {{ kind = "earth" }}
render = {{ subsamples = 4, nodes = 64 }}

[defaults.prior]
position_sigma_km = 1.0
attitude_sigma_deg = [2.0, 2.0, 2.0]
climate = "by_latitude_month"

[[cases]]
name = "infrared"
{SEASONS}{TILTS}
[[cases]]
name = "carbon-dioxide"
base = {{ camera = {{ band = [{{ name = "co2", kind = "thermal", lo_um = 14.0, hi_um = 16.3 }}] }} }}
{SEASONS}{TILTS}
[[cases]]
name = "visible"
base = {{ camera = {{ file = "vis-cmos-512-60deg", camera = {{ width = 160, height = 120, fov_deg = 57.0 }}, detector = {{ exposure_s = 7e-5 }} }} }}
list = [
  {{ scene.name = "haze", platform.epoch_utc = 2026-04-15T11:20:00Z, platform.latitude_deg = 20.0, platform.altitude_km = 500.0, camera.mount_roll_deg = 66.0, atmosphere.aerosol_optical_depth_550nm = 0.4 }},
  {{ scene.name = "clear", platform.epoch_utc = 2026-07-15T11:20:00Z, platform.latitude_deg = 30.0, platform.altitude_km = 800.0, camera.mount_roll_deg = 61.0 }},
]
{TILTS}"""  # noqa: E501  (rows of a table)


def cases(folder: Path) -> tuple[Case, ...]:
    """Return the frames of the suite, whose file is written to a folder."""
    path = folder / "onboard.toml"
    path.write_text(SUITE)
    return load_suite(path).cases


def rendered(case: Case) -> Observation:
    """Return what a camera sees of a case, and what is known beside it."""
    frame = render_frame(case.scene, case.camera)
    return observation_of(observe(frame, case.camera), limb_profile.ESTIMATOR)


def make_tables(folder: Path) -> dict[str, Path]:
    """Write the tables that the suite needs, as ``BAND.npz`` for Python and ``BAND/table.h`` for C."""
    cases(folder)
    tables = {}
    for band in BANDS:
        made = mission_table(str(folder / "onboard.toml"), band, ERROR)
        tables[band] = folder / f"{band}.npz"
        (folder / band).mkdir()
        write_table(made, tables[band])
        write_table(made, folder / band / "table.h")
    return tables


def make_program(folder: Path, *flags: str) -> Path:
    """Return the program that a compiler makes of the source and the table in a folder."""
    program = folder / "limb_fit"
    command = ["cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{folder}", *flags]
    subprocess.run([*command, SOURCE, "-o", program, "-lm"], check=True)
    return program


def band_of(observation: Observation) -> str:
    assert observation.band_um is not None
    return "vis" if observation.band_kind == "solar" else "co2" if observation.band_um[0] > 13.0 else "lwir"


def by_python(observation: Observation, table: Path) -> Any:
    """Return the answer of `limb-profile` that leans on a table."""
    return limb_profile.run(replace(observation, prior=replace(observation.prior, climate=str(table))))


def by_c(observation: Observation, program: Path) -> dict[str, Any]:
    """Return the answer of the program, which is told the same."""
    return answer(program, sent(observation), observation.image)


def sent(observation: Observation) -> list[Any]:
    """Return the numbers that the program reads before an image."""
    camera, prior = observation.camera, observation.prior
    assert prior.r_itrs is not None
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    assert prior.epoch_utc is not None
    assert observation.band_kind is not None
    towards_sun, distance_m = sun_itrs(prior.epoch_utc)
    sun = observation.sun_cam
    if sun is None:
        sun = Rotation.from_quat(prior.q_cam_from_itrs).apply(towards_sun)
    of_time = known_profile.known_sun_itrs(observation, towards_sun)
    if of_time is None:
        of_time = np.zeros(3)
    gain, gain_log_sigma = 1.0, 0.0
    if observation.radiance_per_dn is not None and observation.band_width_um is not None:
        sunlight = (AU_M / distance_m) ** 2 if observation.band_kind == "solar" else 1.0
        gain = sunlight * observation.band_width_um / observation.radiance_per_dn
        gain_log_sigma = GAIN_SIGMA[observation.band_kind]
    return [
        *(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy),
        *(*prior.r_itrs, prior.position_sigma_m),
        *(*prior.q_cam_from_itrs, prior.attitude_sigma_rad[0]),
        *(month_of(prior.epoch_utc), *sun, *of_time),
        *(BLUR_PX, BLUR_LOG_SIGMA, LIFT_SIGMA_M, gain, gain_log_sigma, observation.full_scale or 0.0),
    ]


def answer(program: Path, known: list[Any], image: np.ndarray) -> dict[str, Any]:
    """Return what the program says of an image of whole numbers and what is known beside it."""
    line = " ".join(f"{x:.17g}" for x in known) + "\n"
    pixels = np.rint(image).astype(np.uint16).tobytes()
    done = subprocess.run([program], input=line.encode() + pixels, capture_output=True, check=True)
    return dict(json.loads(done.stdout))


FINER, NODES, STEP_M, LOWEST_M, HIGHEST_M = 4, 80, 500.0, -80e3, 170e3
"""Subpixels per side of a drawn image's pixel, nodes along its limb, and its grid of heights."""
TILT_RAD = float(np.radians(2.0))


def drawn(observation: Observation, table: Path, rng: np.random.Generator) -> tuple[Observation, FloatArray]:
    """Return an observation with an image drawn from a table, and its true nadir in camera axes.

    The pose is near the observation's prior. Air is drawn from the table's modes, the image made on a finer grid
    without the package's model of the blur.
    """
    camera, prior = observation.camera, observation.prior
    assert prior.q_cam_from_itrs is not None
    assert prior.r_itrs is not None
    assert prior.position_sigma_m is not None
    assert prior.epoch_utc is not None
    turn = Rotation.from_rotvec(TILT_RAD * rng.standard_normal(3)) * Rotation.from_quat(prior.q_cam_from_itrs)
    pose = LimbPose(turn.as_matrix(), prior.r_itrs * (1.0 + rng.uniform(-0.01, 0.01)))
    place = (pose.cam_from_itrs, pose.r_itrs, WGS84.axes_m)
    u, v = ((np.arange(n * FINER) + 0.5) / FINER - 0.5 for n in (camera.width, camera.height))
    los = unproject(camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)).T
    ray = ray_height(los, *place)
    to_centre, radius = float(np.linalg.norm(pose.r_itrs)), float(WGS84.axes_m[0])
    curve = 0.5 * radius / (to_centre**2 - radius**2)
    across, _ = level_distance(ray.height_m, curve)
    basis = tangent_basis(pose.nadir_cam)
    azimuth = np.arctan2(*(basis.T @ los)[::-1])
    near = (np.abs(ray.height_m) < 60e3) & (ray.distance_m > 0.0)
    middle = np.angle(np.exp(1j * azimuth[near]).mean())
    away = np.angle(np.exp(1j * (azimuth - middle)))
    first, last = away[near].min(), away[near].max()
    at = middle + np.linspace(first, last, NODES)
    sine = radius / to_centre
    node = sine * basis @ np.array([np.cos(at), np.sin(at)]) + np.sqrt(1.0 - sine**2) * pose.nadir_cam[:, None]
    for _ in range(2):
        limb = ray_height(node, *place)
        node = node - limb.normal_cam * (limb.height_m / limb.distance_m)
        node /= np.linalg.norm(node, axis=0)
    towards_sun = sun_itrs(prior.epoch_utc)[0]
    sun_cam = turn.apply(towards_sun)
    known = KnownAir(templates_of(table), prior.epoch_utc, sun_cam, towards_sun)
    normal = ray_height(node, *place).normal_cam.T
    air = common_air([known.nodes(normal, node.T, pose, (LOWEST_M, HIGHEST_M, STEP_M), curve)], [None]).images[0]
    coefficients = air.coefficients(rng.standard_normal(air.wave.shape[1]))
    profiles = np.maximum(np.einsum("mk,mkn->mn", coefficients, air.functions), 0.0)
    along = np.clip((away - first) / (last - first), 0.0, 1.0) * (NODES - 1)
    height = np.clip((across - LOWEST_M) / STEP_M, 0.0, profiles.shape[1] - 1.0)
    light = map_coordinates(profiles, [along, height], order=1) * (ray.distance_m > 0.0) * los[2] ** 4
    light = gaussian_filter(light.reshape(len(v), len(u)), rng.uniform(0.55, 0.85) * FINER)
    level = sent(observation)[-3] * light.reshape(camera.height, FINER, camera.width, FINER).mean(axis=(1, 3))
    if observation.band_kind == "solar":
        background, variance = 30.0, 1.44 + level / 60.0
    else:
        # at 0 the converter cuts noise off
        background, variance = rng.choice([0.0, 100.0]), 25.0 + 0.0 * level
    image = np.clip(np.rint(background + level + np.sqrt(variance) * rng.standard_normal(level.shape)), 0.0, 65535.0)
    said = replace(
        prior,
        r_itrs=pose.r_itrs + prior.position_sigma_m * rng.standard_normal(3),
        q_cam_from_itrs=(Rotation.from_rotvec(TILT_RAD * rng.standard_normal(3)) * turn).as_quat(),
    )
    sun = None if observation.sun_cam is None else sun_cam
    return replace(observation, image=image, prior=said, sun_cam=sun, full_scale=None), pose.nadir_cam


def kept() -> Iterator[tuple[str, Observation]]:
    """Yield the names and observations of the kept frames."""
    with np.load(KEPT) as data:
        frames = zip(json.loads(str(data["known"])), data["image"], strict=True)
    for known, image in frames:
        prior = known["prior"]
        yield (
            known["name"],
            Observation(
                image=image.astype(np.float64),
                camera=CameraModel(*known["camera"]),
                q_cam_from_body=np.array(known["q_cam_from_body"]),
                full_scale=known["full_scale"],
                prior=Prior(
                    r_itrs=np.array(prior["r_itrs"]),
                    position_sigma_m=prior["position_sigma_m"],
                    q_cam_from_itrs=np.array(prior["q_cam_from_itrs"]),
                    attitude_sigma_rad=np.array(prior["attitude_sigma_rad"]),
                    epoch_utc=datetime.fromisoformat(prior["epoch_utc"]),
                ),
                band_kind=known["band_kind"],
                band_um=(known["band_um"][0], known["band_um"][1]),
                band_width_um=known["band_width_um"],
                radiance_per_dn=known["radiance_per_dn"],
                sun_cam=None if known["sun_cam"] is None else np.array(known["sun_cam"]),
            ),
        )


def _told(name: str, observation: Observation) -> dict[str, Any]:
    camera, prior = observation.camera, observation.prior
    assert prior.epoch_utc is not None
    numbers = {
        key: np.asarray(getattr(prior, key)).tolist()
        for key in ("r_itrs", "position_sigma_m", "q_cam_from_itrs", "attitude_sigma_rad")
    }
    fields = ("full_scale", "band_kind", "band_um", "band_width_um", "radiance_per_dn")
    return {
        "name": name,
        "camera": [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy],
        "q_cam_from_body": observation.q_cam_from_body.tolist(),
        "sun_cam": None if observation.sun_cam is None else observation.sun_cam.tolist(),
        "prior": numbers | {"epoch_utc": prior.epoch_utc.isoformat()},
        **{field: getattr(observation, field) for field in fields},
    }


def _keep(folder: Path) -> None:
    some = cases(folder)[1::PER_PLACE]
    seen = [rendered(case) for case in some]
    told = [_told(case.name, one) for case, one in zip(some, seen, strict=True)]
    images = np.array([np.rint(one.image) for one in seen]).astype(np.uint16)
    np.savez_compressed(KEPT, known=np.array(json.dumps(told)), image=images)


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        _keep(Path(place))
