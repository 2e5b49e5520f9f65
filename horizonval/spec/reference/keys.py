"""Every key of the specification files with its meaning, unit, default and range, from the models themselves."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel

from horizonval.spec.explain import describe, show
from horizonval.spec.orbit import OrbitSpec
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec
from horizonval.spec.sensor.prior import PriorFile
from horizonval.spec.study import StudySpec
from horizonval.spec.suite import SuiteSpec
from horizonval.spec.units import unit_of_name

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

    Attributes
    ----------
    name : str
    meaning : str
    values : str
        What it may hold, in words.
    unit : str or None
        ``"1"`` for a number without a dimension, None for what is no number.
    default : str or None
        As it would stand in the file; empty where leaving the key out means something of its own, None where the key
        must be there.
    """

    name: str
    meaning: str
    values: str
    unit: str | None
    default: str | None


@dataclass(frozen=True)
class KeyTable:
    """One table of a file.

    Attributes
    ----------
    header : str
        ``[optics]``, or ``[[band]]`` where there can be several; empty for the file itself.
    variant : str
        ``kind = "cmos"`` where the key ``kind`` decides which keys the table has; otherwise empty.
    meaning : str
    keys : tuple of Key
        Those that hold values; tables inside it follow as tables of their own.
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
    root = MODELS[kind].model_json_schema()
    found = list(_tables(root, root, "", repeated=False))
    parent = {"suite": "cases", "study": "frames"}.get(kind)
    if parent is not None:
        orbit = OrbitSpec.model_json_schema()
        found += _tables(orbit, orbit, f"{parent}.orbit", repeated=False)
    return found


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


def holds_numbers(node: Schema) -> bool:
    """Whether a key holds a number or a list of numbers."""
    return any(part.get("type") in _NUMBERS for part in _parts(node))


def _parts(node: Schema) -> Iterator[Schema]:
    """Yield a node, what it is one of, and the entries of its lists."""
    yield node
    for inner in (*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("prefixItems", ())):
        yield from _parts(inner)
    if isinstance(node.get("items"), Mapping):
        yield from _parts(node["items"])
