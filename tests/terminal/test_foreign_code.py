"""Remarks that code of files runs, commands that run none, and descriptions of files, which never do."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from kennfeld import cli
from kennfeld.graph.external_function import CodeNotRunError, code_gate, load_function
from kennfeld.importers.fmu.importing import fmu
from kennfeld.models import code_consent
from kennfeld.terminal import foreign_code
from tests.importers.fmu.lag_fmu import build
from tests.importers.onnx.networks import perceptron, random_layers
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
def test_a_command_warns_once_per_content_that_code_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    project = write_python_project(tmp_path, "pass")
    remarks = []
    for content in ("", "", "# changed\n"):
        with (tmp_path / "table.py").open("a") as file:
            file.write(content)
        assert cli.run([command, "--trust", str(project)]) in (0, 1)
        remarks.append(capsys.readouterr().err.splitlines().count(REMARK.format("table.py")))
    assert remarks == [1, 0, 1]


def test_the_remark_is_not_hidden_and_precedes_the_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = "import sys\nprint('running', file=sys.stderr)"
    project = write_python_project(tmp_path, "pass", before)
    assert cli.run(["simulate", "--trust", "--quiet", str(project)]) == 0
    assert capsys.readouterr().err.splitlines() == [REMARK.format("table.py"), "running"]


def test_code_of_an_fmu_is_announced_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["simulate", "--trust", "--quiet", str(write_fmu_project(tmp_path))]) == 0
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
    assert cli.run(["check", "--trust", str(project)]) == 0
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


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let commands believe that they have a terminal; return the answers that are typed, the next one last."""
    answers: list[str] = []
    monkeypatch.setattr(foreign_code, "_is_terminal", lambda: True)
    monkeypatch.setattr("click.termui.visible_prompt_func", lambda text: answers.pop())
    return answers


@pytest.mark.parametrize("command", ["check", "calibrate", "simulate", "report"])
def test_without_a_terminal_code_does_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    project = write_python_project(tmp_path, "pass", f"import helper\n{MARKER}")
    (tmp_path / "helper.py").write_text(MARKER)
    assert cli.run([command, str(project)]) == 2
    assert capsys.readouterr().err == (
        "kennfeld.toml line 5 [functions] table: runs code of table.py with helper.py, and has not been allowed to. "
        "Look into it first. Then answer on a terminal, or add --trust.\n"
    )
    assert not (tmp_path / "ran").exists()


def test_a_terminal_asks_once_for_each_content(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], terminal: list[str]
) -> None:
    project = write_python_project(tmp_path, "pass", f"import helper\n{MARKER}")
    (tmp_path / "helper.py").write_text("")
    terminal.append("n")
    assert cli.run(["simulate", str(project)]) == 2
    assert not (tmp_path / "ran").exists()
    assert "runs code of table.py with helper.py, and has not been allowed to" in capsys.readouterr().err
    terminal.append("y")
    assert cli.run(["simulate", str(project)]) == 0
    assert "remark: The project runs code of table.py with helper.py." in capsys.readouterr().err
    assert (tmp_path / "ran").exists()
    assert cli.run(["check", str(project)]) == 0  # without a question
    (tmp_path / "helper.py").write_text("# changed")
    terminal.append("n")
    assert cli.run(["simulate", str(project)]) == 2
    assert terminal == []


def test_ctrl_c_at_the_question_ends_the_command(
    tmp_path: Path, terminal: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(text: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("click.termui.visible_prompt_func", interrupt)
    assert cli.run(["simulate", str(write_python_project(tmp_path, "pass", MARKER))]) == 130
    assert not (tmp_path / "ran").exists()


class Listener:
    """A server at a port of this machine that is not a scheduler: it notes who connects, and sends bytes."""

    def __init__(self, sends: bytes = b"HTTP/1.1 400 Bad Request\r\n\r\n") -> None:
        self.socket, self.connections = socket.create_server(("127.0.0.1", 0)), 0
        self.address = f"tcp://127.0.0.1:{self.socket.getsockname()[1]}"
        self._sends = sends
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self.socket.accept()
                self.connections += 1
                connection.sendall(self._sends)
                connection.close()


@pytest.fixture
def listener() -> Iterator[Listener]:
    pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install kennfeld[cluster]")
    listener = Listener()
    yield listener
    listener.socket.close()


def write_cluster_project(folder: Path, scheduler: str, options: str = "") -> Path:
    project = write_python_project(folder, "pass")
    (folder / "torque.kf").write_text("y = K * u\n")
    project.write_text(f'{project.read_text()}[cluster]\nscheduler = "{scheduler}"\n{options}')
    return project


@pytest.mark.slow
def test_check_and_info_never_join_a_scheduler(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], listener: Listener
) -> None:
    project = write_cluster_project(tmp_path, listener.address)
    for line in (["check"], ["check", "--no-run"], ["check", "--trust"], ["info"]):
        assert cli.run([*line, str(project)]) == 0
    assert "100 training samples in" in capsys.readouterr().out
    assert listener.connections == 0


@pytest.mark.parametrize("command", ["calibrate", "simulate", "report"])
@pytest.mark.parametrize("in_file", [False, True])
def test_a_scheduler_is_asked_for_before_it_is_joined(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], listener: Listener, command: str, in_file: bool
) -> None:
    (tmp_path / "scheduler.json").write_text(json.dumps({"address": listener.address}))
    project = write_cluster_project(tmp_path, "scheduler.json" if in_file else listener.address)
    assert cli.run([command, str(project)]) == 2
    message = f"[cluster] scheduler: joins the scheduler {listener.address}, which can run code here, and has not been"
    assert message in capsys.readouterr().err
    assert listener.connections == 0


def test_a_scheduler_is_asked_for_once_per_address(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], terminal: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("kennfeld.base.dask_runner.CONNECT_TIMEOUT", 0.01)
    project = write_cluster_project(tmp_path, "nobody://one:1")
    terminal.append("y")
    for _ in range(2):
        assert cli.run(["report", str(project)]) == 2
        assert "scheduler nobody://one:1: does not answer" in capsys.readouterr().err
    project.write_text(project.read_text().replace("one:1", "two:1"))
    terminal.append("n")
    assert cli.run(["report", str(project)]) == 2
    assert "joins the scheduler nobody://two:1, which can run code here" in capsys.readouterr().err
    assert cli.run(["calibrate", str(project), "--scheduler", "nobody://three:1"]) == 2  # the user names it
    assert "scheduler nobody://three:1: does not answer" in capsys.readouterr().err


def test_an_address_without_a_scheduler_gives_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kennfeld.base.dask_runner.CONNECT_TIMEOUT", 0.2)
    project = write_cluster_project(tmp_path, listener.address)
    assert cli.run(["report", "--trust", str(project)]) == 2
    remark, error = capsys.readouterr().err.splitlines()
    assert remark.startswith(f"remark: joins the scheduler {listener.address}")
    assert error.startswith(f"scheduler {listener.address}: does not answer")
    assert listener.connections > 0


@pytest.mark.parametrize("content", ["{", "{}", '{"address": 7}', "[]"])
def test_a_file_without_the_address_of_a_scheduler_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str
) -> None:
    pytest.importorskip("distributed")
    (tmp_path / "scheduler.json").write_text(content)
    project = write_cluster_project(tmp_path, "scheduler.json")
    assert cli.run(["report", "--trust", str(project)]) == 2
    assert "scheduler.json: is not a file that a scheduler has written" in capsys.readouterr().err


def test_a_folder_of_partitions_elsewhere_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    elsewhere = tmp_path / "elsewhere"
    (tmp_path / "project").mkdir()
    project = write_cluster_project(tmp_path / "project", "")
    lines = f'scheduler = ""\npartition = 50\nfolder = "{elsewhere}"'
    project.write_text(project.read_text().replace('scheduler = ""', lines))
    assert cli.run(["check", str(project)]) == 2
    assert f"[cluster] folder: keeps prepared recordings in {elsewhere}, outside of" in capsys.readouterr().err
    assert not elsewhere.exists()
    assert cli.run(["check", "--trust", str(project)]) == 0
    assert elsewhere.exists()
