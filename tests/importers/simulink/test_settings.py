"""Settings of blocks that change a result: followed, or refused with the reason."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported, run

U = np.random.default_rng(17).normal(size=30)

FRAMES = {"InputProcessing": "Columns as channels (frame based)"}
STORED = {"ConvertRealWorld": "Stored Integer (SI)"}
STARTS = "initial states are not supported for the structure 'Direct form I'"
REFUSED = [
    (
        "DiscreteFilter",
        {"Numerator": "[1 2; 3 4]"},
        "its Numerator is a matrix of 2 filters, which is not supported",
    ),
    ("DiscreteTransferFcn", {"Numerator": "[1 2; 3 4]", "Denominator": "[1 0 0 0]"}, "is a matrix of 2 filters"),
    ("DiscreteFilter", {"FilterStructure": "Direct form I", "InitialStates": "1"}, STARTS),
    (
        "DiscreteFir",
        {"Coefficients": "[1 2; 3 4]"},
        "its Coefficients is a matrix of 2 filters, which is not supported",
    ),
    ("DiscreteFir", {"FilterStructure": "Lattice MA"}, "FilterStructure 'Lattice MA'"),
    ("DiscreteFir", {"FilterStructure": "Direct form transposed", "InitialStates": "1"}, "initial states are"),
    ("DataTypeConversion", {"OutDataTypeStr": "fixdt(0,16,13)", **STORED}, "it reinterprets the stored bits"),
    ("DataTypeConversion", {"OutDataTypeStr": "uint16", **STORED}, "it reinterprets the stored bits of a number"),
    (
        "Saturate",
        {"UpperLimitSource": "Input port"},
        "its limits are inputs, which is not supported",
    ),
]


@pytest.mark.parametrize(("kind", "parameters", "reason"), REFUSED)
def test_unsupported_settings_are_refused(kind, parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(alone(kind, **parameters), tmp_path)


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [("UnitDelay", {}), ("Delay", {"DelayLength": "1"}), ("DiscreteFilter", {}), ("DiscreteFir", {}), ("Relay", {})],
)
@pytest.mark.parametrize("shape", ["3", "[3 2]"])
def test_the_rows_of_a_frame_are_not_channels(kind, parameters, shape, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions=shape)
    drawn.block(kind, "B", ports=(1, 1), **parameters, **FRAMES)
    drawn.outport("y")
    drawn.chain("u", "B", "y")
    with pytest.raises(InputError, match="B: its input is a frame of 3 samples"):
        imported(drawn, tmp_path)


def test_the_columns_of_a_frame_of_one_row_are_channels(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for at in (1, 2):
        drawn.inport(f"u{at}")
    drawn.block("Concatenate", "Row", ports=(2, 1), Mode="Multidimensional array", ConcatenateDimension="2")
    drawn.block("UnitDelay", "Z", SampleTime="-1", **FRAMES)
    drawn.block("Demux", "D", ports=(1, 2), Outputs="2")
    drawn.line("u1", "Row:1")
    drawn.line("u2", "Row:2")
    drawn.chain("Row", "Z", "D")
    drawn.outport("y")
    drawn.line("D:2", "y")
    output = run(imported(drawn, tmp_path), {"u1": U, "u2": 2 * U})["y"]
    np.testing.assert_array_equal(output, [0.0, *2 * U[:-1]])


@pytest.mark.parametrize("key", ["OutDataTypeStr", "OutDataTypeMode", "DataType"])
def test_a_conversion_to_a_truth_value_has_had_several_names(key, tmp_path):
    settings = {"DataType": "auto", "OutDataTypeMode": "Inherit via back propagation"} | {key: "boolean"}
    output = run(imported(alone("DataTypeConversion", **settings), tmp_path), {"u1": [0.0, 2.5, -1.0]})["y1"]
    np.testing.assert_array_equal(output, [0, 1, 1])


def test_stored_bits_of_whole_numbers_are_the_numbers(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", OutDataTypeStr="int16")
    drawn.block("DataTypeConversion", "C", OutDataTypeStr="uint16", **STORED)
    drawn.outport("y")
    drawn.chain("u", "C", "y")
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": [0.0, 7.0]})["y"], [0, 7])


def test_a_ramp_of_an_older_file_begins_at_x0(tmp_path):
    outputs = run(
        imported(alone("Reference", 0, special="Ramp", slope="2", start="0.1", X0="-10"), tmp_path), samples=4
    )
    np.testing.assert_allclose(outputs["y1"], [-10, -10, -9.8, -9.6], atol=1e-12)


def test_a_controller_with_an_input_for_its_derivative_is_refused(tmp_path):
    settings = {"TimeDomain": "Discrete-time", "UseExternalDerivativeSource": "on"}
    with pytest.raises(InputError, match="UseExternalDerivativeSource 'on'"):
        imported(alone("Reference", 2, special="PID 1dof", **settings), tmp_path)


def test_the_inverse_hyperbolic_sine_of_large_numbers(tmp_path):
    u = np.array([-1e12, -1e8, -30.0, -0.1, 0.0, 0.1, 30.0, 1e12])
    output = run(imported(alone("Trigonometry", Operator="asinh"), tmp_path), {"u1": u})["y1"]
    np.testing.assert_allclose(output, np.arcsinh(u), rtol=1e-14)


def test_elements_of_a_data_store_are_refused(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="A", InitialValue="[1 2 3]")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A", EnableIndexing="on")
    drawn.outport("y")
    drawn.line("R", "y")
    with pytest.raises(InputError, match="R: it accesses elements of its data store, which is not supported"):
        imported(drawn, tmp_path)


@pytest.mark.parametrize(("own", "expected"), [("[]", 7.0), ("9", 9.0)])
def test_a_merge_begins_with_its_own_value_or_that_of_the_outputs_before_it(own, expected, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("If", "If", ports=(1, 1), IfExpression="u1 > 0", ShowElse="off")
    drawn.block("Merge", "M", ports=(1, 1), Inputs="1", InitialOutput=own)
    inner = drawn.subsystem("A")
    inner.block("ActionPort", "P")
    inner.block("Constant", "C", Value="3")
    inner.outport("y", InitialOutput="start")
    inner.chain("C", "y")
    drawn.line("u", "If")
    drawn.line("If:1", "A#ifaction")
    drawn.line("A", "M:1")
    drawn.outport("y")
    drawn.line("M", "y")
    model = imported(drawn, tmp_path, parameters=[{"start": 7.0}])
    output = run(model, {"u": [-1.0, 0.0, 1.0, -1.0]})["y"]
    np.testing.assert_array_equal(output, [expected, expected, 3, 3])


@pytest.mark.parametrize(("last", "highest"), [("off", 2.0), ("on", 4.0)])
def test_a_flat_table_behind_a_prelookup_goes_by_the_cell_alone(last, highest, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("PreLookup", "P", ports=(1, 2), BreakpointsData="[0 1 3]", ExtrapMethod="Clip", UseLastBreakpoint=last)
    drawn.block("Interpolation_n-D", "T", ports=(2, 1), NumberOfTableDimensions="1", Table="[1 2 4]",
                InterpMethod="Flat", ValidIndexMayReachLast=last)  # fmt: skip
    drawn.outport("y")
    drawn.line("u", "P")
    drawn.line("P:1", "T:1")
    drawn.line("P:2", "T:2")
    drawn.line("T", "y")
    output = run(imported(drawn, tmp_path), {"u": [-1.0, 0.5, 1.0, 2.9, 3.0, 9.0]})["y"]
    np.testing.assert_array_equal(output, [1, 1, 2, 2, highest, highest])


@pytest.mark.parametrize("option", ["Row vector (2-D)", "Column vector (2-D)"])
def test_rows_behind_each_other_are_a_row(option, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="2")
    drawn.block("Reshape", "R", ports=(1, 1), OutputDimensionality=option)
    drawn.block("Concatenate", "C", ports=(2, 1), Mode="Vector")
    drawn.block("Constant", "K", ports=(0, 1), Value="reshape(1:16, 4, 4)")
    row = option.startswith("Row")
    drawn.block("Product", "P", ports=(2, 1), Multiplication="Matrix(*)")
    drawn.block(
        "Sum", "S", ports=(1, 1), Inputs="+", CollapseMode="Specified dimension", CollapseDim="1" if row else "2"
    )
    drawn.outport("y")
    drawn.line("u", "R")
    drawn.line("R", "C:1", "C:2")
    drawn.line("C", "P:1" if row else "P:2")
    drawn.line("K", "P:2" if row else "P:1")
    drawn.chain("P", "S", "y")
    outputs = run(imported(drawn, tmp_path), {"u[1]": [1.0], "u[2]": [5.0]})
    K, x = np.arange(1.0, 17.0).reshape(4, 4, order="F"), np.array([1.0, 5.0, 1.0, 5.0])
    expected = x @ K if row else K @ x
    np.testing.assert_allclose([value[0] for name, value in outputs.items() if name.startswith("y")], expected)
