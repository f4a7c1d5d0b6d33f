"""Input variables of the RTDE interface: values that last, and one owner a variable."""

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

REGISTERS = 48
FORMAT = {  # RTDE's type names as struct codes, big-endian
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
    """Neighbours in a packet that go to neighbouring registers; or one other variable, by its name."""

    kind: str  # "int", "double" or the variable's name
    at: int  # of the packet's values
    width: int
    register: int = 0  # the first


class Recipe(NamedTuple):
    """Variables of one packet, in order."""

    names: tuple[str, ...]
    layout: struct.Struct
    runs: tuple[Run, ...]


def recipe(names: Sequence[str], types: dict[str, str]) -> Recipe:
    """Layout of known names."""
    codes = [FORMAT[types[name]] for name in names]
    return Recipe(tuple(names), struct.Struct(">" + "".join(codes)), _runs(names, [int(code[:-1] or 1) for code in codes]))


def _runs(names: Sequence[str], widths: Sequence[int]) -> tuple[Run, ...]:
    runs: list[Run] = []
    at = 0
    for name, width in zip(names, widths, strict=True):
        kind, register, number = name[6:].partition("_register_")
        if not (name.startswith("input_") and register and kind in {"int", "double"}):
            runs.append(Run(name, at, width))
        elif runs and runs[-1].kind == kind and runs[-1].register + runs[-1].width == int(number):
            runs[-1] = runs[-1]._replace(width=runs[-1].width + 1)
        else:
            runs.append(Run(kind, at, 1, int(number)))
        at += width
    return tuple(runs)


class Inputs:
    """What clients wrote last, and which connection may write what."""

    def __init__(self, knows: Callable[[str], bool] = lambda _: True) -> None:
        """`knows`: whether the emulated version has an input of this name."""
        self._knows = knows
        self.ints = [0] * REGISTERS
        self.doubles = [0.0] * REGISTERS
        self.others: dict[str, float | tuple[float, ...]] = {}
        self._owner: dict[str, int] = {}
        self.changed = False  # something that is no register has been written

    def claim(self, names: Sequence[str], owner: int) -> list[str]:
        """Types of the names as the reply to I: `NOT_FOUND`, or `IN_USE` where another connection owns one; then nothing is taken."""
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

    def seize(self, names: Iterable[str], owner: int) -> None:
        """Take what is free, for somebody who is not there."""
        for name in names:
            self._owner.setdefault(name, owner)

    def release(self, owner: int) -> None:
        """The owner's connection ended."""
        self._owner = {name: who for name, who in self._owner.items() if who != owner}

    def write(self, written: Recipe, values: Sequence[float]) -> None:
        """Take over the values of one packet."""
        for kind, at, width, register in written.runs:
            if kind == "double":
                self.doubles[register : register + width] = values[at : at + width]
            elif kind == "int":
                self.ints[register : register + width] = [int(value) for value in values[at : at + width]]
            else:
                self.changed = True
                self.others[kind] = values[at] if width == 1 else tuple(values[at : at + width])


class Outputs:
    """Digital and analogue outputs as clients set them through the inputs: a mask says which, a value to what."""

    GROUPS = (("standard_digital_output", 0, 8), ("configurable_digital_output", 8, 8), ("tool_digital_output", 16, 2))

    def __init__(self) -> None:
        self.digital = 0  # bits 0–7 standard, 8–15 configurable, 16–17 tool
        self.analog = [0.0, 0.0]  # V or A, as `standard_analog_output_type` says
        self.analog_types = 0  # bits 2 and 3: whether each output gives V

    def take(self, written: Mapping[str, float | tuple[float, ...]]) -> None:
        """What was written last."""
        for name, at, count in self.GROUPS:
            mask, value = written.get(f"{name}_mask", 0), written.get(name, 0)
            bits = (int(mask) & ((1 << count) - 1)) << at  # type: ignore[arg-type]
            self.digital = (self.digital & ~bits) | ((int(value) << at) & bits)  # type: ignore[arg-type]
        mask, kind = written.get("standard_analog_output_mask", 0), written.get("standard_analog_output_type", 0)
        for i in (0, 1):
            if int(mask) >> i & 1:  # type: ignore[arg-type]
                share = written.get(f"standard_analog_output_{i}", 0.0)
                full = 10.0 if int(kind) >> i & 1 else 0.02  # type: ignore[arg-type]
                lowest = 0.0 if int(kind) >> i & 1 else 0.004  # type: ignore[arg-type]
                self.analog_types = self.analog_types & ~(4 << i) | (int(kind) >> i & 1) << (2 + i)  # type: ignore[arg-type]
                if isinstance(share, (int, float)) and 0.0 <= share <= 1.0:
                    self.analog[i] = lowest + share * (full - lowest)
