"""The documents hang together: links and their anchors, the navigation, pictures, addresses, spelling."""

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *PAGES, *sorted((ROOT / "examples").rglob("*.md"))]
IMAGES = sorted(path for path in (DOCS / "images").rglob("*") if path.is_file())
LARGEST = 300_000  # bytes of a picture
SPELLED = ("docs", "src", "scripts", "examples", "benchmarks", ".github")  # as in `scripts/check`; tests misspell

by_name = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())


def prose(path):
    """Return a document without its blocks of code and its inline code."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]+`", "", text)


def links(path):
    """Yield the targets of the links and pictures of a document."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    yield from re.findall(r"\]\(([^)\s]+)\)", text)
    yield from re.findall(r"""<(?:img|a|source)\b[^>]*?(?:src|href|srcset)=["']([^"']+)""", text)


def anchors(path):
    """Return the anchors of a document: its headings as GitHub and the site spell them, and those of HTML."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    names, seen = set(re.findall(r"""<a\b[^>]*?(?:id|name)=["']([^"']+)""", text)), {}
    for heading in re.findall(r"^#{1,6}\s+(.*?)\s*#*$", text, re.MULTILINE):
        heading = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        count = seen.get(name, 0)
        seen[name] = count + 1
        names.add(f"{name}-{count}" if count else name)
    return names


@by_name
def test_links_lead_to_files_and_headings_that_exist(document):
    dead = []
    for target in links(document):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = unquote(target).partition("#")
        file = document.parent / name if name else document
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            dead.append(target)
    assert dead == []


@by_name
def test_addresses_outside_are_encrypted(document):
    assert [target for target in links(document) if target.startswith("http:")] == []


@by_name
def test_no_page_links_the_same_address_outside_twice(document):
    outside = [target for target in links(document) if target.startswith("https:")]
    assert sorted(outside) == sorted(set(outside))


def listed():
    return re.findall(r"[\w/-]+\.md", (DOCS / "navigation.yml").read_text(encoding="utf-8"))


def test_every_page_is_in_the_navigation_once():
    pages = {path.relative_to(DOCS).as_posix() for path in PAGES} - {"index.md"}
    assert sorted(pages - set(listed())) == []
    assert len(listed()) == len(set(listed()))


def test_the_navigation_names_pages_that_exist():
    missing = [name for name in listed() if not (DOCS / name).exists()]
    assert [name for name in missing if not name.startswith("tutorials/")] == []


def test_the_first_page_links_every_page():
    linked = {target.partition("#")[0] for target in links(DOCS / "index.md")}
    assert sorted({name for name in listed() if (DOCS / name).exists()} - linked) == []


@pytest.fixture(scope="module")
def shown():
    """The files that documents link or show."""
    return {(page.parent / target.partition("#")[0]).resolve() for page in DOCUMENTS for target in links(page)}


@pytest.mark.parametrize("image", IMAGES, ids=lambda path: path.name)
def test_every_picture_is_small_and_shown(image, shown):
    assert image.stat().st_size <= LARGEST
    assert image.resolve() in shown


@pytest.mark.guests
def test_the_architecture_names_files_that_exist():
    names = re.findall(r"`([\w./]+(?:\.py|/|\.tsx?))`", (DOCS / "architecture.md").read_text(encoding="utf-8"))
    folders = (ROOT / "src" / "kennfeld", ROOT)
    assert len(names) > 60
    assert [name for name in names if not any((folder / name).exists() for folder in folders)] == []


@by_name
def test_every_picture_has_a_text_for_those_who_cannot_see_it(document):
    assert re.findall(r"!\[\s*\]\([^)]*\)", prose(document)) == []


@pytest.mark.slow
def test_words_are_spelled_right():
    pytest.importorskip("codespell_lib")
    command = [sys.executable, "-m", "codespell_lib", *map(str, ROOT.glob("*.md")), *SPELLED]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)  # pyproject.toml lists words to ignore
    assert done.stdout.splitlines() == []
    assert done.returncode == 0
