"""The optical model as text, so that it can be a property of a Mitsuba plugin and lie in a scene file.

Arrays are base64 of little-endian float64: exact, and quick enough to be made for every frame.
"""

from __future__ import annotations

import base64
import json
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.earth.column import ColumnPlaces, OpticalModel, SpectralNode
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.earth.weather.field import ColumnMap

_ARRAYS = (
    "extinction_per_m",
    "molecular_per_m",
    "particle_per_m",
    "asymmetry",
    "source",
    "glow_per_m",
    "forward_per_m",
)
_ROWS = ("layer_per_m", "more_extinction_per_m", "more_molecular_per_m")


def dump_model(model: OpticalModel) -> str:
    """Return the model as one line of JSON."""
    data = asdict(replace(model, thermal=(), columns=None))
    data["altitude_m"] = _pack(model.altitude_m)
    data["glow_altitude_m"] = _pack(model.glow_altitude_m)
    data["refractivity"] = None if model.refractivity is None else _pack(model.refractivity)
    data["thermal"] = [_dump_band(band) for band in model.thermal]
    for node in data["nodes"]:
        node.update({key: _pack(node[key]) for key in _ARRAYS})
        node.update({key: [_pack(column) for column in node[key]] for key in _ROWS})
    if model.columns is not None:
        places = model.columns
        data["columns"] = {"altitude_m": _pack(places.altitude_m), "sin_latitude": _pack(places.sin_latitude)}
        data["columns"]["column_map"] = None if places.column_map is None else _dump_map(places.column_map)
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
                **{key: _unpack_rows(n[key]) for key in _ROWS},
                "layer_albedo": tuple(n["layer_albedo"]),
                "layer_asymmetry": tuple(n["layer_asymmetry"]),
            }
        )
        for n in data["nodes"]
    )
    grids: dict[str, FloatArray | None] = {key: _unpack(data[key]) for key in ("altitude_m", "glow_altitude_m")}
    grids["refractivity"] = None if data["refractivity"] is None else _unpack(data["refractivity"])
    tuples: dict[str, Any] = {key: tuple(data[key]) for key in ("band_order",)}
    tuples["layers"] = tuple((base, top) for base, top in data["layers"])
    tuples["gaps"] = tuple(None if gaps is None else LayerGaps(**gaps) for gaps in data["gaps"])
    thermal = tuple(_load_band(band) for band in data["thermal"])
    emission = None
    if data["emission"] is not None:
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data["emission"].items()}
        emission = GroundEmission(**values)
    columns = None
    if (places := data["columns"]) is not None:
        columns = ColumnPlaces(
            _unpack(places["altitude_m"]),
            _unpack(places["sin_latitude"]),
            None if places["column_map"] is None else _load_map(places["column_map"]),
        )
    parts = {"nodes": nodes, "thermal": thermal, "emission": emission, "columns": columns}
    return OpticalModel(**{**data, **grids, **tuples, **parts})


def _dump_band(band: EmittingBand) -> dict[str, Any]:
    values = {f.name: getattr(band, f.name) for f in fields(band)}
    place = values.pop("column_map")
    data = {k: v if isinstance(v, str) else {"shape": v.shape, "values": _pack(v)} for k, v in values.items()}
    if place is not None:
        data["column_map"] = _dump_map(place)
    return data


def _load_band(data: dict[str, Any]) -> EmittingBand:
    data = dict(data)
    place = data.pop("column_map", None)
    values: dict[str, Any] = {
        k: v if isinstance(v, str) else _unpack(v["values"]).reshape(v["shape"]) for k, v in data.items()
    }
    if place is not None:
        values["column_map"] = _load_map(place)
    return EmittingBand(**values)


def _dump_map(place: ColumnMap) -> dict[str, Any]:
    return {"axes": _pack(place.axes), "half": place.half, "count": place.count}


def _load_map(data: dict[str, Any]) -> ColumnMap:
    return ColumnMap(_unpack(data["axes"]).reshape(3, 3), data["half"], data["count"])


def _pack(values: ArrayLike) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode("ascii")


def _unpack_rows(texts: list[str]) -> FloatArray:
    rows = [_unpack(text) for text in texts]
    return np.stack(rows) if rows else np.zeros((0, 0))


def _unpack(text: str) -> FloatArray:
    return np.frombuffer(base64.b64decode(text), dtype="<f8").astype(float)
