"""Channels in other units than the function has for them."""

import numpy as np
import pytest

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Scalar

SPEED = np.array([1000.0, 1500, 2000, 2500, 3000, 1200])
OMEGA = SPEED * np.pi / 30


def data(shop, which=0):
    assert shop.errors() == []
    return shop.project.problem().datasets[which]


def in_radians(shop, name="bench.csv"):
    shop.bench(name, **{"n [rpm]": None, "n [rad/s]": OMEGA})
    return shop


def test_an_input_is_converted_to_the_unit_of_the_function(shop):
    channel = data(in_radians(shop))["n"]
    assert channel.values == pytest.approx(SPEED, rel=1e-12)
    assert channel.unit == "rpm"


def test_a_conversion_is_reported_once_as_a_remark(shop):
    for name in ("bench.csv", "bench2.csv"):
        in_radians(shop, name)
    finding, copies = shop.change('"bench.csv"', '"bench*.csv"').findings()
    assert "have the same inputs and targets" in copies.message
    assert finding.severity == "remark"
    message = "channel n is converted from rad/s to rpm, the unit of the input Speed"
    assert str(finding) == f"bench.csv and 1 more: {message}"


def test_a_target_is_converted_to_the_unit_of_its_node(shop):
    torque = data(shop)["Torque"].values
    shop.bench("bench.csv", **{"Torque [Nm]": None, "Torque [kNm]": torque / 1000})
    channel = data(shop)["Torque"]
    assert channel.values == pytest.approx(torque, rel=1e-12)
    assert channel.unit == "Nm"


def test_a_temperature_is_shifted(shop):
    shop.text = shop.text.replace("input Load", "input Load[K]")
    shop.bench("bench.csv", **{"Load": None, "Load [Grad C]": [0.0, 10, 20, 30, 40, 50]})
    assert data(shop)["Load"].values.tolist() == [273.15, 283.15, 293.15, 303.15, 313.15, 323.15]


def test_missing_values_stay_missing(shop):
    shop.bench("bench.csv", **{"Torque [Nm]": None, "Torque [kNm]": [1.0, np.nan, 3, 4, 5, 6]})
    assert np.isnan(data(shop)["Torque"].values).tolist() == [False, True, False, False, False, False]


def test_a_channel_without_a_unit_is_not_converted(shop):
    for unit in ("n", "n [-]"):
        shop.bench("bench.csv", **{"n [rpm]": None, unit: SPEED})
        assert data(shop)["n"].values.tolist() == SPEED.tolist()
        assert shop.findings() == []


def test_a_unit_can_be_stated_if_the_file_has_none_or_a_wrong_one(shop):
    for unit in ("n", "n [Nm]"):
        shop.bench("bench.csv", **{"n [rpm]": None, unit: OMEGA})
        shop.toml = shop.toml.split("\n[units]")[0]
        shop.add('[units]\nn = "rad/s"')
        assert data(shop)["n"].values == pytest.approx(SPEED, rel=1e-12)
        assert data(shop)["n"].unit == "rpm"
        assert [f.severity for f in shop.findings()] == ["remark"]


def test_a_channel_with_a_dash_as_its_unit_is_not_converted(shop):
    in_radians(shop).add('[units]\nn = "-"')
    assert data(shop)["n"].values.tolist() == OMEGA.tolist()
    assert not [f for f in shop.findings() if "unit" in f.message or "rad/s" in f.message]


def test_a_unit_stated_for_an_unused_channel_is_an_error(shop):
    error = shop.add('[units]\nTorqe = "Nm"').error()
    assert error == "kennfeld.toml [units] Torqe: channel Torqe is not used. Did you mean Torque?"


def test_a_function_that_cannot_be_read_adds_no_finding_on_units(shop):
    shop.text = "y = (\n"
    shop.change('Speed = "n"', 'Speed = "n"\n[units]\nn = "rad/s"')
    assert not [error for error in shop.errors() if "[units]" in error]


def test_a_unit_can_be_stated_for_a_calculated_channel(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "omega [rad/s]": OMEGA})
    shop.add('[calculated]\nn = "omega * 30 / pi"\n[units]\nn = "Nm"')
    assert "channel n is in Nm, but the input Speed of the function is in rpm, a different quantity" in shop.warning()
    assert data(shop)["n"].values == pytest.approx(SPEED)


def test_a_channel_of_calculated_ones_alone_keeps_the_unit_of_the_file(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "omega [rad/s]": OMEGA})
    shop.add('[calculated]\nn = "omega * 30 / pi"')
    assert data(shop)["n"].values == pytest.approx(SPEED)
    assert data(shop)["omega"].values.tolist() == OMEGA.tolist()


def test_formulas_use_the_new_unit_of_a_converted_channel_with_a_finding(shop):
    in_radians(shop).change('files = ["bench.csv"]', 'files = ["bench.csv"]\nwhere = "n > 2100"')
    assert data(shop).scored.tolist() == (SPEED > 2100).tolist()
    assert [f.message for f in shop.findings() if f.severity == "remark"] == [
        "channel n is converted from rad/s to rpm, the unit of the input Speed; formulas read n in rpm"
    ]
    shop.add('[calculated]\ndouble = "2 * n"')
    shop.change('target = "Torque"', 'target = "double"')
    assert data(shop)["double"].values == pytest.approx(2 * SPEED)


def test_a_region_over_a_converted_channel_has_a_finding(shop):
    in_radians(shop).change('target = "Torque"', 'target = "Torque"\nregions = [{ where = "n > 2100", weight = 2 }]')
    assert shop.warning().endswith("the unit of the input Speed; formulas read n in rpm")


def test_each_file_of_a_dataset_is_converted_to_the_unit_of_the_function(shop):
    in_radians(shop, "bench2.csv")
    joined = data(shop.change('"bench.csv"', '"bench*.csv"'))["n"]
    assert joined.values == pytest.approx([*SPEED, *SPEED], rel=1e-12)
    assert joined.unit == "rpm"


def test_files_are_converted_to_the_unit_of_the_first_if_the_function_has_none(shop):
    shop.bench("bench.csv", **{"Load": None, "Load [bar]": [1.0, 2, 3, 4, 5, 6]})
    shop.bench("bench2.csv", **{"Load": None, "Load [mbar]": [1000.0, 2000, 3000, 4000, 5000, 6000]})
    joined = data(shop.change('"bench.csv"', '"bench*.csv"'))["Load"]
    assert joined.values == pytest.approx([1, 2, 3, 4, 5, 6] * 2)
    assert joined.unit == "bar"
    assert "bench2.csv: channel Load is converted from mbar to bar, the unit of bench.csv" in shop.warnings()[0]


def test_datasets_are_converted_to_a_common_unit_if_the_function_has_none(shop):
    shop.bench("bench.csv", **{"Load": None, "Load [bar]": [1.0, 2, 3, 4, 5, 6]})
    shop.bench("other.csv", **{"Load": None, "Load [mbar]": [1000.0, 2000, 3000, 4000, 5000, 6000]})
    shop.add('[[dataset]]\nfiles = "other.csv"')
    assert data(shop, 1)["Load"].values == pytest.approx([1, 2, 3, 4, 5, 6])


def test_a_channel_of_two_inputs_in_two_units_is_converted_for_the_first(shop):
    shop.text = shop.text.replace("input Load", "input Load\ninput Omega[rad/s]").replace(
        "+ offset", "+ offset + Omega"
    )
    shop.change('Speed = "n"', 'Speed = "n"\nOmega = "n"')
    assert data(shop)["n"].values.tolist() == SPEED.tolist()
    warning = shop.warning()
    assert "channel n is in rpm, but the input Omega of the function is in rad/s. Convert it" in warning


def test_an_input_takes_precedence_over_a_target(shop):
    shop.text = shop.text.replace("Predict[Nm]", "Predict[rad/s]")
    shop.change('target = "Torque"', 'target = "n"')
    assert data(shop)["n"].unit == "rpm"
    assert "channel n is in rpm, but the node Predict of the function is in rad/s" in shop.warning()


LAG = np.where(np.arange(60) < 3, 0.0, 1 - 0.9 ** (np.arange(60) - 2.0))  # PT1 of T = 0.9 s at steps of 0.1 s


def lagging(shop, head="Time", factor=1000, **columns):
    """A project on a PT1 of 0.9 s, its time in milliseconds."""
    shop.text = "y = PT1(u, T, 0)\n"
    shop.toml = (
        '[model]\nfile = "sensor.kf"\n[[dataset]]\nfiles = ["drive.csv"]\n[[criterion]]\nnode = "y"\ntarget = "z"\n'
        "[parameters.T]\ninitial = 0.5\n"
    )
    time = np.round(0.1 * factor * np.arange(60), 12)
    shop.csv("drive.csv", {head: time, "u": (np.arange(60) >= 3).astype(float), "z": LAG, **columns})
    return shop


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("min", 1 / 60), ("h", 1 / 3600)])
def test_the_unit_of_the_time_may_be_stated(shop, unit, factor):
    project = lagging(shop, factor=factor).add(f'[units]\nTime = "{unit}"')
    assert project.findings() == []
    assert project.project.calibrate().parameters["T"].value == pytest.approx(0.9, rel=1e-6)


def test_a_unit_of_time_in_the_file_gives_the_right_time_constant(shop):
    project = lagging(shop, "Time [ms]")
    assert project.findings() == []
    assert project.project.calibrate().parameters["T"].value == pytest.approx(0.9, rel=1e-6)


def test_time_that_looks_like_milliseconds_is_a_warning(shop):
    message = "the time stamps look like milliseconds: Time has no unit and is read as s, and its steps are long"
    remedy = 'If they are, write [units] Time = "ms", else "s"; in Python kennfeld.read(..., units={"Time": "ms"}).'
    assert f"kennfeld.toml [[dataset]] 1 (drive): {message}. {remedy}" in lagging(shop).warnings()
    assert lagging(shop).add('[units]\nTime = "s"').findings() == []


def test_the_unit_of_the_time_is_irrelevant_to_a_function_without_memory(shop):
    lagging(shop).text = "y = T * u\n"
    assert not [warning for warning in shop.warnings() if "milliseconds" in warning]


def test_the_unit_of_the_time_may_differ_from_file_to_file(shop):
    lagging(shop).csv("second.csv", {"time [s]": [0, 0.1], "u": [0, 1], "z": [0, 0.1]})
    shop.change('"drive.csv"', '"drive.csv", "second.csv"').add('[units]\nTime = "ms"')
    assert shop.findings() == []
    assert shop.project.problem().datasets[0].time[[1, -1]].tolist() == [0.1, 0.1]


def test_the_unit_of_the_time_counts_for_a_raster_and_survives_the_cache(shop):
    lagging(shop).change('files = ["drive.csv"]', 'files = ["drive.csv"]\nraster = 0.2').add('[units]\nTime = "ms"')
    for _ in range(2):
        assert shop.project.problem().datasets[0].samples == 30


def test_a_time_cannot_be_in_another_quantity(shop):
    error = lagging(shop).add('[units]\nTime = "rpm"').error()
    assert (
        error == "kennfeld.toml [units] Time: rpm is not a unit of time, but Time is the time column. "
        "Write s, ms, us, ns, min or h."
    )


def test_a_misspelt_name_of_the_time_is_a_finding(shop):
    error = lagging(shop).add('[units]\nTim = "ms"').error()
    assert error == "kennfeld.toml [units] Tim: channel Tim is not used. Did you mean Time?"


def test_the_unit_of_an_axis_is_compared_with_that_of_the_function(shop):
    shop.values(
        "start.json", Curve("Gain", Axis([1, 2, 3], input="Speed", unit="rad/s"), [1.0] * 3), Scalar("offset", 0)
    )
    unit, outside = shop.warnings()
    assert "axis x of Gain is in rad/s, but the input Speed of the function is in rpm. Correct the unit" in unit
    assert "outside the axis" in outside


def test_the_unit_of_an_axis_is_compared_with_that_of_a_channel(shop):
    shop.text = shop.text.replace("input Speed[rpm]", "input Speed")
    start = [Curve("Gain", Axis(OMEGA[:5], input="Speed", unit="rad/s"), [1.0] * 5), Scalar("offset", 0)]
    shop.values("start.json", *start)
    unit, _ = shop.warnings()
    assert "axis x of Gain is in rad/s, but channel n of dataset bench is in rpm" in unit
    assert "State the unit of Speed in the function, `input Speed[rad/s]`, so that the data are converted." in unit
