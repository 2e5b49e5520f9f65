"""What packages say of themselves agrees: the wheel's metadata, the recipe for conda, the citation."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest
import yaml

import horizonval

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RECIPE = yaml.safe_load((ROOT / ".ci/conda/recipe.yaml").read_text())

CONDA_NAMES = {
    "opencv-python-headless": "py-opencv",
    "openexr": "openexr-python",
    "duckdb": "python-duckdb",
    "matplotlib": "matplotlib-base",
}
COMES_WITH_DRJIT = {"karellen-llvm-core"}
"""An LLVM library as a wheel; conda-forge's Dr.Jit brings its own."""


def test_the_recipe_asks_for_what_the_wheel_asks_for() -> None:
    wanted = {}
    for requirement in PROJECT["dependencies"]:
        found = re.fullmatch(r"([\w-]+)>=([\w.]+)(?:;.*)?", requirement)
        assert found is not None, requirement
        name = found[1].lower()
        if name not in COMES_WITH_DRJIT:
            wanted[CONDA_NAMES.get(name, name)] = f">={found[2]}"
    asked = dict(line.split(" ", 1) for line in RECIPE["requirements"]["run"])
    assert asked.pop("python") == ">=${{ python_min }}"
    assert asked == wanted
    assert PROJECT["requires-python"] == f">={RECIPE['context']['python_min']}"


def test_every_place_has_the_version() -> None:
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None
    versions = {PROJECT["version"], RECIPE["context"]["version"], horizonval.__version__, cited[1]}
    assert versions == {importlib.metadata.version("horizonval")}


def test_the_pythons_stated_are_those_of_the_workflows() -> None:
    prefix = "Programming Language :: Python :: 3."
    stated = {line.removeprefix(prefix) for line in PROJECT["classifiers"] if line.startswith(prefix)}
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    tried = workflow["jobs"]["wheel"]["strategy"]["matrix"]["python"]
    assert {version.removeprefix("3.") for version in tried} == stated
    assert f"3.{min(map(int, stated))}" == PROJECT["requires-python"].removeprefix(">=")


def test_licences_travel_along() -> None:
    assert PROJECT["license-files"] == RECIPE["about"]["license_file"]
    for name in PROJECT["license-files"]:
        assert (ROOT / name).is_file()


@pytest.mark.parametrize("workflow", sorted((ROOT / ".github/workflows").glob("*.yml")), ids=lambda path: path.name)
def test_workflows_call_files_that_exist(workflow: Path) -> None:
    jobs = yaml.safe_load(workflow.read_text())["jobs"]
    commands = "\n".join(step.get("run", "") for job in jobs.values() for step in job["steps"])
    called = re.findall(r"(?:^|\s)(\.ci/[\w./-]+)", commands)
    assert called or workflow.name == "publish.yml"
    for path in called:
        assert (ROOT / path).is_file(), path
