"""Variant subsystems, sources and sinks: one of several choices is left."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink, simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import entry, mxarray, sldd, thing
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.random.default_rng(4).normal(size=12)


def plant(*labels, **settings):
    """Two gains to choose from, 10 and 100, with ports in another order than those of the variant subsystem."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Constant", "C", Value="7")
    variant = drawn.subsystem("Plant", Variant="on", **settings)
    variant.inport("a")
    variant.inport("b")
    for label, gain in zip(labels, ("10", "k"), strict=True):
        choice = variant.subsystem(f"Choice {gain}", VariantControl=label)
        choice.inport("b")
        choice.inport("a")
        choice.block("Gain", "K", Gain=gain)
        choice.block("Sum", "S", ports=(2, 1))
        choice.outport("y")
        choice.line("a", "K")
        choice.line("K", "S:1")
        choice.line("b", "S:2")
        choice.line("S", "y")
    variant.outport("y")
    drawn.line("u", "Plant:1")
    drawn.line("C", "Plant:2")
    drawn.outport("y")
    drawn.line("Plant", "y")
    return drawn


GIVEN = {"k": 100.0}


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx inline"]))
@pytest.mark.parametrize(("mode", "gain"), [(1, 10), (2, 100)])
def test_the_choice_whose_control_is_true_is_the_one_that_is_built(layout, mode, gain, tmp_path):
    drawn = plant("mode == 1", "mode == 2")
    model = imported(drawn, tmp_path, layout, parameters=[{**GIVEN, "mode": mode}])
    np.testing.assert_allclose(run(model, {"u": U})["y"], gain * U + 7)
    assert set(model.graph.parameters) == ({"k"} if gain == 100 else set())


def test_derivatives_go_through_the_active_choice(tmp_path):
    model = imported(plant("0", "1"), tmp_path, parameters=[GIVEN])
    exact, differences = slopes(model, {"u": U}, "k", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-6)


@pytest.mark.parametrize(
    ("labels", "settings", "gain"),
    [
        (("one", "two"), {"VariantControlMode": "label", "LabelModeActiveChoice": "two"}, 100),
        (("one", "two"), {"LabelModeActiveChoice": "one"}, 10),
        (("mode==1", "mode==2"), {"OverrideUsingVariant": "mode==2"}, 100),
        (("mode==7", "(default)"), {}, 100),
        (("(default)", "mode==1"), {}, 100),
        (("% mode==1", "mode==1"), {}, 100),
        (("(sim)", "(codegen)"), {"VariantControlMode": "sim codegen switching"}, 10),
        (("mode > 0 && ~(mode == 2)", "mode == 2"), {"VariantActivationTime": "startup"}, 10),
    ],
)
def test_the_ways_to_choose(labels, settings, gain, tmp_path):
    model = imported(plant(*labels, **settings), tmp_path, parameters=[{**GIVEN, "mode": 1.0}])
    np.testing.assert_allclose(run(model, {"u": U})["y"], gain * U + 7)


def scripted(folder):
    (folder / "init.m").write_text(
        "mode = Simulink.VariantControl('Value', 2, 'ActivationTime', 'update diagram');\n"
        "First = Simulink.VariantExpression('mode == 1');\nSecond = Simulink.Variant; Second.Condition = 'mode == 2';\n"
    )
    return folder / "init.m"


def dictionary(folder):
    conditions = {name: thing("Simulink.Variant", Condition=text) for name, text in CONDITIONS.items()}
    (folder / "data.sldd").write_bytes(sldd({**conditions, "mode": thing("Simulink.Parameter", Value=entry(2.0))}))
    return folder / "data.sldd"


CONDITIONS = {"First": "mode == 1", "Second": "mode == 2"}


@pytest.mark.parametrize("source", [scripted, dictionary])
def test_variant_objects_hold_conditions(source, tmp_path):
    path = plant("First", "Second").write(tmp_path)
    result = import_simulink(path, parameters=[source(tmp_path), GIVEN])
    np.testing.assert_allclose(run(result.model, {"u": U})["y"], 100 * U + 7)
    assert "Plant: the variant Second (mode == 2) is active" in result.report.substitutions


def test_variant_objects_of_the_model_workspace(tmp_path):
    from tests.importers.simulink.simulink_data import Thing

    things = {name: Thing("Simulink.Variant", {"Condition": text}) for name, text in CONDITIONS.items()}
    drawn = plant("First", "Second")
    drawn.workspace = mxarray({**things, "mode": 1.0})
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": U})["y"], 10 * U + 7)


def test_the_mask_around_can_choose(tmp_path):
    drawn = plant("which == 1", "which == 2")
    drawn.blocks[2].mask = Mask({"which": "1 + more"})
    model = imported(drawn, tmp_path, parameters=[{**GIVEN, "more": 1.0}])
    np.testing.assert_allclose(run(model, {"u": U})["y"], 100 * U + 7)


@pytest.mark.parametrize(
    ("labels", "settings", "reason"),
    [
        (("1", "2 > 1"), {}, "several of its variants are active: 1, 2 > 1"),
        (("0", "false"), {}, "none of its variants is active"),
        (("one", "two"), {"VariantControlMode": "label", "LabelModeActiveChoice": "three"}, "three is not one of one"),
        (("1", "0"), {"VariantControlMode": "guess"}, "VariantControlMode 'guess'"),
        (("[1 0]", "0"), {}, "must be scalar, got 2 values"),
    ],
)
def test_an_undecidable_choice_is_reported(labels, settings, reason, tmp_path):
    with pytest.raises(InputError, match=rf"Plant: .*{reason.replace('[', '.')}"):
        imported(plant(*labels, **settings), tmp_path, parameters=[GIVEN])


def test_a_variable_without_a_value_is_reported_by_name(tmp_path):
    with pytest.raises(InputError, match="variable mode: undefined; used by Plant"):
        imported(plant("mode == 1", "mode == 2"), tmp_path, parameters=[GIVEN])


def test_the_model_variants_of_old_releases_are_reported(tmp_path):
    drawn = Model()
    drawn.block("ModelReference", "M", ports=(0, 1), ModelNameDialog="other", Variant="on")
    drawn.outport("y")
    drawn.line("M", "y")
    with pytest.raises(InputError, match=r"M: .*use a variant subsystem instead"):
        imported(drawn, tmp_path)


def test_no_variant_at_all_may_be_allowed(tmp_path):
    model = imported(plant("0", "0", AllowZeroVariantControls="on"), tmp_path)
    assert set(run(model, {"u": U})["y"]) == {0.0}


def test_a_variant_subsystem_can_be_imported_by_itself(tmp_path):
    path = plant("mode == 1", "mode == 2").write(tmp_path)
    model = simulink(path, "Plant", [{**GIVEN, "mode": 2.0}])
    np.testing.assert_allclose(run(model, {"a": U, "b": U})["y"], 101 * U)
    with pytest.raises(InputError, match="Plant: mode is undefined"):
        simulink(path, "Plant")


def test_a_port_missing_in_the_chosen_variant_is_reported(tmp_path):
    drawn = plant("1", "0")
    drawn.blocks[2].system.blocks[2].system.inport("c")
    with pytest.raises(InputError, match="its variant Choice 10 has a port c"):
        imported(drawn, tmp_path)


def test_a_choice_can_be_conditional(tmp_path):
    drawn = plant("1", "0")
    drawn.blocks[2].system.blocks[2].system.block("EnablePort", "E")
    drawn.blocks[2].ports = {"in": 2, "out": 1, "enable": 1}
    drawn.inport("on")
    drawn.line("on", "Plant#enable")
    on = np.tile([0.0, 1.0, 1.0], 4)
    output = run(imported(drawn, tmp_path), {"u": U, "on": on})["y"]
    y = 0.0
    for k in range(12):
        y = 10 * U[k] + 7 if on[k] else y
        assert output[k] == pytest.approx(y)


def test_a_choice_can_be_a_referenced_model(tmp_path):
    other = Model("other", step="0.1", solver="FixedStepDiscrete")
    other.inport("b")
    other.inport("a")
    other.block("Gain", "K", Gain="3")
    other.outport("y")
    other.chain("a", "K", "y")
    other.write(tmp_path)
    drawn = plant("0", "0")
    drawn.blocks[2].system.block("ModelReference", "M", ports=(2, 1), ModelNameDialog="other.slx", VariantControl="1")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u": U})["y"], 3 * U)


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
@pytest.mark.parametrize("mode", [1, 2])
def test_a_variant_source_passes_on_the_active_input(layout, mode, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "K", Gain="3")
    drawn.block("VariantSource", "V", ports=(2, 1), lists={"VariantControls": ["mode==1", "mode==2"]})
    drawn.outport("y")
    drawn.line("u", "V:1", "K")
    drawn.line("K", "V:2")
    drawn.line("V", "y")
    output = run(imported(drawn, tmp_path, layout, parameters=[{"mode": mode}]), {"u": U})["y"]
    np.testing.assert_allclose(output, U if mode == 1 else 3 * U)


def sink(joined):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("VariantSink", "V", ports=(1, 2), lists={"VariantControls": ["mode==1", "mode==2"]})
    drawn.line("u", "V")
    for at in (1, 2):
        drawn.block("Gain", f"K{at}", Gain=str(at))
        drawn.line(f"V:{at}", f"K{at}")
    if joined:
        drawn.block("VariantSource", "W", ports=(2, 1), lists={"VariantControls": ["mode==1", "mode==2"]})
        drawn.line("K1", "W:1")
        drawn.line("K2", "W:2")
    drawn.outport("y")
    drawn.line("W" if joined else "K1", "y")
    return drawn


@pytest.mark.parametrize("mode", [1, 2])
def test_a_variant_sink_leads_to_the_active_output(mode, tmp_path):
    output = run(imported(sink(True), tmp_path, parameters=[{"mode": mode}]), {"u": U})["y"]
    np.testing.assert_allclose(output, mode * U)


def test_readers_of_the_output_of_an_inactive_variant_are_reported(tmp_path):
    with pytest.raises(InputError, match=r"V: .*inactive variant"):
        imported(sink(False), tmp_path, parameters=[{"mode": 2}])
