"""Masks beyond expressions: check boxes, choices, and settings of the model."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import imported, run


def masked(mask, value, **model):
    """A constant in a masked subsystem."""
    drawn = Model(**{"step": "0.02", "solver": "FixedStepDiscrete", **model})
    inner = drawn.subsystem("Sub", mask=mask)
    inner.block("Constant", "C", Value=value)
    inner.outport("y")
    inner.chain("C", "y")
    drawn.outport("y")
    drawn.chain("Sub", "y")
    return drawn


def value_of(drawn, folder, layout="slx parts", **parameters):
    return run(imported(drawn, folder, layout, parameters=[parameters]), samples=1)["y"][0]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
@pytest.mark.parametrize(
    ("kind", "shown", "value"),
    [("checkbox", "on", 1.0), ("checkbox", "off", 0.0), ("popup", "two words", 2.0), ("radiobutton", "IDLE", 1.0)],
)
def test_check_boxes_are_1_or_0_and_choices_are_their_numbers(layout, kind, shown, value, tmp_path):
    mask = Mask({"c": shown}, types={"c": kind}, options={"c": ["IDLE", "two words", "x|y"]})
    assert value_of(masked(mask, "c + 10"), tmp_path, layout) == value + 10


def test_a_choice_that_is_not_evaluated_is_its_text(tmp_path):
    mask = Mask({"c": "fast"}, texts=("c",), types={"c": "popup"}, options={"c": ["slow", "fast"]})
    assert value_of(masked(mask, "strcmp(c, 'fast') + 4"), tmp_path) == 5.0


def test_the_choices_of_old_masks_are_their_numbers_as_well(tmp_path):
    old = {
        "MaskVariables": "mode=@1;on=@2;k=@3;",
        "MaskStyleString": "popup(slow|fast (twice)|off),checkbox,edit",
        "MaskValueString": "fast (twice)|on|K*2",
    }
    drawn = masked(None, "100*mode + 10*on + k")
    drawn.blocks[0].parameters |= old
    assert value_of(drawn, tmp_path, "mdl", K=2.0) == 214.0


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
@pytest.mark.parametrize(
    ("code", "value"),
    [
        ("Ts = eval(get_param(gcs, 'FixedStep'));", 0.02),
        ("Ts = str2double(get_param(bdroot, 'FixedStep'));", 0.02),
        ("Ts = str2num(get_param(bdroot(gcb), 'StopTime')) / 5;", 2.0),
        ("if strcmp(get_param(bdroot, 'SolverName'), 'FixedStepDiscrete'), Ts = 7; else, Ts = 8; end", 7.0),
        ("if choice > 1\n Ts = eval(get_param(bdroot, 'FixedStep'));\nelse\n Ts = 9;\nend", 0.02),
        ("Ts = strcmp(get_param(gcb, 'choice'), 'fast') * 3;", 3.0),
    ],
)
def test_masks_may_ask_for_the_settings_of_the_model(layout, code, value, tmp_path):
    mask = Mask({"choice": "fast"}, initialization=code, types={"choice": "popup"},
                options={"choice": ["slow", "fast"]})  # fmt: skip
    assert value_of(masked(mask, "Ts"), tmp_path, layout) == pytest.approx(value)


def test_a_step_that_is_a_variable_is_followed(tmp_path):
    mask = Mask({"a": "1"}, initialization="Ts = eval(get_param(bdroot, 'FixedStep'));")
    assert value_of(masked(mask, "Ts", step="T/4"), tmp_path, T=2.0) == 0.5


def test_a_sample_time_may_ask_for_the_step(tmp_path):
    mask = Mask({"a": "1"}, initialization="Ts = eval(get_param(gcs, 'FixedStep'));")
    drawn = Model(step="0.02", solver="FixedStepDiscrete")
    inner = drawn.subsystem("Sub", mask=mask)
    inner.inport("u")
    inner.block("ZeroOrderHold", "Z", SampleTime="3*Ts")
    inner.outport("y")
    inner.chain("u", "Z", "y")
    drawn.inport("u")
    drawn.outport("y")
    drawn.chain("u", "Sub", "y")
    output = run(simulink(drawn.write(tmp_path)), {"u": np.arange(7.0)})["y"]
    assert output.tolist() == [0, 0, 0, 3, 3, 3, 6]


@pytest.mark.parametrize(
    "code",
    [
        "Ts = eval(get_param(gcb, 'Position'));",
        "Ts = get_param(5, 'x');",
        "Ts = get_param(gcs);",
        "Ts = eval(5);",
        "Ts = eval('Ts');",
        "if 1, Ts = get_param(gcs, 'Position'); end",
    ],
)
def test_masks_that_only_simulink_can_evaluate_are_refused(code, tmp_path):
    with pytest.raises(InputError, match=r"Sub/C: its Value|variable Ts"):
        value_of(masked(Mask({"a": "1"}, initialization=code), "Ts"), tmp_path)
