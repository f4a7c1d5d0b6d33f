"""Other settings for the past: the keys that a file names replace those with which each verdict was made; the others stay. I/O."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from monitor.config.files import find_prior
from monitor.config.schema import FlowSettings, assess_sections, section_classes
from monitor.config.sections import Mistake, nearest, of_key, of_section, read_section
from monitor.config.sources import Source
from monitor.errors import BadInput
from monitor.judge.assess import AssessSettings
from monitor.judge.document import plain
from monitor.judge.drift.settings import DriftSettings
from monitor.service.history.recompute import settings_from_document


def read_changes(path: Path) -> dict[str, Any]:
    """The keys of a TOML file that a verdict depends on, as `AssessSettings` has them; sections of other rooms are left out.

    Raises BadConfiguration that names every mistake with its key, and BadInput where the file names nothing that a verdict depends on.
    """
    source = Source.read(path)
    document, mistakes = source.document, source.mistakes
    sections = {**assess_sections(), "assess": FlowSettings}
    known = section_classes()
    mistakes += [of_section(name, f": unknown section{nearest(name, [*sections])}") for name in document if name not in known]
    changes: dict[str, Any] = {}
    drift = document.get("drift")
    prior = drift.pop("prior", None) if isinstance(drift, dict) else None  # it names a file, see `for_arm`
    for name, cls in sections.items():
        if name not in document:
            continue
        wrong: list[Mistake] = []
        read_section(name, cls, document[name], wrong)
        # whether values go together is seen with those of the history, and not with the defaults: `settings_with`
        mistakes += [mistake for mistake in wrong if len(mistake.key) > 1 or not isinstance(document[name], dict)]
        if isinstance(document[name], dict):
            changes |= document[name] if name == "assess" else {name: document[name]}
    if isinstance(prior, str):
        changes["drift"] = {**changes.get("drift", {}), "prior": str(path.absolute().parent / prior) if prior else ""}
    elif prior is not None:
        mistakes.append(of_key(("drift", "prior"), f"{prior!r}: expected the path of a file that `joint-monitor prior` has written"))
    source.refuse()
    if not any(changes.values()):
        raise BadInput(f"{path}: changes nothing that a verdict depends on; expected keys of {', '.join(f'[{name}]' for name in sections)}")
    return changes


def for_arm(changes: Mapping[str, Any], made_with: Mapping[str, Any]) -> dict[str, Any]:
    """The changes for one arm: a fleet's prior is that of its model, as the file holds it. made_with : of one of its verdicts.

    Raises BadInput where the file cannot be read, or holds no prior of this model.
    """
    drift = changes.get("drift", {})
    if "prior" not in drift:
        return dict(changes)
    speed = with_changes(made_with["settings"], changes)["drift"].get("reference_speed_rad_s", DriftSettings().reference_speed_rad_s)
    return {**changes, "drift": {**drift, "prior": plain(find_prior(drift["prior"], made_with["robot"], speed, Path()))}}


def with_changes(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The plain settings of a verdict with these keys replaced."""
    changed = dict(settings)
    for key, value in changes.items():
        before = changed.get(key)
        # a fleet's prior is replaced as a whole
        changed[key] = (
            with_changes(before, value) if key != "prior" and isinstance(value, Mapping) and isinstance(before, Mapping) else value
        )
    return changed


def settings_with(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> AssessSettings:
    """The settings of a verdict with these keys replaced. Raises BadInput where they do not go together."""
    try:
        made: AssessSettings = settings_from_document(AssessSettings, with_changes(settings, changes))
    except (BadInput, ValueError) as wrong:
        raise BadInput(f"the changed settings do not fit those of the history: {wrong}") from None
    return made
