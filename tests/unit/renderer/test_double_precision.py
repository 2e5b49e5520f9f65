"""What kernels compute in double precision is right to rounding, with whichever back-end renders here.

A GPU has instructions of its own for some functions that are right to 1e-6 only, whatever the type: of the
Earth's radius that is six metres.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import special

import horizonval
from horizonval.renderer.backend import activate

ANY = np.random.default_rng(1).uniform(-30.0, 30.0, 4001)
POSITIVE = np.exp(ANY)
SHARE = np.tanh(0.2 * ANY)


@pytest.mark.parametrize(
    ("name", "at", "exact"),
    [
        ("sqrt", POSITIVE, np.sqrt),
        ("sin", ANY, np.sin),
        ("cos", ANY, np.cos),
        ("exp", ANY, np.exp),
        ("log", POSITIVE, np.log),
        ("asin", SHARE, np.arcsin),
        ("acos", SHARE, np.arccos),
        ("atan", ANY, np.arctan),
        ("erf", ANY, special.erf),
    ],
)
def test_functions_are_right_to_rounding(name: str, at: np.ndarray, exact: Callable[[Any], np.ndarray]) -> None:
    """1e-14 of the value, and 4e-15 beside it where a function crosses zero: 1e-9 arcsec of an angle."""
    activate()
    import drjit as dr
    import mitsuba as mi

    found = np.array(getattr(dr, name)(mi.Float64(at)))
    np.testing.assert_allclose(found, exact(at), rtol=1e-14, atol=4e-15)


def test_the_inverse_root_is_that_of_numpy_bit_by_bit() -> None:
    activate()
    import mitsuba as mi

    from horizonval.renderer.types import inverse_root

    assert np.array_equal(np.array(inverse_root(mi.Float64(POSITIVE))), 1.0 / np.sqrt(POSITIVE))


def test_nothing_takes_what_is_coarse_on_a_gpu() -> None:
    """Right to 1e-6 there in double precision, as measured; ``dr.normalize`` divides by such a root."""
    coarse = re.compile(r"\bdr\.(rsqrt|rcp|tan|sinh|cosh|tanh|normalize)\((?!.*mi\.Vector3f)")
    sources = sorted(Path(horizonval.__file__).parent.rglob("*.py"))
    assert len(sources) > 300
    assert [str(p) for p in sources if coarse.search(p.read_text(encoding="utf-8"))] == []
