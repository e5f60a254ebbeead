"""`kennfeld calibrate --cross-validate`."""

import json

import numpy as np
import pytest

from kennfeld import cli


def test_the_command_writes_its_table(shop, capsys):
    rng = np.random.default_rng(0)
    shop.bench("bench.csv", speed=rng.uniform(1000, 3000, 60))
    assert cli.run(["calibrate", str(shop.path), "--cross-validate", "3"]) == 0
    printed = capsys.readouterr().out
    assert "random 3" in printed
    assert "Predict: RMSE" in printed
    content = json.loads((shop.folder / "results" / "cross_validation.json").read_text(encoding="utf-8"))
    assert len(content["folds"]) == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["1"], "must be >= 2, got 1"), (["3", "--parts", "halves"], "unknown kind of folds 'halves'")],
)
def test_the_command_refuses_what_it_cannot_do(shop, capsys, arguments, said):
    assert cli.run(["calibrate", str(shop.path), "--cross-validate", *arguments]) == 2
    assert said in capsys.readouterr().err
