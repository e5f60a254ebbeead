"""Project folders as a stranger may send them: small projects, and traps in them that lead to files outside."""

import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path

PROJECT = """[model]
file = "function.kf"
[[dataset]]
files = ["bench.csv"]
cache = true
[[criterion]]
node = "y"
target = "wanted"
[calibration]
output = [".json", ".dcm"]
[parameters.K]
initial = 1.0
[optimizer]
save_every = 1
max_iterations = 3
"""
TRAINING = """[surrogate]
inputs = ["u"]
output = "wanted"
file = "{file}"
[[dataset]]
files = ["bench.csv"]
"""


def write_project(folder: Path) -> Path:
    """Write a harmless project and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [f"{0.1 * number:.1f},{1 + number % 7},{2 + number % 5 + 0.001 * number}" for number in range(60)]
    (folder / "bench.csv").write_text("\n".join(["time,u,wanted", *rows, ""]))
    (folder / "function.kf").write_text("y = K * u\n")
    (folder / "kennfeld.toml").write_text(PROJECT)
    return folder / "kennfeld.toml"


def write_outside(folder: Path) -> Path:
    """Write files that no command may touch, under the names that commands write; return their folder."""
    for place in ("", "saves", "cache", "before"):
        (folder / place).mkdir(parents=True, exist_ok=True)
        for name in (
            "victim.txt",
            "0-end.json",
            "1-000001.json",
            "old.parquet",
            "report.html",
            "kennfeld.unsaved.json",
        ):
            (folder / place / name).write_text("precious")
    return folder


def contents(folder: Path) -> dict[str, str]:
    """Return all files of a folder with their texts, and its folders."""
    paths = sorted(folder.rglob("*"))
    return {str(path.relative_to(folder)): path.read_text() if path.is_file() else "" for path in paths}


def _unfinished(project: Path, outside: Path) -> None:
    """Let a list of unfinished renames lead outside of the results folder."""
    scratch = project / "results" / ".kennfeld-0123456789abcdef"
    scratch.mkdir(parents=True)
    (project / "outside").mkdir()
    (project / "outside" / "victim.txt").write_text("harm")
    names = ["../../outside/victim.txt", str(outside / "victim.txt"), "..\\..\\outside\\victim.txt", 7]
    (scratch / "names").write_text(json.dumps([f"../../{outside.name}/victim.txt", *names]))


def _unfinished_link(project: Path, outside: Path) -> None:
    """Let what a list of unfinished renames holds be links."""
    scratch = project / "results" / ".kennfeld-0123456789abcdef"
    scratch.mkdir(parents=True)
    (scratch / "report.html").symlink_to(outside / "victim.txt")
    (scratch / "lock").symlink_to(outside / "made.txt")
    (scratch / "names").write_text(json.dumps(["report.html"]))


def _unfinished_folder(project: Path, outside: Path) -> None:
    """Let the folder of unfinished renames be a link."""
    (project / "results").mkdir()
    (outside / "names").write_text(json.dumps(["victim.txt"]))
    (project / "results" / ".kennfeld-0123456789abcdef").symlink_to(outside)


def _link(name: str, target: str = "victim.txt") -> Callable[[Path, Path], None]:
    def plant(project: Path, outside: Path) -> None:
        path = project / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.symlink_to(outside / target)

    return plant


RESULTS = ("report.html", "parameters.json", "parameters.dcm", "trace.csv", "trust.csv", "simulation.parquet")

TRAPS: dict[str, Callable[[Path, Path], None]] = {
    "unfinished": _unfinished,
    "unfinished link": _unfinished_link,
    "unfinished folder": _unfinished_folder,
    **{f"results/{name}": _link(f"results/{name}") for name in (*RESULTS, "result.json", "cross_validation.json")},
    "results": _link("results", ""),
    "results to a new file": _link("results/report.html", "made.txt"),
    "saves": _link("results/saves", "saves"),
    "older saves": _link("results/saves/before", "before"),
    "hidden folder": _link(".kennfeld", ""),
    "saves of the app": _link(".kennfeld/saves", "saves"),
    "cache": _link(".kennfeld/cache", "cache"),
    "partitions": _link(".kennfeld/partitions", "cache"),
    "recovery": _link(".kennfeld/kennfeld.unsaved.json"),
    "values": _link("values.json"),
    "new values": _link("values.json", "made.txt"),
    "simulation": _link("simulation.parquet"),
    "script": _link("calibrate.py"),
    "calibration": _link("out.dcm"),
    "new calibration": _link("out.dcm", "made.txt"),
}


class _Bomb:
    """A value whose pickle makes a folder when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.path),)


KEPT = (
    *(".kennfeld/cache/0-0-0.parquet", ".kennfeld/cache/0.json", ".kennfeld/partitions/0.columns"),
    *(".kennfeld/kennfeld.unsaved.json", ".kennfeld/saves/1-000001.json", "results/saves/1-000001.json"),
    *("results/saves/2-end.json", "results/result.json", "results/parameters.json", "results/trace.csv"),
    *("results/trust.csv", "results/simulation.parquet", "results/cross_validation.json", "values.json"),
)


def plant_pickles(project: Path, exploded: Path) -> None:
    """Replace all that Kennfeld keeps in a project folder by pickles that make a folder when they are read."""
    for name in KEPT:
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_bytes(pickle.dumps(_Bomb(exploded)))
