"""The function of a project: formula text, Simulink models, and the way from one to the other."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.session.function_source import ImportSource
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys, SetText
from kennfeld.base.errors import ArgumentError, InputError
from tests.importers.simulink.simulink_files import Model

EXAMPLE = Path(__file__).parents[2] / "examples" / "simulink"


@pytest.fixture
def sensor(tmp_path: Path) -> Session:
    """Return a session of the Simulink example."""
    shutil.copytree(EXAMPLE, tmp_path / "sensor")
    return Session(tmp_path / "sensor" / "kennfeld.toml")


def set_keys(session: Session, *changes: tuple[tuple[str, ...], object]) -> None:
    session.do(SetKeys("changed", session.path.name, changes))


def states(session: Session) -> dict[str, str]:
    return {block["path"]: block["state"] for block in QUESTIONS["diagram"](session, {}).head["blocks"]}


@pytest.mark.guests
def test_the_diagram_has_all_blocks_and_the_lines_that_come_from_them(sensor: Session) -> None:
    own = QUESTIONS["diagram"](sensor, {}).head
    blocks = {block["path"]: block for block in own["blocks"]}
    assert (blocks["Gas"]["inner"], blocks["Gas/MapGas"]["depth"]) == (9, 1)
    assert (blocks["Sensor/Rate"]["field"], blocks["Sensor/Rate"]["detail"]) == ("Gain", "1/TauSensor")
    assert blocks["Sensor/Radiation"]["state"] == "bound"
    lines = {line["path"]: line["text"] for line in own["lines"]}
    assert lines["Sensor/Radiation"] == "Radiation = 0.15 * (t_wand - 20)"
    assert lines["Sensor/Element"] == "T_sensor[degC] = integrator(Rate, 20)"
    names = set(sensor.require_view().model.problem.model.graph.names)
    assert {line["node"] for line in own["lines"]} - {""} == names - {"Sensor/Element"}
    assert own["whole"]
    assert own["files"] == ["exhaust.m"]
    assert own["problems"] == []


@pytest.mark.slow
@pytest.mark.guests
def test_a_diagram_without_binding_and_script_names_the_missing_values(sensor: Session) -> None:
    set_keys(sensor, (("model", "bind"), None), (("model", "parameters"), None))
    own = QUESTIONS["diagram"](sensor, {}).head
    assert [block["path"] for block in own["blocking"]] == ["Sensor/Radiation"]
    assert {each["name"] for each in own["undefined"]} == {
        "MapGas", "NAxis", "LoadAxis", "KRetard", "TauSensor",
    }  # fmt: skip
    assert states(sensor)["Gas/MapGas"] == "undefined"
    assert states(sensor)["Gas/Cooling"] == "supported"
    assert states(sensor)["Sensor/Element"] == "unreached"
    assert states(sensor)["Sensor/Radiation"] == "unsupported"
    assert not own["whole"]
    assert own["lines"] == []
    set_keys(sensor, (("parameters", "TauSensor", "initial"), 9.0))
    assert {each["name"] for each in QUESTIONS["diagram"](sensor, {}).head["undefined"]} == {
        "MapGas", "NAxis", "LoadAxis", "KRetard",
    }  # fmt: skip


@pytest.mark.guests
def test_the_file_that_defines_what_is_missing_is_proposed_by_its_path_in_the_project(sensor: Session) -> None:
    folder = sensor.path.parent / "scripts"
    folder.mkdir()
    (sensor.path.parent / "exhaust.m").rename(folder / "exhaust.m")
    set_keys(sensor, (("model", "parameters"), None))
    (proposal,) = QUESTIONS["diagram"](sensor, {}).head["proposals"]
    assert (proposal["key"], proposal["values"]) == ("parameters", ["scripts/exhaust.m"])
    assert proposal["text"].endswith("and 2 more are set in scripts/exhaust.m")
    set_keys(sensor, (("model", proposal["key"]), proposal["values"]))
    own = QUESTIONS["diagram"](sensor, {}).head
    assert (own["whole"], own["proposals"]) == (True, [])


@pytest.mark.guests
def test_a_part_can_be_imported_alone(sensor: Session) -> None:
    set_keys(sensor, (("model", "bind"), None))
    [part] = QUESTIONS["parts"](sensor, {}).head["parts"]
    assert (part["path"], part["outputs"]) == ("Gas", ["T_gas"])
    set_keys(sensor, (("model", "subsystem"), "Gas"))
    own = QUESTIONS["diagram"](sensor, {}).head
    assert own["whole"]
    assert own["blocks"][0]["path"] == "Speed"
    assert "Sensor" in own["subsystems"]


@pytest.mark.guests
@pytest.mark.guests
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        pytest.param("text.slx", b"hello", "is not a Simulink file", marks=pytest.mark.slow),
        ("cut.slx", b"PK\x03\x04 and no more", "damaged"),
        ("missing.slx", None, "does not exist"),
        pytest.param("protected.slxp", b"PK", "is a protected model", marks=pytest.mark.slow),
    ],
)
def test_a_file_that_cannot_be_read_is_one_message(
    sensor: Session, name: str, content: bytes | None, message: str
) -> None:
    if content is not None:
        (sensor.path.parent / name).write_bytes(content)
    COMMANDS["choose-function"](sensor, {"file": name})
    [problem] = QUESTIONS["diagram"](sensor, {}).head["problems"]
    assert message in problem["text"]
    assert sensor.stale
    assert sensor.view is not None


def write_model(folder: Path, **options: str) -> Path:
    """Write a project with a Simulink model that a function call runs: it has a remark on `file`."""
    folder.mkdir(exist_ok=True)
    model = Model("plant", solver="FixedStepDiscrete", step="0.1", **options)
    model.inport("u")
    model.inport("Task", OutputFunctionCall="on")
    inner = model.subsystem("S")
    inner.block("TriggerPort", "T", TriggerType="function-call")
    inner.inport("u")
    inner.block("Gain", "G", Gain="K")
    inner.outport("y")
    inner.chain("u", "G", "y")
    model.outport("y")
    model.line("u", "S")
    model.line("Task", "S#trigger")
    model.line("S", "y")
    model.write(folder)
    (folder / "drive.csv").write_text("time,u,m\n0,1,2\n0.1,2,4\n0.2,3,6\n", encoding="utf-8")
    text = '[model]\nfile = "plant.slx"\n[[dataset]]\nfiles = ["drive.csv"]\n[[criterion]]\nnode = "y"\n'
    (folder / "kennfeld.toml").write_text(f'{text}target = {{ channel = "m" }}\n', encoding="utf-8")
    return folder / "kennfeld.toml"


@pytest.mark.guests
def test_a_remark_on_the_model_does_not_stop_it(tmp_path: Path) -> None:
    project = write_model(tmp_path)
    project.write_text(f"{project.read_text()}[parameters.K]\ninitial = 1.0\n")
    session = Session(project)
    assert any("Task is a function call" in str(finding) for finding in session.findings)
    own = QUESTIONS["diagram"](session, {}).head
    assert own["problems"] == []
    assert own["whole"]
    assert "y = K * u" in {line["text"] for line in own["lines"]}


@pytest.mark.slow
@pytest.mark.guests
def test_a_solver_is_named_for_models_with_continuous_states(sensor: Session, tmp_path: Path) -> None:
    project = write_model(tmp_path / "discrete")
    project.write_text(f"{project.read_text()}[parameters.K]\ninitial = 1.0\n")
    solvers = [QUESTIONS["diagram"](session, {}).head["solver"] for session in (sensor, Session(project))]
    assert solvers == ["ode3", ""]


@pytest.mark.guests
def test_a_missing_dictionary_is_named_as_the_reason_of_a_stopped_import(tmp_path: Path) -> None:
    own = QUESTIONS["diagram"](Session(write_model(tmp_path, dictionary="plant.sldd")), {}).head
    assert [each["name"] for each in own["undefined"]] == ["K"]
    assert [problem["message"] for problem in own["stopped"]] == ["needs plant.sldd, which was not found"]


@pytest.mark.guests
def test_an_unknown_block_is_named_and_the_blocks_are_still_shown(sensor: Session) -> None:
    set_keys(sensor, (("model", "bind", "Sensor/Radiaton"), "1"))
    own = QUESTIONS["diagram"](sensor, {}).head
    assert "Did you mean Sensor/Radiation?" in own["problems"][0]["text"]
    assert len(own["blocks"]) == 24


@pytest.mark.guests
def test_settings_of_another_kind_are_ignored(sensor: Session) -> None:
    set_keys(sensor, (("model", "bind"), 3), (("model", "parameters"), 4), (("calibration", "initial"), 5))
    source = ImportSource.of(sensor.settings, sensor.path)
    assert source is not None
    assert (source.request.options.bind, source.request.options.parameters) == ((), ())


@pytest.mark.guests
def test_formula_text_of_a_converted_model_gives_the_same_errors(sensor: Session) -> None:
    before = sensor.require_view().now
    answer = COMMANDS["convert-function"](sensor, {})
    assert answer.head["file"] == sensor.formula_file == "exhaust.kf"
    assert not sensor.stale, sensor.findings
    for old, new in zip(before.errors, sensor.require_view().now.errors, strict=True):
        np.testing.assert_allclose(old, new, atol=1e-9)
    sensor.save()
    assert Session(sensor.path).require_view().now.scores == sensor.require_view().now.scores
    sensor.undo()
    assert sensor.settings["model"]["bind"] == {"Sensor/Radiation": "0.15 * (t_wand - 20)"}
    COMMANDS["choose-function"](sensor, {"file": "exhaust.mdl"})
    assert not sensor.stale


@pytest.mark.slow
@pytest.mark.guests
def test_a_model_that_cannot_run_cannot_be_converted(sensor: Session) -> None:
    set_keys(sensor, (("model", "bind"), None))
    with pytest.raises(InputError, match="Sensor/Radiation"):
        COMMANDS["convert-function"](sensor, {})


@pytest.mark.guests
def test_new_formula_text_is_the_function_until_it_is_undone(sensor: Session) -> None:
    answer = COMMANDS["new-function"](sensor, {})
    assert answer.head["file"] == "function.kf"
    assert QUESTIONS["settings"](sensor, {}).head["function"].startswith("#")
    assert QUESTIONS["functions"](sensor, {}).head["files"] == ["exhaust.mdl", "function.kf"]
    assert COMMANDS["new-function"](sensor, {}).head["file"] == "function-2.kf"
    sensor.undo()
    sensor.undo()
    assert not sensor.stale
    assert sensor.settings["model"]["file"] == "exhaust.mdl"


@pytest.mark.slow
@pytest.mark.guests
def test_a_model_that_was_changed_on_disk_is_read_again(sensor: Session) -> None:
    path = sensor.path.parent / "exhaust.m"
    path.write_text(path.read_text("utf-8").replace("KRetard", "KLate"))
    COMMANDS["reread-function"](sensor, {})
    assert sensor.stale
    assert [each["name"] for each in QUESTIONS["diagram"](sensor, {}).head["undefined"]] == ["KRetard"]


@pytest.mark.guests
def test_a_formula_names_the_channels_that_it_reads(sensor: Session) -> None:
    read = QUESTIONS["formula-reads"](sensor, {"text": "0.15 * (t_wund - Speed)"}).head
    unknown, known = read["channels"]
    assert (unknown["name"], unknown["known"], unknown["guess"]) == ("t_wund", False, "Did you mean t_wand?")
    assert (known["name"], known["known"]) == ("n_mot", True)
    assert known["least"] < known["greatest"]
    assert "unclosed" in QUESTIONS["formula-reads"](sensor, {"text": "(1 + 2"}).head["problem"]


@pytest.mark.guests
def test_the_flow_names_the_inputs_of_each_node(torque: Path, sensor: Session) -> None:
    nodes = {node["name"]: node for node in QUESTIONS["flow"](Session(torque), {}).head["nodes"]}
    assert nodes["etaSpark"]["sources"] == ["deltaSpark"]
    assert (nodes["etaSpark"]["tables"], nodes["etaSpark"]["kind"]) == (["CurveEtaDeltaSpark"], "curve")
    assert set(nodes["product"]["sources"]) == {"trqOpt", "etaSpark"}
    nodes = {node["name"]: node for node in QUESTIONS["flow"](sensor, {}).head["nodes"]}
    assert nodes["Sensor/Element"]["sources"] == ["T_sensor"]  # a second name
    assert "T_sensor" in nodes["T_sensor"]["sources"]  # a state reads itself


def test_a_misspelt_name_is_located_at_its_character(torque: Path) -> None:
    session = Session(torque)
    text = session.text_of("torque.kf").rstrip("\n")
    session.do(
        SetText("typed", "torque.kf", f"{text}\n8 limited = min(TorquePredict, MapOptTorqe(Speed, Rel_Airmass))\n")
    )
    [row] = QUESTIONS["spellings"](session, {}).head["spellings"]
    assert row == {"line": 8, "column": 32, "word": "MapOptTorqe", "similar": "MapOptTorque"}
    session.do(SetText("typed", "torque.kf", f"{text}\n8 limited = mix(TorquePredict, 3)\n"))
    [row] = QUESTIONS["spellings"](session, {}).head["spellings"]
    assert (row["word"], row["similar"]) == ("mix", "min")
    session.undo()
    session.undo()
    assert QUESTIONS["spellings"](session, {}).head["spellings"] == []


def test_formula_text_has_no_diagram(torque: Path) -> None:
    with pytest.raises(ArgumentError, match="not in a file of another tool"):
        QUESTIONS["diagram"](Session(torque), {})


@pytest.mark.guests
def test_a_block_that_needs_a_fixed_step_is_offered_that_of_the_data(tmp_path: Path) -> None:
    model = Model("late", solver="ode45", step="auto")
    model.inport("u")
    model.block("TransportDelay", "Delay", DelayTime="0.2", InitialOutput="0")
    model.outport("y")
    model.chain("u", "Delay", "y")
    model.write(tmp_path)
    (tmp_path / "drive.csv").write_text("time,u,m\n0,1,0\n0.1,2,0\n0.2,3,1\n0.3,4,2\n", encoding="utf-8")
    project = tmp_path / "kennfeld.toml"
    project.write_text(
        '[model]\nfile = "late.slx"\n[[dataset]]\nfiles = ["drive.csv"]\n[[criterion]]\nnode = "y"\n'
        'target = { channel = "m" }\n',
        encoding="utf-8",
    )
    session = Session(project)
    own = QUESTIONS["diagram"](session, {}).head
    assert [(each["path"], each["needsStep"]) for each in own["blocking"]] == [("Delay", True)]
    assert own["dataStep"] == pytest.approx(0.1)
    COMMANDS["set-keys"](session, {"title": "step", "changes": [[["model", "step"], own["dataStep"]]]})
    after = QUESTIONS["diagram"](session, {}).head
    assert after["blocking"] == []
    assert "dataStep" not in after
