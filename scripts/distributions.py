"""The packages that Kennfeld needs, as they are installed here, and those that the bundle of the web app contains.

`licenses.py` and `sbom.py` list them.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

__all__ = ["TOOLS", "Package", "bundled", "installed"]

ROOT = Path(__file__).parents[1]
WEB = ROOT / "web"
TOOLS = "dev", "docs"  # extras for work on Kennfeld itself
_SPDX = {
    "Apache 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "3-Clause BSD License": "BSD-3-Clause",
    "BSD License": "BSD",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "LGPLv3+": "LGPL-3.0-or-later",
    "MIT License": "MIT",
    "Python Software Foundation License": "PSF-2.0",
}
_LONGEST = 40  # characters of a license's name; longer ones are its text


@dataclass(frozen=True)
class Package:
    """A package with its license, an SPDX expression where the package states one.

    `extras` are those of Kennfeld that install it, empty if it is always installed; `requires` are names.
    """

    name: str
    version: str
    license: str
    extras: tuple[str, ...] = ()
    requires: tuple[str, ...] = ()


def installed() -> list[Package]:
    """Return what Kennfeld and its extras except `TOOLS` need, sorted by name. Raises if one is not installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    always = _closure(project["dependencies"])
    extras: dict[str, list[str]] = {}
    for extra, requirements in project["optional-dependencies"].items():
        own = [text for text in requirements if not text.startswith(f"{project['name']}[")]
        for name in _closure(own) if extra not in TOOLS else ():
            extras.setdefault(name, []).append(extra)
    names = sorted({*always, *extras})
    return [_package(name, () if name in always else tuple(extras[name])) for name in names]


def bundled() -> list[Package]:
    """Return the npm packages in the bundle of the web app, by its lock file."""
    lock = json.loads((WEB / "package-lock.json").read_text(encoding="utf-8"))
    entries: Mapping[str, Any] = lock["packages"]
    return [
        Package(path.removeprefix("node_modules/"), entry["version"], entry["license"])
        for path, entry in sorted(entries.items())
        if path and not entry.get("dev")
    ]


def _closure(requirements: Iterable[str]) -> set[str]:
    """Return the names of all packages that requirements lead to on this machine."""
    names: set[str] = set()
    pending = [Requirement(text) for text in requirements]
    visited: set[tuple[str, frozenset[str]]] = set()
    while pending:
        requirement = pending.pop()
        key = (_normal(requirement.name), frozenset(requirement.extras))
        if key not in visited:
            visited.add(key)
            names.add(key[0])
            pending += _requirements(_distribution(key[0]), key[1])
    return names


def _requirements(package: Distribution, extras: Iterable[str] = ()) -> Iterator[Requirement]:
    for text in package.requires or ():
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            yield requirement


def _package(name: str, extras: tuple[str, ...]) -> Package:
    package = _distribution(name)
    requires = sorted({_normal(requirement.name) for requirement in _requirements(package)})
    return Package(name, package.version, _license(package), extras, tuple(requires))


def _distribution(name: str) -> Distribution:
    try:
        return distribution(name)
    except PackageNotFoundError:
        raise SystemExit(f'{name} is not installed. Run: pip install -e ".[dev,platforms]"') from None


def _license(package: Distribution) -> str:
    """Return the license as the metadata states it: an expression, a short name, or a classifier."""
    metadata = package.metadata
    if expression := metadata.get("License-Expression"):
        return str(expression)
    text = str(metadata.get("License") or "")
    classifiers = [
        str(line).rpartition(" :: ")[2] for line in metadata.get_all("Classifier") or () if "License" in line
    ]
    stated = text if 0 < len(text) <= _LONGEST and "\n" not in text else next(iter(classifiers), "")
    if not stated:
        raise SystemExit(f"{package.name} {package.version} states no license")
    return _SPDX.get(stated, stated)


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
