"""The other side of `measure.apart`: run one function, print its result as the last line."""

import json
import os
import sys
from importlib import import_module


def main() -> None:
    """Run `module:function` with arguments in JSON, both from the command line."""
    cores = os.environ.get("BENCHMARK_CORES")
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-int(cores) :])
    target, arguments = sys.argv[1:]
    module, function = target.split(":")
    print(json.dumps(getattr(import_module(module), function)(**json.loads(arguments))))


if __name__ == "__main__":
    main()
