"""Words of dialogs are read whatever their capitals: releases differ, and set_param accepts any."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import alone, imported, run
from tests.importers.simulink.test_variants import plant

U = np.random.default_rng(51).normal(size=12)


def respelled(system, change):
    """A drawing whose dialog words are spelled otherwise; expressions, paths and names stay."""
    words = {
        "Variant", "VariantControlMode", "Commented", "AllowZeroVariantControls", "Operator", "Multiplication",
        "InterpMethod", "ExtrapMethod", "IntegratorMethod", "InitialConditionSource", "ExternalReset", "LimitOutput",
        "Function", "Criteria", "OutputWhenDisabled", "StatesWhenEnabling", "TagVisibility", "IndexMode",
        "IndexOptions", "TriggerType", "InitializeStates", "WhileBlockType", "IterationSource", "ResetStates",
    }  # fmt: skip
    for block in system.blocks:
        for name in words & set(block.parameters):
            block.parameters[name] = change(block.parameters[name])
        if block.system is not None:
            respelled(block.system, change)
    return system


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
@pytest.mark.parametrize("change", [str.upper, str.lower, str.capitalize])
@pytest.mark.parametrize(
    "settings", [{"VariantControlMode": "expression"}, {"VariantControlMode": "label", "LabelModeActiveChoice": "K==2"}]
)
def test_variant_blocks_choose_in_any_spelling(settings, change, layout, tmp_path):
    drawn = respelled(plant("K==1", "K==2", **settings), change)
    gain = 100 if "LabelModeActiveChoice" in settings else 10
    model = imported(drawn, tmp_path, layout, parameters=[{"K": 1.0, "k": 100.0}])
    np.testing.assert_allclose(run(model, {"u": U})["y"], gain * U + 7)


@pytest.mark.parametrize("change", [str.upper, str.lower, str.title])
@pytest.mark.parametrize(
    ("kind", "count", "parameters"),
    [
        ("Lookup_n-D", 1, {"NumberOfTableDimensions": "1", "Table": "[1 4 9]", "BreakpointsForDimension1": "[-1 0 1]",
                           "InterpMethod": "Linear point-slope", "ExtrapMethod": "Clip"}),
        ("Math", 1, {"Operator": "magnitude^2"}),
        ("Trigonometry", 1, {"Operator": "asinh"}),
        ("RelationalOperator", 1, {"Operator": "isNaN"}),
        ("MinMax", 2, {"Function": "max"}),
        ("Logic", 2, {"Operator": "NAND"}),
        ("Rounding", 1, {"Operator": "fix"}),
        ("Gain", 1, {"Gain": "[2]", "Multiplication": "Matrix(u*K)"}),
        ("Switch", 3, {"Criteria": "u2 >= Threshold", "Threshold": "0.2"}),
        ("DiscreteIntegrator", 3, {"IntegratorMethod": "Integration: Trapezoidal", "SampleTime": "0.1",
                                   "InitialConditionSource": "external", "ExternalReset": "Rising",
                                   "LimitOutput": "on", "UpperSaturationLimit": "0.3"}),
        ("Selector", 1, {"IndexMode": "Zero-based", "IndexOptions": "Index vector (dialog)", "Indices": "0",
                         "NumberOfDimensions": "1", "InputPortWidth": "1"}),
    ],
)  # fmt: skip
def test_settings_of_blocks_are_read_in_any_spelling(kind, count, parameters, change, tmp_path):
    columns = {f"u{at}": np.roll(U, at) for at in range(1, count + 1)}
    outputs = []
    for spelling in (str, change):
        drawn = respelled(alone(kind, count, **parameters), spelling)
        folder = tmp_path / spelling.__name__
        folder.mkdir()
        outputs.append(run(imported(drawn, folder), columns)["y1"])
    np.testing.assert_array_equal(*outputs)


@pytest.mark.parametrize("word", ["On", "ON", " on "])
def test_a_block_is_commented_out_and_a_check_box_ticked_in_any_spelling(word, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem("Sub", mask=Mask({"c": word}, types={"c": "checkbox"}))
    inner.block("Constant", "C", Value="c + 10")
    inner.outport("y")
    inner.chain("C", "y")
    drawn.block("Gain", "K", Gain="3", Commented=word)
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("Sub", "S:1", "K")
    drawn.line("K", "S:2")
    drawn.line("S", "y")
    assert run(imported(drawn, tmp_path), samples=1)["y"][0] == 11.0


def spaced(text):
    """A text with other capitals and spaces."""
    return text.upper().replace(": ", " :  ")


@pytest.mark.parametrize("change", [str, str.upper, str.lower, spaced])
def test_types_and_resets_are_recognized_in_any_spelling(change, tmp_path):
    drawn = Model(step="0.1", solver=change("FixedStepDiscrete"))
    drawn.inport("u", OutDataTypeStr="int8")
    drawn.inport("z")
    drawn.block("Gain", "K", Gain="3", OutDataTypeStr=change("Inherit: Same as input"), SaturateOnIntegerOverflow="on")
    drawn.block("Sum", "A", ports=(2, 1), Inputs="++", SaturateOnIntegerOverflow=change("on"), AccumDataTypeStr="uint8",
                OutDataTypeStr=change("Inherit: Same as accumulator"))  # fmt: skip
    drawn.block("DataTypeConversion", "T", OutDataTypeStr=change("Inherit: Inherit via back propagation"),
                SaturateOnIntegerOverflow="on")  # fmt: skip
    drawn.block("DiscreteIntegrator", "I", ports=(2, 1), ExternalReset=change("Rising"), SampleTime="0.1")
    for name, kind in (("y", {}), ("a", {}), ("back", {"OutDataTypeStr": "int8"}), ("i", {})):
        drawn.outport(name, **kind)
    drawn.chain("u", "K", "y")
    drawn.line("u", "A:1", "T")
    drawn.line("z", "A:2", "I:1", "I:2")
    drawn.chain("A", "a")
    drawn.chain("T", "back")
    drawn.chain("I", "i")
    values = run(imported(drawn, tmp_path), {"u": 200 * U, "z": 200 * U})
    np.testing.assert_allclose(values["y"], np.clip(600 * U, -128, 127))
    np.testing.assert_allclose(values["a"], np.clip(400 * U, 0, 255))
    np.testing.assert_allclose(values["back"], np.clip(200 * U, -128, 127))


def test_an_unknown_word_is_refused_as_written(tmp_path):
    with pytest.raises(InputError, match="VariantControlMode 'Sometimes' is not supported"):
        imported(plant("1", "0", VariantControlMode="Sometimes"), tmp_path, parameters=[{"k": 1.0}])
