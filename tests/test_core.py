"""The core works without its importers, as `scripts/core` tests it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guests import imports_guest

ROOT = Path(__file__).parents[1]
FOLDERS = ("models", "project", "terminal", "app")
JOURNEYS = {  # what users do with formula text: every command, and the app without a browser
    "models/test_formula_build.py",
    "models/test_formula_frontend.py",
    "project/test_checks.py",
    "project/test_function.py",
    "project/test_pipeline.py",
    "project/test_results.py",
    "project/test_steps.py",
    "project/test_training.py",
    "terminal/test_cache_command.py",
    "terminal/test_project_commands.py",
    "app/test_results.py",
    "app/test_runs.py",
    "app/test_schema.py",
    "app/test_session.py",
    "app/test_start.py",
    "app/test_state.py",
    "app/test_wire.py",
}


def selected_modules():
    """Yield the test modules of journeys, and those in which some tests need an importer, and others do not.

    Those that need a browser or an importer as a whole are left out.
    """
    for path in sorted(each for folder in FOLDERS for each in (ROOT / "tests" / folder).rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        is_journey = path.relative_to(ROOT / "tests").as_posix() in JOURNEYS
        needs_browser = "tests.app.browser" in text or "tests.app.shared_app" in text
        # a module that is named on the command line is collected in any case
        if (is_journey or "guests" in text) and not needs_browser and not imports_guest(path):
            yield path.relative_to(ROOT).as_posix()


@pytest.mark.slow
def test_projects_commands_and_the_app_work_without_importers():
    if shutil.which("bash") is None or not (ROOT / ".git").exists():
        pytest.skip("scripts/core is a script of bash and copies what git tracks")
    tests = list(selected_modules())
    assert {f"tests/{each}" for each in JOURNEYS} <= set(tests)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), environment.get("PATH", "")])
    command = ["bash", str(ROOT / "scripts" / "core"), "-q", *tests]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
    assert " passed" in done.stdout
