"""Dates and times of day as text."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.measurement import read
from kennfeld.measurement.stamps import is_stamp, parse_stamps
from tests.draws import few_or_many

FORMS = ("%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%d.%m.%Y %H:%M:%S,%f", "%Y/%m/%d %H:%M:%S.%f")


@few_or_many(
    st.datetimes(datetime(1970, 1, 1), datetime(2100, 1, 1)),
    st.integers(0, 10**12),
    st.sampled_from(FORMS),
    few=20,
    many=100,
)
def test_stamps_differ_by_the_time_between_them(begin, later, form):
    cells = [(begin + timedelta(microseconds=m)).strftime(form) for m in (0, later)]
    seconds, _ = parse_stamps(cells)
    assert seconds[1] - seconds[0] == pytest.approx(later * 1e-6, abs=1e-9)


@pytest.mark.parametrize("cell", ["", "12:00", "1.5", "2024-13-01", "30.02.2024", "12:61:00", "noon", "2024-01-01x", 5])
def test_other_cells_are_not_read_as_stamps(cell):
    assert not is_stamp(cell)


def test_zones_are_respected():
    seconds, _ = parse_stamps(["2024-01-01T12:00:00+01:00", "2024-01-01T11:00:00Z", "2024-01-01 06:00:00-0500", ""])
    np.testing.assert_array_equal(seconds, [39600, 39600, 39600, np.nan])


@pytest.mark.parametrize(
    "text",
    [
        "Time;n\n12:00:00.0;800\n12:00:00.1;801\n12:00:00.3;802\n",
        "timestamp,n\n2020-02-01T12:00:00.0Z,800\n2020-02-01T12:00:00.1Z,801\n2020-02-01T12:00:00.3Z,802\n",
        "n;Datum;Uhrzeit\n800;01.02.2020;23:59:59,9\n801;02.02.2020;00:00:00,0\n802;02.02.2020;00:00:00,2\n",
        "Start\tn\n1.2.2020 12:00:00,0\t800\n1.2.2020 12:00:00,1\t801\n1.2.2020 12:00:00,3\t802\n",
    ],
)
def test_a_column_of_stamps_is_the_time(csv, text):
    data = read(csv(text))
    assert data.time.tolist() == [0, 0.1, 0.3]
    assert data["n"].values.tolist() == [800, 801, 802]


def test_a_large_file_keeps_its_stamps(csv, monkeypatch):
    monkeypatch.setattr("kennfeld.measurement.text.BULK", 100)
    rows = "".join(f"12:00:{k // 10:02d}.{k % 10};{k}\n" for k in range(300))
    data = read(csv("Time;n\n" + rows))
    np.testing.assert_allclose(np.diff(data.time), 0.1)


def test_an_impossible_date_stays_text(csv):
    assert read(csv("Time;n\n2020-02-30 12:00:00;1\n2020-02-31 12:00:00;2\n")).time is None


def test_a_first_stamp_that_is_missing_is_the_only_finding(csv):
    with pytest.raises(InputError) as caught:
        read(csv("Time;n\n;799\n12:00:00.0;800\n12:00:00.1;801\n"))
    assert [str(f).partition(". ")[0] for f in caught.value.findings] == [
        "bench.csv line 2, column Time: the time stamp is missing"
    ]
