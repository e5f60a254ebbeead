"""The lists of packages: licenses in the documentation, license texts in the app, and the bill of materials."""

import re
import tomllib
from pathlib import Path

import distributions
import licenses
import pytest
import sbom
from distributions import Package

import kennfeld

ROOT = Path(__file__).parents[1]

needs_sources = pytest.mark.skipif(not licenses.WEB.is_dir(), reason="the sources of the page are not there")


def rows(title):
    """The rows of a table of docs/licenses.md."""
    section = licenses.PAGE.read_text(encoding="utf-8").partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"][
        2:
    ]


@needs_sources
def test_the_texts_in_the_app_are_those_of_the_bundled_packages():
    text = licenses.TEXTS.read_text(encoding="utf-8")
    listed = re.findall(r"^(\S+) (\d[\w.-]*)$", text, re.MULTILINE)
    bundled = [(package.name, package.version) for package in distributions.bundled()]
    assert sorted(listed) == bundled, "run `npm ci` in web/ and `python scripts/licenses.py`"
    assert text.count("Permission is hereby granted") == text.count("-" * 80)


@needs_sources
def test_the_page_lists_the_bundled_packages():
    bundled = [[package.name, package.version, package.license] for package in distributions.bundled()]
    assert rows("In the web app") == bundled, "run python scripts/licenses.py"


def test_the_page_lists_every_package_that_the_project_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = dict.fromkeys(names(project["dependencies"]), "always")
    asked |= {
        name: extra
        for extra in extras
        if extra not in distributions.TOOLS
        for name in names(extras[extra])
        if name not in asked
    }
    listed = {name: installed.split(", ") for name, _, installed in rows("Python packages")}
    assert [name for name, extra in asked.items() if extra not in listed.get(name, ())] == []


def names(requirements):
    return [re.split(r"[>\[]", text)[0] for text in requirements if not text.startswith("kennfeld[")]


@pytest.mark.parametrize("document", ["README.md", "docs/installation.md"])
def test_the_documents_name_every_package_that_has_no_permissive_license(document):
    others = [name for name, terms, _ in rows("Python packages") if "GPL" in terms]
    assert "asammdf" in others
    text = (ROOT / document).read_text(encoding="utf-8")
    assert [name for name in others if name not in text.lower()] == []


def test_a_text_that_several_packages_share_is_written_once(tmp_path, monkeypatch):
    monkeypatch.setattr(licenses, "WEB", tmp_path)
    for name, text in {"a": "Copyright A  \n", "b": "Copyright B", "c": "Copyright A"}.items():
        folder = tmp_path / "node_modules" / name
        folder.mkdir(parents=True)
        (folder / "LICENSE.md").write_text(text)
    text = licenses.texts(Package(name, "1.0", "MIT") for name in "abc")
    assert text.count("Copyright A\n") == 1
    assert "a 1.0\nc 1.0\n\nCopyright A\n" in text


def test_a_package_without_a_license_text_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(licenses, "WEB", tmp_path)
    (tmp_path / "node_modules" / "a").mkdir(parents=True)
    with pytest.raises(SystemExit, match="no license text"):
        licenses.texts([Package("a", "1.0", "MIT")])


def test_the_bill_of_materials_refers_to_listed_components_only():
    a, b = Package("a", "1.0", "MIT", (), ("b",)), Package("b", "2.0", "BSD", ())
    extra, web = Package("c", "3.0", "MIT", ("onnx",)), Package("@d/e", "4.0", "MIT")
    bill = sbom.bill([a, b, extra], [web])
    references = {component["bom-ref"] for component in bill["components"]}
    assert references == {"pkg:pypi/a@1.0", "pkg:pypi/b@2.0", "pkg:pypi/c@3.0", "pkg:npm/%40d/e@4.0"}
    needs = {edge["ref"]: edge["dependsOn"] for edge in bill["dependencies"]}
    assert needs["kennfeld"] == ["pkg:pypi/a@1.0", "pkg:pypi/b@2.0", "pkg:npm/%40d/e@4.0"]
    assert needs["pkg:pypi/a@1.0"] == ["pkg:pypi/b@2.0"]
    assert [part["name"] for part in bill["components"] if part.get("scope") == "optional"] == ["c"]
    assert bill["metadata"]["component"]["version"] == kennfeld.__version__


def test_installed_packages_have_versions_licenses_and_requirements():
    try:
        packages = {package.name: package for package in distributions.installed()}
    except SystemExit as missing:
        pytest.skip(str(missing))
    assert packages["numpy"].extras == ()
    assert packages["asammdf"].extras == ("mdf",)
    assert "numpy" in packages["scipy"].requires
    assert all(package.version and package.license for package in packages.values())
