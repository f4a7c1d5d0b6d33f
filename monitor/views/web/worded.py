"""The files of a page, and its texts in the reader's language: what every application that serves pages does alike."""

import asyncio
import html
import json
import re
from collections.abc import Mapping
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from monitor.publish.documents import Alert, Friction, Health, read
from monitor.publish.shown import alert_pill, arm_shown, joint_shown
from monitor.views.alert_sentence import JointPast, deciding, sentences
from monitor.views.language.catalogue import LANGUAGES, Language, best_language, language
from monitor.views.web.page_content import PageContent

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_TEXT = re.compile(r"\[\[(.+?)\]\]")  # a text of a page, to be said in the reader's language


class Worded:
    """Files by name, with their media types, and pages in words."""

    def __init__(self, static: Mapping[str, tuple[bytes, str]], named: str, base: str = "") -> None:
        """Named : the setting of the language, which may be `browser`. base : the path below which the page is mounted."""
        self._static, self._named, self._base = static, named, base

    def language(self, request: Request) -> Language:
        """The language that the address names; else that of the setting, or of the browser."""
        named = request.query_params.get("lang", "")
        accepted = request.headers.get("accept-language", "")
        return language(named if named in LANGUAGES else best_language(accepted, self._named))

    def in_words(self, page: str, request: Request) -> str:
        """A page with its texts, which stand in double brackets, in the reader's language."""
        say = self.language(request)
        worded = _TEXT.sub(lambda text: html.escape(say.say(text[1])), page)
        return worded.replace("%LANG%", say.code).replace("%BASE%", html.escape(self._base))

    async def words(self, request: Request) -> Response:
        """The catalogue of a language as a script."""
        catalogue = language(request.path_params["code"]).catalogue
        script = f"const WORDS = {json.dumps(dict(catalogue), ensure_ascii=False)};\n"
        return with_headers(Response(script, media_type="text/javascript"))

    async def file(self, request: Request) -> Response:
        """One of the files."""
        found = self._static.get(request.path_params["name"])
        if found is None:
            return with_headers(Response("not found", status_code=404))
        response = with_headers(Response(found[0], media_type=found[1]))
        response.headers["Cache-Control"] = "no-cache"
        return response


def with_headers(response: Response) -> Response:
    """The response with HEADERS, where it does not set them itself."""
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    return response


# --- The documents of the bus as a person reads them: sentences in their language, and with every alert what it means ---

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
            if key.startswith("alert/"):
                alert = read(Alert, document)
                said = sentences(alert, self._past(alert.joint, last), self._content.now(), say)
                words |= {"said": said._asdict(), "pill": alert_pill(alert).value}
            elif key == "health":
                words |= self._shown(read(Health, document), last, say)
            told.append((key, json.dumps(words, ensure_ascii=False, separators=(",", ":")).encode()))
        return told

    def _past(self, joint: int | None, last: Mapping[str, bytes]) -> JointPast:
        """What is known of the joint of an alert."""
        payload = None if joint is None else last.get(f"joint/{joint}/friction")
        if payload is None:
            return JointPast(began_unix_s=self._content.began_unix_s())
        return JointPast(Friction.model_validate_json(payload), self._content.began_unix_s(joint), self._content.newest_unix_s())

    def _shown(self, health: Health, last: Mapping[str, bytes], say: Language) -> dict[str, Any]:
        """How arm and joints are shown. of_arm : the arm's own alert decides."""
        shown = arm_shown(health)
        past = self._past(None if shown.alert is None else shown.alert.joint, last)
        text = deciding(shown, self._content.now(), say, past.began_unix_s)
        return {
            "shown": {"pill": shown.pill.value, "text": text, "of_arm": shown.alert is not None and shown.alert.joint is None},
            "pills": {str(each.joint): joint_shown(each).pill.value for each in health.joints},
        }


def _has_words(key: str) -> bool:
    """Whether the values of a key have sentences for people."""
    return (
        key.startswith("alert/")
        or key in {"health", "info", "monitor", "replay", "from_production"}
        or key.endswith(("/friction", "/maintenance"))
    )
