"""Bus logs decoded by databases: signals, their names, buses, multiplexers, and what is not described."""

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.measurement import describe, read
from kennfeld.measurement.bus_databases import to_databases
from tests.measurement.bus_files import DBC, Frame, drive, eec1, engine, write_log, write_mf4


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "engine.dbc"
    path.write_text(DBC)
    return path


@pytest.fixture
def log(tmp_path):
    return lambda frames, **settings: write_mf4(tmp_path / "drive.mf4", frames, **settings)


def remarks(description):
    return [str(finding) for table in description.tables for finding in table.findings]


def test_a_log_without_a_database_is_named_with_the_remedy(log):
    path = log(drive())
    for work in (read, describe):
        with pytest.raises(InputError) as caught:
            work(path)
        message = str(caught.value)
        frames = "30 CAN frames of 2 identifiers on CAN1 (0x1F4, 0x1F5)"
        assert message.startswith(f"drive.mf4: this is a bus log: it holds {frames}, no values of signals. Name its")
        assert 'dbc = ["engine.dbc"] in the [[dataset]]' in message
        assert "kennfeld info --dbc engine.dbc" in message


def test_signals_are_channels_in_physical_units(log, database):
    data = read(log(drive()), ["Temp"], dbc=[database])
    assert data["Temp"].values.tolist() == [80.0] * 20
    assert data["Temp"].unit == "degC"
    assert np.allclose(data.time, 0.01 * np.arange(20))


def test_messages_are_rasters_of_one_recording(log, database):
    path = log(drive())
    with pytest.raises(InputError, match=r"the channels have different rasters: Temp every 0.01 s"):
        read(path, ["Temp", "Gear"], dbc=database)
    data = read(path, ["Engine.Speed", "Gearbox.Speed"], raster=0.02, dbc=database)
    assert np.allclose(data.time[:2], [0.01, 0.03])
    assert np.allclose(data["Engine.Speed"].values[:2], [1010.0, 1030.0])
    assert np.allclose(data["Gearbox.Speed"].values[:2], [-495.5, -485.5])


def test_equal_names_of_messages_are_distinguished(log, database):
    path = log(drive())
    assert [c.name for table in describe(path, database).tables for c in table.channels if "Speed" in c.name] == [
        "Engine.Speed",
        "Gearbox.Speed",
    ]
    with pytest.raises(InputError, match=r"2 channels are named Speed. Name one of them: Engine.Speed, Gearbox.Speed"):
        read(path, ["Speed"], dbc=database)
    assert read(path, ["Engine.Temp"], dbc=database)["Engine.Temp"].values[0] == 80.0


def test_enumerations_are_numbers_whose_texts_are_described(log, database):
    (state,) = (c for c in describe(log(drive()), database).tables[0].channels if c.name == "State")
    assert (state.minimum, state.description) == (1.0, "0 = Off, 1 = On")


def test_multiplexed_signals_have_the_frames_of_their_multiplexer(log, database):
    frames = [Frame(0.01 * k, 502, bytes([k % 2]) + (10 * k).to_bytes(2, "little")) for k in range(10)]
    path = log(frames)
    data = read(path, ["A"], dbc=database)
    assert data["A"].values.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert np.allclose(data.time, [0.0, 0.02, 0.04, 0.06, 0.08])
    assert [table.name for table in describe(path, database).tables] == [
        "Muxed",
        "Muxed (Mode = 0)",
        "Muxed (Mode = 1)",
    ]


def test_a_multiplexer_that_never_has_the_value_is_reported(log, database):
    path = log([Frame(0.01 * k, 502, bytes([7, 0, 0])) for k in range(3)])
    with pytest.raises(InputError, match="no frame holds A: their multiplexers never have the values for it"):
        read(path, ["A"], dbc=database)


def test_messages_of_j1939_are_matched_by_their_parameter_group(log, database):
    path = log([Frame(0.01 * k, 0x0CF00400, eec1(800 + k, 10), extended=True) for k in range(5)])
    assert read(path, ["EngineSpeed"], dbc=database)["EngineSpeed"].values.tolist() == [
        800.0,
        801.0,
        802.0,
        803.0,
        804.0,
    ]


def test_source_addresses_of_j1939_are_senders_of_their_own(log, database):
    frames = [Frame(0.01 * k, 0x0CF00400 + 3 * (k % 2), eec1(800 + k % 2, 10), extended=True) for k in range(6)]
    data = read(log(frames), ["EEC1@0x03.EngineSpeed"], dbc=database)
    assert data["EEC1@0x03.EngineSpeed"].values.tolist() == [801.0] * 3


def test_priorities_of_j1939_do_not_matter(log, database):
    frames = [Frame(0.01 * k, 0x0CF00400 | (k % 2) << 28, eec1(800 + k, 10), extended=True) for k in range(4)]
    assert read(log(frames), ["EngineSpeed"], dbc=database).samples == 4


def test_values_of_j1939_that_are_not_available_are_missing(log, database):
    frames = [Frame(0.0, 0x0CF00400, b"\xff" * 8, True), Frame(0.1, 0x0CF00400, eec1(800, 10), True)]
    values = read(log(frames), ["EngineSpeed"], dbc=database)["EngineSpeed"].values
    assert np.isnan(values).tolist() == [True, False]


def test_an_identifier_of_29_bits_is_not_that_of_11_bits(log, database):
    path = log([Frame(0.0, 500, engine(1000, 80), extended=True), *drive(4)])
    assert "0x000001F4 on CAN1 (1 frame)" in remarks(describe(path, database))[0]


def test_a_message_on_two_buses_is_two_messages(log, database):
    frames = [Frame(0.01 * k, 500, engine(1000 + k % 2, 80), bus=1 + k % 2) for k in range(6)]
    path = log(frames)
    assert read(path, ["CAN2/Engine.Temp"], dbc=database).samples == 3
    assert read(path, ["Temp"], dbc=[{"file": database, "bus": 2}]).samples == 3
    assert read(path, ["Temp"], dbc=f"{database}@1").samples == 3


def test_databases_that_describe_a_parameter_group_differently_are_reported(log, database, tmp_path):
    path = log([Frame(0.01 * k, 0x0CF00400, eec1(800, 10), extended=True) for k in range(3)])
    other = tmp_path / "other.dbc"
    other.write_text(DBC.replace("EngineSpeed", "ShaftSpeed"))
    assert not [text for text in remarks(describe(path, [database, database])) if "differently" in text]
    (warning,) = [text for text in remarks(describe(path, [database, other])) if "differently" in text]
    assert "0x0CF00400 is described differently by engine.dbc (EEC1), other.dbc (EEC1); engine.dbc is used" in warning


def test_a_database_of_another_bus_is_reported_with_both(log, database):
    path = log([Frame(0.01 * k, 500, engine(1000, 80)) for k in range(3)])
    with pytest.raises(
        InputError, match=r"described by engine\.dbc@CAN3; it holds 3 CAN frames of 1 identifier on CAN1 "
    ):
        read(path, dbc=f"{database}@3")


def test_databases_of_several_buses_are_kept_apart(log, database, tmp_path):
    other = tmp_path / "other.dbc"
    other.write_text('BO_ 500 Body: 8 X\n SG_ Light : 0|8@1+ (1,0) [0|0] "" X\n')
    path = log([Frame(0.01 * k, 500, engine(1000, 80), bus=1 + k % 2) for k in range(6)])
    data = read(path, ["Temp", "Light"], raster=0.02, dbc=[f"{database}@1", f"{other}@2"])
    assert data["Light"].values[0] == 160
    (warning,) = remarks(describe(path, [database, other]))[:1]
    assert warning.startswith("drive.mf4: 0x1F4 is described differently by engine.dbc (Engine), other.dbc (Body)")


def test_frames_of_lin_need_a_database_of_lin(log, tmp_path):
    database = tmp_path / "lin.dbc"
    database.write_text('BO_ 16 Seat: 8 X\n SG_ Place : 0|8@1+ (1,0) [0|0] "" X\n')
    path = log([Frame(0.1 * k, 16, bytes([k, 0])) for k in range(4)], event="LIN_Frame")
    with pytest.raises(InputError, match=r"none of its identifiers is described by lin.dbc; it holds 4 LIN frames"):
        read(path, dbc=database)
    for entry in ({"file": database, "network": "LIN"}, f"{database}@LIN"):
        assert read(path, ["Place"], dbc=entry)["Place"].values.tolist() == [0.0, 1.0, 2.0, 3.0]


def test_frames_that_are_too_short_lack_the_signal(log, database):
    frames = [Frame(0.0, 500, engine(1000, 80)), Frame(0.1, 500, engine(1000, 80)[:2])]
    data = read(log(frames), ["Speed", "Temp"], dbc=database)
    assert data["Speed"].values.tolist() == [1000.0, 1000.0]
    assert np.isnan(data["Temp"].values).tolist() == [False, True]


def test_messages_in_several_frames_are_not_decoded(log, database, tmp_path):
    long = tmp_path / "long.dbc"
    long.write_text('BO_ 600 Long: 20 X\n SG_ Far : 8|8@1+ (1,0) [0|0] "" X\n')
    path = log([*drive(4), Frame(0.05, 600, bytes(8))])
    messages = " ".join(remarks(describe(path, [database, long])))
    assert "messages of more than 8 bytes in several frames are not decoded: Long (0x258)" in messages


def test_frames_of_can_fd_hold_signals_beyond_8_bytes(log, tmp_path):
    database = tmp_path / "fd.dbc"
    database.write_text('BO_ 600 Long: 64 X\n SG_ Far : 480|16@1+ (1,0) [0|0] "" X\n')
    path = log([Frame(0.1 * k, 600, bytes(60) + bytes([k, 1, 0, 0])) for k in range(3)])
    assert read(path, ["Far"], dbc=database)["Far"].values.tolist() == [256.0, 257.0, 258.0]


def test_what_is_not_described_is_counted_and_named(log, database):
    path = log([*drive(4), Frame(0.05, 0x77, b"abc"), Frame(0.06, 0x77, b"abc")])
    (remark,) = remarks(describe(path, database))
    assert remark == (
        "drive.mf4: 1 of 3 identifiers (2 of 8 frames) is not described by the databases: 0x077 on CAN1 (2 frames)"
    )


def test_a_message_without_signals_describes_nothing(log, tmp_path):
    (tmp_path / "empty.dbc").write_text("BO_ 500 Engine: 8 X\n")
    with pytest.raises(InputError, match=r"none of its identifiers is described by empty.dbc"):
        read(log(drive(4)), dbc=tmp_path / "empty.dbc")


def test_a_signal_whose_message_was_not_recorded_is_explained(log, database):
    with pytest.raises(InputError, match=r"has no channel EngineSpeed. Its message EEC1 \(0x0CF004FE in engine.dbc\)"):
        read(log(drive(4)), ["EngineSpeed"], dbc=database)
    with pytest.raises(InputError, match=r"has no channel Tempo. Did you mean Temp\?"):
        read(log(drive(4)), ["Tempo"], dbc=database)


def test_a_missing_database_is_an_error(log, tmp_path, database):
    with pytest.raises(InputError, match=r"there is no such file. Did you mean engine.dbc\?"):
        read(log(drive(4)), dbc=tmp_path / "enigne.dbc")


def test_decoded_channels_beside_frames_stay(tmp_path, database):
    from asammdf import MDF, Signal

    path = write_mf4(tmp_path / "drive.mf4", drive())
    with MDF(path) as mdf:
        mdf.append([Signal(np.arange(5.0), 0.1 * np.arange(5), name="Brake")])
        mdf.save(tmp_path / "both.mf4", overwrite=True)
    both = tmp_path / "both.mf4"
    assert read(both)["Brake"].values.size == 5
    (remark,) = remarks(describe(both))
    assert remark.startswith("both.mf4: also holds 30 bus events, which are not decoded. Name its CAN database")
    assert {"Brake", "Temp"} <= {c.name for table in describe(both, database).tables for c in table.channels}
    assert read(both, ["Brake", "Temp"], raster=0.05, dbc=database)["Temp"].values[0] == 80.0


def test_channels_beside_frames_need_no_description_of_the_frames(tmp_path):
    from asammdf import MDF, Signal

    other = tmp_path / "other.dbc"
    other.write_text('BO_ 9 Other: 8 X\n SG_ Light : 0|8@1+ (1,0) [0|0] "" X\n')
    with MDF(write_mf4(tmp_path / "drive.mf4", drive())) as mdf:
        mdf.append([Signal(np.arange(5.0), 0.1 * np.arange(5), name="Brake")])
        mdf.save(tmp_path / "both.mf4", overwrite=True)
    assert read(tmp_path / "both.mf4", ["Brake"], dbc=other)["Brake"].values.size == 5
    with pytest.raises(InputError, match=r"has no channel Light. Its message Other"):
        read(tmp_path / "both.mf4", ["Light"], dbc=other)


def test_the_real_log_of_a_logger_is_named(real):
    with pytest.raises(
        InputError, match=r"this is a bus log: it holds 2010 CAN frames of 2 identifiers on CAN1 \(0x7BB, 0x7EC\)"
    ):
        read(real("mdf/css_17BD1DB7_00000170.MF4"))


@pytest.mark.parametrize("value", [{"bus": 1}, {"file": "a", "bus": 0}, {"file": "a", "network": "FlexRay"}, 3])
def test_databases_that_are_none_are_refused(value):
    with pytest.raises(ArgumentError, match="dbc="):
        to_databases([value])


TEXTS = """VERSION ""

BU_: ECU1

BO_ 256 Engine: 8 ECU1
 SG_ Temp : 0|8@1+ (0.5,-40) [0|0] "degC" ECU1
 SG_ Speed : 8|8@1+ (1,0) [0|0] "km/h" ECU1
 SG_ State : 16|2@1+ (1,0) [0|3] "" ECU1
 SG_ Flag : 18|1@1+ (1,0) [0|1] "" ECU1
 SG_ Gear : 24|8@1- (1,0) [0|0] "" ECU1

VAL_ 256 Temp 255 "SNA" 254 "Signal_Error" 0 "Cold" ;
VAL_ 256 Speed 255 "not available" 0 "Standstill" ;
VAL_ 256 State 0 "Off" 1 "On" 2 "Error" 3 "SNA" ;
VAL_ 256 Flag 0 "valid" 1 "invalid" ;
VAL_ 256 Gear -1 "Reverse" -128 "invalid" ;
"""


def test_named_values_stay_numbers_and_names_for_no_value_are_missing(tmp_path):
    (tmp_path / "engine.dbc").write_text(TEXTS)
    raws = [(0, 0, 0, 255, 0), (100, 50, 1, 1, 1), (254, 100, 2, 2, 0), (255, 255, 3, 128, 1)]
    payloads = [bytes([temp, speed, state | flag << 2, gear, 0, 0, 0, 0]) for temp, speed, state, gear, flag in raws]
    frames = [Frame(0.1 * k, 256, payload) for k, payload in enumerate(payloads)]
    data = read(write_log(tmp_path / "drive.asc", frames), dbc=tmp_path / "engine.dbc")
    # as cantools decodes them without choices, but for the texts that say that there is no value
    np.testing.assert_array_equal(data["Temp"].values, [-40, 10, np.nan, np.nan])
    np.testing.assert_array_equal(data["Speed"].values, [0, 50, 100, np.nan])
    np.testing.assert_array_equal(data["State"].values, [0, 1, 2, 3])
    np.testing.assert_array_equal(data["Flag"].values, [0, 1, 0, 1])
    np.testing.assert_array_equal(data["Gear"].values, [-1, 1, 2, np.nan])
    remark = "missing values: Temp (2 of 4: Signal_Error, SNA), Speed (1 of 4: not available), Gear (1 of 4: invalid)"
    assert remark in data.findings[-1].message
