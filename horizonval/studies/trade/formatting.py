"""Results of a study as text for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.conclude import BY_WORDS
from horizonval.studies.trade.sample import causes_of

MOST_BY = 24
"""Maximum length of an expression in a heading."""


def design_lines(result: JsonObject, costs: JsonObject) -> list[str]:
    """Return a table of the designs as lines."""
    error_deg = result["limit"]["error_deg"]
    rows: list[tuple[str, ...]] = [
        ("", "design", "frames", "answered", f"within {error_deg:g} deg", "bias", "noise", "p95", "pixels/s", "CPU s")
    ]
    by = result["study"]["cheapest_by"]
    prices = result["prices"] or costs["prices"]
    if by not in BY_WORDS:
        rows = [(*rows[0], by if len(by) <= MOST_BY else "cost")]
    for d in result["designs"]:
        rows.append(
            (
                str(d["number"]),
                d["name"],
                str(d["n"]),
                _share(d["availability"]),
                _share(d["within"]),
                *(_degrees(d[key]["value"]) for key in ("bias_deg", "noise_deg", "p95_deg")),
                f"{d['pixel_rate']:.4g}",
                _number(costs["designs"][d["name"]]["value"]),
                *([_number(prices[d["name"]]["value"])] if by not in BY_WORDS else []),
            )
        )
    return _aligned(rows)


def miss_lines(misses: Mapping[str, JsonObject]) -> list[str]:
    """Return a table of the causes of misses as lines; ``misses`` by design."""
    causes = causes_of(misses.values())
    rows: list[tuple[str, ...]] = [("missed by", *causes)]
    for name, causes_of_design in misses.items():
        rows.append((name, *(_missed(causes_of_design.get(cause)) for cause in causes)))
    return _aligned(rows)


def information_lines(result: JsonObject) -> list[str]:
    """Return a table of the designs' bounds as lines."""
    limit = result["limit"]["error_deg"]
    rows: list[tuple[str, ...]] = [
        ("design", "frames", "due", "by noise [deg]", "bound [deg]", f"within {limit:g} deg", "trial")
    ]
    for d in result["designs"]:
        trial = [f"{name} {_number(one['rms_deg'])} rms, {_percent(one['within'])}" for name, one in d["trial"].items()]
        medians = [d[key]["median"] for key in ("noise_arcsec", "bound_arcsec")]
        degrees = [_number(None if value is None else value / 3600.0) for value in medians]
        rows.append((d["name"], str(d["n"]), str(d["due"]), *degrees, _percent(d["within"]), ", ".join(trial)))
    return _aligned(rows)


def _missed(found: JsonObject | None) -> str:
    if found is None:
        return "-"
    return f"{found['n']} ({found['due']} due)" if found["due"] else str(found["n"])


def comparison_lines(comparison: JsonObject) -> list[str]:
    """Return the paired difference of two designs in words."""
    lines = [
        f"A = {comparison['a']}",
        f"B = {comparison['b']}",
        f"{comparison['n']} frames of both, {comparison['both']} answered by both",
        f"nadir error, B - A, mean: {_with(comparison['mean_difference_deg'], ' deg')}",
        f"nadir error, B / A, typical: {_with(comparison['typical_ratio'])}; "
        f"root mean square: {_with(comparison['rms_ratio'])}",
    ]
    if comparison["correlation"] is not None:
        lines.append(f"correlation of the log errors: {comparison['correlation']:.2f}")
    for key, words in (("answered", "answered"), ("within", f"within {comparison['error_deg']:g} deg")):
        odd = comparison[key]
        p = f", McNemar's p = {odd['p']:.2g}" if odd["p"] is not None else ""
        lines.append(f"{words}: by A alone {odd['only_a']}, by B alone {odd['only_b']}{p}")
    return lines


def _with(measure: JsonObject, unit: str = "") -> str:
    if measure["value"] is None:
        return "unknown"
    text = f"{measure['value']:.3g}{unit}"
    if measure["interval"] is None:
        return text
    return f"{text} (95 %: {measure['interval'][0]:.3g} to {measure['interval'][1]:.3g})"


def _share(share: JsonObject) -> str:
    return f"{share['n']}/{share['of']}"


def _degrees(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f} deg"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f} %"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
