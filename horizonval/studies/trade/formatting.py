"""What a study tells on the terminal."""

from __future__ import annotations

from horizonval.core.json_types import JsonObject


def design_lines(result: JsonObject, costs: JsonObject) -> list[str]:
    """Return a table of the designs, a line each."""
    error_deg = result["study"]["requirement"]["error_deg"]
    rows = [
        ("", "design", "frames", "answered", f"within {error_deg:g} deg", "bias", "noise", "p95", "pixels/s", "CPU s")
    ]
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
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


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
