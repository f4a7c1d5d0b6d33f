"""The states of NAMUR NE 107 in the spelling of OPC UA."""

from typing import Literal, get_args

State = Literal["NORMAL", "CHECK_FUNCTION", "OFF_SPEC", "MAINTENANCE_REQUIRED", "FAILURE"]
STATES: tuple[State, ...] = get_args(State)  # in ascending order of precedence: the last one of several states wins
NORMAL: State = "NORMAL"
CHECK_FUNCTION: State = "CHECK_FUNCTION"  # the data are unreliable; the joint itself may be sound
OFF_SPEC: State = "OFF_SPEC"  # outside the temperatures learned so far
MAINTENANCE_REQUIRED: State = "MAINTENANCE_REQUIRED"
FAILURE: State = "FAILURE"  # the configured end of life is reached
