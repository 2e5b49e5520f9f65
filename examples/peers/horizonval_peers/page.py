"""The page of the rivals: every number of it is one of the digest's."""

from __future__ import annotations

import contextlib
import textwrap
from pathlib import Path
from typing import Any

from horizonval_peers.plot import TITLES

ABOUT = {
    "altitude-free": "ours: points and a cone; no altitude",
    "guarded-altitude-free": "ours: the same behind a guard",
    "limb-sphere": "ours: likelihood of the pixels, a sphere; altitude to 1 km",
    "limb-ellipsoid": "ours: likelihood of the pixels, the Earth's ellipsoid; position to 1 km",
    "basilisk": "Basilisk as it is sold; attitude to 2 deg for its oblate Earth",
    "basilisk-half-pixel": "half a pixel added between its two modules",
    "basilisk-mended": "its horizontal scale put right, too",
    "canny-christian-robinson": "Christian and Robinson on Canny's pixels, numpy, 20 lines; no altitude",
    "canny-known-altitude": "the same pixels, altitude to 1 km",
    "otsu-circle": "OpenCV's floor: Otsu's threshold, robust circle of directions",
    "triangle-circle": "the same with OpenCV's triangle threshold",
    "scikit-image-ellipse": "scikit-image: contour, robust ellipse",
}

FAULTS = Path(__file__).with_name("faults.md")
"""What stands below the results and needs none of their numbers."""

SEEN = Path(__file__).with_name("seen.md")
"""Sentences that were written after the run was seen, with places for the digest's numbers."""

HEAD = """# Rivals on the same frames

Other people's horizon navigation, two textbook fits and what OpenCV and scikit-image give in an afternoon, beside four
of our methods, on the same {frames} frames. One command makes this page, its numbers (`rivals.json`) and its picture:

```sh
pip install . "./examples/peers[basilisk,scikit-image]"
python -m horizonval_peers results/rivals
```

The rivals are a package of their own, [`examples/peers`](../../examples/peers/README.md), that shares no code with the
product but the form of questions and answers. Its [suite](../../examples/peers/horizonval_peers/rivals.toml) has the
frames. All of them are rendered by horizonval, and ours were developed on such frames: this is our home ground.

Versions: {versions}.

![Every claim of every method](errors.png)

Nadir errors of all claims; the dashed line is 0.5 deg, beyond which a claim is false whatever it claims of itself.

## Who they are

| method | what it is, and what it knows beside image and camera |
|---|---|
{about}

All rivals get the same picture of 8 bits with an automatic gain of up to four, as Basilisk reads no more. What a row is
off by is the method's: exact points and discs come out right through every wrapper (`tests/system/test_peers.py`).
"""

RESULTS = """## Results

- *Answered*: of the frames that must be answered.
- *False*: more than 0.5 deg off, or beyond 0.1 deg and five claimed sigma; a claim without sigma is judged as sure to
  72 arcsec. Of `limb-sphere` and `limb-ellipsoid` more is asked: 0.25 deg, and five sigma from 0 on.
- *Bias*: length of the mean error in roll and pitch.
- *NEES*: mean of the error squared over what is claimed, 2 is honest; in brackets where an honest mean lies 95 % of the
  time. Below it a method claims too little of itself, above it too much.
- *ms*: processor time of an image, median, on a busy machine: ratios are worth something, digits are not.

Errors are in degrees. From 35 786 km the visible limb has the Sun at 81 deg and more, so that those frames are
borderline: claims count, refusals do not. Altitudes are mixed in a row; the picture has them apart.
"""

NOTHING = """### Frames without an answer

Empty sky, the Earth all over the image with clouds, night, a terminator along the limb, and a corner of the limb,
visible and infrared. None is due an answer.

| method | claims, of frames | of them false | largest error |
|---|---|---|---|"""

HARD, AIR, CLOUDS, HARD_INFRARED, AIR_INFRARED = TITLES


def page(digest: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    frames = sum(next(iter(table.values()))["frames"] for table in digest["groups"].values())
    about = "\n".join(f"| `{method}` | {ABOUT[method]} |" for method in digest["methods"])
    versions = ", ".join(f"{name} {number}" for name, number in digest["versions"].items())
    parts = [HEAD.format(frames=frames, versions=versions, about=about)]
    if digest["left_out"]:
        parts.append(f"**Left out, their packages not being installed:** {', '.join(digest['left_out'])}.\n")
    parts.append(RESULTS)
    for table, title in TITLES.items():
        parts.append(f"### {title[0].upper()}{title[1:]}\n\n{_table(digest['groups'][table], digest['methods'])}\n")
    parts.append(_nothing(digest))
    parts += [_seen(digest), FAULTS.read_text(encoding="utf-8")]
    return "\n".join(parts)


def _table(group: dict[str, Any], methods: list[str]) -> str:
    lines = [
        "| method | answered | false, of claims | median | 95 % | rms | bias [deg] | NEES | ms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for method in methods:
        row = group[method]
        nees = "no sigma" if row["without_sigma"] else "-"
        if row["nees"] is not None:
            low, high = row["nees_interval"]
            nees = f"{_number(row['nees'])} ({low:.1f} to {high:.1f})"
        cells = [
            f"`{method}`",
            f"{row['answered']} of {row['due']}" + (f", {row['crashed']} crashed" if row["crashed"] else ""),
            f"{row['false']} of {row['claims']}",
            *(_number(row[key]) for key in ("median_deg", "p95_deg", "rms_deg", "bias_deg")),
            nees,
            "-" if row["processor_ms"] is None else f"{row['processor_ms']:g}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _nothing(digest: dict[str, Any]) -> str:
    lines = [NOTHING]
    for method in digest["methods"]:
        row = digest["groups"]["nothing"][method]
        errors = [error for place in row["errors_deg"].values() for error in place]
        largest = _number(max(errors)) if errors else "-"
        lines.append(f"| `{method}` | {row['claims']} of {row['frames']} | {row['false']} | {largest} |")
    return "\n".join(lines) + "\n"


def _seen(digest: dict[str, Any]) -> str:
    def of(key: str, table: str) -> dict[str, str]:
        return {name.replace("-", "_"): _number(row[key]) for name, row in digest["groups"][table].items()}

    def count(table: str, method: str, of_claims: bool) -> str:
        row = digest["groups"][table][method]
        return f"{row['false']} of {row['claims']}" if of_claims else f"{row['answered']} of {row['due']}"

    numbers: dict[str, Any] = {
        "hard": of("median_deg", HARD),
        "air": of("median_deg", AIR),
        "clouds": of("median_deg", CLOUDS),
        "most_hard_ir": of("p95_deg", HARD_INFRARED),
        "air_ir": of("median_deg", AIR_INFRARED),
        "nees": of("nees", AIR),
        "nees_hard": of("nees", HARD),
        "nees_hard_ir": of("nees", HARD_INFRARED),
        "cloud_false": count(CLOUDS, "altitude-free", of_claims=True),
        "cloud_guard": count(CLOUDS, "guarded-altitude-free", of_claims=False),
        "disc_guard": count(AIR_INFRARED, "guarded-altitude-free", of_claims=False),
    }
    lines = []
    for point in SEEN.read_text(encoding="utf-8").split("\n\n"):
        # What names a method that was not run is left out.
        with contextlib.suppress(KeyError):
            lines.append(_wrapped(" ".join(point.split()).format(**numbers)))
    return "\n".join(["## What is seen", "", *lines]) + "\n"


def _wrapped(point: str) -> str:
    return textwrap.fill(point, 120, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
