"""Packages with an entry point, as an installer leaves them in a folder."""

from kennfeld.files.plugins import forget_plugins
from kennfeld.models import importer_registry


def install(folder, module, code, entry, group="kennfeld.formats"):
    """Put a package with one entry point into a folder."""
    (folder / f"{module}.py").write_text(code, encoding="utf-8")
    facts = folder / f"{module}-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n", encoding="utf-8")
    (facts / "entry_points.txt").write_text(f"[{group}]\n{entry}\n", encoding="utf-8")


def forget_packages():
    """Look for the formats and importers of packages anew."""
    forget_plugins()
    importer_registry._own.cache_clear()
    importer_registry._others.cache_clear()
