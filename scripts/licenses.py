"""Write the licenses of the packages that Kennfeld needs, and the license texts of those in the web app.

    cd web && npm ci && cd .. && python scripts/licenses.py

Needs an environment with the extras `dev` and `platforms`, and `web/node_modules`.
"""

import re
from collections.abc import Iterable
from pathlib import Path

from distributions import ROOT, WEB, Package, bundled, installed

__all__ = ["page", "texts"]

PAGE = ROOT / "docs" / "licenses.md"
TEXTS = ROOT / "src" / "kennfeld" / "app" / "LICENSES.txt"
_INTRODUCTION = """# Licenses

Kennfeld is free software under the MIT license. The tables list the packages that it uses, with the licenses that they
state themselves. `scripts/licenses.py` writes this page.

## Python packages

pip installs them beside Kennfeld; none is part of it. Every installation has those that are marked "always"; the others
come with an [extra](installation.md#what-is-installed-and-what-for).
"""
_BUNDLE = """
## In the web app

The script of the web app contains these packages. Their license texts are in `kennfeld/app/LICENSES.txt` of the
installed package. The script of a report contains no code of others.
"""


def page(packages: Iterable[Package], in_bundle: Iterable[Package]) -> str:
    """Return the page of the documentation."""
    rows = [(each.name, each.license, ", ".join(each.extras) or "always") for each in packages]
    web = [(each.name, each.version, each.license) for each in in_bundle]
    tables = _table(("package", "license", "installed"), rows), _table(("package", "version", "license"), web)
    return "\n".join([_INTRODUCTION, tables[0], _BUNDLE, tables[1], ""])


def texts(packages: Iterable[Package]) -> str:
    """Return the license texts of npm packages, each text once with the packages that it is for."""
    owners: dict[str, list[str]] = {}
    for package in packages:
        owners.setdefault(_text(WEB / "node_modules" / package.name), []).append(f"{package.name} {package.version}")
    parts = [f"{chr(10).join(names)}\n\n{text}\n" for text, names in owners.items()]
    return f"\n{'-' * 80}\n\n".join(["The script of the web app contains the following packages.\n", *parts])


def _text(folder: Path) -> str:
    files = [path for path in sorted(folder.iterdir()) if re.match(r"licen[sc]e", path.name, re.IGNORECASE)]
    if not files:
        raise SystemExit(f"{folder}: no license text")
    lines = files[0].read_text(encoding="utf-8").strip().splitlines()
    return "\n".join(line.rstrip() for line in lines)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


if __name__ == "__main__":
    in_bundle = bundled()
    PAGE.write_text(page(installed(), in_bundle), encoding="utf-8", newline="\n")
    TEXTS.write_text(texts(in_bundle), encoding="utf-8", newline="\n")
