"""Undefined variables as sections of a project file."""

import tomllib

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink, simulink
from kennfeld.models.importer import ImportOptions
from kennfeld.models.quantities import UndefinedParameter
from kennfeld.terminal.file_info import describe_file
from tests.importers.simulink.simulink_data import entry, sldd
from tests.importers.simulink.simulink_files import Mask, Model
from tests.importers.simulink.simulink_runs import alone, imported, run

SCRIPT = """load('measured.mat');
K = fminsearch(@(x) x^2, 1);
par.limit = fminsearch(@(x) x^2, 1);
"""


def drawing():
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "G", Gain="K")
    drawn.block("Lookup_n-D", "Map", ports=(2, 1), NumberOfTableDimensions="2", Table="M",
                BreakpointsForDimension1="[0 1]", BreakpointsForDimension2="[0 1 2]")  # fmt: skip
    drawn.block("Lookup_n-D", "Curve", NumberOfTableDimensions="1", Table="[1 2 3 4]", BreakpointsForDimension1="X")
    inner = drawn.subsystem("S", mask=Mask({"limit": "par.limit"}))
    inner.inport("u")
    inner.block("Switch", "Sw", ports=(3, 1), Threshold="limit")
    inner.outport("y")
    inner.line("u", "Sw:1", "Sw:2", "Sw:3")
    inner.line("Sw", "y")
    for at, name in enumerate(("G", "Map", "Curve", "S"), 1):
        drawn.outport(f"y{at}")
        drawn.line(name, f"y{at}")
    drawn.line("u", "G", "Map:1", "Map:2", "Curve", "S")
    return drawn


def report_of(folder):
    (folder / "init.m").write_text(SCRIPT)
    return import_simulink(drawing().write(folder), parameters=[folder / "init.m"]).report


def test_undefined_variables_come_with_shape_field_and_reason(tmp_path):
    definitions = {item.name: item for item in report_of(tmp_path).definitions}
    assert {name: item.shape for name, item in definitions.items()} == {
        "K": None, "M": (2, 3), "X": (4,), "par.limit": ()
    }  # fmt: skip
    assert definitions["K"].fields == ("G:Gain",)
    assert definitions["par.limit"].fields == ("S/Sw:Threshold",)
    assert definitions["K"].reason == "assignment failed in init.m line 2"
    assert definitions["M"].reason == ""


def test_the_error_names_the_missing_files(tmp_path):
    (tmp_path / "init.m").write_text(SCRIPT)
    drawn = drawing()
    drawn.dictionary = "lost.sldd"
    with pytest.raises(InputError) as caught:
        simulink(drawn.write(tmp_path), parameters=[tmp_path / "init.m"])
    messages = list(map(str, caught.value.findings))
    assert "model.slx: needs lost.sldd, which was not found. Place it in the same folder" in messages[0]
    assert "model.slx init.m: needs measured.mat, which was not found." in messages[1]
    assert messages[2].startswith("model.slx variable K: undefined")


def test_the_error_names_dictionaries_that_others_refer_to(tmp_path):
    (tmp_path / "main.sldd").write_bytes(sldd({"M": entry([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])}, ["types.sldd"]))
    drawn = drawing()
    drawn.dictionary = "main.sldd"
    with pytest.raises(InputError, match=r"model\.slx main\.sldd: needs types\.sldd, which was not found"):
        simulink(drawn.write(tmp_path))


def test_the_sections_can_be_pasted_into_a_project_and_define_the_model(tmp_path):
    text = report_of(tmp_path).project_sections
    assert text.startswith("# init.m needs measured.mat, which was not found\n")
    assert "# assignment failed in init.m line 2; used by G:Gain; a number, or all values\n[parameters.K]" in text
    assert "# used by Map:Table; 2 x 3 values\n[parameters.M]" in text
    sections = tomllib.loads(text)["parameters"]
    assert np.shape(sections["M"]["initial"]) == (2, 3)
    assert np.shape(sections["X"]["initial"]) == (4,)
    assert all(np.all(np.isnan(section["initial"])) for section in sections.values())
    values = {name: np.ones(np.shape(section["initial"])) for name, section in sections.items()}
    values["X"] = np.arange(4.0)
    model = imported(drawing(), tmp_path, parameters=[tmp_path / "init.m", values])
    assert run(model, {"u": [1.0]})["y1"][0] == 1.0


def test_a_number_that_is_given_for_a_table_stands_for_all_of_its_values(tmp_path):
    values = {"K": 1.0, "M": 5.0, "X": [0.0, 1.0, 2.0, 3.0], "par.limit": 0.0, "Curve:Table": 7.0}
    model = imported(drawing(), tmp_path, parameters=[values])
    assert model.values["M"].values.tolist() == [[5.0, 5.0, 5.0], [5.0, 5.0, 5.0]]
    assert model.values["Curve:Table"].values.tolist() == [7.0] * 4


def test_a_number_that_a_script_assigns_to_a_table_is_refused_as_in_simulink(tmp_path):
    (tmp_path / "init.m").write_text("K = 1; M = 5; X = 0:3; par.limit = 0;")
    with pytest.raises(InputError, match="its M of size 1 x 1 does not match its 2 x 3 breakpoints"):
        imported(drawing(), tmp_path, parameters=[tmp_path / "init.m"])


@pytest.mark.parametrize("gain", ["K", "2"])
def test_a_model_with_all_values_leaves_nothing_to_define(gain, tmp_path):
    report = import_simulink(alone("Gain", Gain=gain).write(tmp_path), parameters=[{"K": 2.0}]).report
    assert (report.definitions, report.project_sections) == ((), "")


def test_an_expression_of_a_variable_leaves_its_size_open(tmp_path):
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", Table="2*M", BreakpointsForDimension1="[0 1]")
    assert [item.shape for item in import_simulink(drawn.write(tmp_path)).report.definitions] == [None]


def test_a_large_table_gets_one_number():
    text = UndefinedParameter("M", (100, 30), ("Map:Table",)).project_section
    assert text == "# used by Map:Table; 100 x 30 values\n[parameters.M]\ninitial = nan"


@pytest.mark.parametrize("options", [ImportOptions(), ImportOptions(step=0.2), ImportOptions(bind=(("G", "u"),))])
def test_a_file_that_cannot_be_imported_as_a_whole_still_tells_its_ports(tmp_path, options):
    info = describe_file(drawing().write(tmp_path), options=options)
    assert [("input", "unit"), ("u", "")] in info.tables
    assert [("output", "unit"), *((f"y{at}", "") for at in range(1, 5))] in info.tables
