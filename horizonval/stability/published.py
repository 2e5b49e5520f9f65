"""What others have found, to stand beside the study's figures: value, source, and why ours may differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quantity = Literal["edge_pitch_deg", "edge_roll_deg", "field_deg", "requirement_deg", "variation"]

_SYSTEMATIC = "Systematic horizon-sensor errors from the variation of infrared radiance, polar orbit at 900 km, 1980"


@dataclass(frozen=True)
class Published:
    """One published figure.

    Attributes
    ----------
    quantity : str
        Which of the study's figures stands beside it.
    text, source : str
    low, high : float
        Equal for a single figure; degrees, or a share.
    why : str
        Why ours differs, or may.
    """

    quantity: Quantity
    text: str
    low: float
    high: float
    source: str
    why: str


PUBLISHED = (
    Published(
        "edge_pitch_deg",
        "largest pitch error of an edge scanner",
        0.06,
        0.06,
        _SYSTEMATIC,
        "Ours sees the seasons of six mean climates only. Weather, stratospheric warmings, the cold of the Antarctic "
        "winter and the width of a real sensor's field add to it.",
    ),
    Published(
        "edge_roll_deg",
        "largest roll error of an edge scanner",
        0.03,
        0.03,
        _SYSTEMATIC,
        "Air that is the same at every longitude looks alike to the right and to the left of a polar orbit; what is "
        "left comes from the inclination. Real air varies with longitude.",
    ),
    Published(
        "field_deg",
        "largest error of a field sensor of 2 deg",
        0.12,
        0.12,
        _SYSTEMATIC,
        "Half the field times half the relative difference of radiance between the heads: all of it is the contrast "
        "of winter and summer, which mean climates hold nearly in full.",
    ),
    Published(
        "requirement_deg",
        "required of horizon sensors",
        0.03,
        0.1,
        "The same study",
        "",
    ),
    Published(
        "variation",
        "variation of radiance with longitude, 14 to 16 um, from orbit (IRS-1B)",
        0.30,
        0.30,
        "Seshamani, Alex and Jain, Optical Engineering 33 (11), 1994",
        "Ours has none with longitude: the range given is that over latitude and season, of monthly means.",
    ),
)
