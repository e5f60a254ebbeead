"""Units as engineers of engines spell them."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kennfeld.preprocessing.units import UnitConversion, compare_units, is_unit_missing

SAME = [
    "rpm 1/min min-1 min^-1 U/min Upm rev/min RPM r/min min⁻¹ 1/Min",
    "deg ° Grad °KW °CA degree degCA °CrK deg_crk",
    "°C degC Deg_C celsius C GradC ºC ˚C ℃",
    "Nm N*m N.m nm N·m N⋅m",
    "mg/hub mg/stk mg/Hub mg/str mg/stroke mg/Inj",
    "% pct Prozent percent",
    "kg/h kg/hr kg/Std",
    "s sec Sek seconds",
    "µs us usec",
    "km/h kmh kph",
    "m3/h m³/h m^3/h",
    "mbar hPa hpa mBar",
    "W/(m²*K) W/m²/K",
    "lambda λ Lambda",
    "V Volt v",
    "V*K/°C V*°C/K V",
    "K kelvin k",
]


@pytest.mark.parametrize("spellings", SAME)
def test_spellings_of_one_unit_are_the_same(spellings):
    first, *others = spellings.split()
    for other in others:
        assert compare_units(first, other) == compare_units(other, first) == "same", other


def test_blanks_in_a_unit_do_not_matter():
    assert compare_units("Grad C", "deg C") == compare_units("kg / h", "kg/h") == compare_units("N m", "Nm") == "same"


@pytest.mark.parametrize(
    ("source", "target", "value", "expected"),
    [
        ("1/min", "rad/s", 60.0, 2 * np.pi),
        ("rad/s", "rpm", np.pi, 30.0),
        ("°C", "K", 20.0, 293.15),
        ("K", "degC", 0.0, -273.15),
        ("°F", "°C", 212.0, 100.0),
        ("degC/s", "K/min", 1.0, 60.0),
        ("kNm", "Nm", 1.5, 1500.0),
        ("lbft", "Nm", 1.0, 1.3558179483314),
        ("bar", "hPa", 1.0, 1000.0),
        ("psi", "kPa", 1.0, 6.894757293168),
        ("mmHg", "mbar", 1.0, 1.33322387415),
        ("kg/h", "g/s", 3.6, 1.0),
        ("g/Hub", "mg/stk", 1.0, 1000.0),
        ("PS", "kW", 1.0, 0.73549875),
        ("ms", "s", 1.0, 0.001),
        ("mV", "V", 1.0, 0.001),
        ("°KW", "rad", 180.0, np.pi),
        ("%", "ppm", 1.0, 1e4),
        ("‰", "%", 1.0, 0.1),
        ("°KW/s", "rpm", 6.0, 1.0),
        ("g/kWh", "kg/kWh", 1.0, 1e-3),
        ("km/h", "m/s", 3.6, 1.0),
        ("l/min", "m3/h", 1.0, 0.06),
    ],
)
def test_values_are_converted(source, target, value, expected):
    conversion = compare_units(source, target)
    assert isinstance(conversion, UnitConversion)
    assert conversion.of(value) == pytest.approx(expected, rel=1e-12)


def test_round_factors_are_exact():
    assert compare_units("kNm", "Nm") == UnitConversion(1000.0)
    assert compare_units("degC", "K") == UnitConversion(1.0, 273.15)
    assert compare_units("bar", "mbar") == UnitConversion(1000.0)


@pytest.mark.parametrize(
    "pair",
    [
        "rpm Nm",
        "rpm Hz",
        "rpm 1/s",
        "mg/hub kg/h",
        "lambda AFR",
        "K rad",
        "bar V",
        "mg/cyc mg/stk",
        "deg %",
        "deg/s 1/s",
    ],
)
def test_units_of_other_quantities_contradict_each_other(pair):
    one, other = pair.split()
    assert compare_units(one, other) == compare_units(other, one) == "contrary"


@pytest.mark.parametrize("unit", ["FSN", "ticks", "l/100km", "barg", "°", "__import__('os')", "9**9**9", "m^99", "((("])
def test_an_unknown_unit_cannot_be_compared(unit):
    assert compare_units(unit, "FSN2") == "unknown"


@pytest.mark.parametrize("pair", ["dB %", "dBm W", "degRe K", "Np %", "dB/s %/s", "count %", "bit %"])
def test_units_that_differ_by_more_than_a_factor_count_as_unknown(pair):
    one, other = pair.split()
    assert compare_units(one, other) == compare_units(other, one) == "unknown"


@pytest.mark.parametrize("unit", ["", "-", "[-]", "1", "--", "none", " - "])
def test_a_placeholder_unit_is_not_compared(unit):
    assert is_unit_missing(unit)
    assert compare_units(unit, "rpm") == compare_units("rpm", unit) == "unknown"


@settings(deadline=None, max_examples=40)
@given(st.text(max_size=60))
def test_any_text_is_some_unit(text):
    assert compare_units(text, text) in ("same", "unknown")
    assert isinstance(compare_units(text, "Nm"), UnitConversion | str)


KNOWN = "rpm rad/s Nm kNm °C K °F bar mbar kPa psi kg/h g/s mg/stk g/stk ms s PS kW deg rad"
units = st.sampled_from(KNOWN.split())


@given(units, units, st.floats(-1e3, 1e3))
def test_there_and_back_is_where_it_began(one, other, value):
    there, back = compare_units(one, other), compare_units(other, one)
    if isinstance(there, UnitConversion):
        assert isinstance(back, UnitConversion)
        assert back.of(there.of(value)) == pytest.approx(value, rel=1e-9, abs=1e-9)
    else:
        assert there == back


def test_equal_units_are_compared_without_the_registry():
    code = "import sys; from kennfeld.preprocessing.units import compare_units\n"
    code += "assert compare_units('1/min', 'rpm') == 'same' and compare_units('', 'Nm') == 'unknown'\n"
    code += "assert compare_units('degC', 'K').offset\n"
    code += "assert 'pint' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
