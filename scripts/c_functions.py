"""Counts the functions of C files that Kennfeld translates, and compares them with compiled ones.

    python scripts/c_functions.py FOLDER ... [--calls 200] [--seed 0] [--list]

Each function gets random inputs, call after call. The compiler of the system compiles the same file with `float` as
`double`. "agree" counts the functions whose outputs are the same to 1e-12 of their largest value.
"""

import argparse
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from compiled_c import NotCompiledError, reference

from kennfeld.base.errors import InputError
from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.c.importing import read_function
from kennfeld.importers.c.interface import CNumbers
from kennfeld.importers.c.number_types import ENUMERATION
from kennfeld.importers.c.reading import CSourceFile, read_c_file
from kennfeld.importers.c.translated import TranslatedFunction, translate
from kennfeld.models.model_function import as_model

TOLERANCE = 1e-12
_KINDS = ("agree", "refused", "not compiled", "undefined")
_NAMES = re.compile(r"\S+\.[ch](:\d+)* (line|file|error)\S*( \d+)?:?|(?<=name |tion |ment )\w+")


def random_inputs(function: TranslatedFunction, calls: int, draw: np.random.Generator, most: int = 0) -> np.ndarray:
    """Return Float[calls, inputs]: numbers of different sizes, and integers that their types hold, up to `most`."""
    columns = [_column(number, calls, draw, most) for number in function.interface.inputs for _ in number.labels]
    return np.array(columns).reshape(len(columns), calls).T


def _column(number: CNumbers, calls: int, draw: np.random.Generator, largest: int) -> np.ndarray:
    word = number.leaf.type.word
    if word is None:
        return draw.normal(0.0, draw.choice([1.0, 10.0]), calls)
    if number.leaf.type is ENUMERATION:
        return draw.integers(0, 4, calls).astype(float)
    if number.leaf.type.truth:
        return draw.integers(0, 2, calls).astype(float)
    most = min(word.most, largest or int(draw.choice([5, 100, 2**31 - 1])))
    return draw.integers(max(word.least, -most), most, calls, endpoint=True).astype(float)


def compare(path: Path, name: str, calls: int, seed: int, most: int = 0) -> str:
    """Return what became of a function: "agree", or why it does not."""
    file = read_c_file(path)
    translated = translate(file.declarations, file.declarations.functions[name])
    draw = np.random.default_rng(seed)
    inputs = random_inputs(translated, calls, draw, most)
    try:
        with tempfile.TemporaryDirectory() as folder:
            expected = reference(file, translated, inputs, Path(folder))
    except NotCompiledError as error:
        return f"not compiled: {error}"
    values = computed(path, name, translated, inputs)
    scale = np.maximum(1.0, np.nanmax(np.where(np.isfinite(expected), np.abs(expected), 0.0), axis=0, initial=0.0))
    same = np.isclose(values / scale, expected / scale, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True)
    if same.all():
        return "agree"
    if np.all(same | (np.isnan(values) & ~np.isnan(expected))):
        return "undefined: an index is out of range, or an integer is divided by 0"
    call, output = np.argwhere(~same & ~np.isnan(values))[0]
    label = translated.outputs[output]
    return f"{label} differs in call {call + 1}: {values[call, output]:.17g}, compiled {expected[call, output]:.17g}"


def computed(path: Path, name: str, translated: TranslatedFunction, inputs: np.ndarray) -> np.ndarray:
    """Return the outputs of the graph, Float[calls, outputs]."""
    function = read_function(path, name)
    model = as_model(function)
    columns = dict(zip(translated.inputs, inputs.T, strict=True))
    nodes = evaluate(
        model.graph,
        {key: columns[key] for key in model.graph.inputs} or {"none": np.zeros(len(inputs))},
        function.values,
    )
    return np.array([np.broadcast_to(nodes[output], len(inputs)) for output in translated.outputs]).T


def _functions(folders: list[Path]) -> Iterator[tuple[Path, CSourceFile | None, str]]:
    for folder in folders:
        for path in sorted(folder.rglob("*.c")) if folder.is_dir() else [folder]:
            try:
                yield path, read_c_file(path), ""
            except InputError as error:
                yield path, None, str(error.findings[0])


def main() -> int:
    """Print a line for each function, if asked for, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--calls", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reasons", type=int, default=10, help="number of reasons to print")
    parser.add_argument("--integers", type=int, default=0, help="largest integer among the inputs")
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    for path, file, problem in _functions(options.folders):
        if file is None:
            counts["files that cannot be read"] += 1
            print(f"{path}: {problem}")
            continue
        counts["files"] += 1
        for name in (*file.declarations.functions, *file.declarations.unsupported):
            began = time.process_time()
            try:
                read_function(path, name)
                outcome = compare(path, name, options.calls, options.seed, options.integers)
            except InputError as error:
                outcome = f"refused: {error.findings[0]}"
            kind = outcome.partition(":")[0] if outcome.startswith(_KINDS) else outcome
            counts["functions"] += 1
            if kind in _KINDS[1:]:
                reasons[_NAMES.sub("...", outcome)] += 1
            counts[kind if kind in _KINDS else "differ"] += 1
            if options.list or " differs " in outcome:
                print(f"{path.name}:{name}: {outcome} ({time.process_time() - began:.1f} s)", flush=True)
    for reason, count in reasons.most_common(options.reasons):
        print(f"{count:5} {reason[:180]}")
    print(", ".join(f"{count} {kind}" for kind, count in counts.items()))
    return int(counts["differ"] > 0)


if __name__ == "__main__":
    sys.exit(main())
