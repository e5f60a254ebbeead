"""Steady points that are held until the function has settled, in the app."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld import Project
from kennfeld.app.session.session import Session
from kennfeld.optimize.quality.quality import Scorer


@pytest.mark.parametrize("average", [0.0, 1.0])
def test_the_errors_of_averaged_points_are_those_of_the_calibration(tmp_path: Path, average: float) -> None:
    x = np.linspace(0, 1, 20)
    np.savetxt(tmp_path / "a.csv", np.column_stack([x, 2 * x]), "%.5f", ",", header="x,m", comments="")
    (tmp_path / "f.kf").write_text("y = PT1(k * x, 0.5, 0)\n", encoding="utf-8")
    path = tmp_path / "kennfeld.toml"
    path.write_text(
        'model.file = "f.kf"\nmodel.step = 0.1\n[[dataset]]\nfiles = ["a.csv"]\nsettle = 2.0\n'
        f'average = {average}\n[[criterion]]\nnode = "y"\ntarget = "m"\n[parameters.k]\ninitial = 1.0\nfree = true\n',
        encoding="utf-8",
    )
    session = Session(path)
    [score] = session.require_view().now.scores
    problem = Project.read(path).problem()
    [row] = Scorer(problem).scores(problem.parameters, problem.parameters).quality
    assert (score.samples, score.rmse) == (20, pytest.approx(row.rmse_after, rel=1e-12))
    # what is drawn as measured is measured
    assert session.require_view().now.measured(0, 0) == pytest.approx(2 * x, abs=1e-4)
