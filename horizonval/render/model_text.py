"""The optical model as text, so that it can be a property of a Mitsuba plugin and lie in a scene file.

Arrays are base64 of little-endian float64: exact, and quick enough to be made for every frame.
"""

from __future__ import annotations

import base64
import json
from dataclasses import asdict
from typing import Any

import numpy as np

from horizonval.earth.column import OpticalModel, SpectralNode

_ARRAYS = ("extinction_per_m", "molecular_per_m", "particle_per_m", "asymmetry", "source", "glow_per_m")


def dump_model(model: OpticalModel) -> str:
    """Return the model as one line of JSON."""
    data = asdict(model)
    data["altitude_m"] = _pack(model.altitude_m)
    data["glow_altitude_m"] = _pack(model.glow_altitude_m)
    data["refractivity"] = None if model.refractivity is None else _pack(model.refractivity)
    for node in data["nodes"]:
        node.update({key: _pack(node[key]) for key in _ARRAYS})
    return json.dumps(data, sort_keys=True)


def load_model(text: str) -> OpticalModel:
    """Return the model written by :func:`dump_model`, bit by bit the same."""
    data = json.loads(text)
    nodes = tuple(
        SpectralNode(
            **{
                **n,
                **{key: _unpack(n[key]) for key in _ARRAYS},
                "limb_darkening": tuple(n["limb_darkening"]),
            }
        )
        for n in data["nodes"]
    )
    grids = {key: _unpack(data[key]) for key in ("altitude_m", "glow_altitude_m")}
    grids["refractivity"] = None if data["refractivity"] is None else _unpack(data["refractivity"])
    around = tuple(data["albedo_around"])
    return OpticalModel(**{**data, **grids, "nodes": nodes, "albedo_around": around})


def _pack(values: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def _unpack(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text), dtype="<f8").astype(float)
