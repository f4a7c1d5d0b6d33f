"""RTDE byte for byte. The expected bytes are written by hand from the description of the protocol."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.simulate.controller.controller import Controller
from monitor.simulate.settings import SimulateSettings
from monitor.simulate.wire.rtde import ProtocolError, RtdeSession
from monitor.simulate.wire.variables import output_variables

VERSION_REQUEST = bytes.fromhex("0005 56 0002")
COMMAND_RECIPE = bytes.fromhex("0018 49") + b"input_int_register_0,"


@pytest.fixture
def controller() -> Controller:
    return Controller(SimulateSettings())


def session_of(controller: Controller, connection: int) -> RtdeSession:
    return RtdeSession(controller, output_variables(controller), connection)


@pytest.fixture
def session(controller: Controller) -> RtdeSession:
    return session_of(controller, 1)


def test_protocol_version_2_is_accepted_and_1_is_not(session):
    """Request V."""
    assert session.feed(VERSION_REQUEST) == bytes.fromhex("0004 56 01")
    assert session.feed(bytes.fromhex("0005 56 0001")) == bytes.fromhex("0004 56 00")


def test_the_controllers_version_is_four_words(session):
    """Request v returns 3, 15, 8 and 106339."""
    assert session.feed(bytes.fromhex("0003 76")) == bytes.fromhex("0013 76 00000003 0000000f 00000008 00019f63")


def test_data_start_pause_and_the_first_packet(session, controller):
    """Requests O, S and P, and packet U: timestamp 1.0 after 125 control periods, robot mode 7."""
    request = bytes.fromhex("0020 4f 405f400000000000") + b"timestamp,robot_mode,"  # ur-rtde ends its lists with a comma
    assert session.feed(request) == bytes.fromhex("0010 4f 01") + b"DOUBLE,INT32"
    assert session.output(controller.clock.ticks, {}) is None  # not before START
    assert session.feed(bytes.fromhex("0003 53")) == bytes.fromhex("0004 53 01")
    for _ in range(125):
        controller.step()
    assert session.output(controller.clock.ticks, {}) == bytes.fromhex("0010 55 01 3ff0000000000000 00000007")
    assert session.feed(bytes.fromhex("0003 50")) == bytes.fromhex("0004 50 01")
    assert session.output(controller.clock.ticks, {}) is None


def test_an_unknown_output_is_not_found_and_start_is_refused(session):
    """The recipe is 0, and S is answered with 0."""
    reply = session.feed(bytes.fromhex("001a 4f 405f400000000000") + b"timestamp,nonse")
    assert reply == bytes.fromhex("0014 4f 00") + b"DOUBLE,NOT_FOUND"
    assert session.feed(bytes.fromhex("0003 53")) == bytes.fromhex("0004 53 00")


def test_an_input_recipe_and_a_value_before_start(session, controller):
    """U directly after I, as ur-rtde's RTDEIO does: register 0 becomes 11."""
    assert session.feed(COMMAND_RECIPE) == bytes.fromhex("0009 49 01") + b"INT32"
    assert session.feed(bytes.fromhex("0008 55 01 0000000b")) == b""
    assert controller.registers.inputs.ints[0] == 11


def test_a_register_has_one_owner_until_its_connection_ends(session, controller):
    """The second connection gets IN_USE and nothing is claimed. When the first has ended, the second gets the register."""
    other = session_of(controller, 2)
    session.feed(COMMAND_RECIPE)
    assert other.feed(COMMAND_RECIPE) == bytes.fromhex("000a 49 00") + b"IN_USE"
    other.feed(bytes.fromhex("0008 55 01 0000000b"))
    assert controller.registers.inputs.ints[0] == 0
    session.close()
    assert other.feed(COMMAND_RECIPE) == bytes.fromhex("0009 49 01") + b"INT32"


def test_recipes_count_per_connection_and_may_share_a_variable(session, controller):
    """Clients expect the numbers 1, 2, 3 … in the order of their requests."""
    session.feed(COMMAND_RECIPE)
    request = bytes.fromhex("002f 49") + b"input_int_register_0,input_double_register_0"
    assert session.feed(request) == bytes.fromhex("0010 49 02") + b"INT32,DOUBLE"
    session.feed(bytes.fromhex("0010 55 02 00000001 4000000000000000"))
    assert controller.registers.inputs.ints[0] == 1
    assert controller.registers.inputs.doubles[0] == 2.0


def test_odd_inputs_are_tolerated_and_counted(session, controller):
    """An unknown recipe is ignored, a short packet is filled with zeros, and surplus bytes are ignored."""
    session.feed(bytes.fromhex("0008 55 01 0000000b"))
    session.feed(COMMAND_RECIPE)
    session.feed(bytes.fromhex("0008 55 07 0000000b"))
    assert controller.registers.inputs.ints[0] == 0
    session.feed(bytes.fromhex("0006 55 01 0000"))
    session.feed(bytes.fromhex("000c 55 01 00000005 ffffffff"))
    assert controller.registers.inputs.ints[0] == 5
    assert controller.registers.odd_inputs == 4


def test_a_text_message_needs_no_answer(session):
    """Message M of level 3 from `me`: `hi`."""
    assert session.feed(bytes.fromhex("000a 4d 02") + b"hi" + bytes.fromhex("02") + b"me" + bytes.fromhex("03")) == b""


def test_packets_may_come_in_pieces_and_in_heaps(session):
    """The replies are the same if bytes arrive one at a time or all at once."""
    talk = VERSION_REQUEST + bytes.fromhex("0003 76") + COMMAND_RECIPE
    piecewise = b"".join(session.feed(bytes([byte])) for byte in talk)
    assert piecewise == session_of(Controller(SimulateSettings()), 1).feed(talk)


def test_the_rate_is_clamped_and_divides_the_tick(controller):
    """On a CB3, 500 Hz and NaN give every control period, 50 Hz every second one, and 0.001 Hz one packet a second."""
    for bits, expected in (("407f400000000000", 1), ("4049000000000000", 2), ("7ff8000000000000", 1), ("3f50624dd2f1a9fc", 125)):
        session = session_of(controller, 1)
        session.feed(bytes.fromhex("0014 4f") + bytes.fromhex(bits) + b"timestamp")
        session.feed(bytes.fromhex("0003 53"))
        assert sum(session.output(tick, {}) is not None for tick in range(250)) == 250 // expected


@given(junk=st.binary(max_size=400))
def test_junk_is_refused_or_ignored_but_never_crashes(junk):
    """Arbitrary bytes raise a ProtocolError at worst."""
    session = session_of(CONTROLLER, 9)
    try:
        session.feed(junk)
    except ProtocolError:
        pass
    finally:
        session.close()


CONTROLLER = Controller(SimulateSettings())
