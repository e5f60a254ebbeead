"""The command that prints the schemas of project files."""

import json

import pytest

from kennfeld import cli
from kennfeld.project.schemas import PROJECT_SCHEMA, TRAINING_SCHEMA, schema_text


@pytest.mark.parametrize(("options", "name"), [([], PROJECT_SCHEMA), (["--training"], TRAINING_SCHEMA)])
def test_schema_prints_the_schema(options, name, capsys):
    assert cli.run(["schema", *options]) == 0
    printed = capsys.readouterr().out
    assert json.loads(printed) == json.loads(schema_text(name))


def test_schema_writes_a_file_and_replaces_it_only_with_force(tmp_path, capsys):
    path = tmp_path / PROJECT_SCHEMA
    assert cli.run(["schema", "-o", str(path)]) == 0
    assert path.read_text(encoding="utf-8") == schema_text(PROJECT_SCHEMA)
    path.write_text("old", encoding="utf-8")
    assert cli.run(["schema", "-o", str(path)]) == 2
    assert "already exists. Add --force" in capsys.readouterr().err
    assert path.read_text(encoding="utf-8") == "old"
    assert cli.run(["schema", "-o", str(path), "--force"]) == 0
    assert path.read_text(encoding="utf-8") == schema_text(PROJECT_SCHEMA)
