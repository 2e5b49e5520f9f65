"""Rivals and our own methods on one suite: ``python -m horizonval_peers FOLDER``.

Renders the suite, asks every method that is installed, and writes the page, its numbers and its picture into FOLDER.
The run itself lies in another folder and is taken up again where it was left.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import tomllib
from importlib.util import find_spec
from pathlib import Path

import horizonval as hv
from horizonval_peers.digest import digest_of
from horizonval_peers.page import page
from horizonval_peers.plot import plot

SUITE = Path(__file__).with_name("rivals.toml")
NEEDS = {"basilisk": "Basilisk", "scikit-image": "skimage"}
"""Beginning of an estimator's name, and the package that it needs."""


def main() -> None:
    """Run the suite and write the page."""
    parser = argparse.ArgumentParser(prog="python -m horizonval_peers", description=__doc__)
    parser.add_argument("folder", type=Path, help="where README.md, rivals.json and errors.png are written")
    parser.add_argument("--run", type=Path, default=Path("out-rivals"), help="folder of the run (out-rivals)")
    arguments = parser.parse_args()
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    text, methods, left_out = suite_of_installed()
    with tempfile.TemporaryDirectory() as place:
        suite = Path(place) / "rivals.toml"
        suite.write_text(text, encoding="utf-8")
        run = hv.run(suite, arguments.run)
    digest = digest_of(run, methods, left_out)
    (folder / "rivals.json").write_text(json.dumps(digest, indent=1) + "\n", encoding="utf-8")
    (folder / "README.md").write_text(page(digest), encoding="utf-8")
    plot(digest, folder / "errors.png")


def suite_of_installed() -> tuple[str, list[str], list[str]]:
    """Return the suite without the estimators whose packages are missing, the names it has, and those it has not."""
    text = SUITE.read_text(encoding="utf-8")
    names = tomllib.loads(text)["suite"]["estimators"]
    missing = tuple(start for start, package in NEEDS.items() if find_spec(package) is None)
    left_out = [name for name in names if name.startswith(missing)] if missing else []
    for name in left_out:
        text = text.replace(f'"{name}", ', "").replace(f'"{name}",', "")
    return text, [name for name in names if name not in left_out], left_out


if __name__ == "__main__":
    main()
