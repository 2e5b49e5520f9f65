"""A program as an estimator, run in this process: what it gets, what becomes of what it prints."""

from __future__ import annotations

import json
import math
import sys
import tomllib
import venv
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import truth_at

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.frames import roll_pitch_of_nadir
from horizonval.plugins.program import (
    camera_file,
    command_line,
    prior_file,
    program_estimator,
    result_of,
)
from horizonval.sensor.knowledge import drawn_prior
from horizonval.spec.load import load_camera, load_prior
from horizonval.spec.suite import ProgramSpec

CAMERA = CameraModel(64, 48, 55.0, 56.0, 31.5, 23.25, distortion=(0.1, 0.02, 1e-3, 2e-3, 0.3))
PROGRAM = """
import json, shutil, sys
shutil.copy(sys.argv[1], "seen.png")
shutil.copy(sys.argv[2], "seen.toml")
print(open("answer.json").read())
"""


def seen(image: np.ndarray | None = None, **changes: Any) -> Observation:
    return Observation(np.full((48, 64), 300.4) if image is None else image, CAMERA, **{"full_scale": 1023.0} | changes)


@pytest.fixture
def ask(tmp_path: Path):  # type: ignore[no-untyped-def]
    """Run a program whose answer is given, or a text of Python; return what becomes of it."""

    def run(answer: Any = None, observation: Observation | None = None, *, text: str = PROGRAM):  # type: ignore[no-untyped-def]
        (tmp_path / "answer.json").write_text(json.dumps(answer))
        (tmp_path / "program.py").write_text(text)
        spec = ProgramSpec(name="mine", command=f"{sys.executable} program.py")
        return program_estimator(spec, tmp_path).run(observation or seen())

    return run


@pytest.mark.parametrize(
    ("full_scale", "top"), [(1023.0, 65535), (255.0, 255), (200.0, 255), (256.0, 65535), (None, 65535)]
)
def test_the_program_gets_the_counts_in_as_many_bits_as_they_need(ask, tmp_path, full_scale, top) -> None:  # type: ignore[no-untyped-def]
    import cv2

    image = np.full((48, 64), 300.4)
    image[0, :4] = (-5.0, 1e6, 40.6, 41.4)
    assert isinstance(ask({"status": "dark", "reason": "x"}, seen(image, full_scale=full_scale)), Refusal)
    read = cv2.imread(str(tmp_path / "seen.png"), cv2.IMREAD_UNCHANGED)
    assert read.dtype == (np.uint16 if top > 255 else np.uint8)
    assert (read == np.clip(np.rint(image), 0, top)).all()


@pytest.mark.parametrize(("projection", "numbers"), [("pinhole", 5), ("fisheye", 4), ("equal_angle", 0)])
def test_the_camera_file_says_what_the_projection_has(tmp_path: Path, projection: str, numbers: int) -> None:
    camera = CameraModel(
        64, 48, 55.0, 56.0, 31.5, 23.25, CAMERA.distortion, projection=projection, image_circle_rad=1.2
    )  # type: ignore[arg-type]
    prior = Prior(altitude_m=512.5e3, altitude_sigma_m=2e3)
    calibration = Calibration(focal_length_sigma=2e-3, principal_point_sigma_px=0.5)
    told = tomllib.loads(camera_file(Observation(np.zeros((48, 64)), camera, prior=prior, calibration=calibration)))
    uncertain = {"focal_length_sigma_percent": 0.2, "principal_point_sigma_px": 0.5, "distortion_sigma_px": 0.0}
    assert told["camera"].pop("uncertainty") == uncertain
    assert told["camera"] == {
        "width": 64,
        "height": 48,
        "projection": projection,
        "fx": 55.0,
        "fy": 56.0,
        "cx": 31.5,
        "cy": 23.25,
        "distortion": list(CAMERA.distortion[:numbers]),
        "image_circle_deg": pytest.approx(math.degrees(2.4)),
    }
    assert told["platform"] == {"altitude_km": 512.5, "altitude_sigma_km": 2.0}
    (tmp_path / "c.toml").write_text(camera_file(seen()))
    read = load_camera(tmp_path / "c.toml").camera
    assert (read.width, read.height, read.fx, read.fy, read.cx, read.cy) == (64, 48, 55.0, 56.0, 31.5, 23.25)
    plain = tomllib.loads(camera_file(seen()))
    assert set(plain) == {"camera"}
    assert "image_circle_deg" not in plain["camera"]


def test_what_is_known_reads_back_as_the_file_of_a_prior(tmp_path: Path) -> None:
    prior = Prior(
        shape="sphere",
        radius_m=6.4e6,
        altitude_m=550e3,
        altitude_sigma_m=1e3,
        r_itrs=np.array([7e6, -1.0, 0.0]),
        position_sigma_m=200.0,
        q_cam_from_itrs=np.array([0.5, -0.5, 0.5, 0.5]),
        attitude_sigma_rad=np.array([0.01, 0.02, 0.03]),
        epoch_utc=datetime(2026, 3, 20, 12, tzinfo=UTC),
        limb_height_m=2e4,
        limb_height_sigma_m=3e3,
        climate="tropical",
        sun_sigma_rad=0.01,
        limb_scale_height_m=0.0,
        limb_scale_height_sigma_m=0.0,
        limb_relief_m=0.0,
        air_height_sigma_m=100.0,
        lens_blur_px=0.5,
        gain_sigma=0.03,
        accept_rad=0.01,
    )
    rough = Prior(nadir_cam=np.array([0.0, 0.6, 0.8]), attitude_sigma_rad=np.array([0.2, 0.2, 0.2]))
    for known in (prior, rough, Prior(), Prior(shape="wgs84")):
        (tmp_path / "p.toml").write_text(prior_file(known))
        spec = load_prior(tmp_path / "p.toml")
        back = drawn_prior(spec, truth_at(ellipsoid=sphere(6.4e6)))
        assert set(back.known) >= set(known.known)
        for name, value in vars(known).items():
            if value is not None:
                # Thousands of metres and degrees of radians: rounded in the last place.
                same = value == getattr(back, name) if isinstance(value, str | datetime) else None
                assert same or getattr(back, name) == pytest.approx(value, rel=1e-15), name


def test_a_claim_is_taken_as_it_was_made(ask) -> None:  # type: ignore[no-untyped-def]
    mounting = Rotation.from_euler("xyz", [0.2, -0.4, 1.0])
    observation = seen(q_cam_from_body=mounting.as_quat())
    answer = {"status": "valid", "nadir_cam": [0.0, 3.0, 4.0], "sigma_nadir_arcsec": 720.0}
    fit = ask(answer, observation)
    assert isinstance(fit, Fit)
    nadir = np.array([0.0, 0.6, 0.8])
    assert fit.nadir_cam == pytest.approx(nadir)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx(roll_pitch_of_nadir(mounting.inv().apply(nadir)))
    # 0.2 deg in the root of the trace, equal in both directions across the nadir, none along it.
    values = np.linalg.eigvalsh(fit.covariance_nadir_cam)
    assert values == pytest.approx([0.0, math.radians(0.2) ** 2 / 2, math.radians(0.2) ** 2 / 2], abs=1e-15)
    assert fit.covariance_nadir_cam @ nadir == pytest.approx(np.zeros(3), abs=1e-18)
    assert (fit.angular_radius_rad, fit.altitude_m, len(fit.points)) == (None, None, 0)
    more = {"roll_deg": 10.0, "altitude_km": 500.5, "angular_radius_deg": 68.0, "points": [[1, 2], [3, 4]]}
    fit = ask(answer | more, observation)
    assert fit.roll_rad == pytest.approx(math.radians(10.0))
    assert fit.pitch_rad == pytest.approx(roll_pitch_of_nadir(mounting.inv().apply(nadir))[1])
    assert (fit.altitude_m, fit.angular_radius_rad) == (500.5e3, pytest.approx(math.radians(68.0)))
    assert fit.points.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert ask(answer | {"pitch_deg": -3.0}, observation).pitch_rad == pytest.approx(math.radians(-3.0))


def test_a_refusal_keeps_its_reason_and_points(ask) -> None:  # type: ignore[no-untyped-def]
    refusal = ask({"status": "short_arc", "reason": "too short", "points": [[1, 2]]})
    assert (refusal.status, refusal.reason, refusal.points.tolist()) == (Outcome.SHORT_ARC, "too short", [[1.0, 2.0]])
    assert ask({"status": "dark"}).reason == "no reason given"


def test_a_long_answer_is_no_mistake(ask) -> None:  # type: ignore[no-untyped-def]
    answer = {"status": "dark", "reason": "long", "points": [[k, 0.5] for k in range(20_000)]}
    assert len(ask(answer).points) == 20_000


def test_paths_take_their_places_in_the_command(tmp_path: Path) -> None:
    paths = Path("/a/i.png"), Path("/a/c.toml"), Path("/a/p.toml")
    assert command_line("prog {prior}", tmp_path, *paths) == ["prog", "/a/p.toml"]
    assert command_line("prog -x 'a b'", tmp_path, *paths) == [
        "prog",
        "-x",
        "a b",
        "/a/i.png",
        "/a/c.toml",
    ]
    assert command_line("prog --in={image}", tmp_path, *paths) == ["prog", "--in=/a/i.png"]
    assert command_line("prog {camera} {image} {image}", tmp_path, *paths)[1:] == [
        "/a/c.toml",
        "/a/i.png",
        "/a/i.png",
    ]
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/prog").touch()
    (tmp_path / "prog").touch()
    assert command_line("bin/prog", tmp_path, *paths)[0] == str(tmp_path / "bin/prog")
    assert command_line("./prog", tmp_path, *paths)[0] == str(tmp_path / "prog")
    assert command_line("prog", tmp_path, *paths)[0] == "prog", "one without a path is looked for as usual"
    assert command_line("bin/none", tmp_path, *paths)[0] == "bin/none"


def test_a_virtual_environments_python_keeps_its_packages(tmp_path: Path) -> None:
    """It is a link, and finds its environment beside the link's own place: the program that it leads to has another."""
    venv.create(tmp_path / "env", symlinks=True, with_pip=False)
    assert (tmp_path / "env/bin/python").is_symlink()
    (tmp_path / "program.py").write_text(
        "import json, sys\nprint(json.dumps({'status': 'dark', 'reason': sys.prefix}))\n"
    )
    spec = ProgramSpec(name="mine", command="env/bin/python program.py {image}")
    refusal = program_estimator(spec, tmp_path).run(seen())
    assert isinstance(refusal, Refusal)
    assert refusal.reason == str(tmp_path / "env")


@pytest.mark.parametrize("command", ["no-such-program-anywhere", "'unbalanced", "' '"])
def test_what_cannot_be_started_is_said(tmp_path: Path, command: str) -> None:
    refusal = program_estimator(ProgramSpec(name="mine", command=command), tmp_path).run(seen())
    assert isinstance(refusal, Refusal)
    assert refusal.status is not Outcome.VALID


@pytest.mark.parametrize(
    "change",
    [
        {"nadir_cam": None},
        {"nadir_cam": [0, 1]},
        {"nadir_cam": [0, 0, 0]},
        {"nadir_cam": [0, 0, float("nan")]},
        {"altitude_km": "high"},
        {"nadir_cam": [0, 0, "x"]},
        {"points": [[1, 2, 3]]},
        {"points": "many"},
        {"roll_deg": "much"},
        {"sigma_nadir_arcsec": [1, 2]},
        {"sigma_nadir_arcsec": -360.0},
        {"sigma_nadir_arcsec": float("nan")},
        {"sigma_nadir_arcsec": float("inf")},
    ],
)
def test_an_answer_that_cannot_be_used_is_no_fit(change: dict[str, Any]) -> None:
    answer = {"status": "valid", "nadir_cam": [0, 0, 1], "sigma_nadir_arcsec": 1.0}
    assert isinstance(result_of(json.dumps(answer).encode(), seen()), Fit)
    assert isinstance(result_of(json.dumps(answer | change).encode(), seen()), Refusal)


@pytest.mark.parametrize("answer", [b"[1]", b'{"status": "fine"}', b'{"status": "valid"}', b"[" * 100_000])
def test_what_is_no_answer_is_a_crash(answer: bytes) -> None:
    assert result_of(answer, seen()).status is Outcome.CRASHED


@pytest.mark.parametrize("claim", [{}, {"sigma_nadir_arcsec": None}, {"sigma_nadir_arcsec": 0}])
def test_leaving_out_the_uncertainty_makes_a_claim_without_one(claim: dict[str, Any]) -> None:
    fit = result_of(json.dumps({"status": "valid", "nadir_cam": [0, 0, 1]} | claim).encode(), seen())
    assert isinstance(fit, Fit)
    # A covariance without a second direction is no claim: scoring judges it by the default.
    assert np.linalg.matrix_rank(fit.total_covariance_nadir_cam) < 2
