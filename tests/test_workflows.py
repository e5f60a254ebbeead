"""The workflows test every version of Python that the project names, by the command of the README."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / ".github" / "workflows"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the workflows are not part of an installed package")


@pytest.fixture(scope="module")
def workflows():
    yaml = pytest.importorskip("yaml")
    return {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in FOLDER.glob("*.yml")}


def commands(job):
    return [step["run"] for step in job["steps"] if "run" in step]


def test_all_systems_run_the_second_command_of_the_readme(workflows):
    tests = workflows["tests"]["jobs"]["tests"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    second = re.search(r"^\.venv/bin/pip install -e .* -m pytest$", readme, re.MULTILINE)[0]
    assert second.replace(".venv/bin", "$BIN") in commands(tests)
    assert {name.partition("-")[0] for name in tests["strategy"]["matrix"]["system"]} == {"ubuntu", "windows", "macos"}


def test_every_version_of_python_is_tested(workflows):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    assert workflows["tests"]["jobs"]["tests"]["strategy"]["matrix"]["python"] == named
    assert {named[0], named[-1]} == set(workflows["release"]["jobs"]["check"]["strategy"]["matrix"]["python"])


def test_only_jobs_that_need_it_may_write(workflows):
    assert all(workflow["permissions"] == {"contents": "read"} for workflow in workflows.values())
    more = {
        name: job["permissions"] for w in workflows.values() for name, job in w["jobs"].items() if "permissions" in job
    }
    pages = {"pages": "write", "id-token": "write"}
    assert more == {"publish": {"id-token": "write"}, "attach": {"contents": "write"}, "deploy": pages}


def test_scripts_and_tests_that_workflows_name_exist(workflows):
    text = "\n".join(line for w in workflows.values() for job in w["jobs"].values() for line in commands(job))
    paths = re.findall(r"\b(?:scripts|tests)/[\w/.]+", text)
    assert len(paths) > 4
    assert [path for path in paths if not (ROOT / path).exists()] == []
