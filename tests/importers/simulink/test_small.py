"""Small blocks: wires that tell of a signal, conversions of units, flip-flops and counters."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run

RNG = np.random.default_rng(17)
COUNT = 40
U = RNG.normal(size=COUNT)
A, B, C = (RNG.random((3, COUNT)) > 0.5).astype(float)


def linked(kind, folder, columns, outputs=1, **parameters):
    drawn = alone("Reference", len(columns), outputs, special=kind, **parameters)
    return run(imported(drawn, folder), {f"u{at}": one for at, one in enumerate(columns, 1)})


# what is known of signals


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
def test_the_width_of_vectors_and_buses(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="3")
    drawn.inport("v")
    drawn.block("BusCreator", "Bus", ports=(2, 1), Inputs="2")
    drawn.block("Width", "W")
    drawn.block("Width", "WB")
    drawn.block("BusToVector", "V", ports=(1, 1))
    drawn.block("Sum", "S", ports=(1, 1), Inputs="+")
    for name, source in (("w", "W"), ("wb", "WB"), ("s", "S")):
        drawn.outport(name)
        drawn.line(source, name)
    drawn.line("u", "W", "Bus:1")
    drawn.line("v", "Bus:2")
    drawn.line("Bus", "WB", "V")
    drawn.line("V", "S")
    columns = {"u[1]": U, "u[2]": 2 * U, "u[3]": 3 * U, "v": U}
    outputs = run(imported(drawn, tmp_path, layout), columns)
    assert (outputs["w"] == 3).all()
    assert (outputs["wb"] == 4).all()
    np.testing.assert_allclose(outputs["s"], 7 * U)


def test_a_probe_returns_what_it_is_asked_for(tmp_path):
    drawn = alone("Probe", 1, 4)
    drawn.blocks[1].parameters |= {"PortDimensions": "[2 3]", "SampleTime": "0.2"}
    outputs = run(imported(drawn, tmp_path), {f"u1[{at}]": U for at in range(1, 7)})
    values = [outputs[name][0] for name in ("y1", "y2[1]", "y2[2]", "y3", "y4[1]", "y4[2]")]
    assert values == [6, 0.2, 0, 0, 2, 3]
    asked = alone("Probe", 1, 1, ProbeSampleTime="off", ProbeComplexSignal="off", ProbeSignalDimensions="off")
    assert run(imported(asked, tmp_path), {"u1": U})["y1"][0] == 1
    with pytest.raises(InputError, match="it outputs the sample time of a signal that does not specify one"):
        imported(alone("Probe", 1, 4), tmp_path)


def test_real_signals_have_parts_like_complex_ones(tmp_path):
    outputs = run(imported(alone("ComplexToRealImag", 1, 2), tmp_path), {"u1": U})
    np.testing.assert_array_equal(outputs["y1"], U)
    assert not outputs["y2"].any()
    outputs = run(imported(alone("ComplexToMagnitudeAngle", 1, 2), tmp_path), {"u1": U})
    np.testing.assert_array_equal(outputs["y1"], np.abs(U))
    np.testing.assert_array_equal(outputs["y2"], np.angle(U))


REFUSED = [
    ("RealImagToComplex", 2, {}, "its output is complex"),
    ("AlgebraicConstraint", 1, {}, "it solves for a value that makes its input 0"),
    ("MATLABFcn", 1, {"MATLABFcn": "besselj(1,u)"}, r"it calls besselj\(1,u\) in MATLAB in each step"),
    ("UnitConversion", 1, {}, "it converts between the units of ports"),
]


@pytest.mark.parametrize(("kind", "inputs", "parameters", "reason"), REFUSED)
def test_blocks_that_a_graph_cannot_express_are_refused_with_the_reason(kind, inputs, parameters, reason, tmp_path):
    with pytest.raises(InputError, match=f"B: {reason}"):
        imported(alone(kind, inputs, **parameters), tmp_path)


def test_wires_that_only_matter_to_types_and_code(tmp_path):
    for kind, at in (("Conversion Inherited", 1), ("Environment Controller", 0)):
        columns = [U, -2 * U]
        np.testing.assert_array_equal(linked(kind, tmp_path, columns)["y1"], columns[at])


def test_checks_and_notes_are_passed_over(tmp_path):
    drawn = alone("Gain", Gain="2")
    drawn.link("Check", "simulink/Model Verification/Check Static Lower Bound", "Checks_SMin", ports=(1, 0), min="0")
    drawn.link("Info", "simulink/Model-Wide Utilities/Model Info", "CMBlock", ports=(0, 0))
    drawn.wires[0].ends.append(("Check", "in", 1))
    result = import_simulink(drawn.write(tmp_path))
    assert result.report.whole
    assert result.report.supported == result.report.total
    checked = alone("Reference", 1, 1, special="Checks_SMin", export="on")
    with pytest.raises(InputError, match="it outputs the result of its check, which is not supported"):
        imported(checked, tmp_path)


# units


UNITS = [
    ("Angle Conversion", "deg", "rad", np.radians),
    ("Angle Conversion", "rev", "deg", lambda u: 360 * u),
    ("Angular Velocity Conversion", "rpm", "rad/s", lambda u: u * np.pi / 30),
    ("Velocity Conversion", "km/h", "m/s", lambda u: u / 3.6),
    ("Velocity Conversion", "mph", "km/h", lambda u: u * 1.609344),
    ("Pressure Conversion", "psi", "Pa", lambda u: u * 6894.757293168),
    ("Pressure Conversion", "Pa", "atm", lambda u: u / 101325),
    ("Temperature Conversion", "C", "K", lambda u: u + 273.15),
    ("Temperature Conversion", "F", "C", lambda u: (u - 32) / 1.8),
    ("Temperature Conversion", "K", "R", lambda u: u * 1.8),
    ("Mass Conversion", "slug", "kg", lambda u: u * 14.593902937),
    ("Force Conversion", "lbf", "N", lambda u: u * 4.4482216152605),
    ("Length Conversion", "naut mi", "km", lambda u: u * 1.852),
    ("Density Conversion", "lbm/ft^3", "kg/m^3", lambda u: u * 16.018463374),
    ("Acceleration Conversion", "G''s", "m/s^2", lambda u: u * 9.80665),
]


@pytest.mark.parametrize(("kind", "unit", "wanted", "rule"), UNITS)
def test_units_are_converted(kind, unit, wanted, rule, tmp_path):
    output = linked(kind, tmp_path, [U], IU=unit, OU=wanted)["y1"]
    np.testing.assert_allclose(output, rule(U), rtol=1e-9, atol=1e-12)


def test_an_unknown_unit_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"unknown unit 'furlong' in IU. Known units: m, km, ft"):
        linked("Length Conversion", tmp_path, [U], IU="furlong", OU="m")


def test_transformations_of_the_library(tmp_path):
    np.testing.assert_allclose(linked("DegreesToRadians", tmp_path, [U])["y1"], np.radians(U))
    np.testing.assert_allclose(linked("RadiansToDegrees", tmp_path, [U])["y1"], np.degrees(U))
    np.testing.assert_allclose(linked("Fahrenheit to Celsius", tmp_path, [U])["y1"], (U - 32) / 1.8)
    np.testing.assert_allclose(linked("Celsius to Fahrenheit", tmp_path, [U])["y1"], U * 1.8 + 32)
    polar = linked("Cartesian to Polar", tmp_path, [U, C + 1], 2)
    back = linked("Polar to Cartesian", tmp_path, [polar["y1"], polar["y2"]], 2)
    np.testing.assert_allclose([polar["y1"], back["y1"], back["y2"]], [np.hypot(U, C + 1), U, C + 1])


def test_a_block_of_the_library_goes_by_its_name_where_its_type_is_not_known(tmp_path):
    drawn = alone("Reference", special="Some Mask Of A Release")
    drawn.blocks[0].parameters["SourceBlock"] = "simulink_extras/Transformations/Degrees to\nRadians"
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u1": U})["y1"], np.radians(U))


@pytest.mark.parametrize("called", ["Degrees to Radians", "Integrator", "Gain", "Switch", "Control"])
def test_a_subsystem_whose_mask_is_called_like_a_block_is_looked_into(called, tmp_path):
    from tests.importers.simulink.simulink_files import Mask

    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("S", mask=Mask({"k": "5"}, type=called))
    inner.inport("x")
    inner.block("Gain", "G", Gain="k")
    inner.outport("z")
    inner.chain("x", "G", "z")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": U})["y"], 5 * U)


# logic with memory


def test_a_row_of_a_truth_table_is_chosen_by_its_digits(tmp_path):
    table = RNG.integers(0, 9, size=(8, 2))
    drawn = alone("CombinatorialLogic", TruthTable=np.array2string(table, separator=" ").replace("]\n", "];"))
    drawn.blocks[1].parameters["PortDimensions"] = "3"
    outputs = run(imported(drawn, tmp_path), {"u1[1]": A, "u1[2]": B, "u1[3]": C})
    rows = (4 * A + 2 * B + C).astype(int)
    np.testing.assert_array_equal(outputs["y1[1]"], table[rows, 0])
    np.testing.assert_array_equal(outputs["y1[2]"], table[rows, 1])
    drawn.blocks[1].parameters["PortDimensions"] = "2"
    with pytest.raises(InputError, match="a table of 8 rows does not match 2 inputs"):
        imported(drawn, tmp_path)


# next Q and !Q by S, R and Q
TABLE = {(0, 0, 0): (0, 1), (0, 0, 1): (1, 0), (0, 1, 0): (0, 1), (0, 1, 1): (0, 1),
         (1, 0, 0): (1, 0), (1, 0, 1): (1, 0), (1, 1, 0): (0, 0), (1, 1, 1): (0, 0)}  # fmt: skip


@pytest.mark.parametrize("init", [0, 1])
def test_a_flip_flop_is_set_and_reset(init, tmp_path):
    outputs = linked("SRFlipFlop", tmp_path, [A, B], 2, initial_condition=str(init))
    q = init
    for k in range(COUNT):
        q, other = TABLE[int(A[k]), int(B[k]), q]
        assert (outputs["y1"][k], outputs["y2"][k]) == (q, other), k


def test_flip_flops_with_a_clock(tmp_path):
    clock = np.array([0.0, 1, 0, 0, 1, 1, 0, 1] * 5)
    kept = (RNG.random(COUNT) > 0.2).astype(float)
    latch, flip = linked("D Latch", tmp_path, [A, clock], 2), linked("D Flip-Flop", tmp_path, [A, clock, kept], 2)
    jk = linked("J-K Flip-Flop", tmp_path, [A, clock, B], 2, initial_condition="1")
    ql, qf, qj = 0, 0, 1
    for k in range(COUNT):
        rises, falls = k > 0 and clock[k] > clock[k - 1], k > 0 and clock[k] < clock[k - 1]
        ql = A[k] if clock[k] else ql
        qf = (A[k] if rises else qf) * kept[k]
        if falls:
            qj = {(0, 0): qj, (0, 1): 0, (1, 0): 1, (1, 1): 1 - qj}[int(A[k]), int(B[k])]
        assert (latch["y1"][k], flip["y1"][k], jk["y1"][k]) == (ql, qf, qj), k
        assert (latch["y2"][k], flip["y2"][k], jk["y2"][k]) == (1 - ql, 1 - qf, 1 - qj), k


def test_counters_run_at_their_sample_time_and_begin_again(tmp_path):
    drawn = alone("Reference", 0, special="Counter Free-Running", NumBits="3", tsamp="-1")
    assert run(imported(drawn, tmp_path), samples=20)["y1"].tolist() == [k % 8 for k in range(20)]
    drawn = alone("Reference", 0, special="Counter Limited", uplimit="2", tsamp="0.2")
    assert run(imported(drawn, tmp_path), samples=20)["y1"].tolist() == [k // 2 % 3 for k in range(20)]


@pytest.mark.parametrize("op", ["min", "max"])
def test_a_running_extreme_is_reset(op, tmp_path):
    reset = np.array([0.0, 0, 0, 1, 0] * 8)
    output = linked("MinMax Running Resettable", tmp_path, [U, reset], Function=op, vinit="0.1")["y1"]
    best = 0.1
    for k in range(COUNT):
        best = 0.1 if reset[k] else {"min": min, "max": max}[op](best, U[k])
        assert output[k] == best, k


def test_counting_down_stops_at_0(tmp_path):
    for kind, rule in (
        ("Increment Real World", U + 1),
        ("Decrement Real World", U - 1),
        ("Stored Integer Value Increment", U + 1),
        ("Stored Integer Value Decrement", U - 1),
        ("Decrement To Zero", np.maximum(U - 1, 0)),
        ("Decrement Time To Zero", np.maximum(U - 0.1, 0)),
    ):
        np.testing.assert_allclose(linked(kind, tmp_path, [U])["y1"], rule, atol=1e-15)


@pytest.mark.parametrize(("kind", "step"), [("fixdt(1,16,2)", 0.25), ("int8", 1.0), ("single", 1.0)])
def test_a_stored_integer_counts_up_by_the_step_of_its_type(kind, step, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DataTypeConversion", "C", OutDataTypeStr=kind)
    drawn.block("Reference", "R", SourceType="Stored Integer Value Increment", SourceBlock="simulink/Increment")
    drawn.outport("y")
    drawn.chain("u", "C", "R", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": U})["y"], U + step)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
def test_an_inport_may_be_drawn_more_than_once(layout, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("v")
    drawn.block("InportShadow", "v again", Port="2")
    inner = drawn.subsystem("S")
    inner.inport("a")
    inner.inport("b")
    inner.block("InportShadow", "b again", Port="2")
    inner.block("Sum", "T", ports=(3, 1), Inputs="++-")
    inner.outport("z")
    for at, name in enumerate(("a", "b", "b again"), 1):
        inner.line(name, f"T:{at}")
    inner.line("T", "z")
    drawn.block("Product", "P", ports=(2, 1))
    drawn.outport("y")
    drawn.outport("w")
    drawn.line("u", "S:1")
    drawn.line("v", "S:2", "P:1")
    drawn.line("v again", "P:2")
    drawn.chain("S", "y")
    drawn.line("P", "w")
    outputs = run(imported(drawn, tmp_path, layout), {"u": U, "v": A})
    np.testing.assert_allclose(outputs["y"], U)
    np.testing.assert_allclose(outputs["w"], A * A)


def test_a_multiport_switch_takes_the_last_port_for_any_other_number(tmp_path):
    number = np.array([-2.0, 0.0, 0.9, 1.0, 1.9, 2.0, 3.0, 4.0])
    columns = {"u1": number} | {f"u{at}": np.full(8, 10.0 * at) for at in (2, 3, 4)}
    output = run(imported(alone("MultiPortSwitch", 4, Inputs=3), tmp_path), columns)["y1"]
    assert output.tolist() == [40, 40, 40, 20, 20, 30, 40, 40]
    zero = alone("MultiPortSwitch", 4, Inputs=3, DataPortOrder="Zero-based contiguous")
    assert run(imported(zero, tmp_path), columns)["y1"].tolist() == [40, 20, 20, 30, 30, 40, 40, 40]


@pytest.mark.parametrize("default", ["Last data port", "Additional data port"])
def test_the_numbers_of_a_multiport_switch_may_be_listed(default, tmp_path):
    number = np.array([-2.0, 7.0, 3.0, 4.0, 5.5, 1.0])
    extra = default.startswith("Additional")
    drawn = alone("MultiPortSwitch", 4, Inputs=2 if extra else 3, DataPortOrder="Specify indices",
                  DataPortIndices="{[3 -2],5}" if extra else "{[3 -2],5,k}", DataPortForDefault=default)  # fmt: skip
    columns = {"u1": number} | {f"u{at}": np.full(6, 10.0 * at) for at in (2, 3, 4)}
    output = run(imported(drawn, tmp_path, parameters=[{"k": 4.0}]), columns)["y1"]
    assert output.tolist() == [20, 40, 20, 40, 30, 40]
    with pytest.raises(InputError, match="DataPortIndices must be a list of cases in braces, got 3"):
        imported(alone("MultiPortSwitch", 4, DataPortOrder="Specify indices", DataPortIndices="3"), tmp_path)


@pytest.mark.parametrize(
    ("kind", "inputs", "parameters", "reason"),
    [
        ("MultiPortSwitch", 1, {}, "it has no data port"),
        ("Gain", 1, {"Gain": "[]"}, "its Gain is empty"),
        ("PermuteDimensions", 1, {"Order": "nan"}, "its Order nan is not"),
        ("CombinatorialLogic", 1, {"TruthTable": "[]"}, "a table of 0 rows does not match 1 inputs"),
        ("MultiPortSwitch", 3, {"DataPortOrder": "Specify indices", "DataPortIndices": "{1:2e4,2}"}, "at most"),
    ],
)
def test_settings_without_a_meaning_are_reported(kind, inputs, parameters, reason, tmp_path):
    with pytest.raises(InputError, match=f"B: .*{reason}"):
        imported(alone(kind, inputs, **parameters), tmp_path)


def test_an_unsupported_block_without_readers_is_reported(tmp_path):
    drawn = alone("Gain", Gain="2")
    drawn.block("RandomNumber", "Noise", ports=(0, 1))
    drawn.block("Terminator", "End")
    drawn.line("Noise", "End")
    report = import_simulink(drawn.write(tmp_path)).report
    assert report.whole
    assert [(one.path, one.why) for one in report.unsupported] == [
        ("Noise", "its signal is random and not part of the model")
    ]


def test_the_blocks_of_a_dashboard_are_passed_over(tmp_path):
    drawn = alone("Gain", Gain="2")
    for kind in ("LampBlock", "KnobBlock", "EditField", "LinearGaugeBlock"):
        drawn.block(kind, kind, ports=(0, 0))
    report = import_simulink(drawn.write(tmp_path)).report
    assert report.supported == report.total
    assert report.whole
