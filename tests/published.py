"""Documents for tests: of a registered type, with the fields that a test gives, whatever else the type asks for."""

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter

from monitor.publish.documents import Document, Time
from monitor.publish.registry import KINDS, Delivery


def raw(kind: str, fields: Mapping[str, Any]) -> Document:
    """A document with these fields alone, for the wire; nobody has held them against the model."""
    document = KINDS[kind].model.model_construct()
    assert isinstance(document, Document)
    document.__dict__.clear()
    document.__dict__.update(fields)
    return document


def last_values(by_key: Mapping[str, Mapping[str, Any]]) -> dict[str, Document]:
    """Last values by their keys, as the bus holds them; a field that is not given is None, or has its default."""
    return {key: _partial(_model(key), fields) for key, fields in by_key.items()}


def _model(key: str) -> type[BaseModel]:
    for kind in KINDS.values():
        if kind.delivery in (Delivery.LAST_VALUE, Delivery.STREAM) and any(
            re.fullmatch(re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(each)), key) for each in kind.keys
        ):
            return kind.model
    raise KeyError(key)


def _partial(model: type[BaseModel], fields: Mapping[str, Any]) -> Any:
    values = {name: _value(field.annotation, fields[name]) for name, field in model.model_fields.items() if name in fields}
    missing = {name: _nothing(field.annotation) for name, field in model.model_fields.items() if name not in fields and field.is_required()}
    return model.model_construct(**missing, **values)


def _nothing(annotation: Any) -> Any:
    """What stands for a required field that is not given: an empty part, an empty list, or None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return _partial(annotation, {})
    return [] if str(annotation).startswith("list[") else None


def _value(annotation: Any, value: Any) -> Any:
    models = [each for each in (annotation, *get_args(annotation)) if isinstance(each, type) and issubclass(each, BaseModel)]
    if models and isinstance(value, Mapping):
        return _partial(models[0], value)
    if models and isinstance(value, list):
        return [_partial(models[0], each) for each in value]
    if isinstance(value, str) and {datetime, Time} & {annotation, *get_args(annotation)}:
        return TypeAdapter(datetime).validate_python(value)
    return value
