"""What becomes of Simulink files: `python -m benchmarks.simulink_models FOLDER [PARAMETERS.json]` prints a table.

For each file whether it is whole, how many of its blocks are supported, and what stops it. The second file gives values
to variables, {"engine": {"K": 1.0}} for engine.slx.
"""

import json
import sys
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.models.simulink.importing import import_simulink


def row(path: Path, given: dict[str, object]) -> str:
    """One line of the table."""
    try:
        report = import_simulink(path, parameters=[given]).report
    except InputError as error:
        return f"| {path.name} | refused | | {error.findings[0]} |"
    stops = [f"{finding.place}: {finding.what}" for finding in report.findings]
    told = "; ".join(stops[:4]) + (f"; and {len(stops) - 4} more" if len(stops) > 4 else "")
    return f"| {path.name} | {'whole' if report.whole else 'partial'} | {report.supported}/{report.total} | {told} |"


def main() -> None:
    """Print the table."""
    folder = Path(sys.argv[1])
    values = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8")) if len(sys.argv) > 2 else {}
    print("| file | | blocks | what stops it |\n|---|---|---|---|")
    for path in sorted(folder.iterdir()):
        if path.suffix in (".slx", ".mdl"):
            print(row(path, values.get(path.stem, {})))


if __name__ == "__main__":
    main()
