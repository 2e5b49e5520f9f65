"""The ``[stability]`` table: what it fills in, and what it refuses in one line."""

from __future__ import annotations

import pytest

from horizonval.core.errors import UserError
from horizonval.spec.load import Suite, load_suite

HEAD = """
[suite]
name = "s"
estimators = ["ideal"]
[[frame]]
scene.name = "a"
camera.file = "ir-bolometer-160-57deg"
platform.altitude_km = 500.0
"""
BAND = '[[stability.band]]\nname = "co2"\nlo_um = 14.0\nhi_um = 16.3\n'
TABLE = "[stability]\naltitude_km = 900.0\n"


@pytest.fixture
def load(tmp_path):
    def build(*parts: str) -> Suite:
        path = tmp_path / "s.toml"
        path.write_text(HEAD + "".join(parts))
        return load_suite(path)

    return build


def test_a_suite_need_not_have_one(load):
    assert load().stability is None


def test_defaults(load):
    spec = load(TABLE, BAND).stability
    assert spec is not None
    assert (spec.inclination_deg, spec.positions, spec.months) == (90.0, 72, list(range(1, 13)))


def test_the_shipped_suite():
    spec = load_suite("infrared-horizon-stability").stability
    assert spec is not None
    assert [(b.lo_um, b.hi_um) for b in spec.band] == [(14.0, 16.3), (14.16, 16.25), (8.0, 14.0), (10.5, 12.5)]
    assert (spec.altitude_km, len(spec.months)) == (900.0, 12)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((TABLE,), ("stability.band", "missing")),
        (("[stability]\n", BAND), ("stability.altitude_km", "missing")),
        (("[stability]\naltitude_km = 100.0\n", BAND), ("altitude_km", "100", "200")),
        ((TABLE, "positions = 3\n", BAND), ("positions", "3", "from 4 to 720")),
        ((TABLE, "months = []\n", BAND), ("months", "at least 1 long")),
        ((TABLE, "months = [0]\n", BAND), ("months[1]", "from 1 to 12")),
        ((TABLE, "months = [1, 1]\n", BAND), ("months holds a month twice",)),
        ((TABLE, "inclinaton_deg = 90.0\n", BAND), ("inclinaton_deg", "unknown key", "inclination_deg")),
        ((TABLE, BAND, BAND), ("two bands are named 'co2'",)),
        ((TABLE, BAND.replace("16.3", "13.0")), ("lo_um must be below hi_um",)),
        ((TABLE, "field_deg = 20.0\n", BAND), ("field_deg", "20", "5")),
    ],
)
def test_mistakes(load, parts, words):
    with pytest.raises(UserError) as error:
        load(*parts)
    line = error.value.line()
    assert "\n" not in line
    for word in ("s.toml", *words):
        assert word in line, line
