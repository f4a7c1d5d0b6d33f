"""The arms of a fleet, read from their histories. I/O."""

from collections.abc import Sequence
from pathlib import Path

from monitor.errors import BadInput, MonitorError
from monitor.recording import DAY_S
from monitor.service.history.assess_and_store import load_state
from monitor.store.backup import HISTORY
from monitor.store.store import Store
from monitor.studies.fleet_prior.learn import LearntArm


def arms_of(folders: Sequence[Path]) -> tuple[list[LearntArm], list[str]]:
    """The arms whose histories lie in the folders or in folders of these, and a sentence for each history that says nothing.

    Raises BadInput where a folder holds no history.
    """
    arms, silent = [], []
    for place in _histories(folders):
        try:
            with Store.reader(place) as store:
                belief = load_state(store).belief
        except MonitorError as error:
            silent.append(f"{place}: {error}")
            continue
        if belief is None:
            silent.append(f"{place}: nothing was assessed yet")
            continue
        days = (belief.at_unix_s - belief.began_at_unix_s) / DAY_S
        arms.append(LearntArm(str(place), belief.robot, belief.filter_state, days, belief.reference_speed_rad_s, int(belief.slot[0])))
    return arms, silent


def _histories(folders: Sequence[Path]) -> list[Path]:
    """The folders that hold a history, each once."""
    found: dict[Path, Path] = {}
    for folder in folders:
        own = [folder] if (folder / HISTORY).is_file() else sorted(path.parent for path in folder.glob(f"*/{HISTORY}"))
        if not own:
            raise BadInput(f"{folder}: holds no {HISTORY}, nor does a folder in it; expected a daemon's state folder, or one of many")
        found |= {place.resolve(): place for place in own}
    return list(found.values())
