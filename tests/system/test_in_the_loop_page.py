"""The page of the loops says what their files say."""

from __future__ import annotations

import json
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "results" / "in-the-loop"
NAMES = {"visible fisheye": "visible", "two infrared cameras": "infrared", "truth": "truth"}


def test_the_table_is_that_of_the_files():
    rows = {}
    for line in (FOLDER / "README.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] in NAMES and len(cells) == 8:
            rows[NAMES[cells[0]], cells[1]] = cells[2:]
    expected = {}
    for name in NAMES.values():
        found = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
        for light, one in found["summary"].items():
            pairs = [
                "" if one[f"{of}_rms_deg"] is None else f"{one[f'{of}_rms_deg']:.3f} ({one[f'{of}_max_deg']:.3f})"
                for of in ("sensor", "knowledge", "pointing")
            ]
            sensor = "" if name == "truth" else pairs[0]
            images = f"{one['answered']} of {one['images']}"
            expected[name, light] = [f"{one['seconds'] / 60:.0f}", images, str(one["taken"]), sensor, *pairs[1:]]
    assert rows == expected
    assert {light for _, light in rows} == {"sunlight", "Sun in frame", "eclipse"}
