"""Score of the tests: break the source in small ways, one at a time, and count how often a test notices.

``python tests/mutation/run.py --sample 200 --seed 1 --out mutation`` copies the tracked files into ``mutation/tree``,
records there which test executes which line (minutes), draws mutants at random, and runs the tests of its line for
each, shortest first, until one fails. ``mutation/mutants.json`` says what became of each mutant, and
``mutation/README.md`` how many of each room were killed. With the same ``--out`` again the recording and what was found
are kept.

cosmic-ray makes the mutants; what is here chooses them and their tests.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator

sys.path.insert(0, str(Path(__file__).parent))
import forked
from mutants import ROOMS, Mutant, Place, all_places, mutant_at
from recording import Recording, record

ROOT = Path(__file__).parents[2]
TESTS = [
    f"tests/unit/{room}"
    for room in ("scoring", "estimation", "plugins", "store", "jobs", "suites", "studies/regression")
]
TESTS.append("tests/unit/test_values.py")
LONGEST_S = 5.0
"""Recorded time of the tests that a mutant gets; what only others would find counts as survived."""
CONFIRMED_FROM_S = 1.0
"""A test that takes so long may fail because the machine is busy: it must fail twice to count."""
SURVIVED, KILLED, TIMEOUT, EQUIVALENT = "survived", "killed", "timeout", "equivalent"
Record = dict[str, Any]


def main() -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=200, help="number of mutants (0: all)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument("--out", type=Path, default=Path("mutation"))
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--record", nargs="+", metavar="TEST", help="take over these new tests, and record them too")
    parser.add_argument("--again", action="store_true", help="test those that survived once more")
    options = parser.parse_args()
    out = options.out.resolve()
    tree, data = out / "tree", out / "recording.sqlite"
    os.nice(10)
    # A mutant is taken back however this ends.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    if not tree.exists():
        _copy(tree)
    places = all_places(tree, options.rooms)
    if options.record or not data.exists():
        if options.record:
            _copy_tests(tree)
        record(tree, options.record or TESTS, data, sorted({tree / place.file for place in places}))
    recording = Recording(data, tree)
    forked.prepare(tree)
    drawn = _drawn(places, options.sample, options.seed)
    kept = out / "mutants.json"
    records: dict[str, Record] = {r["mutant"]: r for r in json.loads(kept.read_text())} if kept.exists() else {}
    equivalent = _equivalent()
    for k, mutant in enumerate(drawn):
        before = records.get(mutant.title)
        if before is None or (options.again and before["outcome"] == SURVIVED):
            records[mutant.title] = _tested(mutant, recording, tree)
            kept.write_text(json.dumps(list(records.values()), indent=1))
        shown = records[mutant.title]
        if (reason := equivalent.get((mutant.file, mutant.before, mutant.after))) and shown["outcome"] == SURVIVED:
            shown |= {"outcome": EQUIVALENT, "reason": reason}
        print(f"{k + 1:4} {shown['outcome']:10} {shown['seconds']:5.1f} s  {mutant.title}", flush=True)
    (out / "README.md").write_text(_page(drawn, records, len(places), options.seed))
    kept.write_text(json.dumps(list(records.values()), indent=1))
    print((out / "README.md").read_text())


def _drawn(places: list[Place], count: int, seed: int) -> list[Mutant]:
    drawn: list[Mutant] = []
    for place in random.Random(seed).sample(places, len(places)):
        if (mutant := mutant_at(place)) is not None:
            drawn.append(mutant)
        if len(drawn) == count:
            break
    return drawn


def _copy(tree: Path) -> None:
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)


def _copy_tests(tree: Path) -> None:
    shutil.copytree(ROOT / "tests", tree / "tests", dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))


def _tested(mutant: Mutant, recording: Recording, tree: Path) -> Record:
    start = time.monotonic()
    tests = recording.tests(mutant.file, mutant.line, LONGEST_S)
    outcome, killer = _outcome(mutant, tests, recording, tree) if tests else (SURVIVED, None)
    if killer is not None and recording.seconds.get(killer, 0.0) > CONFIRMED_FROM_S:
        outcome, killer = _outcome(mutant, [killer], recording, tree)
    return {
        "mutant": mutant.title,
        "room": mutant.room,
        "operator": mutant.operator,
        "outcome": outcome,
        "tests": len(tests),
        "by": killer,
        "seconds": round(time.monotonic() - start, 1),
    }


def _outcome(mutant: Mutant, tests: list[str], recording: Recording, tree: Path) -> tuple[str, str | None]:
    chosen, output = tree.parent / "tests.txt", tree.parent / "output.txt"
    chosen.write_text("\n".join(_by_file(tests)) + "\n")
    limit_s = 60.0 + 4.0 * sum(recording.seconds.get(test, 0.0) for test in tests)
    operator = get_operator(mutant.spec.operator_name)()
    with use_mutation(mutant.spec.module_path, operator, mutant.spec.occurrence):
        status = forked.run(
            ["-q", "-x", "-p", "no:cacheprovider", "--no-header", "--tb=line", f"@{chosen}"], output, limit_s
        )
    if status == 0:
        return SURVIVED, None
    if status is None:
        return TIMEOUT, None
    failed = re.search(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - .*)?$", output.read_text(errors="replace"), re.MULTILINE)
    return KILLED, None if failed is None else failed[1]


def _by_file(tests: list[str]) -> list[str]:
    """Keep the tests of a file together, for the sake of what they share; the files with the shortest test first."""
    files: dict[str, list[str]] = {}
    for test in tests:
        files.setdefault(test.partition("::")[0], []).append(test)
    return [test for group in files.values() for test in group]


def _equivalent() -> dict[tuple[str, str, str], str]:
    """Return the mutants that change nothing one could observe, each with its reason."""
    with (Path(__file__).parent / "equivalent.toml").open("rb") as file:
        entries = tomllib.load(file).get("mutant", [])
    return {(e["file"], e["before"], e["after"]): e["reason"] for e in entries}


def _page(drawn: list[Mutant], records: dict[str, Record], population: int, seed: int) -> str:
    lines = [
        f"{len(drawn)} of {population} mutants, drawn with seed {seed}.",
        "",
        "| room | mutants | killed | of these by time | survived | equivalent | score |",
        "|---|---|---|---|---|---|---|",
    ]
    found = [records[mutant.title] for mutant in drawn]
    for room in (*ROOMS, "all"):
        outcomes = [r["outcome"] for r in found if room in (r["room"], "all")]
        counts = {name: outcomes.count(name) for name in (SURVIVED, KILLED, TIMEOUT, EQUIVALENT)}
        killed, real = counts[KILLED] + counts[TIMEOUT], len(outcomes) - counts[EQUIVALENT]
        if outcomes:
            lines.append(
                f"| {room} | {len(outcomes)} | {killed} | {counts[TIMEOUT]} | {counts[SURVIVED]} "
                f"| {counts[EQUIVALENT]} | {100 * killed / max(real, 1):.0f} % |"
            )
    lines += ["", f"Time: {sum(r['seconds'] for r in found) / 60:.0f} min, without the recording."]
    for outcome, title in ((SURVIVED, "Survived"), (EQUIVALENT, "Equivalent")):
        lines += ["", f"## {title}", ""]
        lines += [
            f"- `{r['mutant']}`" + (f": {r['reason']}" if "reason" in r else "")
            for r in found
            if r["outcome"] == outcome
        ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
