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
    ("arguments", "message"),
    [(["1"], "must be >= 2, got 1"), (["3", "--parts", "halves"], "unknown kind of folds 'halves'")],
)
def test_the_command_refuses_invalid_arguments(shop, capsys, arguments, message):
    assert cli.run(["calibrate", str(shop.path), "--cross-validate", *arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
def test_the_result_and_the_report_contain_the_cross_validation(shop):
    rng = np.random.default_rng(0)
    shop.bench("bench.csv", speed=rng.uniform(1000, 3000, 60))
    results = shop.folder / "results"
    assert cli.run(["calibrate", str(shop.path), "--cross-validate", "3"]) == 0
    content = json.loads((results / "result.json").read_text(encoding="utf-8"))
    assert content["cross_validation"] == json.loads((results / "cross_validation.json").read_text(encoding="utf-8"))
    assert list(content)[-2:] == ["cross_validation", "files"]
    report = (results / "report.html").read_text(encoding="utf-8")
    for words in ("Each fold was held out once", "random 3", "times that in training"):
        assert words in report
    assert "cannot show how the function generalises" not in report
    assert cli.run(["report", str(shop.path), "-o", str(shop.folder / "again.html")]) == 0
    assert "Each fold was held out once" in (shop.folder / "again.html").read_text(encoding="utf-8")
    assert cli.run(["calibrate", str(shop.path)]) == 0
    assert "Each fold was held out once" not in (results / "report.html").read_text(encoding="utf-8")


def test_a_damaged_cross_validation_is_named(shop, capsys):
    shop.bench("bench.csv")
    assert cli.run(["calibrate", str(shop.path)]) in (0, 1)
    path = shop.folder / "results" / "result.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(content | {"cross_validation": {"folds": [{"fold": 1}]}}), encoding="utf-8")
    assert cli.run(["report", str(shop.path)]) == 2
    assert "result.json: not a valid result file" in capsys.readouterr().err
