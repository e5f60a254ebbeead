"""Strips: samples where they fit, extremes where they do not."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.strips import statistics, strip


def test_a_zoom_shows_the_samples_themselves(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording = view.model.recordings[0]
    section = strip(view.signals, recording, [SignalName("channel", "Speed")], 100.0, 110.0, 600)
    assert section.raw
    positions = section.positions + section.begin
    inside = np.isin(recording.position, positions)
    np.testing.assert_array_equal(section.lines[0], recording.channel("Speed")[inside])
    assert positions[0] <= 100.0
    assert positions[-1] >= 110.0


def test_a_strip_of_the_whole_recording_shows_every_extreme(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording = view.model.recordings[0]
    signals = [SignalName("target", "0"), SignalName("node", "TemperaturePredict"), SignalName("error", "0")]
    begin, end = recording.position[[0, -1]]
    section = strip(view.signals, recording, signals, begin, end, 500)
    assert not section.raw
    assert section.positions.size == 1000
    for line, signal in zip(section.lines, signals, strict=True):
        values = view.signals.envelope(recording, signal).values
        assert np.nanmax(line) == np.nanmax(values)
        assert np.nanmin(line) == np.nanmin(values)


def test_error_is_model_minus_measurement(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording = view.model.recordings[0]
    names = (SignalName("node", "TemperaturePredict"), SignalName("target", "0"), SignalName("error", "0"))
    model, target, error = (view.signals.envelope(recording, name).values for name in names)
    np.testing.assert_allclose(model - target, error, atol=1e-9)


def test_statistics_are_those_of_the_stretch(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    recording = view.model.recordings[0]
    row = statistics(view.signals, recording, SignalName("channel", "Speed"), 50.0, 60.0)
    values = recording.channel("Speed")[(recording.position >= 50.0) & (recording.position < 60.0)]
    assert row.samples == values.size
    assert (row.least, row.mean, row.greatest) == pytest.approx((values.min(), values.mean(), values.max()))


def test_an_unknown_signal_is_refused(exhaust: Path) -> None:
    view = Session(exhaust).require_view()
    with pytest.raises(KeyError):
        view.signals.envelope(view.model.recordings[0], SignalName("node", "nothing"))


def test_positions_increase_from_file_to_file(torque: Path, tmp_path: Path) -> None:
    rows = "\n".join(f"{k * 0.1:.1f},{k}" for k in range(50))
    for name in ("a", "b"):
        (torque.parent / f"{name}.csv").write_text(f"time,u\n{rows}\n")
    (torque.parent / "gain.kf").write_text("y = k * u\nscalar k\n")
    project = torque.with_name("two.toml")
    project.write_text(
        '[model]\nfile = "gain.kf"\n[[dataset]]\nfiles = ["a.csv", "b.csv"]\n[parameters.k]\ninitial = 1\n'
        '[[criterion]]\nnode = "y"\ntarget = { channel = "u" }\n'
    )
    recording = Session(project).require_view().model.recordings[0]
    assert recording.starts.tolist() == [0, 50]
    assert np.all(np.diff(recording.position) > 0)
