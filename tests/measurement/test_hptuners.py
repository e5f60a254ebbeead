"""Logs of HP Tuners: sections, sparse rows, names with commas, text among the channels."""

import contextlib
import random

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies

HEAD = (
    "HP Tuners CSV Log File\nVersion: 1.0\n\n[Log Information]\nCreation Time: 7/7/2026 10:13:47 PM\nNotes: \n\n"
    "[Channel Information]\n"
)


@pytest.fixture
def log(csv):
    """Writes a log from the lines of names, units and rows."""

    def write(names, units, *rows, ids=None):
        ids = ids if ids is not None else ",".join(map(str, range(len(units.split(",")))))
        text = HEAD + "\n".join([ids, names, units, "", "[Channel Data]", *rows, ""])
        return csv(text.replace("\n", "\r\n"), "pull.csv")

    return write


def findings(path, *args, **options):
    with pytest.raises(InputError) as caught:
        read(path, *args, **options)
    return [str(finding) for finding in caught.value.findings]


def test_a_log_with_full_rows_is_read_as_it_is(log):
    path = log("Offset,Engine RPM (SAE),Mass Airflow", "s,rpm,g/s", "0.102,800,5.5", "0.205,810,5.6")
    data = read(path)
    assert data.time.tolist() == [0.102, 0.205]
    assert {c.name: (c.unit, c.values.tolist()) for c in data.values()} == {
        "Engine RPM (SAE)": ("rpm", [800, 810]),
        "Mass Airflow": ("g/s", [5.5, 5.6]),
    }
    assert describe(path).kind == "HP Tuners"
    assert describe(path).tables[0].details == {"recorded": "7/7/2026 10:13:47 PM"}


SPARSE = ["0,1000,", "0.1,,50", "0.2,1200,", "0.3,,60", "0.4,1400,"]


def test_channels_sampled_by_turns_need_a_raster(log):
    path = log("Offset,RPM,Load", "s,rpm,%", *SPARSE)
    (message,) = findings(path)
    assert "different rasters: RPM every 0.2 s from 0 s, Load every 0.2 s from 0.1 s. Give a raster" in message
    data = read(path, raster=0.1)
    np.testing.assert_allclose(data["RPM"].values, np.interp(data.time, [0, 0.2, 0.4], [1000, 1200, 1400]))
    np.testing.assert_allclose(data["Load"].values, np.interp(data.time, [0.1, 0.3], [50, 60]))
    assert data.time[0] >= 0.1
    assert data.time[-1] <= 0.3 + 1e-9


def test_one_channel_of_them_is_read_at_its_own_times(log):
    data = read(log("Offset,RPM,Load", "s,rpm,%", *SPARSE), ["Load"])
    assert data.time.tolist() == [0.1, 0.3]
    assert data["Load"].values.tolist() == [50, 60]


def test_channels_of_one_pattern_come_together(log):
    rows = ["0,1,2,", "0.1,,,3", "0.2,4,5,", "0.3,,,6"]
    data = read(log("Offset,a,b,c", "s,,,", *rows), ["a", "b"])
    assert data.time.tolist() == [0, 0.2]
    assert data["b"].values.tolist() == [2, 5]


def test_the_description_counts_what_was_not_sampled_as_missing(log):
    channels = describe(log("Offset,RPM,Load", "s,rpm,%", *SPARSE)).tables[0].channels
    assert [(c.name, c.samples, c.nan_share) for c in channels[1:]] == [("RPM", 5, 0.4), ("Load", 5, 0.6)]


def test_a_late_first_sample_is_a_gap_and_no_raster_of_its_own(log):
    path = log("Offset,a,b", "s,,", "0.1,1,", "0.2,2,", "0.3,3,30", "0.4,4,40")
    np.testing.assert_array_equal(read(path)["b"].values, [np.nan, np.nan, 30, 40])


@pytest.mark.parametrize("name", ["MPVI2.1 -> AEM 30-(03x0,2340,5130)", "p [kPa, abs]", '"a, b"'])
def test_commas_within_a_name_do_not_shift_the_channels(log, name):
    data = read(log(f"Offset,{name},Load", "s,AFR,%", "0.1,14.7,50", "0.2,14.6,51"))
    assert list(data) == [name.strip('"'), "Load"]
    assert data["Load"].values.tolist() == [50, 51]


def test_a_comma_that_cannot_be_placed_is_a_finding(log):
    (message,) = findings(log("Offset,a,b,Load", "s,AFR,%", "0.1,14.7,50"))
    assert message == (
        "pull.csv line 10: there are 4 names for 3 channels: a name contains a comma. Put that name into quotes."
    )


def test_text_channels_are_left_out_unless_asked_for(log):
    path = log("Offset,RPM,Status", "s,rpm,", "0.1,800,OL - Not Ready", "0.2,810,CL - Normal")
    assert list(read(path)) == ["RPM"]
    assert "the column holds text, such as 'OL - Not Ready'" in findings(path, ["Status"])[0]


def test_text_among_numbers_a_missing_channel_and_a_long_row_are_findings(log):
    path = log("Offset,RPM,Load", "s,rpm,%", "0.1,800,50", "0.2,x,51", "0.3,820,52,7", "0.4,830,53")
    messages = findings(path)
    assert any("pull.csv line 15, column RPM: must be a number, got 'x'" in each for each in messages)
    assert any("pull.csv line 16: the row has 4 cells, the log 3 channels" in each for each in messages)
    assert "has no channel Lood. Did you mean Load?" in findings(path, ["Lood"])[0]


def test_names_that_come_twice_are_kept_apart(log):
    assert list(read(log("Offset,RPM,RPM", "s,rpm,rpm", "0.1,1,2", "0.2,3,4"))) == ["RPM", "RPM (2)"]


def test_a_channel_that_was_never_sampled_is_missing_throughout(log):
    path = log("Offset,RPM,Load", "s,rpm,%", "0.1,800,", "0.2,810,")
    assert np.isnan(read(path)["Load"].values).all()
    assert read(path, ["Load"]).samples == 2


@pytest.mark.parametrize("cut", [60, 150, 175, 200])
def test_a_log_that_is_cut_off_is_a_finding(csv, cut):
    text = HEAD + "0,1\nOffset,RPM\ns,rpm\n\n[Channel Data]\n"
    with pytest.raises(InputError, match=r"no rows below|no row of names"):
        read(csv(text[:cut], "pull.csv"))


@few_or_many_copies
def test_mutated_logs_give_data_or_findings(log, csv, count):
    chance = random.Random(22)
    content = log("Offset,RPM,AEM (0,1),Status", "s,rpm,%,", *[f"0.{k},{k},,on\n0.{k}5,,{k},OL" for k in range(9)])
    content = content.read_bytes()
    for _ in range(count):
        changed = bytearray(content)
        for _ in range(chance.randint(1, 5)):
            at = chance.randrange(len(changed))
            changed[at] = chance.choice([0, 10, 34, 44, 46, 91, 255, chance.randrange(256)])
        if chance.random() < 0.3:
            del changed[chance.randrange(len(changed)) :]
        path = csv(bytes(changed), "pull.csv")
        with contextlib.suppress(InputError):
            assert read(path, raster=0.05).samples
            describe(path)
