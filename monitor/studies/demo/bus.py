"""The demo as a client of the bus: what it receives of the monitor's documents, and one torque query beside the truth."""

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from monitor.config.schema import Configuration
from monitor.identify.validate import errors_of
from monitor.publish.client import Client
from monitor.simulate.remote import Remote
from monitor.studies.figures import SLIDING_RAD_S

QUERY_AMBIENT_C = 20.0  # a room that no replay had, so that the joints' temperatures lie between those of the replays
QUERY_SAMPLES = 200  # along one pass of the excitation


@dataclass(slots=True)
class Received:
    """The newest document of each kind, as any subscriber receives it over Zenoh."""

    friction: dict[int, dict[str, Any]] = field(default_factory=dict)  # by joint, numbered from 1
    health: dict[str, Any] = field(default_factory=dict)
    alerts: dict[str, dict[str, Any]] = field(default_factory=dict)  # by key
    raised: list[tuple[str, str]] = field(default_factory=list)  # time by the daemon's clock, and key with tier
    live_samples: int = 0

    def take(self, key: str, document: dict[str, Any]) -> None:
        """Keep one document."""
        if key.endswith("/friction"):
            self.friction[int(key.split("/")[1])] = document
        elif key == "health":
            self.health = document
        elif key == "torque/live":
            self.live_samples += 1
        elif key.startswith("alert/"):
            before = self.alerts.get(key, {})
            self.alerts[key] = document
            if document.get("active") and (not before.get("active") or before.get("tier") != document.get("tier")):
                self.raised.append((str(document.get("updated_at") or document.get("raised_at")), f"{key} {document.get('tier')}"))

    @property
    def active_alerts(self) -> list[tuple[str, dict[str, Any]]]:
        """Alerts that are active now: key and document, in the order of arrival."""
        return [(key, alert) for key, alert in self.alerts.items() if alert.get("active")]


def receive(client: Client, received: Received, done: threading.Event) -> None:
    """Keep every document of the robot until `done` is set; a thread of its own runs this."""
    for message in client.watch("**", until=done.is_set):
        received.take(message.key, message.document)


def query_torque(client: Client, remote: Remote, configuration: Configuration) -> dict[str, Any]:
    """Query torque at temperatures that no replay had, and compare it with the simulated truth.

    Returns figures of every joint at one moment, and RMS of error and torque in motion along the excitation, all [N·m].
    """
    remote.advance(hours=14.0, ambient_c=QUERY_AMBIENT_C, duty=0.0)
    remote.advance(hours=0.6, ambient_c=QUERY_AMBIENT_C, duty=0.35)
    temperature_c = list(remote.truth()["motor_temperature_c"])
    t_s = np.linspace(0.0, configuration.excitation.pass_s, QUERY_SAMPLES, endpoint=False)
    q, qd, qdd = configuration.excitation.at(t_s)
    rows = {"q": q.tolist(), "qd": qd.tolist(), "qdd": qdd.tolist()}
    true_nm = np.array(remote.torque(rows["q"], rows["qd"], rows["qdd"]))
    predicted_nm = np.array(client.torque(**rows, temperature_c=[temperature_c]).torque_nm)
    moving = np.abs(qd) > SLIDING_RAD_S
    error_nm, size_nm = (errors_of(true_nm, one, moving).rms_nm for one in (predicted_nm, np.zeros_like(true_nm)))
    moment = int(np.argmax(np.min(np.abs(qd), axis=1)))  # at this moment the slowest joint is fastest: every joint moves
    answer = client.torque(q=q[moment].tolist(), qd=qd[moment].tolist(), qdd=qdd[moment].tolist(), temperature_c=temperature_c)
    return {
        "temperature_c": temperature_c,
        "predicted_nm": answer.torque_nm,
        "std_nm": answer.std_nm,
        "true_nm": true_nm[moment].tolist(),
        "friction_nm": answer.friction_nm,
        "rms_error_nm": error_nm.tolist(),
        "rms_torque_nm": size_nm.tolist(),
    }
