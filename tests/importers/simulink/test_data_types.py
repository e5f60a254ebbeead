"""Fixed-point and integer types: limits of those that saturate, and what is reported of the rest."""

import numpy as np
import pytest

from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.variables.data_types import FixedPointType, PlainType, UndefinedType, data_type
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.importers.simulink.variables.model_variables import collect_variables
from tests.importers.simulink.simulink_data import Thing, entry, matfile, sldd, thing
from tests.importers.simulink.simulink_files import Mask, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

SATURATES = {"SaturateOnIntegerOverflow": "on"}
TYPES = """
WL = 8; FL = 4;
T = fixdt(1, WL, FL);
N = Simulink.NumericType; N.DataTypeMode = 'Fixed-point: slope and bias scaling'; N.WordLength = 8;
N.Slope = 0.5; N.Bias = 2; N.Signedness = 'Unsigned';
A = Simulink.AliasType('T');
F = Simulink.AliasType; F.BaseType = 'single';
L = Simulink.AliasType; L.BaseType = 'boolean';
I = Simulink.NumericType; I.DataTypeMode = 'Boolean';
X = 'int8';
"""


def notes(model):
    return [str(note) for note in model.remarks]


def scope_of(folder, text=TYPES, *others):
    drawn = Model()
    drawn.inport("u")
    path = folder / "types.m"
    path.write_text(text)
    return Scope(collect_variables(read_document(drawn.write(folder)), [path, *others]))


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("fixdt(1,8,4)", FixedPointType(8, True, 0.0625)),
        ("fixdt(0,16,2^-4,0)", FixedPointType(16, False, 0.0625)),
        ("fixdt(1,16,0.5,-3,2)", FixedPointType(16, True, 0.0625, 2.0)),
        ("fixdt(1,WL,FL)", FixedPointType(8, True, 0.0625)),
        ("fixdt('int8')", FixedPointType(8, True)),
        ("fixdt(1,16,4,'DataTypeOverride','Off')", FixedPointType(16, True, 0.0625)),
        ("T", FixedPointType(8, True, 0.0625)),
        ("A", FixedPointType(8, True, 0.0625)),
        ("N", FixedPointType(8, False, 0.5, 2.0)),
        ("X", FixedPointType(8, True)),
        ("sfix16_En4", FixedPointType(16, True, 0.0625)),
        ("ufix8_S0p5_B2", FixedPointType(8, False, 0.5, 2.0)),
        ("uint(8)", FixedPointType(8, False)),
        ("sfrac(8)", FixedPointType(8, True, 2**-7)),
        ("float('single')", PlainType("single")),
        ("F", PlainType("single")),
        ("I", PlainType("boolean")),
        ("Missing", UndefinedType("Missing")),
        ("fixdt(1, Missing, 4)", UndefinedType("fixdt(1, Missing, 4)")),
        ("Inherit: Inherit via internal rule", None),
        ("Enum: Gear", None),
        ("Same as input", None),
        ("All ports same datatype", None),
        ("Logical (see Configuration Parameters: Optimization)", None),
    ],
)
def test_types_are_read_by_name_expression_and_object(written, expected, tmp_path):
    assert data_type(written, scope_of(tmp_path)) == expected


def test_type_objects_are_read_from_mat_files_and_dictionaries(tmp_path):
    fields = {"DataTypeMode": "Fixed-point: slope and bias scaling", "WordLength": 8.0, "FixedExponent": -4.0}
    (tmp_path / "a.mat").write_bytes(matfile({"M": Thing("Simulink.NumericType", fields)}))
    mode = entry("Fixed-point: binary point scaling", name="DataTypeMode")
    objects = {
        "D": thing("Simulink.NumericType", DataTypeMode=mode, WordLength=8.0, FractionLength=4.0),
        "E": thing("Simulink.AliasType", BaseType="D"),
    }
    (tmp_path / "b.sldd").write_bytes(sldd(objects))
    scope = scope_of(tmp_path, "", tmp_path / "a.mat", tmp_path / "b.sldd")
    assert [data_type(name, scope) for name in "MDE"] == [FixedPointType(8, True, 0.0625)] * 3


def test_the_limits_of_a_type_are_those_of_its_stored_integers():
    for kind in (FixedPointType(8, True, 0.0625), FixedPointType(8, False, 0.5, 2.0)):
        stored = np.arange(-128, 128) if kind.signed else np.arange(256)
        values = kind.slope * stored + kind.bias
        assert kind.limits == (values.min(), values.max())


@pytest.mark.parametrize(
    ("written", "lower", "upper"),
    [
        ("fixdt(1,8,4)", -8, 7.9375),
        ("A", -8, 7.9375),
        ("int8", -128, 127),
        ("N", 2, 129.5),
        ("double", -np.inf, np.inf),
    ],
)
def test_a_type_that_saturates_limits_the_output(written, lower, upper, tmp_path):
    scope_of(tmp_path)
    drawn = alone("Gain", Gain="0.3", OutDataTypeStr=written, **SATURATES)
    model = imported(drawn, tmp_path, parameters=[tmp_path / "types.m"])
    samples = np.array([1.0, 100.0, 0.1, -100.0, 1000.0, -1000.0])
    np.testing.assert_allclose(run(model, {"u1": samples})["y1"], np.clip(0.3 * samples, lower, upper))


def test_without_saturation_the_limits_are_reported(tmp_path):
    model = imported(alone("Gain", Gain="0.3", OutDataTypeStr="fixdt(1,8,4)"), tmp_path)
    np.testing.assert_allclose(run(model, {"u1": [100.0]})["y1"], [30.0])
    assert notes(model) == [
        "fixed-point types are ignored in B (steps of 0.0625 from -8 to 7.9375): Simulink rounds there, and wraps "
        "beyond their limits"
    ]


def test_each_kind_of_ignored_effect_is_reported_once_with_its_blocks(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", OutDataTypeStr="fixdt(1,16,2^-4,0)")
    kinds = {
        "A": ("fixdt(1,8,4)", "on"), "B": ("fixdt(1,8,2)", "on"), "C": ("fixdt(1,8,4)", "off"), "D": ("int8", "on"),
        "E": ("int16", "off"), "F": ("Missing", "off"), "G": ("single", "on"), "H": ("int8", "off"),
    }  # fmt: skip
    for name, (kind, saturates) in kinds.items():
        drawn.block("Gain", name, OutDataTypeStr=kind, SaturateOnIntegerOverflow=saturates)
    drawn.outport("y")
    drawn.chain("u", *kinds, "y")
    assert notes(imported(drawn, tmp_path)) == [
        "fixed-point types are ignored in A (steps of 0.0625 from -8 to 7.9375), B (steps of 0.25 from -32 to 31.75), "
        "except for their limits: Simulink rounds there",
        "fixed-point types are ignored in C (steps of 0.0625 from -8 to 7.9375): Simulink rounds there, and wraps "
        "beyond their limits",
        "integer types are ignored in D, except for their limits: Simulink rounds there",
        "integer types are ignored in E, H: Simulink rounds there, and wraps beyond their limits",
        "data types that are not defined are ignored in F (Missing): Simulink may round and limit values there",
        "single precision is ignored in G: generated code rounds there, as float32 = true does",
    ]


@pytest.mark.parametrize("written", ["Inherit: Same as input", "Inherit: Same as first input"])
def test_a_type_may_be_that_of_the_input(written, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", OutDataTypeStr="fixdt(1,8,4)")
    drawn.block("UnitDelay", "D", SampleTime="-1")
    drawn.block("Gain", "G", Gain="3", OutDataTypeStr=written, **SATURATES)
    drawn.outport("y")
    drawn.chain("u", "D", "G", "y")
    model = imported(drawn, tmp_path)
    np.testing.assert_allclose(run(model, {"u": [5.0, -5.0, 1.0]})["y"], [0, 7.9375, -8])
    assert notes(model) == [
        "fixed-point types are ignored in G (steps of 0.0625 from -8 to 7.9375), except for their limits: "
        "Simulink rounds there"
    ]


def test_a_type_may_be_that_of_the_accumulator(tmp_path):
    drawn = alone("Sum", 2, Inputs="++", OutDataTypeStr="Inherit: Same as accumulator", AccumDataTypeStr="int8",
                  **SATURATES)  # fmt: skip
    outputs = run(imported(drawn, tmp_path), {"u1": [100.0, -100.0], "u2": [100.0, -100.0]})
    np.testing.assert_array_equal(outputs["y1"], [127, -128])


def test_a_conversion_takes_the_type_that_its_reader_requires(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DataTypeConversion", "C", **SATURATES)
    drawn.outport("y", OutDataTypeStr="int8")
    drawn.chain("u", "C", "y")
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": [300.0, -300.0]})["y"], [127, -128])
    # a block that computes states nothing about its input
    drawn.block("Gain", "G", OutDataTypeStr="int16")
    drawn.outport("z")
    drawn.line("C", "G")
    drawn.chain("G", "z")
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": [300.0, -300.0]})["y"], [300, -300])


def test_a_file_of_an_old_release_states_type_and_scaling_separately(tmp_path):
    drawn = alone("Gain", OutDataTypeMode="Specify via dialog", OutDataType="sfix(8)", OutScaling="2^-4", **SATURATES)
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u1": [100.0, 1.0]})["y1"], [7.9375, 1])


def test_an_alias_of_boolean_converts_to_truth(tmp_path):
    scope_of(tmp_path)
    drawn = alone("DataTypeConversion", OutDataTypeStr="L")
    model = imported(drawn, tmp_path, parameters=[tmp_path / "types.m"])
    np.testing.assert_array_equal(run(model, {"u1": [0.0, 3.0, -2.0]})["y1"], [0, 1, 1])


def test_a_mask_may_hold_the_type(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("S", mask=Mask({"dt": "fixdt(1,8,4)"}))
    inner.inport("u")
    inner.block("Gain", "G", OutDataTypeStr="dt", **SATURATES)
    inner.outport("y")
    inner.chain("u", "G", "y")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": [100.0]})["y"], [7.9375])


@pytest.mark.parametrize("method", ["Forward Euler", "Backward Euler", "Trapezoidal"])
def test_the_state_of_an_integrator_does_not_wind_up_beyond_its_type(method, tmp_path):
    drawn = alone("DiscreteIntegrator", IntegratorMethod=f"Accumulation: {method}", SampleTime="0.1",
                  OutDataTypeStr="int8", **SATURATES)  # fmt: skip
    outputs = run(imported(drawn, tmp_path), {"u1": [100.0] * 4 + [-10.0] * 4})
    assert outputs["y1"].max() == 127
    # on the way down it leaves the limit at once
    assert outputs["y1"][-1] <= 127 - 25


def test_a_derivative_is_zero_at_a_limit_of_the_type(tmp_path):
    drawn = alone("Gain", Gain="K", OutDataTypeStr="fixdt(1,8,4)", **SATURATES)
    model = imported(drawn, tmp_path, parameters=[{"K": 0.3}])
    exact, differences = slopes(model, {"u1": [1.0, 100.0, -2.0]}, "K", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-6)
    np.testing.assert_allclose(exact[:, 0], [1, 0, -2])


def test_types_are_reported_with_every_import(tmp_path):
    report = import_simulink(alone("Gain", OutDataTypeStr="Missing").write(tmp_path)).report
    assert any("not defined are ignored in B (Missing)" in str(finding) for finding in report.remarks)


def test_a_boolean_constant_is_1_or_0(tmp_path):
    drawn = alone("Constant", inputs=0, Value="[100 0 -2]", OutDataTypeStr="boolean")
    outputs = run(imported(drawn, tmp_path), samples=1)
    assert [outputs[f"y1[{at}]"].item() for at in (1, 2, 3)] == [1.0, 0.0, 1.0]
