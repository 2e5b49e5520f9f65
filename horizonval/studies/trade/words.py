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


def comparison_lines(found: JsonObject) -> list[str]:
    """Return the paired difference of two designs in words."""
    lines = [
        f"A = {found['a']}",
        f"B = {found['b']}",
        f"{found['n']} frames of both, {found['both']} answered by both",
        f"nadir error, B - A, mean: {_with(found['mean_difference_deg'], ' deg')}",
        f"nadir error, B / A, typical: {_with(found['typical_ratio'])}; root mean square: {_with(found['rms_ratio'])}",
    ]
    if found["correlation"] is not None:
        lines.append(f"correlation of the log errors: {found['correlation']:.2f}")
    for key, words in (("answered", "answered"), ("within", f"within {found['error_deg']:g} deg")):
        odd = found[key]
        p = f", McNemar's p = {odd['p']:.2g}" if odd["p"] is not None else ""
        lines.append(f"{words}: by A alone {odd['only_a']}, by B alone {odd['only_b']}{p}")
    return lines


def _with(found: JsonObject, unit: str = "") -> str:
    if found["value"] is None:
        return "unknown"
    text = f"{found['value']:.3g}{unit}"
    if found["interval"] is None:
        return text
    return f"{text} (95 %: {found['interval'][0]:.3g} to {found['interval'][1]:.3g})"


def _share(found: JsonObject) -> str:
    return f"{found['n']}/{found['of']}"


def _degrees(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f} deg"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
