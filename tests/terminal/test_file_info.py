import gzip
import json
import random
import warnings
import zipfile

import h5py
import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.domain.rbf import Expansion
from kennfeld.files.file_info import FileInfo
from kennfeld.surrogate import DynamicSurrogate, Validity, write_surrogate
from kennfeld.terminal.file_info import describe_file, text_lines
from tests.measurement.bus_files import DBC, drive, write_mf4


@pytest.fixture
def written(tmp_path):
    def write(name, text):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_recording_shows_its_time_and_skipped_columns(written):
    info = describe_file(written("drive.csv", "time,Speed,note\ns,rpm,\n0.0,1000,cold\n0.1,,warm\n0.2,1200,warm\n"))
    text = "\n".join(text_lines(info))
    assert info.summary.startswith("drive.csv: measurement (CSV)")
    assert "time from 0 s to 0.2 s, a sample every 0.1 s" in text
    assert "columns without numbers: note" in text
    assert "33.3%" in text


def test_a_channel_shows_the_rate_of_its_own_values(written):
    rows = "".join(f"{i / 10},{i},{i if i % 20 == 0 else ''},\n" for i in range(100))
    info = describe_file(written("drive.csv", f"time [s],Speed,Oil,Empty\n{rows}"))
    rates = {row[0]: row[2] for row in info.tables[0]}
    assert rates == {"channel": "rate", "time": "10 Hz", "Speed": "10 Hz", "Oil": "every 2 s", "Empty": ""}
    channels = {c["name"]: c["rate"] for c in info.as_json["tables"][0]["channels"]}
    assert channels["Oil"] == pytest.approx(0.5)
    assert channels["Empty"] is None


def test_points_without_time_have_no_rate(written):
    info = describe_file(written("bench.csv", "Speed,Torque\n1000,80\n2000,90\n"))
    assert "rate" not in info.tables[0][0]


def test_one_channel_with_one_sample_is_counted_in_the_singular(written):
    assert describe_file(written("bench.csv", "Speed\n1000\n")).summary.endswith("1 channel over 1 sample")


def test_a_recording_of_several_rasters_shows_each(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal

        with MDF(version="4.10") as file:
            for label, step in (("10ms", 0.01), ("1s", 1.0)):
                time = np.arange(5) * step
                states = Signal((time > 0).astype(np.uint8), time, name="on", conversion={"val_0": 0, "text_0": "off"})
                file.append([Signal(time, time, name=f"Speed{label}", unit="rpm"), states], comment=label)
            file.save(tmp_path / "drive.mf4")
    text = "\n".join(text_lines(describe_file(tmp_path / "drive.mf4")))
    assert "channel in 10ms" in text
    assert "100 Hz" in text
    assert "1 Hz" in text
    assert "1s: time from 0 s to 4 s, a sample every 1 s" in text
    assert "0 = off" in text
    assert "1s: names that others have too on" in text


def test_a_model_with_memory_shows_its_states(written):
    info = describe_file(written("lag.kf", "y[degC] = PT1(MapA(u, v), T1) + delay(u, 3, 0)\nscalar T1[s]\nstep 0.1"))
    assert info.summary == "lag.kf: formula, 1 node, 2 states"
    assert info.as_json["step"] == 0.1
    assert {"name": "MapA", "kind": "map"} in info.as_json["parameters"]


def test_a_model_with_events_warns_that_derivatives_ignore_them(written):
    info = describe_file(written("relay.kf", "scalar K\non = hysteresis(K * u, 2, 1)\nheat = PT1(5 * on, 3)"))
    assert info.notes == [
        'on (>=, <=) jumps depending on parameters. Derivatives do not account for that; method = "global" does.'
    ]
    assert info.as_json["events"][0] == {"node": "on", "kind": ">=", "parameters": ["K"]}
    assert describe_file(written("plain.kf", "scalar K\ny = if(K * u > 0, K * u, 0)")).notes == []


def test_values_that_are_not_finite_are_null(written):
    info = describe_file(written("empty.csv", "a,b\n1,\n2,\n"))
    assert json.loads(json.dumps(info.as_json, allow_nan=False))["tables"][0]["channels"][1]["minimum"] is None


@pytest.mark.parametrize(
    ("text", "content"),
    [
        ("# a comment\n\n3 y[-] = 2 * x\n", "formula"),
        ("input Speed[rpm]\ny = Speed\n", "formula"),
        ("%engine speed% = 2 * x\n", "formula"),
        ('[model]\nfile = "a.kf"\n[[dataset]]\nfiles = ["a.csv"]\n[[criterion]]\nnode = "y"\ntarget = 1\n', "project"),
        ("FESTWERT K\n  WERT 1.0\nEND\n", "calibration"),
        ('{"K": {"kind": "scalar", "unit": "", "value": 1.0}}', "calibration"),
        ("Speed;Torque\n1000;80\n2000;90\n", "measurement"),
    ],
)
def test_text_is_recognised_by_its_content(written, text, content):
    assert describe_file(written("file.txt", text)).as_json["content"] == content


def test_a_calibration_shows_group_axes_texts_and_skipped_labels(written):
    text = """KONSERVIERUNG_FORMAT 2.0
STUETZSTELLENVERTEILUNG AxisSpeed 2
  EINHEIT_X "rpm"
  ST/X 1000 2000
END
TEXTSTRING Version
  TEXT "V1.2"
END
"""
    shown = "\n".join(text_lines(describe_file(written("set.dcm", text))))
    assert "AxisSpeed" in shown
    assert "V1.2" in shown


def test_a_file_of_an_unknown_kind_is_named(written):
    with pytest.raises(InputError, match=r"notes\.txt"):
        describe_file(written("notes.txt", ""))


def plane(inputs):
    return Expansion(0.0, np.ones(inputs), np.zeros(0), np.zeros((0, inputs)), np.zeros((0, inputs)))


LOOP = "n = engine(throttle, load, load, load, load)\nthrottle = k * (wanted - n)\nscalar k\n"


def engine(inputs=("throttle", "load", "b", "c", "d"), name="else"):
    lags = tuple((1,) for _ in inputs)
    return DynamicSurrogate(name, inputs, lags, "n", (1,), 0.02, plane(1 + len(inputs)))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.par", "Kp 1.0\n", "is a parameter file (.par) that does not begin as those of CANape"),
        ("a.a2l", '/begin MEASUREMENT n "" UWORD CM 0 0 0 8000\n/end MEASUREMENT\n', "is a fragment of an A2L file"),
    ],
)
def test_unreadable_calibration_data_are_not_reported_as_a_bad_measurement(written, name, text, message):
    with pytest.raises(InputError) as caught:
        describe_file(written(name, text))
    assert message in str(caught.value)


def test_a_formula_reads_the_surrogates_that_lie_beside_it(written, tmp_path):
    path = written("loop.kf", LOOP)
    write_surrogate(engine(), tmp_path / "engine.json")
    write_surrogate(engine(), tmp_path / "other.json")
    info = describe_file(path)
    assert info.as_json["surrogates"] == ["engine"]
    assert info.notes[0].startswith("engine.json: n = engine(throttle, load, b, c, d), steps of 0.02 s")
    assert {"name": "engine", "kind": "surrogate"} in info.as_json["parameters"]
    json.dumps(info.as_json)


def test_a_surrogate_whose_file_is_missing_is_reported(written):
    with pytest.raises(InputError, match="engine has 5 coordinates"):
        describe_file(written("loop.kf", LOOP))


def test_a_declared_table_stays_a_table_and_a_calibration_beside_it_is_not_a_surrogate(written, tmp_path):
    write_surrogate(engine(("a",)), tmp_path / "engine.json")
    written("Gain.json", '{"Gain": {"kind": "scalar", "unit": "", "value": 1.0}}')
    info = describe_file(written("plain.kf", "y = engine(u) + Gain(u)\ncurve engine\n"))
    assert info.as_json["surrogates"] == []
    assert {"name": "engine", "kind": "curve"} in info.as_json["parameters"]


def test_a_damaged_surrogate_beside_is_named(written):
    written("engine.json", '{"kind": "kennfeld-dynamic-surrogate", "version": 1')
    with pytest.raises(InputError, match=r"engine\.json line 1"):
        describe_file(written("loop.kf", LOOP))


def test_formula_text_of_another_ending_reads_them_too(written, tmp_path):
    write_surrogate(engine(), tmp_path / "engine.json")
    assert describe_file(written("loop.txt", LOOP)).as_json["surrogates"] == ["engine"]


def test_a_surrogate_shows_its_training_ranges_for_any_lag(tmp_path):
    trained = np.array([[100.0, 1.0, 3.0, 7.0], [200.0, 2.0, 4.0, 8.0], [150.0, 1.5, 3.5, 9.0]])
    units = ("deg", "Nm", "rpm")
    surrogate = DynamicSurrogate(
        *("engine", ("throttle", "load"), ((0, 1), (2,)), "n", (1,), 0.02, plane(4)),
        Validity.around(trained, np.ones(4)),
        units=units,
    )
    write_surrogate(surrogate, tmp_path / "engine.json")
    info = describe_file(tmp_path / "engine.json")
    assert info.as_json["ranges"] == {"n": [100.0, 200.0], "throttle": [1.0, 4.0], "load": [7.0, 9.0]}
    assert ["throttle", "deg", "1", "4"] in info.tables[1]


def test_a_project_lists_its_surrogates(written):
    text = '[model]\nfile = "a.kf"\n[surrogates]\nengine = "e.json"\n[[dataset]]\nfiles = ["a.csv"]\n'
    info = describe_file(written("p.toml", text + '[[criterion]]\nnode = "y"\ntarget = 1\n'))
    assert info.as_json["surrogates"] == {"engine": "e.json"}
    assert "surrogate engine: e.json" in info.notes


def test_a_cdfx_file_is_a_calibration(tmp_path):
    kf.ParameterSet([kf.Curve("C", [0, 1], [2, 3])]).save(tmp_path / "p.cdfx")
    assert describe_file(tmp_path / "p.cdfx").summary.startswith("p.cdfx: calibration (CDFX")


DIAGRAM = """Model {
  Version 8.5
  System {
    Block {
      BlockType Inport
      Name "n"
      Unit "rpm"
    }
    Block {
      BlockType Gain
      Name "K"
    }
    Line {
      SrcBlock "n"
      SrcPort 1
      DstBlock "K"
      DstPort 1
    }
  }
}
"""


@pytest.mark.guests
def test_a_simulink_model_is_recognised_by_its_content(written):
    for name in ("engine.mdl", "engine.txt"):
        info = describe_file(written(name, DIAGRAM))
        assert info.summary.startswith(f"{name}: Simulink model (version 8.5), 2 blocks")
        assert info.as_json["inputs"] == [{"name": "n", "unit": "rpm"}]
    assert "rpm" in "\n".join(text_lines(info))


@pytest.mark.guests
def test_a_zipped_simulink_model_and_a_data_dictionary_are_described(tmp_path):
    diagram = '<M><Model><System><Block BlockType="Gain" Name="K" SID="1"/></System></Model></M>'
    with zipfile.ZipFile(tmp_path / "engine.slx", "w") as archive:
        archive.writestr("simulink/blockdiagram.xml", diagram)
    entry = '<P Name="Name" Class="char">K</P><P Name="Value" Class="double">2.5</P>'
    with zipfile.ZipFile(tmp_path / "data.sldd", "w") as archive:
        archive.writestr("data/chunk0.xml", f'<DataSource><Object Class="DD.ENTRY">{entry}</Object></DataSource>')
    assert describe_file(tmp_path / "engine.slx").as_json["blocks"] == {"Gain": 1}
    info = describe_file(tmp_path / "data.sldd")
    assert info.summary == "data.sldd: Simulink data dictionary, 1 variable"
    [variable] = info.as_json["variables"]
    assert (variable["name"], variable["class"], variable["size"]) == ("K", "double", [1, 1])
    json.dumps(info.as_json)
    assert info.tables[0][1][:4] == ("K", "double", "1 x 1", "2.5")


@pytest.mark.guests
def test_the_class_file_of_an_enumeration_shows_its_members(written):
    text = "classdef Gear < Simulink.IntEnumType\nenumeration\nReverse(-1), First(1)\nend\nend\n"
    described = describe_file(written("Gear.m", text))
    assert described.summary == "Gear.m: enumeration class of MATLAB, 2 members"
    assert described.tables[0][1:] == [("Gear.Reverse", "-1"), ("Gear.First", "1")]
    assert described.as_json["members"] == {"Reverse": -1, "First": 1}
    assert "must be called Gear.m" in describe_file(written("gears.m", text)).notes[0]


@pytest.mark.guests
def test_a_damaged_simulink_model_is_reported(tmp_path):
    (tmp_path / "engine.slx").write_bytes(b"PK\3\4 and no more")
    with pytest.raises(InputError, match=r"engine\.slx: is a damaged zip archive"):
        describe_file(tmp_path / "engine.slx")


@pytest.mark.parametrize(
    ("ending", "kind"),
    [(".xlsx", "Excel"), (".m", "MATLAB script"), (".mat", "MATLAB 5"), (".csv", "CVX 2.1"), (".json", "JSON")],
)
def test_a_calibration_of_any_format_is_distinguished_from_a_measurement(tmp_path, ending, kind):
    kf.ParameterSet([kf.Curve("C", [0, 1], [2, 3]), kf.Scalar("K", 1.0)]).save(tmp_path / f"p{ending}")
    assert describe_file(tmp_path / f"p{ending}").summary.startswith(f"p{ending}: calibration ({kind}), 2 parameters")


def test_a_tune_is_a_calibration(written):
    tune = '<?xml version="1.0"?>\n<msq><versionInfo signature="x"/><page><constant name="K">1</constant></page></msq>'
    assert describe_file(written("t.msq", tune)).summary == "t.msq: calibration (MSQ tune of x), 1 parameters, 1 values"


def test_a_parameter_file_of_canape_is_a_calibration(written):
    summary = describe_file(written("t.par", "CANape PAR V3.1: ~ 0 0 \nK [FLOAT(32)] 1 ; 1\n")).summary
    assert summary == "t.par: calibration (CANape PAR 3.1), 1 parameters, 1 values"


def test_a_workbook_of_measured_data_stays_a_measurement(tmp_path):
    import xlsxwriter

    with xlsxwriter.Workbook(tmp_path / "bench.xlsx") as book:
        sheet = book.add_worksheet("Parameters")
        for row, line in enumerate([("time", "n"), ("s", "rpm"), (0, 700), (1, 800)]):
            sheet.write_row(row, 0, line)
    assert describe_file(tmp_path / "bench.xlsx").summary.startswith("bench.xlsx: measurement (Excel)")


def test_a_packed_file_that_is_damaged_anywhere_is_named_as_such(tmp_path):
    path, draw = tmp_path / "drive.csv.gz", random.Random(1)
    whole = gzip.compress(b"time,a\n" + b"".join(b"%d,%d\n" % (i, i * i % 977) for i in range(5000)))
    message = "drive.csv.gz: the compressed file is damaged or cut off. Copy it again from its source."
    for at in range(10, len(whole), len(whole) // 40):
        path.write_bytes(whole[:at])
        with pytest.raises(InputError) as caught:
            describe_file(path)
        assert str(caught.value) == message
        path.write_bytes(whole[:at] + draw.randbytes(9) + whole[at + 9 :])
        with pytest.raises(InputError) as caught:
            describe_file(path)
        assert str(caught.value) == message


@pytest.mark.parametrize("start", [b"\x28\xb5\x2f\xfd", b"7z\xbc\xaf\x27\x1c"])
def test_files_of_other_packers_are_to_be_unpacked(tmp_path, start):
    path = tmp_path / "drive.csv.x"
    path.write_bytes(start + bytes(200))
    with pytest.raises(InputError, match=r"this is a compressed file\. Unpack it first"):
        describe_file(path)


def test_an_hdf5_file_that_matlab_did_not_write_is_a_measurement(tmp_path):
    with h5py.File(tmp_path / "bench.h5", "w") as file:
        file["Speed"], file["group/Torque"] = np.arange(3.0), np.arange(3.0)
    assert "measurement (HDF5)" in "\n".join(text_lines(describe_file(tmp_path / "bench.h5")))


def test_a_bus_log_is_described_by_its_databases(tmp_path):
    path, database = write_mf4(tmp_path / "drive.mf4", drive()), tmp_path / "engine.dbc"
    database.write_text(DBC)
    with pytest.raises(InputError, match="this is a bus log"):
        describe_file(path)
    description = describe_file(path, dbc=[str(database)])
    assert description.summary.startswith("drive.mf4: measurement (MDF), 4 channels over 20 samples and 3 channels")
    assert "Engine.Speed" in "\n".join(text_lines(description))


@pytest.mark.guests
def test_a_function_of_a_file_is_described_without_running_it(tmp_path):
    (tmp_path / "f.py").write_text(
        'raise RuntimeError("it ran")\ndef eta(a, b=2.0):\n    values = {"a": a}\n    return values["a"]\n'
    )
    contents = describe_file(f"{tmp_path}/f.py:eta")
    assert contents.as_json["inputs"][1] == {"name": "b", "unit": "", "default": 2.0}
    assert contents.as_json["outputs"] == [{"name": "eta", "unit": ""}]
    assert "line 3 cannot be translated" in contents.notes[0]


def test_lines_in_a_pipe_are_broken_between_words(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    names = ", ".join(f"input{at}" for at in range(100))
    path = "/".join(["A_long_subsystem"] * 20)
    tables = [[("subsystem", "inputs", "blocks"), (path, names, "7"), ("Gas", "n", "12")]]
    lines = text_lines(FileInfo("engine.slx", tables, [f"warning: {names}", "[parameters.K]\ninitial = nan"], {}))
    assert max(map(len, lines)) < len(path) + 60
    assert sum(path in line for line in lines) == 1
    assert " ".join(" ".join(lines).split()).count("input99") == 2
    assert lines[-1] == "[parameters.K]\ninitial = nan"
    table = [line for line in lines if line.startswith("Gas")]
    assert table[0].split() == ["Gas", "n", "12"]


def test_a_terminal_folds_lines_by_itself(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert text_lines(FileInfo("engine.slx", [], ["word " * 100], {}))[-1] == "word " * 100
