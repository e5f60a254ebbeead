"""Compares tasks of ASCET projects with the C code that ASCET generated from them.

    python scripts/ascet_code.py APPLICATION.app FOLDER_OF_C_FILES ... [--steps 2000] [--seed 0]

The arguments are pairs of an application and the folder of its generated code. For each task, and for all periodic
tasks of an application together, the C files are compiled with gcc in a temporary folder, with `float32` as double so
that only the semantics differ, and run over random inputs; all messages that the tasks write are compared. Tasks run
together as an operating system calls them: each every n-th step with its own time difference. Prints a table.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kennfeld.ascet.schedule import Task, parse_schedule
from kennfeld.base.errors import InputError
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.node import STEPS, TIME
from kennfeld.importers.ascet.importing import esdl
from kennfeld.importers.ascet.task_choice import ALL_TASKS
from kennfeld.models.model import Model

Values = Mapping[str, npt.NDArray[np.float64]]
TOLERANCE = 1e-9  # relative to the largest value of a message
_GLOBAL = re.compile(r"^(float32|float64|boolean|[us]int(?:8|16|32)|\w+_E\w+) (\w+) = ", re.MULTILINE)
_FLOAT = re.compile(r"(?<![\w.])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)[fF]\b")
_STUBS = ("stm32f3xx.h",)
_DEFINES = ("-DESDL_PLATFORM_INTERNAL_BUILD", "-DOSENV_SINGLE_THREADED", "-D__NOP()=((void)0)")


@dataclass(frozen=True)
class Comparison:
    """Tasks with the largest relative difference of each message, or the reason why they were not compared."""

    application: str
    task: str
    differences: Mapping[str, float]
    reason: str = ""

    @property
    def row(self) -> str:
        """A line of the table."""
        if self.reason:
            return f"| {self.application} | {self.task} | not compared: {self.reason} |"
        wrong = [name for name, size in self.differences.items() if not size <= TOLERANCE]
        largest = max(self.differences.values(), default=0.0)
        verdict = f"differ: {', '.join(wrong)}" if wrong else f"agree to {largest:.1g}"
        return f"| {self.application} | {self.task} | {len(self.differences)} messages {verdict} |"


def compare(application: Path, code: Path, steps: int, seed: int) -> Iterator[Comparison]:
    """Yield the comparison of each task of an application."""
    schedule = parse_schedule(application.read_text("utf-8-sig"), application.name)
    tasks = [task for task in schedule.tasks if task.processes]
    together = sorted((task for task in tasks if task.period), key=lambda task: task.priority)
    groups = {task.name: ([task], task.name) for task in tasks}
    if len(together) > 1:
        groups["all tasks together"] = (together, ALL_TASKS)
    for title, (group, names) in groups.items():
        try:
            model = esdl(application, task=names)
        except InputError as error:
            yield Comparison(application.stem, title, {}, str(error.findings[0]))
            continue
        with tempfile.TemporaryDirectory() as folder:
            yield _compare_tasks(Comparison(application.stem, title, {}), group, model, code, Path(folder), steps, seed)


def _compare_tasks(
    empty: Comparison, tasks: list[Task], model: Model, code: Path, folder: Path, steps: int, seed: int
) -> Comparison:
    sources = _copy_sources(code, folder)
    text = "\n".join(path.read_text(errors="replace") for path in sources)
    variables = {variable: "uint32" if "_E" in kind else kind for kind, variable in _GLOBAL.findall(text)}
    inputs = {name: _variable(name, variables) for name in model.graph.inputs}
    outputs = {name: _variable(name, variables) for name in model.graph.outputs}
    if missing := [name for name, variable in inputs.items() if not variable]:
        return replace(empty, reason=f"{missing[0]} is not in the code")
    step = model.step or 0.01
    calls = [_calls(task, text, step) for task in tasks]
    if not all(function for each in calls for function in each.functions):
        return replace(empty, reason="a process is not in the code")
    columns = _random_inputs({name: variables[variable] for name, variable in inputs.items()}, steps, seed)
    known = {name: variable for name, variable in outputs.items() if variable}
    recorded = _run(folder, sources, _main(inputs, known, variables, calls), columns, list(known), list(inputs))
    clock = {**dict.fromkeys(STEPS, np.full(steps, step)), TIME: np.arange(steps) * step}
    simulated = evaluate(model.graph, {**columns, **clock}, model.values)
    return replace(empty, differences={key: _difference(simulated[key], recorded[key]) for key in known})


@dataclass(frozen=True)
class Calls:
    """The functions of a task, the number of steps from one run to the next, the first step, and the period in s."""

    functions: tuple[str, ...]
    every: int
    first: int
    period: float

    @property
    def line(self) -> str:
        """A line of C code that calls the functions where the task is due."""
        due = f"step >= {self.first} && (step - {self.first}) % {self.every} == 0"
        return f"if ({due}) {{ ASD_DT_SCALED = {self.period!r}; {' '.join(f'{name}();' for name in self.functions)} }}"


def _calls(task: Task, text: str, step: float) -> Calls:
    period = task.period or step
    functions = tuple(_function(process, text) for process in task.processes)
    return Calls(functions, round(period / step), round(task.delay / step), period)


def _copy_sources(code: Path, folder: Path) -> list[Path]:
    """Copy the generated code, in double precision and without the task functions."""
    sources = []
    for path in sorted(code.rglob("*.[ch]")):
        text = re.sub(r"\bfloat\b", "double", path.read_text(errors="replace"))
        (folder / path.name).write_text(_FLOAT.sub(r"\1", text))
        if path.suffix == ".c" and not path.name.startswith("Task"):
            sources.append(folder / path.name)
    for name in _STUBS:
        (folder / name).write_text("")
    return sources


def _variable(message: str, variables: Mapping[str, str]) -> str:
    plain = message.rpartition(".")[2]
    names = [name for name in variables if name == plain or name.endswith(f"_{plain}")]
    return names[0] if len(names) == 1 else plain if plain in names else ""


def _function(process: str, text: str) -> str:
    owner, _, method = process.rpartition(".")
    match = re.search(rf"^void ({owner.replace('.', '_')}_\w*?_{method})\s*\(void\)", text, re.MULTILINE)
    return match[1] if match else ""


def _random_inputs(kinds: Mapping[str, str], steps: int, seed: int) -> dict[str, npt.NDArray[np.float64]]:
    """Return inputs that stay for some steps and then jump, some of them to 0."""
    draw = np.random.default_rng(seed)
    columns = {}
    for name, kind in kinds.items():
        parts = np.repeat(np.arange(steps // 20 + 1), 20)[:steps]
        if kind == "boolean":
            levels = draw.integers(0, 2, parts[-1] + 1).astype(float)
        elif kind.startswith("float"):
            levels = draw.uniform(-2, 2, parts[-1] + 1) * draw.choice([0.0, 0.3, 1.0, 20.0], parts[-1] + 1)
        else:
            low, high = (0, 20) if kind[0] == "u" else (-300, 300)
            levels = draw.integers(low, high, parts[-1] + 1)
        columns[name] = levels.astype(float)[parts]
    return columns


def _main(
    inputs: Mapping[str, str], outputs: Mapping[str, str], kinds: Mapping[str, str], calls: Sequence[Calls]
) -> str:
    used = dict.fromkeys([*inputs.values(), *outputs.values()])
    lines = ["#include <stdio.h>", '#include "esdl_types.h"', *(f"extern {kinds[name]} {name};" for name in used)]
    lines += [f"extern void {name}(void);" for name in dict.fromkeys(name for each in calls for name in each.functions)]
    lines += ["extern float32 ASD_DT_SCALED;", "int main(void) { double x; long step;", "for (step = 0;; step++) {"]
    lines += [f'if (scanf("%lf", &x) != 1) return 0; {name} = ({kinds[name]})x;' for name in inputs.values()]
    if not inputs:
        lines.append('if (scanf("%lf", &x) != 1) return 0;')
    lines += [each.line for each in calls]
    lines += [f'printf("%.17g ", (double){name});' for name in outputs.values()]
    return "\n".join([*lines, 'printf("\\n"); } }', ""])


def _run(
    folder: Path, sources: list[Path], main: str, columns: Values, outputs: list[str], inputs: list[str]
) -> Values:
    (folder / "main.c").write_text(main)
    program = folder / "run"
    files = [*map(str, sources), str(folder / "main.c")]
    command = ["gcc", "-O1", "-w", "-ffp-contract=off", *_DEFINES, "-I", str(folder), "-o", str(program), *files, "-lm"]
    subprocess.run(command, check=True)
    rows = np.column_stack([columns[name] for name in inputs]) if inputs else np.zeros((len(outputs), 1))
    text = "\n".join(" ".join(map(repr, row.tolist())) for row in rows)
    done = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=True)
    table = np.array([list(map(float, line.split())) for line in done.stdout.splitlines()])
    return {name: table[:, at] for at, name in enumerate(outputs)}


def _difference(ours: npt.NDArray[np.float64], theirs: npt.NDArray[np.float64]) -> float:
    scale = max(float(np.max(np.abs(theirs), initial=0.0)), 1e-12)
    return float(np.max(np.abs(ours - theirs))) / scale


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pairs", nargs="+", type=Path)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if shutil.which("gcc") is None or len(options.pairs) % 2:
        sys.exit("gcc is required, and pairs of an application and a folder of C files")
    print("| application | task | result |\n|---|---|---|")
    results = [
        result
        for application, code in zip(options.pairs[::2], options.pairs[1::2], strict=True)
        for result in compare(application, code, options.steps, options.seed)
    ]
    print("\n".join(result.row for result in results))
    tried = [result for result in results if not result.reason]
    agree = sum(all(size <= TOLERANCE for size in result.differences.values()) for result in tried)
    print(f"\ntried {len(tried)}, agree {agree}, disagree {len(tried) - agree}")


if __name__ == "__main__":
    main()
