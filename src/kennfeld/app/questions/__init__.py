"""Questions of a page. A new one is a function in the module of its screen, and a line here."""

from collections.abc import Callable

from kennfeld.app.answer import Answer, Given
from kennfeld.app.questions import (
    additions,
    calibrations,
    error_split,
    evidence,
    exports,
    history,
    parameters,
    plots,
    recordings,
    runs,
    schema,
    settings,
    signals,
    trust,
)
from kennfeld.app.session.session import Session

Question = Callable[[Session, Given], Answer]

QUESTIONS: dict[str, Question] = {
    "table": parameters.table,
    "strip": plots.strip_chart,
    "statistics": plots.stretch_statistics,
    "cursor": plots.cursor,
    "scatter": plots.scatter,
    "points": plots.points,
    "signals": signals.signals,
    "informing": evidence.informing,
    "passed": evidence.passed,
    "conditions": evidence.conditions,
    "coverage": evidence.coverage,
    "split": error_split.split,
    "worst": error_split.worst,
    "progress": runs.progress,
    "outcome": runs.outcome,
    "compare": runs.compare,
    "choice": runs.choice,
    "trust": trust.trust,
    "pinned": trust.pinned,
    "settings": settings.settings,
    "schema": schema.schema,
    "names": schema.names,
    "files": recordings.files,
    "proposals": recordings.proposals,
    "formats": exports.formats,
    "export": exports.export,
    "calibrations": calibrations.calibrations,
    "contents": calibrations.contents,
    "differences": calibrations.differences,
    "pair": calibrations.pair,
    "write-calibration": calibrations.write_calibration,
}
COMMANDS: dict[str, Question] = {  # these change the state, which all pages are told
    "set-values": parameters.set_values,
    "set-keys": settings.set_keys,
    "set-toml": settings.set_toml,
    "set-text": settings.set_text,
    "save": settings.save,
    "reload": settings.reload,
    "recover": settings.recover,
    "undo": history.undo,
    "redo": history.redo,
    "run": runs.run,
    "stop": runs.stop,
    "accept": runs.accept,
    "add-files": additions.add_files,
    "take-values": calibrations.take_values,
}
