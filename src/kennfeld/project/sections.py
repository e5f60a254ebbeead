"""Reads the sections of a project file into the values of `schema`. One pass reports every problem of the file."""

import math
from pathlib import Path
from typing import Any

from kennfeld.calfiles import endings
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.preprocessing.recipe import DatasetEntry, SteadyEntry
from kennfeld.project.limit_sections import read_equality, read_limit
from kennfeld.project.schema import (
    MAX_STARTS,
    PROTECTED,
    SIMULINK,
    CalibrationEntry,
    CriterionEntry,
    ModelEntry,
    OptimizerEntry,
    ProjectFile,
    RegionEntry,
    TargetEntry,
)
from kennfeld.project.step_sections import read_steps
from kennfeld.project.structuring import Section, as_finite
from kennfeld.project.table_sections import read_group_axis, read_parameter
from kennfeld.project.toml_file import is_training, read_toml

_INNER = "calculated"

_EXAMPLE = 'Write steady = { channel = "Speed", window = 5.0, tolerance = 10 }.'


def read_project(path: Path) -> ProjectFile:
    """Read a project file. Raises `InputError` with every problem of the file itself."""
    findings: list[Finding] = []
    tables = read_toml(path)
    if is_training(tables):
        raise InputError.of(path.name, "this is a training file, not a project", "Run `kennfeld surrogate train`.")
    root = Section(tables, path.name, findings)
    channels, calculated = read_channels(root)
    file = ProjectFile(
        path=path,
        name=path.resolve().parent.name if path.stem == "kennfeld" else path.stem,
        model=_model(root),
        channels=channels,
        calculated=calculated,
        datasets=read_datasets(root),
        calibration=_calibration(root),
        axes={name: read_group_axis(name, section) for name, section in root.named("axes").items()},
        parameters={name: read_parameter(name, section) for name, section in root.named("parameters").items()},
        criteria=_criteria(root),
        optimizer=_optimizer(root),
        limits=tuple(read_limit(section) for section in root.sections("limit")),
        equalities=tuple(read_equality(section) for section in root.sections("equality")),
        steps=read_steps(root),
        surrogates=root.text_table("surrogates"),
        units=root.text_table("units"),
        findings=tuple(finding for finding in findings if finding.severity == "warning"),
    )
    _end(root)
    if any(finding.severity == "error" for finding in findings):
        raise InputError(findings)
    return file


def _end(root: Section) -> None:
    """Report unknown sections, and keys before the first section."""
    known = ("model", "channels", "calculated", "dataset", "calibration", "axes", "parameters", "criterion")
    more = ("limit", "equality", "optimizer", "step", "surrogates", "units")
    for key, value in root.values.items():
        if key not in (*known, *more):
            is_section = isinstance(value, dict | list)
            message = "unknown section" if is_section else "unknown key"
            root.report(f"[{key}]" if is_section else key, message, nearest(key, [*known, *more]))


def _model(root: Section) -> ModelEntry:
    section = root.section("model", 'Write [model] and file = "....kf".')
    if section is None:
        return ModelEntry("")
    file = section.text("file")
    if not section.has("file"):
        section.report("file", "the key is missing", 'Write file = "....kf", the formula text.')
    step = section.number("step", 0.0, 0.0, above=True) or None
    drawn = section.text("subsystem"), section.texts("parameters"), section.text_table("bind"), section.texts("folders")
    section.end()
    if file and any(drawn) and not file.lower().endswith((*SIMULINK, PROTECTED)):
        section.report("file", f"subsystem, parameters, bind and folders require a Simulink model, got {file}")
    return ModelEntry(file, step, *drawn)


def read_datasets(root: Section) -> tuple[DatasetEntry, ...]:
    """Return the entries of `[[dataset]]`; there must be at least one."""
    sections = root.sections("dataset")
    if not sections and "dataset" not in root.values:
        root.report("[[dataset]]", "the section is missing", 'Write [[dataset]] and files = ["..."].')
    return tuple(_dataset(section) for section in sections)


def _dataset(section: Section) -> DatasetEntry:
    if not section.has("files"):
        section.report("files", "the key is missing", 'Write files = ["..."].')
    shift, unknown = _shift(section)
    entry = DatasetEntry(
        place=section.place,
        files=section.texts("files"),
        name=section.text("name"),
        use="test" if section.choice("use", "training", ("training", "test")) == "test" else "training",
        weight=section.number("weight", 1.0, 0.0),
        raster=section.number("raster", 0.0, 0.0, above=True) or None,
        where=section.text("where"),
        warmup=section.number("warmup", 0.0, 0.0),
        max_gap=section.number("max_gap", 0.0, 0.0),
        shift=shift,
        unknown_shifts=unknown,
        weight_channel=section.text("weight_channel"),
        settle=section.number("settle", 0.0, 0.0, above=True) or None,
        average=section.number("average", 0.0, 0.0),
        step=section.number("step", 0.0, 0.0, above=True) or None,
        steady=read_steady(section),
        cache=section.flag("cache") is not False,
    )
    _check_settling(section, entry)
    check_steady(section, entry)
    section.end()
    return entry


def _check_settling(section: Section, entry: DatasetEntry) -> None:
    """Report keys that require `settle`, and those that contradict it."""
    if not section.has("settle"):
        for key in ("average", "step"):
            if section.has(key):
                section.report(key, f"{key} requires settle", "Write settle = ... in s, or remove it.")
        return
    for key in ("raster", "warmup", "max_gap"):
        if section.has(key) and not section.has("steady"):  # which averages a recording to points first
            section.report(key, f"{key} contradicts settle, which is for steady-state points", "Remove one.")
    for key, value in (("average", entry.average), ("step", entry.step)):
        if entry.settle is not None and value is not None and value > entry.settle:
            section.report(key, f"must be <= settle = {entry.settle:g} s, got {value:g} s", "Shorten it.")


def _shift(section: Section) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the given shifts, and the channels whose shift is to be estimated."""
    if not section.has("shift"):
        return {}, ()
    if section.values["shift"] == "auto":
        section.report("shift", 'shift = "auto" must name a channel', 'Write shift = { Channel = "auto" }.')
        return {}, ()
    inner = section.inner("shift")
    if inner is None:
        return {}, ()
    unknown = tuple(name for name, value in inner.values.items() if value == "auto")
    return {name: inner.number(name, 0.0) for name in inner.values if name not in unknown}, unknown


def _calibration(root: Section) -> CalibrationEntry:
    section = root.section("calibration")
    if section is None:
        return CalibrationEntry()
    initial, descriptions = _initial(section)
    entry = CalibrationEntry(
        initial=initial,
        descriptions=descriptions,
        variant=section.text("variant"),
        output=tuple(ending for word in section.texts("output") if (ending := _ending(section, word))),
        free=section.texts("free") if section.has("free") else ("*",),
    )
    section.end()
    return entry


def _ending(section: Section, word: str) -> str:
    """Return the file extension of an output format, empty if it is unknown."""
    ending = f".{word.casefold().removeprefix('.')}"
    if ending in endings():
        return ending
    known = [known.removeprefix(".") for known in endings()]
    remedy = nearest(word, known) or f"Choose from {', '.join(known)}."
    section.report("output", f"unknown calibration format {word!r}", remedy)
    return ""


def _initial(section: Section) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the initial files, and the A2L file of each image among them."""
    value = section.get("initial")
    if value is None:
        return (), {}
    names: list[str] = []
    descriptions: dict[str, str] = {}
    for item in value if isinstance(value, list) else [value]:
        if isinstance(item, dict):
            inner = Section(item, f"{section.place} initial", section.findings)
            name, description = inner.text("hex"), inner.text("a2l")
            inner.end()
            if not name:
                inner.report("hex", "the key is missing", 'Write initial = { a2l = "ecu.a2l", hex = "ecu.hex" }.')
                continue
            names.append(name)
            if description:
                descriptions[name] = description
        elif isinstance(item, str) and item.strip():
            names.append(item)
        else:
            section.report(
                "initial", f"must be a file, got {item!r}", 'Write "start.dcm" or { a2l = "...", hex = "..." }.'
            )
    return tuple(dict.fromkeys(names)), descriptions


def _criteria(root: Section) -> tuple[CriterionEntry, ...]:
    sections = root.sections("criterion")
    if not sections and "criterion" not in root.values:
        root.report("[[criterion]]", "the section is missing", 'Write [[criterion]], node = "..." and target = "...".')
    return tuple(_criterion(section) for section in sections)


def _criterion(section: Section) -> CriterionEntry:
    for key, example in (("node", '"..."'), ("target", '{ channel = "..." }')):
        if not section.has(key):
            section.report(key, "the key is missing", f"Write {key} = {example}.")
    loss = section.choice("loss", "square", ("square", "huber", "soft_l1"))
    if loss == "square" and "delta" in section.values:
        section.report("delta", "delta requires the loss huber or soft_l1", 'Write loss = "huber" or "soft_l1".')
    entry = CriterionEntry(
        place=section.place,
        node=section.text("node"),
        target=_target(section),
        weight=section.number("weight", 1.0, 0.0),
        loss="huber" if loss == "huber" else "soft_l1" if loss == "soft_l1" else "square",
        delta=section.number("delta", 1.0, 0.0, above=True),
        scale=section.number("scale", 1.0, 0.0, above=True),
        weight_channel=section.text("weight_channel"),
        regions=_regions(section),
    )
    section.end()
    return entry


def _regions(section: Section) -> tuple[RegionEntry, ...]:
    tables = section.get("regions")
    example = 'Write regions = [{ where = "Speed > 3000", weight = 2.0 }].'
    if tables is None:
        return ()
    if not isinstance(tables, list) or not all(isinstance(item, dict) for item in tables):
        section.report("regions", "must be a list of tables", example)
        return ()
    regions = []
    for number, item in enumerate(tables, 1):
        inner = Section(item, f"{section.place} region {number}", section.findings)
        where, weight = inner.text("where"), inner.number("weight", 1.0, 0.0)
        for key in ("where", "weight"):
            if key not in item:
                inner.report(key, "the key is missing", example)
        inner.end()
        if where:
            regions.append(RegionEntry(where, weight))
    return tuple(regions)


def _target(section: Section) -> TargetEntry:
    value: Any = section.get("target")
    number = as_finite(value)
    if number is not None:
        return TargetEntry("number", value=number)
    if isinstance(value, str) and value.strip():
        return TargetEntry("name", value)
    if not isinstance(value, dict):
        if value is not None:
            remedy = 'Write { channel = "..." }, { node = "..." }, a number or a name.'
            section.report("target", f"must be a channel, a node or a number, got {value!r}", remedy)
        return TargetEntry("number", value=math.nan)
    inner = Section(value, f"{section.place} target", section.findings)
    channel, node = inner.text("channel"), inner.text("node")
    inner.end()
    if len(inner.values.keys() & {"channel", "node"}) != 1:
        inner.report("", "must be either a channel or a node", 'Write { channel = "..." } or { node = "..." }.')
    return TargetEntry("channel", channel) if channel else TargetEntry("node", node)


def _optimizer(root: Section) -> OptimizerEntry:
    section = root.section("optimizer")
    if section is None:
        return OptimizerEntry()
    method = section.choice("method", "gauss-newton", ("gauss-newton", "global"))
    if method != "global" and section.has("max_evaluations"):
        remedy = 'Write method = "global", or max_iterations.'
        section.report("max_evaluations", f"max_evaluations requires the method global, got {method}", remedy)
    continuation = section.choice("continuation", "auto", ("auto", "off"))
    entry = OptimizerEntry(
        max_iterations=section.whole("max_iterations", 200, 1),
        tolerance=section.number("tolerance", 1e-8, 0.0, above=True),
        continuation="off" if continuation == "off" else "auto",
        method="global" if method == "global" else "gauss-newton",
        max_evaluations=section.whole("max_evaluations", 0, 1),
        starts=section.whole("starts", 1, 1, MAX_STARTS),
        seed=section.whole("seed", 0, 0),
        spread=section.number("spread", 0.5, 0.0, above=True),
        save_every=section.whole("save_every", 0, 0),
    )
    section.end()
    return entry


def read_channels(root: Section) -> tuple[dict[str, str], dict[str, str]]:
    """Return the channels of inputs and the formulas of calculated channels, each by name.

    Calculated channels are in `[calculated]` or `[channels.calculated]`.

    >>> found = []
    >>> text = {"channels": {"Speed": "n", "calculated": {"n": "omega * 30 / pi"}}}
    >>> read_channels(Section(text, "kennfeld.toml", found)), found
    (({'Speed': 'n'}, {'n': 'omega * 30 / pi'}), [])
    """
    calculated = root.text_table("calculated")
    section = root.section("channels")
    if section is None:
        return {}, calculated
    inner = section.inner(_INNER) if isinstance(section.values.get(_INNER), dict) else None  # a text is a channel
    names = [name for name in section.values if inner is None or name != _INNER]
    channels = {name: text for name in names if (text := section.text(name))}
    return channels, calculated if inner is None else _both(calculated, inner)


def _both(calculated: dict[str, str], inner: Section) -> dict[str, str]:
    """Return the formulas of both tables and report names in both."""
    more = {name: text for name in inner.values if (text := inner.text(name))}
    for name in more:
        if name in calculated:
            inner.report(name, "duplicate of the channel in [calculated]", "Remove one.")
    return more | calculated


def read_steady(section: Section) -> tuple[SteadyEntry, ...]:
    """Return the steady-state conditions of a recording, one table or a list of them."""
    given: Any = section.get("steady")
    if given is None:
        return ()
    tables = [given] if isinstance(given, dict) else given
    if not isinstance(tables, list) or not tables or not all(isinstance(item, dict) for item in tables):
        section.report("steady", "must be a table or a list of tables", _EXAMPLE)
        return ()
    made: list[SteadyEntry] = []
    for number, item in enumerate(tables, 1):
        place = f"{section.place} steady" + (f" {number}" if len(tables) > 1 else "")
        entry = _entry(Section(item, place, section.findings))
        if entry.channel in [other.channel for other in made]:
            section.report(f"steady {number}", f"duplicate channel {entry.channel}", "Remove one.")
        made.append(entry)
    return tuple(made)


def _entry(section: Section) -> SteadyEntry:
    for key in ("channel", "window", "tolerance"):
        if not section.has(key):
            section.report(key, "the key is missing", _EXAMPLE)
    entry = SteadyEntry(
        channel=section.text("channel"),
        window=section.number("window", math.inf, 0.0, above=True),
        tolerance=section.number("tolerance", 0.0, 0.0),
    )
    section.end()
    return entry


def check_steady(section: Section, entry: DatasetEntry) -> None:
    """Report keys that contradict `steady`."""
    if not section.has("steady"):
        return
    if section.has("warmup"):
        remedy = f'Write where = "t > {entry.warmup:g}", or remove it.'
        section.report("warmup", "warmup contradicts steady: averaged points have no warm-up", remedy)
    if entry.unknown_shifts:
        message = 'shift = "auto" contradicts steady: averaged points have no time'
        section.report("shift", message, f"Write {entry.unknown_shifts[0]} = ... in s.")
