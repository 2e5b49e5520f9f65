"""Validation errors in plain words: file, dotted key, what was found, what was expected.

A model's JSON schema already says what every key may hold, so one description of a schema node serves every kind of
error; nothing here knows a particular model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from horizonval.core.errors import UserError, excerpt, one_of, several
from horizonval.spec.base import Model

Schema = Mapping[str, Any]

MOST_EXPLAINED = 200
"""Problems of one file that are looked at; a list may have a million of them."""


def explain(error: ValidationError, model: type[BaseModel], file: str, *, inside: str = "") -> UserError:
    """Return the problems of a validation as a user's error, each of them one line.

    ``inside`` comes before the dotted key, where the data are part of a larger file.
    """
    problems = error.errors(include_url=False)
    # An unknown key is nearly always the cause of a missing one (``widht``), so it is told first.
    problems.sort(key=lambda problem: problem["type"] != "extra_forbidden")
    root = _schema_of(model)
    mistakes: dict[str, UserError] = {}
    for problem in problems[:MOST_EXPLAINED]:
        mistake = _explained(problem, root, file, inside)
        # What may be of several types is wrong once, and not once for each of them.
        mistakes.setdefault(mistake.where if problem["type"] != "value_error" else mistake.line(), mistake)
    return several(list(mistakes.values()), len(problems) - len(problems[:MOST_EXPLAINED]))


@cache
def _schema_of(model: type[BaseModel]) -> Schema:
    return model.model_json_schema()


def _explained(problem: Any, root: Schema, file: str, inside: str) -> UserError:
    node, key = _walk(root, problem["loc"])
    kind, value = problem["type"], problem["input"]
    if kind == "extra_forbidden":
        parent, _ = _walk(root, problem["loc"][:-1])
        known = list(parent.get("properties", {}))
        what, expected = "unknown key", one_of(problem["loc"][-1], known)
    elif kind == "missing":
        what, expected = "missing", describe(root, node)
    elif kind == "value_error":
        what, expected = str(problem.get("ctx", {}).get("error", problem["msg"])), ""
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        tag = str(problem["ctx"]["discriminator"]).strip("'")
        key += f".{tag}"
        what = f"found {show(problem['ctx']['tag'])}" if "tag" in problem["ctx"] else "missing"
        expected = _either(show(t) for t in node.get("discriminator", {}).get("mapping", {}))
    elif kind == "finite_number":
        what, expected = f"found {show(value)}", "a finite number"
    else:
        what, expected = f"found {show(value)}", describe(root, node) or "another value"
    return UserError(what, where=": ".join(part for part in (file, inside, key) if part), expected=expected)


def describe_key(model: type[BaseModel], key: str) -> str:
    """Return what a key of a model accepts, in words."""
    root = _schema_of(model)
    return describe(root, _walk(root, (key,))[0])


def describe(root: Schema, node: Schema) -> str:
    """Return what a schema node accepts, in words; empty where the schema says nothing useful."""
    node = _resolve(root, node)
    if options := _types(node):
        return _either(filter(None, (describe(root, option) for option in options)))
    if "discriminator" in node:
        kinds = _either(show(kind) for kind in node["discriminator"].get("mapping", {}))
        return f"a table with {node['discriminator']['propertyName']} = {kinds}"
    if "const" in node:
        return show(node["const"])
    if "enum" in node:
        return _either(show(v) for v in node["enum"])
    match node.get("type"):
        case "integer":
            return "a whole number" + _limits(node)
        case "number":
            return "a number" + _limits(node)
        case "boolean":
            return "true or false"
        case "string" if node.get("format") == "date-time":
            return "a date and time such as 2026-03-20T12:00:00Z"
        case "string" if "pattern" in node:
            return f"text made of the characters {node['pattern'].strip('^$').rstrip('+')}" + _length(node)
        case "string":
            return "text in quotes" + _length(node)
        case "array":
            return "a list" + _item(root, node) + _length(node)
        case "object":
            keys = list(node.get("properties", {}))
            least = f" with at least {node['minProperties']} key" if "minProperties" in node else ""
            return "a table" + (f" with the keys {', '.join(keys)}" if keys else least)
        case _:
            return ""


def show(value: object) -> str:
    """Return a value as it would stand in the file, shortened."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            text = f'"{value}"'
        case Mapping():
            return "a table"
        case list() | tuple():
            text = "[" + ", ".join(show(v) for v in value) + "]"
        case None:
            return "nothing"
        case _:
            text = str(value)
    return excerpt(text, 60)


def _walk(root: Schema, loc: Sequence[int | str]) -> tuple[Schema, str]:
    """Follow an error's location; return the schema node there and the dotted key as the file spells it.

    Pydantic's tag of a union (``detector.cmos.bits``) is dropped; list items count from 1.
    """
    node: Schema = _resolve(root, root)
    key = ""
    for part in loc:
        if len(_types(node)) > 1 and "discriminator" not in node:
            # Pydantic goes on with the name of a type, which is no key.
            break
        mapping = node.get("discriminator", {}).get("mapping", {})
        if isinstance(part, int):
            # Lists of a fixed length say what each entry is.
            fixed = node.get("prefixItems", ())
            item = fixed[part] if part < len(fixed) else node.get("items", {})
            node, key = _resolve(root, item), f"{key}[{part + 1}]"
        elif part in mapping:
            node = _resolve(root, {"$ref": mapping[part]})
        else:
            others = node.get("additionalProperties")
            node = node.get("properties", {}).get(part, others if isinstance(others, dict) else {})
            node = _resolve(root, node)
            key = f"{key}.{excerpt(str(part))}" if key else excerpt(str(part))
    return node, key


def _resolve(root: Schema, node: Schema) -> Schema:
    """Follow references, and see through ``anything or null``."""
    while True:
        if "$ref" in node:
            node = root["$defs"][node["$ref"].rsplit("/", 1)[-1]]
            continue
        options = _types(node)
        if len(options) != 1:
            return node
        node = options[0]


def _types(node: Schema) -> list[Schema]:
    """Return the types that a node may be of, beside nothing; empty where it says none or one of them."""
    return [o for o in node.get("anyOf", []) if o.get("type") != "null"]


def _limits(node: Schema) -> str:
    lo, hi = node.get("minimum"), node.get("maximum")
    above, below = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
    if lo is not None and hi is not None:
        return f" from {_number(lo)} to {_number(hi)}"
    words = []
    if above is not None:
        words.append(f"above {_number(above)}")
    if lo is not None:
        words.append(f"of at least {_number(lo)}")
    if below is not None:
        words.append(f"below {_number(below)}")
    if hi is not None:
        words.append(f"of at most {_number(hi)}")
    return (" " + " and ".join(words)) if words else ""


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) and abs(value) < 10**9 else f"{value:g}"


def _item(root: Schema, node: Schema) -> str:
    inner = describe(root, node.get("items", {}))
    return f" whose entries are each {inner}" if inner else ""


def _length(node: Schema) -> str:
    words = []
    unit = "long" if node.get("type") == "array" else "characters long"
    if "minItems" in node or node.get("minLength", 0) > 1:
        words.append(f"at least {node.get('minItems', node.get('minLength'))} {unit}")
    if most := node.get("maxItems", node.get("maxLength")):
        words.append(f"at most {most} {unit}")
    return (", " + " and ".join(words)) if words else ""


def _either(words: Any) -> str:
    return " or ".join(words)


M = TypeVar("M", bound=Model)


def with_option(model: M, key: str, value: Any, option: str) -> M:
    """Return a table of a file with one key changed; UserError, at ``option``, where the value is refused."""
    changed = {name: getattr(model, name) for name in model.model_fields_set} | {key: value}
    try:
        return type(model).model_validate(changed, strict=True)
    except ValidationError as e:
        problem = e.errors(include_url=False)[0]
        if problem["loc"]:
            expected = describe_key(type(model), key)
            raise UserError(f"found {show(value)}", where=option, expected=expected or "another value") from None
        raise UserError(str(problem["ctx"]["error"]), where=option) from None
