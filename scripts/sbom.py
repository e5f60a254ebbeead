"""Print a software bill of materials in the format of CycloneDX 1.6: what Kennfeld needs, as it is installed here.

    python scripts/sbom.py > kennfeld-sbom.cdx.json

Needs an environment with the extras `dev` and `platforms`; the packages that only `dev` asks for are not listed.
"""

import json
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote
from uuid import uuid4

from distributions import Package, bundled, installed

from kennfeld import __version__

__all__ = ["bill"]

_OWN = {
    "type": "application",
    "bom-ref": "kennfeld",
    "name": "kennfeld",
    "version": __version__,
    "purl": f"pkg:pypi/kennfeld@{__version__}",
    "licenses": [{"expression": "MIT"}],
}


def bill(packages: Iterable[Package], in_bundle: Iterable[Package]) -> dict[str, Any]:
    """Return the bill: Python packages with their requirements, and npm packages in the bundle of the web app."""
    python = {package.name: package for package in packages}
    web = list(in_bundle)
    components = [_component(each, "pypi") for each in python.values()] + [_component(each, "npm") for each in web]
    needed = [_url(each, "pypi") for each in python.values() if not each.extras] + [_url(each, "npm") for each in web]
    edges = [
        {"ref": _url(each, "pypi"), "dependsOn": [_url(python[name], "pypi") for name in each.requires]}
        for each in python.values()
    ]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid4()}",
        "version": 1,
        "metadata": {"timestamp": datetime.now(UTC).isoformat(timespec="seconds"), "component": _OWN},
        "components": components,
        "dependencies": [{"ref": "kennfeld", "dependsOn": needed}, *edges],
    }


def _component(package: Package, kind: str) -> dict[str, Any]:
    url = _url(package, kind)
    component = {"type": "library", "bom-ref": url, "name": package.name, "version": package.version, "purl": url}
    if package.extras:
        component["scope"] = "optional"
    return {**component, "licenses": [{"license": {"name": package.license}}]}


def _url(package: Package, kind: str) -> str:
    return f"pkg:{kind}/{quote(package.name)}@{quote(package.version)}"


if __name__ == "__main__":
    json.dump(bill(installed(), bundled()), sys.stdout, indent=1)
    print()
