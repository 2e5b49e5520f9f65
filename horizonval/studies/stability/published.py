"""What others have found, to stand beside the study's figures: value, source, and why ours may differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quantity = Literal[
    "edge_pitch_deg",
    "edge_roll_deg",
    "field_pitch_deg",
    "requirement_deg",
    "variation",
    "half_km",
    "plateau_w_m2_sr",
    "half_std_km",
    "threshold_std_km",
]

_ERRORS = "study of systematic horizon-sensor errors from infrared radiance variation, 1980, polar orbit of 900 km"
_DEFINITION = "Horizon Definition Study, 1966 (615 to 715 cm⁻¹, computed profiles); second hand, not checked"


@dataclass(frozen=True)
class PublishedStability:
    """One published figure.

    Attributes
    ----------
    quantity : str
        Which of the study's figures stands beside it.
    text, source : str
    low, high : float
        Equal for a single figure; in the unit of the quantity's name, ``variation`` as a share.
    why : str
        Why ours differs, or may.
    field_deg : float, optional
        Of the field sensor.
    altitude_km : float, optional
        Of the orbit, where the figure belongs to one.
    """

    quantity: Quantity
    text: str
    low: float
    high: float
    source: str
    why: str
    field_deg: float | None = None
    altitude_km: float | None = None


PUBLISHED = (
    PublishedStability(
        "edge_pitch_deg",
        "largest pitch error of an edge scanner",
        0.06,
        0.06,
        _ERRORS,
        "Which edge the published scanner takes is not known here. The seasons of mean climates alone give as much to "
        "a fixed radiance, and half to a head that measures its own plateau. Weather and stratospheric warmings, which "
        "the blended climates lack, come on top.",
        altitude_km=900.0,
    ),
    PublishedStability(
        "edge_roll_deg",
        "largest roll error of an edge scanner",
        0.03,
        0.03,
        _ERRORS,
        "Ours comes from the orbit's inclination alone, near the poles: at exactly 90° air that is the same at every "
        "longitude looks alike to both sides, and the roll error is zero. Real air varies with longitude.",
        altitude_km=900.0,
    ),
    PublishedStability(
        "field_pitch_deg",
        "largest error of a sensor with a field of 2°",
        0.12,
        0.12,
        _ERRORS,
        "A quarter of the field times the relative difference of radiance between opposite heads. Winter against "
        "summer makes nearly all of it, and mean climates have that.",
        field_deg=2.0,
        altitude_km=900.0,
    ),
    PublishedStability(
        "requirement_deg",
        "requirement on horizon sensors",
        0.03,
        0.1,
        "the same study",
        "Errors left without any correction for latitude and season.",
    ),
    PublishedStability(
        "variation",
        "variation of radiance with longitude, 14 to 16 µm, seen from orbit by IRS-1B",
        0.30,
        0.30,
        "Seshamani, Alex and Jain, Optical Engineering 33 (11), 1994",
        "Ours does not vary with longitude at all; its range is over latitude and season. Planetary waves and warmings "
        "of the polar stratosphere (the variation follows the temperature at 10 hPa) are not in a blend of climates. A "
        "difference of 30 % between opposite heads would cost a field of 2° an error of 0.15°.",
    ),
    PublishedStability(
        "half_km",
        "height of half the plateau",
        38.0,
        45.0,
        _DEFINITION,
        "The spread between spectroscopies is 1.5 to 2 km; carbon dioxide has risen by a quarter since, which lifts "
        "the horizon by about a kilometre.",
    ),
    PublishedStability(
        "plateau_w_m2_sr",
        "plateau, polar winter to summer of high latitudes",
        3.5,
        7.0,
        _DEFINITION,
        "Monthly means of subarctic climates end before the cold of the Antarctic winter.",
    ),
    PublishedStability(
        "half_std_km",
        "standard deviation of the height of normalised edges",
        1.0,
        2.0,
        _DEFINITION,
        "Over the orbit and the year. The smooth year of mean climates reaches the lower end.",
    ),
    PublishedStability(
        "threshold_std_km",
        "standard deviation of the height of a fixed radiance",
        3.0,
        6.0,
        _DEFINITION,
        "As above; weather would add to it.",
    ),
)
