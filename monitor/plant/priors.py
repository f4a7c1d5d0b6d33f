"""The priors that the plant tells new arms, as it answers with them on the bus. I/O."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import orjson
import zenoh

from monitor.publish.session import PLANT, encoding

NOTE = "priors"  # in the plant's database, for whoever looks there
ANY_SITE = "-"  # in the place of the site: of all of them
NONE_YET = "the plant has no prior of a {model}: no arm of it has replays enough, or none was made since the plant's start"


class ModelPrior(NamedTuple):
    """The newest prior of a model, as it is said."""

    site: str | None  # None: of the arms of all sites
    model: str
    arms: int
    made_at: str
    text: str  # the document, JSON


Learn = Callable[[str | Path], list[ModelPrior]]  # from the address of the plant's database


class Priors:
    """What is answered below `joint-monitor/plant/v1/prior`: SITE/MODEL. Methods may be called from any thread."""

    def __init__(self) -> None:
        self._known: dict[tuple[str | None, str], ModelPrior] = {}

    def take(self, priors: Sequence[ModelPrior]) -> None:
        """Answer with these from now on."""
        self._known = {(each.site, quote(each.model, safe="")): each for each in priors}

    def answer(self, query: zenoh.Query) -> None:
        """Answer one question: exactly one site and model, or every prior of a site that a selector with wildcards names."""
        known = self._known
        with query:
            key = str(query.key_expr)
            if "*" in key or "$" in key:
                for (site, model), each in known.items():
                    full = zenoh.KeyExpr(f"{PLANT}/prior/{site or ANY_SITE}/{model}")
                    if query.key_expr.intersects(full):
                        query.reply(full, each.text.encode(), encoding=encoding("prior"))
                return
            site, _, model = key.removeprefix(f"{PLANT}/prior/").partition("/")
            found = known.get((site, model)) or known.get((None, model))
            if found is None:
                query.reply_err(orjson.dumps({"error": NONE_YET.format(model=model)}), encoding=encoding("error"))
            else:
                query.reply(query.key_expr, found.text.encode(), encoding=encoding("prior"))
