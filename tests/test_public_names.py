import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import kennfeld
from tests.guests import marked

ROOT = Path(__file__).parents[1]

PROMISED = {
    *("Project", "Dataset", "Channel", "Model", "Graph", "ParameterSet", "Scalar", "Curve", "Map", "Cube", "Axis"),
    *("Criterion", "Limit", "Result", "read", "read_parameters", "formula", "simulink", "calibrate", "simulate"),
}
NEEDED_WITH_THEM = {
    *("Block", "Text", "Pin", "Region", "Settling", "Options", "Step", "Stop", "Expansion", "RBF", "cross_validate"),
    *("Parameter", "TraceLine", "CrossValidation", "problem"),
    *("InputError", "InputWarning", "KennfeldError", "ArgumentError", "Finding"),
}
IN_THE_DOCUMENTS = {
    *(
        "Shape",
        "Equality",
        "Term",
        "Target",
        "Problem",
        "Trust",
        "Quality",
        "RecordingQuality",
        "residuals",
        "find_extrapolation",
        "propose",
        "TermProposal",
        "TermProposals",
        "report",
    ),
    *(
        "esdl",
        "import_esdl",
        "import_simulink",
        "inspect_simulink",
        "onnx",
        "train_surrogate",
        "SurrogateSettings",
        "StaticSurrogate",
    ),
    "design",
    "fmu",
    "function",
    *("DynamicSurrogate", "FilteredSurrogate", "read_surrogate", "write_surrogate", "compress_map"),
    *("Export", "export_function"),
}
# what packages with an importer are written against
OF_PLUGINS = (
    "from kennfeld.measurement.delimited import ",
    "from kennfeld.models.importer import ",
    "from kennfeld.models.model_function import ",
)
NAMES = PROMISED | NEEDED_WITH_THEM | IN_THE_DOCUMENTS


def test_the_public_names_are_these():
    assert set(kennfeld.__all__) == NAMES
    assert len(kennfeld.__all__) == len(set(kennfeld.__all__))


@pytest.mark.parametrize("name", marked(sorted(NAMES)))
def test_every_public_name_is_there_and_listed(name):
    assert getattr(kennfeld, name) is getattr(kennfeld, name)
    assert name in dir(kennfeld)


def test_read_is_for_measurements_and_read_parameters_for_calibrations():
    assert kennfeld.read.__module__.startswith("kennfeld.measurement")
    assert kennfeld.read_parameters.__module__.startswith("kennfeld.calfiles")


def test_an_unknown_name_comes_with_the_nearest_one():
    with pytest.raises(AttributeError, match="Did you mean calibrate"):
        kennfeld.calibrat  # noqa: B018


def test_the_name_of_an_importer_that_is_not_there_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.delitem(vars(kennfeld), "onnx", raising=False)
    for module in [module for module in sys.modules if module.startswith("kennfeld.importers.onnx")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr("kennfeld.importers.__path__", [str(tmp_path)])
    message = r"^kennfeld\.onnx needs the importer kennfeld\.importers\.onnx, which is not installed$"
    with pytest.raises(AttributeError, match=message):
        kennfeld.onnx  # noqa: B018


def test_the_version_is_stated_in_one_place():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["project"]["dynamic"] == ["version"]
    assert ROOT / settings["tool"]["hatch"]["version"]["path"] == Path(kennfeld.__file__)


def test_the_changelog_describes_this_version_first():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert versions[0] == kennfeld.__version__
    assert versions == sorted(versions, key=lambda text: [int(part) for part in text.split(".")], reverse=True)


def test_the_citation_states_this_version_and_its_date():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    date = re.search(rf"^## \[{re.escape(kennfeld.__version__)}\] - (\S+)$", changes, re.MULTILINE)[1]
    assert f"\nversion: {kennfeld.__version__}\n" in text
    assert f'\ndate-released: "{date}"\n' in text


def test_the_documents_name_the_wheel_of_this_version():
    text = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    assert set(re.findall(r"kennfeld-(\d[\d.]*)-py3", text)) == {kennfeld.__version__}


def loaded_by(code):
    """The modules that a fresh interpreter holds after running some code."""
    script = f"import sys\n{code}\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_by("import kennfeld").isdisjoint({"numpy", "scipy", "click", "typing", "kennfeld.optimize"})


def test_the_help_text_loads_nothing_heavy():
    heavy = {"numpy", "scipy", "pandas", "pyarrow", "llvmlite", "rich", "threadpoolctl"}
    assert loaded_by("from kennfeld.cli import run\nrun(['--help'])").isdisjoint(heavy)


def test_the_page_is_served_before_anything_heavy_is_loaded():
    heavy = {"numpy", "pyarrow", "llvmlite", "kennfeld.project", "kennfeld.app.questions"}
    assert loaded_by("import kennfeld.app.launch\nimport kennfeld.app.server.server").isdisjoint(heavy)
    assert loaded_by("import kennfeld.app.launch").isdisjoint({"uvicorn", "starlette"})


@pytest.mark.slow  # test_startup.py asks the same of calibrate, without the demo
def test_a_calibration_loads_no_table_library(tmp_path):
    code = f"from kennfeld.cli import run\nrun(['demo', '--dir', {str(tmp_path / 'demo')!r}])"
    assert "pandas" not in loaded_by(code)


def test_a_set_can_be_saved_without_loading_a_format_first(tmp_path):
    path = tmp_path / "new.dcm"
    code = f"import kennfeld as kf\nkf.ParameterSet([kf.Scalar('Kp', 0.08)]).save({str(path)!r})"
    assert "kennfeld.calfiles" in loaded_by(code)
    assert kennfeld.read_parameters(path)["Kp"].value == 0.08


@pytest.mark.parametrize(
    "path", [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "examples").rglob("*.py")]
)
def test_documents_import_nothing_from_inside(path):
    text = path.read_text(encoding="utf-8")
    lines = re.findall(r"^\s*(?:from kennfeld\.\S+ import|import kennfeld\.).*", text, re.MULTILINE)
    assert [line for line in lines if not line.strip().startswith(OF_PLUGINS)] == []
