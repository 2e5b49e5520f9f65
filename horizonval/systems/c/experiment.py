"""System C: the ideal horizon-sensor module of a space simulator, held against the exact horizon.

The module that ships is compared with two other ways to the same reading (:mod:`ideal_module_poses`), then the oracle
of image estimators with the truth of rendered frames, and every image estimator with the oracle.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from horizonval.estimation import registry
from horizonval.estimation.methods import ideal
from horizonval.estimation.observation import Fit
from horizonval.scoring.errors import ARCSEC, angle_between, score
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of
from horizonval.systems.c.figures import readings_figure
from horizonval.systems.c.poses import RADIUS_M, departures, known_poses
from horizonval.systems.result import Reproduction, Row, Table
from horizonval.systems.workshop import Plain, Workshop

LIMIT_RAD = 1e-9
POSES = 1000
BRUTE = 100
"""Of the poses, those that are minimised as well."""

FRAMES: dict[str, Plain] = {
    "visible, sphere without air": {
        "camera": "vis-cmos-512-60deg",
        "width": 320,
        "earth": {"shape": "sphere"},
        "atmosphere": {"profile": "none"},
    },
    "visible, WGS84 without air": {
        "camera": "vis-cmos-512-60deg",
        "width": 320,
        "earth": {"shape": "wgs84"},
        "atmosphere": {"profile": "none"},
    },
    "infrared, WGS84 with air": {
        "camera": "ir-bolometer-160-57deg",
        "width": 160,
        "earth": {"shape": "wgs84"},
        "atmosphere": {"profile": "us_standard"},
    },
}


def against_oracle(item: Plain) -> Plain:
    """Render one frame; return the oracle's departure from its truth and each image estimator's from both [rad]."""
    from horizonval.renderer.scene.frame import render_frame
    from horizonval.sensor.observe import observe

    camera = load_camera(item["camera"])
    shape = {"width": item["width"], "height": item["width"] * camera.camera.height // camera.camera.width}
    camera = camera.model_copy(update={"camera": camera.camera.model_copy(update=shape)})
    scene = SceneSpec.model_validate(
        {
            "scene": {"name": "ideal-module", "seed": item["seed"]},
            "camera": {"file": item["camera"], "mount_pitch_deg": 65.0},
            "platform": {
                "altitude_km": 500.0,
                "latitude_deg": 40.0,
                "longitude_deg": 20.0,
                "epoch_utc": datetime(2026, 6, 21, 10, tzinfo=UTC),
            },
            "attitude": {"roll_deg": 3.0, "pitch_deg": -2.0, "yaw_deg": 10.0},
            "earth": item["earth"],
            "atmosphere": item["atmosphere"],
        }
    )
    image = observe(render_frame(scene, camera), camera, seed=item["seed"])
    truth = image.truth
    oracle = ideal.ESTIMATOR.run(observation_of(image, ideal.ESTIMATOR))
    assert isinstance(oracle, Fit)
    result: Plain = {
        "truth": angle_between(np.array(truth.nadir_geocentric_cam), oracle.nadir_cam),
        "angles": max(abs(oracle.roll_rad - truth.roll_rad), abs(oracle.pitch_rad - truth.pitch_rad)),
        "estimators": {},
        "asked": 0,
    }
    for name in registry.names():
        estimator = registry.get(name)
        if estimator.needs != "image" or estimator.estimates != "geocentric":
            continue
        result["asked"] += 1
        fit = registry.run_safely(estimator, observation_of(image, estimator))
        scored = score(truth, estimator, fit)
        if isinstance(fit, Fit) and scored.nadir_error_arcsec is not None:
            error = scored.nadir_error_arcsec * ARCSEC
            result["estimators"][name] = {
                "error": error,
                "apart": abs(angle_between(oracle.nadir_cam, fit.nadir_cam / np.linalg.norm(fit.nadir_cam)) - error),
            }
    return result


def reproduce(workshop: Workshop) -> Reproduction:
    """Do the comparisons and return rows, table and figure."""
    seed = workshop.seed
    random = workshop.each("C: random poses", departures, {"poses": {"seed": seed, "count": POSES, "brute": BRUTE}})
    known = workshop.each("C: known poses", known_poses, {"poses": {"seed": seed, "count": POSES}})["poses"]
    frames = workshop.each("C: frames", against_oracle, {k: {**v, "seed": seed} for k, v in FRAMES.items()})
    rows = (*_pose_rows(random["poses"], known), *_frame_rows(frames))
    worst = max(row.measured for row in rows if row.unit == "rad")
    return Reproduction(
        system="C",
        title="Ideal Earth-horizon-sensor module",
        source="Documentation of a commercial space simulator's horizon-sensor module",
        summary=(
            f"The module as documented (two tangents, nearer horizon point, signed roll and pitch errors) agrees with "
            f"the exact horizon curve, with its own documented matrices and with the truth of rendered frames to "
            f"{worst:.1e} rad. It is the oracle of all image estimators: what a score calls their error is their "
            f"angle to it."
        ),
        rows=rows,
        tables=(_estimator_table(frames),),
        figures=(readings_figure(),),
        settings={"radius_m": RADIUS_M, "poses": POSES, "minimised": BRUTE, "altitude_km": [100, 100_000]},
    )


def _pose_rows(random: Plain, known: Plain) -> list[Row]:
    def row(name: str, value: float, why: str, unit: str = "rad", limit: float = LIMIT_RAD) -> Row:
        return Row(name, "exact by definition", value, unit, why, limit=limit)

    rows = []
    for key, other, how in (
        ("documented", "documented matrices", "the documentation's steps, done with rotation matrices"),
        ("exact", "exact horizon curve", "nearest point of the curve by root finding, its chord as level"),
    ):
        for what, value in zip(("roll error", "pitch error", "direction to H"), random[key], strict=True):
            rows.append(row(f"{what} against the {other}: largest", value, f"{POSES} random poses; {how}."))
    return [
        *rows,
        row(
            "pitch error against plain minimisation along the horizon: largest",
            random["brute"],
            f"{BRUTE} of the poses, scipy's bounded minimiser on the angle between boresight and horizon.",
        ),
        row(
            "two-tangent theorem: asin(R / D) against the tangents' angle, largest",
            random["tangent"],
            "A line to H passes the centre at the distance R.",
        ),
        row("boresight on the horizon, level right axis: largest reading", known["level"], f"{POSES} poses made so."),
        row(
            "pitch error at known heights above the horizon: largest departure",
            known["pitch"],
            f"{POSES} poses, 1e-8 rad to 0.9 of the Earth's angular radius above and below.",
        ),
        row(
            "roll error at known rolls: largest departure",
            known["roll"],
            f"{POSES} poses, 1e-8 to 2.5 rad either way; the right axis above the level is positive.",
        ),
        row(
            "wrong signs across the horizon and across level",
            known["wrong"],
            f"Of {2 * POSES}: positive above the horizon, negative below it, down to 1e-8 rad.",
            f"of {2 * POSES}",
            0.0,
        ),
        row(
            "wrong statuses at nadir, zenith, on and inside the Earth",
            known["statuses"],
            "Every horizon point is equally near at nadir and zenith, none exists inside: a status, not a number.",
            "of 4",
            0.0,
        ),
        row(
            "pitch error next to nadir and zenith: largest departure",
            known["near_axis"],
            "1e-8 to 1e-3 rad from them the nearer point is still the right one.",
        ),
    ]


def _frame_rows(frames: dict[str, Plain]) -> list[Row]:
    asked = sum(found["asked"] for found in frames.values())
    answered = sum(len(found["estimators"]) for found in frames.values())
    rows = [
        Row(
            "image estimators' answers compared with the oracle",
            None,
            answered,
            f"of {asked}",
            "Every registered estimator of the geocentric nadir from one image, on every frame; those that refuse a "
            "frame have no row.",
            limit=1.0,
            at_least=True,
        )
    ]
    for name, found in frames.items():
        rows.append(
            Row(
                f"oracle against the frame's truth: {name}",
                "exact by definition",
                max(found["truth"], found["angles"]),
                "rad",
                "Nadir, roll and pitch of the pose in the frame's header against the truth written beside it.",
                limit=LIMIT_RAD,
            )
        )
        for estimator, one in found["estimators"].items():
            rows.append(
                Row(
                    f"{estimator}, angle to the oracle against the score's error: {name}",
                    None,
                    one["apart"],
                    "rad",
                    f"The score gives {one['error'] / ARCSEC:.2f} arcsec; the oracle is the truth of the score.",
                    limit=LIMIT_RAD,
                )
            )
    return rows


def _estimator_table(frames: dict[str, Plain]) -> Table:
    lines: list[tuple[Any, ...]] = [
        (name, estimator, one["error"] / ARCSEC)
        for name, found in frames.items()
        for estimator, one in found["estimators"].items()
    ]
    return Table(
        "Image estimators against the oracle",
        ("frame", "estimator", "angle to the oracle [arcsec]"),
        tuple(lines),
        "With detector noise; estimators that refuse a frame are left out.",
    )
