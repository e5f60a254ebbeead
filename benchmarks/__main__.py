"""`python -m benchmarks [TOPIC ...]`: run benchmarks and print a markdown table a topic."""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module

from benchmarks.machine import heading
from benchmarks.table import Table

TOPICS = {
    "torque": "benchmarks.torque",
    "exhaust": "benchmarks.exhaust",
    "limits": "benchmarks.limits",
    "constrained": "benchmarks.constrained",
    "continuation": "benchmarks.continuation",
    "scaling": "benchmarks.scaling",
    "states": "benchmarks.states",
    "large": "benchmarks.large",
    "factors": "benchmarks.factors",
    "small": "benchmarks.small_fits",
    "designs": "benchmarks.exact_designs",
    "compile": "benchmarks.compiling",
    "python": "benchmarks.python_functions",
    "startup": "benchmarks.startup",
    "files": "benchmarks.files",
    "cluster": "benchmarks.cluster",
    "fleet": "benchmarks.fleet",
    "simulink": "benchmarks.drawn",
    "app": "benchmarks.app",
    "nist": "benchmarks.nist",
    "starts": "benchmarks.bad_starts",
    "sets": "benchmarks.sets",
    "fmu": "benchmarks.fmu",
    "onnx": "benchmarks.onnx_networks",
    "smoothness": "benchmarks.automatic_smoothness",
    "missing": "benchmarks.missing_terms",
    "scores": "benchmarks.candidate_scores",
    "rounding": "benchmarks.rounding",
    "static": "benchmarks.static_models",
    "dynamic": "benchmarks.dynamic_models",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the topics that are asked for, all of them by default."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=main.__doc__)
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help=f"{', '.join(TOPICS)}; default: all")
    parser.add_argument("--cap", type=float, default=60.0, help="s after which a peer is stopped (default: 60)")
    options = parser.parse_args(arguments)
    unknown = [topic for topic in options.topics if topic not in TOPICS]
    if unknown:
        parser.error(f"{unknown[0]} is no topic; there are {', '.join(TOPICS)}")
    print(heading(), flush=True)
    for topic in options.topics or TOPICS:
        run: Callable[[], list[Table]] = import_module(TOPICS[topic]).run
        for table in (partial(run, options.cap) if topic in ("torque", "exhaust") else run)():
            print(f"\n{table}", end="", flush=True)


if __name__ == "__main__":
    main()
