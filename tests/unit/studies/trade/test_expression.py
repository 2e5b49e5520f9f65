"""The user's expression of a cost: what it may hold, what it gives, and its uncertainty."""

from __future__ import annotations

import pytest

from horizonval.core.errors import UserError
from horizonval.studies.trade.cost import is_tie, price_of, read_expression


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mass_g", 120.0),
        ("mass_g + 20 * power_w - 1", 129.0),
        ("-mass_g ** 2 / 2", -7200.0),
        ("max(mass_g, power_w, 500) + min(1, 2)", 501.0),
        ("sqrt(abs(-4)) * (mass_g)", 240.0),
        (" 1e3 ", 1000.0),
        ("mass_g / (power_w - 0.5)", None),
        ("9 ** 9 ** 9", None),
        ("sqrt(-mass_g)", None),
        ("(-mass_g) ** 0.5", None),
    ],
)
def test_arithmetic(text, value):
    found = read_expression(text, {"mass_g": None, "power_w": None}, "x").value({"mass_g": 120.0, "power_w": 0.5})
    assert found == (None if value is None else pytest.approx(value))


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "mass_g.real", "mass_g[0]", "[1, 2]", "lambda: 1", "mass_g if 1 else 2",
        "mass_g < 2", "'mass_g'", "True", "print(1)", "min()", "sqrt(1, 2)", "max(key=1)", "min(*mass_g)", "mass_g +",
        "a := 1", "1e999", "1" * 400, "(" * 250 + "1" + ")" * 250, "x" * 501, "", "mass_g; 1", "\0",
    ],
)  # fmt: skip
def test_what_is_no_arithmetic_is_refused_in_one_line(text):
    with pytest.raises(UserError) as e:
        read_expression(text, {"mass_g": None}, "s.toml: study.cheapest_by")
    line = e.value.line()
    assert "s.toml: study.cheapest_by" in line
    assert "\n" not in line


def column(value, half=None):
    interval = None if half is None else [value - half, value + half]
    return {"value": value, "interval": interval, "uncertain": half is not None}


def test_uncertainties_are_carried_through_and_added_in_squares():
    price = read_expression("2 * a + b + c", dict.fromkeys("abc"), "x")
    found = price_of(price, {"a": column(10.0, 1.5), "b": column(5.0, 4.0), "c": column(100.0)})
    assert found == {"value": 125.0, "interval": [pytest.approx(120.0), pytest.approx(130.0)], "known": True}
    exact = price_of(price, {name: column(1.0) for name in "abc"})
    assert exact == {"value": 4.0, "interval": None, "known": True}
    few = {"value": 1.0, "interval": None, "uncertain": True}
    assert price_of(price, {"a": few, "b": column(1.0), "c": column(1.0)})["known"] is False
    assert price_of(price, {"a": few | {"value": None}, "b": few, "c": few})["value"] is None


def test_ties():
    def price(value, half=None):
        return {"value": value, "interval": None if half is None else [value - half, value + half], "known": True}

    assert is_tie(price(0.1 + 0.2), price(0.3))
    assert not is_tie(price(1.0), price(1.001))
    # Only the halves that face each other count: 0.3 and 0.4 make 0.5.
    assert is_tie(price(1.0, 0.3), price(1.49, 0.4))
    assert is_tie(price(1.49, 0.4), price(1.0, 0.3))
    assert not is_tie(price(1.0, 0.3), price(1.51, 0.4))
    assert is_tie(price(None), price(None))
    assert not is_tie(price(None), price(1.0))
