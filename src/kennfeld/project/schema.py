"""The project file: its sections and their keys, in the documented order.

Reading, writing, the JSON schema and the tables of the documentation all come from these classes.
"""

from collections.abc import Collection, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings, Fix, InputError, Location
from kennfeld.base.file_errors import files_alike
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.file_keys import key
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer import ImportOptions, ImportRequest
from kennfeld.preprocessing.recipe import DatasetEntry, used_entries
from kennfeld.project.criteria_schema import CriterionEntry, EqualityEntry, LimitEntry
from kennfeld.project.design_table import DesignEntry
from kennfeld.project.forms import EntriesForm, NamedEntriesForm, TableOfForm, TextForm, form_of, keys_of, read_entry
from kennfeld.project.model_schema import ModelEntry
from kennfeld.project.run_schema import CalibrationEntry, ClusterEntry, OptimizerEntry, ReportEntry, StepEntry
from kennfeld.project.section import KeyLocation, Section
from kennfeld.project.table_schema import GroupAxisEntry, ParameterEntry
from kennfeld.project.toml_file import is_training, parse_toml, read_text
from kennfeld.project.toml_keys import TomlKeys

_INNER = "calculated"


class ChannelsForm(TableOfForm):
    """Channels of inputs. A table `calculated` among them is an alternative spelling of `[calculated]`."""

    def read(self, section: Section, key: str) -> dict[str, str] | None:
        table = section.values[key]
        if isinstance(table, dict) and isinstance(table.get(_INNER), dict):
            rest = {name: value for name, value in table.items() if name != _INNER}
            section = section.with_values({key: rest})
        return super().read(section, key)

    def json_schema(self) -> dict[str, Any]:
        schema = super().json_schema()
        return schema | {"properties": {_INNER: {"anyOf": [{"type": "string"}, schema]}}}


@dataclass(frozen=True, eq=False, kw_only=True)
class SectionsFile:
    """A file of sections; `lines` are those of its keys, by path."""

    path: Path
    lines: dict[str, int] = field(repr=False)

    @property
    def folder(self) -> Path:
        """The folder that paths in the file are relative to."""
        return self.path.parent

    def location(self, *keys: str | int) -> Location:
        """Return the location of a section or key.

        The path `"dataset", 2, "files"` is shown as `kennfeld.toml line 9 [[dataset]] 2 files`.
        """
        section, *inner = keys
        form = form_of(keys_of(type(self))[str(section)])
        heading = f"[[{section}]]" if isinstance(form, EntriesForm) else f"[{section}]"
        # the heading of an entry has its name: [parameters.MapTorque]
        if isinstance(form, NamedEntriesForm) and inner:
            heading = f"[{section}.{inner.pop(0)}]"
        location = KeyLocation(self.path.name, keys=keys, lines=self.lines)
        for part in (heading, *inner):
            location = location.within(str(part))
        return location

    def alike(self, name: str) -> list[str]:
        """Return the files beside a missing one that have its ending, as the file names them."""
        return [(Path(name).parent / other).as_posix() for other in files_alike(self.folder / name)]


@dataclass(frozen=True, eq=False, kw_only=True)
class ProjectFile(SectionsFile):
    """Contents of a project file, its sections in the documented order."""

    unsaved: Mapping[str, str] = field(default_factory=dict, repr=False)  # texts that replace those of files, by name
    model: ModelEntry = key("the function, and how its time is stepped", missing='Write [model] and file = "....kf".')
    channels: Mapping[str, str] = key(
        "the channel of each input that has another name in the recordings",
        factory=dict,
        form=ChannelsForm(TextForm()),
        holds="channel",
        by="input",
    )
    calculated: Mapping[str, str] = key(
        "channels that are calculated by a [formula](formula.md) over other channels",
        factory=dict,
        holds="formula",
        by="calculated channel",
    )
    units: Mapping[str, str] = key(
        "the unit of each channel whose recording has none, or a wrong one; channels are converted to the units of the "
        "function",
        factory=dict,
        holds="unit",
        by="channel",
    )
    datasets: tuple[DatasetEntry, ...] = key(
        "recordings that are prepared alike", name="dataset", missing='Write [[dataset]] and files = ["..."].'
    )
    calibration: CalibrationEntry = key("calibration files to start from and to write", CalibrationEntry())
    surrogates: Mapping[str, str] = key(
        "the file of each data-driven model of the formula text", factory=dict, holds="surrogate file", by="surrogate"
    )
    functions: Mapping[str, str] = key(
        "the [file of each function](functions.md) that the formula text calls and that is not formula text itself",
        factory=dict,
        holds="file of functions",
        by="function",
    )
    axes: Mapping[str, GroupAxisEntry] = key(
        "group axes, which several tables share", factory=dict, form=NamedEntriesForm(GroupAxisEntry)
    )
    parameters: Mapping[str, ParameterEntry] = key(
        "tables, curves and numbers that are fitted", factory=dict, form=NamedEntriesForm(ParameterEntry)
    )
    criteria: tuple[CriterionEntry, ...] = key(
        "what the fit minimises", name="criterion", missing='Write [[criterion]], node = "..." and target = "...".'
    )
    limits: tuple[LimitEntry, ...] = key("bounds on nodes at every training sample", (), name="limit")
    equalities: tuple[EqualityEntry, ...] = key("sums of values that are given exactly", (), name="equality")
    steps: tuple[StepEntry, ...] = key("searches in sequence, each from the result of the one before", (), name="step")
    optimizer: OptimizerEntry = key("the search", OptimizerEntry())
    cluster: ClusterEntry = key("[large data and several machines](cluster.md)", ClusterEntry())
    report: ReportEntry = key("the head of the report", ReportEntry())
    design: DesignEntry = key("[what to measure next](how-to/measure-next.md)", factory=DesignEntry)

    @property
    def name(self) -> str:
        """The name of the file, or of its folder if it is called `kennfeld.toml`."""
        return self.path.resolve().parent.name if self.path.stem == "kennfeld" else self.path.stem

    def import_request(self, initial: ParameterSet | None = None) -> ImportRequest:
        """Return what to import as the function, if it is in a file of another tool.

        Args:
            initial: values from calibration files.
        """
        entry = self.model
        file, choice = split_reference(entry.file)
        options = ImportOptions(
            entry.step,
            tuple(self.folder / name for name in entry.folders),
            entry.subsystem,
            tuple(self.folder / name for name in entry.parameters),
            tuple(entry.bind.items()),
            entry.class_name,
            entry.methods,
            entry.startup,
            entry.task,
            entry.outputs,
            entry.limit_assignments,
            "" if entry.target == "lp64" else entry.target,
            entry.float32,
        )
        values = {name: None if section.axes else section.initial for name, section in self.parameters.items()}
        # a name with a colon is a field of a block, `Path:Field`, which is a parameter because the project names it
        fixed = ((name, _as_tuples(value)) for name, value in values.items() if value is not None or ":" in name)
        return ImportRequest(self.folder / file, options, choice, tuple(fixed), initial)


def _as_tuples(value: Float | None) -> Any:
    """Return an array as nested tuples, which requests can be compared by."""

    def nested(item: Any) -> Any:
        return tuple(map(nested, item)) if isinstance(item, list) else item

    return None if value is None else nested(np.asarray(value).tolist())


def open_sections(path: Path, text: str | None = None) -> Section:
    """Return the tables of a file, or of another text for it. Raises `InputError` if it is not valid TOML."""
    text = read_text(path) if text is None else text
    tables = parse_toml(path.name, text)
    return Section(tables, KeyLocation(path.name, lines={}), Findings(), line_of=TomlKeys(text).line)


def read_project(path: Path, unsaved: Mapping[str, str] | None = None) -> ProjectFile:
    """Read a project file.

    Args:
        path: the file.
        unsaved: texts that replace those of the project file and of formula files, by name.

    Raises:
        InputError: every problem of the file itself.
    """
    unsaved = unsaved or {}
    root = open_sections(path, unsaved.get(path.name))
    path = path.absolute()  # the present folder may be another one when the files of the project are read
    if is_training(root.values):
        message = "this is a training file, not a project"
        raise InputError.of(root.location, message, "Run `kennfeld surrogate train`.")
    file: ProjectFile = read_entry(ProjectFile, root, path=path, lines=root.location.lines, unsaved=unsaved)
    used = used_entries(file.datasets or ())
    if file.datasets and not used:
        root.report("dataset", "all datasets are off", 'Write use = "training" in one of them.')
    # before `finish`, which raises its findings together with the others
    more = _calculated_channels(root, file.calculated)
    root.findings.finish()
    return replace(file, calculated={**more, **file.calculated}, datasets=used)


def read_partly(path: Path, tables: Mapping[str, Any]) -> ProjectFile:
    """Return what the tables of a project file say as far as they are valid; the rest is as if it were not there."""
    section = Section(dict(tables), KeyLocation(path.name, lines={}), Findings())
    file: ProjectFile = read_entry(ProjectFile, section, path=path, lines={}, unsaved={})
    return replace(file, datasets=used_entries(file.datasets or ()))


def _calculated_channels(root: Section, calculated: Collection[str]) -> dict[str, str]:
    """Return the formulas of `[channels.calculated]` and report names that `[calculated]` has, too."""
    channels = root.values.get("channels")
    if not isinstance(channels, dict) or not isinstance(channels.get(_INNER), dict):
        return {}
    section = root.inner(channels, "[channels]", "channels")
    for name in channels[_INNER]:
        if name in calculated:
            location = f"{_INNER} {name}"
            fix = Fix.remove(("channels", _INNER, name))
            section.report(location, "duplicate of the channel in [calculated]", "Remove one.", [fix])
    return TableOfForm(TextForm()).read(section, _INNER) or {}
