"""New project files name their schema, which is beside them; demos from before stay valid."""

import re

import pytest

from kennfeld import InputError
from kennfeld.app.workspace import AppWorkspace
from kennfeld.project.demo import NAMES, write
from kennfeld.project.schemas import DIRECTIVE, PROJECT_SCHEMA, TRAINING_SCHEMA, directive, schema_text
from tests.draws import mostly_slow


def without_schema(path):
    """Make a project file one that an earlier version wrote."""
    text = path.read_text(encoding="utf-8").partition("\n")[2]
    assert not text.startswith(DIRECTIVE)
    path.write_text(text, encoding="utf-8")
    path.with_name(PROJECT_SCHEMA).unlink()
    return text


@pytest.mark.parametrize("name", mostly_slow(NAMES, ["exhaust", "torque"]))
def test_every_file_of_a_demo_names_a_schema_in_its_folder(name, tmp_path):
    write(name, tmp_path)
    files = list(tmp_path.glob("*.toml"))
    assert files
    for path in files:
        schema = re.match(r"#:schema \./(\S+)\n", path.read_text(encoding="utf-8"))[1]
        assert schema == (TRAINING_SCHEMA if path.name == "engine.toml" else PROJECT_SCHEMA)
        assert (tmp_path / schema).read_text(encoding="utf-8") == schema_text(schema)


def test_a_new_project_of_the_app_names_its_schema(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    workspace = AppWorkspace()
    workspace.answer("new", {"name": "air"})
    first = (tmp_path / "air" / "kennfeld.toml").read_text(encoding="utf-8").partition("\n")[0]
    assert first == directive(PROJECT_SCHEMA)
    assert (tmp_path / "air" / PROJECT_SCHEMA).read_text(encoding="utf-8") == schema_text(PROJECT_SCHEMA)
    assert PROJECT_SCHEMA not in str(workspace.answer("names", {}).head)
    workspace.close()


def test_a_demo_of_an_earlier_version_is_kept(tmp_path):
    path = write("torque", tmp_path)
    text = without_schema(path)
    write("torque", tmp_path)
    assert path.read_text(encoding="utf-8") == text
    assert path.with_name(PROJECT_SCHEMA).exists()


@pytest.mark.parametrize("earlier", [False, True])
def test_a_demo_does_not_overwrite_another_one(earlier, tmp_path):
    path = write("torque", tmp_path)
    if earlier:
        without_schema(path)
    with pytest.raises(InputError, match="does not contain this demo"):
        write("exhaust", tmp_path)
