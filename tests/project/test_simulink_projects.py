"""Projects whose function is drawn in Simulink: calibrated, simulated, turned into formula text."""

import json
import re

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.calfiles import read
from kennfeld.calfiles import write as write_parameters
from kennfeld.domain import parameter_set
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.simulink.importer import IMPORTER
from kennfeld.importers.simulink.importing import simulink
from kennfeld.models import merge_start_values
from kennfeld.models.formula import read as read_formula
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.models.model_export import write_formula
from kennfeld.optimize.api import calibrate, simulate
from kennfeld.project import Project
from kennfeld.project.demo import write
from kennfeld.report.provenance import sources
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import sldd, thing
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.torque_drawing import torque

DRAWN = "slx parts"


@pytest.fixture
def drawn(shop):
    """A project on y = Slope * u + 1.5, with y recorded for Slope = 3."""
    model = Model("line")
    model.inport("u")
    model.block("Gain", "Times", Gain="Slope")
    model.block("Bias", "Plus", Bias="1.5")
    model.outport("y")
    model.chain("u", "Times", "Plus", "y")
    u = np.linspace(-2, 2, 20)
    shop.csv("bench.csv", {"u": u, "z": 3 * u + 1.5})
    shop.model = model
    shop.toml = (
        "[model]\nfile = 'line.slx'\n[[dataset]]\nfiles = 'bench.csv'\n[[criterion]]\nnode = 'y'\ntarget = 'z'\n"
        "[parameters.Slope]\ninitial = 1.0\n"
    )
    shop.model.write(shop.folder, DRAWN)
    return shop


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_drawn_function_is_calibrated(drawn, layout):
    path = drawn.model.write(drawn.folder, layout)
    drawn.change("line.slx", path.name)
    result = drawn.project.calibrate()
    assert result.parameters["Slope"].value == pytest.approx(3, rel=1e-9)


def test_values_come_from_scripts_that_the_project_names(drawn):
    (drawn.folder / "init.m").write_text("half = 2;\nSlope = half / 4; % to be fitted\n")
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    drawn.change("[[dataset]]", "parameters = 'init.m'\n[[dataset]]")
    problem = drawn.project.problem()
    assert problem.parameters["Slope"].value == 0.5
    assert drawn.project.calibrate().parameters["Slope"].value == pytest.approx(3, rel=1e-9)


@pytest.fixture
def bounded(drawn):
    """The project with a dictionary that keeps Slope between 0 and 2.5, in Nm."""
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    drawn.change("[[dataset]]", "parameters = 'data.sldd'\n[[dataset]]")
    content = sldd({"Slope": thing("Simulink.Parameter", Value=1.0, Min=0.0, Max=2.5, DocUnits="Nm")})
    (drawn.folder / "data.sldd").write_bytes(content)
    return drawn


def start_from(project, parameter, ending):
    write_parameters(ParameterSet([parameter]), project.folder / f"start.{ending}")
    project.change("[[dataset]]", f"[calibration]\ninitial = 'start.{ending}'\n[[dataset]]")


@pytest.mark.parametrize("ending", ["dcm", "cdfx", "csv", "json", "m"])
def test_limits_of_a_dictionary_hold_for_a_value_from_a_calibration_file(bounded, ending):
    start_from(bounded, Scalar("Slope", 0.5), ending)
    slope = bounded.project.problem().parameters["Slope"]
    assert (slope.value, float(slope.lower), float(slope.upper)) == (0.5, 0.0, 2.5)
    assert bounded.project.calibrate().parameters["Slope"].value == 2.5


def test_limits_of_parameters_take_precedence_over_a_dictionary(bounded):
    start = ParameterSet([Scalar("Slope", 0.5, lower=np.array(0.25))])
    path, dictionary = bounded.folder / "line.slx", bounded.folder / "data.sldd"
    for parameters in (
        merge_start_values(simulink(path, parameters=[dictionary]).values, start),
        simulink(path, parameters=[dictionary, start]).values,
    ):
        assert (float(parameters["Slope"].lower), float(parameters["Slope"].upper)) == (0.25, np.inf)


@pytest.mark.parametrize("start", [{"Slope": 0.5}, ParameterSet([Scalar("Slope", 0.5)])])
def test_limits_of_a_dictionary_hold_for_a_start_that_python_gives(bounded, start):
    model = simulink(bounded.folder / "line.slx", parameters=[bounded.folder / "data.sldd"])
    u = np.linspace(-2, 2, 20)
    data = {"u": u, "z": 3 * u + 1.5}
    assert calibrate(model, data, start, target="z").parameters["Slope"].value == 2.5
    free = calibrate(model, data, start, target="z", bounds={"Slope": (-np.inf, np.inf)})
    assert free.parameters["Slope"].value == pytest.approx(3, rel=1e-9)


def test_a_start_beyond_the_limits_of_a_dictionary_is_moved_onto_them(bounded):
    start_from(bounded, Scalar("Slope", 7.0), "dcm")
    assert bounded.project.calibrate().parameters["Slope"].value == 2.5


def test_limits_of_a_table_hold_for_values_over_other_breakpoints(tmp_path):
    drawn = Model("bounded", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Lookup_n-D", "T", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 3]")
    drawn.outport("y")
    drawn.chain("u", "T", "y")
    content = sldd({"Eta": thing("Simulink.Parameter", Value=[1.0, 2.0, 6.0], Min=0.0, Max=8.0)})
    (tmp_path / "data.sldd").write_bytes(content)
    own = simulink(drawn.write(tmp_path, DRAWN), parameters=[tmp_path / "data.sldd"]).values
    read_from_file = ParameterSet([Curve("Eta", [0, 1, 3, 4], [2, 3, 7, 8])])
    table = merge_start_values(own, read_from_file)["Eta"]
    np.testing.assert_array_equal([table.lower, table.upper], [[0.0] * 4, [8.0] * 4])


def test_a_table_of_literals_is_fitted_by_a_section_and_else_reported(drawn):
    model = Model("line")
    model.inport("u")
    model.block("Lookup_n-D", "Eta", NumberOfTableDimensions="1", Table="[1 2 6]", BreakpointsForDimension1="[-2 0 2]")
    model.outport("y")
    model.chain("u", "Eta", "y")
    model.write(drawn.folder, DRAWN)
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    assert drawn.warnings() == [
        "kennfeld.toml [calibration] free: no value can be fitted: Eta:Table is locked. "
        'A section [parameters."Eta:Table"] unlocks a table.'
    ]
    drawn.add('[parameters."Eta:Table"]\ninitial = 0')
    assert drawn.warnings() == []
    assert drawn.project.calibrate().parameters["Eta:Table"].values.tolist() == pytest.approx([-4.5, 1.5, 7.5])


def test_a_literal_that_the_project_names_is_a_parameter(drawn):
    drawn.add('[parameters."Plus:Bias"]\ninitial = 0.0\n')
    parameters = drawn.project.calibrate().parameters
    assert parameters["Slope"].value == pytest.approx(3, rel=1e-9)
    assert parameters["Plus:Bias"].value == pytest.approx(1.5, rel=1e-9)


def test_a_block_is_replaced_by_a_formula(drawn):
    drawn.change("[[dataset]]", 'bind = { "Plus" = "3 * u + 1.5" }\n[[dataset]]')
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    [data] = drawn.project.simulate()
    np.testing.assert_allclose(data["y"].values, data["z"].values, rtol=1e-12)


def test_a_variable_without_a_value_is_named_with_its_block(drawn):
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    [finding] = [str(finding) for finding in drawn.findings() if "Slope" in str(finding)]
    assert "Times" in finding
    assert "undefined" in finding


def test_keys_of_drawn_models_are_refused_for_formula_text(shop):
    shop.change("[model]", "[model]\nsubsystem = 'A'")
    assert any("subsystem requires a Simulink model" in str(finding) for finding in shop.findings())


def test_a_drawn_model_becomes_formula_text_with_its_parameters(drawn, capsys):
    (drawn.folder / "init.m").write_text("Slope = 3;")
    target = drawn.folder / "line.kf"
    arguments = ["convert", str(drawn.folder / "line.slx"), str(target), "--parameters", str(drawn.folder / "init.m")]
    assert cli.run(arguments) == 0
    model = read_formula(target)
    assert model.graph.outputs == ("y",)
    assert json.loads((drawn.folder / "line.json").read_text())["Slope"]["value"] == 3
    capsys.readouterr()
    assert cli.run(arguments) == 2
    assert [line.split(": ")[1][:6] for line in capsys.readouterr().err.splitlines()] == ["alread", "alread"]
    assert cli.run([*arguments, "--force"]) == 0
    assert cli.run(["convert", str(drawn.folder / "line.slx"), str(target.with_suffix(".dcm"))]) == 2
    assert "formula text" in capsys.readouterr().err


def test_python_writes_formula_text_without_reading_a_calibration_file_before(drawn, monkeypatch):
    monkeypatch.setattr(parameter_set, "_writer", None)
    (drawn.folder / "init.m").write_text("Slope = 3;")
    request = ImportRequest(drawn.folder / "line.slx", ImportOptions(parameters=(drawn.folder / "init.m",)))
    written = write_formula(IMPORTER, request, drawn.folder / "line.kf")
    assert [path.name for path in written] == ["line.kf", "line.json"]
    assert read(written[1])["Slope"].value == 3


def test_formula_text_names_nodes_by_subsystem_and_block(tmp_path):
    drawn = Model("plant", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    for name, gain in (("Left", "2"), ("Right side", "3")):
        inner = drawn.subsystem(name)
        inner.inport("x")
        inner.block("Gain", "K", Gain=gain)
        inner.block("Abs", f"Size {gain}")
        inner.outport("y")
        inner.chain("x", "K", f"Size {gain}", "y")
        drawn.line("u", name)
    drawn.block("Sum", "Both", ports=(2, 1))
    drawn.outport("y")
    drawn.line("Left", "Both:1")
    drawn.line("Right side", "Both:2")
    drawn.chain("Both", "y")
    source, target = drawn.write(tmp_path, DRAWN), tmp_path / "plant.kf"
    assert cli.run(["convert", str(source), str(target)]) == 0
    text = target.read_text(encoding="utf-8")
    assert "# Left\n%Left/K% = 2 * u\n%Size 2% = abs(%Left/K%)\n" in text
    assert "# Right side\n%Right side/K% = 3 * u\n%Size 3% = abs(%Right side/K%)" in text
    again = read_formula(target)
    u = np.array([-1.0, 2.0])
    np.testing.assert_array_equal(evaluate(again.graph, {"u": u}, ParameterSet([]))["y"], 5 * np.abs(u))


def test_libraries_are_searched_in_the_folders_of_the_project(drawn, capsys):
    library = Model("lib", kind="Library")
    inner = library.subsystem("Twice")
    inner.inport("x")
    inner.block("Gain", "K", Gain="2")
    inner.outport("y")
    inner.chain("x", "K", "y")
    (drawn.folder / "parts").mkdir()
    library.write(drawn.folder / "parts", DRAWN)
    model = Model("line")
    model.inport("u")
    model.link("Half", "lib/Twice")
    model.block("Gain", "Times", Gain="Slope/2")
    model.block("Bias", "Plus", Bias="1.5")
    model.outport("y")
    model.chain("u", "Half", "Times", "Plus", "y")
    path = model.write(drawn.folder, DRAWN)
    assert any("library lib, which was not found" in str(finding) for finding in drawn.findings())
    drawn.change("[[dataset]]", "folders = 'parts'\n[[dataset]]")
    assert drawn.project.calibrate().parameters["Slope"].value == pytest.approx(3, rel=1e-9)
    assert cli.run(["info", str(path), "--folder", str(drawn.folder / "parts")]) == 0
    assert "was not found" not in capsys.readouterr().out


def test_formula_text_extrapolates_tables_like_its_model(tmp_path):
    drawn = Model("beyond", step="0.1", solver="FixedStepDiscrete")
    for name, method in (("Eta", "Linear"), ("Phi", "Clip")):
        drawn.inport(f"u_{name}")
        drawn.block("Lookup_n-D", name, NumberOfTableDimensions="1", Table=name, BreakpointsForDimension1="[0 1 3]",
                    ExtrapMethod=method)  # fmt: skip
        drawn.outport(f"y_{name}")
        drawn.chain(f"u_{name}", name, f"y_{name}")
    (tmp_path / "init.m").write_text("Eta = [1 2 6]; Phi = [1 2 6];")
    source, target = drawn.write(tmp_path, DRAWN), tmp_path / "beyond.kf"
    assert cli.run(["convert", str(source), str(target), "--parameters", str(tmp_path / "init.m")]) == 0
    u = np.array([-2.0, 0.5, 4.0])
    columns = {"u_Eta": u, "u_Phi": u}
    outputs = evaluate(read_formula(target).graph, columns, read(target.with_suffix(".json")))
    np.testing.assert_allclose(outputs["y_Eta"], [-1, 1.5, 8])
    np.testing.assert_allclose(outputs["y_Phi"], [1, 1.5, 6])


@pytest.mark.parametrize("ending", ["dcm", "cdfx", "csv", "json", "m"])
def test_a_table_from_a_calibration_file_extrapolates_like_the_model(ending, tmp_path):
    drawn = Model("beyond", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Lookup_n-D", "T", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 3]",
                ExtrapMethod="Linear")  # fmt: skip
    drawn.outport("y")
    drawn.chain("u", "T", "y")
    model = simulink(drawn.write(tmp_path, DRAWN), parameters=[{"Eta": [1.0, 2.0, 6.0]}])
    write_parameters(ParameterSet([Curve("Eta", [0, 1, 3], [2, 3, 7])]), tmp_path / f"start.{ending}")
    start = read(tmp_path / f"start.{ending}")
    assert merge_start_values(model.values, start)["Eta"].extrapolation == "linear"
    outputs = evaluate(model.graph, {"u": np.array([-2.0, 4.0])}, merge_start_values(model.values, start))
    np.testing.assert_allclose(outputs["y"], [0, 9])


@pytest.mark.parametrize("ending", ["dcm", "cdfx", "csv", "json", "m"])
def test_python_starts_from_a_calibration_file_without_clipping_the_tables_of_a_model(shop, ending):
    drawn = Model("beyond")
    drawn.inport("u")
    drawn.block("Lookup_n-D", "T", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 3]",
                ExtrapMethod="Linear")  # fmt: skip
    drawn.outport("y")
    drawn.chain("u", "T", "y")
    source = drawn.write(shop.folder, DRAWN)
    model = simulink(source, parameters=[{"Eta": [1.0, 2.0, 6.0]}])
    write_parameters(model.values, shop.folder / f"start.{ending}")
    start = read(shop.folder / f"start.{ending}")
    simulation = simulate(model, {"u": [-2.0, 4.0]}, start)
    np.testing.assert_allclose(simulation["y"].values, [-1, 8])
    clipped = ParameterSet([model.values["Eta"].changed(extrapolation="clip")])
    np.testing.assert_allclose(simulate(model, {"u": [-2.0, 4.0]}, clipped)["y"].values, [1, 6])


def test_a_project_starts_from_a_calibration_file_without_clipping_the_tables_of_its_model(shop):
    model = Model("line")
    model.inport("u")
    model.block("Lookup_n-D", "T", NumberOfTableDimensions="1", Table="Eta", BreakpointsForDimension1="[0 1 3]",
                ExtrapMethod="Linear")  # fmt: skip
    model.outport("y")
    model.chain("u", "T", "y")
    model.write(shop.folder, DRAWN)
    (shop.folder / "init.m").write_text("Eta = [1 2 6];")
    write_parameters(ParameterSet([Curve("Eta", [0, 1, 3], [2, 3, 7])]), shop.folder / "start.dcm")
    u = np.linspace(-2, 5, 20)
    shop.csv("bench.csv", {"u": u, "z": u})
    shop.toml = (
        "[model]\nfile = 'line.slx'\nparameters = 'init.m'\n[[dataset]]\nfiles = 'bench.csv'\n"
        "[calibration]\ninitial = 'start.dcm'\n[[criterion]]\nnode = 'y'\ntarget = 'z'\n"
    )
    [data] = shop.project.simulate()
    np.testing.assert_allclose(data["y"].values, np.where(u < 1, 2 + u, 3 + 2 * (u - 1)), rtol=1e-12, atol=1e-12)


def test_a_step_on_the_command_line_replaces_that_of_the_model(drawn, capsys):
    (drawn.folder / "init.m").write_text("Slope = 3;")
    source, target = str(drawn.folder / "line.slx"), drawn.folder / "fine.kf"
    options = ["--parameters", str(drawn.folder / "init.m"), "--step", "0.004"]
    assert cli.run(["convert", source, str(target), *options]) == 0
    assert read_formula(target).step == 0.004
    capsys.readouterr()
    assert cli.run(["info", "--json", source, *options]) == 0
    assert json.loads(capsys.readouterr().out)["import"]["step"] == 0.004
    for wrong in ("0", "-1", "inf", "often"):
        assert cli.run(["info", source, "--step", wrong]) == 2


def test_info_states_the_supported_share_of_a_model(drawn, capsys):
    assert cli.run(["info", str(drawn.folder / "line.slx")]) == 0
    out = capsys.readouterr().out
    assert "1 of 4 blocks supported, 2 not reached behind others; not all outputs can be calibrated" in out
    assert re.search(r"Slope +1 +Times", out)
    assert cli.run(["info", "--json", str(drawn.folder / "line.slx")]) == 0
    assert json.loads(capsys.readouterr().out)["import"]["whole"] is False


AXES = {table: (f"{table}_n", f"{table}_q") for table in ("MapOptTorque", "MapOptIgnition", "MapDragTorque")}


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, 1))
def test_the_demo_drawn_as_blocks_takes_the_same_steps(layout, tmp_path):
    path = write("torque", tmp_path / "demo").with_name("load-only.toml")
    text = path.read_text(encoding="utf-8").replace("[optimizer]\n", "[optimizer]\nmax_iterations = 2\n")
    path.write_text(text, encoding="utf-8")
    check_demo_drawn_as_blocks(path, layout)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_demo_drawn_as_blocks_is_calibrated_to_the_same_values(layout, tmp_path):
    check_demo_drawn_as_blocks(write("torque", tmp_path / "demo").with_name("load-only.toml"), layout)


def check_demo_drawn_as_blocks(path, layout):
    text = path.read_text(encoding="utf-8")
    expected = Project.read(path).calibrate().parameters
    drawn = torque(AXES).write(path.parent, layout)
    (path.parent / "axes.m").write_text(axes_script(path.parent / "start.dcm"))
    text = text.replace('file = "torque.kf"', f'file = "{drawn.name}"\nparameters = "axes.m"', 1)
    path.write_text(text, encoding="utf-8")
    parameters = Project.read(path).calibrate().parameters
    assert parameters.keys() == expected.keys()
    for name, parameter in expected.items():
        np.testing.assert_allclose(parameters[name].values, parameter.values, rtol=1e-12)
        assert [axis.breakpoints.tolist() for axis in parameters[name].axes] == [
            a.breakpoints.tolist() for a in parameter.axes
        ]


def axes_script(start):
    """The breakpoints of the demo's start, as the script that a model of blocks comes with."""
    values = read(start)
    names = {**AXES, "CurveEtaDeltaSpark": ("d",)}
    lines = [
        f"{variable} = {axis.breakpoints.tolist()};"
        for table, variables in names.items()
        for variable, axis in zip(variables, values[table].axes, strict=True)
    ]
    return "\n".join(lines)


def model_messages(shop):
    """Return the findings of a check on the model, its parameters and its criteria, as text."""
    return [str(finding) for finding in shop.findings()]


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("line.slx", "lime.slx", "kennfeld.toml [model] file: file lime.slx does not exist. Did you mean line.slx?"),
        (
            "[[dataset]]",
            "subsystem = 'Engin'\n[[dataset]]",
            "line.slx: unknown subsystem Engin. Did you mean Engine?",
        ),
        ("[[dataset]]", "parameters = 'inti.m'\n[[dataset]]", "inti.m: file not found. Did you mean init.m?"),
        ("[[dataset]]", "parameters = 'x.sldd'\n[[dataset]]", "x.sldd: file not found. Check the path."),
        (
            "[[dataset]]",
            "folders = ['parts', 'libs']\n[[dataset]]",
            "kennfeld.toml [model] folders: folder libs does not exist. Check the path.",
        ),
    ],
)
def test_a_model_that_cannot_be_read_is_the_only_finding(drawn, before, after, expected):
    (drawn.folder / "parts").mkdir()
    (drawn.folder / "init.m").write_text("Slope = 1;")
    inner = drawn.model.subsystem("Engine")
    inner.inport("x")
    drawn.model.write(drawn.folder, DRAWN)
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "[parameters.Slope]\nbounds = [0, 5]\n")
    drawn.change(before, after)
    [message] = model_messages(drawn)
    assert message.removeprefix(f"{drawn.folder}/") == expected


def test_a_protected_model_is_named(drawn):
    (drawn.folder / "line.slxp").write_bytes(b"PK")
    drawn.change("line.slx", "line.slxp")
    drawn.change("[[dataset]]", "parameters = 'init.m'\n[[dataset]]")
    [message] = model_messages(drawn)
    assert "line.slxp is a protected model; its blocks cannot be read. Obtain the unprotected model" in message
    assert cli.run(["convert", str(drawn.folder / "line.slxp"), "x.kf"]) == 2


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ('"Pluss:Bias"', "line.slx: unknown block Pluss (field Bias to promote to a parameter). Did you mean Plus?"),
        ('"Plus:Bais"', "line.slx Plus: Bias has no field Bais. Did you mean Bias?"),
        ('"Plus:Slope"', "line.slx Plus: Bias has no field Slope. Its fields: Bias"),
        (
            '"Times:Multiplication"',
            "kennfeld.toml [parameters.Times:Multiplication]: this field of the block is not a number that can be "
            "fitted. Name a numeric field.",
        ),
        ("Slop", "kennfeld.toml [parameters.Slop]: unknown parameter Slop. Did you mean Slope?"),
    ],
)
def test_a_parameter_that_the_model_does_not_have_is_reported_once_with_the_nearest(drawn, section, expected):
    drawn.add(f"[parameters.{section}]\nbounds = [0, 5]\n")
    [message] = model_messages(drawn)
    assert message.startswith(expected)


def test_a_field_that_a_block_needs_as_a_number_is_not_fitted(drawn):
    model = drawn.model
    model.block("Delay", "Later", DelayLength="2", SampleTime="-1")
    model.outport("late")
    model.chain("u", "Later", "late")
    model.write(drawn.folder, DRAWN)
    drawn.add('[parameters."Later:DelayLength"]\ninitial = 3\n')
    [remark] = [finding for finding in drawn.findings() if "Later" in str(finding)]
    assert remark.severity == "remark"
    assert "the block requires this field to be constant; it has the value given here and is not fitted" in str(remark)
    [data] = drawn.project.simulate()
    u = np.linspace(-2, 2, 20)
    np.testing.assert_allclose(data["late"].values, [0, 0, 0, *u[:-3]])


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ("Engine/Gian", "unknown node Engine/Gian. Did you mean Engine/Gain?"),
        ("Engine/Gain x", "unknown node Engine/Gain x. Did you mean Engine/Gain?"),
        ("Engine", "unknown node Engine. Engine has Engine/Gain, Engine/Other."),
        ("Speed", "unknown node Speed. The function has y."),
    ],
)
def test_a_misspelt_path_as_a_node_does_not_count_as_a_formula(drawn, node, expected):
    model = Model("line")
    model.inport("u")
    inner = model.subsystem("Engine")
    inner.inport("x")
    inner.outport("y")
    inner.block("Gain", "Gain", Gain="Slope")
    inner.block("Bias", "Other", Bias="1")
    inner.chain("x", "Gain", "Other", "y")
    model.outport("y")
    model.chain("u", "Engine", "y")
    model.write(drawn.folder, DRAWN)
    drawn.change("node = 'y'", f"node = '{node}'")
    [message] = [text for text in model_messages(drawn) if "unknown node" in text]
    assert message == f"kennfeld.toml [[criterion]] 1 node: {expected}"


def test_differences_from_simulink_are_remarks_of_the_check(drawn):
    model = Model("line", solver="ode45", step="auto")
    model.inport("u")
    model.block("Gain", "Times", Gain="Slope")
    model.block("Integrator", "Sum", InitialCondition="0")
    model.outport("y")
    model.chain("u", "Times", "Sum", "y")
    model.write(drawn.folder, DRAWN)
    drawn.csv("bench.csv", {"time": 0.1 * np.arange(20), "u": np.ones(20), "z": 0.3 * np.arange(20)})
    [remark] = [finding for finding in drawn.findings() if finding.severity == "remark"]
    assert str(remark).startswith("kennfeld.toml [model] file: ode45 -> ode4 with a fixed step")
    assert drawn.project.calibrate().parameters["Slope"].value == pytest.approx(3, rel=1e-9)


def test_parameters_that_a_format_cannot_name_are_skipped_with_a_message(drawn, capsys):
    model = Model("line")
    model.inport("u")
    model.block("Gain", "Times", Gain="Slope")
    model.block("Bias", "Plus so much", Bias="1.5")
    model.outport("y")
    model.chain("u", "Times", "Plus so much", "y")
    model.write(drawn.folder, DRAWN)
    drawn.add('[parameters."Plus so much:Bias"]\ninitial = 0.0\n[calibration]\noutput = ["dcm", "cdfx", "m"]\n')
    [warning] = model_messages(drawn)
    assert warning == (
        "kennfeld.toml [calibration] output: dcm cannot hold Plus so much:Bias: 'Plus so much:Bias' is not a "
        "valid DCM name: it must be one word without quotes. parameters.json holds every parameter."
    )
    path = drawn.folder / "kennfeld.toml"
    assert drawn.project.path == path
    assert cli.run(["calibrate", str(path)]) == 0
    assert "'Plus so much:Bias' is not a valid DCM name" in capsys.readouterr().err
    results = drawn.folder / "results"
    assert list(read(results / "parameters.dcm")) == ["Slope"]
    for ending in ("json", "cdfx", "m"):
        assert read(results / f"parameters.{ending}")["Plus so much:Bias"].value == pytest.approx(1.5, rel=1e-6)


def test_info_shows_values_limits_and_the_ports_of_the_part(drawn, capsys):
    model = Model("line")
    model.inport("u", Unit="rpm")
    inner = model.subsystem("Engine")
    inner.inport("x", Unit="Nm")
    inner.outport("power", Unit="W")
    inner.block("Gain", "Gain", Gain="Slope")
    inner.block("Lookup_n-D", "Eta", NumberOfTableDimensions="1", Table="[1 2 6]", BreakpointsForDimension1="[0 1 3]")
    inner.chain("x", "Gain", "Eta", "power")
    model.outport("y")
    model.chain("u", "Engine", "y")
    path = model.write(drawn.folder, DRAWN)
    (drawn.folder / "init.m").write_text("Slope = 2.5;")
    arguments = ["info", str(path), "--parameters", str(drawn.folder / "init.m")]
    assert cli.run(arguments) == 0
    out = capsys.readouterr().out
    assert re.search(r"Slope +scalar +2\.5 +init\.m", out)
    assert re.search(r"Engine/Eta:Table +curve +3 +1 to 6 +a literal of the block, locked", out)
    assert 'A locked literal is fitted if the project has a section for it: [parameters."Engine/Eta:Table"].' in out
    assert re.search(r"input +unit\nu +rpm", out)
    assert cli.run([*arguments, "--subsystem", "Engine"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"input +unit\nx +Nm\n\noutput +unit\npower +W", out)
    assert cli.run([*arguments, "--subsystem", "Motor"]) == 2
    assert "unknown subsystem Motor" in capsys.readouterr().err
    assert cli.run([*arguments, "--folder", str(drawn.folder / "libs")]) == 2
    assert "libs: folder not found" in capsys.readouterr().err


def test_info_lists_bound_blocks_and_fixed_values(drawn, capsys):
    model = Model("line")
    model.inport("u")
    model.block("S-Function", "Code", ports=(1, 1), FunctionName="f")
    model.block("Gain", "Times", Gain="interp1([0 1], [2 4], Slope)")
    model.outport("y")
    model.chain("u", "Code", "Times", "y")
    path = model.write(drawn.folder, DRAWN)
    (drawn.folder / "init.m").write_text("Slope = 0.5;")
    assert cli.run(["info", str(path), "--parameters", str(drawn.folder / "init.m")]) == 0
    out = capsys.readouterr().out
    assert 'Bind it: bind = { "Code" = "channel or formula" }.' in out
    assert "interp1([0 1], [2 4], Slope) is constant, and so are its variables: " in out


def test_a_model_without_outputs_names_the_subsystems_that_have_some(drawn):
    model = Model("line")
    inner = model.subsystem("Engine")
    inner.inport("x")
    path = model.write(drawn.folder, DRAWN)
    with pytest.raises(InputError, match=r"no signal that could be an output. Import a subsystem: Engine\."):
        simulink(path)
    with pytest.raises(InputError, match=r"Add an outport\."):
        simulink(Model("line").write(drawn.folder, DRAWN))


def test_the_report_lists_the_scripts_that_define_the_values_of_a_model(drawn):
    (drawn.folder / "init.m").write_text("Slope = 1;")
    drawn.change("[[dataset]]", "parameters = 'init.m'\n[[dataset]]")
    roles = {source.name: source.role for source in sources(drawn.project)}
    assert roles["init.m"] == "values of the model"
    assert all(source.digest for source in sources(drawn.project))


def test_an_undefined_variable_is_reported_with_its_script_and_its_block(drawn):
    (drawn.folder / "init.m").write_text("Slope = made_elsewhere(3);")
    drawn.change("[parameters.Slope]\ninitial = 1.0\n", "")
    drawn.change("[[dataset]]", "parameters = 'init.m'\n[[dataset]]")
    [message] = model_messages(drawn)
    assert message.startswith("line.slx variable Slope: undefined (assignment failed in init.m line 1)")
    assert "; used by Times. Define it in a script" in message
