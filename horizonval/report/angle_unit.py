"""The unit of the errors on a page."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from horizonval.report.formatting import number


@dataclass(frozen=True)
class AngleUnit:
    """The unit of all errors on a page, so that no two of them are compared across units.

    ``sign`` follows a number in a sentence, ``name`` stands in brackets; ``arcsec`` is how many arc seconds it has.
    """

    name: str
    sign: str
    arcsec: float

    def of(self, arcsec: float) -> float:
        """Return an angle in this unit."""
        return arcsec / self.arcsec

    def number(self, arcsec: float | None) -> str:
        """Return an angle with three significant digits a dash for ``None``."""
        return number(None if arcsec is None else self.of(arcsec))

    def text(self, arcsec: float | None) -> str:
        """Return an angle with its unit."""
        return number(None) if arcsec is None else f"{self.number(arcsec)}{self.sign}"


DEG = AngleUnit("deg", "\N{DEGREE SIGN}", 3600.0)
ARCSEC = AngleUnit("arcsec", " arcsec", 1.0)


def unit_of(errors_arcsec: Iterable[float | None]) -> AngleUnit:
    """Return degrees, as sensors are specified; arc seconds where every error is below a hundredth of a degree."""
    largest = max((error for error in errors_arcsec if error is not None), default=math.inf)
    return ARCSEC if largest < 0.01 * DEG.arcsec else DEG
