import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.earth.gases import ozone


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
    assert (ozone.cross_section_m2(np.array([0.280, 1.0]), 250.0) > 0).all()


@pytest.mark.parametrize("wavelength_um", [0.279, 1.001, np.nan])
def test_outside_the_table(wavelength_um: float) -> None:
    with pytest.raises(UserError, match=r"within 0\.28 to 1 um"):
        ozone.cross_section_m2([0.5, wavelength_um], 250.0)


@pytest.mark.parametrize(
    ("wavelength_nm", "per_cm2"),
    # Bremen measurements (Bogumil et al. 2003, 220 K) averaged over the 20 nm that begin here, 1e-23 cm2.
    [(820, 11.83), (840, 11.53), (860, 6.01), (880, 5.30)],
)
def test_beyond_the_measurements(wavelength_nm: int, per_cm2: float) -> None:
    # Our continuation is log-linear; the measurements have bands about it, by 22 % at most. No more is claimed.
    mean = ozone.cross_section_m2(np.arange(wavelength_nm + 1, wavelength_nm + 21) * 1e-3, 220.0).mean()
    assert mean * 1e27 == pytest.approx(per_cm2, rel=0.25)


def test_positive_and_finite_everywhere() -> None:
    wavelength = np.linspace(0.28, 1.0, 7201)[:, None]
    values = ozone.cross_section_m2(wavelength, np.array([150.0, 220.0, 250.0, 280.0, 330.0]))
    assert (values > 0).all()
    assert np.isfinite(values).all()
    # Ten orders of magnitude between the Hartley band's edge at 280 nm and the gap at 380 nm.
    assert values.max() < 5e-22
