"""The files that a Python file loads from its folder: found without running it, part of its digest, and importable."""

import sys
from pathlib import Path

import pytest

from kennfeld.app.session.function_source import FunctionSource
from kennfeld.base.errors import InputError
from kennfeld.graph.external_function import evaluate_points
from kennfeld.importers.python.loaded_files import files_loaded_by, find_loaded_files
from kennfeld.models.code_consent import content_digest
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model

MAIN = """\
import json
import helper
import pkg.other
from pkg import deep
from pathlib import Path

TABLE = float(Path(__file__).with_name("table.csv").read_text())
WEIGHTS = [float(path.read_text()) for path in Path(__file__).parent.glob("*.weight")]


def f(x):
    return {0: helper.twice(x) + pkg.other.THREE + deep.five() + TABLE + sum(WEIGHTS)}[0]
"""
FILES = {
    "helper.py": "def twice(x):\n    return 2 * x\n",
    "pkg/__init__.py": "",
    "pkg/other.py": "THREE = 3\n",
    "pkg/deep.py": "from .other import THREE\nfrom . import inner\n\n\ndef five():\n    return THREE + inner.TWO\n",
    "pkg/inner.py": "TWO = 2\n",
    "table.csv": "100",
    "a.weight": "1000",
    "unused.py": "raise SystemExit\n",
    "unused.csv": "1",
    "json.py": "raise SystemExit\n",
}


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "main.py"


@pytest.fixture
def main(tmp_path: Path) -> Path:
    return write(tmp_path, {"main.py": MAIN, **FILES})


def value(path: Path, x: float) -> float:
    graph = as_model(read_function_file(f"{path.name}:f", path.parent)).graph
    function = next(node.payload.function for node in graph.nodes if node.op == "external")
    return float(evaluate_points(function, [[x]])[0][0, 0])


def test_modules_and_data_are_found(main: Path) -> None:
    names = [path.relative_to(main.parent).as_posix() for path in files_loaded_by(main)]
    loaded = ["a.weight", "helper.py", "pkg/deep.py", "pkg/inner.py", "pkg/other.py", "table.csv"]
    assert [name for name in names if name != "pkg/__init__.py"] == loaded


def test_modules_beside_the_file_are_imported(main: Path) -> None:
    assert value(main, 1.0) == 2 + 3 + 5 + 100 + 1000
    assert "helper" not in sys.modules
    assert "pkg" not in sys.modules


def test_a_changed_module_is_another_function(main: Path) -> None:
    before = value(main, 1.0)
    (main.parent / "pkg/inner.py").write_text("TWO = 22\n")
    assert value(main, 1.0) == before + 20


def test_changed_data_are_another_function(main: Path) -> None:
    before = value(main, 1.0)
    (main.parent / "table.csv").write_text("107")
    assert value(main, 1.0) == before + 7


def test_the_app_reads_a_function_again_if_a_module_beside_it_changes(main: Path) -> None:
    source = FunctionSource(main.parent, "main.py:f")
    first = source.read()
    assert source.read() is first
    (main.parent / "pkg/inner.py").write_text("TWO = 22\n")
    assert source.read() is not first


def test_two_folders_may_have_modules_of_the_same_name(tmp_path: Path) -> None:
    text = "import helper\n\n\ndef f(x):\n    return {0: helper.VALUE * x}[0]\n"
    files = [write(tmp_path / name, {"main.py": text, "helper.py": f"VALUE = {name}\n"}) for name in ("1", "2")]
    assert [value(path, 1.0) for path in files] == [1.0, 2.0]


@pytest.mark.parametrize("name", [name for name in FILES if not name.startswith(("unused", "json", "pkg/__"))])
def test_the_digest_covers_what_is_loaded(main: Path, name: str) -> None:
    before = content_digest(main)
    (main.parent / name).write_text(f"{FILES[name]} ")
    assert content_digest(main) != before


@pytest.mark.parametrize("name", ["unused.py", "unused.csv", "new.csv", "json.py"])
def test_the_digest_leaves_out_what_is_not_loaded(main: Path, name: str) -> None:
    before = content_digest(main)
    (main.parent / name).write_text("something else")
    assert content_digest(main) == before


def test_a_new_module_that_replaces_a_library_changes_the_digest(main: Path) -> None:
    (main.parent / "main.py").write_text("import numpy\n\n\ndef f(x):\n    return {0: numpy.abs(x)}[0]\n")
    before = content_digest(main)
    (main.parent / "numpy.py").write_text("def abs(x):\n    return 7.0\n")
    assert content_digest(main) != before
    assert value(main, 1.0) == 7.0


def test_a_module_that_changes_while_the_project_is_open_does_not_run(main: Path) -> None:
    graph = as_model(read_function_file("main.py:f", main.parent)).graph
    function = next(node.payload.function for node in graph.nodes if node.op == "external")
    (main.parent / "helper.py").write_text("raise SystemExit\n")
    with pytest.raises(InputError, match="a module that it loads, has changed since the project was read"):
        evaluate_points(function, [[1.0]])


def test_code_may_write_files_that_it_names(main: Path) -> None:
    text = 'import os\nfrom pathlib import Path\nPath(__file__).with_name("log.txt").write_text("x")\n'
    main.write_text(f"{text}\n\ndef f(x):\n    return {{0: 2 * x}}[0]\n", encoding="utf-8")
    assert [value(main, 1.0), value(main, 2.0)] == [2.0, 4.0]


@pytest.mark.parametrize(
    "text",
    ["import main\n", "import helper.gone\n", "from ... import x\n", "x = 'a\\0b'\n", "x = '*[*'\n", "x = '/'\n"],
)
def test_odd_imports_and_texts_are_accepted(main: Path, text: str) -> None:
    main.write_text(f"{text}\n\ndef f(x):\n    return x\n", encoding="utf-8")
    assert main not in find_loaded_files(main).others


def test_data_outside_of_the_folder_are_not_read(main: Path) -> None:
    (main.parent.parent / "outside.csv").write_text("1")
    main.write_text('X = "../outside.csv"\nY = "/etc/passwd"\n', encoding="utf-8")
    assert files_loaded_by(main) == ()
