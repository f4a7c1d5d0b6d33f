"""Registers, inputs and outputs of a controller, as clients write and read them over RTDE."""

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

REGISTERS = 48  # of each type
FORMAT = {  # RTDE's type names as codes of `struct`
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "INT32": "i",
    "UINT32": "I",
    "UINT64": "Q",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
    "UINT8": "B",
    "BOOL": "?",
}
INPUT_TYPES = {
    **{f"input_int_register_{i}": "INT32" for i in range(REGISTERS)},
    **{f"input_double_register_{i}": "DOUBLE" for i in range(REGISTERS)},
    **{f"input_bit_register_{i}": "BOOL" for i in range(64, 128)},
    "input_bit_registers0_to_31": "UINT32",
    "input_bit_registers32_to_63": "UINT32",
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}


class Run(NamedTuple):
    """Neighbouring values of a packet that belong to neighbouring registers, or one variable that is no register."""

    kind: str  # "int", "double" or the name of the variable
    at: int  # index of the first value in the packet
    width: int
    register: int = 0  # the first register


class Recipe(NamedTuple):
    """The variables of one packet, in their order."""

    names: tuple[str, ...]
    layout: struct.Struct
    runs: tuple[Run, ...]


def width(kind: str) -> int:
    """How many numbers a variable of this RTDE type has."""
    return int(FORMAT[kind][:-1] or 1)


def recipe(names: Sequence[str], types: Mapping[str, str]) -> Recipe:
    """The recipe of these variables, whose RTDE types are given by name."""
    kinds = [types[name] for name in names]
    layout = struct.Struct(">" + "".join(FORMAT[kind] for kind in kinds))
    return Recipe(tuple(names), layout, _runs(names, [width(kind) for kind in kinds]))


def _runs(names: Sequence[str], widths: Sequence[int]) -> tuple[Run, ...]:
    runs: list[Run] = []
    at = 0
    for name, size in zip(names, widths, strict=True):
        kind, register, number = name.removeprefix("input_").partition("_register_")
        if not (name.startswith("input_") and register and kind in {"int", "double"}):
            runs.append(Run(name, at, size))
        elif runs and runs[-1].kind == kind and runs[-1].register + runs[-1].width == int(number):
            runs[-1] = runs[-1]._replace(width=runs[-1].width + 1)
        else:
            runs.append(Run(kind, at, 1, int(number)))
        at += size
    return tuple(runs)


Written = float | tuple[float, ...]  # the value of an input that is no register


class Inputs:
    """What clients wrote last, and which connection may write which variable."""

    def __init__(self, knows: Callable[[str], bool]) -> None:
        """`knows` tells whether the emulated version has an input of this name."""
        self._knows = knows
        self.ints = [0] * REGISTERS
        self.doubles = [0.0] * REGISTERS
        self.others: dict[str, Written] = {}
        self._owner: dict[str, int] = {}

    def claim(self, names: Sequence[str], owner: int) -> list[str]:
        """Claim variables for a connection. Returns their types.

        The type of an unknown variable is `NOT_FOUND`, that of a variable of another connection `IN_USE`; then nothing is claimed.
        """
        types = []
        for name in names:
            if name not in INPUT_TYPES or not self._knows(name):
                types.append("NOT_FOUND")
            elif self._owner.get(name, owner) != owner:
                types.append("IN_USE")
            else:
                types.append(INPUT_TYPES[name])
        if not {"NOT_FOUND", "IN_USE"} & set(types):
            self._owner.update(dict.fromkeys(names, owner))
        return types

    def occupy(self, names: Iterable[str], owner: int) -> None:
        """Give the variables that nobody owns to a connection that does not exist."""
        for name in names:
            self._owner.setdefault(name, owner)

    def release(self, owner: int) -> None:
        """Free the variables of a connection that ended."""
        self._owner = {name: who for name, who in self._owner.items() if who != owner}

    def write(self, written: Recipe, values: Sequence[float]) -> bool:
        """Store the values of one packet. Returns whether a variable that is no register was among them."""
        others = False
        for kind, at, size, register in written.runs:
            if kind == "double":
                self.doubles[register : register + size] = values[at : at + size]
            elif kind == "int":
                self.ints[register : register + size] = [int(value) for value in values[at : at + size]]
            else:
                others = True
                self.others[kind] = values[at] if size == 1 else tuple(values[at : at + size])
        return others

    def number(self, name: str, default: float = 0.0) -> float:
        """The value of an input that is one number; the default if nobody has written it."""
        value = self.others.get(name, default)
        return value if isinstance(value, (int, float)) else default


class Outputs:
    """Digital and analogue outputs. Clients set them through inputs: a mask selects outputs, a value says what they become."""

    GROUPS = (("standard_digital_output", 0, 8), ("configurable_digital_output", 8, 8), ("tool_digital_output", 16, 2))

    def __init__(self) -> None:
        self.digital = 0  # bits 0–7 standard, 8–15 configurable, 16–17 tool
        self.analog = [0.0, 0.0]  # [V] or [A], as `standard_analog_output_type` says
        self.analog_types = 0  # bits 2 and 3: whether output 0 and 1 give volts

    def update(self, inputs: Inputs) -> None:
        """Set the outputs that the clients selected."""
        for name, at, count in self.GROUPS:
            bits = (int(inputs.number(f"{name}_mask")) & ((1 << count) - 1)) << at
            self.digital = (self.digital & ~bits) | ((int(inputs.number(name)) << at) & bits)
        mask, kinds = int(inputs.number("standard_analog_output_mask")), int(inputs.number("standard_analog_output_type"))
        for i in (0, 1):
            if mask >> i & 1:
                volts = kinds >> i & 1
                lowest, highest = (0.0, 10.0) if volts else (0.004, 0.02)  # 0–10 V, 4–20 mA
                self.analog_types = self.analog_types & ~(4 << i) | volts << (2 + i)
                share = inputs.number(f"standard_analog_output_{i}")
                if 0.0 <= share <= 1.0:
                    self.analog[i] = lowest + share * (highest - lowest)


class Registers:
    """All registers, inputs and outputs of one controller."""

    def __init__(self, knows: Callable[[str], bool]) -> None:
        """`knows` tells whether the emulated version has an input of this name."""
        self.inputs = Inputs(knows)
        self.output_ints, self.output_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self.outputs = Outputs()
        self.digital_inputs = 0  # bits 0–7 standard, 8–15 configurable, 16–17 tool
        self.never_ready = False  # the control program's register never says that it takes a command
        self.odd_inputs = 0  # input packets with an unknown recipe or a wrong length

    def write(self, written: Recipe, values: Sequence[float]) -> bool:
        """Store the values of one packet of inputs. Returns whether the speed slider or an output may have changed."""
        changed = self.inputs.write(written, values)
        if changed:
            self.outputs.update(self.inputs)
        return changed

    @property
    def speed_fraction(self) -> float:
        """What the speed slider is set to, 0 … 1."""
        fraction = self.inputs.number("speed_slider_fraction", 1.0) if self.inputs.others.get("speed_slider_mask") else 1.0
        return min(max(float(fraction), 0.0), 1.0) if math.isfinite(fraction) else 1.0
