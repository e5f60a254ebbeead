"""Former names of arguments work, give the same, and say what to write instead, as docs/stability.md promises."""

import dataclasses

import numpy as np
import pytest

import kennfeld as kf

X = np.linspace(0.0, 3.0, 31)
LINE = {"x": X, "z": 2 * X + 1}


def fit(**arguments):
    return kf.calibrate("y = a * x + b", LINE, {"a": 1.0, "b": 0.0}, target="z", **arguments)


def test_bounds_of_parameters_may_be_stated_as_limits():
    message = r"limits of the parameter a are bounds: write bounds=\{'a': \(0, 1.5\)\}"
    with pytest.warns(DeprecationWarning, match=message) as issued:
        former = fit(limits={"a": (0, 1.5), "y": (None, 5.0)})
    assert [warning.filename for warning in issued] == [__file__]
    assert former.parameters == fit(bounds={"a": (0, 1.5)}, limits={"y": (None, 5.0)}).parameters


def test_a_bound_of_what_is_no_parameter_is_an_error():
    with pytest.raises(kf.ArgumentError, match=r"bounds: unknown parameter A\. Did you mean a\?"):
        fit(bounds={"A": (0, 1)})
    with pytest.raises(kf.ArgumentError, match=r"bounds must be a dict of \(lower, upper\) by parameter, got 3.0"):
        fit(bounds=3.0)


def progress_lines(work):
    """Return the lines that work passes to a function for its progress."""
    lines = []
    work(lines.append)
    return lines


@pytest.mark.parametrize(
    "work",
    [
        lambda **report: kf.propose("y = a + b * x", LINE, {"a": 0.0, "b": 0.0}, target="z", channels=(), **report),
        lambda **report: kf.train_surrogate(
            [kf.Dataset.of("d", {"u": np.sin(X), "y": np.cos(X)}, time=X)],
            kf.SurrogateSettings("s", ("u",), "y", kind="dynamic", starts=1, longest_lag=2, free_run=False, centres=3),
            **report,
        ),
    ],
    ids=["propose", "train_surrogate"],
)
def test_the_function_for_lines_on_the_progress_may_be_stated_as_report(work):
    now = progress_lines(lambda progress: work(progress=progress))
    with pytest.warns(DeprecationWarning, match="report is now called progress: write progress=") as issued:
        assert progress_lines(lambda report: work(report=report)) == now
    assert issued[0].filename == __file__
    assert now


def test_piece_starts_of_a_dataset_may_be_stated_and_read_as_starts():
    now = kf.Dataset.of("d", LINE, piece_starts=[0, 10])
    message = "the argument starts is now called piece_starts: write piece_starts="
    for construct in (
        lambda: kf.Dataset.of("d", LINE, starts=[0, 10]),
        lambda: dataclasses.replace(now, starts=[0, 10]),
    ):
        with pytest.warns(DeprecationWarning, match=message) as issued:
            former = construct()
        assert former.piece_starts.tolist() == [0, 10]
        assert len(issued) == 1
    with pytest.warns(DeprecationWarning, match=r"Dataset\.starts is now called piece_starts") as issued:
        assert former.starts is former.piece_starts
    assert issued[0].filename == __file__
