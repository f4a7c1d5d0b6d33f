"""Two sets, file by file and byte by byte; where they differ, the first places in their JSON and by how much."""

import json
from collections.abc import Iterator
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

MOST_SHOWN = 8
SHORT = 90
_ABSENT = object()


def compared(expected: Path, found: Path, chosen: set[str] | None = None) -> bool:
    """Print of every file whether it is the same; `chosen`: only files below these folders. True where all are."""
    names = sorted({path.relative_to(folder).as_posix() for folder in (expected, found) for path in folder.rglob("*") if path.is_file()})
    names = [name for name in names if chosen is None or name.split("/", 1)[0] in chosen]
    wrong = 0
    for name in names:
        one, other = (folder / name for folder in (expected, found))
        if not one.is_file() or not other.is_file():
            wrong += 1
            print(f"{name}: DIFFERS: {'not there before' if other.is_file() else 'not there any more'}")
        elif one.read_bytes() == other.read_bytes():
            print(f"{name}: same")
        else:
            wrong += 1
            print(f"{name}: DIFFERS")
            for line in islice(differences(_read(one), _read(other)), MOST_SHOWN):
                print(f"    {line}")
    print(f"{len(names) - wrong} files are the same, {wrong} differ")
    return wrong == 0 and bool(names)


def _read(path: Path) -> Any:
    text = path.read_text("utf-8")
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in text.splitlines()]
    return json.loads(text) if path.suffix == ".json" else text.splitlines()


def differences(before: Any, after: Any, where: str = "$", *, relative: float = 0.0, absolute: float = 0.0) -> Iterator[str]:
    """Each difference as a line with its JSON path; text that is JSON is looked into.

    Figures may differ by this fraction of the larger, or by this much; whole numbers may not.
    """
    more = {"relative": relative, "absolute": absolute}
    before, after = _opened(before), _opened(after)
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            yield from differences(before.get(key, _ABSENT), after.get(key, _ABSENT), f"{where}.{key}", **more)
        if set(before) == set(after) and list(before) != list(after):
            yield f"{where}: the keys come in another order"
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{where}: {len(before)} entries, now {len(after)}"
        for number, (one, other) in enumerate(zip_longest(before, after, fillvalue=_ABSENT)):
            yield from differences(one, other, f"{where}[{number}]", **more)
    elif _is_number(before) and _is_number(after):
        largest, whole = max(abs(before), abs(after)), type(before) is int and type(after) is int
        near = relative and not whole and abs(after - before) <= max(relative * largest, absolute)
        if not near and repr(before) != repr(after):
            share = f" ({abs(after - before) / largest:.1e} of it)" if largest else ""
            yield f"{where}: {before!r}, now {after!r}{share}"
    elif before is not after and before != after:
        yield f"{where}: {_short(before)}, now {_short(after)}"


def _opened(value: Any) -> Any:
    """Text, or lines of it, that is a JSON object or list, as such."""
    text = "\n".join(value) if isinstance(value, list) and value and all(isinstance(line, str) for line in value) else value
    if isinstance(text, str) and text[:1] in {"{", "["}:
        try:
            return json.loads(text)
        except ValueError:
            return value
    return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = "absent" if value is _ABSENT else repr(value)
    return text if len(text) <= SHORT else f"{text[:SHORT]}…"
