"""Run parameter scripts: assignments, decisions, loops, functions, and the files that they load or call.

Calls without a value, such as plots and messages, are skipped and reported once. A variable whose value depends on
something unknown becomes undefined; whatever reads it reports the reason.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace
from typing import Any

import numpy as np

from kennfeld.base.errors import Finding, Location, Severity
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab import values as v
from kennfeld.matlab.assignment import assign, without_field
from kennfeld.matlab.errors import Budget, LimitError, MatlabError, failed_assignment
from kennfeld.matlab.evaluator import HostFunction, NumericEvaluator
from kennfeld.matlab.functions.reductions import matches_case
from kennfeld.matlab.parser import parse_leniently
from kennfeld.matlab.printer import format_expression
from kennfeld.matlab.script_files import Files, ScriptFiles
from kennfeld.matlab.simulink_objects import define_enumeration
from kennfeld.matlab.simulink_types import buses_of_cells
from kennfeld.program import tree as m
from kennfeld.program.traversal import access_chain, assigned_path, paths_assigned

_UNCLOSED = ("is never closed", "deep")  # findings after which the rest of the script is lost
_FAILURE_STEPS = 100  # reporting takes longer than a statement
_MAX_NESTED, _MAX_DEPTH = 1_000_000, 40  # values in a struct or a cell array
_SKIPPED_SILENTLY = frozenset(
    {"clc", "close", "format", "more", "warning", "tic", "drawnow", "pause", "rng", "hold", "keyboard", "dbstop"}
)
_SKIPPED = frozenset(
    {"figure", "plot", "plot3", "surf", "mesh", "contour", "subplot", "xlabel", "ylabel", "zlabel", "title", "legend"}
    | {"grid", "axis", "disp", "display", "fprintf", "set_param", "sim", "open_system", "load_system", "addpath"}
    | {"rmpath", "save", "save_system", "close_system", "print", "set", "saveas", "xlim", "ylim", "zlim", "colorbar"}
    | {"colormap", "shading", "view", "bdclose", "mkdir", "delete", "cd", "beep", "waitbar", "msgbox", "errordlg"}
    | {"bar", "semilogx", "semilogy", "loglog", "line", "text", "sgtitle", "clf", "cla", "mfilename", "toc", "dbstack"}
)


@dataclass(frozen=True)
class ScriptResult:
    """The variables that a script leaves, and the findings on it.

    `comments` are those behind the last assignment to a variable or to a field of it (`Map.x`), `lines` the first line
    that assigns each variable, `undefined` where the assignment of others failed, `missing_files` the files that it
    loads or runs and that do not exist. A finding is an error if the script ends early.
    """

    variables: dict[str, v.Value]
    findings: tuple[Finding, ...]
    comments: dict[str, str] = field(default_factory=dict)
    undefined: dict[str, Location] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    missing_files: tuple[str, ...] = ()


def run_script(
    text: str,
    name: str = "script.m",
    variables: Mapping[str, Any] | None = None,
    files: Files | None = None,
    functions: Mapping[str, HostFunction] | None = None,
    budget: Budget | None = None,
) -> ScriptResult:
    """Run a parameter script.

    Args:
        text: The script.
        name: Its name in findings.
        variables: Initial variables, as MATLAB or Python values.
        files: Returns the content of a file by its name: the text of `x.m`, the bytes or the variables of `x.mat`,
            None if there is none.
        functions: Functions that the script may call, by name.
        budget: Limits of steps, array elements and nested calls.

    Returns:
        The variables and findings. Problems of the script are findings with their line; none is raised.

    Example:
        >>> run_script("K = 2; Map.z = K*[1 2; 3 4];").variables["Map"].fields["z"].tolist()
        [[2.0, 4.0], [6.0, 8.0]]
    """
    shared = _ScriptSession(ScriptFiles(files or (lambda _: None)), budget or Budget())
    initial = {key: v.from_python(value) for key, value in (variables or {}).items()}
    runner = _ScriptRunner(initial, functions or {}, shared, name)
    try:
        runner.script(text)
    except _StopError:
        pass
    except (LimitError, RecursionError) as error:
        reason = str(error) if isinstance(error, LimitError) else "functions and blocks are nested too deeply"
        location = Location(name, runner.place.line, column=runner.place.column)
        shared.report(location, f"{reason}; the rest of the script is skipped", "", "error")
    undefined = {key: why for key, why in runner.undefined.items() if key not in runner.variables}
    findings, missing = tuple(shared.findings.values()), tuple(shared.files.missing)
    comments = {target: text for own in runner.comments.values() for target, text in own.items()}
    return ScriptResult(runner.variables, findings, comments, undefined, runner.lines, missing)


@dataclass
class _ScriptSession:
    """The state that a script shares with everything it calls."""

    files: ScriptFiles
    budget: Budget
    findings: dict[object, Finding] = field(default_factory=dict)
    kept: dict[str, v.Value] = field(default_factory=dict)  # of global and persistent variables
    scripts: list[str] = field(default_factory=list)

    def report(
        self, location: Location, message: str, remedy: str = "", severity: Severity = "warning", once: str = ""
    ) -> None:
        """Add a finding, unless it or another one with the key `once` is known."""
        self.findings.setdefault(
            once or (str(location), message), Finding(location, message, remedy, severity=severity)
        )


class _JumpError(Exception):
    """break, continue or return."""

    def __init__(self, kind: str) -> None:
        self.kind = kind


class _StopError(Exception):
    """The script stopped with an error, which has been reported."""


class _ScriptRunner(NumericEvaluator):
    """Runs the statements of one script or function."""

    def __init__(
        self, variables: dict[str, v.Value], functions: Mapping[str, HostFunction], shared: _ScriptSession, name: str
    ) -> None:
        super().__init__(variables, functions, shared.budget, name)
        self.shared = shared
        self.caller: _ScriptRunner | None = None
        self.local: dict[str, m.FunctionDefinition] = {}
        self.comments: dict[str, dict[str, str]] = {}  # by variable, on itself and on its fields
        self.lines: dict[str, int] = {}
        self.function = ""  # that runs; empty in a script
        self.kept: dict[str, str] = {}  # variables that outlast the call, with their keys in the session
        self.place = m.TextPosition()
        self.trying = 0

    def script(self, content: str) -> None:
        """Run a script in the variables of this runner."""
        tree, findings = parse_leniently(content, self.name)
        for finding in findings:
            is_open = finding.message.endswith(_UNCLOSED)
            # an invalid statement costs its own variables only
            reported = finding if is_open else replace(finding, severity="warning")
            self.shared.findings.setdefault((str(finding.location), finding.message), reported)
        self.local |= {function.name: function for function in tree.functions}
        try:
            if not tree.statements and tree.functions:
                first = tree.functions[0]  # of a file of functions
                # as MATLAB runs a file of functions; one with parameters can only be called
                if first.parameters == ("varargin",):
                    self.call(first.name, (), 0, self.place)
                self.body(() if first.parameters else first.body)
            self.body(tree.statements)
        except _JumpError:
            return

    def body(self, statements: Sequence[m.Statement]) -> None:
        """Run statements; a failure is reported, and the variables that the statement assigns become undefined."""
        for statement in statements:
            self.budget.step()
            self.place = statement.place
            try:
                self._run_statement(statement)
            except (MatlabError, v.MatlabValueError) as error:
                # within `try` the handler deals with the failure
                if self.trying:
                    raise
                self._report_failure(statement, error)

    def _report_failure(self, statement: m.Statement, error: MatlabError | v.MatlabValueError) -> None:
        self.budget.step(_FAILURE_STEPS)
        if isinstance(error, v.MatlabValueError):
            error = MatlabError.at(self.name, statement.place, str(error))
        lost = sorted(paths_assigned(statement))
        for finding in error.findings:
            message = finding.message + (f"; {', '.join(lost[:5])} remains undefined" if lost else "")
            self.shared.report(finding.location, message, finding.remedy)
        self.forget(lost, Location(self.name, statement.place.line))

    def forget(self, paths: Iterable[str], place: Location) -> None:
        """Remove the values of variables and of fields whose assignment failed; other fields of a struct stay."""
        for path in paths:
            name, *fields = path.split(".")
            rest = without_field(self.variables.get(name), fields) if fields else None
            if rest is not None:
                self.variables[name] = rest
            elif not fields:
                self.variables.pop(name, None)
            self.undefined[path] = place

    def define(self, path: str) -> None:
        """Record that a variable or field has a value again, and so do the fields in it."""
        for known in [key for key in self.undefined if key == path or key.startswith(f"{path}.")]:
            del self.undefined[known]

    def _run_statement(self, statement: m.Statement) -> None:
        match statement:
            case m.Assign():
                self._assign(statement)
            case m.Evaluate():
                self._evaluate(statement)
            case m.Command():
                self._command(statement.name, [word.strip("'\"") for word in statement.words], statement.place)
            # branches are tried one by one: conditions behind the one that holds are not evaluated
            case m.If():
                chosen = (branch.body for branch in statement.branches if self.is_true(branch.condition))
                self.body(next(chosen, statement.otherwise))
            case m.For():
                self._for(statement)
            case m.While():
                while self.is_true(statement.condition):
                    if self._run_turn(statement.body):
                        break
            case m.Switch():
                subject = self.value(statement.subject)
                chosen = (case.body for case in statement.cases if matches_case(subject, self.value(case.condition)))
                self.body(next(chosen, statement.otherwise))
            case m.Try():
                self._try(statement)
            case m.Jump():
                raise _JumpError(statement.kind)
            case m.Declaration():
                self._declare(statement)

    def _assign(self, statement: m.Assign) -> None:
        targets = self._listed_targets(statement)
        values = self.values(statement.value, len(targets))
        if len(values) == 1:  # `p.a = 1` is not a list of targets, and an error for an array
            targets = statement.targets
        if not values or (len(values) < len(targets)):
            raise MatlabError.at(self.name, statement.value.place, "fewer values than targets")
        for target, value in zip(targets, values, strict=False):
            if target is not None:
                self._store(target, value, statement)

    def _listed_targets(self, statement: m.Assign) -> Sequence[m.Expression | None]:
        """Return the targets of an assignment; `[p.a] = ...` has one for each struct of an array."""
        result: list[m.Expression | None] = []
        for target in statement.targets:
            count = self._struct_count(target)
            if isinstance(target, m.Field) and count != 1:
                indices = (m.Number(at + 1.0) for at in range(count))
                result += [replace(target, of=m.Call(target.of, (index,), place=target.place)) for index in indices]
            else:
                result.append(target)
        return result

    def _struct_count(self, target: m.Expression | None) -> int:
        """Return the number of structs of the variable of which a target is a field; 1 for other targets."""
        holder = target.of if isinstance(target, m.Field) else None
        value = self.variables.get(holder.name) if isinstance(holder, m.Name) else None
        return value.elements.size if isinstance(value, v.MatlabStruct) else 1

    def _store(self, target: m.Expression, value: v.Value, statement: m.Statement) -> None:
        try:
            name = assign(self, target, value)
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, target.place, str(error)) from None
        # `s.a = s` in a loop makes structs deep, `s.a = s; s.b = s` doubles them at each turn
        count, depth = v.measure_nesting(self.variables[name])
        if count > _MAX_NESTED or depth > _MAX_DEPTH:
            self.variables.pop(name)
            raise LimitError(f"{name} contains too many nested values")
        if self.undefined:
            self.define(assigned_path(target))
        if name in self.kept:
            self.shared.kept[self.kept[name]] = self.variables[name]
        self.lines.setdefault(name, statement.place.line)
        # comments on fields of the value before
        if isinstance(target, m.Name):
            self.comments.pop(name, None)
        if isinstance(target, m.Name | m.Field) and isinstance(statement, m.Assign) and statement.comment:
            self.comments.setdefault(name, {})[format_expression(target)] = statement.comment

    def _evaluate(self, statement: m.Evaluate) -> None:
        base, steps = access_chain(statement.expression)
        # a variable hides a function of its name, also an undefined one: reading it reports the reason
        if isinstance(base, m.Name) and base.name not in self.variables and base.name not in self.undefined:
            call = steps[0] if steps else None
            if base.name in _SKIPPED_SILENTLY:
                return
            # a project may have a function of its own by the name of a plot or message
            if base.name in _SKIPPED and not self._is_user_function(base.name):
                self._skip(base.name, statement.place)
                return
            if base.name in _STATEMENTS:
                arguments = self.indices(call.arguments, v.scalar(0)) if isinstance(call, m.Call) else []
                _STATEMENTS[base.name](self, arguments, statement.place)
                return
            if not steps and self._run_script_file(base.name):
                return
            if not steps and not self.knows(base.name):
                self.shared.files.missing[f"{base.name}.m"] = None
            if base.name == "Simulink" and self._define_types(steps, statement):
                return
        self.values(statement.expression, 0)

    def _define_types(self, steps: Sequence[m.Expression], statement: m.Evaluate) -> bool:
        """Return True if a statement defines an enumeration or buses, which are variables of the base workspace."""
        path, call = [step.name for step in steps if isinstance(step, m.Field)], steps[-1] if steps else None
        define = _DEFINITIONS.get(".".join(path))
        if define is None or not isinstance(call, m.Call) or len(steps) != len(path) + 1:
            return False
        try:
            types = define(self.flat_values(call.arguments))
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, statement.place, f"Simulink.{'.'.join(path)}: {error}") from None
        for name, value in types.items():
            self.base()._store(m.Name(name), value, statement)
        return True

    def buses(self) -> Mapping[str, v.Value]:
        # buses of a function are variables of the base workspace
        return {**self.base().variables, **self.variables}

    def base(self) -> "_ScriptRunner":
        """Return the runner of the outermost script, whose variables are the base workspace."""
        return self if self.caller is None else self.caller.base()

    def _is_user_function(self, name: str) -> bool:
        return name in self.functions or name in self.local

    def _skip(self, name: str, place: m.TextPosition) -> None:
        self.shared.report(Location(self.name, place.line), f"{name} skipped", "", "remark", f"skipped {name}")

    def _command(self, name: str, words: Sequence[str], place: m.TextPosition) -> None:
        if name in _SKIPPED_SILENTLY:
            return
        if name in _STATEMENTS:
            _STATEMENTS[name](self, [v.characters(word) for word in words], place)
        elif self._is_user_function(name):
            self.call(name, [v.characters(word) for word in words], 0, place)
        else:
            self._skip(name, place)

    def _for(self, statement: m.For) -> None:
        values = self.value(statement.values)
        data = v.elements_of(values)
        # MATLAB loops over columns; further dimensions count as more of them
        count = int(np.prod(data.shape[1:]))
        columns = data.reshape(data.shape[0], count, order="F")
        if not count:  # the loop variable then is empty
            self._store(statement.target, v.with_class_of(values, columns), statement)
        for at in range(count):
            self.budget.step()
            self._store(statement.target, v.with_class_of(values, columns[:, at : at + 1].copy()), statement)
            if self._run_turn(statement.body):
                break

    def _run_turn(self, body: Sequence[m.Statement]) -> bool:
        """Run the body of a loop once; return True if it ends the loop."""
        self.budget.step()
        try:
            self.body(body)
        except _JumpError as jump:
            if jump.kind == "return":
                raise
            return jump.kind == "break"
        return False

    def _try(self, statement: m.Try) -> None:
        self.trying += 1
        try:
            self.body(statement.body)
            return
        # an exhausted budget (LimitError) is not caught: `try` in a loop must not go on for ever
        except (MatlabError, v.MatlabValueError, _StopError) as error:
            message = v.characters(str(error))
        finally:
            self.trying -= 1
        if statement.name:
            self.variables[statement.name] = v.MatlabStruct.of({"message": message, "identifier": v.characters("")})
        self.body(statement.handler)

    def _declare(self, statement: m.Declaration) -> None:
        for name in statement.names:
            # a persistent variable belongs to its function
            self.kept[name] = name if statement.kind == "global" else f"{self.name}/{self.function}/{name}"
            # a local variable of the name gives a new global one its value
            first = self.variables.get(name, np.zeros((0, 0)))
            self.variables[name] = self.shared.kept.setdefault(self.kept[name], first)

    def knows(self, name: str) -> bool:
        return name in self.local or name == "load" or super().knows(name) or bool(self.shared.files.functions(name))

    def call(self, name: str, arguments: Sequence[v.Value], outputs: int, place: m.TextPosition) -> list[v.Value]:
        if name in self.functions:
            return super().call(name, arguments, outputs, place)
        if name in self.local:
            function, local, file = self.local[name], self.local, self.name
        elif name == "load":
            return [v.MatlabStruct.of(self.shared.files.load(arguments))]
        # a file cannot replace a built-in function, a function of the same script can
        elif not super().knows(name) and (functions := self.shared.files.functions(name)):
            function, local, file = functions[0], {function.name: function for function in functions}, f"{name}.m"
        else:
            return super().call(name, arguments, outputs, place)
        with self.nested_call():
            runner = self.inner(_parameters(function, arguments))
            runner.name, runner.local, runner.function = file, local, function.name
            runner.variables |= {"nargin": v.scalar(len(arguments)), "nargout": v.scalar(outputs)}
            with suppress(_JumpError):
                runner.body(function.body)
        return runner.results(function, outputs)

    def results(self, function: m.FunctionDefinition, outputs: int) -> list[v.Value]:
        """Return the outputs of a function that has run."""
        values: list[v.Value] = []
        for name in function.results:
            if name == "varargout" and isinstance(rest := self.variables.get(name), v.MatlabCell):
                values += list(rest.values.ravel(order="F"))
            elif name in self.variables:
                values.append(self.variables[name])
            # called as a statement, a function need not assign its output; a failed assignment is reported all the same
            elif len(values) < max(outputs, 1) and (outputs or name in self.undefined):
                place = self.undefined.get(name)
                why = "no assignment was reached" if place is None else failed_assignment(place)
                raise v.MatlabValueError(f"{function.name} does not assign its output {name}: {why}")
            else:
                break
        return values[: max(outputs, 1)]

    def inner(self, variables: dict[str, v.Value]) -> "_ScriptRunner":
        runner = _ScriptRunner(variables, self.functions, self.shared, self.name)
        runner.local, runner.caller = self.local, self
        # a failure in a function reaches the `try` of its caller
        runner.trying = self.trying
        return runner

    def _run_script_file(self, name: str) -> bool:
        """Run the script of this name, if there is one."""
        content = None if super().knows(name) or name in self.local else self.shared.files.text(f"{name}.m")
        if content is None or self.shared.files.functions(name):
            return False
        self.follow(f"{name}.m", content)
        return True

    def follow(self, name: str, content: str) -> None:
        """Run another script in the same variables."""
        if name in self.shared.scripts or name == self.name:
            raise v.MatlabValueError(f"{name} calls itself")
        before, local, place = self.name, self.local, self.place
        self.shared.scripts.append(name)
        # the functions of a script file are visible in it only
        self.name, self.local = name, {}
        try:
            with self.nested_call():
                self.script(content)
        finally:
            self.shared.scripts.pop()
            self.name, self.local, self.place = before, local, place


def _parameters(function: m.FunctionDefinition, arguments: Sequence[v.Value]) -> dict[str, v.Value]:
    names, values = list(function.parameters), list(arguments)
    if names and names[-1] == "varargin":
        rest = values[len(names) - 1 :]
        values = [*values[: len(names) - 1], v.MatlabCell(v.object_array(rest, (1, len(rest))))]
    if len(values) > len(names):
        raise v.MatlabValueError(f"{function.name} takes {len(names)} arguments, got {len(values)}")
    return {name: value for name, value in zip(names, values, strict=False) if name != "~"}


def _load(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    loaded = runner.shared.files.load(arguments)
    runner.variables |= loaded
    runner.owned.clear()
    for name in loaded:
        runner.define(name)


def _run(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    name = v.text(arguments[0]) if arguments else ""
    name = name if name.casefold().endswith(".m") else f"{name}.m"
    content = runner.shared.files.text(name)
    if content is None:
        raise runner.shared.files.not_found(name)
    runner.follow(name, content)


def _clear(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    """Remove named variables; `clear all` is ignored, since it would remove values from other files."""
    for word in (v.text(value) for value in arguments):
        runner.variables.pop(word, None)
        runner.define(word)


def _error(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    message = (
        v.text(arguments[0])[:200] if arguments and v.class_name(arguments[0]) in ("char", "string") else "an error"
    )
    if not runner.trying:
        runner.shared.report(
            Location(runner.name, place.line), f"the script stops with an error: {message}", "", "error"
        )
    raise _StopError(message)


def _assert(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    if arguments and not all(np.asarray(v.elements_of(arguments[0])).ravel()):
        _error(runner, arguments[1:], place)


def _assignin(runner: _ScriptRunner, arguments: Sequence[Any], place: m.TextPosition) -> None:
    if len(arguments) != 3:
        raise v.MatlabValueError("assignin requires a workspace, a name and a value")
    # any other workspace is that of the caller
    to_base = v.text(arguments[0]) == "base"
    target = runner.base() if to_base else runner.caller or runner
    name = v.text(arguments[1])
    target.variables[name] = arguments[2]
    target.define(name)


def _enumeration(arguments: Sequence[v.Value]) -> dict[str, v.MatlabStruct]:
    name, members = define_enumeration(arguments)
    return {name: members}


def _buses(arguments: Sequence[v.Value]) -> dict[str, v.MatlabStruct]:
    if not arguments:
        raise v.MatlabValueError("a list of buses is required")
    return buses_of_cells(arguments[0])


_DEFINITIONS: dict[str, Callable[[Sequence[v.Value]], dict[str, v.MatlabStruct]]] = {
    "defineIntEnumType": _enumeration,
    "Bus.cellToObject": _buses,
}
_STATEMENTS: dict[str, Callable[[_ScriptRunner, Sequence[Any], m.TextPosition], None]] = {
    "load": _load,
    "run": _run,
    "clear": _clear,
    "clearvars": _clear,
    "error": _error,
    "assert": _assert,
    "assignin": _assignin,
}
