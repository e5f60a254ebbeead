"""Questions of a page. A new one is a function in the module of its screen, and a line here."""

from collections.abc import Callable

from kennfeld.app.answer import Answer, Given
from kennfeld.app.questions import (
    error_split,
    evidence,
    exports,
    function,
    history,
    parameters,
    plots,
    recordings,
    runs,
    settings,
    surrogates,
)
from kennfeld.app.session.session import Session

Question = Callable[[Session, Given], Answer]

QUESTIONS: dict[str, Question] = {
    "table": parameters.table,
    "strip": plots.strip_chart,
    "statistics": plots.stretch_statistics,
    "scatter": plots.scatter,
    "informing": evidence.informing,
    "passed": evidence.passed,
    "split": error_split.split,
    "worst": error_split.worst,
    "progress": runs.progress,
    "compare": runs.compare,
    "trust": runs.trust,
    "settings": settings.settings,
    "files": recordings.files,
    "proposals": recordings.proposals,
    "functions": function.functions,
    "diagram": function.diagram,
    "spellings": function.spellings,
    "flow": function.flow,
    "parts": function.parts,
    "formula-reads": function.formula_reads,
    "surrogates": surrogates.surrogates,
    "validity": surrogates.validity,
    "formats": exports.formats,
    "export": exports.export,
}
COMMANDS: dict[str, Question] = {  # these change the state, which all pages are told
    "set-values": parameters.set_values,
    "set-keys": settings.set_keys,
    "set-text": settings.set_text,
    "choose-function": function.choose_function,
    "reread-function": function.reread_function,
    "new-function": function.new_function,
    "convert-function": function.convert_function,
    "new-surrogate": surrogates.new_surrogate,
    "train-surrogate": surrogates.train_surrogate,
    "stop-training": surrogates.stop_training,
    "save": settings.save,
    "reload": settings.reload,
    "recover": settings.recover,
    "undo": history.undo,
    "redo": history.redo,
    "run": runs.run,
    "stop": runs.stop,
    "accept": runs.accept,
}
