"""The demo's verdict: did the wear alert come for the right joint and for no other? As JSON, and as text."""

import os
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from monitor.reason import joint_name, joint_text
from monitor.studies.demo.bus import Received
from monitor.studies.demo.plan import DAYS, WEARING_JOINT, DemoState
from monitor.studies.demo.screen import percent, wear_percent

WEAR_TIERS = ("wear", "limit")  # an advisory alone is no finding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """What the demo ends with. `torque` is the document of `query_torque`."""

    state: DemoState
    received: Received
    torque: dict[str, Any]
    took_s: float

    @property
    def wear_alerts(self) -> list[dict[str, Any]]:
        """Active alerts of the wear tier or above."""
        return [alert for _, alert in self.received.active_alerts if alert["tier"] in WEAR_TIERS]

    @property
    def problems(self) -> list[str]:
        """Why the demo failed, in words; empty where it passed."""
        found = []
        if self.state.failed:
            found.append(f"{len(self.state.failed)} of {DAYS} replays were not assessed ({'; '.join(self.state.failed)})")
        alerts = {(alert["joint"], alert["condition"]) for alert in self.wear_alerts}
        if not any(joint == WEARING_JOINT for joint, _ in alerts):
            found.append(f"no wear alert for joint {WEARING_JOINT}")
        wrong = sorted(str(alert) for alert in alerts if alert[0] != WEARING_JOINT)
        if wrong:
            found.append(f"alerts for {', '.join(wrong)}")
        return found

    def as_document(self) -> dict[str, Any]:
        """What `demo --json` prints."""
        return {
            "passed": not self.problems,
            "days": DAYS,
            "live_replays": self.state.live_replays,
            "stepped_replays": self.state.stepped_replays,
            "not_live_days": [day + 1 for day in self.state.not_live],
            "problems": self.problems,
            "live_torque_samples": self.received.live_samples,
            "alerts": [{key: alert[key] for key in ("joint", "condition", "tier", "text")} for alert in self.wear_alerts],
            "raised": [{"at": at, "alert": which} for at, which in self.received.raised],
            "wear": [
                {"joint": j, "estimated": row["wear"], "std": row["wear_std"], "true": float(self.state.true_wear[j - 1])}
                for j, row in sorted(self.received.friction.items())
            ],
            "torque": self.torque,
            "took_s": round(self.took_s, 1),
        }

    def print(self, console: Console) -> None:
        """Print the torque query, when which alert was raised, the wear beside the truth, and the verdict."""
        state, received = self.state, self.received
        console.print(_torque_table(self.torque))
        for at, which in received.raised:
            console.print(f"  {at[:10]}  raised {which}", highlight=False)
        row = received.friction.get(WEARING_JOINT)
        if row:
            true = percent(state.true_wear[WEARING_JOINT - 1])
            console.print(f"{joint_text(WEARING_JOINT)} wore by {true} in truth; the monitor says {wear_percent(row)}")
        counts = f"{state.live_replays} replays over RTDE, {state.stepped_replays} stepped, {received.live_samples} live torque samples"
        console.print(f"{counts}, {self.took_s:.0f} s")
        for repeated in state.disturbed:
            console.print(f"live replay disturbed, this machine had other work to do: {repeated}", highlight=False)
        if state.not_live:
            days = ", ".join(str(day + 1) for day in state.not_live)
            text = f"this machine could not keep the live replay of day {days} in real time: the simulator stepped it instead"
            console.print(text, style="yellow", highlight=False)
        if self.problems:
            console.print(f"FAILED: {'; '.join(self.problems)}", style="bold red")
            if (busy := busy_text()) is not None:
                console.print(busy, style="bold red")
        else:
            console.print("the wear alert came for the right joint and for no other", style="green")


def busy_text() -> str | None:
    """How busy this machine is, where that may be the cause of a failure; else None."""
    load, processors = os.getloadavg()[0], os.cpu_count() or 1
    if load <= processors:
        return None
    return f"this machine is busy: {load:.1f} programs want its {processors} processors; try again with less beside the demo"


def _torque_table(torque: dict[str, Any]) -> Table:
    table = Table(title="one torque query over Zenoh at a temperature between those of the replays", title_justify="left")
    for title in ("joint", "T [°C]", "predicted [Nm]", "truth [Nm]", "of it friction [Nm]", "RMS error, in motion"):
        table.add_column(title, justify="left" if title == "joint" else "right")
    for j in range(6):
        table.add_row(
            f"{j + 1} {joint_name(j + 1)}",
            f"{torque['temperature_c'][j]:.1f}",
            f"{torque['predicted_nm'][j]:.2f} ± {torque['std_nm'][j]:.2f}",
            f"{torque['true_nm'][j]:.2f}",
            f"{torque['friction_nm'][j]:.2f}",
            f"{torque['rms_error_nm'][j]:.2f} Nm ({100 * torque['rms_error_nm'][j] / torque['rms_torque_nm'][j]:.1f} %)",
        )
    return table
