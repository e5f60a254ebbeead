"""CAN databases: what their statements say, and what is reported of damaged ones."""

from contextlib import suppress

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement.bus_messages import MultiplexCondition
from kennfeld.measurement.dbc import parse_database, read_database
from tests.measurement.bus_files import DBC


def message(name, text=DBC):
    return next(message for message in parse_database("a.dbc", text).messages if message.name == name)


def signal(name, text=DBC, of="Engine"):
    return next(signal for signal in message(of, text).signals if signal.name == name)


def test_a_signal_has_its_layout_scaling_unit_comment_and_texts():
    speed, state = signal("Speed"), signal("State")
    assert (speed.start, speed.length, speed.big_endian, speed.kind) == (0, 16, False, "u")
    assert (speed.factor, speed.offset, speed.unit, speed.comment) == (0.25, 0.0, "rpm", "Speed of the crankshaft")
    assert state.texts == ((0, "Off"), (1, "On"))
    assert (signal("Speed", of="Gearbox").big_endian, signal("Speed", of="Gearbox").kind) == (True, "i")


def test_the_highest_bit_marks_an_identifier_of_29_bits():
    assert (message("EEC1").identifier, message("EEC1").extended) == (0x0CF004FE, True)
    assert not message("Engine").extended


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ('BA_ "VFrameFormat" BO_ 2364540158 3;', True),
        ('BA_ "VFrameFormat" BO_ 2364540158 1;', False),
        ('BA_ "ProtocolType" "J1939";', True),
        ('BA_DEF_DEF_ "VFrameFormat" "J1939PG";', True),
        ("", False),
    ],
)
def test_a_message_is_one_of_j1939_by_its_format_or_by_the_protocol(attributes, expected):
    head = 'BO_ 2364540158 EEC1: 8 X\n SG_ n : 24|16@1+ (0.125,0) [0|0] "rpm" X\n'
    choices = 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    assert message("EEC1", head + choices + attributes).is_j1939 == expected


def test_floating_point_signals_are_declared_apart():
    text = 'BO_ 1 M: 8 X\n SG_ f : 0|32@1- (1,0) [0|0] "" X\nSIG_VALTYPE_ 1 f : 1;\n'
    assert signal("f", text, "M").kind == "f"


def test_multiplexed_signals_have_the_conditions_of_all_their_multiplexers():
    text = """BO_ 1 M: 8 X
 SG_ Mode M : 0|8@1+ (1,0) [0|0] "" X
 SG_ Sub m3M : 8|8@1+ (1,0) [0|0] "" X
 SG_ Deep m0 : 16|8@1+ (1,0) [0|0] "" X
SG_MUL_VAL_ 1 Sub Mode 3-3;
SG_MUL_VAL_ 1 Deep Sub 0-1, 5-7;
"""
    assert signal("Sub", text, "M").switches == (MultiplexCondition("Mode", ((3, 3),)),)
    assert signal("Deep", text, "M").switches == (
        MultiplexCondition("Sub", ((0, 1), (5, 7))),
        MultiplexCondition("Mode", ((3, 3),)),
    )


@pytest.mark.parametrize(
    ("statements", "switches"),
    [
        (["Deep Mode 1-2", "Deep Mode 5-5"], (MultiplexCondition("Mode", ((1, 2), (5, 5))),)),
        (["Deep Mode 1-2", "Deep Mode 1-2"], (MultiplexCondition("Mode", ((1, 2),)),)),
        (
            ["Sub Mode 3-3", "Deep Sub 0-1", "Deep Mode 3-3"],
            (MultiplexCondition("Sub", ((0, 1),)), MultiplexCondition("Mode", ((3, 3),))),
        ),
    ],
)
def test_several_statements_on_a_signal_are_all_taken(statements, switches):
    text = """BO_ 1 M: 8 X
 SG_ Mode M : 0|8@1+ (1,0) [0|0] "" X
 SG_ Sub m3M : 8|8@1+ (1,0) [0|0] "" X
 SG_ Deep m0 : 16|8@1+ (1,0) [0|0] "" X
"""
    text += "".join(f"SG_MUL_VAL_ 1 {statement};\n" for statement in statements)
    assert parse_database("a.dbc", text).findings == ()
    assert signal("Deep", text, "M").switches == switches


def test_conditions_that_form_a_cycle_skip_their_signals():
    text = """BO_ 1 M: 8 X
 SG_ A m1M : 0|8@1+ (1,0) [0|0] "" X
 SG_ B m1M : 8|8@1+ (1,0) [0|0] "" X
SG_MUL_VAL_ 1 A B 1-1;
SG_MUL_VAL_ 1 B A 1-1;
"""
    database = parse_database("a.dbc", text)
    assert database.messages[0].signals == ()
    assert "depends on a multiplexer that is missing" in str(database.findings[0])


@pytest.mark.parametrize(
    ("line", "remark"),
    [
        (' SG_ b : 0|0@1+ (1,0) [0|0] "" X', "signal b of message M has 0 bits; it is skipped"),
        (' SG_ b : 0|65@1+ (1,0) [0|0] "" X', "signal b of message M has 65 bits; it is skipped"),
        (' SG_ b : 60|8@1+ (1,0) [0|0] "" X', "signal b of message M lies outside its 8 bytes; it is skipped"),
        (' SG_ a : 8|8@1+ (1,0) [0|0] "" X', "duplicate signal a of message M; it is skipped"),
        (' SG_ b : 0|8@1+ (1e999,0) [0|0] "" X', "is not a signal of message M; it is skipped"),
        (" SG_ b : 0|8@", "is not a signal of message M; it is skipped"),
        (' SG_ b m1 : 0|8@1+ (1,0) [0|0] "" X', "depends on a multiplexer that is missing; it is skipped"),
        ("BO_ 1 N: 8 X", "message N has the identifier of M (line 1); it is skipped"),
        ("BO_ 600000000 N: 8 X", "message N has an identifier 600000000 that no frame can have; it is skipped"),
        ("BO_ x", "'BO_ x' is not a message; it is skipped with its signals"),
        ('VAL_ 1 a 0 "Off', "the text of VAL_ does not end; it is skipped"),
        (' SG_ b : 4|8@1+ (1,0) [0|0] "" X', "1 signal share bits with others of their message: M.b and a"),
    ],
)
def test_unusable_entries_are_skipped_and_reported_with_their_line(line, remark):
    database = parse_database("a.dbc", f'BO_ 1 M: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "" X\n{line}\n')
    assert remark in " ".join(map(str, database.findings))
    assert database.messages[0].signals[0].name == "a"
    assert all(finding.severity != "error" for finding in database.findings)


def test_a_statement_without_its_end_does_not_take_the_next_one():
    text = 'BO_ 1 M: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "" X\nVAL_ 1 a 0 "Off"\nVAL_ 1 a 1 "On" ;\n'
    assert signal("a", text, "M").texts == ((1, "On"),)


def test_many_problems_are_counted():
    text = 'BO_ 1 M: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "" X\n' + " SG_ broken\n" * 50
    findings = parse_database("a.dbc", text).findings
    assert str(findings[-1]) == "a.dbc: 30 more problems of the database"


@pytest.mark.parametrize("content", [b"", b"\0\1\2", b"BO_ \n", b"a,b\n1,2\n"])
def test_a_file_without_messages_is_an_error(tmp_path, content):
    path = tmp_path / "a.dbc"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"a\.dbc: describes no message of a bus"):
        read_database(path)


def test_a_database_cut_off_anywhere_is_read_as_far_as_it_goes():
    for end in range(0, len(DBC), 7):
        with suppress(InputError):
            parse_database("a.dbc", DBC[:end])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_are_read_in_the_encodings_of_tools(tmp_path, encoding):
    path = tmp_path / "a.dbc"
    path.write_text('BO_ 1 M: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "°C" X\n', encoding=encoding)
    assert read_database(path).messages[0].signals[0].unit == "°C"
