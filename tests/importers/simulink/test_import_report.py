"""The import report: undefined variables, unreached blocks, and the order of its entries."""

import pytest

from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
from tests.importers.simulink.simulink_files import Mask, Model


def broken():
    """A chain with undefined variables before and behind an S-function."""
    drawn = Model(step="0.1", solver="ode4")
    drawn.inport("u")
    drawn.block("Gain", "G", ports=(1, 1), Gain="a*b + data.c")
    drawn.block("TransferFcn", "T", ports=(1, 1), Numerator="[num k]", Denominator="[T1 den]")
    drawn.block("S-Function", "S", ports=(1, 1))
    drawn.block("Gain", "After", ports=(1, 1), Gain="2")
    drawn.block("Saturate", "Sat", ports=(1, 1), UpperLimit="hi", LowerLimit="min(lo, other)")
    drawn.block("UnitDelay", "U", ports=(1, 1), InitialCondition="x0", SampleTime="Ts")
    drawn.outport("y")
    drawn.chain("u", "G", "T", "S", "After", "Sat", "U", "y")
    return drawn


def test_all_undefined_variables_are_reported_at_once(tmp_path):
    report = inspect_simulink(broken().write(tmp_path, "slx parts"))
    assert sorted(report.undefined) == sorted(
        ["a", "b", "data.c", "num", "k", "T1", "den", "hi", "lo", "other", "x0", "Ts"]
    )
    assert report.undefined["den"] == ("T",)


def test_a_block_behind_an_unsupported_one_is_neither_supported_nor_unsupported(tmp_path):
    report = inspect_simulink(broken().write(tmp_path, "slx parts"))
    assert report.unreached == ("After", "y")
    assert [block.path for block in report.unsupported] == ["U", "S", "Sat", "T", "G"]
    assert (report.supported, report.total) == (1, 8)
    assert report.sentences[0] == (
        "1 of 8 blocks supported, 2 not reached behind others; not all outputs can be calibrated"
    )
    assert report.as_dict()["unreached"] == ("After", "y")


def test_a_variable_that_a_mask_passes_on_is_reported_by_the_name_outside(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("M", mask=Mask({"p": "gain*2", "q": "offset + gain"}))
    inner.inport("x")
    inner.block("Gain", "G", ports=(1, 1), Gain="p + q")
    inner.outport("y")
    inner.chain("x", "G", "y")
    drawn.outport("y")
    drawn.chain("u", "M", "y")
    assert set(inspect_simulink(drawn.write(tmp_path, "slx parts")).undefined) == {"gain", "offset"}


def test_blocks_come_before_variables_and_both_before_remarks_on_scripts(tmp_path):
    script = tmp_path / "init.m"
    script.write_text("plot(1)\na = 2;\nxlabel('t')\nb = unknown(3);\n")
    report = inspect_simulink(broken().write(tmp_path, "slx parts"), parameters=[script])
    texts = [str(finding) for finding in report.findings]
    assert texts[0].startswith("S: blocks of type S-Function")
    assert all(text.startswith("variable ") for text in texts[1:])
    headings = [table[0][0] for table in report.tables]
    assert headings.index("not supported") < headings.index("variable without a value")
    severities = [remark.severity for remark in report.remarks]
    assert severities == sorted(severities, key=lambda severity: severity == "remark")
    assert report.sentences[1].startswith("Define the variables with --parameters")


@pytest.mark.parametrize("step", [None, 0.02])
def test_a_step_replaces_that_of_the_model(step, tmp_path):
    drawn = Model(step="0.1", solver="ode4")
    drawn.inport("u")
    drawn.block("Integrator", "I")
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    report = inspect_simulink(drawn.write(tmp_path, "slx parts"), step=step)
    assert report.step == (step or 0.1)
    assert f"runs with a step of {step or 0.1} s" in report.sentences


def test_the_axes_of_a_table_that_is_undefined_are_reported_with_it(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    for name in ("u", "v"):
        drawn.inport(name)
    axes = {"BreakpointsForDimension1": "nAxis", "BreakpointsForDimension2": "axes.load"}
    drawn.block("Lookup_n-D", "T", ports=(2, 1), NumberOfTableDimensions="2", Table="MapT", **axes)
    drawn.outport("y")
    drawn.line("u", "T:1")
    drawn.line("v", "T:2")
    drawn.line("T", "y")
    assert set(inspect_simulink(drawn.write(tmp_path, "slx parts")).undefined) == {"MapT", "nAxis", "axes.load"}


@pytest.mark.parametrize(
    ("sink", "sentence"),
    [
        ("Terminator", "all outputs can be calibrated"),
        ("Scope", "it has no outport: its outputs, what T gets, can be calibrated"),
        ("ToWorkspace", "it has no outport: its outputs, what T gets, can be calibrated"),
        ("Outport", "all outputs can be calibrated"),
    ],
)
def test_the_coverage_says_what_the_outputs_are(sink, sentence, tmp_path):
    drawn = Model()
    drawn.inport("u")
    drawn.block("Gain", "G", Gain="2")
    drawn.block(sink, "T", ports=(1, 0))
    drawn.chain("u", "G", "T")
    report = inspect_simulink(drawn.write(tmp_path))
    assert report.sentences[0] == f"3 of 3 blocks supported; {sentence}"
