"""What is wrong of the camera and the time that estimators are told: the table ``[calibration]``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from horizonval.spec.base import Model
from horizonval.spec.numbers import Finite, FrameName, Listed, NonNegative

Percent = Annotated[float, Field(ge=-50, le=50)]
SigmaPercent = Annotated[float, Field(ge=0, le=20)]
Turn = Annotated[float, Field(ge=-180, le=180)]
SigmaTurn = Annotated[float, Field(ge=0, le=60)]
PerAxis = Annotated[tuple[SigmaTurn, SigmaTurn, SigmaTurn], Listed]
Seconds = Annotated[float, Field(ge=-600, le=600)]
SigmaSeconds = Annotated[float, Field(ge=0, le=100)]


class CalibrationSpec(Model):
    """By how much the camera and the time that estimators are told differ from those of the frame.

    An `error` is what is told minus what is true, and stands as it is. A `sigma` adds an error that is drawn from it,
    and is told to the estimator, which may count on it. Frame, noise and truth are what they are without the table.
    """

    draw: FrameName | None = None
    """Name of the flight that errors are drawn for: frames of one name and seed share them, as those of one camera do.
    Without the key every frame has its own (those of one `scene.draw` share them).
    """
    focal_length_error_percent: Percent = 0.0
    """Of both focal lengths, of a fisheye of its scale."""
    focal_length_sigma_percent: SigmaPercent = 0.0
    """Standard deviation of a drawn error of it."""
    principal_point_error_px: Annotated[tuple[Finite, Finite], Listed] = (0.0, 0.0)
    """Of the principal point: column, row."""
    principal_point_sigma_px: NonNegative = 0.0
    """Standard deviation of a drawn error of each of the two."""
    distortion_error_px: Finite = 0.0
    """Of the radial distortion, as it moves the image's farthest corner outwards: a change of `k1`."""
    distortion_sigma_px: NonNegative = 0.0
    """Standard deviation of a drawn error of it."""
    mounting_error_deg: Annotated[tuple[Turn, Turn, Turn], Listed] = (0.0, 0.0, 0.0)
    """Of the mounting about the body's x, y and z: by as much roll and pitch of an answer are larger, of a level body.
    """
    mounting_sigma_deg: PerAxis = (0.0, 0.0, 0.0)
    """Standard deviation of a drawn error of each of the three."""
    exposure_offset_s: Seconds = 0.0
    """By how much later than its stamp the image was taken: a drawn position and attitude are those of the stamp."""
    exposure_offset_sigma_s: SigmaSeconds = 0.0
    """Standard deviation of a drawn offset."""
    clock_error_s: Seconds = 0.0
    """By how much the clock is ahead: the drawn position is the orbit's at the wrong time, 7.5 km for each second."""
    clock_sigma_s: SigmaSeconds = 0.0
    """Standard deviation of a drawn error of it."""
