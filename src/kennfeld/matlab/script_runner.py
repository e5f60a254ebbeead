"""Follows parameter scripts: assignments, decisions, loops, functions, and the files that they load or call.

What a script does besides, such as plots and messages, is told once and passed over; a variable that would get its
value from what is not known is undefined from there on, and whatever needs it says so.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.assignment import assign
from kennfeld.matlab.errors import Budget, LimitError, MatlabError, located
from kennfeld.matlab.evaluator import HostFunction, NumericEvaluator, access_chain
from kennfeld.matlab.functions.reductions import matches_case
from kennfeld.matlab.parser import parse_leniently
from kennfeld.matlab.printer import format_expression
from kennfeld.matlab.simulink_objects import enumeration
from kennfeld.matlab.values import (
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    characters,
    class_name,
    elements_of,
    from_python,
    nested_size,
    object_array,
    scalar,
    text,
)

__all__ = ["Files", "run_script"]

Files = Callable[[str], "bytes | str | Mapping[str, Any] | None"]
_TAKING_ALL = ("is never closed", "deep")  # findings of what takes the rest of a script with it
_COST_OF_FAILURE = 100  # steps: to tell it takes longer than a statement
_MOST_WITHIN, _DEEPEST = 1_000_000, 40  # values within a struct or a cell array
_SILENT = frozenset(
    {"clc", "close", "format", "more", "warning", "tic", "drawnow", "pause", "rng", "hold", "keyboard", "dbstop"}
)
_IDLE = frozenset(
    {"figure", "plot", "plot3", "surf", "mesh", "contour", "subplot", "xlabel", "ylabel", "zlabel", "title", "legend"}
    | {"grid", "axis", "disp", "display", "fprintf", "set_param", "sim", "open_system", "load_system", "addpath"}
    | {"rmpath", "save", "save_system", "close_system", "print", "set", "saveas", "xlim", "ylim", "zlim", "colorbar"}
    | {"colormap", "shading", "view", "bdclose", "mkdir", "delete", "cd", "beep", "waitbar", "msgbox", "errordlg"}
    | {"bar", "semilogx", "semilogy", "loglog", "line", "text", "sgtitle", "clf", "cla", "mfilename", "toc", "dbstack"}
)


@dataclass(frozen=True)
class ScriptResult:
    """What a script leaves: its variables, and what there is to say.

    `comments` are those behind the last value of a variable, or of a field of it (`Map.x`); `lines` tell where each
    variable begins, `undefined` why others have no value. A finding is an error where the script ends early.
    """

    variables: dict[str, Value]
    findings: tuple[Finding, ...]
    comments: dict[str, str] = field(default_factory=dict)
    undefined: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)


def run_script(
    text: str,
    name: str = "script.m",
    variables: Mapping[str, Any] | None = None,
    files: Files | None = None,
    functions: Mapping[str, HostFunction] | None = None,
    budget: Budget | None = None,
) -> ScriptResult:
    """The variables that a parameter script makes, beginning with some that are there already.

    `files` gives the content of a file that the script loads or calls: the text of `x.m`, the bytes or the variables
    of `x.mat`, None where there is none. What is wrong is a finding, with its line; nothing is raised.

    >>> run_script("K = 2; Map.z = K*[1 2; 3 4];").variables["Map"].fields["z"].tolist()
    [[2.0, 4.0], [6.0, 8.0]]
    """
    shared = _ScriptSession(files or (lambda _: None), budget or Budget())
    known = {key: from_python(given) for key, given in (variables or {}).items()}
    runner = _ScriptRunner(known, functions or {}, shared, name)
    try:
        runner.script(text)
    except _StopError:
        pass
    except (LimitError, RecursionError) as error:
        said = str(error) if isinstance(error, LimitError) else "functions and blocks are nested too deep"
        shared.tell(located(name, runner.place), f"{said}; the rest is left aside", "", "error")
    undefined = {key: why for key, why in runner.undefined.items() if key not in runner.variables}
    return ScriptResult(runner.variables, tuple(shared.findings.values()), runner.comments, undefined, runner.lines)


@dataclass
class _ScriptSession:
    """What a script and all that it calls have in common."""

    files: Files
    budget: Budget
    findings: dict[object, Finding] = field(default_factory=dict)
    globals: dict[str, Value] = field(default_factory=dict)
    scripts: list[str] = field(default_factory=list)
    parsed: dict[str, m.Script | None] = field(default_factory=dict)

    def tell(self, place: str, message: str, remedy: str = "", severity: Any = "warning", once: str = "") -> None:
        self.findings.setdefault(once or (place, message), Finding(place, message, remedy, "", severity))


class _JumpError(Exception):
    """break, continue or return."""

    def __init__(self, kind: str) -> None:
        self.kind = kind


class _StopError(Exception):
    """The script ends itself by an error; the finding is told."""


class _ScriptRunner(NumericEvaluator):
    """Runs the statements of one script or function."""

    def __init__(
        self, variables: dict[str, Value], functions: Mapping[str, HostFunction], shared: _ScriptSession, name: str
    ) -> None:
        super().__init__(variables, functions, shared.budget, name)
        self.shared = shared
        self.local: dict[str, m.FunctionDefinition] = {}
        self.comments: dict[str, str] = {}
        self.lines: dict[str, int] = {}
        self.globals: set[str] = set()
        self.place = m.SourcePosition()
        self.trying = 0

    def script(self, content: str) -> None:
        """Run a text in the variables of this runner."""
        tree, findings = parse_leniently(content, self.name)
        for finding in findings:
            is_open = finding.message.endswith(_TAKING_ALL)
            told = finding if is_open else replace(finding, severity="warning")
            self.shared.findings.setdefault((finding.place, finding.message), told)
        self.local |= {function.name: function for function in tree.functions}
        try:
            if not tree.statements and tree.functions:
                self._alone(tree.functions[0])
            self.body(tree.statements)
        except _JumpError:
            return

    def _alone(self, function: m.FunctionDefinition) -> None:
        """A file of functions: what its first one makes without arguments."""
        if not function.parameters:
            self.body(function.body)

    def body(self, statements: Sequence[m.Statement]) -> None:
        """Run statements; one without a value is told, and what it assigns is undefined."""
        for statement in statements:
            self.budget.step()
            self.place = statement.place
            try:
                self._run_one(statement)
            except (MatlabError, MatlabValueError) as error:
                if self.trying:
                    raise
                self._failed(statement, error)

    def _failed(self, statement: m.Statement, error: MatlabError | MatlabValueError) -> None:
        self.budget.step(_COST_OF_FAILURE)
        if isinstance(error, MatlabValueError):
            error = MatlabError.at(self.name, statement.place, str(error))
        line = f"{self.name} line {statement.place.line}"
        lost = sorted(_assigned(statement))
        for finding in error.findings:
            message = finding.message + (f"; {', '.join(lost[:5])} stays undefined" if lost else "")
            self.shared.tell(finding.place, message, finding.remedy)
        self.forget(lost, f"{line} gives it no value")

    def forget(self, names: Iterable[str], why: str) -> None:
        """Variables lose their value."""
        for name in names:
            self.variables.pop(name, None)
            self.undefined[name] = why

    def _run_one(self, statement: m.Statement) -> None:
        match statement:
            case m.Assign():
                self._assign(statement)
            case m.Evaluate():
                self._evaluate(statement)
            case m.Command():
                self._command(statement.name, [word.strip("'\"") for word in statement.words], statement.place)
            case m.If():
                self._if(statement)
            case m.For():
                self._for(statement)
            case m.While():
                while self.holds(statement.condition):
                    if self._looped(statement.body):
                        break
            case m.Switch():
                self._switch(statement)
            case m.Try():
                self._try(statement)
            case m.Jump():
                raise _JumpError(statement.kind)
            case m.Declaration():
                self._declare(statement)

    def _assign(self, statement: m.Assign) -> None:
        found = self.values(statement.value, len(statement.targets))
        if not found or (len(found) < len(statement.targets)):
            raise MatlabError.at(self.name, statement.value.place, "this has no value for each target")
        for target, value in zip(statement.targets, found, strict=False):
            if target is not None:
                self._store(target, value, statement)

    def _store(self, target: m.Expression, value: Value, statement: m.Assign | m.For) -> None:
        try:
            name = assign(self, target, value)
        except MatlabValueError as error:
            raise MatlabError.at(self.name, target.place, str(error)) from None
        count, depth = nested_size(self.variables[name])
        if count > _MOST_WITHIN or depth > _DEEPEST:
            self.variables.pop(name)
            raise LimitError(f"{name} holds more values within others than a script needs")
        self.undefined.pop(name, None)
        if name in self.globals:
            self.shared.globals[name] = self.variables[name]
        self.lines.setdefault(name, statement.place.line)
        if isinstance(target, m.Name):
            self.comments = {key: said for key, said in self.comments.items() if key.partition(".")[0] != name}
        if isinstance(target, m.Name | m.Field) and isinstance(statement, m.Assign) and statement.comment:
            self.comments[format_expression(target)] = statement.comment

    def _evaluate(self, statement: m.Evaluate) -> None:
        base, steps = access_chain(statement.expression)
        if isinstance(base, m.Name) and base.name not in self.variables and base.name not in self.undefined:
            given = steps[0] if steps else None
            if base.name in _SILENT:
                return
            if base.name in _IDLE and not self._is_own(base.name):
                self._passed(base.name, statement.place)
                return
            if base.name in _STATEMENTS:
                arguments = self.indices(given.arguments, scalar(0)) if isinstance(given, m.Call) else []
                _STATEMENTS[base.name](self, arguments, statement.place)
                return
            if not steps and self._script_beside(base.name):
                return
            if base.name == "Simulink" and self._defines(steps, statement):
                return
        self.values(statement.expression, 0)

    def _defines(self, steps: Sequence[m.Expression], statement: m.Evaluate) -> bool:
        """Whether a statement defines an enumeration, which is then a struct of its members."""
        first, second = steps if len(steps) == 2 else (None, None)
        if not isinstance(first, m.Field) or first.name != "defineIntEnumType" or not isinstance(second, m.Call):
            return False
        try:
            name, made = enumeration(self._arguments(second.arguments))
        except MatlabValueError as error:
            raise MatlabError.at(self.name, statement.place, f"Simulink.defineIntEnumType: {error}") from None
        self.variables[name] = made
        self.undefined.pop(name, None)
        self.lines.setdefault(name, statement.place.line)
        return True

    def _is_own(self, name: str) -> bool:
        return name in self.functions or name in self.local

    def _passed(self, name: str, place: m.SourcePosition) -> None:
        self.shared.tell(f"{self.name} line {place.line}", f"{name} is passed over", "", "remark", f"passed {name}")

    def _command(self, name: str, words: Sequence[str], place: m.SourcePosition) -> None:
        if name in _SILENT:
            return
        if name in _STATEMENTS:
            _STATEMENTS[name](self, [characters(word) for word in words], place)
        elif self._is_own(name):
            self.call(name, [characters(word) for word in words], 0, place)
        else:
            self._passed(name, place)

    def _if(self, statement: m.If) -> None:
        for branch in statement.branches:
            if self.holds(branch.condition):
                self.body(branch.body)
                return
        self.body(statement.otherwise)

    def _for(self, statement: m.For) -> None:
        values = self.value(statement.values)
        data = elements_of(values)
        columns = data.reshape(data.shape[0], -1, order="F") if data.size else data.reshape(0, 0)
        for at in range(columns.shape[1]):
            self.budget.step()
            self._store(statement.target, _column(values, columns[:, at : at + 1]), statement)
            if self._looped(statement.body):
                break

    def _looped(self, body: Sequence[m.Statement]) -> bool:
        """Run the body of a loop once; whether it ends the loop."""
        self.budget.step()
        try:
            self.body(body)
        except _JumpError as jump:
            if jump.kind == "return":
                raise
            return jump.kind == "break"
        return False

    def _switch(self, statement: m.Switch) -> None:
        subject = self.value(statement.subject)
        for case in statement.cases:
            if matches_case(subject, self.value(case.condition)):
                self.body(case.body)
                return
        self.body(statement.otherwise)

    def _try(self, statement: m.Try) -> None:
        self.trying += 1
        try:
            self.body(statement.body)
        except (MatlabError, MatlabValueError, _StopError) as error:
            self.trying -= 1
            if statement.name:
                said = characters(str(error))
                self.variables[statement.name] = MatlabStruct.of({"message": said, "identifier": characters("")})
            self.body(statement.handler)
        else:
            self.trying -= 1

    def _declare(self, statement: m.Declaration) -> None:
        for name in statement.names:
            if statement.kind == "global":
                self.globals.add(name)
                self.variables[name] = self.shared.globals.setdefault(name, self.variables.get(name, np.zeros((0, 0))))
            else:
                self.variables.setdefault(name, np.zeros((0, 0)))

    def knows(self, name: str) -> bool:
        return name in self.local or name in _VALUED or super().knows(name) or self._function_beside(name) is not None

    def call(self, name: str, arguments: Sequence[Value], outputs: int, place: m.SourcePosition) -> list[Value]:
        if name in self.functions:
            return super().call(name, arguments, outputs, place)
        if name in self.local:
            return self._invoke(self.local[name], self.local, self.name, arguments, outputs)
        if name in _VALUED:
            return [_VALUED[name](self, arguments, place)]
        if not super().knows(name) and (beside := self._function_beside(name)) is not None:
            local = {function.name: function for function in beside.functions}
            return self._invoke(beside.functions[0], local, f"{name}.m", arguments, outputs)
        return super().call(name, arguments, outputs, place)

    def _function_beside(self, name: str) -> m.Script | None:
        """The functions of the file that is called like a function."""
        if name not in self.shared.parsed:
            content = self.shared.files(f"{name}.m")
            tree = parse_leniently(_decoded(content), f"{name}.m")[0] if isinstance(content, bytes | str) else None
            self.shared.parsed[name] = tree if tree is not None and tree.functions and not tree.statements else None
        return self.shared.parsed[name]

    def _invoke(
        self,
        function: m.FunctionDefinition,
        local: dict[str, m.FunctionDefinition],
        name: str,
        arguments: Sequence[Value],
        outputs: int,
    ) -> list[Value]:
        """Call a function that is written in MATLAB."""
        with self.deeper():
            runner = _ScriptRunner(_parameters(function, arguments), self.functions, self.shared, name)
            runner.local = local
            runner.trying = self.trying
            runner.variables |= {"nargin": scalar(len(arguments)), "nargout": scalar(outputs)}
            with suppress(_JumpError):
                runner.body(function.body)
        return runner.results(function, outputs)

    def results(self, function: m.FunctionDefinition, outputs: int) -> list[Value]:
        """The values of a function that has run."""
        found: list[Value] = []
        for name in function.results:
            if name == "varargout" and isinstance(rest := self.variables.get(name), MatlabCell):
                found += list(rest.values.ravel(order="F"))
            elif name in self.variables:
                found.append(self.variables[name])
            elif len(found) < max(outputs, 1) and (outputs or name in self.undefined):
                why = self.undefined.get(name, "nothing is assigned to it")
                raise MatlabValueError(f"{function.name} gives {name} no value: {why}")
            else:
                break
        return found[: max(outputs, 1)]

    def inner(self, variables: dict[str, Value]) -> "_ScriptRunner":
        runner = _ScriptRunner(variables, self.functions, self.shared, self.name)
        runner.local = self.local
        runner.trying = self.trying
        return runner

    def _script_beside(self, name: str) -> bool:
        """Run the script that is called like this, if there is one."""
        content = None if super().knows(name) or name in self.local else self.shared.files(f"{name}.m")
        if not isinstance(content, bytes | str) or self._function_beside(name) is not None:
            return False
        self.follow(f"{name}.m", _decoded(content))
        return True

    def follow(self, name: str, content: str) -> None:
        """Run another script in the same variables."""
        if name in self.shared.scripts or name == self.name:
            raise MatlabValueError(f"{name} calls itself")
        before, local, place = self.name, self.local, self.place
        self.shared.scripts.append(name)
        self.name, self.local = name, {}
        try:
            with self.deeper():
                self.script(content)
        finally:
            self.shared.scripts.pop()
            self.name, self.local, self.place = before, local, place

    def loaded(self, arguments: Sequence[Value], place: m.SourcePosition) -> dict[str, Value]:
        """The variables of a data file, those asked for."""
        words = [text(value) for value in arguments]
        words = [word for word in words if not word.startswith("-")]
        if not words:
            raise MatlabValueError("load needs the name of a file")
        asked = words[0] if words[0].casefold().endswith(".mat") else f"{words[0]}.mat"
        found = self._content(asked)
        missing = [word for word in words[1:] if word not in found and "*" not in word]
        if missing:
            raise MatlabValueError(f"{asked} holds no {missing[0]}")
        return {name: value for name, value in found.items() if len(words) == 1 or name in words}

    def _content(self, asked: str) -> dict[str, Value]:
        content = self.shared.files(asked)
        if content is None:
            raise MatlabValueError(f"{asked} is not there")
        if isinstance(content, Mapping):
            return {name: from_python(value) for name, value in content.items()}
        if isinstance(content, str):
            raise MatlabValueError(f"{asked} is no data file")
        from kennfeld.matlab.mat_reader import load_variables

        try:
            return load_variables(content, asked)
        except InputError as error:
            raise MatlabValueError(f"{asked}: {error.findings[0].message}") from None


def _decoded(content: bytes | str) -> str:
    if isinstance(content, str):
        return content
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _column(values: Value, column: Any) -> Value:
    if isinstance(values, MatlabCell):
        return MatlabCell(column)
    return MatlabStruct(column, values.names, values.kind) if isinstance(values, MatlabStruct) else column.copy()


def _parameters(function: m.FunctionDefinition, arguments: Sequence[Value]) -> dict[str, Value]:
    names, given = list(function.parameters), list(arguments)
    if names and names[-1] == "varargin":
        rest = given[len(names) - 1 :]
        given = [*given[: len(names) - 1], MatlabCell(object_array(rest, (1, len(rest))))]
    if len(given) > len(names):
        raise MatlabValueError(f"{function.name} takes {len(names)} arguments, not {len(given)}")
    return {name: value for name, value in zip(names, given, strict=False) if name != "~"}


def _assigned(statement: m.Statement) -> set[str]:
    """The variables that a statement would change."""
    match statement:
        case m.Assign():
            return {name for target in statement.targets if target is not None and (name := _base(target))}
        case m.For():
            return {_base(statement.target), *_assigned_in(statement.body)}
        case m.While():
            return _assigned_in(statement.body)
        case m.If():
            return _assigned_in(statement.otherwise).union(*(_assigned_in(one.body) for one in statement.branches))
        case m.Switch():
            return _assigned_in(statement.otherwise).union(*(_assigned_in(one.body) for one in statement.cases))
        case m.Try():
            return _assigned_in(statement.body) | _assigned_in(statement.handler)
    return set()


def _assigned_in(body: Sequence[m.Statement]) -> set[str]:
    return set().union(*(_assigned(one) for one in body))


def _base(target: m.Expression) -> str:
    base = access_chain(target)[0]
    return base.name if isinstance(base, m.Name) else ""


def _load(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    found = runner.loaded(arguments, place)
    runner.variables |= found
    runner.owned.clear()
    for name in found:
        runner.undefined.pop(name, None)


def _run(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    name = text(arguments[0]) if arguments else ""
    name = name if name.casefold().endswith(".m") else f"{name}.m"
    content = runner.shared.files(name)
    if not isinstance(content, bytes | str):
        raise MatlabValueError(f"{name} is not there")
    runner.follow(name, _decoded(content))


def _clear(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    """Named variables go; to clear all would take away what other files gave."""
    for word in (text(value) for value in arguments):
        runner.variables.pop(word, None)
        runner.undefined.pop(word, None)


def _error(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    said = text(arguments[0])[:200] if arguments and class_name(arguments[0]) in ("char", "string") else "an error"
    if not runner.trying:
        runner.shared.tell(f"{runner.name} line {place.line}", f"the script stops: {said}", "", "error")
    raise _StopError(said)


def _assert(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    if arguments and not all(np.asarray(elements_of(arguments[0])).ravel()):
        _error(runner, arguments[1:], place)


def _assignin(runner: _ScriptRunner, arguments: Sequence[Any], place: m.SourcePosition) -> None:
    if len(arguments) != 3:
        raise MatlabValueError("assignin takes a workspace, a name and a value")
    runner.variables[text(arguments[1])] = arguments[2]


_STATEMENTS: dict[str, Callable[[_ScriptRunner, Sequence[Any], m.SourcePosition], None]] = {
    "load": _load,
    "run": _run,
    "clear": _clear,
    "clearvars": _clear,
    "error": _error,
    "assert": _assert,
    "assignin": _assignin,
}


def _loaded(runner: _ScriptRunner, arguments: Sequence[Value], place: m.SourcePosition) -> Value:
    return MatlabStruct.of(runner.loaded(arguments, place))


_VALUED: dict[str, Callable[[_ScriptRunner, Sequence[Value], m.SourcePosition], Value]] = {"load": _loaded}
