"""A mistake as a message: what is wrong, where, what was expected, what to do, and all of it as one line."""

from __future__ import annotations

from typing import Any

from horizonval.core.errors import UserError
from horizonval.wire import SCHEMA

PARTS = ("what", "where", "expected", "fix")


def problem_message(error: UserError, identity: int | str | None = None) -> dict[str, Any]:
    """Return the reply that says a mistake, the first one of several; ``identity`` is the request's ``id``."""
    message: dict[str, Any] = {"schema": SCHEMA, "kind": "error"}
    if identity is not None:
        message["id"] = identity
    return message | {part: getattr(error, part) for part in PARTS} | {"line": error.line()}


def error_of_message(message: dict[str, Any]) -> UserError:
    """Return the mistake that a reply says."""
    what, where, expected, fix = (str(message.get(part, "")) for part in PARTS)
    return UserError(what or "the server refused", where=where, expected=expected, fix=fix)
