"""Published water tanks: what their physics and what their recordings alone make of them."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT.parent / "shared" / "data" / "cascaded_tanks" / "dataBenchmark.csv"

pytestmark = pytest.mark.skipif(not FILE.is_file(), reason=f"the recording of the tanks is not at {FILE}")


def example():
    place = ROOT / "examples" / "cascaded-tanks" / "tanks.py"
    spec = importlib.util.spec_from_file_location("tanks", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_example_meets_the_other_half():
    result = example().calibrated(FILE)
    assert result.converged
    fitted, other = result.quality
    assert fitted.rmse_after < 0.16
    assert other.rmse_after < 0.25


@pytest.mark.slow
def test_recordings_alone_make_a_model_that_runs_freely():
    data = kf.read(FILE)
    halves = [
        kf.Dataset.of(
            half,
            {"u": data[f"u{half}"].values, "y": data[f"y{half}"].values},
            time=4.0 * np.arange(data.samples),
            use=use,
        )
        for half, use in (("Est", "training"), ("Val", "test"))
    ]
    options = {"lags": {"u": (1, 18)}, "output_lags": (1, 4), "hold": 300.0, "centres": 40, "limits": (-np.inf, 10.0)}
    surrogate = train_surrogate(halves, SurrogateSettings("tank", ("u",), "y", kind="dynamic", **options))
    free = {line.dataset: line.rmse for line in surrogate.quality if line.mode == "free run"}
    assert free["Est"] < 0.3
    assert free["Val"] < 0.5
