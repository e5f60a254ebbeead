"""The examples, and what README and documents show, work as written.

In a document the language of a block says what is done with it: `sh` lines that begin with `kennfeld` are run,
`python` is run from top to bottom, `kf` is read as formula text, `toml` with a `[model]` as a project file and with a
`[surrogate]` as a training file. A block that begins with `# NAME.toml`, `# NAME.kf`, `# NAME.py` or `# NAME.csv` (in
a `text` block) is there as a file when the `sh` lines run; one that begins with `# in NAME.toml` has been put into that
file, and one that begins with `# at the end of NAME.toml` appended to it. `cd` and `python NAME.py` are run as well; a
script of a tutorial runs only there, because it may read what the lines before it have written. Documents run in the
folder of the torque demo, README, `simulink-example.md` and pages of `examples` in that of the example they show,
tutorials in one of an example or in an empty one.

In long documents, fits end early and write no report, recordings of scripts are short, and the engine of the idle demo
is a small one. The longest documents run so only with the mark `slow`. Without it, they fit nothing: the command line
has to accept what they show, and their projects have to be right.
"""

import ast
import contextlib
import json
import re
import runpy
import shlex
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from kennfeld import Project, cli, formula
from kennfeld.optimize import Options
from kennfeld.project.demo import idle, prepare, write
from kennfeld.project.surrogate_training import read_training
from tests.importers.ascet.amd_files import Component, Drawing, Method, message, parameter, write_archive
from tests.importers.ascet.esdl_projects import BATTERY, write_project
from tests.importers.onnx.networks import perceptron, random_layers
from tests.importers.simulink.simulink_data import entry, sldd
from tests.importers.simulink.simulink_files import Model
from tests.project.flash_files import A2L, hex_of

ROOT = Path(__file__).parents[1]
PROJECTS = sorted((ROOT / "examples").glob("*/kennfeld.toml"))
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*/*.ipynb"))
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# standard deviation; of idle speed, 2/3 of the 114 rpm that are published as the best: a step of the set value cannot
# be followed at once
NOISE = {
    **{"air-flow": 1.0, "exhaust-temperature": 2.0, "simulink": 2.0, "idle-speed": 76.0, "nox": 8.0},
    **{
        "battery-cell": 0.0015,
        "maf-curve": 0.4,
        "motor-efficiency": 25.0,
        "pedal-map": 0.05,
        "sensor-drift": 0.15,
        "ve-table": 0.08,
    },
}
NEEDS = {"nox": ("onnx", "pycparser")}  # packages

QUICK = ("air-flow", "maf-curve", "motor-efficiency", "sensor-drift", "simulink")  # examples

# of tutorials: the example that they start from; the others start from a demo
STARTS = {"exhaust.md": "exhaust-temperature", "simulink.md": "simulink"}

LONG = {  # documents whose fits take several seconds
    *("commands.md", "get-started.md", "installation.md", "results.md", "simulink-example.md"),
    *(
        "how-to/ci.md",
        "how-to/delay.md",
        "how-to/export.md",
        "how-to/missing-terms.md",
        "how-to/monotonic-maps.md",
        "how-to/review.md",
        "how-to/rounding.md",
        "how-to/smoothness.md",
        "how-to/trust.md",
    ),
    *("examples/battery-cell.md", "examples/pedal-map.md", "examples/ve-table.md"),
    *("how-to/weights.md", "tutorials/exhaust.md", "tutorials/idle.md", "tutorials/simulink.md"),
    *("tutorials/torque.md", "tutorials/two-days.md"),
}
LONGEST = {  # documents with several fits
    *("commands.md", "get-started.md", "results.md", "simulink-example.md"),
    *("how-to/delay.md", "how-to/missing-terms.md", "how-to/smoothness.md"),
    *("tutorials/exhaust.md", "tutorials/idle.md", "tutorials/simulink.md", "tutorials/torque.md"),
    *("how-to/ci.md", "how-to/monotonic-maps.md", "how-to/trust.md", "how-to/weights.md"),
    *("examples/battery-cell.md", "examples/pedal-map.md", "examples/ve-table.md"),
    *("how-to/export.md", "how-to/review.md", "how-to/rounding.md"),
}

LONG_PYTHON = {"missing-terms.md", "python.md", "rounding.md", "surrogates.md"}  # documents

# whose models importers read
IMPORTING_EXAMPLES = {"nox", "simulink"}
IMPORTING_COMMANDS = {"README.md", "ascet.md", "formats.md", "simulink.md", "simulink-example.md"}
IMPORTING_PYTHON = {"ascet.md", "simulink.md"}
IMPORTING_PROJECTS = {"simulink-example.md"}


def marked(path, name, importing, is_slow=False):
    """Return an example or a document as parameter of a test, with its marks."""
    marks = [*([pytest.mark.slow] if is_slow else []), *([pytest.mark.guests] if name in importing else [])]
    return pytest.param(path, marks=marks, id=document_name(path) if path.suffix == ".md" else name)


def document_name(path):
    return path.relative_to(ROOT).as_posix()


by_name = pytest.mark.parametrize("document", DOCUMENTS, ids=document_name)


@pytest.fixture
def workplace(tmp_path, monkeypatch, demo_project):
    """A folder to run in, from a copy of an example or the torque demo."""

    def enter(document):
        folder = tmp_path / "work"
        if document.name == "README.md":
            shutil.copytree(ROOT / "examples" / "air-flow", folder)
            add_model(folder)
        elif document.name == "simulink-example.md":
            shutil.copytree(ROOT / "examples" / "simulink", folder)
        elif document.parent.name == "examples":
            shutil.copytree(ROOT / "examples" / document.stem, folder)
        elif is_tutorial(document) and document.name in STARTS:
            shutil.copytree(ROOT / "examples" / STARTS[document.name], folder)
        elif is_tutorial(document):
            folder.mkdir()
        else:
            shutil.copytree(demo_project, folder)
        monkeypatch.chdir(folder)
        return folder

    return enter


@pytest.fixture(scope="session")
def demo_project(tmp_path_factory):
    """The torque demo, not calibrated, with models of every kind; documents work in a copy."""
    folder = tmp_path_factory.mktemp("documents") / "demo"
    write("torque", folder)
    add_image(folder)
    add_model(folder)
    write_project(folder, BATTERY)
    add_components(folder)
    perceptron(folder / "knock.onnx", random_layers([2, 4, 1]))
    return folder


class Demos:
    """Demos that documents begin with, each run or only written once."""

    def __init__(self, folder, only_written=False):
        self.folder, self.only_written = folder, only_written

    def run(self, name):
        folder = self.folder / f"kennfeld-demo-{name}"
        if not folder.exists():
            with contextlib.chdir(self.folder):
                if self.only_written:
                    prepare(name, write(name, folder).parent, lambda *_: None)
                else:
                    assert cli.run(["demo", name]) == 0
        if not Path(folder.name).exists():
            shutil.copytree(folder, folder.name)


@pytest.fixture(scope="session")
def demos(tmp_path_factory):
    return Demos(tmp_path_factory.mktemp("demos"))


@pytest.fixture(scope="session")
def short_demos(tmp_path_factory):
    return Demos(tmp_path_factory.mktemp("short-demos"))


@pytest.fixture(scope="session")
def written_demos(tmp_path_factory):
    return Demos(tmp_path_factory.mktemp("written-demos"), only_written=True)


def override_options(monkeypatch, **values):
    """Replace settings of all searches, whatever they are given."""
    finish = Options.__post_init__

    def override(options):
        finish(options)
        for name, value in values.items():
            object.__setattr__(options, name, value)

    monkeypatch.setattr(Options, "__post_init__", override)


def shorten_runs(monkeypatch):
    """End fits early, without a report, cut recordings of scripts, and let the idle demo learn a small engine."""
    write_table = np.savetxt
    settings = idle.FILES["engine.toml"]()
    for key, number in (("centres", 20), ("iterations", 2)):
        settings = re.sub(rf"^{key} = \d+", f"{key} = {number}", settings, flags=re.MULTILINE)
    files = {
        "engine.toml": lambda: settings,
        "recording.csv": lambda: idle.recording("recording", 0.5, 1),
        "other_recording.csv": lambda: idle.recording("other_recording", 0.1, 2, "test"),
    }
    override_options(monkeypatch, tolerance=0.01, continuation="off", max_evaluations=100)
    monkeypatch.setattr("kennfeld.report.document_safely", lambda *_: "")  # whose faults no command reports
    monkeypatch.setattr(
        np, "savetxt", lambda file, table, *form, **head: write_table(file, table[:1500], *form, **head)
    )
    monkeypatch.setattr(idle, "FILES", idle.FILES | files)


def is_tutorial(document):
    return document.parent.name == "tutorials"


def add_image(folder):
    """An image with its A2L file, and values for it."""
    (folder / "ecu.a2l").write_text(A2L)
    (folder / "ecu.hex").write_text(hex_of(100, 200, 300, 50))
    (folder / "new.dcm").write_text("FESTWERT offset\n WERT 7.5\nEND\n")


def add_components(folder):
    """An archive of ASCET 6 with one module."""
    drawing = Drawing()
    drawing.write("mass", drawing.value_of("gain", "getAt", "oned", x=drawing.element("Speed")), ("Injection_calc", 1))
    elements = [message("Speed"), message("mass", "exported"), parameter("gain", ([0.0, 6000.0], [1.0, 2.0]))]
    write_archive(folder, Component("Injection", elements, [Method("Injection_calc")], drawing))


def add_model(folder):
    """A Simulink model with a subsystem in a subsystem, and a script and a dictionary that hold variables."""
    model = Model("engine")
    system = model
    for name in ("Engine", "Torque"):
        system.inport("n")
        system.outport("y")
        inner = system.subsystem(name)
        system.chain("n", name, "y")
        system = inner
    system.inport("n")
    system.block("Gain", "Times", Gain="2")
    system.block("Bias", "Plus", Bias="1")
    system.outport("y")
    system.chain("n", "Times", "Plus", "y")
    model.write(folder, "slx parts")
    (folder / "init.m").write_text("Slope = 2;\n")
    (folder / "data.sldd").write_bytes(sldd({"Offset": entry(1.0)}))


def require_packages(document):
    """Skip a test of a document whose scripts need a package that is not installed."""
    for package in set(re.findall(r"^from (skl2onnx) import", document.read_text(encoding="utf-8"), re.MULTILINE)):
        pytest.importorskip(package, reason=f"the package {package} is not installed")


def blocks(document, language):
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("project", [marked(path, path.parent.name, IMPORTING_EXAMPLES) for path in PROJECTS])
def test_every_example_is_free_of_warnings(project, tmp_path, capsys):
    for package in NEEDS.get(project.parent.name, ()):
        pytest.importorskip(package)
    folder = Path(shutil.copytree(project.parent, tmp_path / "example"))
    assert cli.run(["check", str(folder / "kennfeld.toml")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if not line.startswith(("remark: ", "reading: "))] == []  # progress, if it is slow


@pytest.mark.parametrize(
    "project",
    [marked(path, path.parent.name, IMPORTING_EXAMPLES, path.parent.name not in QUICK) for path in PROJECTS],
)
def test_every_example_is_calibrated_to_its_noise(project, tmp_path):
    for package in NEEDS.get(project.parent.name, ()):
        pytest.importorskip(package)
    folder = Path(shutil.copytree(project.parent, tmp_path / "example"))
    assert cli.run(["calibrate", str(folder / "kennfeld.toml")]) == 0
    result = json.loads((folder / "results" / "result.json").read_text(encoding="utf-8"))
    for row in result["quality"]:
        assert row["rmse_after"] < 1.5 * NOISE[project.parent.name]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_every_script_runs(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(script.read_text(encoding="utf-8"), str(script), "exec"), {"__name__": "__main__"})
    assert "converged" in capsys.readouterr().out


def shown_by(source, names):
    """Run a cell of a notebook as Jupyter does and return what it displays: HTML or PNG of its last expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    for method in ("_repr_html_", "_repr_png_"):
        if hasattr(value, method) and (content := getattr(value, method)()):
            return content
    return value


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_notebook_runs_and_displays_its_values(notebook, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(shutil.copytree(notebook.parent, tmp_path / "example"))
    content = json.loads(notebook.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    cells = ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == "code"]
    names = {"__name__": "__main__"}
    displays = [shown_by(cell, names) for cell in cells]
    assert names["result"].converged
    assert sum(isinstance(display, str) and "<table" in display for display in displays) >= 5
    assert sum(isinstance(display, bytes) and display.startswith(b"\x89PNG") for display in displays) >= 3
    assert not [display for display in displays if isinstance(display, str | bytes) and len(display) > 500_000]
    assert list(Path().glob("*.dcm"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_code_stored_without_outputs(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    assert [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")] == []
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(ast.parse(text).body for text in code)


def edited(text, change):
    """Set the keys of `change` in the same sections of a project file; of several `[[...]]`, in the first."""
    lines = text.splitlines()
    section = 0
    for line in change.splitlines()[1:]:
        if line.startswith("["):
            header = line.partition("#")[0].strip()
            if header not in lines:
                lines += ["", header]
            section = lines.index(header)
        elif key := re.match(r"(\w+) = ", line):
            end = next((n for n in range(section + 1, len(lines)) if lines[n].startswith("[")), len(lines))
            same = [n for n in range(section + 1, end) if lines[n].startswith(key[0])]
            lines[same[0] if same else section + 1 : same[0] + 1 if same else section + 1] = [line]
    return "\n".join(lines) + "\n"


def lay_out(text):
    """Write a block that names its file, or put it into the file that it changes."""
    if named := re.match(r"# ([\w-]+\.(?:toml|kf|py|csv))\b", text):
        Path(named[1]).write_text(text, encoding="utf-8")
    elif named := re.match(r"# in ([\w-]+\.toml)\n", text):
        Path(named[1]).write_text(edited(Path(named[1]).read_text(encoding="utf-8"), text), encoding="utf-8")
    elif named := re.match(r"# at the end of ([\w-]+\.toml)\n", text):
        with Path(named[1]).open("a", encoding="utf-8") as file:
            file.write("\n" + text.partition("\n")[2])


def prepare_files(document):
    """Write the formulas and measurements of a document that name their file, and run its scripts that write data."""
    require_packages(document)
    for text in [*blocks(document, "kf"), *blocks(document, "text"), *blocks(document, "python")]:
        lay_out(text)
    for text in blocks(document, "python"):
        if named := re.match(r"# ([\w-]+\.py)\b", text):
            runpy.run_path(named[1])


def accept(words):
    """Let the command line read a command without running it; check the project that it would calibrate."""
    context = cli.app.make_context("kennfeld", words[1:])
    name, command, arguments = cli.app.resolve_command(context, words[1:])
    parameters = command.make_context(name, arguments, parent=context).params
    if name == "calibrate":
        assert cli.run(["check", str(parameters["path"])]) == 0
    return 0


def run(line, monkeypatch, demos, run_command=lambda words: cli.run(words[1:])):
    if not re.match(r"(cd|python|kennfeld) ", line):
        return
    words = shlex.split(line, comments=True)
    if words[0] == "cd":
        monkeypatch.chdir(words[1])
    elif words[0] == "python" and Path(words[1]).exists():
        runpy.run_path(words[1])
    elif words[1] == "demo" and len(words) == 3:
        demos.run(words[2])
    elif words[0] == "kennfeld" and words[1] != "app":  # the app serves until it is stopped
        done = (0, 1) if words[1] == "diff" else (0,)  # 1 says that the files differ
        assert run_command(words) in done, line


IN_ORDER = re.compile(r"^```(sh|toml|kf|python|text)\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)


def run_all(document, folder, *arguments, compare=lambda shown: None):
    """Write what a document shows, and run its commands, in order; `compare` takes the output below a block of them."""
    (folder / "results").mkdir()
    if (folder / "start.dcm").exists():
        shutil.copy(folder / "start.dcm", folder / "results" / "parameters.dcm")
    content = document.read_text(encoding="utf-8")
    end_of_commands = len(content)
    for block in IN_ORDER.finditer(content):
        language, text = block.groups()
        if language == "sh":
            for line in text.splitlines():
                run(line, *arguments)
            end_of_commands = block.end()
            continue
        lay_out(text)
        between = content[end_of_commands : block.start()] if end_of_commands <= block.start() else "no commands"
        if language == "text" and not between.strip() and not text.startswith("kennfeld "):
            compare(text)


def shows_output(document):
    """Return whether a document shows below a block of commands what they print."""
    below = r"^```sh\n(?:(?!```).*\n)*```\n+```text\n(?!kennfeld )"
    return re.search(below, document.read_text(encoding="utf-8"), re.MULTILINE)


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")
TRAINED = re.compile(r"free run|limited\.toml")  # lines about a trained engine
TIMES = re.compile(r", \d+(?:\.\d+)? s$|^- +\d")  # of searches


def not_printed(shown, printed):
    """Return the lines shown that no printed line has: numbers to 5 %, chosen and trained ones roughly."""
    lines = {}
    for line in printed.splitlines():
        lines.setdefault(tuple(NUMBER.sub("#", line).split()), []).append([float(n) for n in NUMBER.findall(line)])
    wrong = []
    for line in shown.splitlines():
        if line.strip() in ("", "...") or TIMES.search(line):
            continue
        # the error hardly depends on the factors; what is trained differs between processors
        tolerance = 0.2 if line.startswith("smoothness of ") else 0.3 if TRAINED.search(line) else 0.05
        numbers = pytest.approx([float(n) for n in NUMBER.findall(line)], rel=tolerance)
        if not any(found == numbers for found in lines.get(tuple(NUMBER.sub("#", line).split()), ())):
            wrong.append(line)
    return wrong


WITH_COMMANDS = [
    document for document in DOCUMENTS if re.search(r"^kennfeld ", "\n".join(blocks(document, "sh")), re.MULTILINE)
]
LONG_DOCUMENTS = [ROOT / "docs" / name for name in sorted(LONG)]
LONGEST_DOCUMENTS = [ROOT / "docs" / name for name in sorted(LONGEST)]


@pytest.mark.parametrize(
    "document",
    [
        marked(path, path.name, IMPORTING_COMMANDS, path.name == "surrogates.md")
        for path in WITH_COMMANDS
        if path not in LONG_DOCUMENTS
    ],
)
def test_commands_shown_work(document, workplace, monkeypatch, demos):
    run_all(document, workplace(document), monkeypatch, demos)


@pytest.mark.parametrize(
    "document",
    [marked(path, path.name, IMPORTING_COMMANDS, path in LONGEST_DOCUMENTS) for path in LONG_DOCUMENTS],
)
def test_commands_of_long_documents_work_in_short_runs(document, workplace, monkeypatch, short_demos):
    shorten_runs(monkeypatch)
    run_all(document, workplace(document), monkeypatch, short_demos)


@pytest.mark.parametrize("document", [marked(path, path.name, IMPORTING_COMMANDS) for path in LONGEST_DOCUMENTS])
def test_commands_of_the_longest_documents_are_accepted(document, workplace, monkeypatch, written_demos):
    shorten_runs(monkeypatch)
    run_all(document, workplace(document), monkeypatch, written_demos, accept)


@pytest.mark.slow
@pytest.mark.parametrize(
    "document",
    [
        marked(path, path.name, IMPORTING_COMMANDS)
        for path in WITH_COMMANDS
        if shows_output(path) and path.name != "idle.md"  # searches with a trained engine, which differs by processor
    ],
)
def test_output_shown_is_what_the_commands_print(document, workplace, tmp_path, monkeypatch, capsys):
    wrong = []

    def compare(shown):
        printed = capsys.readouterr()
        wrong.extend(not_printed(shown, printed.out + printed.err))

    demos = tmp_path / "demos"
    demos.mkdir()
    run_all(document, workplace(document), monkeypatch, Demos(demos), compare=compare)
    assert wrong == []


def test_an_output_that_differs_from_what_is_printed_is_found():
    printed = "criterion  samples  RMSE after\nTorque         27       1.497\n519 values, 29 iterations, 0.35 s\n"
    assert (
        not_printed("criterion  samples  RMSE after\nTorque  27  1.50\n...\n519 values, 31 iterations, 9 s", printed)
        == []
    )
    assert not_printed("Torque  27  1.60\nDrag  27  1.497\n", printed) == ["Torque  27  1.60", "Drag  27  1.497"]


@pytest.mark.parametrize(
    "document",
    [
        marked(
            path,
            path.name,
            IMPORTING_PYTHON,
            path.name in LONG_PYTHON,
        )
        for path in DOCUMENTS
    ],
)
def test_python_shown_works(document, workplace, monkeypatch):
    texts = blocks(document, "python")
    code = "\n".join(text for text in texts if not (is_tutorial(document) and text.startswith("# ")))
    if not code:
        return
    require_packages(document)
    workplace(document)
    override_options(monkeypatch, max_evaluations=100)
    with contextlib.redirect_stdout(None):
        exec(compile(code, str(document), "exec"), {})


@by_name
def test_formulas_shown_can_be_read(document):
    for text in blocks(document, "kf"):
        assert formula(text).graph.names


@pytest.mark.parametrize("document", [marked(path, path.name, IMPORTING_PROJECTS) for path in DOCUMENTS])
def test_project_files_shown_are_right(document, workplace, tmp_path):
    texts = blocks(document, "toml")
    if is_tutorial(document):  # its project files are read, and run, by the commands that follow them
        texts = [text for text in texts if not text.startswith("# ")]
    if any("[model]" in text for text in texts):
        workplace(document)
        prepare_files(document)
    for text in texts:
        assert tomllib.loads(text)
        if "[model]" in text:
            Path("shown.toml").write_text(text, encoding="utf-8")
            errors = [str(f) for f in Project.read("shown.toml").check() if f.severity == "error"]
            assert errors == []
        if "[surrogate]" in text:
            (tmp_path / "shown.toml").write_text(text, encoding="utf-8")
            assert read_training(tmp_path / "shown.toml").settings


def test_the_readme_shows_what_the_demo_prints(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.run(["demo", "torque"]) == 0
    printed = capsys.readouterr().out.splitlines()
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = readme.partition("$ kennfeld demo torque\n")[2].partition("```")[0].splitlines()
    number = re.compile(r"\d+(?:\.\d+)?")
    for ours, theirs in zip(shown, printed[: len(shown)], strict=True):
        assert number.sub("", ours).split() == number.sub("", theirs).split()
        if ours.startswith("TorquePredict"):
            pairs = zip(number.findall(ours), number.findall(theirs), strict=True)
            assert all(float(one) == pytest.approx(float(other), rel=0.05) for one, other in pairs)
