"""Mistakes in a suite that the files' models cannot know, found before anything is rendered."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from horizonval.core.errors import MistakeCollector, UserError
from horizonval.earth.spectral.bands import limits_um
from horizonval.estimation.fit.templates import is_of_band, templates_of
from horizonval.geometry import clock
from horizonval.geometry.camera import camera_from_spec, check_invertible
from horizonval.geometry.pose import place_from_spec
from horizonval.renderer.frame_cost import refuse_too_large
from horizonval.sensor.knowledge import drawn_errors, refuse_unknown_climate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import Case, Suite
from horizonval.spec.prior import PriorSpec, is_limb_table
from horizonval.suites import stability
from horizonval.suites.plan import CasePlan, of_heads
from horizonval.suites.worker_memory import largest_frame


def refuse_mistakes(suite: Suite, plan: CasePlan) -> None:
    """Find mistakes beyond the reach of the files' models: estimators, atmospheres, detectors, positions.

    Each distinct camera and atmosphere is checked once. Raises ``UserError``: naming the suite, the frame and the key.
    """
    from horizonval.earth.optical import optical_model

    for program in suite.programs:
        if program.name not in suite.estimators:
            raise UserError(
                f"the program {program.name!r} is not among the estimators",
                where=suite.estimators_key,
                fix="add its name, or take the [[estimator]] table away",
            )
    for name in suite.estimators:
        try:
            plan.estimator(name)
        except UserError as e:
            raise e.inside(suite.estimators_key) from e
    check_heads(suite, plan)
    cameras: set[int] = set()
    matters = _outermost_matters(suite.cases)
    collector = MistakeCollector()
    for case in suite.cases:
        with collector.caught(case.name):
            try:
                _check_case(case, cameras)
                if case.name in matters:
                    optical_model(case.scene, case.camera)
            except UserError as e:
                raise e.inside(f"{suite.source}: {case.name}") from e
    collector.tell()
    largest = largest_frame(suite)
    if largest is not None:
        try:
            refuse_too_large(largest.scene, largest.camera)
        except UserError as e:
            raise e.inside(f"{suite.source}: {largest.name}") from e
    stability.check(suite)


def check_heads(suite: Suite, plan: CasePlan) -> None:
    """Every estimator must have a frame, and those that see all heads a camera with several."""
    run: set[str] = set()
    for case in suite.cases:
        together = plan.together(case)
        if together and case.estimators is not None and not of_heads(case):
            raise _without_heads(together[0], f"{suite.source}: {case.name}: estimators")
        run.update(plan.alone(case), together if of_heads(case) else ())
    for name in plan.estimators:
        if name in run:
            continue
        where = suite.estimators_key
        if plan.estimator(name).needs == "heads":
            raise _without_heads(name, where)
        raise UserError(
            f"no frame runs {name!r}", where=where, fix="name it in a [[cases]] table's estimators, or take it away"
        )


def _without_heads(name: str, where: str) -> UserError:
    return UserError(
        f"the estimator {name!r} needs the images of all heads",
        where=where,
        expected="a frame with a camera of several heads and without camera.head",
    )


def _check_prior(prior: PriorSpec, camera: CameraSpec) -> None:
    refuse_unknown_climate(prior)
    if prior.climate is not None and is_limb_table(prior.climate):
        _check_table(prior.climate, camera)
    solar = [band.name for band in camera.band if band.kind == "solar"]
    if prior.limb_height_sigma_km is not None and prior.limb_height_km is None and solar:
        raise UserError(
            f"a sigma alone, and the truth has no limb height of the solar band {solar[0]!r}",
            where="prior.limb_height_sigma_km",
            expected="limb_height_km beside it",
        )


def _check_table(climate: str, camera: CameraSpec) -> None:
    """Raise ``UserError`` for a table of profiles that cannot be read or has none of a camera's bands."""
    try:
        table = templates_of(Path(climate))
    except UserError as e:
        raise e.inside("prior.climate") from e
    if not any(is_of_band(table, band.kind, limits_um(band)) for band in camera.band):
        low, high = table.band_um
        raise UserError(
            f"a {table.band_kind} table of {low:g} to {high:g} um, which is none of the camera's bands",
            where=f"prior.climate: {climate}",
            expected=", ".join("{} ({:g} to {:g} um)".format(band.name, *limits_um(band)) for band in camera.band),
        )


def _outermost_matters(cases: Sequence[Case]) -> set[str]:
    """Return the names of the frames whose distinct air and bands are checked.

    Of atmospheres that differ only in numbers, such as a sampled haze depth, those with the extremes of each number are
    checked: a value out of range is so at an end.
    """
    alike: dict[tuple[str, int, float], list[tuple[str, list[float]]]] = {}
    for case in cases:
        numbers: list[float] = []
        words = json.dumps(_without_numbers(case.scene.atmosphere.model_dump(mode="json"), numbers))
        # Cases of one camera file share the object.
        key = words, id(case.camera), case.scene.render.band_error
        alike.setdefault(key, []).append((case.name, numbers))
    found: set[str] = set()
    for matters in alike.values():
        numbers_of_all = zip(*(numbers for _, numbers in matters), strict=True)
        ends = {i for one in numbers_of_all if min(one) < max(one) for i in (one.index(min(one)), one.index(max(one)))}
        found.update(matters[i][0] for i in ends or {0})
    return found


def _without_numbers(value: Any, numbers: list[float]) -> Any:
    """Return plain data with a word in place of each number; the numbers are appended to ``numbers``."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        numbers.append(value)
        return "a number"
    if isinstance(value, dict):
        return {key: _without_numbers(one, numbers) for key, one in value.items()}
    if isinstance(value, list):
        return [_without_numbers(one, numbers) for one in value]
    return value


def _check_case(case: Case, cameras: set[int]) -> None:
    from horizonval.sensor.motion import check_scene_turn
    from horizonval.sensor.observe import check_camera

    camera = id(case.camera)
    if camera not in cameras:
        if case.camera.detector is None:
            raise UserError(
                f"camera {case.scene.camera.file!r} has no detector",
                where="camera.file",
                expected="a [detector] table in the camera file",
            )
        check_camera(case.camera)
        check_invertible(camera_from_spec(case.camera.camera))
        cameras.add(camera)
    place_from_spec(case.scene)
    check_scene_turn(case.scene, case.camera)
    if case.scene.calibration is not None:
        errors = drawn_errors(case.scene.calibration, case.scene.model_dump(mode="json"), case.scene.camera.head)
        errors.camera(camera_from_spec(case.camera.camera))
    if case.scene.prior is not None:
        _check_prior(case.scene.prior, case.camera)
    try:
        clock.in_range(case.scene.platform.epoch_utc)
    except UserError as e:
        raise e.at("platform.epoch_utc") from e
