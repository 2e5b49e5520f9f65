import numpy as np
import pytest

from horizonval.earth import ozone
from horizonval.errors import UserError


@pytest.mark.parametrize(
    ("wavelength_um", "bremen", "osiris", "tolerance"),
    # 220 K, 1e-21 cm2; tolerances: 5 % where the measurements differ by 4 to 6 %, 1.5 % in the Chappuis band.
    [
        (0.450, 0.190, 0.191, 0.05),
        (0.550, 3.390, 3.379, 0.015),
        (0.602, 5.314, 5.289, 0.015),
        (0.650, 2.54, 2.526, 0.02),
    ],
)
def test_other_measurements(wavelength_um: float, bremen: float, osiris: float, tolerance: float) -> None:
    found = ozone.cross_section_m2(wavelength_um, 220.0) * 1e25
    assert found == pytest.approx(bremen, rel=tolerance)
    assert found == pytest.approx(osiris, rel=tolerance)


def test_linear_in_temperature_and_held_outside() -> None:
    cold, middle, warm, hot, frozen = ozone.cross_section_m2(0.325, np.array([220.0, 250.0, 280.0, 320.0, 150.0]))
    assert warm > 1.1 * cold
    assert middle == pytest.approx((cold + warm) / 2)
    assert hot == warm
    assert frozen == cold


def test_both_ends_of_the_table_are_inside() -> None:
    assert (ozone.cross_section_m2(np.array([0.280, 0.820]), 250.0) > 0).all()


@pytest.mark.parametrize("wavelength_um", [0.279, 0.821, np.nan])
def test_outside_the_table(wavelength_um: float) -> None:
    with pytest.raises(UserError, match=r"within 0\.28 to 0\.82 um"):
        ozone.cross_section_m2([0.5, wavelength_um], 250.0)
