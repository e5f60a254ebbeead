"""The keys of `[model]`: the function of a project."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields
from typing import Literal

from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.watch_folder import DEFAULT_LIMIT
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer import ImportOptions
from kennfeld.models.importer_registry import importer_of, importers


@dataclass(frozen=True)
class ModelEntry:
    """`[model]`; the keys after `timeout` are for Simulink models, ASCET projects and FMUs."""

    file: str = key(
        "the function: a `.kf` file, a [Simulink model](formats.md#simulink), `.slx` or `.mdl`, a class or an "
        "application of an [ASCET project](ascet.md), `.esdl` or `.app`, `.axl` or `.amd`, or a "
        "[function from another tool](functions.md): `plant.fmu`, `knock.onnx`, `engine.c:torque`, `engine.py:torque`",
        holds="function file",
        missing='Write file = "....kf", the formula text.',
    )
    step: float | None = key(
        "for models with memory: the step of the model. If it is finer than the step of the data, inputs are "
        "interpolated, except for switches and others that jump between levels, which are held",
        None,
        above=0,
        unit="s",
        default_text="the step of the data",
    )
    timeout: float = key(
        "for functions of files whose code runs, such as [FMUs](functions.md#crashes-and-endless-loops): the time that "
        "one call may take. A command that waits for longer ends with a message",
        DEFAULT_LIMIT,
        above=0,
        unit="s",
    )
    subsystem: str = key('the part of a Simulink model that is the function: `"Engine/Torque"`', "")
    parameters: tuple[str, ...] = key(
        "a file, or a list of files, with values of a Simulink model's variables: scripts (`.m`), `.mat`, `.sldd`, "
        "calibration files; later files take precedence",
        (),
        holds="calibration file",
    )
    bind: Mapping[str, str] = key(
        '`{ "Engine/Sensor" = "T_meas + 273.15" }` replaces the output of a block of a Simulink model by a channel or '
        "a [formula](formula.md) over channels",
        factory=dict,
        holds="formula",
        by="block",
    )
    folders: tuple[str, ...] = key(
        "a folder or a list of folders in which libraries, referenced models, data dictionaries, classes and functions "
        "of a Simulink model, or packages of an ASCET project, are searched, in addition to its own folder",
        (),
        holds="folder",
    )
    class_name: str = key(
        "the class of an ESDL file, or the class or module of an `.axl` archive, that is the function, if the file has "
        "several",
        "",
        name="class",
    )
    methods: tuple[str, ...] = key(
        "the methods of the class that a step calls, in their order",
        (),
        default_text="those of its task, or its public methods less those that start or reset it",
    )
    startup: tuple[str, ...] = key(
        "the methods of the class that run once before the first step", (), default_text="those of the application"
    )
    task: tuple[str, ...] = key(
        'the task of an ASCET application that is the function, if it has several; or a list of tasks, or `"*"` for '
        "all that are periodic, each of which runs at its own period",
        (),
    )
    outputs: tuple[str, ...] = key(
        "variables of an [FMU](functions.md#fmu) that become nodes in addition to its outputs, or patterns of their "
        'names: `["body.v", "der(*)"]`',
        (),
        default_text="the states, if it has no outputs",
    )
    limit_assignments: bool | None = key(
        "`true`: real numbers of an ASCET model are limited to the [ranges of their types](ascet.md#ranges-of-reals) "
        "when they are assigned; `false`: they are not",
        None,
        default_text="as generated code does",
    )
    target: Literal["lp64", "ilp32"] = key(
        "the data model of the processor for functions in C, also of those of `[functions]`: `ilp32`, where `long`, "
        "`size_t` and addresses have 32 bits, or `lp64`, where they have 64",
        "lp64",
    )
    float32: bool = key(
        "round each result of type `float` of functions in C, and signals of type `single` of a "
        "[Simulink model](simulink.md#data-types), to single precision, as the processor does; for C also in "
        "`[functions]`",
        False,
    )

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield keys that the importer of the function does not take."""
        # formula text may call functions in C, which take these two
        own = ("step", *(("target", "float32") if self.file.endswith(".kf") else ()))
        plain = ModelEntry(self.file)
        names = [part.name for part in fields(ImportOptions) if part.name not in own]
        used = [name for name in names if getattr(self, name) != getattr(plain, name)]
        if not self.file or not used:
            return
        importer = importer_of(split_reference(self.file)[0])
        taken = () if importer is None else importer.keys
        # one finding for all keys of the same importers
        keys: dict[tuple[str, ...], list[str]] = {}
        for name in used:
            if name not in taken:
                takers = tuple(each.label for each in importers() if name in each.keys)
                keys.setdefault(takers, []).append("class" if name == "class_name" else name)
        for takers, names in keys.items():
            verb = "requires" if len(names) == 1 else "require"
            wanted = join_names(takers, len(takers), " or ") or "an importer that is not installed"
            yield "file", f"{join_names(names, len(names), ' and ')} {verb} {wanted}, got {self.file}", ""
