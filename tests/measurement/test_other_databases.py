"""Databases of other formats than DBC describe the same messages; names, flags and multiplexers of DBC files."""

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import read
from kennfeld.measurement.dbc import parse_database, read_database

PLAIN = """VERSION ""
BU_: A
BO_ 500 Engine: 8 A
 SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" A
 SG_ Temp : 16|8@1+ (1,-40) [-40|215] "degC" A
 SG_ Torque : 31|16@0- (0.1,0) [0|100] "Nm" A
BO_ 2364540158 Far: 8 A
 SG_ Load : 0|8@1+ (0.4,0) [0|100] "%" A
"""
FIELDS = ("start", "length", "big_endian", "kind", "factor", "offset", "unit", "texts", "switches")


@pytest.mark.parametrize("kind", ["kcd", "arxml", "sym"])
def test_messages_are_those_of_the_dbc_file(tmp_path, kind):
    formats = pytest.importorskip("canmatrix.formats")
    pytest.importorskip("lxml")
    with (tmp_path / f"x.{kind}").open("wb") as file:
        cluster = formats.loads(PLAIN.encode(), import_type="dbc")
        formats.dump(next(iter(cluster.values())) if kind == "sym" else cluster, file, kind)
    own = {(m.identifier, m.extended): m for m in parse_database("x.dbc", PLAIN).messages}
    others = {(m.identifier, m.extended): m for m in read_database(tmp_path / f"x.{kind}").messages}
    assert own.keys() == others.keys()
    for key, message in own.items():
        signals = {signal.name: signal for signal in others[key].signals}
        for signal in message.signals:
            assert [getattr(signals[signal.name], f) for f in FIELDS] == [getattr(signal, f) for f in FIELDS]


@pytest.mark.parametrize("content", ["<AUTOSAR><x", "<NetworkDefinition>", "FormatVersion=6.0\n{SEND"])
def test_a_damaged_database_is_refused(tmp_path, content):
    pytest.importorskip("canmatrix")
    path = tmp_path / "x.arxml"
    path.write_text(content)
    with pytest.raises(InputError):
        read_database(path)


SYMBOLS = """FormatVersion=6.0 // Do not edit this line!
Title="Engine"

{ENUMS}
Enum=State(0="off", // first
  1="on")
Enum=Nothing()

{SIGNALS}
Sig=Speed unsigned 16 /u:rpm /f:0.25
Sig=Temp signed 8 -m /u:degC /o:-40
Sig=Load float /u:%
Sig=Mode State 2
Sig=Rest Nothing 6

{SENDRECEIVE}

[Engine]
ID=1F4h
Len=8
Sig=Speed 0
Sig=Temp 16
Sig=Load 32
Sig=Mode 24 // comment
Sig=Rest 26
"""


def test_signals_that_a_sym_file_defines_apart_from_its_messages_are_read(tmp_path):
    pytest.importorskip("canmatrix")
    path = tmp_path / "x.sym"
    path.write_text(SYMBOLS)
    database = read_database(path)
    [message] = database.messages
    layout = {s.name: (s.start, s.length, s.big_endian, s.kind, s.factor, s.offset, s.unit) for s in message.signals}
    assert layout == {
        "Speed": (0, 16, False, "u", 0.25, 0.0, "rpm"),
        "Temp": (23, 8, True, "i", 1.0, -40.0, "degC"),
        "Load": (32, 32, False, "f", 1.0, 0.0, "%"),
        "Mode": (24, 2, False, "u", 1.0, 0.0, ""),
        "Rest": (26, 6, False, "u", 1.0, 0.0, ""),
    }
    assert {s.name: s.texts for s in message.signals}["Mode"] == ((0, "off"), (1, "on"))
    assert not database.findings


def test_entries_of_a_database_that_the_library_skips_are_reported(tmp_path):
    pytest.importorskip("canmatrix")
    path = tmp_path / "x.sym"
    text = SYMBOLS.replace("ID=1F4h", "ID=1F4h-1F5h").replace("Sig=Rest 26", "Var=Other Unknown 26,6")
    path.write_text(text)
    [finding] = read_database(path).findings
    assert finding.severity == "warning"
    assert "2 parts of the database could not be read (a message of several identifiers" in finding.message


def test_a_switch_may_be_named_apart_from_its_signal():
    """An `m` without a number, as editors write it beside SG_MUL_VAL_."""
    text = PLAIN + "BO_ 7 M: 8 A\n" + ' SG_ Code m : 0|2@1+ (1,0) [0|3] "" A\n SG_ Gear m2 : 8|8@1+ (1,0) [0|9] "" A\n'
    database = parse_database("x.dbc", text + "SG_MUL_VAL_ 7 Gear Code 2-2;\n")
    signals = {signal.name: signal for message in database.messages for signal in message.signals}
    assert [switch.signal for switch in signals["Gear"].switches] == ["Code"]
    assert not signals["Code"].switches


LONG = 'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\n' + "".join(
    f'BA_ "System{kind}LongSymbol" {rest};\n'
    for kind, rest in (
        ("Message", 'BO_ 500 "EngineControlModule"'),
        ("Signal", 'SG_ 500 Mux "MultiplexerWithALongName"'),
        ("Signal", 'SG_ 500 Speed "SpeedOfTheCrankshaft"'),
    )
)
MUXED = """BO_ 500 Engine: 8 A
 SG_ Mux M : 0|8@1+ (1,0) [0|8000] "" A
 SG_ Inner M : 8|8@1+ (1,0) [0|8000] "" A
 SG_ Speed m3 : 16|16@1+ (0.25,0) [0|8000] "rpm" A
 SG_ Plain : 32|8@1+ (1,0) [0|8000] "" A
"""


def test_long_names_are_the_names(tmp_path):
    message = parse_database("x.dbc", MUXED + LONG).messages[0]
    assert message.name == "EngineControlModule"
    signals = {signal.name: signal for signal in message.signals}
    assert set(signals) == {"MultiplexerWithALongName", "Inner", "SpeedOfTheCrankshaft", "Plain"}
    assert signals["SpeedOfTheCrankshaft"].switches[0].signal == "MultiplexerWithALongName"
    (tmp_path / "x.dbc").write_text(MUXED + LONG)
    (tmp_path / "x.log").write_text("(0.0) can0 1F4#0300A00F00000000\n(0.1) can0 1F4#0300B00F00000000\n")
    pytest.importorskip("can")
    for name in ("SpeedOfTheCrankshaft", "Speed"):
        assert read(tmp_path / "x.log", [name], dbc=tmp_path / "x.dbc")[name].values.tolist() == [1000, 1004]


def test_extended_multiplexing_overrules_the_marks():
    text = MUXED + "SG_MUL_VAL_ 500 Inner Mux 2-2;\nSG_MUL_VAL_ 500 Speed Inner 7-9;\nSG_MUL_VAL_ 500 Plain Mux 4-4;\n"
    signals = {signal.name: signal for signal in parse_database("x.dbc", text).messages[0].signals}
    assert signals["Inner"].switches == (("Mux", ((2, 2),)),)
    assert signals["Speed"].switches == (("Inner", ((7, 9),)), ("Mux", ((2, 2),)))
    assert signals["Plain"].switches == (("Mux", ((4, 4),)),)
    assert signals["Mux"].switches == ()


def test_an_identifier_without_its_flag_is_extended_with_a_warning():
    database = parse_database("x.dbc", 'BO_ 103596083 X: 8 A\n SG_ LEFT : 0|8@1+ (1,0) [0|1] "" A\n')
    assert (database.messages[0].identifier, database.messages[0].extended) == (0x62CC033, True)
    assert database.findings[0].severity == "warning"
    assert "Write 2251079731" in database.findings[0].remedy
