"""The prior that an arm takes from its plant: asked for before its first verdict, kept in its history, never another one afterwards.

So a verdict can be made again: what its joints began with is in its provenance, and all later ones began with the same. I/O.
"""

import dataclasses
import hashlib
import logging
from collections.abc import Callable
from typing import Any
from urllib.parse import quote

import orjson

from monitor.config.schema import Configuration
from monitor.errors import BadInput
from monitor.judge.document import plain
from monitor.judge.friction.prior import prior_from_document, prior_from_plain
from monitor.publish.documents import PriorTaken, read, worded
from monitor.publish.timestamps import utc
from monitor.reason import Reason, Sentence
from monitor.store.store import Store

log = logging.getLogger(__name__)

NOTE = "plant_prior"  # in the history
TAKEN, NO_ANSWER, REFUSED, WAITS, TOO_LATE = "taken", "no_answer", "refused", "waits", "too_late"
OF_PLANT = Sentence("prior_of_plant", "joints began with the prior of {arms} {model} of the plant, made {made_at} ({digest})")
OF_SITE = Sentence("prior_of_site", "joints began with the prior of {arms} {model} of the site {site}, made {made_at} ({digest})")
PLANT_SILENT = Sentence("prior_plant_silent", "no plant answers: without its prior joints begin with what holds for every arm")
PLANT_REFUSES = Sentence("prior_plant_refuses", "without the plant's prior joints begin with what holds for every arm: {why}")
ASKED_LATER = Sentence("prior_asked_later", "the plant is asked for a prior at the first replay")
HAD_VERDICTS = Sentence("prior_had_verdicts", "no prior of the plant was taken: the arm had verdicts before it was to ask for one")

Ask = Callable[[str], bytes | None]  # the plant's answer on a key; None: nobody answers. Raises BadInput with the text of a refusal


def with_prior(configuration: Configuration, store: Store) -> Configuration:
    """The settings with the prior that this history has taken from the plant, where they ask for one and it has."""
    noted = _noted(store) if configuration.prior_of_plant else None
    if noted is None or noted["said"]["state"] != TAKEN:
        return configuration
    drift = dataclasses.replace(configuration.assess.drift, prior=prior_from_plain(noted["prior"]))
    return dataclasses.replace(configuration, assess=dataclasses.replace(configuration.assess, drift=drift))


def asked(configuration: Configuration, store: Store, ask: Ask, now_unix_s: float) -> Configuration:
    """The settings with the plant's prior, if it answers with one that fits this arm; what it answered is noted in the history.

    To be called before a verdict, as long as there is none.
    """
    known = with_prior(configuration, store)
    if known.assess.drift.prior is not None:
        return known
    robot, prior = configuration.robot, None
    try:
        content = ask(f"prior/{robot.site}/{quote(robot.model, safe='')}")
        if content is not None:
            document, digest = orjson.loads(content), hashlib.sha256(content).hexdigest()[:16]
            speed, joints = configuration.assess.drift.reference_speed_rad_s, configuration.robot_description.joints
            prior = prior_from_document(document, robot.model, joints, speed, digest=digest)
            about = {name: document.get(name) for name in ("site", "made_at", "software")}
            about |= {"model": prior.model, "arms": prior.arms, "digest": digest}
            said = _said(TAKEN, (OF_PLANT if about["site"] is None else OF_SITE)(**about), at=utc(now_unix_s), **about)
        else:
            said = _said(NO_ANSWER, PLANT_SILENT(), at=utc(now_unix_s))
    except orjson.JSONDecodeError:
        prior, said = None, _said(REFUSED, PLANT_REFUSES(why="its answer is no JSON"), at=utc(now_unix_s))
    except BadInput as error:
        prior, said = None, _said(REFUSED, PLANT_REFUSES(why=error.reason), at=utc(now_unix_s))
    note = {"said": said.model_dump(mode="json"), "prior": None if prior is None else plain(prior)}
    store.notes.set(NOTE, orjson.dumps(note).decode())
    log.log(logging.INFO if prior is not None else logging.WARNING, "%s", said.text)
    return with_prior(configuration, store)


def prior_taken(configuration: Configuration, store: Store) -> PriorTaken | None:
    """Which prior of the plant the joints began with, or why with none; None where the configuration asks for none."""
    if not configuration.prior_of_plant:
        return None
    noted = _noted(store)
    if noted is not None:
        return read(PriorTaken, noted["said"])
    return _said(TOO_LATE, HAD_VERDICTS()) if store.assessments.state() is not None else _said(WAITS, ASKED_LATER())


def _said(state: str, why: Reason, **about: Any) -> PriorTaken:
    return read(PriorTaken, {"state": state, **worded(text=why), **about})


def _noted(store: Store) -> dict[str, Any] | None:
    note = store.notes.get(NOTE)
    found: dict[str, Any] | None = None if note is None else orjson.loads(note)
    return found
