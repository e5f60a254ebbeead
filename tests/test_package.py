"""Wheel and sdist: what they contain, and that the sdist builds the wheel."""

import email
import importlib.util
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import kennfeld

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "kennfeld"
INFO = f"kennfeld-{kennfeld.__version__}.dist-info"
MISSING = [name for name in ("build", "hatchling") if importlib.util.find_spec(name) is None]

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}"),
    pytest.mark.skipif(not PACKAGE.is_dir(), reason="the sources are not part of an installed package"),
]


def run_module(*arguments, tree=ROOT):
    """Run a module of Python in a tree."""
    done = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, check=False, cwd=tree)
    assert done.returncode == 0, done.stdout + done.stderr


def build_wheel(folder, tree=ROOT):
    """Build the wheel from a tree and return its files."""
    run_module("hatchling", "build", "--target", "wheel", "--directory", str(folder), tree=tree)
    return contents(folder)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the sdist, and the wheel that was built from it, without a network."""
    folder = tmp_path_factory.mktemp("dist")
    run_module("build", "--no-isolation", "--outdir", str(folder))
    return folder


def contents(folder):
    """The files of the wheel in a folder."""
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_the_wheel_contains_the_package_and_nothing_else(wheel):
    sources = [path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    expected = {path.relative_to(PACKAGE.parent).as_posix() for path in sources}
    assert {name for name in wheel if not name.startswith(f"{INFO}/")} == expected


@pytest.mark.parametrize(
    "name",
    [
        *(
            "py.typed",
            "project/schemas/kennfeld.schema.json",
            "app/static/index.html",
            "app/static/app.js",
            "app/LICENSES.txt",
            "report/static/report.js",
        ),
        *("project/demo/torque.toml",),
    ],
)
def test_the_wheel_contains_files_that_are_not_code(wheel, name):
    assert wheel[f"kennfeld/{name}"] == (PACKAGE / name).read_bytes()


def test_the_wheel_states_version_license_and_command(wheel):
    metadata = email.message_from_bytes(wheel[f"{INFO}/METADATA"])
    assert metadata["Version"] == kennfeld.__version__
    assert metadata["License-Expression"] == "MIT"
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata.get_all("License-File") == ["LICENSE", "src/kennfeld/app/LICENSES.txt"]
    assert all(f"{INFO}/licenses/{name}" in wheel for name in metadata.get_all("License-File"))
    assert "kennfeld = kennfeld.cli:main" in wheel[f"{INFO}/entry_points.txt"].decode()


@pytest.mark.slow
def test_the_sdist_builds_the_wheel_of_the_tree(wheel, built):
    from_sdist = contents(built)
    assert [name for name in wheel | from_sdist if wheel.get(name) != from_sdist.get(name)] == []


@pytest.mark.slow
def test_the_files_that_docker_copies_build_the_same_wheel(wheel, tmp_path):
    first, *others = [
        line for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if line[:1] in ("*", "!")
    ]
    assert (first, others[-1]) == ("*", "**/__pycache__")
    tree = tmp_path / "tree"
    tree.mkdir()
    for name in (line.removeprefix("!") for line in others[:-1]):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, tree / name)
    assert build_wheel(tmp_path, tree) == wheel


def check_sources(names):
    assert {"LICENSE", "CHANGELOG.md", "tests/test_package.py", "web/src/main.tsx", "scripts/licenses.py"} <= names
    folders = {folder for name in names for folder in name.split("/")[:-1]}
    assert [name for name in folders if name.endswith(("cache", "cache__")) or name == "node_modules"] == []


def test_the_sdist_lists_the_sources_and_no_caches():
    from hatchling.builders.sdist import SdistBuilder

    files = SdistBuilder(str(ROOT)).recurse_included_files()
    check_sources({Path(file.distribution_path).as_posix() for file in files})


@pytest.mark.slow
def test_the_sdist_contains_the_sources_and_no_caches(built):
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        check_sources({name.partition("/")[2] for name in archive.getnames()})
