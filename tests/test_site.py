"""The site that `scripts/docs` builds: no warning, nothing from elsewhere, light pages, search, coloured formulas.

The whole site is slow to build. Without the mark `slow`, a small one has its settings and a short page in each section.
"""

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import pytest

if not all(map(find_spec, ("sphinx", "furo", "myst_parser"))):
    pytest.skip("sphinx, furo or myst_parser is not installed", allow_module_level=True)

ROOT = Path(__file__).parents[1]
HEAVIEST = 500_000  # bytes of a page with its styles, scripts and pictures
FORMULAS = [*sorted((ROOT / "examples").rglob("*.kf")), *sorted((ROOT / "docs").rglob("*.md"))]


CODE = {"formula": "kf", "python": "python", "project-file": "toml", "get-started": "sh"}  # languages of pages


def write_small_site(root):
    """Write the settings of the site, a page for each language and one more in each section; return their folder."""
    for name in ("docs/conf.py", "docs/navigation.yml", "scripts/formula_lexer.py", "src/kennfeld/app/static/icon.svg"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, root / name)
    docs = Path(shutil.copytree(ROOT / "docs" / "static", root / "docs" / "static")).parent
    pages = dict.fromkeys(("index", "tutorials/torque", "examples/ve-table", "how-to/ci", "architecture"), "")
    for name, language in CODE.items():
        text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        pages[name] = re.search(rf"^```{language}\n.*?^```", text, re.MULTILINE | re.DOTALL)[0]
    for name, code in pages.items():
        (docs / name).parent.mkdir(exist_ok=True)
        (docs / f"{name}.md").write_text(f"# A page\n\nMaps are smooth.\n\n{code}\n", encoding="utf-8")
    return docs


@pytest.fixture(scope="module", params=["small", pytest.param("whole", marks=pytest.mark.slow)])
def documents(request, tmp_path_factory):
    """The folder of the documents that the site is built from."""
    return ROOT / "docs" if request.param == "whole" else write_small_site(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def site(documents, tmp_path_factory):
    """The folder of the built site; with warnings as errors, as in `scripts/docs`."""
    folder = tmp_path_factory.mktemp("site")
    options = ["--quiet", "--fail-on-warning", "--keep-going", "--doctree-dir", str(folder / ".doctrees")]
    command = [sys.executable, "-m", "sphinx", *options, str(documents), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    return folder / "html"


def assets(page):
    """Return the addresses of what a browser loads with a page."""
    text = re.sub(r"<pre>.*?</pre>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    tags = re.findall(r"<(?:script|img|source|iframe|link)\b[^>]*>", text)
    loading = [tag for tag in tags if not re.search(r'rel="(?:index|search|next|prev|author|canonical)"', tag)]
    return [address for tag in loading for address in re.findall(r'\b(?:src|href)="([^"]+)"', tag)]


def pages(site):
    return sorted(site.rglob("*.html"))


def test_every_document_becomes_a_page_of_the_sidebar(documents, site):
    names = {path.relative_to(documents).with_suffix(".html").as_posix() for path in documents.rglob("*.md")}
    assert names <= {path.relative_to(site).as_posix() for path in pages(site)}
    sidebar = (site / "index.html").read_text(encoding="utf-8").partition('class="sidebar-tree"')[2]
    assert names - {name for name in names if f'href="{name}"' in sidebar} == {"index.html"}
    assert [
        name for name in ("Start", "Tutorials", "Examples", "How-to", "Reference", "Explanation") if name not in sidebar
    ] == []


def test_pages_load_nothing_from_elsewhere(site):
    assert {page.name: foreign for page in pages(site) if (foreign := [a for a in assets(page) if "//" in a])} == {}
    sheets = [sheet.read_text(encoding="utf-8") for sheet in site.rglob("*.css")]
    assert [
        address for sheet in sheets for address in re.findall(r"""(?:@import|url\()\s*["']?(https?:[^"')]+)""", sheet)
    ] == []


def test_pages_are_light(site):
    weights = {}
    for page in pages(site):
        files = {page, *((page.parent / unquote(address).partition("?")[0]).resolve() for address in assets(page))}
        weights[page.relative_to(site).as_posix()] = sum(file.stat().st_size for file in files)
    assert {name: weight for name, weight in weights.items() if weight > HEAVIEST} == {}


def test_search_needs_no_server(site):
    assert "searchindex.js" in (site / "search.html").read_text(encoding="utf-8")
    assert "smooth" in (site / "searchindex.js").read_text(encoding="utf-8")


def test_code_is_coloured(site):
    for name, language in CODE.items():
        text = (site / f"{name}.html").read_text(encoding="utf-8")
        assert re.search(
            rf'class="highlight-{language} notranslate"><div class="highlight"><pre>.*?<span class="\w+">',
            text,
            re.DOTALL,
        )


def formulas(path):
    text = path.read_text(encoding="utf-8")
    return [text] if path.suffix == ".kf" else re.findall(r"^```kf\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("path", FORMULAS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_lexer_knows_all_of_the_formula_language(path):
    for text in formulas(path):
        from formula_lexer import FormulaLexer

        tokens = list(FormulaLexer().get_tokens(text))
        assert [part for kind, part in tokens if "Error" in str(kind)] == []
        assert "".join(part for _, part in tokens).strip() == text.strip()
