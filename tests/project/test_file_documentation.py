"""The generated documentation of project files: up to date, and its JSON schemas accept and refuse the right files."""

import importlib.util
import json
import tomllib
from math import isfinite
from pathlib import Path

import pytest

from kennfeld.project import demo

ROOT = Path(__file__).parents[2]
FILES = sorted(path for folder in (ROOT / "examples", Path(demo.__file__).parent) for path in folder.rglob("*.toml"))
SOUND = "[model]\nfile = 'a.kf'\n[[dataset]]\nfiles = 'b.csv'\n[[criterion]]\nnode = 'y'\ntarget = 1\n"


def generated():
    script = ROOT / "scripts" / "project_file_docs.py"
    spec = importlib.util.spec_from_file_location("project_file_docs", script)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.documents(ROOT / "docs")


def test_tables_and_schemas_are_up_to_date():
    stale = [path.name for path, text in generated().items() if path.read_text(encoding="utf-8") != text]
    assert stale == [], "run: python scripts/project_file_docs.py docs"


def test_every_section_has_its_table():
    text = "".join(text for path, text in generated().items() if path.suffix == ".md")
    for key in ("max_gap", "min_distance", "grid_reduction", "extrapolation", "save_every", "terms", "output_lags"):
        assert f"| `{key}` |" in text
    assert text.count("<!-- keys of") == 17


@pytest.fixture(scope="module")
def validators():
    jsonschema = pytest.importorskip("jsonschema")
    schemas = [json.loads((ROOT / "docs" / f"{name}.schema.json").read_text()) for name in ("kennfeld", "surrogate")]
    for schema in schemas:
        jsonschema.Draft7Validator.check_schema(schema)
    return [jsonschema.Draft7Validator(schema) for schema in schemas]


def problems(validators, text):
    tables = tomllib.loads(text)
    return [error.message for error in validators["surrogate" in tables].iter_errors(tables)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_the_schema_accepts_valid_sections(validators, path):
    text = path.read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    is_training = "surrogate" in tables and "model" not in tables
    assert [error.message for error in validators[is_training].iter_errors(tables)] == []


def with_nulls(value):
    """Return values as editors pass them to a schema: JSON has no infinite numbers."""
    if isinstance(value, dict):
        return {key: with_nulls(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_nulls(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


INFINITE = """
[parameters.M]
x = { input = "x", range = [0, 1], count = 3 }
bounds = [0, inf]
gradient = { x = [-inf, 0] }
pin = [{ at = [inf, 0.5], value = 1 }]
lock = [{ x = [1, inf] }]
"""


@pytest.mark.parametrize("text", [*(path.read_text(encoding="utf-8") for path in FILES), SOUND + INFINITE])
def test_the_schema_accepts_infinite_numbers_as_editors_pass_them(validators, text):
    tables = with_nulls(tomllib.loads(text))
    is_training = "surrogate" in tables and "model" not in tables
    assert [error.message for error in validators[is_training].iter_errors(tables)] == []


def test_the_schema_accepts_the_example_of_the_documentation(validators):
    page = (ROOT / "docs" / "project-file.md").read_text(encoding="utf-8")
    assert problems(validators, page.partition("```toml\n")[2].partition("```")[0]) == []


@pytest.mark.parametrize(
    "section",
    [
        "[modell]\nx = 1",
        "[optimizer]\nmax_iteration = 5",
        "[optimizer]\nmax_iterations = '5'",
        "[optimizer]\nmax_iterations = true",
        "[optimizer]\ntolerance = 0",
        "[optimizer]\nstarts = 1000000000",
        "[optimizer]\ncontinuation = 'of'",
        "[[dataset]]\nname = 'a'",
        "[[dataset]]\nfiles = [1]",
        "[[dataset]]\nfiles = 'a'\nweight = -1",
        "[[dataset]]\nfiles = 'a'\nshift = {a = 'b'}",
        "[[dataset]]\nfiles = 'a'\nsteady = []",
        "[[criterion]]\nnode = 'a'",
        "[[criterion]]\nnode = 'a'\ntarget = []",
        "[[criterion]]\nnode = 'a'\ntarget = {chanel = 'b'}",
        "[[criterion]]\nnode = 'a'\ntarget = 1\nregions = [{ where = 'x' }]",
        "[[limit]]\nmax = 1",
        "[[equality]]\nterms = []",
        "[parameters]\nGain = 3",
        "[parameters.Gain]\nfree = 'yes'",
        "[parameters.Gain]\nbounds = 3",
        "[parameters.Gain]\nsmoothness = {q = 1}",
        "[parameters.Gain]\nlock = 'nodata'",
        "[parameters.Gain]\npin = [{at = [1]}]",
        "[parameters.Gain]\nx = [1, 2]",
        "[parameters.Gain]\nx = {count = 1}",
        "[axes.A]\naxis = 'B'",
        "[units]\nn = 1",
        "[[step]]\ngrid_reduction = 0",
    ],
)
def test_the_schema_refuses_invalid_sections(validators, section):
    assert problems(validators, SOUND) == []
    assert problems(validators, f"{SOUND}{section}\n") != []


@pytest.mark.parametrize(
    "keys", ["inputs = ['n']", "inputs = []\noutput = 'y'\ncentres = 0", "input = 1\noutput = 'y'"]
)
def test_the_schema_refuses_invalid_training_files(validators, keys):
    assert problems(validators, f"[surrogate]\n{keys}\n[[dataset]]\nfiles = 'a'\n") != []
