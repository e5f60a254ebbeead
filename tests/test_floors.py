import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.guests
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


def test_the_map_for_contributors_describes_every_package_from_top_to_bottom():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
    layers = layers_of_the_package()[1:]  # all but `__main__`
    assert len(rows) == sum(map(len, layers))
    for layer in layers:
        assert sorted(rows[: len(layer)]) == sorted(layer)
        del rows[: len(layer)]


@pytest.mark.guests
def test_the_architecture_names_files_that_exist():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    paths = re.findall(r"`([\w/]+\.py)`", text)
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / "src" / "kennfeld" / path).exists()] == []
