"""Sentences and tables on a class or an application of an ASCET project."""

from collections.abc import Sequence

from kennfeld.ascet import syntax as e
from kennfeld.base.formatting import count_noun, number_text, shorten
from kennfeld.importers.ascet.import_report import EsdlReport, TaskSummary
from kennfeld.terminal.simulink import MAX_REMARKS, Rows, parameter_rows, port_tables


def class_table(classes: Sequence[e.ClassDeclaration]) -> Rows:
    """Return a row for each class of a file: its methods, and its numbers of elements."""
    rows: Rows = [("class", "methods", "characteristics", "variables", "state machines")]
    for item in classes:
        kinds = [element.kind for element in item.elements]
        methods = ", ".join(method.name for method in item.methods)
        counts = (kinds.count("characteristic"), kinds.count(""), len(item.machines))
        rows.append((item.name, methods, *map(str, counts)))
    return rows


def import_tables(report: EsdlReport) -> list[Rows]:
    """Return inputs, outputs, parameters, states, and what is not supported."""
    states = ((s.name, "calculated" if s.initial is None else number_text(s.initial)) for s in report.states)
    unsupported = ((str(f.location), f.message, f.remedy) for f in report.findings)
    return [
        *port_tables(report),
        parameter_rows(report.parameters),
        [("state", "first value"), *states],
        [("not supported", "why", "remedy"), *unsupported],
    ]


def import_notes(report: EsdlReport) -> list[str]:
    """Return what a step calls, whether it can be calibrated, and what behaves differently than in ASCET."""
    step = f"every {number_text(report.step)} s" if report.step is not None else "in each step of the data"
    startup = [f"calls once before: {', '.join(report.startup)}"] if report.startup else []
    coverage = (
        "can be calibrated"
        if report.whole
        else f"cannot be calibrated: {count_noun(len(report.findings), 'finding')} above"
    )
    return [
        *([_task_note(task) for task in report.tasks] or [f"calls {step}: {', '.join(report.methods)}"]),
        *startup,
        coverage,
        *shorten([str(remark) for remark in report.remarks], MAX_REMARKS, " remarks; --json lists them"),
    ]


def _task_note(task: TaskSummary) -> str:
    delay = f", first at {number_text(task.delay)} s" if task.delay else ""
    return f"{task.name} calls every {number_text(task.period)} s{delay}: {', '.join(task.methods)}"
