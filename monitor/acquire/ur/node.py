"""The node of the program that lends the arm, as the streaming process sees it: its output registers, and what is written into its inputs.

`monitor.acquire.ur.node_script` says what each register means.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

from monitor.acquire.ur.failures import StreamFailure
from monitor.acquire.ur.node_script import BEAT, DUE, ECHO, NUMBER_MAX, OFFER, OFFERED, STATE, TAKE, TAKEN
from monitor.errors import MotionRefused, RobotUnreachable
from monitor.reason import Sentence
from monitor.recording import Array

VARIABLES = tuple(f"output_int_register_{register}" for register in (ECHO, OFFER, STATE))  # to be received beside the rows
BEAT_S = 0.015  # between two beats while this process computes; the node waits for a beat for at least 0.12 s
NO_NUMBER = 0


NO_INPUT_REGISTERS = Sentence("no_input_registers", "{host}: RTDE input registers: {why}")
REGISTERS_IN_USE = Sentence(
    "registers_in_use",
    "another RTDE client holds the registers of the hand-over, input_int_register_{first} to {last}: another driver, a URCap, a fieldbus "
    "adapter, or a connection that has just ended. ur-rtde cannot tell which, and names fieldbuses alone: {why!r}",
)
REGISTERS_LOST = Sentence("registers_lost", "the RTDE connection of the input registers broke off: {why}")
REGISTERS_REFUSED = Sentence("registers_refused", "the controller takes no input registers")


class Node:
    """What the node says, and what it is told. The arm is `taken` from the node's word for it until it is given back."""

    def __init__(self, host: str, receive: RTDEReceiveInterface) -> None:
        """Open the connection that writes the registers, and forget what was written before.

        Raises MotionRefused where somebody else writes them; RobotUnreachable.
        """
        self._receive = receive
        self._lock = threading.Lock()  # ur-rtde's connection is for one thread at a time
        self._beat = time.monotonic_ns() % NUMBER_MAX  # other than what a process before this one has left
        self._echo, self._echo_at_s = -1, 0.0
        self.number = NO_NUMBER  # under which the arm was taken
        self.taken_q: Array = np.zeros(0)  # (J,) [rad] where it was taken, as the controller's target
        try:
            self._io = RTDEIOInterface(host)
        except RuntimeError as error:
            if "already in use" in str(error):
                raise MotionRefused(REGISTERS_IN_USE(first=TAKE, last=DUE, why=str(error))) from None
            raise RobotUnreachable(NO_INPUT_REGISTERS(host=host, why=str(error))) from None
        self._write(TAKE, NO_NUMBER)

    @property
    def state(self) -> int:
        """How far the node is: IDLE, OFFERED, TAKEN, LOST or ASTRAY."""
        return int(self._receive.getOutputIntRegister(STATE))

    @property
    def offered(self) -> int | None:
        """The number under which the arm is offered now; None while it is not."""
        return self._offer if self.state == OFFERED else None

    @property
    def taken(self) -> bool:
        """Whether the arm is ours, as the node says."""
        return self.number != NO_NUMBER and self.state == TAKEN and self._offer == self.number

    @property
    def _offer(self) -> int:
        return int(self._receive.getOutputIntRegister(OFFER))

    def say_due(self, due: bool) -> None:
        """Say whether the node shall offer the arm and wait."""
        self._write(DUE, int(due))

    def take(self, number: int) -> None:
        """Take the arm that is offered under this number."""
        self.number = number
        self._write(TAKE, number)

    def release(self) -> None:
        """Withdraw the number: the node ends the control loop, or does not begin it, and the program goes on if the arm is in its place."""
        self._write(TAKE, NO_NUMBER)

    def beat(self) -> None:
        """Say once more that the arm is watched."""
        with self._lock:
            self._beat = self._beat % NUMBER_MAX + 1
            self._set(BEAT, self._beat)

    @contextmanager
    def beating(self) -> Iterator[None]:
        """Beat from a thread while this process computes or waits for one answer. Only for an arm that stands."""
        over = threading.Event()

        def beats() -> None:
            while not over.wait(BEAT_S):
                try:
                    self.beat()
                except StreamFailure:
                    return  # the cycle finds out by itself

        thread = threading.Thread(target=beats, name="beats", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def silent_s(self, now_s: float) -> float:
        """For how long, on the caller's clock, the guard of the node has repeated no new beat: without it nothing stops a lost arm."""
        echo = int(self._receive.getOutputIntRegister(ECHO))
        if echo != self._echo:
            self._echo, self._echo_at_s = echo, now_s
        return now_s - self._echo_at_s

    def _write(self, register: int, value: int) -> None:
        with self._lock:
            self._set(register, value)

    def _set(self, register: int, value: int) -> None:
        try:
            written = self._io.setInputIntRegister(register, value)
        except RuntimeError as error:
            raise StreamFailure("connection_lost", REGISTERS_LOST(why=str(error))) from None
        if not written:
            raise StreamFailure("connection_lost", REGISTERS_REFUSED())
