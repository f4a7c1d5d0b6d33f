"""The bounds of a room's settings, checked where settings are made: each bound stands once, in the annotation of its field."""

from collections.abc import Mapping
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from annotated_types import Interval

from monitor.errors import BadConfiguration

NO_KEY: Mapping[str, bool] = {"toml": False}  # metadata of a settings field that is no key of the configuration


def check_bounds(settings: Any, section: str) -> None:
    """Raises BadConfiguration naming `section.field` where the value of a dataclass field lies outside its annotated `Interval`."""
    for name, hint in get_type_hints(type(settings), include_extras=True).items():
        for bound in get_args(hint)[1:] if get_origin(hint) is Annotated else ():
            if isinstance(bound, Interval) and not _inside(getattr(settings, name), bound):
                raise BadConfiguration(f"{section}.{name} = {getattr(settings, name)!r}; expected {_words(bound)}")


def _inside(value: Any, bound: Interval) -> bool:
    """False for NaN as well."""
    return (
        (bound.ge is None or value >= bound.ge)
        and (bound.gt is None or value > bound.gt)
        and (bound.le is None or value <= bound.le)
        and (bound.lt is None or value < bound.lt)
    )


def _words(bound: Interval) -> str:
    low = f"from {bound.ge}" if bound.ge is not None else f"above {bound.gt}"
    high = f"to {bound.le}" if bound.le is not None else f"and below {bound.lt}"
    return f"a number {low} {high}"
