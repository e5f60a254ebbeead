"""Designs on recordings of a real engine, if they are at hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design import design
from kennfeld.design.segments import cut_segments

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "engine_transient"
NAMES = ("10", "11", "12", "30", "31")
TARGET = "T_exh_manifold"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the recordings of the engine are not at {FOLDER}"),
]


@pytest.fixture(scope="module")
def drives():
    names = (*NAMES, "53")
    read = {name: kf.read(FOLDER / f"gengine1_m{name}.csv.gz", channels=["speed", "load", TARGET]) for name in names}
    return {name: replace(data, name=name, use="test" if name == "53" else "training") for name, data in read.items()}


@pytest.fixture(scope="module")
def fit(drives):
    speed, load = (np.concatenate([drives[name][channel].values for name in NAMES]) for channel in ("speed", "load"))
    x, y, z = (np.quantile(v, np.linspace(0, 1, n)) for v, n in ((speed, 9), (load, 9), (load, 4)))
    start = kf.ParameterSet([kf.Map("M", x, y, np.zeros((9, 9))), kf.Curve("L", z, np.full(4, 20.0), lower=0.05)])
    model = kf.formula("input speed\ninput load\ny = PT1(M(speed, load), L(load))")

    def run(training):
        result = kf.calibrate(model, training, start, TARGET, test=drives["53"], smoothness=0.1)
        return result, next(row.rmse_after for row in result.quality if row.use == "test")

    return run


@pytest.mark.parametrize("begin", [5, 60])
def test_fifteen_chosen_minutes_are_at_least_as_good_as_thirty_random_ones(drives, fit, begin):
    recordings = [drives[name] for name in NAMES]
    segments = cut_segments(recordings, 60.0, 30.0)
    numbers = {(segment.file, round(segment.begin, 1)): number for number, segment in enumerate(segments)}

    def cut(chosen):
        return [segments[number].cut(recordings[segments[number].dataset]) for number in chosen]

    known = list(range(begin, begin + 4))
    proposal = design(fit(cut(known))[0], segments=15, candidates=recordings, warmup=30.0)
    named = {name: data.files.names[0] if data.files else name for name, data in drives.items()}
    assert {segment.file for segment in proposal.segments} <= {*named, *named.values()}
    chosen = [numbers[segment.file, round(segment.begin, 1)] for segment in proposal.segments]
    random = np.random.default_rng(begin)
    rest = np.setdiff1d(np.arange(len(segments)), known)
    thirty = [fit(cut([*known, *random.choice(rest, 30, replace=False)]))[1] for _ in range(3)]
    assert fit(cut(sorted({*known, *chosen})))[1] <= np.mean(thirty)


def test_half_of_the_recordings_are_as_good_as_all(drives, fit):
    recordings = [drives[name] for name in NAMES]
    pieces = [
        replace(segment.cut(recordings[segment.dataset]), name=str(number))
        for number, segment in enumerate(cut_segments(recordings, 120.0, 30.0))
    ]
    result, everything = fit(pieces)
    proposal = design(result, reduce=True, keep=len(pieces) // 2)
    assert len(proposal.drop) == len(pieces) - len(pieces) // 2
    assert fit([piece for piece in pieces if piece.name not in proposal.drop])[1] <= 1.03 * everything
