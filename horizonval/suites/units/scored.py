"""From images, rendered or archived, to rows: every estimator on every noise sample, compared with the truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.frame import DetectorImage, FrameTruth
from horizonval.jobs.progress import Stopwatch
from horizonval.plugins.supervisor import supervisor_of
from horizonval.scoring.bound import Bound, known_bound
from horizonval.scoring.errors import score
from horizonval.scoring.expected import Expected, expected_of_heads, expected_outcome
from horizonval.scoring.row import Row, make_row
from horizonval.scoring.summary import mean_noise_nees
from horizonval.suites.observation import method_radius_m, observation_of, observation_of_heads
from horizonval.suites.plan import CasePlan
from horizonval.suites.record import details_of

PROCESSOR = "processor "
"""Stage of an estimator's processor time (with its name); ``estimate`` with the name is the wall clock."""

DRAWS = "draws"
"""Stage of all further noise samples; the cost of a frame does not include them."""


@dataclass
class Observed:
    """The images of one camera at one instant, and the estimators' results.

    ``images``: by band, in the camera file's order. ``redrawn``: by band, images with other noise. ``details``: data
    for the report's overlay. ``expected``: by band and by what an estimator needs. ``bounds``: by band.
    """

    images: dict[str, DetectorImage]
    redrawn: dict[str, list[DetectorImage]] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)
    expected: dict[tuple[str, str], Expected] = field(default_factory=dict)
    bounds: dict[str, Bound | None] = field(default_factory=dict)

    @property
    def truth(self) -> FrameTruth:
        """The truth of the first band's image."""
        return next(iter(self.images.values())).truth

    def expected_of(self, band: str, needs: Literal["image", "pose", "heads"]) -> Expected:
        """Return the expected outcome, cached for all estimators with the same needs."""
        if (band, needs) not in self.expected:
            truth, bound = self.images[band].truth, self.bound(band)
            self.expected[band, needs] = expected_outcome(truth, band, needs=needs, bound=bound)
        return self.expected[band, needs]

    def bound(self, band: str) -> Bound | None:
        """Return the bound of a band, cached for all estimators; None where the image carries no information."""
        if band not in self.bounds:
            image = self.images[band]
            self.bounds[band] = known_bound([image], image.truth, band)
        return self.bounds[band]


def score_alone(observed: Observed, name: str, estimators: Iterable[str], plan: CasePlan, watch: Stopwatch) -> None:
    """Run estimators of one image, and add their rows under the name of a case."""
    names = list(estimators)
    for number, (band, image) in enumerate(observed.images.items()):
        for estimator in names:
            drawn = (image, *observed.redrawn.get(band, ()))
            observations = (observation_of(one, plan.estimator(estimator)) for one in drawn)
            _score(observed, name, band, number, estimator, observations, plan, watch)


def score_together(
    heads: Mapping[str, Observed], name: str, estimators: Iterable[str], plan: CasePlan, watch: Stopwatch
) -> Observed:
    """Run estimators that need all heads; images and truth of the result are the first head's.

    ``heads``: by name, in the camera file's order; answers are in the camera frame of the first. ``name``: of the rows.
    """
    names, first = list(estimators), next(iter(heads.values()))
    scene = Observed(first.images)
    for number, band in enumerate(first.images):
        if any(band not in one.images for one in heads.values()):
            continue
        draws = [{head: one.images[band] for head, one in heads.items()}]
        draws += [{head: one.redrawn[band][k] for head, one in heads.items()} for k in range(plan.draws - 1)]
        scene.bounds[band] = known_bound([one.images[band] for one in heads.values()], scene.truth, band)
        scene.expected[band, "heads"] = expected_of_heads(
            [one.expected_of(band, "heads") for one in heads.values()], scene.truth, scene.bounds[band]
        )
        for estimator in names:
            observations = (observation_of_heads(images, plan.estimator(estimator)) for images in draws)
            _score(scene, name, band, number, estimator, observations, plan, watch)
    # The Sun affects the nearest head most, which need not be the first.
    nearest_rad = min(one.truth.sun_boresight_rad for one in heads.values())
    scene.rows = [replace(row, sun_boresight_deg=math.degrees(nearest_rad)) for row in scene.rows]
    return scene


def _score(
    observed: Observed,
    name: str,
    band: str,
    band_number: int,
    estimator_name: str,
    observations: Iterator[Observation],
    plan: CasePlan,
    watch: Stopwatch,
) -> None:
    """Run one estimator on all noise samples of a frame, and add its row."""
    estimator, truth = plan.estimator(estimator_name), observed.images[band].truth
    with watch.stage(f"estimate {estimator_name}"):
        supervisor = supervisor_of(plan.limits)
        result: Fit | Refusal = supervisor.run(estimator_name, next(observations))
    if supervisor.spent_s is not None:
        watch.add(PROCESSOR + estimator_name, supervisor.spent_s)
    results = [result]
    for other in observations:
        with watch.stage(DRAWS):
            results.append(supervisor.run(estimator_name, other))
    fits = [one for one in results if isinstance(one, Fit)]
    # A crash with any noise sample is a crash on the frame.
    result = next((one for one in results if one.status is Outcome.CRASHED), result)
    with watch.stage("score"):
        scored = score(truth, estimator, result, earth_radius_m=method_radius_m(truth))
        if plan.draws > 1:
            scored = replace(scored, nees_noise=mean_noise_nees(fits), noise_draws=len(fits))
        row = make_row(
            case=name,
            camera=truth.camera_name,
            band=band,
            estimator=estimator_name,
            truth=truth,
            expected=observed.expected_of(band, estimator.needs),
            score=scored,
            bound=observed.bound(band),
        )
    observed.rows.append(row)
    # The report draws the first band; further bands have separate entries.
    observed.details[estimator_name if band_number == 0 else f"{estimator_name} [{band}]"] = details_of(result)
