"""Recorded drives: rounds of `propose --apply 1` take a bare map below what was reached by hand."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from kennfeld import Project, cli

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "engine_transient"
TRAINING, TEST = ("m10", "m11", "m12", "m30", "m31"), ("m53",)
BY_HAND = {"T_exh_manifold": 0.273, "T_catalyst": 0.294}  # RMSE of the test recordings, with a lag by load
BAIT = 8
ROUNDS = 3

PROJECT = """[model]
file = "map.kf"

[[dataset]]
name = "drives"
files = ["training_*.csv"]
raster = 0.5

[[dataset]]
name = "fresh"
files = ["test_*.csv"]
use = "test"
raster = 0.5

[[criterion]]
node = "T"
target = {{ channel = "{target}" }}

[parameters.M]
x = {{ input = "speed", count = 9 }}
y = {{ input = "load", count = 9 }}
initial = 0.0
smoothness = 1.0
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the recordings of the engine are not at {FOLDER}"),
]


def write_bare_map(folder, target):
    """Write a project of a map over speed and load; random walks are recorded beside the channels of the engine."""
    rng = np.random.default_rng(0)
    for use, names in (("training", TRAINING), ("test", TEST)):
        for name in names:
            with gzip.open(FOLDER / f"gengine1_{name}.csv.gz", "rt") as file:
                head, *rows = file.read().splitlines()
            walks = np.cumsum(rng.normal(size=(len(rows), BAIT)), axis=0) / np.sqrt(len(rows))
            lines = [f"{row}," + ",".join(f"{x:.4f}" for x in walk) for row, walk in zip(rows, walks, strict=True)]
            text = "\n".join([f"{head}," + ",".join(f"walk{number}" for number in range(BAIT)), *lines])
            (folder / f"{use}_{name}.csv").write_text(text + "\n", encoding="utf-8")
    (folder / "map.kf").write_text("T = M(speed, load)\n", encoding="utf-8")
    path = folder / "kennfeld.toml"
    path.write_text(PROJECT.format(target=target), encoding="utf-8")
    return path


@pytest.mark.parametrize("target", BY_HAND)
def test_rounds_of_proposals_take_a_bare_map_below_the_figure_by_hand(target, tmp_path, capsys):
    path = write_bare_map(tmp_path, target)
    errors = []
    for _ in range(ROUNDS):
        # the command refuses if nothing is proposed any more
        if cli.run(["propose", str(path), "--apply", "1"]) != 0:
            break
        print(capsys.readouterr().out)
        result = Project.read(path).calibrate(folder=tmp_path / "results")
        [errors_of_test] = [row.rmse_after for row in result.quality if row.use == "test"]
        errors.append(errors_of_test)
    text = (tmp_path / "map.kf").read_text(encoding="utf-8")
    assert "walk" not in text
    assert min(errors) < BY_HAND[target], (errors, text)
