"""A program as an estimator: it reads an image and a camera file and prints one JSON object.

The program gets a 16 bit PNG of the digital numbers, the calibrated camera as TOML, and on request the prior; it never
gets the truth. It prints the format of ``horizonval estimate --json``; ``status`` is required, for a fit also
``nadir_cam``. Missing angles follow from the nadir. ``sigma_nadir_arcsec`` is the claimed rms error, taken as
isotropic; without it the fit claims no uncertainty, and is judged by a default. A crash, a wrong or oversized answer,
and none within the limits of time and memory (:mod:`horizonval.plugins.supervisor`) are outcomes.
"""

from __future__ import annotations

import json
import math
import shlex
import subprocess
import tempfile
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import excerpt
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Calibration, Estimator, Fit, Observation
from horizonval.estimation.prior import DEFAULTS, FILE_KEYS, Prior
from horizonval.geometry.camera import camera_table
from horizonval.geometry.frames import inverse, roll_pitch_of_nadir, rotate
from horizonval.plugins.answer import crash
from horizonval.spec.suite import ProgramSpec

LONGEST_ANSWER = 1 << 20
"""Maximum size of an answer, bytes; typical answers have a few hundred."""
_ARCSEC = math.radians(1 / 3600)


def program_estimator(spec: ProgramSpec, folder: Path) -> Estimator:
    """Return the estimator that runs a program in this process, without limits; ``folder`` is the base of its path."""
    return Estimator(
        name=spec.name,
        title=spec.command,
        run=partial(_run, command=spec.command, folder=folder),
        estimates=spec.estimates,
    )


def command_line(command: str, folder: Path, image: Path, camera: Path, prior: Path) -> list[str]:
    """Return the words of a command with the paths filled in.

    A command without placeholders gets image and camera as last words; the prior needs ``{prior}``.
    """
    words = shlex.split(command)
    places = {"{image}": image, "{camera}": camera, "{prior}": prior}
    if not any(place in word for word in words for place in places):
        words += ["{image}", "{camera}"]
    for place, path in places.items():
        words = [word.replace(place, str(path)) for word in words]
    program = folder / words[0]
    # Links are not resolved: a virtual environment's python finds its packages by its path.
    return [str(program.absolute()) if "/" in words[0] and program.is_file() else words[0], *words[1:]]


def _run(observation: Observation, *, command: str, folder: Path) -> Fit | Refusal:
    with tempfile.TemporaryDirectory(prefix="horizonval-") as place:
        image, camera, prior = (Path(place) / name for name in ("image.png", "camera.toml", "prior.toml"))
        depth = np.uint16 if (observation.full_scale or np.inf) > 255 else np.uint8
        top = np.iinfo(depth).max
        cv2.imwrite(str(image), np.clip(np.rint(observation.image), 0, top).astype(depth))
        camera.write_text(camera_file(observation), encoding="utf-8")
        prior.write_text(prior_file(observation.prior), encoding="utf-8")
        try:
            words = command_line(command, folder, image, camera, prior)
        except (ValueError, IndexError) as e:
            return crash(f"the command {command!r} cannot be read: {e}")
        answer = _answer(words, folder)
    if isinstance(answer, Refusal):
        return answer
    result = result_of(answer, observation)
    return crash(result.reason, answer) if isinstance(result, Refusal) and result.status == "crashed" else result


def camera_file(observation: Observation) -> str:
    """Return the camera file for the ``estimate`` command."""
    camera = observation.camera
    height, width = observation.image.shape
    table = camera_table(camera) | {"width": width, "height": height}
    lines = ["[camera]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    said = observation.calibration or Calibration()
    lines += [
        "[camera.uncertainty]",
        f"focal_length_sigma_percent = {100.0 * said.focal_length_sigma!r}",
        f"principal_point_sigma_px = {said.principal_point_sigma_px!r}",
        f"distortion_sigma_px = {said.distortion_sigma_px!r}",
    ]
    prior = observation.prior
    if prior.altitude_m is not None and prior.altitude_sigma_m is not None:
        lines += ["[platform]", f"altitude_km = {prior.altitude_m / 1e3!r}"]
        lines += [f"altitude_sigma_km = {prior.altitude_sigma_m / 1e3!r}"]
    return "\n".join(lines) + "\n"


def prior_file(prior: Prior) -> str:
    """Return the file for the ``estimate`` command's ``--prior``; an empty table if nothing is known."""
    lines = ["[prior]"]
    for key, name, factor in FILE_KEYS:
        value = getattr(prior, name)
        if value is None or (isinstance(value, float) and value == DEFAULTS[name]):
            continue
        if isinstance(value, datetime):
            text = value.isoformat()
        elif isinstance(value, str):
            # Quoted JSON strings are valid TOML.
            text = json.dumps(value)
        else:
            text = repr((np.asarray(value) / (factor or 1.0)).tolist())
        lines.append(f"{key} = {text}")
    return "\n".join(lines) + "\n"


def _answer(words: list[str], folder: Path) -> bytes | Refusal:
    """Run a program; return its output, or the reason that there is none."""
    try:
        # Standard error is inherited; the supervisor stores its last lines.
        process = subprocess.Popen(words, cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    except OSError as e:
        return crash(f"the program {words[0]!r} cannot be started: {e.strerror}")
    assert process.stdout is not None
    with process:
        printed = process.stdout.read(LONGEST_ANSWER + 1)
        if len(printed) > LONGEST_ANSWER:
            process.kill()
            return crash("the program printed more than a megabyte, where one JSON object was expected")
    return printed if process.returncode == 0 else crash(f"the program ended with status {process.returncode}", printed)


def result_of(answer: bytes, observation: Observation) -> Fit | Refusal:
    """Return the result in a program's answer."""
    try:
        data = json.loads(answer)
    except (ValueError, RecursionError):
        return crash(f"the program printed no JSON object but {answer[:40]!r}")
    if not isinstance(data, dict):
        return crash(f"the program printed {excerpt(json.dumps(data))}, where a JSON object was expected")
    status = data.get("status")
    if status not in tuple(Outcome):
        return crash(f"the program's status {str(status)[:40]!r} is none of {', '.join(Outcome)}")
    try:
        points = np.asarray(data.get("points") or [], dtype=np.float64).reshape(-1, 2)
        if Outcome(status) is not Outcome.VALID:
            return Refusal(Outcome(status), str(data.get("reason") or "no reason given"), points)
        return _fit(data, points, observation)
    except (TypeError, ValueError, OverflowError) as e:
        return crash(f"the program's answer cannot be used: {e}")


def _fit(data: Mapping[str, Any], points: NDArray[np.float64], observation: Observation) -> Fit:
    nadir = np.asarray(data.get("nadir_cam"), dtype=np.float64)
    if nadir.shape != (3,) or not np.isfinite(nadir).all() or not np.any(nadir):
        raise ValueError("nadir_cam is no direction")
    nadir = nadir / np.linalg.norm(nadir)
    angles = roll_pitch_of_nadir(rotate(inverse(observation.q_cam_from_body), nadir))
    sigma = float(data.get("sigma_nadir_arcsec") or 0.0) * _ARCSEC
    if not 0.0 <= sigma < math.inf:
        raise ValueError(f"sigma_nadir_arcsec is {data['sigma_nadir_arcsec']}, no standard deviation")

    def radians(key: str) -> float | None:
        return None if data.get(key) is None else math.radians(float(data[key]))

    claimed = radians("roll_deg"), radians("pitch_deg")
    roll, pitch = (float(x) if said is None else said for x, said in zip(angles, claimed, strict=True))
    altitude = data.get("altitude_km")
    return Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=0.5 * sigma**2 * (np.eye(3) - np.outer(nadir, nadir)),
        roll_rad=roll,
        pitch_rad=pitch,
        angular_radius_rad=radians("angular_radius_deg"),
        altitude_m=None if altitude is None else float(altitude) * 1e3,
        points=points,
    )
