"""The core works without its importers, as `scripts/core` tests it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guests import imports_guest

ROOT = Path(__file__).parents[1]
FOLDERS = ("models", "project", "terminal")


def modules_without_browser():
    """Yield the test modules of the app that need neither a browser nor an importer."""
    for path in sorted((ROOT / "tests" / "app").glob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        # a module that is named on the command line is collected in any case
        if "tests.app.browser" not in text and "tests.app.shared_app" not in text and not imports_guest(path):
            yield path


@pytest.mark.slow
def test_projects_commands_and_the_app_work_without_importers():
    if shutil.which("bash") is None or not (ROOT / ".git").exists():
        pytest.skip("scripts/core is a script of bash and copies what git tracks")
    tests = [
        *(f"tests/{folder}" for folder in FOLDERS),
        *(f"tests/app/{each.name}" for each in modules_without_browser()),
    ]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment.get("PATH", "")])
    command = ["bash", str(ROOT / "scripts" / "core"), "-q", *tests]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
    assert " passed" in done.stdout
