"""What the commands `status`, `alerts`, `history` and `check` print about one arm, and what is listened to in ordinary work."""

import time
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, tzinfo
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from monitor.identify.document import NINETY
from monitor.judge.alerts.remaining_life import assumptions
from monitor.judge.alerts.states import unseen_steps
from monitor.publish.documents import Alert, Health, HistoryRow, JointFrictionAt, read
from monitor.publish.shown import arm_shown
from monitor.publish.timestamps import unix_s
from monitor.reason import ENGLISH, Reason, Words, joint_name, joint_text, reason_at, reason_from
from monitor.views.alert_sentence import JointPast, sentences
from monitor.views.history import PERCENT_PER_MONTH
from monitor.views.terminal.figures import STATE_STYLE, TIER_STYLE, local_times, number, pair, remaining_life, standard_output, table_of
from monitor.views.terminal.watch import known_temperatures

COMPENSATION_WIDTH = 90  # characters
NEWEST = 3  # stops that are printed


def print_compensation(rows: Sequence[JointFrictionAt]) -> None:
    """The friction terms of each joint at one temperature, one line a joint."""
    table = table_of(("joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear [%]", ""), left=("",))
    for row in rows:
        table.add_row(
            str(row.joint),
            f"{row.temperature_c:.1f}",
            pair(row.coulomb_nm, row.coulomb_std_nm),
            pair(row.viscous_nm_s_per_rad, row.viscous_std_nm_s_per_rad),
            f"{100 * row.wear:+.1f} ± {100 * row.wear_std:.1f}",
            "extrapolated" if row.extrapolated else "",
        )
    standard_output(width=COMPENSATION_WIDTH).print(table)


def inspection_lines(found: Mapping[str, Any] | None) -> list[str]:
    """Operating hours, stops and checks, as lines; none where [inspection] asks for nothing."""
    if not found:
        return []
    if found["counted_since"] is None:
        lines = ["operating hours and stops: the arm was not heard yet"]
    else:
        lines = [
            f"operating hours {found['operating_h']:.1f} h; since {found['counted_since'][:10]} heard {found['heard_h']:.1f} h, "
            f"on {found['on_h']:.1f} h, in motion {found['moving_h']:.1f} h",
            f"stops of the safety system: {found['stops']}, in the last 28 days {found['stops_28_days']}",
        ]
    lines += [f"  {stop['at']}  {stop_words(stop)}" for stop in found["last_stops"][:NEWEST]]
    return [*lines, *(f"check {_item(item)}" for item in found["items"])]


def stop_words(stop: Mapping[str, Any]) -> str:
    """A stop in words: its kind, and what the controller told."""
    told = [joint_text(stop["joint"])] if stop["joint"] is not None else []
    told += [stop["code"]] if stop["code"] else []
    told += ["during a replay"] if stop["during_replay"] else []
    told += ["it stands"] if stop["ended_at"] is None else []
    return f"{stop['kind'].replace('_', ' ')}{': ' if told else ''}{', '.join(told)}"


def _item(item: Mapping[str, Any]) -> str:
    """One check in words."""
    if item["state"] == "unrecorded":
        return f"{item['name']}: due, nobody has recorded when it was done last"
    since = f"; {item['stops_since']} stops since" if item["after_collision"] and item["stops_since"] else ""
    by = f" by {item['last_by']}" if item["last_by"] else ""
    last = f"last done {item['last_done'][:10]}{by}{since}"
    if item["due"] is None:
        return f"{item['name']}: {last}; its hours are not known yet"
    what = {"due": "DUE since", "soon": "due soon,", "done": "due"}[item["state"]]
    hours = "" if item["hours_left"] is None else f", {item['hours_left']:.0f} h left"
    return f"{item['name']}: {what} {item['due'][:10]}{hours}; {last}"


# --- What the command `listen` prints -------------------------------------------------------------------


def print_listened(document: dict[str, Any]) -> None:
    """Print what recordings of production tell: each file, friction of every joint, what was left out, and what they cannot tell."""
    console = standard_output(120)
    for file in document["files"]:
        size = f"{file['duration_s']:.0f} s at {number(file['rate_hz'], '.0f')} Hz, {file['counted_s']:.0f} s of motion counted"
        console.print(f"{escape(file['file'])}: {size}", highlight=False)
    seen = max(document["seen_s"], 1e-9)
    for cause, seconds in sorted(document["left_out_s"].items(), key=lambda each: -each[1]):
        console.print(f"  left out {100 * seconds / seen:.1f} %, {seconds:.0f} s: {document['causes'][cause]} ({cause})", highlight=False)
    speed = document["reference_speed_rad_s"]
    titles = ["joint", f"F({speed:g} rad/s), 90 % [Nm]", "replay [Nm]", "change", "T [°C]", "speed [rad/s]", "moved [s]", "held/needed"]
    table = table_of(titles)
    for joint, change, replay in zip(document["joints"], document["changes"], document["replay"]["friction_nm"], strict=True):
        known = joint["friction_nm"] is not None
        table.add_row(
            str(joint["joint"]),
            f"{joint['friction_nm']:.2f} ± {NINETY * joint['deviation_nm']:.2f}" if known else "–",
            number(replay, ".2f"),
            "–" if change["change"] is None else f"{100 * change['change']:+.1f} %{'' if change['clear'] else ' (not clear)'}",
            number(joint["temperature_c"], ".1f"),
            number(joint["speed_rad_s"], ".2f"),
            number(joint["moving_s"], ".0f"),
            number(joint["share"], ".2g"),
        )
    console.print(table)
    for reason in document["reasons"]:
        console.print(reason["text"], highlight=False, markup=False)
    for warning in document["warnings"]:
        console.print(f"[yellow]{warning['code']}[/]: {escape(warning['text'])}", highlight=False)


# --- What the commands `status`, `alerts`, `history` and `check` print about one arm --------------------


def print_alerts(alerts: list[dict[str, Any]], zone: tzinfo = UTC) -> None:
    """Print every alert: tier, time in the zone, text, advice, and who has acknowledged or shelved it."""
    console = standard_output(120)
    if not alerts:
        console.print("no alerts")
    for published, alert in zip(alerts, local_times(alerts, zone), strict=True):
        place = "arm" if alert["joint"] is None else f"j{alert['joint']}"
        state = alert["tier"] if alert["active"] else "cleared"
        since = alert["raised_at"] if alert["active"] else f"{alert['cleared_at']}, raised {alert['raised_at']}"
        console.print(f"[bold]{place}/{alert['condition']}[/] [{TIER_STYLE.get(state, 'white')}]{state}[/] since {since}")
        if alert["active"]:
            _print_leading(console, published, None, time.time())
        console.print(f"  {alert['text']}")
        if alert["active"]:  # a cleared one asks for nothing any more
            console.print(f"  do: {alert['action']}")
        if alert["acknowledged_at"]:
            why = f": {alert['acknowledged_why']}" if alert["acknowledged_why"] else ""
            console.print(f"  acknowledged by {alert['acknowledged_by']} at {alert['acknowledged_at']}{why}", markup=False)
        if alert["shelved_until"]:
            console.print(f"  shelved by {alert['shelved_by']} until {alert['shelved_until']}", markup=False)


def print_status(document: dict[str, Any], zone: tzinfo = UTC) -> None:
    """Print what `status` knows: health, friction of every joint, active alerts, the monitor's own state, the last windows.

    document : of `service.history.status.status_document`. zone : in which times are shown.
    """
    published, document = document, local_times(document, zone)
    console = standard_output(120, highlight=True)
    once = _Once(reason_at(row, "reason") for row in document["ledger"])
    health = document["health"]
    not_watched = document.get("not_watched")
    if not_watched:  # before anything that looks like a verdict of now
        console.print(f"[bold red]NOT WATCHED[/]: {escape(not_watched)}; what follows is of then", highlight=False)
    said = read(Health, published["health"]) if health else None
    shown = arm_shown(said)
    state = f"{shown.pill.value}{' then' if not_watched else ''}" if said else shown.why.text
    console.print(f"{document['robot']}: {state}, model {document['model_revision']}")
    if health and health.get("stale"):
        console.print(f"[yellow]{health['stale_why']}[/]", highlight=False)
    if document["friction"]:
        console.print(_friction_table(document["friction"], health["joints"] if health else [], of_then=bool(not_watched)))
        for note in (assumptions(document["friction"]), unseen_steps(document["friction"])):
            if note is not None:
                console.print(note.text, highlight=False)
    if document.get("compensation"):
        console.print(known_temperatures(document["compensation"]), highlight=False)
    for utc, alert in zip(_alerts(published), _alerts(document), strict=True):
        if alert.get("active"):
            rows = [row for row in published["friction"] if row["joint"] == alert["joint"]]
            _print_leading(console, utc, rows[0] if rows else None, unix_s(published["said_at"]))
            place = "arm" if alert["joint"] is None else f"j{alert['joint']}"
            console.print(f"  {place}/{alert['condition']}, {alert['tier']}: {_said(once, alert, 'text')}", highlight=False, markup=False)
    for line in from_production_lines(document.get("from_production")):
        console.print(f"  {line}", highlight=False, markup=False)
    for line in inspection_lines(document.get("inspection")):
        console.print(f"  {line}", highlight=False, markup=False)
    for act in document.get("maintenance", ()):
        console.print(f"  {act['text']}", highlight=False, markup=False)
    if document.get("prior"):
        console.print(f"  {document['prior']['text']}", highlight=False, markup=False)
    if document.get("monitor"):
        console.print(monitor_lines(document["monitor"], once), highlight=False, markup=False)
    for count, row in _grouped(document["ledger"]):
        times = "" if count == 1 else f" and {count - 1} before it"
        reason = f"  {_said(once, row, 'reason')}" if row["reason"] else ""
        console.print(f"  replay {row['replay']}  {row['window']}  {row['state']}{times}{reason}", highlight=False, markup=False)
        if row.get("borrowed"):
            console.print(f"    {borrowed_text(row['borrowed'])}", highlight=False, markup=False)
        for nth, each in enumerate(row.get("tries", []), start=1):
            console.print(f"    try {nth} ended {each['at']}: {each['reason']}", highlight=False, markup=False)


def from_production_lines(found: dict[str, Any] | None) -> list[str]:
    """What came from ordinary work, as lines; none where no work was judged."""
    if not found:
        return []
    shares = ", ".join(f"j{joint['joint']} {0.0 if joint['share'] is None else joint['share']:.2g}" for joint in found["joints"])
    lines = [f"ordinary work until {found['period_ended_at']}, {found['seen_s'] / 3600.0:.1f} h: held of what is needed: {shares}"]
    lines += [f"  {joint['reason']}" for joint in found["joints"] if joint["reason"]]
    if found["asks"]:
        lines.append(f"work alone has found wear of joints {', '.join(map(str, found['asks']))}: a replay shall confirm it")
    if found.get("suspects"):
        lines.append(f"work makes wear of joints {', '.join(map(str, found['suspects']))} likely: replays shall tell")
    following = found["next_replay"]
    if following["replay"] == "when_needed":
        lines.append(f"the next replay is needed from {following['needed_from'] or 'now'}: {following['why']}")
    return lines


def borrowed_text(borrowed: dict[str, Any]) -> str:
    """From which program a replay had its arm, and how long that program waited."""
    program = borrowed["program"] or "a program without a name"
    if not borrowed["given_back"]:
        return f"borrowed from {program}, not given back: the program has ended"
    return f"borrowed from {program}, which waited {borrowed['waited_s']:.1f} s"


class _Once(Words):
    """Says a window's reason as `as above` where it is the last one of them that was said, also within another sentence."""

    def __init__(self, reasons: Iterable[Reason | None]) -> None:
        self._reasons = [reason for reason in reasons if reason is not None]
        self._last: Reason | None = None  # another one between them, and `above` would mean that

    def say(self, reason: Reason, /) -> str:
        """The sentence, or that it stands above."""
        if reason not in self._reasons:
            return super().say(reason)
        again, self._last = reason == self._last, reason
        return "as above" if again else super().say(reason)


def _said(words: Words, document: Mapping[str, Any], key: str) -> str:
    reason = reason_at(document, key)
    return "" if reason is None else words.say(reason)


def _alerts(document: dict[str, Any]) -> list[dict[str, Any]]:
    """The alerts of a status document; before the first verdict those that came early."""
    alerts: list[dict[str, Any]] = document["health"]["alerts"] if document["health"] else document.get("early_alerts", [])
    return alerts


def _print_leading(console: Console, alert: Mapping[str, Any], friction: Mapping[str, Any] | None, now_unix_s: float) -> None:
    """Print the sentences that an alert leads with, as of now. friction : newest estimate of its joint, as `status` knows it."""
    known = None if friction is None else read(HistoryRow, friction)
    told = sentences(read(Alert, alert), JointPast(known, None, None if known is None else known.recorded_at.timestamp()), now_unix_s)
    console.print(Text.assemble((told.headline, "bold"), *(f" {more}" for more in (told.pace, told.due) if more)))


def _grouped(ledger: list[dict[str, Any]]) -> list[tuple[int, dict[str, Any]]]:
    """Windows in a row that ended alike for the same reason: how many, and the newest of them."""
    groups: list[tuple[int, dict[str, Any]]] = []
    for row in ledger:
        last = groups[-1] if groups else None
        alike = last is not None and row["reason"] and (row["state"], row["reason"]) == (last[1]["state"], last[1]["reason"])
        if last is not None and alike and not any(each.get("tries") or each.get("borrowed") for each in (row, last[1])):
            groups[-1] = (last[0] + 1, row)
        else:
            groups.append((1, row))
    return groups


def _friction_table(friction: list[dict[str, Any]], joints: list[dict[str, Any]], *, of_then: bool = False) -> Table:
    """The newest estimate of every joint. joints : of the health document, for their states; of_then : nobody watches now."""
    states = {joint["joint"]: joint["state"] for joint in joints}
    stale = {joint["joint"] for joint in joints if joint.get("stale")}
    table = table_of(
        ("joint", "state", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "wear [%]", "rate [%/month]", "remaining life"), left=("joint", "state")
    )
    for row in friction:
        state = states.get(row["joint"], "")
        table.add_row(
            f"{row['joint']} {joint_name(row['joint'])}",
            f"[{'dim' if of_then else STATE_STYLE.get(state, 'white')}]{state}{' STALE' if row['joint'] in stale else ''}",
            number(row.get("temperature_c"), ".1f"),
            f"{row['coulomb_nm']:.2f} ± {row['coulomb_std_nm']:.2f}",
            f"{row['viscous_nm_s_per_rad']:.2f} ± {row['viscous_std_nm_s_per_rad']:.2f}",
            f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
            f"{PERCENT_PER_MONTH * row['wear_rate_per_day']:+z.1f}",
            remaining_life(row.get("remaining_life")),
        )
    return table


def monitor_lines(document: dict[str, Any], words: Words = ENGLISH) -> str:
    """The newest `monitor` document as lines: the monitor's own state, its problems, the outcome of the last reload."""
    store = document["store"]
    free = "unknown" if store["free_bytes"] is None else f"{store['free_bytes'] / 1e9:.1f} GB"
    lines = [
        f"monitor {document['version']} at {document['said_at']}: next replay {document['next_replay_due'] or 'none'}; "
        f"backup {store['last_backup_at'] or 'none yet'}; {free} free"
    ]
    lag_s, lengths, process = document["lag_s"], document["bus"], document["process"]
    resident = f"{process['resident_bytes'] / 1e6:.0f} MB of memory, " if process["resident_bytes"] else ""
    lines.append(
        f"  up {document['uptime_s'] / 3600.0:.1f} h; {resident}{process['cpu_s']:.0f} s of processor; "
        f"{'' if lag_s is None else f'last window begun {lag_s:.0f} s after its opening; '}"
        f"bus: {', '.join(f'{count} {name.replace(chr(95), chr(32))}' for name, count in lengths.items())}"
    )
    if archive := store.get("archive"):
        since = f", the oldest since {archive['waiting_since']}" if archive["waiting"] else ""
        lines.append(f"  archive {archive['address']}: {archive['recordings']} recordings; {archive['waiting']} wait{since}")
    if due := document.get("due"):
        lines.append(f"  replay due since {due['since']} ({due['why']}), {words.say(reason_from(due))}")
    lines += [f"  since {problem['since']} {problem['name']}: {words.say(reason_from(problem))}" for problem in document["troubles"]]
    if document.get("reload"):
        reload = document["reload"]
        lines.append(f"  configuration {'reloaded' if reload['done'] else 'NOT reloaded'} at {reload['at']}: {reload['text']}")
    return "\n".join(lines)


def print_conditions(title: str, found: list[tuple[str, str, str]]) -> None:
    """Print every condition (name, status, text), and whether the arm may move."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for column in ("condition", "holds", "found"):
        table.add_column(column, overflow="fold", no_wrap=column != "found")
    style = {"ok": "green", "NO": "bold red", "not checked": "yellow"}
    for name, status, text in found:
        table.add_row(name, Text(status, style=style[status]), Text(text))
    standard_output(140, highlight=True).print(table)
    failed = [name for name, status, _ in found if status == "NO"]
    print(f"the arm may not move: {', '.join(failed)}" if failed else "the arm may move")  # noqa: T201


def print_bus(found: list[dict[str, Any]]) -> None:
    """Print how far each party gets on the bus, and what to do where it gets no answer."""
    console = standard_output(140)
    for row in found:
        outcome = "[green]ok[/]" if row["cause"] == "reached" else f"[bold yellow]{row['cause']}[/]"
        console.print(f"bus, {row['who']} at {escape(row['endpoint'])}: {outcome}: {escape(row['text'])}")


def print_gateway(found: dict[str, Any] | None) -> None:
    """Print how far each channel gets that tells people and other systems."""
    console = standard_output(140)
    for row in [] if found is None else found["findings"]:
        outcome = "[green]ok[/]" if row["ok"] else "[bold yellow]FAILED[/]"
        console.print(f"gateway, {row['channel']}: {row['step']}: {outcome}: {escape(row['text'])}")


def print_not_alerting(joint: int, reasons: Sequence[Mapping[str, Any]]) -> None:
    """Print the reasons why a joint (from 1) has no alert of a higher tier."""
    console = Console()
    console.print(f"{joint_text(joint)}: {'the highest tier stands' if not reasons else 'no further alert, for'}", highlight=False)
    for reason in reasons:
        console.print(f"  {reason['text']}", highlight=False, markup=False)


def print_history(rows: list[dict[str, Any]], left_out: int, zone: tzinfo = UTC) -> None:
    """Print the rows of the history with times in the zone, and how many earlier ones are left out."""
    rows = local_times(rows, zone)
    console = standard_output(120, highlight=True)
    if not rows:
        console.print("no replay has been assessed in that time")
        return
    table = table_of(
        ("recorded", "replay", "joint", "T [°C]", "fc [Nm]", "fv [Nm·s/rad]", "F at v*, T0 [Nm]", "wear [%]"), left=("recorded", "joint")
    )
    for row in rows:
        table.add_row(
            row["recorded_at"],
            str(row["replay"]),
            f"{row['joint']} {joint_name(row['joint'])}",
            number(row.get("temperature_c"), ".1f"),
            pair(row.get("coulomb_nm"), row.get("coulomb_std_nm")),
            pair(row.get("viscous_nm_s_per_rad"), row.get("viscous_std_nm_s_per_rad")),
            pair(row.get("reference_torque_nm"), row.get("reference_torque_std_nm")),
            f"{100 * row['wear']:+z.1f} ± {100 * row['wear_std']:.1f}",
        )
    console.print(table)
    if left_out:
        console.print(f"{left_out} earlier rows are left out: --limit, --from, --to, --joint", highlight=False)
