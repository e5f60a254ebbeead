"""The commands as a user calls them; what they compute is tested where it is computed."""

import gzip
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from kennfeld import __version__, cli, read_parameters
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.measurement import cache as caching
from kennfeld.project.demo import write
from kennfeld.terminal import progress

COMMAND = [sys.executable, "-m", "kennfeld"]
ENDING = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.fixture(scope="session")
def pristine(tmp_path_factory):
    """A demo project that no test changes."""
    return write("torque", tmp_path_factory.mktemp("pristine")).parent


@pytest.fixture
def folder(pristine, tmp_path):
    """A demo project to spoil."""
    return Path(shutil.copytree(pristine, tmp_path / "demo"))


@pytest.fixture
def project(folder):
    return folder / "kennfeld.toml"


@pytest.fixture(scope="session")
def calibrated(pristine, tmp_path_factory):
    """A demo project with results, that no test changes."""
    folder = Path(shutil.copytree(pristine, tmp_path_factory.mktemp("calibrated") / "demo"))
    change(folder / "kennfeld.toml", 'continuation = "auto"', 'continuation = "off"')
    assert cli.run(["calibrate", str(folder / "kennfeld.toml")]) == 0
    return folder


@pytest.fixture
def calibrated_project(calibrated, tmp_path):
    """The file of a calibrated project to spoil."""
    return Path(shutil.copytree(calibrated, tmp_path / "demo")) / "kennfeld.toml"


@pytest.fixture
def growth(tmp_path):
    """The file of a project that takes tenths of a second: two values, and some iterations because of the exponent."""
    folder = tmp_path / "growth"
    folder.mkdir()
    rows = "\n".join(f"{x / 10},{2 * math.exp(0.3 * x / 10):.2f}" for x in range(30))
    (folder / "bench.csv").write_text(f"x,measured\n{rows}\n", encoding="utf-8")
    (folder / "model.kf").write_text("y = Gain * exp(Rate * x)\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(
        '[model]\nfile = "model.kf"\n[[dataset]]\nfiles = ["bench.csv"]\n[[criterion]]\nnode = "y"\n'
        'target = "measured"\n[parameters.Gain]\ninitial = 100.0\n[parameters.Rate]\ninitial = -1.0\n',
        encoding="utf-8",
    )
    return folder / "kennfeld.toml"


def slowly(seconds):
    """Return a command that rests after each step of a search, so that there is time to stop it."""
    code = (
        "import time; from kennfeld.terminal.progress import Interrupt; watch = Interrupt.watch; Interrupt.watch = "
        f"lambda self, progress: watch(self, lambda line: (progress(line), time.sleep({seconds}))); "
        "from kennfeld.cli import main; main()"
    )
    return [sys.executable, "-c", code]


def results_of(project):
    return json.loads((project.parent / "results" / "result.json").read_text(encoding="utf-8"))


def change(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def everything_in(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


class TestHelp:
    def test_lists_the_commands_of_this_version_and_no_others(self, capsys):
        assert cli.run(["--help"]) == 0
        commands = capsys.readouterr().out.partition("Commands:")[2].split("\n")
        names = [line.split()[0] for line in commands if line.strip()]
        assert names == [
            "demo",
            "app",
            "check",
            "calibrate",
            "simulate",
            "report",
            "propose",
            "design",
            "export",
            "info",
            "convert",
            "diff",
            "merge",
            "surrogate",
            "cache",
            "schema",
            "completion",
        ]

    def test_is_what_a_bare_call_shows(self, capsys):
        assert cli.run([]) == 0
        assert "Usage: kennfeld" in capsys.readouterr().out

    def test_the_version(self, capsys):
        assert cli.run(["--version"]) == 0
        assert capsys.readouterr().out == f"kennfeld {__version__}\n"

    @pytest.mark.parametrize(
        "command",
        [
            "demo",
            "check",
            "calibrate",
            "simulate",
            "report",
            "propose",
            "design",
            "export",
            "info",
            "convert",
            "diff",
            "merge",
            "surrogate",
        ],
    )
    def test_every_command_explains_itself(self, command):
        done = CliRunner().invoke(cli.app, [command, "--help"])
        assert done.exit_code == 0
        assert "Usage:" in done.output


class TestWrongUse:
    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["calibrate"], "Missing argument 'PROJECT'. See kennfeld calibrate --help."),
            (["calibrte", "x"], "Did you mean 'calibrate'? See kennfeld --help."),
            (["calibrate", "--worker", "3", "x"], "No such option '--worker'. Did you mean '--workers'? See"),
            (["calibrate", "--workers", "0", "x"], "Invalid value for '--workers': 0 is not in the range x>=1."),
            (["calibrate", "--workers", "some", "x"], "Invalid value for '--workers'"),
            (["surrogate", "trian"], "Did you mean 'train'? See kennfeld surrogate --help."),
            (["surrogate"], "Missing command. See kennfeld surrogate --help."),
            (["info", "a", "b"], "See kennfeld info --help."),
            (["demo", "boost"], "demo: unknown demo boost. The demos are: torque, exhaust, idle."),
            (["check", "nowhere/kennfeld.toml"], "the project file does not exist. Check the path."),
            (["info", "nowhere.csv"], "nowhere.csv: there is no such file. Check the path."),
            (["convert", "nowhere.dcm", "x.json"], "nowhere.dcm: there is no such file"),
        ],
    )
    def test_is_one_line_on_stderr_and_status_2(self, arguments, said, capsys, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert cli.run(arguments) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert said in err

    @pytest.mark.parametrize(
        "command", ["check", "calibrate", "simulate", "report", "propose", "design", "export", "info"]
    )
    def test_a_folder_is_no_file(self, command, tmp_path, capsys):
        assert cli.run([command, str(tmp_path)]) == 2
        assert capsys.readouterr().err.startswith(str(tmp_path))

    @pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="needs a user whom permissions bind")
    def test_a_file_that_may_not_be_read(self, project, capsys):
        project.chmod(0)
        assert cli.run(["check", str(project)]) == 2
        assert "Permission denied" in capsys.readouterr().err

    def test_an_error_of_the_system_is_no_traceback(self, project, capsys, monkeypatch):
        def fails(*_, **__):
            raise OSError(28, "No space left on device", "/disk")

        monkeypatch.setattr("kennfeld.project.Project.read", fails)
        assert cli.run(["check", str(project)]) == 2
        assert capsys.readouterr().err == "/disk: No space left on device\n"

    def test_memory_that_runs_out_is_no_traceback(self, project, capsys, monkeypatch):
        def fails(*_, **__):
            raise MemoryError("Unable to allocate 18.6 GiB")

        monkeypatch.setattr("kennfeld.project.Project.read", fails)
        assert cli.run(["check", str(project)]) == 2
        assert capsys.readouterr().err.startswith("Not enough memory (Unable to allocate 18.6 GiB). Use fewer")


def half(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2 - 3])


def blank(path, column):
    head, units, *rows = path.read_text(encoding="utf-8").splitlines()
    at = head.split(",").index(column)
    emptied = [",".join("" if i == at else cell for i, cell in enumerate(row.split(","))) for row in rows]
    path.write_text("\n".join([head, units, *emptied, ""]), encoding="utf-8")


def insert(path, line, text):
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([*lines[:line], text, *lines[line:], ""]), encoding="utf-8")


def second_start(folder):
    """A second initial file with another axis for the same curve."""
    change(folder / "kennfeld.toml", '"start.dcm" ', '["start.dcm", "more.dcm"] ')
    shutil.copy(folder / "start.dcm", folder / "more.dcm")
    change(folder / "more.dcm", "  -15.0 ", "  -14.0 ")


SPOILT = {
    "a missing channel": (lambda f: change(f / "bench.csv", "Ignition,", "Zuendung,"), ["Ignition", "bench"]),
    "a unit row in the middle": (lambda f: insert(f / "bench.csv", 100, "rpm,%,deg,Nm"), ["bench.csv", "101"]),
    "a column without a value": (lambda f: blank(f / "bench.csv", "Ignition"), ["Ignition"]),
    "an axis that does not increase": (
        lambda f: change(f / "start.dcm", "  -15.0 ", "  5.0 "),
        ["start.dcm", "CurveEtaDeltaSpark"],
    ),
    "a table of the wrong size": (
        lambda f: change(f / "start.dcm", "KENNLINIE CurveEtaDeltaSpark 12", "KENNLINIE CurveEtaDeltaSpark 13"),
        ["start.dcm", "CurveEtaDeltaSpark"],
    ),
    "a name that two files define differently": (second_start, ["CurveEtaDeltaSpark", "more.dcm", "start.dcm"]),
    "an unknown key": (lambda f: change(f / "kennfeld.toml", "use = ", "usage = "), ["usage", "Did you mean use?"]),
    "an algebraic loop": (lambda f: change(f / "torque.kf", "ignOpt - Ignition", "product - 1"), ["torque.kf", "loop"]),
    "an unknown parameter": (
        lambda f: change(f / "torque.kf", "MapOptTorque(", "MapOptTorqe("),
        ["torque.kf line 1", "Did you mean MapOptTorque?"],
    ),
    "a criterion that no sample reaches": (
        lambda f: change(f / "kennfeld.toml", 'files = ["bench.csv"]', 'files = ["bench.csv"]\nwhere = "Speed < 0"'),
        ["Speed < 0 is true at no sample"],
    ),
    "a target without a value": (lambda f: blank(f / "bench.csv", "Torque"), ["Torque"]),
    "half a measurement": (lambda f: half(f / "bench.csv"), ["bench.csv"]),
    "half a calibration file": (lambda f: half(f / "start.dcm"), ["start.dcm"]),
    "half a Parquet file": (lambda f: _half_parquet(f), ["bench.csv", "damaged"]),
    "half a project file": (lambda f: half(f / "kennfeld.toml"), ["kennfeld.toml"]),
    "a calibration in the place of a measurement": (
        lambda f: shutil.copy(f / "start.dcm", f / "bench.csv"),
        ["bench.csv", "DCM"],
    ),
    "a measurement in the place of a calibration": (
        lambda f: shutil.copy(f / "bench.csv", f / "start.dcm"),
        ["start.dcm"],
    ),
    "a picture in the place of a formula": (
        lambda f: (f / "torque.kf").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0"),
        ["torque.kf"],
    ),
    "an empty measurement": (lambda f: (f / "bench.csv").write_bytes(b""), ["bench.csv"]),
    "a file that is not there": (lambda f: (f / "fresh.csv").unlink(), ["fresh.csv"]),
    "a folder for a file": (lambda f: ((f / "torque.kf").unlink(), (f / "torque.kf").mkdir()), ["torque.kf"]),
}


def _half_parquet(folder):
    import pyarrow as pa
    import pyarrow.parquet

    pyarrow.parquet.write_table(pa.table({"Speed": list(range(1000))}), folder / "bench.csv")
    half(folder / "bench.csv")


class TestBadInput:
    @pytest.mark.parametrize(
        ("kind", "command"),
        [
            *((kind, "check") for kind in SPOILT),
            ("half a measurement", "calibrate"),
            *(pytest.param(k, "calibrate", marks=pytest.mark.slow) for k in SPOILT if k != "half a measurement"),
        ],
    )
    def test_is_named_with_its_place_and_nothing_is_written(self, kind, command, folder, capsys, monkeypatch):
        monkeypatch.setattr(caching, "_worth", lambda source: math.inf)  # a busy machine keeps what was slow to read
        spoil, words = SPOILT[kind]
        spoil(folder)
        before = everything_in(folder)
        assert cli.run([command, str(folder / "kennfeld.toml")]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert all(word in err for word in words), err
        assert len([line for line in err.splitlines() if not line.startswith(("    ", "warning: "))]) <= 3, err
        assert everything_in(folder) == before

    def test_the_excerpt_shows_the_place(self, folder, project, capsys):
        change(folder / "torque.kf", "ignOpt - Ignition", "product - 1")
        assert cli.run(["check", str(project)]) == 2
        line, excerpt, marks = capsys.readouterr().err.splitlines()
        assert line.startswith("torque.kf line 3")
        assert excerpt == "    3 deltaSpark[-] = product - 1"
        assert marks == "      ^^^^^^^^^^"

    def test_a_constant_channel_is_a_warning(self, folder, capsys):
        head, units, *rows = (folder / "bench.csv").read_text(encoding="utf-8").splitlines()
        rows = [",".join([row.split(",")[0], "50", *row.split(",")[2:]]) for row in rows]
        (folder / "bench.csv").write_text("\n".join([head, units, *rows, ""]), encoding="utf-8")
        assert cli.run(["check", str(folder / "load-only.toml")]) == 0
        out, err = capsys.readouterr()
        assert "with warnings" in out
        assert "channel Rel_Airmass is constant (50)" in err
        assert all(line.startswith("warning: ") for line in err.splitlines())

    @pytest.mark.slow
    def test_a_remark_is_told_and_is_no_warning(self, folder, project, capsys):
        inputs = "input Speed[rad/s]\ninput Rel_Airmass\ninput Ignition\n"
        text = (folder / "torque.kf").read_text(encoding="utf-8")
        (folder / "torque.kf").write_text(inputs + text, encoding="utf-8")
        assert cli.run(["check", str(project)]) == 0
        out, err = capsys.readouterr()
        remarks = [line for line in err.splitlines() if line.startswith("remark: ")]
        assert any("channel Speed is converted from rpm to rad/s, the unit of the input Speed" in t for t in remarks)
        assert ("with warnings" in out) == any(line.startswith("warning: ") for line in err.splitlines())

    def test_every_problem_is_named_at_once(self, folder, project, capsys):
        change(project, "smoothness = 10\n", "smothness = 10\n")
        change(project, "[optimizer]", "[optimiser]")
        assert cli.run(["check", str(project)]) == 2
        err = capsys.readouterr().err
        assert "Did you mean smoothness?" in err
        assert "Did you mean optimizer?" in err

    def test_a_folder_that_takes_no_results_is_found_before_the_search(self, folder, project, capsys, monkeypatch):
        monkeypatch.setattr("kennfeld.project.Project.calibrate", lambda *_, **__: pytest.fail("searched in vain"))
        (folder / "results").write_text("a file", encoding="utf-8")
        assert cli.run(["calibrate", str(project)]) == 2
        assert "results: cannot be written" in capsys.readouterr().err


class TestCalibrate:
    def test_ends_with_a_table_and_the_place_of_the_results(self, folder, project, capsys):
        change(project, 'continuation = "auto"', 'continuation = "off"')
        assert cli.run(["calibrate", str(project)]) == 0
        out, err = capsys.readouterr()
        assert "RMSE before" in out.splitlines()[0]
        assert "training" in out
        assert "converged" in out
        assert f"Written to {folder / 'results'}: " in out
        assert "iteration" in err
        assert "iteration  " not in out

    def test_writes_where_it_is_told_to(self, growth, tmp_path):
        assert cli.run(["calibrate", str(growth), "-o", str(tmp_path / "elsewhere")]) == 0
        assert (tmp_path / "elsewhere" / "result.json").exists()

    def test_a_fit_that_ran_out_of_iterations_is_status_1(self, growth, capsys):
        change(growth, "[parameters.Gain]", "[optimizer]\nmax_iterations = 2\n[parameters.Gain]")
        assert cli.run(["calibrate", str(growth)]) == 1
        assert "max_iterations" in capsys.readouterr().out
        assert results_of(growth)["status"] == "max_iterations"

    def test_a_fit_that_is_worse_than_its_start_is_a_warning(self, tmp_path, capsys):
        rows = "\n".join(f"{x},{5 * (-1) ** x}" for x in range(8))
        (tmp_path / "bench.csv").write_text(f"x,y\n{rows}\n", encoding="utf-8")
        (tmp_path / "model.kf").write_text("m = C(x)\n", encoding="utf-8")
        (tmp_path / "kennfeld.toml").write_text(
            '[model]\nfile = "model.kf"\n[[dataset]]\nfiles = ["bench.csv"]\n'
            '[[criterion]]\nnode = "m"\ntarget = "y"\n[parameters.C]\n'
            'x = { input = "x", begin = 0, end = 7, count = 8 }\nsmoothness = 1000\n'
            f"initial = {[5.1 * (-1) ** x for x in range(8)]}\n",
            encoding="utf-8",
        )
        assert cli.run(["calibrate", str(tmp_path / "kennfeld.toml")]) == 0
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: Smooth")]
        assert line.startswith("warning: Smoothness outweighs the data: the RMSE of m on bench rises from 0.1 to ")
        (entry,) = json.loads((tmp_path / "results" / "result.json").read_text(encoding="utf-8"))["warnings"]
        assert line == f"warning: {entry['sentence']} {entry['remedy']}"

    @pytest.mark.slow
    def test_a_calibrated_set_is_a_start_like_any_other(self, calibrated_project):
        change(calibrated_project, "start.dcm", "results/parameters.dcm")
        assert cli.run(["check", str(calibrated_project)]) == 0


class TestHowManyValues:
    @pytest.mark.slow
    def test_check_and_calibrate_count_the_same(self, folder, project, capsys):
        change(project, "[parameters.CurveEtaDeltaSpark]", "[parameters.CurveEtaDeltaSpark]\nlock = [{ x = [0, 20] }]")
        assert cli.run(["check", str(project)]) == 0
        counted = int(capsys.readouterr().out.splitlines()[1].split()[0])
        change(project, "[optimizer]", "[optimizer]\nmax_iterations = 1")
        change(project, 'continuation = "auto"', "")
        cli.run(["calibrate", str(project)])
        stored = json.loads((folder / "results" / "result.json").read_text(encoding="utf-8"))
        assert stored["values"]["free"] == counted < stored["values"]["free"] + stored["values"]["fixed"]


class TestCtrlC:
    def test_stops_at_the_best_values_and_writes_them(self, folder, project, capfd, monkeypatch):
        lines = []

        def press(self, line):
            lines.append(line)
            if len(lines) == 3:
                signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(progress._Lines, "__call__", press)
        assert cli.run(["calibrate", str(project)]) == 130
        stored = json.loads((folder / "results" / "result.json").read_text(encoding="utf-8"))
        assert stored["status"] == "stopped"
        assert stored["cost"]["after"] < 0.01 * stored["cost"]["before"]
        assert len(lines) == 3
        assert "Ctrl-C again" in capfd.readouterr().err

    def test_twice_gives_up_without_results(self, folder, project, monkeypatch):
        def press(self, line):
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(progress._Lines, "__call__", press)
        with pytest.raises(SystemExit) as ended:
            cli.run(["calibrate", str(project)])
        assert ended.value.code == 130
        assert not (folder / "results").exists()

    def test_before_the_descent_writes_nothing(self, folder, project, capsys, monkeypatch):
        monkeypatch.setattr("kennfeld.project.Project.calibrate", lambda *_, **__: signal.raise_signal(signal.SIGINT))
        assert cli.run(["calibrate", str(project)]) == 130
        assert "before there was anything to write" in capsys.readouterr().err
        assert not (folder / "results").exists()

    def test_leaves_the_handlers_as_they_were(self, growth):
        before = [signal.getsignal(getattr(signal, name)) for name in ENDING]
        cli.run(["calibrate", str(growth)])
        assert [signal.getsignal(getattr(signal, name)) for name in ENDING] == before

    @pytest.mark.slow
    @pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
    def test_reaches_a_running_process(self, growth):
        running = subprocess.Popen(
            [*slowly(1), "calibrate", str(growth)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        while "iteration" not in running.stderr.readline():
            assert running.poll() is None
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=120)
        assert running.returncode == 130
        assert "stopped: " in out
        assert "Traceback" not in err
        assert results_of(growth)["status"] == "stopped"
        assert results_of(growth)["cost"]["after"] < results_of(growth)["cost"]["before"]


class TestRequestsToEnd:
    @pytest.mark.parametrize("name", [name for name in ENDING if name != "SIGINT"])
    def test_stop_at_the_best_values_and_write_them(self, growth, monkeypatch, name):
        lines = []

        def press(self, line):
            lines.append(line)
            if len(lines) == 3:
                signal.raise_signal(getattr(signal, name))

        monkeypatch.setattr(progress._Lines, "__call__", press)
        assert cli.run(["calibrate", str(growth)]) == 130
        assert results_of(growth)["status"] == "stopped"
        assert len(lines) == 3

    @pytest.mark.parametrize("first", [name for name in ENDING if name != "SIGINT"])
    def test_twice_give_up_without_results(self, growth, monkeypatch, first):
        def press(self, line):
            signal.raise_signal(getattr(signal, first))
            signal.raise_signal(signal.SIGTERM)

        monkeypatch.setattr(progress._Lines, "__call__", press)
        with pytest.raises(SystemExit) as ended:
            cli.run(["calibrate", str(growth)])
        assert ended.value.code == 130
        assert not (growth.parent / "results").exists()

    @pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs SIGHUP")
    def test_a_closing_terminal_may_say_so_twice(self, growth, monkeypatch):
        def press(self, line):
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGHUP)

        monkeypatch.setattr(progress._Lines, "__call__", press)
        assert cli.run(["calibrate", str(growth)]) == 130
        assert (growth.parent / "results" / "result.json").exists()

    @pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="needs SIGHUP")
    def test_one_that_is_ignored_stays_ignored(self, growth, monkeypatch):
        before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
        try:
            monkeypatch.setattr(progress._Lines, "__call__", lambda *_: signal.raise_signal(signal.SIGHUP))
            assert cli.run(["calibrate", str(growth)]) == 0
        finally:
            signal.signal(signal.SIGHUP, before)

    @pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
    def test_end_any_command(self, project):
        code = (
            "import time; from kennfeld import cli; from kennfeld.project import Project\n"
            "Project.read = lambda path, **_: (print('reading', flush=True), time.sleep(60))\n"
            "cli.main()"
        )
        running = subprocess.Popen(
            [sys.executable, "-c", code, "check", str(project)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert running.stdout.readline() == "reading\n"
        running.terminate()
        _, err = running.communicate(timeout=60)
        assert (running.returncode, err) == (130, "")

    @pytest.mark.slow
    @pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
    def test_a_terminal_that_closes_loses_no_result(self, growth):
        terminal, other_end = os.openpty()
        code = (
            "import os, sys\n"
            "terminal = os.open(os.ttyname(0), os.O_RDWR)\n"  # the first that a session opens becomes its own
            "for number in range(3): os.dup2(terminal, number)\n"
            "os.close(terminal)\nos.execv(sys.argv[1], sys.argv[1:])"
        )
        running = subprocess.Popen(
            [sys.executable, "-c", code, *slowly(1), "calibrate", str(growth)], stdin=other_end, start_new_session=True
        )
        os.close(other_end)
        seen = b""
        while b"iteration" not in seen:
            seen += os.read(terminal, 1000)
        os.close(terminal)
        assert running.wait(timeout=120) == 130
        assert results_of(growth)["status"] == "stopped"


class TestAFolderThatCannotBeWritten:
    @pytest.fixture(autouse=True)
    def full(self, monkeypatch):
        def fails(path):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("kennfeld.project.folder_replacement._sync", fails)

    def test_costs_neither_the_table_nor_the_values(self, growth, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        assert cli.run(["calibrate", str(growth)]) == 2
        out, err = capsys.readouterr()
        (other,) = tmp_path.glob("kennfeld-results-*")
        assert "RMSE before" in out
        assert f"Written to {other}: parameters.json" in out
        assert "results: cannot be written: No space left on device. Written to" in err

    def test_nor_do_the_values_get_lost_where_nothing_can(self, growth, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
        assert cli.run(["calibrate", str(growth)]) == 2
        out, err = capsys.readouterr()
        values = json.loads(out.partition("The values, as parameters.json:\n")[2])
        assert values["Gain"]["kind"] == "scalar"
        assert "A temporary folder cannot be written either." in err


class TestSeveralStarts:
    @pytest.mark.slow
    @pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
    def test_are_told_of_one_by_one(self, growth, capsys, workers):
        change(growth, "[parameters.Gain]", "[optimizer]\nstarts = 3\n[parameters.Gain]\nbounds = [0, 200]")
        change(growth, "initial = -1.0", "initial = -1.0\nbounds = [-1, 1]")
        assert cli.run(["calibrate", str(growth), "--workers", str(workers)]) == 0
        out, err = capsys.readouterr()
        assert "Best of 3 starts" in out
        rows = [line.split() for line in out.splitlines()]
        at = rows.index(["start", "status", "cost", "before", "cost", "after", "iterations", "distance"])
        assert [row[0] for row in rows[at + 1 : at + 4]] == ["1", "2", "3"]
        assert {line[:8] for line in err.splitlines()} == {"start  1", "start  2", "start  3"}
        assert [row["start"] for row in results_of(growth)["starts"]] == [1, 2, 3]
        starts = [line.split(",")[1] for line in (growth.parent / "results" / "trace.csv").read_text().splitlines()[1:]]
        assert starts == sorted(starts)
        assert set(starts) == {"1", "2", "3"}

    @pytest.mark.slow
    @pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
    def test_stop_at_ctrl_c_together(self, folder, project):
        change(project, "[optimizer]", "[optimizer]\nstarts = 40")
        running = subprocess.Popen(
            [*COMMAND, "calibrate", str(project), "--workers", "2"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert "start" in running.stderr.readline()
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does
        out, err = running.communicate(timeout=120)
        assert running.returncode == 130
        assert "stopped: Stopped on request; these are the best values so far. Best of 40 starts" in out
        assert "Traceback" not in err
        assert (folder / "results" / "parameters.json").exists()


def children(pid):
    """Processes that a process has started; Linux tells in the file system."""
    processes = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            processes.append(int(stat.parent.name))
    return processes


class TestResume:
    def wait(self, condition):
        """Until a condition holds."""
        for _ in range(3000):
            if condition():
                return
            time.sleep(0.02)
        pytest.fail("it never came")

    @pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
    @pytest.mark.slow
    @pytest.mark.parametrize("starts", [1, 6])
    def test_goes_on_after_a_process_was_killed(self, folder, project, capsys, starts):
        steps = "[[step]]\ngrid_reduction = 2\n[[step]]\n"
        change(project, "[optimizer]", f"{steps}[optimizer]\nsave_every = 3\nstarts = {starts}")
        running = subprocess.Popen(
            [*(slowly(0.1) if starts == 1 else COMMAND), "calibrate", str(project), "--workers", "2"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        saves = folder / "results" / "saves"
        self.wait(lambda: len(list(saves.glob("*.json"))) >= 4 and any(saves.glob("1-*.json")))
        workers = children(running.pid) if sys.platform == "linux" else []
        running.kill()
        assert running.wait(timeout=60) == -signal.SIGKILL
        assert not (folder / "results" / "result.json").exists()
        assert len(workers) == (0 if starts == 1 else 2) or sys.platform != "linux"
        self.wait(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
        fewer = f"starts = {min(starts, 3)}\nmax_iterations = 1000\ntolerance = 1e-3\ncontinuation = 'off'"
        change(project, f"starts = {starts}", fewer)
        change(project, 'continuation = "auto"', "")
        assert cli.run(["calibrate", str(project), "--resume"]) == 0
        out, err = capsys.readouterr()
        assert "Resumed from saves/1-" in out
        assert "warning: kennfeld.toml: changed since the checkpoints were written" in err
        stored = json.loads((folder / "results" / "result.json").read_text(encoding="utf-8"))
        assert stored["status"] == "converged"
        assert stored["resumed"][0].startswith("saves/1-")
        assert stored["quality"][0]["rmse_after"] < 1.8

    def test_without_saved_states_is_refused(self, project, capsys):
        assert cli.run(["calibrate", str(project), "--resume"]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "no checkpoint to resume from. Set save_every in [optimizer]" in err


class TestSimulate:
    def test_writes_beside_the_project(self, folder, project, capsys):
        assert cli.run(["simulate", str(project)]) == 0
        assert (folder / "simulation.parquet").exists()
        assert "bench: 2812 samples" in capsys.readouterr().out

    def test_takes_other_parameters(self, folder, project, tmp_path):
        import pyarrow.csv

        shutil.copy(folder / "start.dcm", folder / "other.dcm")
        change(folder / "other.dcm", "82.5", "100.0")
        target = tmp_path / "s.csv"
        assert cli.run(["simulate", str(project), "-p", str(folder / "other.dcm"), "-o", str(target)]) == 0
        table = pyarrow.csv.read_csv(target)
        assert table["trqOpt"].to_pylist() == pytest.approx([100.0] * (2812 + 27 + 1000))

    def test_refuses_other_formats(self, project, capsys):
        assert cli.run(["simulate", str(project), "-o", "simulation.xlsx"]) == 2
        assert ".parquet, .csv, .mf4 or .mat, got .xlsx" in capsys.readouterr().err


class TestReport:
    def test_comes_with_the_other_results(self, calibrated):
        text = (calibrated / "results" / "report.html").read_text(encoding="utf-8")
        assert text.startswith("<!doctype html>")
        assert "MapOptTorque" in text

    def test_can_be_made_again_from_the_results(self, calibrated_project, capsys):
        report = calibrated_project.parent / "results" / "report.html"
        report.unlink()
        assert cli.run(["report", str(calibrated_project)]) == 0
        assert f"Written to {report}" in capsys.readouterr().out
        assert "converged" in report.read_text(encoding="utf-8")

    def test_goes_where_it_is_told_to_and_takes_the_results_it_is_told_to(self, folder, project, calibrated, tmp_path):
        shutil.copytree(calibrated / "results", tmp_path / "second")
        target = tmp_path / "for the customer.html"
        assert cli.run(["report", str(project), "-r", str(tmp_path / "second"), "-o", str(target)]) == 0
        assert "Not calibrated yet" not in target.read_text(encoding="utf-8")
        assert not (folder / "results").exists()

    def test_without_results_tells_about_the_start(self, folder, project):
        assert cli.run(["report", str(project)]) == 0
        text = (folder / "results" / "report.html").read_text(encoding="utf-8")
        assert "Not calibrated yet" in text

    def test_damaged_results_are_named(self, calibrated_project, capsys):
        (calibrated_project.parent / "results" / "result.json").write_text("{", encoding="utf-8")
        assert cli.run(["report", str(calibrated_project)]) == 2
        assert "result.json: not a valid result file" in capsys.readouterr().err


class TestInfo:
    @pytest.mark.parametrize(
        ("name", "content", "part"),
        [
            ("bench.csv", "measurement", "Rel_Airmass"),
            ("start.dcm", "calibration", "19 x 13"),
            ("torque.kf", "formula", "MapDragTorque"),
            ("kennfeld.toml", "project", "TorquePredict"),
        ],
    )
    def test_tells_what_is_in_a_file(self, name, content, part, pristine, capsys):
        assert cli.run(["info", str(pristine / name)]) == 0
        out = capsys.readouterr().out
        assert content in out.splitlines()[0]
        assert part in out
        assert cli.run(["info", "--json", str(pristine / name)]) == 0
        info = json.loads(capsys.readouterr().out)
        assert (info["content"], info["file"]) == (content, name)

    @pytest.mark.parametrize("name", ["bench.csv", "start.dcm", "torque.kf"])
    def test_shows_what_is_searched_alone(self, name, pristine, capsys):
        assert cli.run(["info", str(pristine / name), "--search", "torq"]) == 0
        out = capsys.readouterr().out
        assert "Torq" in out
        assert "Ignition " not in out
        assert cli.run(["info", "--json", str(pristine / name), "--search", "torq"]) == 0
        info = json.loads(capsys.readouterr().out)
        assert "Torq" in json.dumps(info)
        assert "Eta" not in json.dumps(info)

    def test_names_the_nearest_where_nothing_is_found(self, pristine, capsys):
        assert cli.run(["info", str(pristine / "bench.csv"), "--search", "Ignitoin"]) == 2
        assert "bench.csv: no name or description contains 'Ignitoin'" in (said := capsys.readouterr().err)
        assert "Did you mean Ignition?" in said

    @pytest.mark.parametrize(
        ("name", "content"),
        [
            ("bench.csv", "measurement"),
            ("start.dcm", "calibration"),
            ("torque.kf", "formula"),
            ("kennfeld.toml", "project"),
        ],
    )
    def test_goes_by_the_content_not_by_the_name(self, name, content, folder, capsys):
        shutil.move(folder / name, folder / "renamed.txt")
        assert cli.run(["info", "--json", str(folder / "renamed.txt")]) == 0
        assert json.loads(capsys.readouterr().out)["content"] == content


class TestConvert:
    def test_keeps_every_value(self, folder, tmp_path):
        start = read_parameters(folder / "start.dcm")
        steps = [folder / "start.dcm", tmp_path / "a.json", tmp_path / "b.csv", tmp_path / "c.dcm"]
        for source, target in pairwise(steps):
            assert cli.run(["convert", str(source), str(target)]) == 0
        after = read_parameters(tmp_path / "c.dcm")
        assert {name: after[name].values.tolist() for name in after} == {
            name: start[name].values.tolist() for name in start
        }

    def test_tells_what_the_new_file_has_no_place_for(self, tmp_path, capsys):
        ParameterSet([Scalar("K", 1.0, description="gain")]).save(tmp_path / "a.dcm")
        assert cli.run(["convert", str(tmp_path / "a.dcm"), str(tmp_path / "a.csv")]) == 0
        said = "a.csv: descriptions are left out: 1 label (K). Write it as .json to keep them."
        assert said in capsys.readouterr().err

    def test_replaces_a_file_by_force_alone(self, folder, capsys):
        source, target = folder / "start.dcm", folder / "new.json"
        target.write_text("mine", encoding="utf-8")
        assert cli.run(["convert", str(source), str(target)]) == 2
        said = f"{target}: already exists. Add --force to replace it, or name another file.\n"
        assert (capsys.readouterr().err, target.read_text(encoding="utf-8")) == (said, "mine")
        assert cli.run(["convert", str(source), str(target), "--force"]) == 0
        assert read_parameters(target) == read_parameters(source)

    def test_force_does_not_replace_a_write_protected_file(self, folder, capsys):
        target = folder / "new.json"
        target.write_text("mine", encoding="utf-8")
        target.chmod(0o444)
        assert cli.run(["convert", str(folder / "start.dcm"), str(target), "--force"]) == 2
        said = f"{target}: cannot be written: it is write-protected. Choose another path.\n"
        assert (capsys.readouterr().err, target.read_text(encoding="utf-8")) == (said, "mine")

    def test_an_unknown_ending_is_refused(self, folder, capsys):
        assert cli.run(["convert", str(folder / "start.dcm"), "start.xyz"]) == 2
        assert ".dcm" in capsys.readouterr().err


class TestSurroundings:
    """What stdout and stderr are connected to."""

    def process(self, arguments, **environment):
        return subprocess.run(
            [*COMMAND, *map(str, arguments)], capture_output=True, env=os.environ | environment, check=False
        )

    def test_a_reader_that_goes_away_is_no_error(self, pristine):
        running = subprocess.Popen(
            [*COMMAND, "info", str(pristine / "start.dcm")], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        running.stdout.close()
        assert running.stderr.read() == b""
        running.stderr.close()
        assert running.wait(timeout=60) == 0

    def test_characters_that_stdout_cannot_show_do_no_harm(self, folder):
        change(folder / "start.dcm", "Drag torque", "Öldruck Ω")
        done = self.process(["info", folder / "start.dcm"], PYTHONIOENCODING="ascii")
        assert done.returncode == 0
        assert b"?ldruck ?" in done.stdout

    def test_a_narrow_terminal_gets_a_block_a_row(self, growth, capsys, monkeypatch):
        monkeypatch.setenv("COLUMNS", "40")
        assert cli.run(["calibrate", str(growth)]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[0].split() == ["criterion", "y"]
        assert all(len(line) <= 40 for line in lines[: lines.index("") + 1])

    @pytest.mark.parametrize("environment", [{}, pytest.param({"NO_COLOR": "1"}, marks=pytest.mark.slow)])
    def test_a_terminal_gets_a_live_line_and_the_same_table(self, growth, environment):
        pty = pytest.importorskip("pty")
        ours, theirs = pty.openpty()
        running = subprocess.Popen(
            [*COMMAND, "calibrate", str(growth)],
            stdout=subprocess.PIPE,
            stderr=theirs,
            env=os.environ | {"TERM": "xterm"} | environment,
        )
        os.close(theirs)
        out = running.stdout.read().decode()
        running.stdout.close()
        assert running.wait(timeout=120) == 0
        shown = b""
        while True:
            try:
                chunk = os.read(ours, 65536)
            except OSError:
                break
            if not chunk:
                break
            shown += chunk
        os.close(ours)
        assert "RMSE before" in out.splitlines()[0]
        assert b"\r" in shown
        assert b"Traceback" not in shown

    def test_the_module_is_the_command(self):
        done = self.process(["--version"])
        assert done.stdout.decode().strip() == f"kennfeld {__version__}"


class TestDiffAndMerge:
    @pytest.fixture
    def files(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        ParameterSet([Scalar("K", 1.0), Scalar("Old", 1.0)]).save("a.dcm")
        ParameterSet([Scalar("K", 1.0 + 2**-52)]).save("b.cdfx")
        return tmp_path

    def test_equal_files_end_with_0(self, files, capsys):
        assert cli.run(["convert", "a.dcm", "a.cdfx"]) == 0
        assert cli.run(["diff", "a.dcm", "a.cdfx"]) == 0
        assert capsys.readouterr().out.endswith("equal: 2 names in both\n")

    def test_the_last_bit_counts_without_a_tolerance(self, files, capsys):
        assert cli.run(["diff", "a.dcm", "b.cdfx"]) == 1
        assert "1.0000000000000002" in capsys.readouterr().out
        assert cli.run(["diff", "a.dcm", "b.cdfx", "--relative", "1e-15"]) == 1
        assert capsys.readouterr().out.endswith("0 of 1 name in both differ, 1 only in a.dcm\n")

    def test_json_for_a_program(self, files, capsys):
        assert cli.run(["diff", "a.dcm", "b.cdfx", "--json"]) == 1
        comparison = json.loads(capsys.readouterr().out)
        assert (comparison["left"], comparison["right"], comparison["equal"], comparison["compared"]) == (
            "a.dcm",
            "b.cdfx",
            False,
            1,
        )
        assert comparison["differences"][0]["right"] - comparison["differences"][0]["left"] == 2**-52
        assert [one["aspect"] for one in comparison["differences"]] == ["values", "presence"]

    def test_wrong_files_are_all_named_with_2(self, files, capsys):
        (files / "c.dcm").write_text("FESTWERT K\nWERT x\nEND\n")
        assert cli.run(["diff", "c.dcm", "nowhere.dcm"]) == 2
        stderr = capsys.readouterr().err
        assert "c.dcm line 2 (K): must be a finite number, got 'x'" in stderr
        assert "nowhere.dcm: there is no such file" in stderr

    @pytest.mark.parametrize(
        ("option", "given", "said"),
        [
            ("--tolerance", "-1", "Invalid value for '--tolerance'"),
            ("--relative", "some", "Invalid value for '--relative'"),
            ("--relative", "inf", "relative must be a finite number >= 0, got inf"),
        ],
    )
    def test_a_wrong_tolerance_is_refused(self, files, option, given, said, capsys):
        assert cli.run(["diff", "a.dcm", "b.cdfx", option, given]) == 2
        assert said in capsys.readouterr().err

    def test_merge_tells_what_it_replaced(self, files, capsys):
        assert cli.run(["merge", "a.dcm", "b.cdfx", "-o", "c.json"]) == 0
        assert "b.cdfx: 1 replaced\n\nWritten to c.json\n" in capsys.readouterr().out
        assert read_parameters("c.json") == ParameterSet([Scalar("K", 1.0 + 2**-52), Scalar("Old", 1.0)])

    def test_merge_may_write_onto_its_input_by_force(self, files, capsys):
        before = everything_in(files)
        assert cli.run(["merge", "a.dcm", "b.cdfx", "-o", "a.dcm"]) == 2
        assert capsys.readouterr().err == "a.dcm: already exists. Add --force to replace it, or name another file.\n"
        assert everything_in(files) == before
        assert cli.run(["merge", "a.dcm", "b.cdfx", "-o", "a.dcm", "--force"]) == 0
        assert read_parameters("a.dcm")["K"].value == 1.0 + 2**-52

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["a.dcm", "-o", "c.dcm"], "merge: needs at least two files, got only a.dcm. Name another file."),
            (["a.dcm", "b.cdfx"], "Missing option '-o'"),
            (["a.dcm", "b.cdfx", "-o", "c.dmc"], "Did you mean .dcm?"),
            (["a.dcm", "b.cdfx", "-o", "nowhere/c.dcm"], "cannot be written"),
        ],
    )
    def test_a_merge_that_fails_writes_nothing(self, files, arguments, said, capsys):
        before = everything_in(files)
        assert cli.run(["merge", *arguments]) == 2
        assert said in capsys.readouterr().err
        assert everything_in(files) == before


def test_a_file_that_ends_too_early_is_no_interrupt(tmp_path, capsys):
    path = tmp_path / "drive.csv.gz"
    path.write_bytes(gzip.compress(b"time,a\n0,1\n1,2\n")[:14])
    assert cli.run(["info", str(path)]) == 2
    assert "drive.csv.gz: the compressed file is damaged or cut off" in capsys.readouterr().err


def test_an_end_of_file_that_nobody_expects_is_not_taken_for_ctrl_c(monkeypatch):
    def fail(*arguments):
        raise EOFError("unexpected")

    monkeypatch.setattr("kennfeld.terminal.file_info.describe_file", fail)
    with pytest.raises(EOFError, match="unexpected"):
        cli.run(["info", "bench.csv"])
