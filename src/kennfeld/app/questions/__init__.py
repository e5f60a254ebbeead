"""Questions of a page. A new one is a function in the module of its screen, and a line here.

The module is loaded when one of its questions is first asked: the first screen needs few of them.
"""

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from kennfeld.app.wire import Question

if TYPE_CHECKING:
    from kennfeld.app.session.session import Session

_QUESTIONS: dict[str, str] = {
    "table": "parameters.table",
    "strip": "plots.strip_chart",
    "statistics": "plots.stretch_statistics",
    "cursor": "plots.cursor",
    "scatter": "plots.scatter",
    "points": "plots.points",
    "signals": "signals.signals",
    "informing": "evidence.informing",
    "passed": "evidence.passed",
    "conditions": "evidence.conditions",
    "coverage": "evidence.coverage",
    "split": "error_split.split",
    "worst": "error_split.worst",
    "progress": "runs.progress",
    "outcome": "runs.outcome",
    "by-file": "runs.by_file",
    "sets": "comparison.sets",
    "compare": "comparison.compare",
    "choice": "comparison.choice",
    "limits": "limits.limits",
    "trust": "trust.trust",
    "pinned": "trust.pinned",
    "settings": "settings.settings",
    "schema": "schema.schema",
    "names": "schema.names",
    "files": "recordings.files",
    "file-errors": "data_overview.file_errors",
    "file-lines": "data_overview.file_lines",
    "shift-scan": "data_overview.shift_scan",
    "proposals": "proposals.proposals",
    "functions": "function.functions",
    "diagram": "imported.imported",
    "program": "imported.imported",
    "spellings": "function.spellings",
    "flow": "function.flow",
    "parts": "imported.parts",
    "formula-reads": "function.formula_reads",
    "function-file": "function_files.function_file",
    "called-functions": "function_files.called_functions",
    "completions": "function_files.completions",
    "surrogates": "surrogates.surrogates",
    "validity": "surrogates.validity",
    "formats": "exports.formats",
    "export": "exports.export",
    "open-file": "exports.open_file",
    "control-unit": "control_unit.control_unit",
    "rounding": "control_unit.rounding",
    "finer-storage": "control_unit.finer_storage",
    "code": "control_unit.code",
    "write-unit": "control_unit.write_unit",
    "designs": "design.designs",
    "design-map": "design.design_map",
    "export-design": "design.export_design",
    "missing": "missing.missing",
    "term": "missing.term",
    "calibrations": "calibrations.calibrations",
    "contents": "calibrations.contents",
    "differences": "calibrations.differences",
    "pair": "calibrations.pair",
    "write-calibration": "calibrations.write_calibration",
}
_COMMANDS: dict[str, str] = {  # these change the state, which is then sent to all pages
    "set-values": "parameters.set_values",
    "choose-reference": "parameters.choose_reference",
    "lock-values": "parameters.lock_values",
    "pin-values": "parameters.pin_values",
    "set-keys": "settings.set_keys",
    "set-toml": "settings.set_toml",
    "apply-fix": "fixes.apply_fix",
    "set-text": "settings.set_text",
    "choose-function": "function.choose_function",
    "reread-function": "function.reread_function",
    "new-function": "function.new_function",
    "convert-function": "function.convert_function",
    "allow-code": "function.allow_code",
    "add-functions": "function_files.add_functions",
    "new-surrogate": "surrogates.new_surrogate",
    "train-surrogate": "surrogates.train_surrogate",
    "stop-training": "surrogates.stop_training",
    "save": "settings.save",
    "reload": "settings.reload",
    "discard": "settings.discard",
    "recover": "settings.recover",
    "undo": "history.undo",
    "redo": "history.redo",
    "run": "runs.run",
    "stop": "runs.stop",
    "accept": "comparison.accept",
    "add-proposals": "proposals.add_proposals",
    "add-files": "additions.add_files",
    "take-values": "calibrations.take_values",
    "set-storage": "control_unit.set_storage",
    "propose-design": "design.propose_design",
    "stop-design": "design.stop_design",
    "look": "missing.look",
    "stop-looking": "missing.stop_looking",
    "apply-term": "missing.apply",
}


class _LoadedWhenAsked(Mapping[str, "Question[Session]"]):
    """Questions by their names on the wire.

    Args:
        functions: by name, the module of this package and its function that answers.
    """

    def __init__(self, functions: Mapping[str, str]) -> None:
        self._functions = functions
        self._loaded: dict[str, Question[Session]] = {}

    def __getitem__(self, name: str) -> "Question[Session]":
        if name not in self._loaded:
            module, _, function = self._functions[name].partition(".")
            self._loaded[name] = Question(name, getattr(import_module(f"{__name__}.{module}"), function))
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._functions)

    def __len__(self) -> int:
        return len(self._functions)


QUESTIONS = _LoadedWhenAsked(_QUESTIONS)
COMMANDS = _LoadedWhenAsked(_COMMANDS)
