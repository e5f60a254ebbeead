"""Simulink files of any layout, told by their content, as a `Document`."""

import contextlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

from kennfeld.errors import InputError
from kennfeld.models.simulink.files.blocks import Builder
from kennfeld.models.simulink.files.brace_sections import brace_sections, brace_text
from kennfeld.models.simulink.files.chart import Chart
from kennfeld.models.simulink.files.charts import charts_of
from kennfeld.models.simulink.files.masks import mask_of
from kennfeld.models.simulink.files.package import Package, is_text_package, is_zip, text_package, zip_package
from kennfeld.models.simulink.files.section import Section
from kennfeld.models.simulink.files.settings import active_configuration, callbacks_of, defaults_of, setting, solver_of
from kennfeld.models.simulink.files.stored_workspace import workspace_of
from kennfeld.models.simulink.files.tree import Document, Solver, System
from kennfeld.models.simulink.files.trouble import RefusedError, Trouble

__all__ = ["read_document", "recognises_simulink"]

_DIAGRAMS = ("Model", "Library", "Subsystem")
_HEAD = 65536
_CLASSIC = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:Model|Library|Subsystem)\s*\{")
_ROOT = "simulink/blockdiagram.xml"
_NEW_ROOT = "simulink/blockDiagram.json"  # of R2026b and later, whose systems remain XML
_NEW_DIAGRAM = "BlockDiagram"
_FIRST_CONFIGURATION = "simulink/configSet0.xml"
_RELEASES = ("metadata/mwcoreProperties.xml", "metadata/mwcorePropertiesReleaseInfo.xml")
_MEND = "Simulink files end in .slx or .mdl."
_LARGEST = 1_000_000_000  # bytes


def recognises_simulink(raw: bytes) -> bool:
    """Whether bytes, or the first of a file, look like a Simulink model that is no zip archive."""
    return bool(_CLASSIC.match(raw)) or is_text_package(raw)


def read_document(path: str | Path) -> Document:
    """The tree of a `.slx` or `.mdl` file of any version.

    Raises `InputError` with every finding where the file is broken, hostile, protected or no Simulink file at all.
    What is merely unusual is among the document's remarks.
    """
    path = Path(path)
    return document(_bytes(path), path)


def document(raw: bytes, path: Path) -> Document:
    """The tree of a file's bytes; `path` is only what it is called. Raises `InputError` like `read_document`."""
    trouble = Trouble(path.name)
    read = None
    with contextlib.suppress(RefusedError):
        read = _packed(raw, path, trouble) if is_zip(raw) or is_text_package(raw) else _classic(raw, path, trouble)
    remarks = trouble.settle()
    if read is None:
        raise InputError.of(path.name, "is no Simulink file", _MEND)
    return replace(read, remarks=remarks) if remarks else read


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > _LARGEST:
            raise InputError.of(str(path), f"has more than {_LARGEST / 1e6:.0f} MB", "No model is that large.")
        return path.read_bytes()
    except OSError as error:
        raise InputError.of(str(path), f"cannot be read: {error.strerror or error}") from None


def _classic(raw: bytes, path: Path, trouble: Trouble) -> Document | None:
    if not _CLASSIC.match(raw[:_HEAD].removeprefix(b"\xef\xbb\xbf")):
        raise trouble.refuse("", "is no Simulink file", _MEND)
    top = brace_sections(brace_text(raw.removeprefix(b"\xef\xbb\xbf")), trouble)
    model = next((section for section in top if section.kind in _DIAGRAMS), None)
    if model is None:
        return None
    stateflow = next((section for section in top if section.kind == "Stateflow"), None)
    charts = charts_of(stateflow, _no_part) if stateflow is not None else {}
    builder = Builder(trouble, _no_part, charts, defaults_of(model))
    solver = solver_of(active_configuration(model), model)
    version = model.get("Version")
    return _document(model, path, version, builder, solver, model.get("Name") or path.stem, Parts(None, top, trouble))


def _no_part(_: str) -> Section | None:
    return None


def _packed(raw: bytes, path: Path, trouble: Trouble) -> Document | None:
    package = zip_package(raw, trouble) if is_zip(raw) else text_package(raw, trouble)
    if trouble.errors:
        return None
    name = next((name for name in (_ROOT, _NEW_ROOT) if name in package), None)
    if name is None:
        raise _no_diagram(package, trouble)
    root = package.section(name)
    if root is None:
        return None
    model = next(_diagrams(root), None)
    if model is None:
        raise trouble.refuse(name, f"has no {', '.join(_DIAGRAMS[:-1])} or {_DIAGRAMS[-1]}", _MEND)
    return _of_package(package, model, path, trouble)


def _diagrams(root: Section) -> Iterator[Section]:
    if root.kind in (*_DIAGRAMS, _NEW_DIAGRAM):
        yield root
    yield from root.all(*_DIAGRAMS)


def _no_diagram(package: Package, trouble: Trouble) -> RefusedError:
    names = list(package.names())
    if any("encrypted" in name.lower() or name.endswith(".slxp") for name in names):
        return trouble.refuse("", "is a protected model, whose blocks cannot be read", "Ask for the model itself.")
    if any(name.startswith("data/chunk") for name in names):
        return trouble.refuse("", "is a data dictionary and no model", "Name it among the parameters.")
    return trouble.refuse("", f"is no Simulink model: it has no part {_ROOT}", _MEND)


def _of_package(package: Package, model: Section, path: Path, trouble: Trouble) -> Document:
    def system(name: str) -> Section | None:
        return package.section(f"simulink/systems/{name.removesuffix('.xml')}.xml")

    defaults = defaults_of(package.section("simulink/bddefaults.xml"), model)
    builder = Builder(trouble, system, _charts(package), defaults)
    configuration = _configuration(package)
    solver = solver_of(configuration if configuration is not None else active_configuration(model), model)
    parts = Parts(package, [], trouble)
    return _document(model, path, _release(package), builder, solver, path.stem, parts)


def _charts(package: Package) -> dict[str, Chart]:
    def chart(name: str) -> Section | None:
        return package.section(f"simulink/stateflow/{name.removesuffix('.xml')}.xml")

    stateflow = package.section("simulink/stateflow/machine.xml") or package.section("simulink/stateflow.xml")
    return charts_of(stateflow, chart) if stateflow is not None else {}


def _configuration(package: Package) -> Section | None:
    """The part of the active configuration; the first where none is called active."""
    info = package.section("simulink/configSetInfo.xml") or package.section("simulink/configSetInfo.json")
    named = list(info.all("ConfigSet", "ConfigSetInfo")) if info is not None else []
    active = next((part for part in named if part.keys.get("Active") in ("true", "on")), None) or next(
        iter(named), None
    )
    name = active.keys.get("PartName", "").lstrip("/") if active is not None else _FIRST_CONFIGURATION
    return package.section(name)


def _release(package: Package) -> str:
    for name in _RELEASES:
        section = package.section(name)
        release = (section.get("matlabRelease") or section.get("release")) if section is not None else ""
        if release:
            return release.strip()
    return package.release


class Parts:
    """Where a file keeps what is not in its diagram: the parts of a package, or the sections beside the model."""

    def __init__(self, package: Package | None, sections: list[Section], trouble: Trouble) -> None:
        self.package = package
        self.sections = sections
        self.trouble = trouble

    def kind(self) -> Literal["model", "library", "subsystem"]:
        """What the package says that it is, where the diagram does not."""
        core = self.package.section(_RELEASES[0]) if self.package is not None else None
        content = core.get("contentType").lower() if core is not None else ""
        return "library" if "library" in content else "subsystem" if "subsystem" in content else "model"


def _document(
    model: Section, path: Path, version: str, builder: Builder, solver: Solver, name: str, parts: Parts
) -> Document:
    kinds: dict[str, Literal["model", "library", "subsystem"]] = {"Library": "library", "Subsystem": "subsystem"}
    inner = model.first("System")
    root = builder.system(inner) if inner is not None else System()
    dictionary = setting(model, "DataDictionary")
    return Document(
        name=name,
        kind=kinds.get(model.kind) or (parts.kind() if model.kind == _NEW_DIAGRAM else "model"),
        version=version,
        path=path,
        root=root,
        solver=solver,
        callbacks=callbacks_of(model),
        workspace=workspace_of(model, parts.package, parts.sections, parts.trouble),
        dictionaries=(dictionary,) if dictionary else (),
        defaults=builder.defaults,
        enumerations=tuple(builder.enumerations),
        charts=tuple(builder.charts.values()),
        parameters=dict(model.keys),
        mask=mask_of(model) or (mask_of(inner) if inner is not None else None),
    )
