"""What to measure next in the app: points and segments in another process, their maps, and their files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.app.questions import QUESTIONS
from kennfeld.app.questions.overview import overview
from kennfeld.app.session import design_work
from kennfeld.app.session.side_work import PartialOutcome
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import InputError
from kennfeld.design.api import Request
from tests.app.questions import WaitingSession

pytestmark = pytest.mark.usefixtures("forked_workers")

MAP = """\
model.file = "f.kf"
[[dataset]]
name = "bench"
files = "bench.csv"
[[criterion]]
node = "y"
target = "m"
[parameters.M]
x = { input = "n", breakpoints = [0.0, 1.0, 2.0] }
y = { input = "l", breakpoints = [0.0, 1.0, 3.0, 7.0] }
initial = 1.0
smoothness = 0.001
"""


class Designing(WaitingSession):
    """A session whose design can be waited for."""

    def propose(self, **arguments: Any) -> dict[str, Any]:
        """Compute a design, and return it."""
        self.ask("propose-design", **arguments)
        self.wait(self.session.design_work)
        proposed = self.ask("designs")["found"]
        assert proposed is not None, self.session.design_work.reason
        return dict(proposed)


def write_map(folder: Path, time: bool = False, upper: float = 1.0) -> Path:
    """Write a map of 3 x 4 values and data with n up to a limit, beyond which grid points have none."""
    rng = np.random.default_rng(5)
    n, load = rng.uniform(0, upper, 300), rng.uniform(0, 7, 300)
    columns = {"n": n, "l": load, "m": 2 * n + load + 0.05 * rng.standard_normal(300)}
    if time:
        columns = {"time": 0.1 * np.arange(300), **columns}
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "bench.csv", table, "%.5f", ",", header=",".join(columns), comments="")
    (folder / "f.kf").write_text("input n\ninput l\ny[Nm] = M(n, l)\n", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(MAP, encoding="utf-8")
    return folder / "kennfeld.toml"


def test_points_are_proposed_where_nothing_was_measured_and_written(tmp_path: Path) -> None:
    bench = Designing(write_map(tmp_path))
    offered = bench.ask("designs")
    assert (offered["timed"], offered["memory"], offered["found"]) == (False, False, None)
    assert offered["parameters"] == [{"name": "M", "unit": "", "values": 12, "withoutData": 4}]
    ranges = {"n": [0.0, 2.0], "l": [0.0, 7.0]}
    bench.session.do(SetKeys("ranges", "kennfeld.toml", [(("design", "ranges"), ranges)]))
    proposed = bench.propose(points=6, names=["M"])
    assert overview(bench.session).design.detail == "6 points"
    assert proposed["channels"] == ["n", "l"]
    assert sum(row["channels"][0] > 1 for row in proposed["points"]) >= 5
    [row] = proposed["tables"]
    assert row["greatest"][1] < 0.5 * row["greatest"][0]
    shown = QUESTIONS["design-map"](bench.session, {"name": "M"})
    assert [axis["points"] for axis in shown.head["axes"]] == [[0.0, 1.0, 2.0], [0.0, 1.0, 3.0, 7.0]]
    assert shown.head["empty"] == [False] * 8 + [True] * 4
    assert not shown.head["isDrive"]
    points = {(round(x, 4), round(y, 4)) for x, y in zip(shown.arrays["wayX"], shown.arrays["wayY"], strict=True)}
    assert points == {tuple(round(value, 4) for value in each["channels"]) for each in proposed["points"]}
    after, before = shown.arrays["after"].reshape(3, 4), shown.arrays["before"].reshape(3, 4)
    assert (after[2] < before[2]).all()
    assert bench.ask("export-design", format="csv") == {"file": "measure-next.csv"}
    assert (tmp_path / "measure-next.csv").read_text(encoding="utf-8").startswith('"number","block","kind"')
    assert bench.ask("export-design", format="csv") == {"existing": ["measure-next.csv"]}
    assert bench.ask("export-design", format="csv", force=True) == {"file": "measure-next.csv"}
    bench.session.undo()
    assert bench.ask("designs")["found"]["old"]


def test_segments_are_named_as_seen_from_the_project_with_their_ways(tmp_path: Path) -> None:
    path = write_map(tmp_path, time=True)
    (tmp_path / "old").mkdir()
    write_map(tmp_path / "old", time=True, upper=2.0)
    bench = Designing(path)
    bench.session.do(SetKeys("length", "kennfeld.toml", [(("design", "length"), 5.0)]))
    proposed = bench.propose(segments=2, candidates=["old/*.csv"])
    assert [row["file"] for row in proposed["segments"]] == ["old/bench.csv"] * 2
    assert proposed["segments"][1]["left"] < proposed["segments"][0]["left"] < 1
    assert proposed["segments"][1]["left"] == pytest.approx(proposed["factor"])
    assert proposed["formats"] == ["csv", "xlsx", "parquet", "json"]  # a list of segments has no time
    shown = QUESTIONS["design-map"](bench.session, {"name": "M"})
    assert shown.head["isDrive"]
    assert shown.head["ways"] == [0, 50]
    recorded = np.loadtxt(tmp_path / "old" / "bench.csv", delimiter=",", skiprows=1)
    begin = round(proposed["segments"][0]["begin"] / 0.1)
    np.testing.assert_allclose(shown.arrays["wayX"][:50], recorded[begin : begin + 50, 1], atol=1e-6)


def test_a_design_that_cannot_be_made_says_why_and_how(tmp_path: Path) -> None:
    bench = Designing(write_map(tmp_path, time=True))
    with pytest.raises(InputError, match="keep requires reduce"):
        bench.ask("propose-design", keep=2)
    with pytest.raises(InputError, match="nothing has been proposed yet"):
        bench.ask("export-design", format="csv")
    bench.ask("propose-design", segments=3)
    assert bench.wait(bench.session.design_work) == "failed"
    assert "there is nothing to choose segments from" in overview(bench.session).design.text


def test_a_project_without_data_gets_points_that_fill_its_ranges(tmp_path: Path) -> None:
    (tmp_path / "f.kf").write_text("y = 2 * n\n", encoding="utf-8")
    path = tmp_path / "kennfeld.toml"
    path.write_text(
        'model.file = "f.kf"\n[[dataset]]\nfiles = "later_*.csv"\n[[criterion]]\nnode = "y"\ntarget = "m"\n'
        "[design]\nranges = { n = [800.0, 6000.0] }\n",
        encoding="utf-8",
    )
    bench = Designing(path)
    proposed = bench.propose(points=5)
    assert len(proposed["points"]) == 5
    assert all(800 <= row["channels"][0] <= 6000 for row in proposed["points"])
    assert proposed["tables"] == []
    assert any("no recordings" in row["message"] for row in proposed["remarks"])


@pytest.mark.parametrize("request_of", [{"segments": 2}, {"n": 2}], ids=["segments", "points"])
def test_a_stop_keeps_the_design_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request_of: dict[str, int]
) -> None:
    path = write_map(tmp_path, time="segments" in request_of)
    monkeypatch.setattr(design_work, "EVERY", 0.0)
    unsaved, candidates = {"kennfeld.toml": f"{MAP}[design]\nlength = 5.0\n"}, (str(tmp_path / "bench.csv"),)
    task = design_work.DesignTask(path, unsaved, None, False, Request(**request_of), candidates)
    messages: list[Any] = []
    whole = task.run(messages.append)
    first, *_ = [message.outcome for message in messages if isinstance(message, PartialOutcome)]
    assert len(first.design.segments or first.design.points) == 1
    if first.design.segments:
        assert first.design.segments[0].file == "bench.csv"
    bench = Designing(path)
    bench.session.design_work.outcome = first
    shown = bench.ask("designs")["found"]
    assert (shown["stopped"], shown["remarks"]) == ([1, 2], [])
    assert len(shown["segments"] or shown["points"]) == 1
    assert whole.design.stopped is None
    assert len(whole.design.segments or whole.design.points) == 2
