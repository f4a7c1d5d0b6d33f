"""The weekly and the monthly report: when each is due, and its message with the printed page attached. I/O through the outbox alone."""

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

from monitor.gateway.channel import Surroundings
from monitor.gateway.notify.plant_page import plant_page
from monitor.gateway.notify.routing import REPORT, Route
from monitor.gateway.notify.settings import NotifySettings, RecipientSettings, time_of_day
from monitor.gateway.notify.texts import Message, one_line
from monitor.gateway.outbox import Owed
from monitor.gateway.values import ArmState, Delivery
from monitor.views.language.catalogue import Language, full_day

N_ = str  # marks a text for the catalogue
TITLES = {
    "weekly": N_("Weekly report of {count} arms: {sick} need somebody"),
    "monthly": N_("Monthly report of {count} arms: {sick} need somebody"),
}


class Periods:
    """The reports of all recipients."""

    def __init__(self, settings: NotifySettings, ways: Sequence[Route], surroundings: Surroundings) -> None:
        self._settings, self._surroundings = settings, surroundings
        self._routes = [route for route in ways if route.recipient.reports]
        self._began_unix_s: float | None = None
        self._owed: set[str] = set()  # known to be in the outbox

    def owe(self, now_unix_s: float) -> None:
        """Owe the newest report of each period that has ended since there is a gateway. Raises StoreError."""
        if not self._routes:
            return
        outbox = self._surroundings.outbox
        if self._began_unix_s is None:
            self._began_unix_s = outbox.began_unix_s()
        new = []
        for address, recipient in self._routes:
            for period in recipient.reports:
                begin, end = last_period(period, self._settings, recipient, now_unix_s)
                key = f"{address}/report/{period}/{int(end)}"
                if end < self._began_unix_s or key in self._owed:
                    continue
                document = {"period": period, "from_unix_s": begin, "to_unix_s": end}
                new.append(Delivery(key=key, recipient=address, kind=REPORT, document=document, due_at_unix_s=end))
        outbox.owe("mail", new)
        self._owed |= {each.key for each in new}

    def message(self, name: str, owed: Owed, at_unix_s: float, say: Language, zone: ZoneInfo) -> Message:
        """The report as it is now: an arm's last words count, and the transitions of the period."""
        begin, end = float(owed.document["from_unix_s"]), float(owed.document["to_unix_s"])
        arms = list(self._surroundings.arms().values())
        changes = self._surroundings.transitions(begin, end)
        wishes = next(route.recipient for route in self._routes if route.address == owed.recipient)
        arms = [arm for arm in arms if _concerns(wishes, arm)]
        changes = [each for each in changes if wishes.concerns(each.arm.site, each.arm.robot, each.condition)]
        content = plant_page(arms, changes, begin, end, at_unix_s, say, zone, self._surroundings.link)
        subject = say.say(TITLES[str(owed.document["period"])], count=len(arms), sick=content.sick)
        period = f"{full_day(begin, say)} – {full_day(end, say)}"
        text = "\n\n".join([f"{subject}.", period, *content.lines, say.say("The page is attached; it can be printed.")]) + "\n"
        file_name = f"joint-monitor-{owed.document['period']}-{datetime.fromtimestamp(end, zone):%Y-%m-%d}.html"
        return Message(
            name=name,
            kind=REPORT,
            recipient=owed.recipient,
            subject=one_line(subject),
            text=text,
            made_at_unix_s=at_unix_s,
            attachments=((file_name, "html", content.html),),
        )


def last_period(period: str, settings: NotifySettings, recipient: RecipientSettings, now_unix_s: float) -> tuple[float, float]:
    """Begin and end of the newest week or month that has ended, in the recipient's time zone."""
    zone = settings.zone_of(recipient)
    at = time_of_day(settings.report_at, "report_at")
    today = datetime.fromtimestamp(now_unix_s, zone)
    day = today.date() - timedelta(days=today.weekday()) if period == "weekly" else today.date().replace(day=1)

    def before(each: Any) -> Any:
        return each - timedelta(days=7) if period == "weekly" else (each - timedelta(days=1)).replace(day=1)

    if datetime.combine(day, at, zone).timestamp() > now_unix_s:
        day = before(day)
    return datetime.combine(before(day), at, zone).timestamp(), datetime.combine(day, at, zone).timestamp()


def _concerns(recipient: RecipientSettings, arm: ArmState) -> bool:
    return recipient.concerns(arm.name.site, arm.name.robot, "") or any(
        recipient.concerns(arm.name.site, arm.name.robot, str(alert.get("condition"))) for alert in arm.alerts
    )
