"""Surrogate files: one readable JSON file for a data-driven model; its numbers are restored bit for bit."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import ArgumentError, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import nearest
from kennfeld.domain.dataset import Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.rbf import RBF, Expansion
from kennfeld.files.functions import SURROGATE_KINDS
from kennfeld.files.functions import recognises_surrogate as recognises_surrogate
from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
from kennfeld.surrogate.free_run_uncertainty import FreeRunUncertainty
from kennfeld.surrogate.surrogate_models import DynamicSurrogate, Mode, StaticSurrogate, SurrogateQuality
from kennfeld.surrogate.uncertainty import Uncertainty
from kennfeld.surrogate.validity import Validity

VERSIONS = {"gaussian": 1, "matern52": 2}  # by kernel: readers of version 1 know Gaussian bells only
WITH_HINGES = 3  # version of files with hinges, which readers of version 2 do not know
EXPANSION = ("offset", "slopes", "weights", "centres", "widths")
VALIDITY = ("centres", "lengths", "threshold", "least", "most")
UNCERTAINTY = ("signal", "noise", "nugget")
FREE_RUN_UNCERTAINTY = ("signal", "noise", "process_noise", "start")
REWRITE = "Train it again with `kennfeld surrogate train`."
NUMBERS = ("rmse", "r2", "max_abs")
MISSING = object()  # the value of a key that is not in its table; null is a value

Surrogate = StaticSurrogate | DynamicSurrogate | FilteredSurrogate


def write_surrogate(surrogate: Surrogate, path: str | Path) -> None:
    """Write a surrogate, whole or not at all.

    Args:
        surrogate: the surrogate.
        path: the JSON file.

    Raises:
        InputError: the file cannot be written.

    >>> bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    >>> write_surrogate(StaticSurrogate("bell", ("x",), "y", (), bell), "engine.json")
    >>> read_surrogate("engine.json").name
    'bell'
    """
    with convert_errors(path, "cannot be written", "Name another file."):
        write_whole(Path(path), _text(_tables(surrogate)), follow=True)


def read_surrogate(path: str | Path) -> Surrogate:
    """Read a file that `write_surrogate` or `kennfeld surrogate train` wrote.

    Args:
        path: the JSON file.

    Returns:
        The surrogate; its numbers are those that were written, bit for bit.

    Raises:
        InputError: all problems of the file.

    >>> bell = Expansion(1.0, [0.0], [2.0], [[3.0]], [[0.5]])
    >>> write_surrogate(StaticSurrogate("bell", ("x",), "y", (), bell), "engine.json")
    >>> read_surrogate("engine.json").expansion == bell
    True
    """
    file = Path(path)
    findings = Findings()
    reader = _TableReader(_content(file), Location(file.name), findings)
    kind = reader.text("kind")
    if kind and kind not in SURROGATE_KINDS.values():
        reader.report("kind", f"unknown kind {kind!r}", nearest(kind, SURROGATE_KINDS.values()) or REWRITE)
    version = reader.number("version")
    versions = (*VERSIONS.values(), WITH_HINGES)
    if version is not None and version not in versions:
        known = f"{', '.join(map(str, versions[:-1]))} and {versions[-1]}"
        reader.report("version", f"version {version:g} is not supported, only {known}", "Update kennfeld.")
    findings.finish()
    make, further = _READERS.get(kind, _READERS[SURROGATE_KINDS["static"]])
    values = _shared(reader) | further(reader)
    findings.finish()
    try:
        surrogate: Surrogate = make(**values)
        return surrogate
    except ArgumentError as error:
        raise InputError.of(Location(file.name), str(error), REWRITE) from None


def _tables(surrogate: Surrogate) -> dict[str, Any]:
    kind = next(name for name, (make, _) in _READERS.items() if isinstance(surrogate, make))
    result: dict[str, Any] = {
        "kind": kind,
        "version": WITH_HINGES if surrogate.expansion.hinges else VERSIONS[surrogate.expansion.kernel],
        "name": surrogate.name,
        "inputs": list(surrogate.inputs),
        "output": surrogate.output,
        "units": list(surrogate.units),
    }
    if isinstance(surrogate, DynamicSurrogate):
        result |= {
            "lags": [list(lags) for lags in surrogate.lags],
            "output_lags": list(surrogate.output_lags),
            "step": surrogate.step,
            "start": surrogate.start,
            "start_inputs": list(surrogate.start_inputs),
            "stability": surrogate.stability,
        }
    elif isinstance(surrogate, FilteredSurrogate):
        result |= {
            "delay": surrogate.delay,
            "time_constants": list(surrogate.time_constants),
            "step": surrogate.step,
            "start_inputs": list(surrogate.start_inputs),
        }
    if not isinstance(surrogate, StaticSurrogate):
        # JSON has no infinity
        result["limits"] = [None if math.isinf(limit) else limit for limit in surrogate.limits]
    result |= {"remarks": list(surrogate.remarks)} if surrogate.remarks else {}
    result["quality"] = [{name: _plain(value) for name, value in vars(line).items()} for line in surrogate.quality]
    kernel = surrogate.expansion.kernel
    result["expansion"] = {} if kernel == "gaussian" else {"kernel": kernel}
    result["expansion"] |= {name: _plain(getattr(surrogate.expansion, name)) for name in EXPANSION}
    if surrogate.expansion.hinges:
        result["expansion"]["hinges"] = [list(hinge) for hinge in surrogate.expansion.hinges]
    if surrogate.uncertainty is not None:
        names = FREE_RUN_UNCERTAINTY if isinstance(surrogate, DynamicSurrogate) else UNCERTAINTY
        result["uncertainty"] = {name: _plain(getattr(surrogate.uncertainty, name)) for name in names}
    if surrogate.validity is not None:
        result["validity"] = {name: _plain(getattr(surrogate.validity, name)) for name in VALIDITY}
    return result


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _text(tables: Mapping[str, Any], indent: str = "") -> str:
    """Return JSON text with a line for each row of numbers."""
    inner = indent + "  "
    lines = []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            text = _text(value, inner).strip()
        elif isinstance(value, list) and value and isinstance(value[0], list | Mapping):
            rows = ",\n".join(f"{inner}  {json.dumps(row, ensure_ascii=False)}" for row in value)
            text = f"[\n{rows}\n{inner}]"
        else:
            text = json.dumps(value, ensure_ascii=False)
        lines.append(f"{inner}{json.dumps(key)}: {text}")
    return f"{indent}{{\n" + ",\n".join(lines) + f"\n{indent}}}\n"


def _content(path: Path) -> Mapping[str, Any]:
    location = Location(path.name)
    with convert_errors(path, "cannot be read", missing="there is no such file", advice="Check the path."):
        raw = path.read_bytes()
    try:
        content = json.loads(raw.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise InputError.of(location, "this is not UTF-8 text", REWRITE) from None
    except json.JSONDecodeError as error:
        location = location.within(f"line {error.lineno}, column {error.colno}")
        raise InputError.of(location, f"this is not valid JSON: {error.msg}", f"Is it cut off? {REWRITE}") from None
    except RecursionError:
        raise InputError.of(location, "brackets are nested too deeply to be read", REWRITE) from None
    if not isinstance(content, dict):
        raise InputError.of(location, "this is not a surrogate file", REWRITE)
    return content


class _TableReader:
    """Typed access to one table of the file; collects all findings."""

    def __init__(self, values: Mapping[str, Any], location: Location, findings: Findings) -> None:
        self.values, self.location, self.findings = values, location, findings

    def report(self, key: str, message: str, remedy: str = REWRITE) -> None:
        self.findings.error(self.location.within(key), message, remedy)

    def get(self, key: str) -> Any:
        """Return a value; `MISSING`, with an error, if there is none."""
        if key not in self.values:
            self.report(key, "is missing")
        return self.values.get(key, MISSING)

    def check(self, key: str, value: Any, accepts: Callable[[Any], bool], expected: str) -> Any:
        """Return the value if it is accepted; else None, with an error unless it is missing."""
        if value is not MISSING and accepts(value):
            return value
        if value is not MISSING:
            self.report(key, f"must be {expected}, got {_shorten(value)}")
        return None

    def text(self, key: str) -> str:
        return self.check(key, self.get(key), lambda value: isinstance(value, str), "text") or ""

    def texts(self, key: str) -> tuple[str, ...]:
        return tuple(self.check(key, self.get(key), _is_list_of(str), "a list of texts") or ())

    def number(self, key: str) -> float | None:
        value = self.get(key)
        if _is_number(value) and math.isfinite(value):
            return float(value)
        if key in self.values:
            self.report(key, f"must be a finite number, got {_shorten(value)}")
        return None

    def numbers(self, key: str) -> Float | None:
        value = self.check(key, self.get(key), _is_numeric, "a list of finite numbers")
        if value is None:
            return None
        try:
            result = np.array(value, dtype=np.float64)
            if not np.isfinite(result).all():
                raise ValueError
        except (ValueError, OverflowError):
            self.report(key, f"must be a list of finite numbers, got {_shorten(value)}")
            return None
        return result

    def count(self, key: str) -> int:
        return int(self.check(key, self.get(key), _is_count, "a whole number >= 0") or 0)

    def whole(self, key: str, value: Any) -> tuple[int, ...]:
        return tuple(self.check(key, value, _is_list_of(int), "a list of whole numbers") or ())

    def inner(self, key: str) -> "_TableReader | None":
        values = self.check(key, self.get(key), lambda value: isinstance(value, dict), "a table")
        return None if values is None else _TableReader(values, self.location.within(key), self.findings)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number; truth values are not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_count(value: Any) -> bool:
    return _is_number(value) and value >= 0 and value % 1 == 0


def _is_numeric(value: Any) -> bool:
    """Return whether a value is a list of numbers, or a list of such lists."""
    return isinstance(value, list) and all(_is_number(item) or _is_numeric(item) for item in value)


def _is_rows(value: Any) -> bool:
    """Return whether a value is a list of lists of three numbers."""
    return isinstance(value, list) and all(_is_numeric(row) and len(row) == 3 for row in value)


def _is_list_of(kind: type) -> Callable[[Any], bool]:
    """Return a check that a value is a list of such items; truth values are not numbers."""
    return lambda value: (
        isinstance(value, list) and all(isinstance(item, kind) and not isinstance(item, bool) for item in value)
    )


def _shared(reader: _TableReader) -> dict[str, Any]:
    return {
        "name": reader.text("name"),
        "inputs": reader.texts("inputs"),
        "output": reader.text("output"),
        "units": reader.texts("units"),
        "quality": _quality(reader),
        "expansion": _inner(reader, "expansion", EXPANSION, Expansion),
        "validity": _inner(reader, "validity", VALIDITY, Validity) if "validity" in reader.values else None,
        "remarks": reader.texts("remarks") if "remarks" in reader.values else (),
    }


def _static(reader: _TableReader) -> dict[str, Any]:
    return _uncertainty(reader, UNCERTAINTY, Uncertainty)


def _uncertainty(reader: _TableReader, names: tuple[str, ...], kind: type[Any]) -> dict[str, Any]:
    known = "uncertainty" in reader.values
    return {"uncertainty": _inner(reader, "uncertainty", names, kind) if known else None}


def _dynamic(reader: _TableReader) -> dict[str, Any]:
    lags = reader.check("lags", reader.get("lags"), lambda value: isinstance(value, list), "a list of lists") or []
    return {
        "lags": tuple(reader.whole(f"lags {j}", row) for j, row in enumerate(lags, 1)),
        "output_lags": reader.whole("output_lags", reader.get("output_lags")),
        "step": reader.number("step"),
        "start": reader.number("start"),
        "start_inputs": _row(reader, "start_inputs"),
        "limits": _limits(reader),
        "stability": reader.text("stability"),
        **_uncertainty(reader, FREE_RUN_UNCERTAINTY, FreeRunUncertainty),
    }


def _filtered(reader: _TableReader) -> dict[str, Any]:
    return {
        "delay": reader.count("delay"),
        "time_constants": _row(reader, "time_constants"),
        "step": reader.number("step"),
        "start_inputs": _row(reader, "start_inputs"),
        "limits": _limits(reader),
        **_uncertainty(reader, UNCERTAINTY, Uncertainty),
    }


_READERS: dict[str, tuple[type[Any], Callable[[_TableReader], dict[str, Any]]]] = {
    SURROGATE_KINDS["static"]: (StaticSurrogate, _static),
    SURROGATE_KINDS["dynamic"]: (DynamicSurrogate, _dynamic),
    SURROGATE_KINDS["filtered"]: (FilteredSurrogate, _filtered),
}


def _row(reader: _TableReader, key: str) -> tuple[float, ...]:
    numbers = reader.numbers(key)
    if numbers is not None and numbers.ndim != 1:
        reader.report(key, "must be a flat list of numbers")
        return ()
    return () if numbers is None else tuple(numbers.tolist())


def _inner(reader: _TableReader, key: str, names: tuple[str, ...], kind: type[Any]) -> Any:
    inner = reader.inner(key)
    if inner is None:
        return None
    scalars = ("offset", "threshold", "signal", "noise", "process_noise", "start")
    values: dict[str, Any] = {name: inner.number(name) if name in scalars else inner.numbers(name) for name in names}
    _report_unknown_keys(inner, (*names, "kernel", "hinges") if key == "expansion" else names)
    if any(value is None for value in values.values()):
        return None
    if "kernel" in inner.values:
        values["kernel"] = inner.text("kernel")
    if "hinges" in inner.values:
        expected = "a list of rows of input, position and height"
        values["hinges"] = inner.check("hinges", inner.get("hinges"), _is_rows, expected) or ()
    # an empty list in the file has one axis, an expansion without centres two
    if key == "expansion" and not values["weights"].size:
        empty = np.empty((0, values["slopes"].size))
        values |= {"centres": empty, "widths": empty}
    try:
        return kind(**values)
    except (ArgumentError, np.linalg.LinAlgError) as error:
        reader.report(key, str(error))
        return None


def _report_unknown_keys(reader: _TableReader, known: tuple[str, ...]) -> None:
    for key in reader.values:
        if key not in known:
            reader.report(key, "unknown key", nearest(key, known) or REWRITE)


def _limits(reader: _TableReader) -> tuple[float, float]:
    value = reader.get("limits")
    valid = isinstance(value, list) and len(value) == 2
    if not valid or not all(item is None or _is_number(item) for item in value):
        if "limits" in reader.values:
            reader.report("limits", f"must be two numbers or null, got {_shorten(value)}")
        return (-math.inf, math.inf)
    lower, upper = value
    return (-math.inf if lower is None else float(lower), math.inf if upper is None else float(upper))


def _quality(reader: _TableReader) -> tuple[SurrogateQuality, ...]:
    lines = reader.check("quality", reader.get("quality"), _is_list_of(dict), "a list of tables") or ()
    result = []
    for i, values in enumerate(lines, 1):
        inner = _TableReader(values, reader.location.within(f"quality {i}"), reader.findings)
        use, mode = inner.text("use"), inner.text("mode")
        if use not in get_args(Use) or mode not in get_args(Mode):
            inner.report("", f"unknown use {use!r} or mode {mode!r}")
            continue
        numbers = {
            name: math.nan if inner.values.get(name, MISSING) is None else inner.number(name) for name in NUMBERS
        }
        samples = inner.count("samples")
        result.append(SurrogateQuality(inner.text("dataset"), use, mode, samples, **numbers))  # type: ignore[arg-type]
    return tuple(result)


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def surrogate_notes(surrogate: Surrogate) -> list[str]:
    """Return sentences on a surrogate: its stability, its deviation, and the remarks of its training."""
    stability = "" if isinstance(surrogate, StaticSurrogate) else surrogate.stability
    remarks = [f"Remark: {text.rstrip('.')}." for text in surrogate.remarks]
    return [*([stability] if stability else []), deviation_note(surrogate), *remarks]


def deviation_note(surrogate: Surrogate) -> str:
    """Return a line with the predictive deviation of a surrogate, or that it is not known."""
    if surrogate.uncertainty is None:
        return "deviation of a new measurement: not known"
    unit = surrogate.units[-1] if surrogate.units else ""
    least = f"{least_deviation(surrogate):.3g} {unit if unit != '-' else ''}".strip()
    if isinstance(surrogate, DynamicSurrogate):
        return f"deviation of a new measurement from a free run: {least} at its first step, or more later"
    return f"deviation of a new measurement: {least} amidst the training data, more away from them"


def least_deviation(surrogate: Surrogate) -> float | None:
    """Return the deviation of a measurement amid the training data, in the unit of the output; None if unknown.

    Of a recursion it is that of the first step of a free run.
    """
    known = surrogate.uncertainty
    return known.first if isinstance(known, FreeRunUncertainty) else None if known is None else known.noise


def as_parameters(surrogates: Iterable[Surrogate]) -> ParameterSet:
    """Return the expansions as parameters, by surrogate; locked, since they are trained and not calibrated."""
    return ParameterSet(RBF(s.name, s.expansion, locked=True) for s in surrogates)
