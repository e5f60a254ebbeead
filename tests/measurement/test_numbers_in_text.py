"""Numbers as spreadsheets and loggers write them: thousands, words for missing values, switches, repeated names."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read, text

NAN = np.nan


def severities(data):
    return [finding.severity for finding in data.findings]


@pytest.mark.parametrize(
    ("content", "values"),
    [
        ('time,n\n0,"1,200.5"\n1,"1,300.5"\n2,"2,000.0"\n', [1200.5, 1300.5, 2000]),
        ('time,n\n0,"1,200.5"\n1,"2,000"\n2,950\n', [1200.5, 2000, 950]),
        ('time,n\n0,950\n1,"1,100"\n2,"-12,345,678"\n', [950, 1100, -12345678]),
        ('n,m\n"1,200.5","1,000"\n"1,300.5","2,000"\n', [1200.5, 1300.5]),
        ("time;n\n0;1,200.5\n1;1,300.5\n2;2,000.0\n", [1200.5, 1300.5, 2000]),
        ("time\tn\n0\t1,200.5\n1\t950.5\n", [1200.5, 950.5]),
        ("time;n\n0;1.200,5\n1;950,25\n", [1200.5, 950.25]),
        ("time;n\n0;1'200.5\n1;1’300.5\n", [1200.5, 1300.5]),
        ("time;n\n0;1 200,5\n1;12\u00a0300,5\n2;1\u202f234\u202f567\n", [1200.5, 12300.5, 1234567]),
        ("time;n\n0;1,200\n1;1,300\n2;0,900\n", [1.2, 1.3, 0.9]),  # decimal commas
    ],
)
def test_separated_thousands_are_numbers(csv, monkeypatch, content, values):
    path = csv(content)
    assert read(path)["n"].values.tolist() == values
    monkeypatch.setattr(text, "BULK", 0)
    assert read(path)["n"].values.tolist() == values


def test_thousands_that_show_only_far_down_are_numbers(csv, monkeypatch):
    path = csv("time,n\n" + "".join(f"{k},{k % 900}.5\n" for k in range(400)) + '400,"1,200.5"\n')
    assert read(path)["n"].values[-1] == 1200.5
    monkeypatch.setattr(text, "BULK", 0)
    assert read(path)["n"].values[-1] == 1200.5


def test_what_is_not_grouped_by_thousands_is_not_a_number(csv):
    for cell in ('"1,20"', '"12,3456"', '"1,200.5.1"', '"0,900"'):
        with pytest.raises(InputError, match="must be a number"):
            read(csv(f"time,n\n0,1.5\n1,{cell}\n2,3\n"))


WORDS = [
    "1.#IND", "-1.#IND00", "1.#QNAN", "-nan(ind)", "nan(0x8000)", "---", "-----", "****", "*", "?", "#VALUE!",
    "#DIV/0!", "#REF!", "#NUM!", "#####", "No Data", "no data", "n.a.", "NaN", "n/a", "NULL", "Not Available",
]  # fmt: skip


@pytest.mark.parametrize("word", WORDS)
def test_words_for_a_missing_value(csv, monkeypatch, word):
    path = csv("time;n\n" + "".join(f"{k};{k}.5\n" for k in range(300)) + f"300;{word}\n301;7\n")
    for bulk in (text.BULK, 0):
        monkeypatch.setattr(text, "BULK", bulk)
        data = read(path)
        np.testing.assert_array_equal(data["n"].values[-3:], [299.5, NAN, 7])
        assert data.findings == ()


@pytest.mark.parametrize("word", ["1.#INF", "-1.#INF00", "inf"])
def test_infinite_values_are_missing_with_a_warning(csv, word):
    data = read(csv(f"time;n\n0;1.5\n1;{word}\n2;7\n"))
    np.testing.assert_array_equal(data["n"].values, [1.5, NAN, 7])
    assert severities(data) == ["warning"]


def test_a_question_mark_may_stand_for_a_unit(csv):
    data = read(csv("time;n;x\ns;rpm;?\n0;1;2\n1;3;4\n"))
    assert (data["n"].unit, data["n"].values.tolist()) == ("rpm", [1, 3])


@pytest.mark.parametrize("bulk", [text.BULK, 0])
def test_switches_among_numbers_are_missing_with_a_warning(csv, monkeypatch, bulk):
    monkeypatch.setattr(text, "BULK", bulk)
    path = csv("time;NOx;fan\n" + "".join(f"{k};{k}.5;on\n" for k in range(300)) + "300;OFF;off\n301;off;on\n302;5;0\n")
    data = read(path)
    np.testing.assert_array_equal(data["NOx"].values[-4:], [299.5, NAN, NAN, 5])
    assert data["fan"].values[-4:].tolist() == [1, 0, 1, 0]
    [finding] = data.findings
    assert finding.severity == "warning"
    assert "column NOx: 2 of 303 cells hold 'OFF' or the like among numbers" in str(finding)
    assert describe(path).tables[0].findings == data.findings


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_repeated_names_are_renamed_with_a_remark(csv, separator):
    path = csv("time,a,b,a\ns,Nm,K,kPa\n0,1,2,3\n1,4,5,6\n".replace(",", separator))
    data = read(path)
    assert [(name, c.unit, c.values.tolist()) for name, c in data.items()] == [
        ("a", "Nm", [1, 4]), ("b", "K", [2, 5]), ("a (2)", "kPa", [3, 6]),
    ]  # fmt: skip
    assert "renamed: a (2)" in data.findings[0].message
    assert read(path, ["a (2)"])["a (2)"].values.tolist() == [3, 6]


FACTS = '"Format","MoTeC CSV File"\n"Sample Rate","50"\n\n'


@pytest.mark.parametrize("facts", ["", FACTS])
@pytest.mark.parametrize("first", ["5.00,5.02,5.04", "0.00,0.02,0.04", "1.50,1.52,1.54"])
def test_a_row_of_channel_numbers_is_skipped_with_a_remark(csv, facts, first):
    rows = "".join(f"{time},{4000 + k},{10 + k}.5\n" for k, time in enumerate(first.split(",")))
    data = read(csv(f"{facts}Time,Engine RPM,Throttle Pos\ns,rpm,%\n1,2,3\n{rows}"))
    assert data.time.tolist() == [float(time) for time in first.split(",")]
    assert data["Engine RPM"].values.tolist() == [4000, 4001, 4002]
    assert severities(data) == ["remark"]


@pytest.mark.parametrize("facts", ["", FACTS])
def test_a_sample_that_counts_from_one_stays(csv, facts):
    data = read(csv(f"{facts}Time,n,T\ns,rpm,K\n1,2,3\n2,800,300\n3,801,301\n4,802,302\n"))
    assert data.time.tolist() == [1, 2, 3, 4]
    assert data.findings == ()
