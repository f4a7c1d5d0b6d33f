"""Seconds since 1970 ↔ what people and other programs read: UTC, RFC 3339."""

from datetime import UTC, datetime


def rfc3339(unix_s: float) -> str:
    """2026-11-21T03:00:00Z, to the second."""
    return datetime.fromtimestamp(round(unix_s), tz=UTC).isoformat().replace("+00:00", "Z")


def outside(document: object) -> object:
    """The same JSON document with every `*_unix_s` number told as `*` in RFC 3339, as documents leave the house."""
    if isinstance(document, dict):
        told: dict[str, object] = {}
        for key, value in document.items():
            if key.endswith("_unix_s") and isinstance(value, int | float):
                told[key.removesuffix("_unix_s")] = rfc3339(value)
            elif key.endswith("_unix_s") and value is None:
                told[key.removesuffix("_unix_s")] = None
            else:
                told[key] = outside(value)
        return told
    if isinstance(document, list | tuple):
        return [outside(value) for value in document]
    return document
