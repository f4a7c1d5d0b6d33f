"""The section [notify], of an arm's file and of a plant's: who is told of alerts, by which way and when. No I/O, no clock."""

import re
from dataclasses import dataclass, field
from datetime import time as TimeOfDay  # noqa: N812 - `time` is the module elsewhere
from fnmatch import fnmatchcase
from typing import Annotated, Literal
from zoneinfo import ZoneInfo

from annotated_types import Interval

from monitor.acquire.schedule.times import time_zone
from monitor.errors import BadInput
from monitor.judge.alerts.health import TIERS
from monitor.views.language.catalogue import LANGUAGES
from monitor.views.web.settings import is_loopback

PLANT_SILENT = "plant_silent"  # the condition of the plant's own service
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
PERIODS = ("weekly", "monthly")
_ADDRESS = re.compile(r"[^@\s<>,;\"()]+@[^@\s<>,;\"()]+\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecipientSettings:
    """One table [[notify.to]]: a person, or a role of several people."""

    name: str  # e.g. "maintenance"; it is named in the status
    mail: tuple[str, ...] = ()  # addresses; each is a person
    webhook: str = ""  # https://…: receives signed JSON
    webhook_secret: str = field(default="", repr=False)  # the key of its signatures: "credential:NAME"
    apprise: str = field(default="", repr=False)  # an address as apprise has them, e.g. of a chat: "credential:NAME"
    sites: tuple[str, ...] = ("*",)  # patterns: "hall-*"
    robots: tuple[str, ...] = ("*",)  # patterns of SITE/ROBOT
    tiers: tuple[str, ...] = TIERS  # advisory, wear, limit; empty: no alerts
    conditions: tuple[str, ...] = ("*",)  # patterns, e.g. "wear_rising"
    cleared: bool = True  # whether the end of an alert is told as well
    quiet: str = ""  # "22:00-06:00": nothing then; it comes afterwards
    quiet_days: tuple[str, ...] = ()  # e.g. "sat", "sun"
    pierce: tuple[str, ...] = ("limit",)  # tiers that wait neither for the end of quiet hours nor for the digest
    digest_at: str = ""  # "07:00": one message a day; empty: at once
    digest_tiers: tuple[str, ...] = ("advisory",)  # that wait for it
    time_zone: str = ""  # empty: that of [notify]
    language: str = ""  # en or de; empty: that of [gateway]
    escalation: bool = False  # is told of alerts of tier wear and limit that nobody has acknowledged for escalate_days
    reports: tuple[str, ...] = ()  # weekly, monthly; by mail, with the printed page attached

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        here = f"notify.to: {self.name!r}:"
        if not re.fullmatch(r"[\w.+ -]{1,60}", self.name):
            raise BadInput(f"notify.to: name = {self.name!r}; expected up to 60 letters and digits")
        if not (self.mail or self.webhook or self.apprise):
            raise BadInput(f"{here} expected mail, webhook or apprise: there is no way to reach it")
        for key in ("sites", "robots", "conditions"):
            if not getattr(self, key):
                raise BadInput(f"{here} {key} = []: nothing would ever be told; leave it out for all of them")
        for each in self.mail:
            if not _ADDRESS.match(each):
                raise BadInput(f'{here} mail: {each!r} is no address; expected e.g. "ada@plant.example"')
        if self.webhook and not re.match(r"https?://[^\s/]+", self.webhook):
            raise BadInput(f"{here} webhook: expected https://…")
        if self.webhook and not self.webhook_secret:
            raise BadInput(f'{here} webhook without webhook_secret: nobody could tell our messages; expected "credential:NAME"')
        for key, allowed in (("tiers", TIERS), ("pierce", TIERS), ("digest_tiers", TIERS), ("quiet_days", DAYS), ("reports", PERIODS)):
            for each in getattr(self, key):
                if each not in allowed:
                    raise BadInput(f"{here} {key}: {each!r}; expected of {', '.join(allowed)}")
        if not (self.tiers or self.escalation or self.reports):
            raise BadInput(f"{here} tiers = []: without escalation or reports nothing would ever be told; leave it out for all tiers")
        if len(set(self.quiet_days)) == len(DAYS):
            raise BadInput(f"{here} quiet_days: every day is quiet; nothing would ever be told")
        if self.reports and not self.mail:
            raise BadInput(f"{here} reports: go by mail; expected mail")
        if self.language and self.language not in LANGUAGES:
            raise BadInput(f"{here} language = {self.language!r}; expected {', '.join(LANGUAGES)}")
        self.quiet_hours()
        if self.digest_at:
            time_of_day(self.digest_at, f"{here} digest_at")
        if self.time_zone:
            time_zone(self.time_zone, f"{here} time_zone")

    def quiet_hours(self) -> tuple[TimeOfDay, TimeOfDay] | None:
        """Begin and end; None without any. Raises BadInput."""
        if not self.quiet:
            return None
        begin, sign, end = self.quiet.partition("-")
        here = f"notify.to: {self.name!r}: quiet"
        if not sign:
            raise BadInput(f'{here} = {self.quiet!r}; expected "22:00-06:00"')
        hours = time_of_day(begin.strip(), here), time_of_day(end.strip(), here)
        if hours[0] == hours[1]:
            raise BadInput(f"{here} = {self.quiet!r}: begins when it ends")
        return hours

    def concerns(self, site: str, robot: str, condition: str) -> bool:
        """Whether this arm and condition are theirs. The plant's own service is everybody's."""
        if condition == PLANT_SILENT:
            return any(fnmatchcase(condition, each) for each in self.conditions)
        return (
            any(fnmatchcase(site, each) for each in self.sites)
            and any(fnmatchcase(f"{site}/{robot}", each) for each in self.robots)
            and any(fnmatchcase(condition, each) for each in self.conditions)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class NotifySettings:
    """The section [notify]. Without a recipient nobody is told of anything."""

    smtp: str = ""  # HOST:PORT of the mail server, e.g. "smtp.plant.example:587"
    tls: Literal["starttls", "tls", "none"] = "starttls"  # starttls: from the first command on (587); tls: from the beginning (465)
    ca_file: str = ""  # PEM of an authority of yours, for mail server and webhooks; empty: those that the system believes
    user: str = ""
    password: str = field(default="", repr=False)  # "credential:NAME"
    sender: str = ""  # e.g. "joint-monitor@plant.example"
    time_zone: str = "UTC"  # of quiet hours, digests, reports and times in messages, e.g. "Europe/Berlin"
    gather_s: Annotated[float, Interval(ge=0.0, le=3600.0)] = 120.0  # what comes within this time is one message
    fleet_arms: Annotated[int, Interval(ge=2, le=1000)] = (
        3  # one condition in so many arms within fleet_hours has one cause: a message a day
    )
    fleet_hours: Annotated[float, Interval(ge=0.1, le=48.0)] = 6.0
    escalate_days: Annotated[float, Interval(ge=0.01, le=365.0)] = 3.0  # without an acknowledgement
    report_at: str = "07:00"  # of the weekly report on Mondays, of the monthly one on the first
    give_up_days: Annotated[float, Interval(ge=1.0, le=60.0)] = 14.0  # after which a message that nobody takes is given up
    to: tuple[RecipientSettings, ...] = ()

    def __post_init__(self) -> None:
        """Raises BadInput naming the key that is wrong."""
        time_zone(self.time_zone, "notify: time_zone")
        time_of_day(self.report_at, "notify: report_at")
        names = [each.name for each in self.to]
        if len(set(names)) != len(names):
            raise BadInput("notify.to: a name stands there twice")
        mails = any(each.mail for each in self.to)
        if mails and not self.smtp:
            raise BadInput('notify: mail, but no mail server; expected smtp = "HOST:PORT"')
        if self.smtp:
            host, _ = self.server()
            if self.tls == "none" and self.password and not is_loopback(host):
                raise BadInput('notify: tls = "none" with a password, which everybody on the way could read; expected starttls or tls')
        from email.utils import parseaddr  # most arms tell nobody

        if mails and not _ADDRESS.match(parseaddr(self.sender)[1]):
            raise BadInput(f'notify: sender = {self.sender!r}; expected an address, e.g. "joint-monitor@plant.example"')
        if bool(self.user) != bool(self.password):
            raise BadInput("notify: expected user and password together, or neither")
        if not (self.user + self.password).isascii():
            raise BadInput("notify: user or password hold letters that are not ASCII; mail servers are signed in to with ASCII alone")

    def server(self) -> tuple[str, int]:
        """Host and port of the mail server. Raises BadInput."""
        host, _, port = self.smtp.rpartition(":")
        if not host or not (port.isascii() and port.isdigit() and 0 < int(port) <= 65535):
            raise BadInput(f'notify: smtp = {self.smtp!r}; expected HOST:PORT, e.g. "smtp.plant.example:587"')
        return host.strip("[]"), int(port)

    def zone_of(self, recipient: RecipientSettings) -> ZoneInfo:
        """The time zone of a recipient."""
        return time_zone(recipient.time_zone or self.time_zone, "notify: time_zone")


def time_of_day(text: str, where: str) -> TimeOfDay:
    """Raises BadInput where it is none."""
    found = re.fullmatch(r"([01]\d|2[0-3]):([0-5]\d)", text)
    if found is None:
        raise BadInput(f'{where} = {text!r}; expected a time of day, e.g. "07:00"')
    return TimeOfDay(int(found[1]), int(found[2]))
