"""The committed bundles of the app and of the report belong to their sources, and load nothing from elsewhere."""

import gzip
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from kennfeld.app.server.server import STATIC
from kennfeld.report.page import STATIC as REPORT

WEB = Path(__file__).parents[2] / "web"
BUILD = ("package-lock.json", "tsconfig.json", "vite.config.ts")
SOURCES = {
    STATIC: ("src", "public", "index.html", *BUILD),
    REPORT: ("src/drawing", "src/report", "src/tokens.css", *BUILD),
}

needs_sources = pytest.mark.skipif(
    not WEB.is_dir(), reason="the sources of the page are not part of an installed package"
)


def files(names: Iterable[str]) -> list[Path]:
    paths = [path for name in names for path in ((WEB / name).rglob("*") if (WEB / name).is_dir() else [WEB / name])]
    return [path for path in paths if path.is_file()]


@needs_sources
@pytest.mark.parametrize("bundle", SOURCES, ids=["app", "report"])
def test_the_bundle_was_built_from_these_sources(bundle: Path) -> None:
    digest = hashlib.sha256()
    for name in sorted(path.relative_to(WEB).as_posix() for path in files(SOURCES[bundle])):
        digest.update(f"{name}\n".encode())
        digest.update((WEB / name).read_bytes())
        digest.update(b"\n")
    built = (bundle / "sources.sha256").read_text(encoding="utf-8").strip()
    assert digest.hexdigest() == built, "run `npm ci && npm run build` in web/"


@needs_sources
@pytest.mark.parametrize("folder", ["drawing", "report"])
def test_drawing_and_report_do_not_import_the_app(folder: str) -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in files([f"src/{folder}"]) if path.suffix == ".ts"}
    imports = [(path, name) for path, text in texts.items() for name in re.findall(r'(?:from|import) "([^"]+)"', text)]
    assert len(imports) > 5
    allowed = {"drawing": ("drawing",), "report": ("drawing", "report")}[folder]
    for path, name in imports:
        target = (path.parent / name).resolve().relative_to((WEB / "src").resolve())
        assert name.startswith("."), f"{path.name} imports the package {name}"
        assert target.parts[0] in allowed, f"{path.name} imports {name}"


def test_the_page_loads_little_before_it_can_be_used() -> None:
    imported = re.findall(r"""from[`"']\./([\w-]+\.js)[`"']""", (STATIC / "app.js").read_text(encoding="utf-8"))
    assert imported
    first = [STATIC / name for name in ("app.js", "index.css", *imported)]
    assert sum(len(gzip.compress(path.read_bytes())) for path in first) < 110_000


def test_bundles_load_no_external_resources() -> None:
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    assert "http:" not in page
    assert "https:" not in page


def test_the_script_of_a_report_stands_alone() -> None:
    script, style = ((REPORT / name).read_text(encoding="utf-8") for name in ("report.js", "report.css"))
    assert script.startswith("(function(){")
    assert re.search(r"\b(import|export)\b", script) is None
    assert "</script" not in script.lower()
    for text in (script, style):
        assert "http:" not in text
        assert "https:" not in text
        assert "url(" not in text
        assert "@import" not in text


def test_the_lock_file_names_no_host() -> None:
    if WEB.is_dir():
        assert "resolved" not in (WEB / "package-lock.json").read_text(encoding="utf-8")
