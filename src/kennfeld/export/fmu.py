"""FMU of a function: its description, its C code as `sources/`, and a library for this machine."""

import hashlib
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal
from uuid import UUID

import numpy as np

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.fmi_platform import SUFFIXES, platform_folder, platform_tuple
from kennfeld.base.formatting import holds_control_characters, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.c_code import write_c
from kennfeld.export.cross_compiler import CrossCompiler
from kennfeld.export.fmi2_description import fmi2_description
from kennfeld.export.fmi3_description import build_description, fmi3_description
from kennfeld.export.fmu_variables import ExportedVariable, interface_of
from kennfeld.export.host_compiler import HostCompiler
from kennfeld.export.prepared import PreparedFunction

Moment = Literal["start", "end"]
_STAMP = (1980, 1, 1, 0, 0, 0)  # of all members, so that equal functions give equal files
FLAGS = ("-fvisibility=hidden",)


@dataclass(frozen=True)
class FmuSettings:
    """Settings of an FMU.

    Attributes:
        version: version of FMI.
        inputs: "end" if inputs that are set before a step are those at its end, "start" if at its start.
        step: its step in s.
        fixed: True if steps of another length are errors.
        platforms: machines for which it has a library in addition to this one, named as in FMI 3.0.
    """

    version: Literal[2, 3]
    inputs: Moment
    step: float
    fixed: bool
    platforms: tuple[str, ...] = ()

    @property
    def rule(self) -> str:
        """The rule for inputs and outputs, a sentence for the description."""
        if self.inputs == "end":
            return (
                "Inputs set before a step count at its end, to which the outputs behind the step belong; "
                "those set in the initialization count at the start of the simulation."
            )
        return (
            "Inputs set before a step count at its start; outputs behind the step are those of its start, "
            "until inputs are set for the next one."
        )

    @property
    def step_rule(self) -> str:
        """The message for a step that is refused."""
        return f"the step has to be {self.step!r} s" if self.fixed else "the step has to be a finite number > 0"


def write_fmu(
    function: PreparedFunction, settings: FmuSettings, location: Location, findings: Findings
) -> dict[str, bytes]:
    """Return the content of the FMU by its file name.

    Raises:
        InputError: two variables have the same name, or a start value is not finite.
    """
    variables = interface_of(function, arrays=settings.version == 3)
    _check(variables, location)
    code = write_c(function, tangent=True)
    token = _token(code, settings)
    runtime = {name: _runtime(name) for name in ("core.h", f"fmi{settings.version}.c")}
    sources = {**code, "model.h": _model_header(function, variables, settings, token), **runtime}
    describe = fmi2_description if settings.version == 2 else fmi3_description
    description = describe(function, variables, token, settings.rule, settings.step, settings.fixed)
    members: dict[str, str | bytes] = {"modelDescription.xml": description}
    if settings.version == 3:
        members["sources/buildDescription.xml"] = build_description(function.name)
    members |= {f"sources/{name}": text for name, text in sources.items()}
    for platform, library in _libraries(function.name, sources, settings.platforms, location, findings):
        folder = platform_folder(f"{settings.version}.0", platform)
        members[f"binaries/{folder}/{_library_name(function.name, platform)}"] = library
    return {f"{function.name}.fmu": _archive(members)}


def is_fixed_step(function: PreparedFunction) -> bool:
    """Return True if the memory of a function counts steps: it never reads their length, or delays by several."""
    if not function.states:
        return False
    reads = {"dt", "dt_next"} & set(function.clocks)
    return not reads or any(state.latency > 1 for state in function.states)


def _check(variables: tuple[ExportedVariable, ...], location: Location) -> None:
    names = [variable.name for variable in variables]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    findings = Findings()
    if twice:
        message = f"{join_names(twice)} would be the name of several variables of the FMU"
        findings.error(location, message, "Rename one of them in the function.")
    unwritable = [repr(name) for name in names if holds_control_characters(name)]
    if unwritable:
        message = f"the names {join_names(unwritable)} hold characters that XML cannot"
        findings.error(location, message, "Rename them in the function.")
    infinite = [v.name for v in variables if v.start is not None and not np.isfinite(v.start).all()]
    if infinite:
        message = f"values of {join_names(infinite)} are not finite, which a description of an FMU cannot state"
        findings.error(location, message, "Change them.")
    findings.finish()


def _token(code: Mapping[str, str], settings: FmuSettings) -> str:
    """Return the GUID: the same for the same code."""
    content = repr((sorted(code.items()), settings.version, settings.inputs, settings.step, settings.fixed))
    return f"{{{UUID(bytes=hashlib.sha256(content.encode()).digest()[:16])}}}"


def _runtime(name: str) -> str:
    return (files("kennfeld.export") / "runtime" / name).read_text(encoding="utf-8")


def _model_header(
    function: PreparedFunction, variables: tuple[ExportedVariable, ...], settings: FmuSettings, token: str
) -> str:
    name = function.name
    structs = {"input": "inputs", "output": "outputs", "parameter": "parameters"}
    places = [
        f"    {{PLACE_{v.causality.upper()}, offsetof({name}_{structs[v.causality]}, {v.member}), {v.size}}},"
        if v.causality in structs
        else "    {PLACE_TIME, 0, 1},"
        for v in variables
    ]
    flags = {
        "FIXED_STEP": settings.fixed,
        "AT_START": settings.inputs == "start",
        "HAS_MEMORY": bool(function.states),
        "USES_DT": "dt" in function.clocks,
        "USES_DT_NEXT": "dt_next" in function.clocks,
        "USES_T": "t" in function.clocks,
    }
    lines = [
        f"/* what the interface of FMI has to know of {name} */",
        "#ifndef KENNFELD_MODEL_H",
        "#define KENNFELD_MODEL_H",
        "",
        f'#include "{name}.h"',
        "",
        f"#define MODEL(x) {name}_##x",
        f'#define TOKEN "{token}"',
        f"#define STEP {settings.step!r}",
        f'#define STEP_RULE "{settings.step_rule}"',
        *(f"#define {flag} {int(value)}" for flag, value in flags.items()),
        "",
        "#define PLACES { \\",
        *(f"{place} \\" for place in places),
        "}",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _libraries(
    name: str, sources: Mapping[str, str], platforms: Sequence[str], location: Location, findings: Findings
) -> Iterator[tuple[str, bytes]]:
    """Yield machines with their libraries; for this one, the compiler of the machine is preferred."""
    own, host = platform_tuple(), HostCompiler.find()
    others = [platform for platform in platforms if platform != own or host is None]
    if host is not None:
        yield own, _library(host, _library_name(name, own), sources)
    elif own not in platforms:
        has = "sources only" if not others else "no library for this machine"
        message = f"the FMU has {has}, as this machine has no C compiler"
        findings.warning(location, message, "Install gcc or clang, or set CC, and export again; or compile sources/.")
    for platform in others:
        yield platform, _library(CrossCompiler.of(platform), _library_name(name, platform), sources)


def _library_name(name: str, platform: str) -> str:
    return name + SUFFIXES[platform.partition("-")[2]]


def _library(compiler: HostCompiler, library: str, sources: Mapping[str, str]) -> bytes:
    with TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        target = folder / library
        # else a library of macOS states the path at which it was made, in this folder
        named = (f"-Wl,-install_name,@rpath/{library}",) if library.endswith(SUFFIXES["darwin"]) else ()
        code = [folder / file for file in sorted(sources) if file.endswith(".c")]
        compiler.shared_library(code, target, (*FLAGS, *named))
        return target.read_bytes()


def _archive(members: Mapping[str, str | bytes]) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            info = zipfile.ZipInfo(name, _STAMP)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return buffer.getvalue()


def require_step(step: float | None, fixed: bool, location: Location) -> float:
    """Return the step of an FMU; raise `InputError` if it is not known and matters."""
    if step is None and fixed:
        message = "the step of the FMU is not known: the function counts steps, and there are no data with time stamps"
        raise InputError.of(location, message, "State it with --step.")
    return 0.1 if step is None else step
