"""Remarks that code of files runs, commands that run none, and descriptions of files, which never do."""

from pathlib import Path

import pytest

from kennfeld import cli
from kennfeld.graph.external_function import CodeNotRunError, code_gate, load_function
from kennfeld.models import code_consent
from kennfeld.models.fmu.importing import fmu
from tests.models.fmu.lag_fmu import build
from tests.models.onnx_network.networks import perceptron, random_layers
from tests.terminal.foreign_projects import write_fmu_project, write_python_project

MARKER = 'from pathlib import Path\nPath(__file__).with_name("ran").touch()'
REMARK = "remark: runs code of {}. Said once for each content of the file."


@pytest.fixture(autouse=True)
def memory(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what is allowed in a file of the test, and forget what this process allows."""
    file = tmp_path_factory.mktemp("memory") / "allowed-code.json"
    monkeypatch.setattr(code_consent, "consent_file", lambda: file)
    monkeypatch.setattr(code_consent, "_allowed_here", set())


def marked_fmu(folder: Path) -> str:
    """Return the option by which an FMU writes a file once its library is loaded."""
    return f'-DIN_LOADING=fclose(fopen("{folder / "ran"}", "w"))'


@pytest.mark.parametrize("command", ["calibrate", "simulate", "report"])
def test_a_command_says_once_for_each_content_that_code_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    project = write_python_project(tmp_path, "pass")
    remarks = []
    for content in ("", "", "# changed\n", ""):
        with (tmp_path / "table.py").open("a") as file:
            file.write(content)
        assert cli.run([command, str(project)]) in (0, 1)
        remarks.append(capsys.readouterr().err.splitlines().count(REMARK.format("table.py")))
    assert remarks == [1, 0, 1, 0]


def test_the_remark_is_not_hidden_and_precedes_the_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = "import sys\nprint('running', file=sys.stderr)"
    project = write_python_project(tmp_path, "pass", before)
    assert cli.run(["simulate", "--quiet", str(project)]) == 0
    assert capsys.readouterr().err.splitlines() == [REMARK.format("table.py"), "running"]


def test_code_of_an_fmu_is_announced_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["simulate", "--quiet", str(write_fmu_project(tmp_path))]) == 0
    assert REMARK.format("lag.fmu") in capsys.readouterr().err


def test_a_check_without_running_reports_the_rest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = write_fmu_project(tmp_path, "-include", "stdio.h", marked_fmu(tmp_path))
    project.write_text(project.read_text() + '[units]\nu = "km"\n')
    assert cli.run(["check", "--no-run", str(project)]) == 0
    out, err = capsys.readouterr()
    assert not (tmp_path / "ran").exists()
    assert "channel u is in km, but the input u of the function is in Nm" in err
    assert "remark: kennfeld.toml: not checked, because code of lag.fmu was not run: its values" in err
    assert "remark: kennfeld.toml: not checked, because code of lag.fmu was not run: the step" in err
    assert "runs code" not in err
    assert "2 values of 2 parameters to fit; 100 training samples in bench" in out


def test_a_check_without_running_finds_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project = write_python_project(tmp_path, "pass", MARKER)
    project.write_text(project.read_text().replace('"wanted"', '"wnated"'))
    assert cli.run(["check", "--no-run", str(project)]) == 2
    assert "Did you mean wanted?" in capsys.readouterr().err
    assert not (tmp_path / "ran").exists()


def test_a_check_without_running_does_not_look_where_samples_lie(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = write_python_project(tmp_path, "pass", MARKER)
    (tmp_path / "torque.kf").write_text("y = K * Map(table(u))\n")
    table = '[parameters.Map]\nx = {begin = 0.0, end = 1.0, count = 3}\ninitial = 1.0\nlock = "no-data"\n'
    project.write_text(project.read_text() + table)
    assert cli.run(["check", "--no-run", str(project)]) == 0
    err = capsys.readouterr().err
    assert 'lock = "no-data" has no effect, because code of table.py was not run' in err
    assert "not checked, because code of table.py was not run: samples outside of axes" in err
    assert not (tmp_path / "ran").exists()
    assert cli.run(["check", str(project)]) == 0
    assert "samples are outside the axis" in capsys.readouterr().err
    assert (tmp_path / "ran").exists()


def test_a_check_without_running_of_a_project_without_code_is_a_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = write_python_project(tmp_path, "pass")
    (tmp_path / "torque.kf").write_text("y = K * u\n")
    outputs = []
    for options in ([], ["--no-run"]):
        assert cli.run(["check", *options, str(project)]) == 0
        outputs.append(capsys.readouterr())
    assert outputs[0] == outputs[1]


@pytest.mark.parametrize("kind", ["fmu", "py", "translated", "c", "onnx", "project"])
def test_a_description_never_runs_code(tmp_path: Path, kind: str) -> None:
    (tmp_path / "gain.c").write_text("double gain(double x) { return 2 * x; }\n")
    (tmp_path / "gain.py").write_text(f"{MARKER}\n\n\ndef gain(x):\n    return 2 * x\n")
    project = write_python_project(tmp_path, "pass", MARKER)
    names = {
        "fmu": "lag.fmu",
        "py": "table.py:table",
        "translated": "gain.py:gain",
        "c": "gain.c:gain",
        "onnx": "net.onnx",
        "project": project.name,
    }
    if kind == "fmu":
        build(tmp_path, 2, "-include", "stdio.h", marked_fmu(tmp_path))
    if kind == "onnx":
        pytest.importorskip("onnx")
        perceptron(tmp_path / "net.onnx", random_layers([2, 3, 1]))
    assert cli.run(["info", str(tmp_path / names[kind])]) == 0
    assert not (tmp_path / "ran").exists()


def test_a_loaded_function_is_refused_as_well(tmp_path: Path) -> None:
    graph = fmu(build(tmp_path, 2)).graph
    function = next(node.payload.function for node in graph.nodes if node.op == "external")
    load_function(function)

    def refuse(_: object) -> None:
        raise CodeNotRunError(())

    with code_gate(refuse), pytest.raises(CodeNotRunError):
        load_function(function)
    load_function(function)
