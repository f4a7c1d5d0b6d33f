"""The documents of the bus as a person reads them: sentences in their language, and with every alert what it means."""

import asyncio
import json
from collections.abc import Mapping
from typing import Any

from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.language.catalogue import Language
from monitor.views.web.page_content import PageContent

Payloads = list[tuple[str, bytes]]


class Told:
    """Puts the last values of the bus into words."""

    def __init__(self, content: PageContent) -> None:
        self._content = content

    async def tell(self, new: Payloads, last: Mapping[str, bytes], say: Language) -> Payloads:
        """The new values in words, and the alerts whose dates they change. last : all values."""
        changed = {key.split("/")[1] for key, _ in new if key.startswith("joint/") and key.endswith("/friction")}
        known = {key for key, _ in new}
        again = [(key, last[key]) for key in last if key.startswith("alert/j") and key.split("/")[1][1:] in changed and key not in known]
        if not any(_has_words(key) for key, _ in [*new, *again]):
            return new
        return await asyncio.to_thread(self._in_words, [*new, *again], last, say)

    def _in_words(self, new: Payloads, last: Mapping[str, bytes], say: Language) -> Payloads:
        told: Payloads = []
        for key, payload in new:
            if not _has_words(key):
                told.append((key, payload))
                continue
            document = json.loads(payload)
            words = say.document(document)
            if key.startswith("alert/") and isinstance(document, dict):
                words["said"] = self._sentences(document, last, say)
            told.append((key, json.dumps(words, ensure_ascii=False, separators=(",", ":")).encode()))
        return told

    def _sentences(self, alert: Mapping[str, Any], last: Mapping[str, bytes], say: Language) -> dict[str, str]:
        """Headline, pace and due of one alert."""
        joint, past = alert["joint"], JointPast(began_unix_s=self._content.began_unix_s())
        payload = last.get(f"joint/{joint}/friction")
        if joint is not None and payload is not None:
            past = past._replace(
                friction=json.loads(payload),
                began_unix_s=self._content.began_unix_s(joint),
                learnt_unix_s=self._content.newest_unix_s(),
            )
        return sentences(alert, past, self._content.now(), say)._asdict()


def _has_words(key: str) -> bool:
    """Whether the values of a key have sentences for people."""
    return (
        key.startswith("alert/") or key in {"health", "monitor", "replay", "from_production"} or key.endswith(("/friction", "/maintenance"))
    )
