"""What a trial prints: how to play with it, a line for each replay, a line for each change of an alert."""

from datetime import UTC, datetime
from typing import Any, Protocol

import typer

from monitor.config.schema import Configuration
from monitor.reason import joint_name
from monitor.service.run import Running
from monitor.studies.trial.plan import Trial


class Obstructed(Protocol):
    """The simulated arm, as far as this module needs it."""

    @property
    def obstacle(self) -> str:
        """Why it does not age; empty where it does."""
        ...


class Says:
    """Prints what is new since the last call. One thread calls it."""

    def __init__(self, configuration: Configuration, host: str, trial: Trial) -> None:
        self._configuration, self._host, self._trial = configuration, host, trial
        self._replay = self._event = 0
        self._obstacle = ""

    def line(self, text: str) -> None:
        """One line, at once."""
        typer.echo(text)

    def beginning(self) -> None:
        """What runs, and what a person can do with it from another terminal."""
        configuration, path = self._configuration, self._configuration.path
        day_s = 86_400.0 / self._trial.speed
        self.line(
            f"a simulated {configuration.robot.model}, scenario {self._trial.scenario}, {self._trial.speed:g} times as fast as life: "
            f"a day in {day_s:.1f} s, and the time of its replay"
        )
        self.line(
            "replays are stepped by the simulated arm, not driven over RTDE in real time; all that is judged and told is the daemon's own"
        )
        for what, command in (
            ("the status page", f"http://{configuration.page.listen}/"),
            ("what is known", f"joint-monitor status --config {path}"),
            ("alerts, and what they ask", f"joint-monitor alerts --config {path}"),
            ("somebody has seen one", f"joint-monitor ack --config {path} j3/wear_rising --by you"),
            ("a mechanic works on it", f"joint-monitor serviced --config {path} --joint 3 --replaced --by you --why worn"),
            ("something breaks", f"joint-monitor simulate --bind {self._host} --fault 'protective_stop'"),
        ):
            self.line(f"  {what:<26} {command}")
        self.line("Ctrl-C ends it\n")

    def news(self, service: Running, now_unix_s: float, arm: Obstructed) -> None:
        """Replays that have ended and alerts that have changed since the last call. Raises StoreError."""
        if arm.obstacle and arm.obstacle != self._obstacle:
            self.line(f"{_date(now_unix_s)}  the arm does not work: {arm.obstacle}")
        self._obstacle = arm.obstacle
        newest = service.store.ledger.rows(limit=5)
        for row in newest:
            if row.id > self._replay and row.ended_at_unix_s is not None:
                self._replay = row.id
                self.line(f"{_date(row.window_unix_s)}  {row.state}{f': {row.reason}' if row.reason else self._worst(service)}")
        for event in service.store.events.rows(after=self._event):
            self._event = event.seq
            self.line(f"{_date(event.at_unix_s)}  {_event(event.document)}")

    def end(self, *, kept: bool) -> None:
        """Where the history is, where it stays."""
        path = self._configuration.path
        if kept:
            self.line(f"the history stays: joint-monitor report --config {path} -o report.html")

    def _worst(self, service: Running) -> str:
        """The joint that has changed most, by the newest estimates."""
        rows = service.store.assessments.friction(limit=self._configuration.robot_description.joints)
        if not rows:
            return ""
        worst: dict[str, Any] = max(rows, key=lambda row: abs(row["wear"]))
        return f"  {joint_name(worst['joint'])} {100 * worst['wear']:+z.1f} ± {100 * worst['wear_std']:.1f} %"


def _event(document: dict[str, Any]) -> str:
    """One change of an alert as a line."""
    where = "arm" if document.get("joint") is None else f"j{document['joint']}"
    kind = str(document.get("event") or document.get("kind") or "changed")
    text = str(document.get("text")).split("; ")[0]  # `alerts` has the whole of it
    return f"ALERT {where}/{document.get('condition')} {document.get('tier')} {kind}: {text}"


def _date(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).strftime("%a %Y-%m-%d %H:%M")
