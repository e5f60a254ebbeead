"""Text files: detected dialects, gaps, findings with their line, and random tables."""

import contextlib
import gzip
import random
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.measurement import read, text
from kennfeld.measurement.bulk_csv import read_bulk
from kennfeld.measurement.source import locate
from kennfeld.measurement.table import Selection
from tests.draws import few_or_many

NAN = np.nan


def findings(path, *args, **options):
    with pytest.raises(InputError) as caught:
        read(path, *args, **options)
    return [str(finding) for finding in caught.value.findings]


@pytest.mark.parametrize("separator", [";", ",", "\t", "|", " ", "   "])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_separator_and_line_ends_are_detected(csv, separator, end):
    rows = [["Speed", "Torque"], ["1000", "80.5"], ["2000", "95.25"]]
    data = read(csv(end.join(separator.join(row) for row in rows) + end))
    assert list(data) == ["Speed", "Torque"]
    assert data["Torque"].values.tolist() == [80.5, 95.25]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encoding_is_detected(csv, encoding):
    data = read(csv("Öltemperatur [°C];n\n90,5;1000\n91,5;2000\n", encoding=encoding))
    assert data["Öltemperatur"].unit == "°C"
    assert data["Öltemperatur"].values.tolist() == [90.5, 91.5]


def test_decimal_comma_that_shows_only_far_down_is_detected(csv):
    path = csv("a;b\n" + "1;2\n" * 300 + "0,5;2,25\n")
    assert read(path)["b"].values[-1] == 2.25


def test_a_single_column_with_decimal_comma_is_not_a_pair(csv):
    assert read(csv("Torque\n1,5\n2,5\n"))["Torque"].values.tolist() == [1.5, 2.5]


def test_units_come_from_a_row_below_the_names(csv):
    data = read(csv("Speed,Torque,lam,T\nrpm,[Nm],-,°C\n1000,80,1,20\n"))
    assert [channel.unit for channel in data.values()] == ["rpm", "Nm", "-", "°C"]


def test_a_unit_row_may_hold_ones(csv):
    data = read(csv("Speed;eta\nrpm;1\n1000;0.5\n2000;0.6\n"))
    assert data["eta"].unit == "1"
    assert data.samples == 2


def test_units_come_from_the_names(csv):
    data = read(csv("Speed [rpm],Torque (Nm),p (intake),rad[3]\n1,2,3,4\n"))
    assert {c.name: c.unit for c in data.values()} == {"Speed": "rpm", "Torque": "Nm", "p (intake)": "", "rad[3]": ""}


def test_full_heads_keep_columns_apart_that_differ_in_the_unit(csv):
    assert list(read(csv("p [bar],p [kPa]\n1,100\n"))) == ["p [bar]", "p [kPa]"]


def test_preamble_settings_and_comments_are_passed_over(csv):
    data = read(csv('"A test bench"\nRate;0.1\nDriver;Ada\n# by hand\n\nSpeed;Torque;n\n1;2;3\n# pause\n\n4;5;6\n'))
    assert data["Torque"].values.tolist() == [2, 5]


def test_names_in_a_comment_are_taken_where_there_are_no_others(csv):
    assert list(read(csv("# x y\n1.0 2.0\n3.0 4.0\n"))) == ["x", "y"]


def test_a_quoted_name_may_hold_the_separator_and_a_line_end(csv):
    data = read(csv('"Speed, mean","Torque\n[Nm]"\n1,2\n'))
    assert list(data) == ["Speed, mean", "Torque"]
    assert data["Torque"].unit == "Nm"


def test_trailing_separators_and_empty_rows_are_passed_over(csv):
    data = read(csv("a;b;\n1;2;\n;;\n3;4;\n\n"))
    assert data["b"].values.tolist() == [2, 4]


def test_gaps_become_nan_and_switches_numbers(csv):
    cells = ["", "NaN", "nan", "NA", "#N/A", "-", "on", "OFF", "true", "False", "1"]
    data = read(csv("k,x\n" + "".join(f"{i},{cell}\n" for i, cell in enumerate(cells))))
    np.testing.assert_array_equal(data["x"].values, [NAN] * 6 + [1, 0, 1, 0, 1])


def test_text_columns_are_left_out_and_reported_when_asked_for(csv):
    path = csv("Date,Speed,Note\n2024-01-01,1,ok\n2024-01-02,2,\n2024-01-03,3,late\n")
    assert list(read(path)) == ["Speed"]
    assert findings(path, ["Speed", "Note"]) == [
        "bench.csv line 2, column Note: the column holds text, such as 'ok'. "
        "Choose another channel, or replace the text by numbers."
    ]


def test_only_requested_channels_and_time_are_read(csv):
    data = read(csv("time,a,b\n0,1,x\n1,2,3\n2,5,4\n"), ["a"])
    assert list(data) == ["a"]
    assert data.time.tolist() == [0, 1, 2]


def test_a_channel_that_is_missing_names_the_nearest(csv):
    assert findings(csv("Speed,Load\n1,2\n"), ["Sped", "xyz"]) == [
        "bench.csv: has no channel Sped. Did you mean Speed?",
        "bench.csv: has no channel xyz. It has Speed, Load.",
    ]


def test_every_problem_of_a_file_is_reported_at_once(csv):
    body = "Speed,Torque\n1,2\n3,abc\n4\n5,6,7\n8,8.5\n9,10\n"
    assert findings(csv(body)) == [
        "bench.csv line 4: the row has 1 cell, the header names 2. Give the row as many cells as the header.",
        "bench.csv line 5: the row has 3 cells, the header names 2. Give the row as many cells as the header.",
        "bench.csv line 3, column Torque: must be a number, got 'abc'. "
        "Correct it, or leave the cell empty if there is no value.",
    ]


def test_a_second_unit_row_is_one_finding(csv):
    messages = findings(csv("Speed,Torque\nrpm,Nm\n1,2\n3,4\n5,6\nrpm,Nm\n7,8\n"))
    assert len(messages) == 1
    assert messages[0].startswith("bench.csv line 6, columns Speed, Torque: must be numbers, got 'rpm', 'Nm'")


def test_a_file_cut_in_half_is_called_cut_off(csv):
    (message,) = findings(csv("a,b,c\n1,2,3\n4,5,6\n7,8"))
    assert message.startswith("bench.csv line 4: the row has 2 cells, the header names 3. The file seems to be cut off")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file is empty (0 bytes)"),
        ("\n\n", "the file is empty"),
        ("Speed,Torque\n", "there are names but no row of numbers below them"),
        ("Speed,Torque\nrpm,Nm\n", "there are names but no row of numbers below them"),
        ("1,2\n3,4\n", "the numbers have no header with channel names"),
        ("a;b\n1,234.5.1;1.5\n2.5;3.5\n3.5;4.5\n", "must be a number, got '1,234.5.1'"),
        ("a,b\n1,2\n3,1_000\n4,5\n", "must be a number, got '1_000'"),
    ],
)
def test_a_file_without_a_table_is_refused_with_the_reason(csv, content, message):
    assert message in "\n".join(findings(csv(content)))


def test_many_findings_are_counted(csv):
    messages = findings(csv("a,b\n" + "1,2\n" * 100 + "1,x\n" * 90))
    assert len(messages) == 21
    assert messages[-1].startswith("bench.csv: 70 more rows")


def test_a_packed_file_is_read_and_named_without_its_endings(csv):
    data = read(csv(gzip.compress(b"a,b\n1,2\n"), "run.csv.gz"))
    assert data.name == "run"


def test_a_packed_file_cut_off_is_reported(csv):
    whole = gzip.compress(b"a,b\n" + bytes(random.Random(1).randbytes(20000).hex(), "ascii"))
    assert "cut off" in findings(csv(whole[:9000], "run.csv.gz"))[0]


def test_small_files_need_neither_pandas_nor_pyarrow(csv):
    path = csv("time,a\n0,1\n1,2\n")
    code = f"import sys; from kennfeld.measurement import read; read({str(path)!r}, raster=0.5); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {"pandas", "pyarrow", "scipy", "python_calamine"}.isdisjoint(loaded)


@pytest.mark.parametrize(
    "body",
    [
        "time,a,b\n" + "".join(f"{i},{i * 0.1!r},on\n" for i in range(400)),
        "time;a;b\n" + "".join(f"{i};{i},5;\n" for i in range(400)) + "\n\n",
        "time a b\n" + "".join(f"{i}  {i}.25 NaN\n" for i in range(400)),
        '"n, mean", a, note\n' + "".join(f"{i}, , x\n" for i in range(400)),
        "a,b\n" + "1,2\n" * 300 + "3\n",
        "a,b\n" + "1,2\n" * 300 + "1,2,3\n",
        "a,b\n" + "1,2\n" * 300 + "rpm,Nm\n" + "1,2\n",
        "a,b\n" + "1,2\n" * 300 + ",\n" + "1,2\n",
        "a,b\n" + "1,2\n" * 300 + "# pause\n1,1_0\n",
        "a;b\n" + "1;2\n" * 300 + "1,5;2\n",
        "a,b\n" + "1,2\n" * 300 + "inf,2\n",
    ],
)
def test_the_bulk_reader_agrees_with_the_exact_one(csv, monkeypatch, body):
    path = csv(body)

    def outcome():
        try:
            data = read(path)
        except InputError as error:
            return str(error)
        return {name: channel.values.tolist() for name, channel in data.items()}, str(data.time)

    exact = outcome()
    monkeypatch.setattr(text, "BULK", 0)
    assert repr(outcome()) == repr(exact)


NUMBERS = st.one_of(st.just(NAN), st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**6), 10**6))
TABLES = st.integers(1, 5).flatmap(
    lambda n: st.lists(st.lists(NUMBERS, min_size=n, max_size=n), min_size=1, max_size=8)
)


@st.composite
def dialects(draw):
    separator = draw(st.sampled_from([";", ",", "\t", "|", " "]))
    return {
        "separator": separator,
        "decimal": "." if separator == "," else draw(st.sampled_from(".,")),
        "gap": draw(st.sampled_from(["nan", "NaN", "NA", "#N/A"])),
        "units": draw(st.booleans()),
        "title": draw(st.booleans()),
        "end": draw(st.sampled_from(["\n", "\r\n"])),
        "encoding": draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"])),
        "quotes": draw(st.booleans()),
    }


def written(table, how):
    def cell(value):
        return how["gap"] if value != value else repr(value).replace(".", how["decimal"])

    head = [f'"Größe {i}"' if how["quotes"] or how["separator"] == " " else f"Größe {i}" for i in range(len(table[0]))]
    rows = [head, *([["Nm"] * len(head)] if how["units"] else []), *([cell(v) for v in row] for row in table)]
    lines = [*(["# a title"] if how["title"] else []), *(how["separator"].join(row) for row in rows)]
    return (how["end"].join(lines) + how["end"]).encode(how["encoding"])


@few_or_many(TABLES, dialects(), few=20, many=300)
def test_a_random_table_in_a_random_dialect_is_read_back_exactly(csv, table, how):
    data = read(csv(written(table, how)))
    assert list(data) == [f"Größe {i}" for i in range(len(table[0]))]
    np.testing.assert_array_equal(np.array([c.values for c in data.values()]).T, np.array(table, dtype=float))
    assert {c.unit for c in data.values()} == {"Nm" if how["units"] else ""}


def mutants(content, seed, count):
    generator = random.Random(seed)
    for _ in range(count):
        mutant = bytearray(content)
        for _ in range(generator.randint(0, 6)):
            at = generator.randrange(len(mutant))
            mutant[at] = generator.randrange(256)
        if generator.random() < 0.3:
            a, b = sorted(generator.randrange(len(mutant)) for _ in range(2))
            del mutant[a:b]
        yield bytes(mutant[: generator.randrange(len(mutant) + 1)] if generator.random() < 0.4 else mutant)


@pytest.mark.parametrize("count", [25, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("bulk", [False, True])
def test_a_damaged_file_gives_findings_and_nothing_else(csv, monkeypatch, bulk, count):
    if bulk:
        monkeypatch.setattr(text, "BULK", 0)
    body = "# test\ntime [s];Speed;Note\n;rpm;\n" + "".join(f"{i / 10};{1000 + i},5;ok\n" for i in range(30))
    for content in mutants(body.replace(".", ",").encode(), 7, count):
        with contextlib.suppress(InputError):
            read(csv(content), raster=0.05)


def outcome(path):
    try:
        data = read(path)
    except InputError as error:
        return str(error)
    return {name: (channel.values.tolist(), channel.unit) for name, channel in data.items()}, str(data.time)


@pytest.mark.parametrize("count", [15, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_damaged_files_read_in_bulk_are_as_read_line_by_line(csv, monkeypatch, separator, count):
    numbers = random.Random(5)
    rows = [[f"{i / 10}", repr(numbers.gauss(0, 1e3)), repr(numbers.random() * 1e-9), str(-i)] for i in range(60)]
    body = "\n".join(separator.join(row) for row in [["time", "a", "b", "c"], ["s", "Nm", "", "1"], *rows]) + "\n"
    assert read_bulk_of(csv(body)) is not None
    for content in [body.encode(), body.replace("\n", "\r\n").encode(), *mutants(body.encode(), 11, count)]:
        path = csv(content)
        exact = repr(outcome(path))
        with monkeypatch.context() as patched:
            patched.setattr(text, "BULK", 0)
            assert repr(outcome(path)) == exact


def read_bulk_of(path):
    source = locate(path)
    return read_bulk(source, text.detect_dialect(source), Selection())


def numbers_and(cell):
    """Return a table whose last rows lie beyond those that the bulk reader looks at before it begins."""
    return "a,b\n" + "1,2\n" * 300 + f"3,{cell}\n5,6\n7,8\n"


@pytest.mark.parametrize("cell", ["x", "1 2", "1.2.3", "1e", "1-2", "--1", "0x10", "1_000"])
def test_cells_that_are_not_numbers_are_left_to_the_exact_reader(csv, cell):
    assert read_bulk_of(csv(numbers_and(cell))) is None


@pytest.mark.parametrize(
    "cell", ["", "nan", "-", "N/A", "inf", "-Infinity", '"1"', " 1", "1 ", "1.", ".5", "1e-3", "-0"]
)
def test_a_number_in_an_unusual_form_is_read_in_bulk_as_line_by_line(csv, monkeypatch, cell):
    path = csv(numbers_and(cell))
    exact = repr(outcome(path))
    assert read_bulk_of(path) is not None
    monkeypatch.setattr(text, "BULK", 0)
    assert repr(outcome(path)) == exact


@pytest.mark.parametrize("row", ["", "1", "1,2,3", "1,2,", "# 1,2", "1;2", ",", '"1', '"1\n2",3'])
def test_a_row_of_another_form_is_left_to_the_exact_reader(csv, row):
    assert read_bulk_of(csv(f"a,b\n1,2\n{row}\n5,6\n7,8\n")) is None


@pytest.mark.parametrize("row", ["1  2", "1 2 ", " 1 2", "1\t2 3"])
def test_several_blanks_between_numbers_are_left_to_the_exact_reader(csv, row):
    assert read_bulk_of(csv("a b c\n" + "1 2 3\n" * 300 + f"{row}\n5 6 7\n")) is None


@pytest.mark.parametrize(
    "above",
    [
        "4711\n",
        "1,2,3\n4,5,6\n7,8,9\n",
        "Bench 3\n2024\n5,6,7\n",
        "Rate,0.1\nCount,8\n17,4,2024\n",
        "k1,k2,k3\n1,2,3\n",
        "k1,k2\n1,2\n3,4\n5,6\n",
    ],
)
@pytest.mark.parametrize("units", ["s,rpm,%\n", ""])
def test_numbers_above_the_header_are_not_a_table(csv, above, units):
    rows = "".join(f"{k / 10:.1f},{900 + k},{k % 7}.5\n" for k in range(12))
    data = read(csv(f"{above}time,Speed,Load\n{units}{rows}"))
    assert (list(data), data.samples) == (["Speed", "Load"], 12)
    assert data.time[-1] == 1.1


def test_text_after_a_few_rows_is_not_a_header_of_fewer_columns(csv):
    messages = findings(csv("time,Speed\n0,1\n1,2\nrestart,x,at noon\n" + "".join(f"{k},{k}\n" for k in range(2, 20))))
    assert "line 4" in messages[0]


@pytest.mark.slow
def test_a_table_of_very_many_columns_is_read(csv):
    count = 6_000
    names = ",".join(f"n{i % (count // 2)} [{'rpm' if i < count // 2 else 'Nm'}]" for i in range(count))
    rows = "".join(",".join([f"{k}", *["1.5"] * count]) + "\n" for k in range(5))
    data = read(csv(f"time,{names}\n{rows}"), ["n7 [Nm]", "n7 [rpm]"])
    assert [c.name for c in data.values()] == ["n7 [rpm]", "n7 [Nm]"]
    assert data.samples == 5


def test_many_lines_of_very_many_columns_need_not_all_be_looked_at(csv, monkeypatch):
    monkeypatch.setattr("kennfeld.measurement.text._HEAD_TEXT", 1000)
    rows = "".join(f"{k / 10:.1f}{',1' * 99}\n" for k in range(60))
    assert read(csv(f"time,{','.join(f'n{i}' for i in range(99))}\n{rows}")).samples == 60


@pytest.mark.parametrize("count", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_a_damaged_packed_file_gives_findings_and_nothing_else(csv, count):
    content = gzip.compress(b"time,a\n" + b"".join(b"%d,%d\n" % (i, i * i) for i in range(200)))
    for mutant in mutants(content, 3, count):
        with contextlib.suppress(InputError):
            read(csv(mutant, "run.csv.gz"))


def test_the_published_tanks_are_read(real):
    data = read(real("cascaded_tanks/dataBenchmark.csv"))
    assert list(data) == ["uEst", "uVal", "yEst", "yVal", "Ts"]
    assert data.samples == 1024
    assert data["yEst"].values[0] == 5.205
    assert data.time is None


def test_the_real_engine_recordings_are_read(real):
    data = read(real("engine_transient/gengine1_m10.csv.gz"), ["speed", "T_exh_manifold"])
    assert data.samples == 13364
    assert data.time[-1] == 1336.3
    assert data["T_exh_manifold"].values[0] == 1.0905


def test_a_real_megasquirt_log_is_read(real):
    data = read(real("ecu_logs/empro_ms_test.msl"))
    assert data["RPM"].unit == "rpm"
    assert data.samples == 7977
