"""Every public name is described: arguments, an example that runs, and a place in `docs/api*.md`."""

import importlib
import importlib.util
import inspect
import re
from pathlib import Path

import pytest

import kennfeld
from tests.guests import marked

ROOT = Path(__file__).parents[1]
PAGES = "".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").glob("api*.md")))
NAMES = sorted(kennfeld.__all__)


def public(name):
    """Return what the name stands for; a package that can be called stands for its function."""
    return inspect.unwrap(getattr(kennfeld, name, None))


FUNCTIONS = [name for name in NAMES if inspect.isfunction(public(name))]


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    spec = importlib.util.spec_from_file_location("api_docs", ROOT / "scripts" / "api_docs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def docstring(name):
    return inspect.getdoc(public(name)) or ""


def described(text):
    """Return the entries of the sections Args and Attributes of a docstring."""
    sections = re.findall(r"^(?:Args|Attributes):\n((?:[ ]{4}.*\n?)+)", text, re.MULTILINE)
    return {entry for section in sections for entry in re.findall(r"^ {4}(\w+): ", section, re.MULTILINE)}


@pytest.mark.guests
def test_the_pages_are_up_to_date(script):
    importlib.import_module("kennfeld.design")  # any import of it binds the package to the name of its function
    stale = [path.name for path, text in script.documents(ROOT / "docs").items() if path.read_text("utf-8") != text]
    assert stale == [], "run: python scripts/api_docs.py docs"


def test_every_public_name_has_a_place_of_its_own():
    placed = [name for names in re.findall(r"<!-- reference of ([^>]*) -->", PAGES) for name in names.split()]
    assert sorted(placed) == NAMES
    assert "## More names" not in PAGES


@pytest.mark.parametrize("name", marked(NAMES))
def test_every_public_name_has_an_example_that_runs(name):
    examples = [line for line in docstring(name).splitlines() if line.startswith(">>> ")]
    assert examples
    assert not [line for line in examples if "+SKIP" in line]


@pytest.mark.parametrize("name", marked(FUNCTIONS))
def test_every_argument_of_a_public_function_is_described(name):
    if re.search(r"The arguments are those of `\w+`\.", docstring(name)):
        return
    assert set(inspect.signature(public(name)).parameters) == described(docstring(name))


@pytest.mark.parametrize("name", marked(FUNCTIONS))
def test_every_public_function_states_what_it_returns(name):
    returned = inspect.signature(public(name)).return_annotation
    assert returned is None or "Returns:\n" in docstring(name)


@pytest.mark.parametrize("name", marked(sorted(set(NAMES) - set(FUNCTIONS))))
def test_every_field_of_a_public_class_is_described(name):
    value = public(name)
    fields = {field for field in getattr(value, "__dataclass_fields__", {}) if not field.startswith("_")}
    if hasattr(value, "with_bounds") and value is not kennfeld.Parameter:
        fields -= set(kennfeld.Scalar.__dataclass_fields__)
    assert fields - described(docstring(name)) == set()


@pytest.mark.guests
@pytest.mark.slow
def test_a_name_that_the_page_does_not_mention_is_added(script, tmp_path):
    (tmp_path / "api.md").write_text("# Python reference\n", encoding="utf-8")
    [text] = script.documents(tmp_path).values()
    assert "### calibrate\n\n```py\ncalibrate(\n    model: Model | str | Problem,\n" in text
    assert "| `lower` | `float` | lower limit, in the unit of the node; None stands for no limit. |" in text
    assert "\nRaises `InputError`: the input cannot be used; lists all problems.\n" in text
    assert "#### Axis.of_quantiles\n" in text
    assert "# doctest:" not in text
