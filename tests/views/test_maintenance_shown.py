"""Work on joints as people see it: marks of the charts, and the table of the report."""

from monitor.judge.alerts.life_cycle import SERVICED
from monitor.judge.drift.maintenance import OUTCOMES
from monitor.reason import with_reasons
from monitor.views.history import mark_text, marks
from monitor.views.language.catalogue import ENGLISH
from monitor.views.report.sections import maintenance_table

DAY_S = 86_400.0


def act(joint: int, kind: str, day: float, outcome: str | None) -> dict:
    """Work as the history holds it."""
    return {"joint": joint, "kind": kind, "at_unix_s": day * DAY_S, "outcome": outcome}


def test_production_is_a_mark_on_the_chart_of_its_joint_and_says_whether_friction_counts_anew():
    """Declared of the arm by `maintenance`, it is one mark of the arm, and one of each joint whose friction it moved."""
    arm = [act(joint, "maintenance", 9.0, "new_reference" if joint == 2 else "unchanged") for joint in range(1, 7)]
    found = marks([act(3, "replaced", 5.0, "new_joint"), act(2, "greased", 7.0, "still_worn"), *arm], ())
    assert [(mark.t / DAY_S, mark.joint, mark.text, mark.renews) for mark in found] == [
        (5.0, 3, "replaced", True),
        (7.0, 2, "greased", False),
        (9.0, None, "maintenance", False),
        (9.0, 2, "maintenance", True),
    ]


def test_a_transition_that_production_made_says_what_was_done():
    """Another transition says nothing of work, also where the alert had work before."""
    assert mark_text({"kind": "serviced", "serviced_kind": "greased"}) == "greased"
    assert mark_text({"kind": "cleared", "serviced_kind": "replaced", "reasons": {"cleared_why": SERVICED(act="").coded()}}) == "replaced"
    assert mark_text({"kind": "updated", "serviced_kind": "greased"}) is None
    assert mark_text({"kind": "raised"}) is None


def test_the_report_has_a_table_of_production_with_what_it_meant_and_who_took_it_back():
    """Text of people is text, never markup."""
    told = {"joint": 3, "kind": "greased", "at": "2026-05-02T08:00:00Z", "by": "Ada", "why": "<b>dark</b>", "undone_at": None}
    told |= with_reasons({}, meaning=OUTCOMES["new_reference"]())
    undone = {**told, "undone_at": "2026-05-03T08:00:00Z", "undone_by": "Bob"}
    html = "".join(maintenance_table({"maintenance": [told, undone]}, ENGLISH))
    assert "Friction counts from this level now." in html
    assert "Ada: &lt;b&gt;dark&lt;/b&gt;" in html
    assert "Taken back by Bob" in html
    assert maintenance_table({"maintenance": []}, ENGLISH) == []
