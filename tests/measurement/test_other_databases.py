"""Databases of other formats than DBC describe the same messages; names, flags and multiplexers of DBC files."""

import pytest

from kennfeld.errors import InputError
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
