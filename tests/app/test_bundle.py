"""The committed bundle of the page belongs to its sources."""

import hashlib
from pathlib import Path

import pytest

from kennfeld.app.server.server import STATIC

WEB = Path(__file__).parents[2] / "web"
SOURCES = ("src", "public", "index.html", "package-lock.json", "tsconfig.json", "vite.config.ts")


def test_the_bundle_was_built_from_these_sources() -> None:
    if not WEB.is_dir():
        pytest.skip("the sources of the page are not part of an installed package")
    paths = [path for name in SOURCES for path in ((WEB / name).rglob("*") if (WEB / name).is_dir() else [WEB / name])]
    names = sorted(path.relative_to(WEB).as_posix() for path in paths if path.is_file())
    digest = hashlib.sha256()
    for name in names:
        digest.update(f"{name}\n".encode())
        digest.update((WEB / name).read_bytes())
        digest.update(b"\n")
    built = (STATIC / "sources.sha256").read_text(encoding="utf-8").strip()
    assert digest.hexdigest() == built, "run `npm ci && npm run build` in web/"


def test_the_page_loads_little_before_it_can_be_used() -> None:
    first = [STATIC / name for name in ("index.html", "app.js", "index.css")]
    assert sum(path.stat().st_size for path in first) < 300_000


def test_nothing_is_loaded_from_elsewhere() -> None:
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    assert "http:" not in page
    assert "https:" not in page


def test_the_lock_file_names_no_host() -> None:
    if WEB.is_dir():
        assert "resolved" not in (WEB / "package-lock.json").read_text(encoding="utf-8")
