"""The JSON Schema of the files: shipped files keep it, mistakes do not, and the kept copies are the printed ones."""

from __future__ import annotations

import tomllib
from datetime import datetime
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from horizonval.cli.app import run_command_line
from horizonval.spec.files import shipped_names, shipped_path, shipped_root
from horizonval.spec.schema import MODELS, json_schema

FILES = [(kind, name) for kind in MODELS if kind != "prior" for name in shipped_names(kind)]
"""No prior is shipped: what is known is known of one picture."""
SCENE = {"camera": {"file": "vis-cmos-512-60deg"}, "platform": {"altitude_km": 500.0}}
CASES = {"suite": {"name": "s", "estimators": ["ideal"]}}


def _plain(value: Any) -> Any:
    """As JSON has it: dates are text."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list) else value


def _validator(kind) -> Draft202012Validator:
    return Draft202012Validator(json_schema(kind))


def _grid(**grid: Any) -> dict[str, Any]:
    return CASES | {"cases": [{"name": "t", "grid": grid}]}


@pytest.mark.parametrize("kind", MODELS)
def test_it_is_a_schema(kind):
    Draft202012Validator.check_schema(json_schema(kind))


@pytest.mark.parametrize(("kind", "name"), FILES)
def test_every_shipped_file_keeps_it_and_names_it(kind, name):
    path = shipped_path(kind, name)
    text = path.read_text(encoding="utf-8")
    errors = list(_validator(kind).iter_errors(_plain(tomllib.loads(text))))
    assert errors == []
    first = text.splitlines()[0]
    assert first.startswith("#:schema ")
    assert (path.parent / first.removeprefix("#:schema ")).resolve() == shipped_root() / "schema" / f"{kind}.json"


@pytest.mark.parametrize("kind", MODELS)
def test_the_kept_copy_is_what_is_printed(kind, capsys):
    assert run_command_line(["schema", kind]) == 0
    assert (shipped_root() / "schema" / f"{kind}.json").read_text(encoding="utf-8") == capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("scene", SCENE | {"platform": {"altitude_km": "500"}}),
        ("scene", SCENE | {"platfrom": {}}),
        ("scene", SCENE | {"camera": {"file": "x", "detector": {"exposure": 1.0}}}),
        ("scene", SCENE | {"camera": {"file": "x", "band": {"vis": {"lo": 1.0}}}}),
        ("scene", SCENE | {"surface": {"albedo": 1.5}}),
        ("camera", {"camera": {"width": 4, "height": 4, "fov_deg": 400.0}}),
        ("suite", CASES | {"defaults": {"platform": {"altitude": 500.0}}}),
        ("suite", CASES | {"frame": [{"scene": {"seed": 1}}]}),
        ("suite", _grid(platform={"latitude": [1.0, 2.0]})),
        ("suite", _grid(platform={"latitude_deg": 3.0})),
        ("suite", _grid(platform={"latitude_deg": {"from": 0, "to": 1, "step": 1, "n": 2}})),
        ("study", {"study": {"name": "s", "estimators": ["a"]}, "frames": {}, "design": {"list": [{"surface": {}}]}}),
    ],
)
def test_mistakes_are_found(kind, data):
    assert not _validator(kind).is_valid(data)


@pytest.mark.parametrize(
    "grid",
    [
        {"platform": {"latitude_deg": [1.0, 2.0]}},
        {"platform.latitude_deg": [1.0, 2.0]},
        {"platform": {"latitude_deg": {"from": 0, "to": 60, "n": 4, "scale": "sine"}}},
        {"camera": {"detector": {"exposure_s": {"from": 0.1, "to": 0.2, "step": 0.05}}}},
        {"camera": {"band": {"vis": {"nodes": [2, 4]}}}},
        {"clouds": [{"cover": 0.2}, {"cover": 0.4, "top_km": 9.0}]},
        {"orbit": {"altitude_km": [400.0, 600.0]}},
    ],
)
def test_axes_over_any_key_are_let_through(grid):
    assert _validator("scene").is_valid(SCENE)
    assert list(_validator("suite").iter_errors(_grid(**grid))) == []
