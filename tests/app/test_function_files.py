"""Functions in files of other tools: as the function, as functions of formula text, and the consent to run code."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import overview
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.models import code_consent
from tests.app.function_samples import write_functions
from tests.importers.fmu import tank_fmu
from tests.importers.fmu.lag_fmu import build

pytestmark = pytest.mark.usefixtures("forked_workers")

CALLS = '[functions]\ntable = "table.py:table"'


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep what is allowed in a folder of the test."""
    monkeypatch.setattr(code_consent, "consent_file", lambda: tmp_path / "home/.kennfeld/allowed-code.json")
    monkeypatch.setattr(code_consent, "_allowed_here", set())
    return tmp_path / "home"


def ask(session: Session, question: str, **arguments: Any) -> dict[str, Any]:
    return dict({**QUESTIONS, **COMMANDS}[question](session, arguments).head)


def allow(session: Session) -> None:
    ask(session, "allow-code", digests=[code.digest for code in overview(session).code])


def errors(session: Session) -> list[str]:
    return [str(finding) for finding in session.findings if finding.severity == "error"]


def test_a_c_function_is_shown_with_its_text_ports_and_states(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, file="engine.c:lag"))
    own = ask(session, "function-file")
    assert own["whole"]
    assert own["functions"] == ["lag", "twice"]
    assert "static double y;" in own["source"]
    assert [each["name"] for each in own["inputs"]] == ["x", "T"]  # dt is the step
    assert [each["name"] for each in own["outputs"]] == ["lag"]
    assert len(own["states"]) == 2
    assert not own["runs"]
    assert any(line["text"].startswith("lag = ") for line in own["lines"])


def test_a_function_must_be_chosen_if_it_is_not_named(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, file="engine.c"))
    own = ask(session, "function-file")
    assert (own["function"], own["functions"], own["problems"]) == ("", ["lag", "twice"], [])
    ask(session, "choose-function", file="engine.c:twice")
    assert ask(session, "function-file")["whole"]
    assert session.settings["model"]["file"] == "engine.c:twice"


def test_the_only_function_of_a_file_is_chosen(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path))
    assert ask(session, "add-files", files=["gain.py"])["kinds"] == {"gain.py": "function"}
    assert session.settings["model"]["file"] == "gain.py:gain"
    ask(session, "choose-function", file="table.py")
    assert session.settings["model"]["file"] == "table.py:table"
    assert {"engine.c", "gain.py", "torque.kf"} <= set(ask(session, "functions")["files"])


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("engine.c:lag", "double lag(", "not valid C"),
        ("engine.c", "double lag(", "not valid C"),
        ("gain.py:gain", "def gain(", "not valid Python"),
        ("gain.py", "def gain(", "not valid Python"),
        ("gain.py", "GAIN = 2.5", "no functions"),
        ("gain.py:other", "def gain(x):\n    return x\n", "no function other"),
        ("lag.fmu", "no archive", "is not a readable ZIP archive"),
        ("net.onnx", "no network", "net.onnx"),
        ("missing.c:f", None, "does not exist"),
    ],
)
def test_errors_of_a_file_are_messages(tmp_path: Path, file: str, content: str | None, message: str) -> None:
    project = write_functions(tmp_path, file=file)
    if content is not None:
        (tmp_path / file.partition(":")[0]).write_text(content)
    own = ask(Session(project), "function-file")
    assert not own["whole"]
    assert any(message in problem["text"] for problem in own["problems"])


def test_functions_that_formula_text_calls_are_listed_with_their_calls(tmp_path: Path) -> None:
    functions = '[functions]\nlag = "engine.c:lag"\ngain = "gain.py:gain"\nbad = "engine.c:none"'
    session = Session(write_functions(tmp_path, "y = K * gain(lag(u, 0.2, 0.1))\n", functions))
    rows = {row["name"]: row for row in ask(session, "called-functions")["functions"]}
    assert [call["signature"] for call in rows["gain"]["calls"]] == ["gain(x, offset=1.0)"]
    assert rows["lag"]["memory"]
    assert not rows["gain"]["runs"]
    assert "no function none" in rows["bad"]["problems"][0]["text"]
    [error] = [finding for finding in overview(session).findings if finding.severity == "error"]
    assert error.screen == "function"
    session.do(SetKeys("removed", session.path.name, [(("functions", "bad"), None)]))
    assert errors(session) == []
    assert not (tmp_path / "ran").exists()  # a translated function does not run


def test_dropped_files_are_called_by_free_names(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path))
    (tmp_path / "2 min.py").write_text("def f(x):\n    return x\n")
    (tmp_path / "u.py").write_text("def f(x):\n    return x\n")
    answer = ask(session, "add-functions", files=["gain.py", "engine.c", "2 min.py", "u.py"])
    assert answer["names"] == ["gain", "engine", "f_2_min", "u2"]  # u is an input
    assert session.settings["functions"] == {
        "gain": "gain.py:gain", "engine": "engine.c", "f_2_min": "2 min.py:f", "u2": "u.py:f",
    }  # fmt: skip
    assert "may hold several functions" in errors(session)[0]
    session.undo()
    assert "functions" not in session.settings
    with pytest.raises(ArgumentError, match="holds no functions"):
        ask(session, "add-functions", files=["bench.csv"])
    (tmp_path / "idle_data.c").write_text("const volatile double GAIN = 2.0;\n")
    (tmp_path / "idle.c").write_text("double idle(double x) { return x; }\n")
    assert ask(session, "add-functions", files=["idle_data.c", "idle.c"])["names"] == ["idle"]


def test_a_c_file_is_chosen_before_its_file_of_data_and_read_again_with_its_headers(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path))
    (tmp_path / "idle_data.c").write_text("const volatile double GAIN = 2.0;\n")
    (tmp_path / "idle.c").write_text('#include "idle.h"\nreal step(real x) { return GAIN * x; }\n')
    header = tmp_path / "idle.h"
    ask(session, "add-files", files=["idle_data.c", "idle.c"])
    assert session.settings["model"]["file"] == "idle.c:step"
    assert "line 2" in ask(session, "function-file")["problems"][0]["text"]
    header.write_text("typedef double real;\nextern const volatile double GAIN;\n")
    assert ask(session, "add-files", files=["idle.h"])["kinds"] == {"idle.h": "companion"}
    own = ask(session, "function-file")
    assert own["whole"]
    assert [each["name"] for each in own["parameters"]] == ["GAIN"]


def test_the_interface_of_an_fmu_is_chosen(tmp_path: Path) -> None:
    head = 'providesDirectionalDerivative="true"/><CoSimulation modelIdentifier="lag"'
    session = Session(write_functions(tmp_path, file="lag.fmu"))
    build(tmp_path, 2, head=head)
    own = ask(session, "function-file")
    assert (own["choices"], own["function"], own["solver"]) == (["co-simulation", "model-exchange"], "", "ode4")
    ask(session, "choose-function", file="lag.fmu:co_simulation")
    own = ask(session, "function-file")
    assert (own["file"], own["function"], own["solver"]) == ("lag.fmu", "co-simulation", "")
    assert [code.file for code in session.undecided] == ["lag.fmu"]


def test_completions_have_the_calls_of_functions(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, functions='[functions]\ngain = "gain.py:gain"'))
    rows = {row["label"]: row for row in ask(session, "completions")["completions"]}
    assert rows["gain"] == {"label": "gain", "kind": "function", "detail": "gain(x, offset=1.0)"}
    assert rows["PT1"]["detail"] == "PT1(x, T, init=x)"
    assert (rows["K"]["kind"], rows["u"]["kind"], rows["y"]["kind"]) == ("parameter", "input", "node")


def test_calls_of_functions_are_not_proposed_as_tables(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, "y = M(u) * table(u)\n", CALLS))
    titles = [each["title"] for each in ask(session, "proposals")["proposals"]]
    assert titles == ["curve M over u"]


def test_code_runs_only_once_it_is_allowed(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, "y = K * table(u)\n", CALLS))
    [code] = overview(session).code
    assert code.file == "table.py"
    [error] = errors(session)
    assert "[functions] table: runs code of table.py" in error
    for question in ("called-functions", "functions", "completions", "proposals", "names", "schema"):
        ask(session, question)
    ask(session, "choose-function", file="table.py:table")
    assert ask(session, "function-file")["runs"]
    session.undo()
    with pytest.raises(InputError):
        session.run()
    assert not (tmp_path / "ran").exists()
    allow(session)
    assert errors(session) == []
    assert session.require_view().now.scores[0].samples == 8
    assert (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "key", ['lock = "no-data"\nx = { input = "s", begin = 0, end = 20, count = 5 }', 'x = { input = "s", count = 3 }']
)
def test_code_does_not_run_to_find_breakpoints_or_grid_points_without_data(tmp_path: Path, key: str) -> None:
    project = write_functions(tmp_path, "s = table(u)\ny = K * M(s)\n", CALLS)
    project.write_text(f"{project.read_text()}[parameters.M]\ninitial = 1.0\n{key}\n")
    session = Session(project)
    assert "runs code of table.py" in errors(session)[0]
    assert not (tmp_path / "ran").exists()
    allow(session)
    assert errors(session) == []
    assert (tmp_path / "ran").exists()


def test_code_of_unused_functions_needs_no_consent(tmp_path: Path) -> None:
    assert Session(write_functions(tmp_path, functions=CALLS)).undecided == ()


def test_consent_is_remembered_until_the_file_changes(tmp_path: Path) -> None:
    project = write_functions(tmp_path, "y = K * table(u)\n", CALLS)
    allow(Session(project))
    assert Session(project).undecided == ()
    (tmp_path / "table.py").write_text((tmp_path / "table.py").read_text() + "# changed\n")
    assert [code.file for code in Session(project).undecided] == ["table.py"]


def test_a_changed_file_does_not_run_on_a_consent_to_its_former_content(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, "y = K * table(u)\n", CALLS))
    former = overview(session).code
    (tmp_path / "table.py").write_text((tmp_path / "table.py").read_text() + "# changed\n")
    ask(session, "allow-code", digests=[code.digest for code in former])
    assert [code.file for code in session.undecided] == ["table.py"]
    assert not (tmp_path / "ran").exists()


def test_a_damaged_file_of_consents_allows_no_code(tmp_path: Path, home: Path) -> None:
    (home / ".kennfeld").mkdir(parents=True)
    (home / ".kennfeld/allowed-code.json").write_text("{")
    session = Session(write_functions(tmp_path, "y = K * table(u)\n", CALLS))
    assert len(session.undecided) == 1
    allow(session)
    assert session.undecided == ()


def test_an_fmu_is_shown_and_runs_once_it_is_allowed(tmp_path: Path) -> None:
    project = write_functions(tmp_path, file="lag.fmu")
    build(tmp_path, 2)
    session = Session(project)
    own = ask(session, "function-file")
    assert dict(own["facts"])["standard"] == "FMI 2.0 for model exchange"
    assert [each["name"] for each in own["inputs"]] == ["u"]
    assert [each["name"] for each in own["states"]] == ["x"]
    assert [each["name"] for each in own["parameters"]] == ["tau", "k", "table"]
    assert (own["step"], own["solver"], own["runs"]) == (0.1, "ode4", True)
    assert any("directional derivatives" in note for note in own["notes"])
    session.do(SetKeys("free", session.path.name, [(("parameters", "K"), None)]))
    assert "[model] file: runs code of lag.fmu" in errors(session)[0]
    allow(session)
    assert errors(session) == []
    assert np.isfinite(session.require_view().now.scores[0].rmse)
    with pytest.raises(ArgumentError, match="cannot be written as formula text"):
        ask(session, "convert-function")


def test_an_fmu_for_co_simulation_shows_no_states(tmp_path: Path) -> None:
    project = write_functions(tmp_path, file="tank.fmu:co_simulation")
    tank_fmu.build(tmp_path, 2)
    session = Session(project)
    own = ask(session, "function-file")
    assert dict(own["facts"])["standard"] == "FMI 2.0 for co-simulation"
    assert [each["name"] for each in own["outputs"]] == ["y", "steps", "high"]
    assert (own["states"], own["step"], own["solver"], own["runs"]) == ([], 0.1, "", True)
    assert [code.file for code in session.undecided] == ["tank.fmu"]


def test_a_network_is_shown_with_its_layers(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    from tests.importers.onnx.networks import perceptron, random_layers

    project = write_functions(tmp_path, file="net.onnx")
    perceptron(tmp_path / "net.onnx", random_layers([2, 3, 1]))
    own = ask(Session(project), "function-file")
    assert [each["name"] for each in own["inputs"]] == ["x[0]", "x[1]"]
    assert [(each["name"], each["shape"]) for each in own["parameters"]] == [("layer1", [3, 3]), ("layer2", [4, 1])]
    assert dict(own["facts"])["Gemm"] == "2 operators"
    assert not own["runs"]


def test_a_translated_function_becomes_formula_text(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, file="engine.c:lag"))
    assert ask(session, "convert-function") == {"file": "engine.kf"}
    assert "output lag" in session.text_of("engine.kf")
    session.do(SetKeys("criterion", session.path.name, [(("criterion", 1, "node"), "lag")]))
    assert session.settings["model"]["file"] == "engine.kf"


def test_a_criterion_follows_a_function_in_c(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, file="engine.c:twice"))
    session.do(SetKeys("x", session.path.name, [(("criterion", 1, "node"), "twice"), (("channels", "x"), "u")]))
    assert errors(session) == []
    view = session.require_view()
    assert np.allclose(view.now.outputs[0][0], 2 * np.arange(1.0, 9.0))


def test_a_run_calibrates_through_code_that_is_allowed(tmp_path: Path) -> None:
    session = Session(write_functions(tmp_path, "y = K * table(u) + 0.5 * u + 1\n", CALLS))
    allow(session)
    session.run()
    deadline = time.monotonic() + 120
    while session.job.state == "running":
        assert time.monotonic() < deadline, "the run does not end"
        time.sleep(0.02)
        session.pump()
    assert session.job.state == "converged"
    assert float(session.parameters["K"].values) == pytest.approx(1.25)
