"""Every key of the specification files, from the models themselves: as JSON Schema, and as tables for the reference.

The models say what a whole table holds. Files also hold parts of scenes (defaults, frames, designs), changes of the
camera file inside a scene, and axes over any key; their schemas (draft 2020-12) are made from the whole ones here. For
every table ``X`` there are, where they are needed, ``XPartial`` (no key is required), ``XAxes`` (every key holds the
values that it takes) and ``XRanges`` (every key holds the two ends between which it is drawn).
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel

from horizonval.core.json_types import JsonObject
from horizonval.spec.base import unit_of_name
from horizonval.spec.camera import CameraSpec
from horizonval.spec.explain import describe, show
from horizonval.spec.load import CAMERA_TABLES
from horizonval.spec.orbit import OrbitSpec
from horizonval.spec.prior import PriorFile
from horizonval.spec.scene import SceneSpec
from horizonval.spec.suite import StudySpec, SuiteSpec

FileKind = Literal["scene", "camera", "suite", "study", "prior"]

MODELS: dict[FileKind, type[BaseModel]] = {
    "scene": SceneSpec,
    "camera": CameraSpec,
    "suite": SuiteSpec,
    "study": StudySpec,
    "prior": PriorFile,
}
"""Kinds of files that have a schema, by what the command line calls them."""

_NUMBERS = ("integer", "number")
Schema = Mapping[str, Any]


@dataclass(frozen=True)
class Key:
    """One key of a table.

    ``values``: what it may hold, in words. ``unit``: "1" without a dimension, None for what is no number. ``default``:
    as in the file, empty where a missing key has a meaning of its own, None where the key is required.
    """

    name: str
    meaning: str
    values: str
    unit: str | None
    default: str | None


@dataclass(frozen=True)
class KeyTable:
    """One table of a file; tables inside it follow as separate tables.

    ``header``: ``[optics]``, or ``[[band]]`` where there can be several; empty for the file itself. ``variant``:
    ``kind = "cmos"`` where the key ``kind`` decides which keys the table has.
    """

    header: str
    variant: str
    meaning: str
    keys: tuple[Key, ...]


def tables(kind: FileKind) -> list[KeyTable]:
    """Return every table that a kind of file can have, those inside a table after it.

    ``[cases.orbit]`` and the study's ``[frames.orbit]`` are plain data to their models, for a grid may hold a part of
    them; their keys are those of :class:`horizonval.spec.orbit.OrbitSpec`.
    """
    found = tables_of(MODELS[kind])
    parent = {"suite": "cases", "study": "frames"}.get(kind)
    if parent is not None:
        found += tables_of(OrbitSpec, f"{parent}.orbit")
    return found


def tables_of(model: type[BaseModel], path: str = "") -> list[KeyTable]:
    """Return the tables of a model, which itself is the table ``path``."""
    root = model.model_json_schema()
    return list(_tables(root, root, path, repeated=False))


def _tables(root: Schema, node: Schema, path: str, *, repeated: bool, tag: str = "") -> Iterator[KeyTable]:
    required = node.get("required", ())
    keys: list[Key] = []
    below: list[tuple[str, list[Schema], bool]] = []
    for name, prop in node["properties"].items():
        objects, several = _objects(root, prop)
        if objects:
            below.append((name, objects, several))
        else:
            keys.append(_key(root, name, prop, required=name in required))
    header = f"[[{path}]]" if repeated else f"[{path}]" if path else ""
    yield KeyTable(header, tag, " ".join(node.get("description", "").split("\n")), tuple(keys))
    for name, objects, several in below:
        for found in objects:
            kind = found["properties"].get("kind", {}).get("const") if len(objects) > 1 else None
            yield from _tables(
                root,
                found,
                f"{path}.{name}" if path else name,
                repeated=several,
                tag=f'kind = "{kind}"' if kind is not None else "",
            )


def _objects(root: Schema, node: Schema) -> tuple[list[Schema], bool]:
    """Return the tables that a key can hold, and whether it holds a list of them; none where it holds values."""
    if "$ref" in node:
        node = root["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    if node.get("type") == "array" and "items" in node:
        return _objects(root, node["items"])[0], True
    if node.get("type") == "object" and "properties" in node:
        return [node], False
    options = [*node.get("oneOf", ()), *node.get("anyOf", ())]
    return [table for option in options for table in _objects(root, option)[0]], False


def _key(root: Schema, name: str, node: Schema, *, required: bool) -> Key:
    default = None if required else "" if node.get("default") is None else show(node["default"])
    meaning = " ".join(node.get("description", "").split())
    return Key(name, meaning, describe(root, node), unit_of(name, node), default)


def unit_of(name: str, node: Schema) -> str | None:
    """Return the unit of a key that holds a number or numbers: stated, or by its name; None for anything else."""
    stated = next((part["unit"] for part in _parts(node) if "unit" in part), None)
    if stated is not None:
        return str(stated)
    if not any(part.get("type") in _NUMBERS for part in _parts(node)):
        return None
    return unit_of_name(name)


def _parts(node: Schema) -> Iterator[Schema]:
    """Yield a node, what it is one of, and the entries of its lists."""
    yield node
    for inner in (*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("prefixItems", ())):
        yield from _parts(inner)
    if isinstance(node.get("items"), Mapping):
        yield from _parts(node["items"])


DRAFT = "https://json-schema.org/draft/2020-12/schema"
_DEFINITIONS = "#/$defs/"
_SUFFIXES = ("Partial", "Axes", "Ranges")


def json_schema(kind: FileKind) -> JsonObject:
    """Return the schema of a kind of file as plain data.

    Every key has a ``description`` and, where it holds numbers, a ``unit`` (``"1"`` without a dimension). Keys that
    exclude each other are found only by reading the file.
    """
    definitions = _Definitions()
    name = definitions.add(MODELS[kind])
    if kind not in ("camera", "prior"):
        definitions.add(SceneSpec)
        definitions.add(CameraSpec)
        definitions.add(OrbitSpec)
        definitions.let_scenes_change_the_camera()
    match kind:
        case "suite":
            definitions.replace("SuiteSpec", "defaults", definitions.partial_scene())
            definitions.replace("SuiteSpec", "frame", {"type": "array", "items": definitions.frame()})
            definitions.vary("CasesSpec")
        case "study":
            definitions.replace("StudySpec", "defaults", definitions.partial_scene())
            entry = definitions.partial_scene(orbit=True)
            entry["properties"] |= {"name": {"type": "string"}, "estimators": _NAMES}
            entries = {"type": "array", "minItems": 1, "items": entry | {"required": ["name"]}}
            definitions.replace("DesignSpec", "list", entries)
            definitions.replace("DesignSpec", "choices", {"type": "object", "additionalProperties": entries})
            definitions.replace("DesignSpec", "grid", definitions.scene_of("Axes"))
            definitions.vary("FramesSpec")
    return definitions.document(name)


def schema_text(kind: FileKind) -> str:
    """Return the schema of a kind of file as the JSON text that is printed, and kept beside the shipped files."""
    return json.dumps(json_schema(kind), indent=1) + "\n"


_NAMES: JsonObject = {"type": "array", "minItems": 1, "items": {"type": "string"}}


class _Definitions:
    """Tables by name; those that are variants of others are made when they are first referred to."""

    def __init__(self) -> None:
        self._tables: dict[str, JsonObject] = _ranges()

    def add(self, model: Any) -> str:
        """Take in a model with all tables that it holds; return its name."""
        whole = model.model_json_schema()
        for name, table in (whole.pop("$defs", {}) | {model.__name__: whole}).items():
            self._tables.setdefault(name, _tidy_table(table))
        return str(model.__name__)

    def let_scenes_change_the_camera(self) -> None:
        """Add the tables of the camera file to the scene's ``[camera]``; bands are changed by their names."""
        camera = self._tables["CameraSpec"]["properties"]
        for key in CAMERA_TABLES:
            if key == "band":
                table = {"type": "object", "additionalProperties": self._variant(camera[key]["items"], "Partial")}
            else:
                table = self._variant(camera[key], "Partial")
            table["description"] = f"Change of the camera file's `{key}`."
            self._tables["CameraUse"]["properties"][key] = table

    def replace(self, table: str, key: str, node: JsonObject) -> None:
        """Put another node in a key's place; its description stays."""
        old = self._tables[table]["properties"][key]
        kept = {word: old[word] for word in ("title", "description") if word in old}
        self._tables[table]["properties"][key] = kept | node

    def partial_scene(self, *, orbit: bool = False) -> JsonObject:
        """Return a scene of which nothing is required."""
        return self.scene_of("Partial", orbit=orbit)

    def scene_of(self, suffix: str, *, orbit: bool = True) -> JsonObject:
        """Return a variant of a scene, with or without an orbit; axes and ranges can also have dotted keys."""
        table = copy.deepcopy(self._tables[self._make("SceneSpec", suffix)])
        if orbit:
            table["properties"]["orbit"] = {"$ref": _DEFINITIONS + self._make("OrbitSpec", suffix)}
        if suffix != "Partial":
            table["patternProperties"] = {r"\.": {"type": ["array", "object"]}}
        return table

    def frame(self) -> JsonObject:
        """Return a ``[[frame]]`` of a suite."""
        table = self.partial_scene()
        table["properties"]["estimators"] = _NAMES
        named = {"properties": {"scene": {"required": ["name"]}}, "required": ["scene"]}
        return table | {"allOf": [named]}

    def vary(self, table: str) -> None:
        """Say what the keys of a table that makes many frames hold."""
        self.replace(table, "base", self.partial_scene())
        self.replace(table, "list", {"type": "array", "minItems": 1, "items": self.partial_scene(orbit=True)})
        self.replace(table, "grid", self.scene_of("Axes"))
        self.replace(table, "orbit", {"$ref": _DEFINITIONS + self._make("OrbitSpec", "Partial")})
        self.replace("SobolSpec", "ranges", self.scene_of("Ranges"))

    def document(self, name: str) -> JsonObject:
        """Return the schema with all tables that it needs, sorted by name."""
        needed: dict[str, JsonObject] = {}
        waiting = [name]
        while waiting:
            for reference in _references(self._tables[waiting.pop()]):
                if reference not in needed:
                    needed[reference] = self._tables[reference]
                    waiting.append(reference)
        head = {"$schema": DRAFT} | self._tables[name]
        return copy.deepcopy(head | {"$defs": dict(sorted(needed.items()))})

    def _make(self, name: str, suffix: str) -> str:
        """Return the name of a table's variant, which is there afterwards."""
        base = next((name.removesuffix(s) for s in _SUFFIXES if name.endswith(s)), name)
        new = base + suffix
        if new not in self._tables:
            table = copy.deepcopy(self._tables[base])
            table.pop("required", None)
            # There before its keys are made: tables can hold tables of their own kind.
            self._tables[new] = table
            for key, node in table["properties"].items():
                place = f"{_DEFINITIONS}{base}/properties/{key}"
                made = self._variant(node, suffix, place)
                if "$ref" not in made:
                    made = {word: node[word] for word in ("title", "description") if word in node} | made
                table["properties"][key] = made
        return new

    def _variant(self, node: JsonObject, suffix: str, place: str = "") -> JsonObject:
        """Return what stands in a key's place in a variant; ``place`` is the key's own in the schema."""
        options = [n for n in node.get("oneOf") or node.get("anyOf") or [node] if "$ref" in n]
        if options:
            made = [{"$ref": _DEFINITIONS + self._make(_table_of(n["$ref"]), suffix)} for n in options]
            whole = made if suffix == "Partial" else [*made, _list_of(self._variant(node, "Partial"))]
            return whole[0] if len(whole) == 1 else {"anyOf": whole}
        inner = node.get("additionalProperties")
        if node.get("type") == "object" and isinstance(inner, Mapping) and "$ref" in inner:
            return node | {"additionalProperties": self._variant(dict(inner), suffix)}
        whole_key = {"$ref": place}
        return whole_key if suffix == "Partial" else _values(node, whole_key, pair=suffix == "Ranges")


def _table_of(reference: str) -> str:
    """Return the name of the table that a reference is to, or to a key of."""
    return reference.removeprefix(_DEFINITIONS).split("/")[0]


def _list_of(node: JsonObject) -> JsonObject:
    return {"type": "array", "minItems": 1, "items": node}


def _values(node: JsonObject, whole: JsonObject, *, pair: bool) -> JsonObject:
    """Return an axis over a key: a list of what it may hold, or a range of numbers or dates.

    ``pair``: its two ends instead of a list.
    """
    if node.get("type") in ("integer", "number"):
        span = "NumberRange"
    elif node.get("format") == "date-time":
        span = "DateRange"
    else:
        return _list_of(whole)
    if pair:
        return {"anyOf": [_list_of(whole) | {"minItems": 2, "maxItems": 2}, {"$ref": f"{_DEFINITIONS}{span}Drawn"}]}
    return {"anyOf": [_list_of(whole), {"$ref": f"{_DEFINITIONS}{span}"}]}


def _ranges() -> dict[str, JsonObject]:
    """Return the tables ``{from, to, ...}`` of numbers and dates; the ends' limits are left to the reading."""
    found: dict[str, JsonObject] = {}
    for name, end in (
        ("NumberRange", {"type": "number"}),
        ("DateRange", {"type": "string", "format": "date-time"}),
    ):
        ends: JsonObject = {"from": end, "to": end, "scale": {"enum": ["linear", "log", "sine"], "default": "linear"}}
        steps: JsonObject = {"step": {"type": "number"}, "n": {"type": "integer", "minimum": 1}}
        table: JsonObject = {"type": "object", "required": ["from", "to"], "additionalProperties": False}
        found[f"{name}Drawn"] = table | {"properties": ends}
        one_of = {"oneOf": [{"required": ["step"]}, {"required": ["n"]}]}
        found[name] = table | {"properties": ends | steps} | one_of
    return found


def _tidy_table(table: JsonObject) -> JsonObject:
    """Return a table without what TOML cannot hold, its keys with units."""
    table = copy.deepcopy(table)
    paragraphs = table.get("description", "").split("\n\n")
    table["description"] = "\n\n".join(" ".join(text.split()) for text in paragraphs)
    for key, node in table.get("properties", {}).items():
        unit = unit_of(key, node)
        node = _tidy(node)
        if isinstance(node.get("default"), dict | None) or node.get("default") == []:
            node.pop("default", None)
        node["title"] = key if unit in (None, "1") else f"{key} [{unit}]"
        if unit is not None:
            node["unit"] = unit
        if "description" in node:
            node["description"] = " ".join(node["description"].split())
        table["properties"][key] = node
    return table


def _tidy(node: JsonObject) -> JsonObject:
    """Return a node without null (TOML has none), inner titles and units, and pydantic's discriminator."""
    node = {key: value for key, value in node.items() if key not in ("title", "unit", "discriminator")}
    options = [_tidy(option) for option in node.pop("anyOf", []) if option.get("type") != "null"]
    if len(options) == 1:
        node |= {key: value for key, value in options[0].items() if key not in node}
    elif options:
        node["anyOf"] = options
    if isinstance(node.get("items"), Mapping):
        node["items"] = _tidy(node["items"])
    if "prefixItems" in node:
        node["prefixItems"] = [_tidy(item) for item in node["prefixItems"]]
    return node


def _references(node: Any) -> set[str]:
    """Return the names of the tables that a node refers to."""
    if isinstance(node, Mapping):
        found = {_table_of(node["$ref"])} if "$ref" in node else set()
        return found.union(*(_references(value) for value in node.values()))
    if isinstance(node, list):
        return set().union(*(_references(value) for value in node))
    return set()
