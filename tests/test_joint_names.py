"""The names of joints are those of PolyScope."""

from monitor.judge.alerts.states import FOR_DAYS, stale_reason
from monitor.reason import JOINT_NAMES, joint_name, joint_text


def test_the_names_are_those_that_polyscope_shows():
    """From the foot to the tool; a joint beyond the table keeps its number."""
    assert JOINT_NAMES == ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")
    assert [joint_name(joint) for joint in (1, 3, 6, 7)] == ["Base", "Elbow", "Wrist 3", "Joint 7"]
    assert joint_text(3) == "Elbow (joint 3)"
    assert joint_text(7) == "joint 7"


def test_stale_joints_are_told_by_name():
    """A person reads which joint it is without counting."""
    assert stale_reason([3, 4], 6, FOR_DAYS(days=8, limit=7)).text.startswith("STALE: Elbow, Wrist 1: nothing was learnt for 8 days")
