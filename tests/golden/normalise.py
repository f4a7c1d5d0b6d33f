"""What differs from run to run or from machine to machine without meaning anything, and why; all else is compared byte for byte."""

import re
from pathlib import Path
from typing import NamedTuple


class Rule(NamedTuple):
    """What is replaced by what, and for which reason."""

    pattern: re.Pattern[str]
    by: str
    why: str


def _json(key: str, value: str = r'"(?:[^"\\]|\\.)*"|[-+0-9.eE]+|null') -> re.Pattern[str]:
    """A key of a JSON text with its value, however it is laid out."""
    return re.compile(rf'("{key}":\s*)(?:{value})')


_OBJECT = r"\{(?:[^{}]|\{[^{}]*\})*\}"

RULES = (
    Rule(_json("host", r'"(?!127\.)[^"]*"'), r'\1"<host>"', "name of this host; the address of the arm, 127.…, stays"),
    Rule(_json("boot_id"), r'\1"<boot>"', "another one after every boot"),
    Rule(_json("versions", _OBJECT), r'\1"<versions>"', "of Python and of libraries"),
    Rule(_json("programs", _OBJECT), r'\1"<programs>"', "versions of libraries, processor, threads"),
    Rule(_json("circumstances", _OBJECT), r'\1"<circumstances>"', "versions of libraries, processor, threads"),
    Rule(_json("sqlite"), r'\1"<version>"', "version of a library"),
    Rule(_json("uptime_s"), r'\1"<duration>"', "by the wall clock"),
    Rule(_json("up_s"), r'\1"<duration>"', "by the wall clock"),
    Rule(_json("process", _OBJECT), r'\1"<process>"', "memory, processor time and threads of the process"),
    Rule(_json("resident_mb"), r'\1"<memory>"', "of the process"),
    Rule(_json("free_bytes"), r'\1"<disk>"', "of this machine's disk"),
    Rule(_json("disk_free_gb"), r'\1"<disk>"', "of this machine's disk"),
    Rule(_json("disk_free_share"), r'\1"<disk>"', "of this machine's disk"),
    Rule(_json("history_bytes"), r'\1"<bytes>"', "depends on when SQLite writes its log back"),
    Rule(_json("history_mb"), r'\1"<bytes>"', "depends on when SQLite writes its log back"),
    Rule(_json("last_backup_at"), r'\1"<wall clock>"', "a backup is named by the host's own clock"),
    Rule(_json("workers", _OBJECT), r'\1"<ages>"', "by the wall clock"),
    Rule(_json("bus", r'\{"to_send":[^{}]*\}|\{"to_send"[^{}]*\}'), r'\1"<queues>"', "how far the sending thread has come"),
    Rule(re.compile(r'(<meta name="page-token" content=")[^"]*'), r"\1<token>", "drawn anew by every page server"),
    Rule(re.compile(r"^(joint_monitor_(?:disk_free|history|resident)_bytes\{.*\}) .*$", re.M), r"\1 <bytes>", "of this machine"),
    Rule(re.compile(r"^(joint_monitor_last_backup_timestamp_seconds\{.*\}) .*$", re.M), r"\1 <wall clock>", "by the host's own clock"),
    Rule(re.compile(r"^(joint_monitor_(?:documents|queries)_waiting\{.*\}) .*$", re.M), r"\1 <queue>", "how far a thread has come"),
    Rule(re.compile(r"backup history-\S+, [0-9.]+ MB"), "backup <wall clock>", "a backup is named by the host's own clock"),
    Rule(_json("took_s"), r'\1"<duration>"', "by the wall clock"),
    Rule(re.compile(r"as the arms are simulated; [0-9.]+ s"), "as the arms are simulated; <duration>", "the same in `reproduce`"),
    Rule(re.compile(r'(\["W?LS", "[0-9.]+ s", )"[0-9.]+ s"'), r'\1"<duration>"', "what a method costs, in `reproduce`"),
    Rule(re.compile(r'(time of WLS over that of LS", "paper": "2778", "ours": )"[0-9.]+"'), r'\1"<ratio>"', "of two durations"),
    Rule(re.compile(r"(time of WLS over that of LS\s*│ 2778\s*│).*"), r"\1 <ratio>", "of two durations"),
    Rule(re.compile(r"(page|metrics) on http://[^\s\",]+"), r"\1 on <address>", "a free port"),
    Rule(re.compile(r"backup \d{4}-[-\dT:]+Z; [0-9.]+ GB free"), "backup <wall clock>; <disk>", "the same in `status`"),
    Rule(re.compile(r"up [0-9.]+ h; [^│]{,250}?\s+dropped", re.S), "up <process and queues>", "the same in `status`, line breaks too"),
    Rule(_json("took_s"), r'\1"<duration>"', "by the wall clock"),
    Rule(re.compile(r"as the arms are simulated; [0-9.]+ s"), "as the arms are simulated; <duration>", "the same in `reproduce`"),
    Rule(re.compile(r'(\["W?LS", "[0-9.]+ s", )"[0-9.]+ s"'), r'\1"<duration>"', "what a method costs, in `reproduce`"),
    Rule(re.compile(r'(time of WLS over that of LS", "paper": "2778", "ours": )"[0-9.]+"'), r'\1"<ratio>"', "of two durations"),
    Rule(re.compile(r"(time of WLS over that of LS\s*│ 2778\s*│).*"), r"\1 <ratio>", "of two durations"),
    Rule(re.compile(r"(page|metrics) on http://[^\s\",]+"), r"\1 on <address>", "a free port"),
    Rule(re.compile(r"backup \d{4}-[-\dT:]+Z; [0-9.]+ GB free"), "backup <wall clock>; <disk>", "the same in `status`"),
    Rule(re.compile(r"up [0-9.]+ h; \d+ MB of memory, \d+ s of processor"), "up <process>", "the same in `status`"),
    Rule(re.compile(r"bus: \d+ to send, \d+ to answer"), "bus: <queues>", "the same in `status`"),
)


def normalised(text: str, places: dict[Path, str] | None = None) -> str:
    """The text without entries that differ without meaning; `places` are folders of this run, which are replaced by a name."""
    for place, name in (places or {}).items():
        text = text.replace(str(place), name)
    for rule in RULES:
        text = rule.pattern.sub(rule.by, text)
    return text
