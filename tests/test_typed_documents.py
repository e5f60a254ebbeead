"""What README and documents show in Python passes `mypy --strict`, as a user's own code does.

Functions that the documents define may be without annotations, which documents spare the reader; what is in them is
checked all the same. A name may be bound anew, as in a notebook.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
OPTIONS = (
    *("--strict", "--allow-untyped-defs", "--allow-untyped-calls", "--allow-untyped-decorators"),
    *("--allow-redefinition-new", "--local-partial-types", "--follow-imports=silent", "--ignore-missing-imports"),
    "--no-pretty",
)
MISTAKES = """
import kennfeld as kf

kf.Curve("C", [0, 1], [0.0, 1.0], uint="Nm")
kf.calibrate("y = a * x", {"x": [1.0]}, {"a": 1.0}, "x", smothness=1.0)
kf.cross_validate("y = a * x", {"x": [1.0]}, {"a": 1.0}, "x", smothness=1.0)
kf.problem("y = a * x", {"x": [1.0]}, {"a": 1.0}, "x", weights=1.0)
kf.Dataset.of("d", {"x": [1.0]}, wieght=2.0)
kf.calibrate(3, {"x": [1.0]}, {"a": 1.0}, "x")
kf.Criterion("y", "x", weigth=1.0)
"""


def checked(folder, texts):
    """Return the errors of mypy in files of some texts, by name."""
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    environment = {**os.environ, "MYPYPATH": str(ROOT / "src")}
    command = [sys.executable, "-m", "mypy", *OPTIONS, "--cache-dir", str(ROOT / ".mypy_cache" / "documents"), "."]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return [line for line in done.stdout.splitlines() if ": error: " in line]


@pytest.mark.slow
@pytest.mark.guests
def test_documents_pass_a_strict_type_checker_and_typing_errors_do_not(tmp_path):
    pytest.importorskip("mypy")
    texts = {"mistakes": MISTAKES}
    for document in DOCUMENTS:
        blocks = re.findall(r"^```python\n(.*?)^```", document.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        name = re.sub(r"\W", "_", document.relative_to(ROOT).with_suffix("").as_posix())
        texts |= {name: "\n".join(blocks)} if blocks else {}
    errors = checked(tmp_path, texts)
    assert [error for error in errors if not error.startswith("mistakes.py")] == []
    wrong = {int(error.split(":")[1]) for error in errors}
    assert wrong == {number for number, line in enumerate(MISTAKES.splitlines(), 1) if line.startswith("kf.")}
