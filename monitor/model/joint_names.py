"""The names of joints as PolyScope shows them, so that a person opens the right joint. This table is the only one."""

NAMES = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")  # of Universal Robots' arms, joints 1 to 6


def joint_name(joint: int) -> str:
    """The name of a joint (from 1), e.g. Elbow; "Joint 7" beyond the table."""
    return NAMES[joint - 1] if 1 <= joint <= len(NAMES) else f"Joint {joint}"


def joint_text(joint: int) -> str:
    """The name of a joint (from 1) with its number, by which commands address it, e.g. "Elbow (joint 3)"."""
    return f"{joint_name(joint)} (joint {joint})" if 1 <= joint <= len(NAMES) else f"joint {joint}"
