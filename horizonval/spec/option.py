"""What the command line says in place of a key of a file: checked as the file's own value is."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from horizonval.core.errors import UserError
from horizonval.spec.base import Model
from horizonval.spec.explain import describe_key, show

M = TypeVar("M", bound=Model)


def with_option(model: M, key: str, value: Any, option: str) -> M:
    """Return a table of a file with one key changed.

    Parameters
    ----------
    model : Model
    key : str
    value
        As the file would hold it.
    option : str
        What the error calls it, as ``"--frames"``.

    Raises
    ------
    UserError
        The file may not hold that value.
    """
    changed = {name: getattr(model, name) for name in model.model_fields_set} | {key: value}
    try:
        return type(model).model_validate(changed, strict=True)
    except ValidationError as e:
        problem = e.errors(include_url=False)[0]
        if problem["loc"]:
            expected = describe_key(type(model), key)
            raise UserError(f"found {show(value)}", where=option, expected=expected or problem["msg"]) from None
        raise UserError(str(problem["ctx"]["error"]), where=option) from None
