"""What an estimator is told of a detector's calibration, against images of an even scene."""

from __future__ import annotations

import pytest

from horizonval.earth.spectral.bands import width_um
from horizonval.estimation.observation import Estimator, Observation
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.suites.observation import observation_of

NEVER = Estimator(name="never", title="", run=lambda observation: None, estimates="geocentric")  # type: ignore[arg-type,return-value]


def seen(make_frame, tables, radiance: float) -> Observation:
    image = observe(make_frame(radiance, tables), CameraSpec.model_validate(tables), noise=False)
    return observation_of(image, NEVER)


def test_a_digital_number_of_a_visible_array_is_a_radiance(make_frame, camera_tables) -> None:
    """Two even scenes: 10 W m-2 sr-1 apart, on the axis, to the rounding of one number in some hundred."""
    dark, bright = (seen(make_frame, camera_tables, radiance) for radiance in (5.0, 15.0))
    row, column = dark.image.shape[0] // 2, dark.image.shape[1] // 2
    steps = bright.image[row, column] - dark.image[row, column]
    assert steps > 100.0
    assert bright.radiance_per_dn is not None
    # Four pixels about the axis have 0.9998 of its light and more.
    assert steps * bright.radiance_per_dn == pytest.approx(10.0, rel=1.5 / steps + 2e-3)
    assert bright.radiance_per_dn == dark.radiance_per_dn
    assert bright.band_width_um == pytest.approx(width_um(CameraSpec.model_validate(camera_tables).band[0]))
