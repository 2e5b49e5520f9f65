"""The ``[regression]`` table of a suite: what a night compares, and the margins it allows.

This is the one place for margins. Each is in the unit of its metric, with the engineering reason beside it.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model, Name, Positive, unit

MOST_GATES = 12
"""More gates are more chances for a false alarm, paid for with power by all."""

Lane = Literal["replay", "rerender", "fresh"]
Metric = Literal[
    "nadir_error",
    "error_over_bound",
    "availability",
    "false_valid",
    "limb_radiance",
    "disc_radiance",
    "limb_displacement",
    "noise",
]

UNITS: dict[str, str] = {
    "nadir_error": "arcsec",
    "error_over_bound": "1",
    "availability": "percentage points",
    "false_valid": "percentage points",
    "limb_radiance": "%",
    "disc_radiance": "%",
    "limb_displacement": "px",
    "noise": "%",
}
IMAGE_METRICS = ("limb_radiance", "disc_radiance", "limb_displacement", "noise")
TWO_SIDED = ("limb_radiance", "disc_radiance", "noise")
"""Metrics of which neither sign is better."""


class GateSpec(Model):
    """One gate: a metric in one lane, the largest change for the worse that does not matter, and why."""

    name: Name
    """Name of the gate."""
    lane: Lane
    """`replay` (frozen images through today's estimators), `rerender` (the same scenes and noise again) or `fresh`
    (scenes drawn anew).
    """
    metric: Metric
    """`nadir_error`: mean change of the angle between claimed and true nadir where both runs claim one.
    `error_over_bound`: the same of that angle over what the limb in the frame allows any method. `availability`: loss
    among frames that should give an attitude. `false_valid`: gain of false claims among all frames. `limb_radiance`,
    `disc_radiance`: bias of the region's mean. `limb_displacement`: root mean square, along the limb. `noise`: change
    of the detector noise's standard deviation, in space.
    """
    margin: Annotated[Positive, unit("that of the key `unit`")]
    """Largest change for the worse that does not matter."""
    unit: str
    """Unit of the margin; each metric has its own."""
    reason: Annotated[str, Field(min_length=20)]
    """Engineering reason of the margin."""
    estimators: list[str] = []
    """Estimators that the gate looks at; all where it is empty."""
    cases: list[str] = []
    """Tables `[[cases]]` that the gate looks at; all where it is empty."""

    @model_validator(mode="after")
    def _sense(self) -> GateSpec:
        if self.unit != UNITS[self.metric]:
            raise ValueError(f'unit of {self.metric} is "{UNITS[self.metric]}"')
        if self.metric in IMAGE_METRICS and self.lane != "rerender":
            raise ValueError(f'{self.metric} compares images; lane must be "rerender"')
        return self


class RegressionSpec(Model):
    """What a night does with the suite.

    The fresh lane draws the suite's Sobol tables again with a seed of the night.
    """

    replicates: Annotated[int, Field(ge=1, le=1000), unit("1")] = 4
    """Detector images of every frame, each with noise of its own."""
    most_batches: Annotated[int, Field(ge=1, le=10), unit("1")] = 2
    """Batches that the fresh lane takes at most: further ones where its gates are inconclusive."""
    published: bool = False
    """Whether a night also computes key figures of the published systems again, and compares them with those of the
    committed pages. They are the program's and not the suite's: seven systems, whatever the suite renders.
    """
    gate: Annotated[list[GateSpec], Field(min_length=1, max_length=MOST_GATES)]
    """The gates."""

    @model_validator(mode="after")
    def _unique_names(self) -> RegressionSpec:
        names = [gate.name for gate in self.gate]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two gates are named {twice[0]!r}")
        return self
