"""The page of what was learned: every number of it is one of the digest's."""

from __future__ import annotations

from typing import Any

from horizonval_learned.score import ALONE, BESIDE, FLOOR, OURS

HEAD = """# A learned estimator beside the others

`learned-limb` is a plug-in of its own, [`examples/learned`](../../examples/learned/README.md): geometry does what is
known, a small network says where the horizon lies in a profile across the limb. It learned from frames of
[`horizonval dataset learning`](../../docs/howto/dataset.md). This page, its numbers (`learned.json`) and its picture:

```sh
pip install . ./examples/peers "./examples/learned[train]"
horizonval dataset learning --frames 10000 --out frames --format hdf5 --workers 2
python -m horizonval_learned train frames
python -m horizonval_learned score frames results/learned
```

| what | |
|---|---|
| frames | {frames}: {train} to learn from, {validation} to stop by and {test} to be tested by, split by scene |
| digest of the frames | `{sha256}` |
| learned from | {profiles} profiles; seed {seed}; kept as of epoch {epoch} |
| training | {seconds} s on two cores shared with other work, reading the frames included |
| weights | {kilobytes:.0f} kB, numpy alone |
| time of an image | {ms:g} ms of processor time, median; `otsu-circle` {floor_ms:g} ms |
| versions | {versions}; torch {torch} for the training |

![Errors and claims](errors.png)
"""

TEST = """## Frames for test

{test} frames of {scenes} scenes that were neither learned from nor stopped by. `learned-limb` knows the place as in the
benchmark: position to 1 km, attitude to 2 deg, of which it uses the direction to the north. *Image alone* is the same
estimator without any of it: the Earth's flattening, which no image tells from a tilt, is then in its error and in its
claim. Errors in degrees; *normalised* is the mean normalised error squared over 2, which is 1 of an honest claim.

| method | answered | rms | median | 95 % | largest | normalised | ms |
|---|---|---|---|---|---|---|---|
{all}

Methods of ours that take longer, on every tenth of these frames, with the same priors, and the others on the same:

| method | answered | rms | median | 95 % | largest | normalised | ms |
|---|---|---|---|---|---|---|---|
{sample}

By the kind of air:

| air | scenes | frames | rms | normalised | rms, image alone | normalised, image alone | rms, `{floor}` |
|---|---|---|---|---|---|---|---|
{airs}
"""

SUITES = """## As a plug-in beside the others

Rows of the product's own scorer, from suites that name `learned-limb` among their `estimators`. `learning-again` is
`learning` with another seed: {again} scenes of the same kinds elsewhere. The cells of the benchmark have its public
seed, the first {cell} frames of each; the network was trained for none of them but `ir-leo-clear`, `ir-leo-tropical`,
`ir-leo-subarctic-winter` and `ir-leo-night`, whose frames are of the kind that it knows.

Each cell of the table: answers of those due, *false claims* if any, rms error in degrees (normalised error squared
over 2).

| frames | {methods} |
|---|{lines}|
{rows}

Median error over the bound of what the limb allows, in `learning-again`: {bounds}.
"""

CAVEATS = """## Honest remarks

- **One camera, cloudless standard air.** All frames are of one lens, from 450 to 650 km, of six standard airs without
  clouds. The table above says what becomes of others. A profile unlike those of the training is left out, and with
  fewer than 60 % of the profiles left the answer is a refusal.
- **The noise is small and the same in training and test**, and both are rendered by the same program: nothing here says
  how it does on a real image.
- **Scenes for test are few**: {scenes}. What frames of a scene have in common (the air's height, the flattening of a
  latitude) is drawn that often only, so that *normalised* by the kind of air is coarse.
- What errors of profiles have in common is measured on the frames of training and validation, as four numbers (spread,
  then kilometres at the limb of tilt, shape and height): {placed} with the place known, {free} without.
- **Visible bands are refused**: it has seen none.
"""


def page(digest: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    test, made, models = digest["test"], digest["made"], digest["models"]
    scenes, again = digest["test_scenes"], digest["suites"]["learning-again"]["learning-again"]
    head = HEAD.format(
        frames=digest["dataset"]["frames"],
        test=digest["dataset"]["test"],
        sha256=digest["dataset"]["sha256"],
        kilobytes=digest["bytes"] / 1e3,
        ms=test["all"][OURS]["ms"],
        floor_ms=test["all"][FLOOR]["ms"],
        versions=", ".join(f"{name} {number}" for name, number in digest["versions"].items()),
        **made["frames"],
        **{key: made[key] for key in ("profiles", "seed", "epoch", "seconds", "torch")},
    )
    tables = TEST.format(
        test=digest["dataset"]["test"],
        scenes=scenes,
        floor=FLOOR,
        all="\n".join(_method(*one) for one in test["all"].items()),
        sample="\n".join(_method(*one) for one in test["sample"].items()),
        airs="\n".join(_air(*one) for one in test["airs"].items()),
    )
    cells = [one for suite in digest["suites"].values() for one in suite.items()]
    suites = SUITES.format(
        again=again[OURS]["frames"],
        cell=next(iter(digest["suites"]["bench-infrared"].values()))[OURS]["frames"],
        methods=" | ".join(f"`{method}`" for method in BESIDE),
        lines="|".join("---" for _ in BESIDE),
        rows="\n".join(f"| `{name}` | {' | '.join(_cell(by[method]) for method in BESIDE)} |" for name, by in cells),
        bounds=", ".join(f"`{method}` {_number(again[method]['over_bound'])}" for method in BESIDE),
    )
    remarks = CAVEATS.format(
        scenes=scenes,
        placed=", ".join(_number(x) for x in models["placed"]),
        free=", ".join(_number(x) for x in models["free"][:3]),
    )
    return "\n".join([head, tables, suites, remarks])


def _method(name: str, row: dict[str, Any]) -> str:
    title = "`learned-limb`, image alone" if name == ALONE else f"`{name}`"
    numbers = [_number(row[key]) for key in ("rms_deg", "median_deg", "p95_deg", "largest_deg", "normalised")]
    return f"| {title} | {row['claims']} of {row['frames']} | {' | '.join(numbers)} | {row['ms']:g} |"


def _air(name: str, row: dict[str, Any]) -> str:
    numbers = [_number(row[method][key]) for method in (OURS, ALONE) for key in ("rms_deg", "normalised")]
    floor = _number(row[FLOOR]["rms_deg"])
    return f"| {name} | {row['scenes']} | {row[OURS]['frames']} | {' | '.join(numbers)} | {floor} |"


def _cell(row: dict[str, Any]) -> str:
    text = f"{row['answered']} of {row['due']}"
    if row["false"]:
        text += f", *{row['false']} false*"
    if row["crashed"]:
        text += f", {row['crashed']} crashed"
    if row["claims"]:
        text += f"; {_number(row['rms_deg'])}"
    return text if row["normalised"] is None else f"{text} ({_number(row['normalised'])})"


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if 1e-3 <= abs(value) < 1000 else f"{value:.1e}" if value else "0"
