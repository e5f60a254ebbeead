"""The results: what is accepted, and what a pin would do to the uncertainty."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.app.questions.trust import pinned_deviation
from kennfeld.app.session.session import Session
from tests.app.app_processes import FORKS, fork_workers, forking_process
from tests.app.function_samples import write_product
from tests.app.questions import ask


@pytest.fixture(scope="module", autouse=True)
def forked_worker() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if FORKS:
            fork_workers(patch, forking_process())
        yield


def run(session: Session) -> Session:
    session.run()
    deadline = time.monotonic() + 120
    while session.job.state == "running":
        assert time.monotonic() < deadline
        time.sleep(0.02)
        session.pump()
    return session


@pytest.mark.parametrize("axis", [0, 2, 4])
def test_the_deviation_of_a_pinned_fit_is_predicted(axis: int) -> None:
    rng = np.random.default_rng(5)
    x = rng.uniform(0, 4, 4000)
    data = {"x": x, "y": np.sin(x) + 0.1 * rng.standard_normal(x.size)}
    start = kf.ParameterSet([kf.Curve("C", np.arange(5.0), np.zeros(5))])
    options: dict[str, Any] = {"target": "y", "smoothness": {"C": 0.5}}
    free = kf.calibrate("m = C(x)", data, start, **options)
    value = float(free.parameters["C"].values[axis])
    pinned = kf.calibrate("m = C(x)", data, start, pins=[kf.Pin("C", (float(axis),), value)], **options)
    predicted = pinned_deviation(free.trust, "C", (axis,))["C"]
    assert predicted == pytest.approx(pinned.trust.deviation["C"], rel=0.02, abs=1e-12)
    assert predicted[axis] == 0.0


def test_an_undetermined_value_has_no_predicted_deviation() -> None:
    x = np.linspace(0, 1, 50)
    start = kf.ParameterSet([kf.Scalar("a", 0.0), kf.Scalar("b", 0.0)])
    trust = kf.calibrate("m = (a + b) * x", {"x": x, "y": x}, start, target="y").trust
    assert pinned_deviation(trust, "a", ()) == {}


def test_directions_have_remedies_that_a_click_applies(tmp_path: Path) -> None:
    calibrated = run(Session(write_product(tmp_path / "product")))
    head = ask(calibrated, "trust").head
    assert head["coupled"] == []
    remedies = [each for direction in head["directions"] for each in direction["remedies"]]
    assert remedies
    before = calibrated.state
    ask(calibrated, "set-keys", changes=remedies[0]["changes"], title=remedies[0]["title"])
    assert not calibrated.stale, calibrated.findings
    again = ask(calibrated, "trust").head
    applied = [each["applied"] for direction in again["directions"] for each in direction["remedies"]]
    assert applied[0]
    assert calibrated.undo() == remedies[0]["title"]
    assert calibrated.state == before
