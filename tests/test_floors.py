import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_imports_fall_one_way(tmp_path):
    program = shutil.which("lint-imports", path=Path(sys.executable).parent)
    if program is None:
        pytest.skip("import-linter is not installed; it comes with the extra `dev`")
    command = [program, "--no-cache", "--config", str(ROOT / "pyproject.toml")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def layers_of_the_package():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contract = next(c for c in settings["tool"]["importlinter"]["contracts"] if c["containers"] == ["kennfeld"])
    return [layer.split(" | ") for layer in contract["layers"]]


def test_the_map_for_contributors_shows_the_layers_and_every_package():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    drawn = [line.split() for line in text.partition("```text\n")[2].partition("```")[0].splitlines()]
    assert drawn == layers_of_the_package()[1:]  # all but `__main__`
    described = re.findall(
        r"`(\w+)`", "".join(line.split("|")[1] for line in text.splitlines() if line.startswith("| `"))
    )
    assert sorted(described) == sorted(name for layer in drawn for name in layer)


def test_the_architecture_names_files_that_exist():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = re.findall(r"`([\w/]+\.py)`", text)
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / "src" / "kennfeld" / path).exists()] == []
