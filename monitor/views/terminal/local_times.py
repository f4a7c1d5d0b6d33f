"""Times of documents, which are UTC, in the time zone of the schedule, for a person."""

import re
from datetime import UTC, datetime, tzinfo
from typing import Any

_STAMP = re.compile(r"\b(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.\d+)?Z")


def local_times(document: Any, zone: tzinfo) -> Any:
    """The same document with every time of its texts in the zone, e.g. 2026-11-22 04:00:00 CET; unchanged where the zone is UTC."""
    if str(zone) == "UTC":
        return document
    if isinstance(document, dict):
        return {key: local_times(value, zone) for key, value in document.items()}
    if isinstance(document, list):
        return [local_times(value, zone) for value in document]
    return _STAMP.sub(lambda match: _local(match[1], zone), document) if isinstance(document, str) else document


def _local(stamp: str, zone: tzinfo) -> str:
    return datetime.fromisoformat(stamp).replace(tzinfo=UTC).astimezone(zone).strftime("%Y-%m-%d %H:%M:%S %Z")
