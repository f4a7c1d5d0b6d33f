"""The protocol of one replay: its states, and one table of transitions. Pure.

Two processes play a replay. The session holds the connection and moves the arm; its parent watches it, gives it orders, and ends it.
Each keeps a `State`, and both move theirs by the same events: what the session does, it says to its parent; what the parent orders, it
says to the session. A state has three parts:

    Phase    where the session is
    Program  which program has the arm, as far as it is known
    Order    what the parent has ordered

An event changes each part for which TRANSITIONS has it. Where the table has an event for other values of a part, and not for its present
one, the event is unexpected in this state.

    own program                                         a program that plays lends its arm
    START → CONNECT → READY ─GO→ CONTROL →              START → CONNECT → NODE ─ASKING, TAKEN→ READY ─GO→ CONTROL →
      APPROACH or WAY_BACK → SETTLE → PLAY → RETURN → SETTLE → FINISH → ENDED           (lent: FINISH ─GIVEN_BACK→ RETURNED → ENDED)

STOP brings the arm to rest where it is: SETTLE, then FINISH. BACK is for an arm that a program has lent: it comes to rest, goes back over
the way it came, and is given back. Once the session has ended, its parent finds out what became of the program, and then somebody looks
at the arm (`ending`).
"""

from enum import StrEnum
from typing import NamedTuple


class Phase(StrEnum):
    """Where the session is."""

    START = "start"  # its process begins
    CONNECT = "connect"
    NODE = "node"  # it waits for the node at which a program lends its arm
    READY = "ready"  # the arm is in order and at rest; it waits for GO, then proves its way to the start
    CONTROL = "control"  # it takes control: the arm stands
    APPROACH = "approach"  # to the start, straight
    WAY_BACK = "way_back"  # to the start, back along the trajectory
    SETTLE = "settle"  # it holds the last target until the arm is at rest
    PLAY = "play"
    RETURN = "return"  # from the end of the trajectory to where the arm stood
    FINISH = "finish"  # the arm is at rest: it ends its program, or gives the arm back
    RETURNED = "returned"  # the program has its arm back, and is watched going on
    ENDED = "ended"  # there is no session any more


class Program(StrEnum):
    """Which program has the arm."""

    NONE = "none"  # none of ours was sent
    OURS = "ours"  # ours may run
    OVER = "over"  # ours has ended
    UNKNOWN = "unknown"  # whether ours has ended is not known
    THEIRS = "theirs"  # another one plays, and has its arm
    ASKED = "asked"  # it was asked for its arm, and has not answered
    LENDS = "lends"  # it has lent its arm
    OFFERED = "offered"  # it was offered its arm back, and has not answered
    GOES_ON = "goes_on"  # it has its arm back
    LOST = "lost"  # it has ended without its arm
    LOST_UNSEEN = "lost_unseen"  # the same, or it has not ended: nobody has seen it


class Order(StrEnum):
    """What the parent has ordered last."""

    WAIT = "wait"
    WITHDRAWN = "withdrawn"  # to stop, before GO
    GO = "go"
    BACK = "back"  # to come to rest, and then to go back …
    COMING_BACK = "coming_back"  # … and it does
    STOP = "stop"  # to come to rest


class Event(StrEnum):
    """What moves a state. The values are the words in which both sides say it."""

    CONNECT = "connect"  # a phase begins: said by the session, as those that follow
    NODE = "node"
    READY = "ready"
    CONTROL = "control"
    APPROACH = "approach"
    WAY_BACK = "way_back"
    SETTLE = "settle"
    PLAY = "play"
    RETURN = "return"
    FINISH = "finish"
    ASKING = "asking"
    TAKEN = "taken"
    NOT_TAKEN = "not_taken"
    GIVING_BACK = "giving_back"
    GIVEN_BACK = "given_back"

    GO = "go"  # said by the parent
    BACK = "back"
    STOP = "stop"

    DONE = "done"  # the session's last word: the arm is back, and our program has ended
    STOPPED = "stopped"  # … it ended early, the arm stands, and no program of ours runs
    FAILED = "failed"  # … it ended early, and our program may run
    REFUSED = "refused"  # … nothing was moved: a condition does not hold
    UNREACHABLE = "unreachable"  # … nothing was moved: the controller does not answer
    DIED = "died"  # the session ended without a last word

    PLAYS = "plays"  # what the parent finds once the session has ended: the program that was asked plays
    PLAYS_NOT = "plays_not"
    PROGRAM_ENDED = "program_ended"  # no program of ours runs any more
    NOT_SHOWN = "not_shown"  # the controller does not show whether it does


P, G, R, E = Phase, Program, Order, Event
_LIVE = tuple(phase for phase in Phase if phase is not Phase.ENDED)
_UNMOVED = (P.START, P.CONNECT, P.NODE, P.READY, P.RETURNED)  # a refusal that comes later cannot mean that nothing was moved

Part = Phase | Program | Order
TRANSITIONS: dict[tuple[Part, Event], Part] = {
    # the session
    (P.START, E.CONNECT): P.CONNECT,
    (P.CONNECT, E.NODE): P.NODE,
    (P.CONNECT, E.READY): P.READY,
    (P.NODE, E.READY): P.READY,
    (P.NODE, E.FINISH): P.FINISH,  # refused once the arm was taken: it is given back
    **{(P.NODE, event): P.NODE for event in (E.ASKING, E.TAKEN, E.NOT_TAKEN)},
    (P.READY, E.FINISH): P.FINISH,
    (P.READY, E.GO): P.READY,
    (P.READY, E.CONTROL): P.CONTROL,
    (P.CONTROL, E.FINISH): P.FINISH,
    (P.CONTROL, E.APPROACH): P.APPROACH,
    (P.CONTROL, E.WAY_BACK): P.WAY_BACK,
    (P.CONTROL, E.SETTLE): P.SETTLE,  # stopped before the first motion
    (P.APPROACH, E.SETTLE): P.SETTLE,
    (P.WAY_BACK, E.SETTLE): P.SETTLE,
    (P.SETTLE, E.SETTLE): P.SETTLE,  # stopped while it settled
    (P.SETTLE, E.PLAY): P.PLAY,
    (P.SETTLE, E.WAY_BACK): P.WAY_BACK,  # after BACK
    (P.SETTLE, E.RETURN): P.RETURN,  # after the way back
    (P.SETTLE, E.FINISH): P.FINISH,
    (P.PLAY, E.SETTLE): P.SETTLE,
    (P.PLAY, E.RETURN): P.RETURN,
    (P.RETURN, E.SETTLE): P.SETTLE,
    (P.FINISH, E.GIVING_BACK): P.FINISH,
    (P.FINISH, E.GIVEN_BACK): P.RETURNED,
    **{(phase, event): P.ENDED for phase in (P.FINISH, P.RETURNED) for event in (E.DONE,)},
    **{(phase, event): P.ENDED for phase in _LIVE for event in (E.STOPPED, E.FAILED, E.DIED)},
    **{(phase, event): P.ENDED for phase in _UNMOVED for event in (E.REFUSED, E.UNREACHABLE)},
    **{(P.ENDED, event): P.ENDED for event in (E.PLAYS, E.PLAYS_NOT, E.PROGRAM_ENDED, E.NOT_SHOWN)},
    # our own program
    (G.NONE, E.READY): G.NONE,
    (G.NONE, E.GO): G.OURS,
    (G.OURS, E.CONTROL): G.OURS,
    (G.OURS, E.FINISH): G.OURS,
    **{(G.NONE, event): G.NONE for event in (E.STOPPED, E.FAILED, E.DIED, E.REFUSED, E.UNREACHABLE)},
    **{(G.OURS, event): G.NONE for event in (E.REFUSED, E.UNREACHABLE)},
    **{(G.OURS, event): G.OVER for event in (E.DONE, E.STOPPED, E.PROGRAM_ENDED)},
    **{(G.OURS, event): G.OURS for event in (E.FAILED, E.DIED)},
    (G.OURS, E.NOT_SHOWN): G.UNKNOWN,
    # a program that lends its arm
    (G.THEIRS, E.NODE): G.THEIRS,
    (G.THEIRS, E.ASKING): G.ASKED,
    (G.ASKED, E.NOT_TAKEN): G.THEIRS,
    (G.ASKED, E.TAKEN): G.LENDS,
    (G.LENDS, E.READY): G.LENDS,
    (G.LENDS, E.GO): G.LENDS,
    (G.LENDS, E.CONTROL): G.LENDS,
    (G.LENDS, E.FINISH): G.LENDS,
    (G.LENDS, E.GIVING_BACK): G.OFFERED,
    (G.OFFERED, E.GIVEN_BACK): G.GOES_ON,
    **{(G.THEIRS, event): G.THEIRS for event in (E.STOPPED, E.FAILED, E.DIED, E.REFUSED, E.UNREACHABLE)},
    **{(program, event): program for program in (G.ASKED, G.LENDS, G.OFFERED) for event in (E.FAILED, E.DIED)},
    **{(G.GOES_ON, event): G.GOES_ON for event in (E.DONE, E.STOPPED, E.FAILED, E.DIED, E.REFUSED, E.UNREACHABLE)},
    **{(program, E.PLAYS): G.GOES_ON for program in (G.ASKED, G.OFFERED)},
    **{(program, E.PLAYS_NOT): G.LENDS for program in (G.ASKED, G.OFFERED)},
    (G.LENDS, E.PROGRAM_ENDED): G.LOST,
    (G.LENDS, E.NOT_SHOWN): G.LOST_UNSEEN,
    # orders
    (R.WAIT, E.GO): R.GO,
    (R.WAIT, E.STOP): R.WITHDRAWN,
    (R.GO, E.STOP): R.STOP,
    (R.GO, E.BACK): R.BACK,
    (R.BACK, E.STOP): R.STOP,
    (R.COMING_BACK, E.STOP): R.STOP,
    (R.BACK, E.WAY_BACK): R.COMING_BACK,
    **{(order, E.WAY_BACK): order for order in (R.GO, R.COMING_BACK, R.STOP)},  # an order and what the session does may cross
    **{(order, E.CONTROL): order for order in (R.GO, R.BACK, R.STOP)},  # nothing moves without GO
}
_CONCERNS = {part: frozenset(event for of, event in TRANSITIONS if type(of) is part) for part in (Phase, Program, Order)}

MOTIONS = frozenset({P.APPROACH, P.WAY_BACK, P.PLAY, P.RETURN})  # the arm goes from one place to another
STREAMING = MOTIONS | {P.SETTLE}  # targets are sent: something comes from the session in every tick
ON_PATH = frozenset({P.PLAY, P.WAY_BACK})  # the arm is on its trajectory
KNOWN = frozenset({G.NONE, G.OVER, G.UNKNOWN, G.THEIRS, G.GOES_ON, G.LOST, G.LOST_UNSEEN})  # at an end: nothing is left to be found out


class Unexpected(Exception):
    """An event that the table does not have in this state."""


class State(NamedTuple):
    """Where a replay is."""

    phase: Phase
    program: Program
    order: Order

    @classmethod
    def at_start(cls, *, lent: bool) -> "State":
        """Before anything; `lent`: a program that plays lends its arm."""
        return cls(Phase.START, Program.THEIRS if lent else Program.NONE, Order.WAIT)

    def allows(self, event: Event) -> bool:
        """Whether the event may come in this state."""
        concerned = [part for part in self if event in _CONCERNS[type(part)]]
        return bool(concerned) and all((part, event) in TRANSITIONS for part in concerned)

    def after(self, event: Event) -> "State":
        """The state after an event. Raises Unexpected."""
        if not self.allows(event):
            raise Unexpected(f"{event} in the phase {self.phase.value!r} (program {self.program}, order {self.order})")
        phase, program, order = (TRANSITIONS.get((part, event), part) for part in self)
        assert isinstance(phase, Phase)
        assert isinstance(program, Program)
        assert isinstance(order, Order)
        return State(phase, program, order)

    @property
    def gone(self) -> bool:
        """GO was said: from then on a program of ours may move the arm."""
        return self.order not in {Order.WAIT, Order.WITHDRAWN}

    @property
    def must_rest(self) -> bool:
        """The arm must come to rest, along its path."""
        return self.order in {Order.WITHDRAWN, Order.STOP, Order.BACK}

    @property
    def brings_back(self) -> bool:
        """A lent arm was ordered back: no STOP stands against it."""
        return self.order in {Order.BACK, Order.COMING_BACK}

    @property
    def streams(self) -> bool:
        """Targets are sent: the session says something in every tick."""
        return self.phase in STREAMING

    @property
    def lent(self) -> bool:
        """A program has lent its arm, and has not said that it has it back."""
        return self.program in {Program.LENDS, Program.OFFERED, Program.LOST, Program.LOST_UNSEEN}

    @property
    def needs_its_session(self) -> bool:
        """The session must end by itself, because a program waits for it: killed, it would end that program too."""
        waits = self.program in {Program.THEIRS, Program.ASKED, Program.LENDS, Program.OFFERED, Program.GOES_ON}
        return waits and self.phase not in {Phase.START, Phase.CONNECT}

    @property
    def unanswered(self) -> bool:
        """Whether the program has its arm is not known: the session has not heard its answer."""
        return self.program in {Program.ASKED, Program.OFFERED}

    @property
    def may_run(self) -> bool:
        """A program with our commands may run."""
        return self.program in {Program.OURS, Program.LENDS}

    @property
    def moved(self) -> bool:
        """The arm may have been moved, or taken from a program and not given back."""
        return self.gone or self.lent

    @property
    def unknown(self) -> bool:
        """At an end: whether our program has ended is not known."""
        return self.program in {Program.UNKNOWN, Program.LOST_UNSEEN}

    @property
    def over(self) -> bool:
        """At an end: there is no session, and nothing left to be found out. Where `moved`, somebody looks at the arm."""
        return self.phase is Phase.ENDED and self.program in KNOWN
