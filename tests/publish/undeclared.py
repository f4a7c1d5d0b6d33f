"""The fields of a document that its type does not name."""

from typing import Any

from pydantic import BaseModel


def undeclared(value: Any, place: str = "") -> list[str]:
    """The paths of all fields that a reader takes for unknown additions."""
    if isinstance(value, BaseModel):
        found = [f"{place}{extra}" for extra in value.model_extra or ()]
        for field in type(value).model_fields:
            found += undeclared(getattr(value, field), f"{place}{field}.")
        return found
    if isinstance(value, list | tuple):
        return [extra for item in value for extra in undeclared(item, place)]
    return []
