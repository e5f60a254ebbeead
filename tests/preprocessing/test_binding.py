import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.dataset import Dataset
from kennfeld.models.formula import formula
from kennfeld.preprocessing.binding import bind_inputs

NAN = np.nan
STEADY, TIMED = formula("y = u + v").graph, formula("y = u + v + t + dt").graph
LAG = formula("y = PT1(u, 1) + v").graph


def columns(u, v=None):
    u = np.array(u, dtype=float)
    return {"u": u, "v": np.zeros(u.size) if v is None else np.array(v, dtype=float)}


def test_a_missing_input_drops_the_point_of_steady_data():
    bound = bind_inputs(Dataset.of("d", columns([1, NAN, 3, 4], [1, 2, NAN, 4])), STEADY, {})
    assert bound.kept.tolist() == [0, 3]
    assert bound.columns["u"].tolist() == [1, 4]
    assert bound.starts.tolist() == [0]


def test_an_infinite_input_drops_the_point_too():
    assert bind_inputs(Dataset.of("d", columns([1, np.inf, 3])), STEADY, {}).kept.tolist() == [0, 2]


def test_a_missing_value_in_another_channel_drops_nothing():
    data = Dataset.of("d", columns([1, 2]) | {"w": [NAN, NAN]})
    assert bind_inputs(data, STEADY, {}).count == 2


def test_gaps_up_to_the_longest_allowed_are_interpolated():
    time = np.array([0.0, 1.0, 1.5, 3.0, 4.0])
    data = Dataset.of("d", columns([0, NAN, NAN, 3, 4]), time=time, max_gap=3.0)
    bound = bind_inputs(data, LAG, {})
    assert bound.columns["u"].tolist() == [0, 1, 1.5, 3, 4]
    assert bound.starts.tolist() == [0]


def test_longer_gaps_split_the_recording():
    time = np.arange(8.0)
    data = Dataset.of("d", columns([0, NAN, 2, 3, NAN, NAN, 6, 7]), time=time, max_gap=2.0)
    bound = bind_inputs(data, LAG, {})
    assert bound.kept.tolist() == [0, 1, 2, 3, 6, 7]
    assert bound.columns["u"].tolist() == [0, 1, 2, 3, 6, 7]
    assert bound.starts.tolist() == [0, 4]


def test_without_an_allowance_every_gap_splits():
    bound = bind_inputs(Dataset.of("d", columns([0, NAN, 2, 3]), time=np.arange(4.0)), LAG, {})
    assert (bound.kept.tolist(), bound.starts.tolist()) == ([0, 2, 3], [0, 1])


def test_gaps_at_the_ends_are_never_interpolated():
    data = Dataset.of("d", columns([NAN, 1, 2, NAN]), time=np.arange(4.0), max_gap=9.0)
    assert bind_inputs(data, LAG, {}).kept.tolist() == [1, 2]


def test_gaps_are_not_bridged_from_one_piece_to_the_next():
    data = Dataset.of("d", columns([0, 1, NAN, NAN, 4, 5]), time=np.arange(6.0), piece_starts=[0, 3], max_gap=9.0)
    bound = bind_inputs(data, LAG, {})
    assert (bound.kept.tolist(), bound.starts.tolist()) == ([0, 1, 4, 5], [0, 2])


def test_a_gap_in_one_input_is_bridged_while_another_goes_on():
    data = Dataset.of("d", columns([0, NAN, 2], [5, 6, NAN]), time=np.arange(3.0), max_gap=2.0)
    bound = bind_inputs(data, LAG, {})
    assert (bound.columns["u"].tolist(), bound.columns["v"].tolist()) == ([0, 1], [5, 6])


def test_the_first_step_is_as_long_as_the_second():
    bound = bind_inputs(Dataset.of("d", columns(np.zeros(4)), time=[10.0, 10.5, 11.5, 12.0]), TIMED, {})
    assert bound.columns["dt"].tolist() == [0.5, 0.5, 1.0, 0.5]
    assert bound.columns["t"].tolist() == [0.0, 0.5, 1.5, 2.0]


def test_time_starts_again_in_every_piece():
    time = [0.0, 1.0, 3.0, 0.0, 0.25, 0.75]
    bound = bind_inputs(Dataset.of("d", columns(np.zeros(6)), time=time, piece_starts=[0, 3]), TIMED, {})
    assert bound.columns["dt"].tolist() == [1.0, 1.0, 2.0, 0.25, 0.25, 0.5]
    assert bound.columns["t"].tolist() == [0.0, 1.0, 3.0, 0.0, 0.25, 0.75]


def test_the_next_step_leads_to_the_next_sample_of_the_piece():
    time = [0.0, 1.0, 3.0, 0.0, 0.25, 0.75, 5.0]
    data = Dataset.of("d", columns(np.zeros(7)), time=time, piece_starts=[0, 3, 6])
    bound = bind_inputs(data, formula("y = u + v + dt + dt_next").graph, {})
    assert bound.columns["dt_next"].tolist() == [1.0, 2.0, 2.0, 0.25, 0.5, 0.5, 0.75]
    assert bound.columns["dt"].tolist() == [1.0, 1.0, 2.0, 0.25, 0.25, 0.5, 0.75]


def test_steps_of_a_second_raster_are_not_pauses():
    times = np.concatenate([[0.0], np.cumsum(np.resize([0.01, 0.01, 0.5], 60))])
    assert bind_inputs(Dataset.of("d", columns(np.zeros(61)), time=times), LAG, {}).starts.tolist() == [0]
    times[40:] += 60.0
    assert bind_inputs(Dataset.of("d", columns(np.zeros(61)), time=times), LAG, {}).starts.tolist() == [0, 40]


def test_the_ratio_that_makes_a_pause_does_not_depend_on_rounding():
    times = 0.1 * np.arange(50) + np.where(np.arange(50) > 20, 1.9, 0.0)  # a step of 20 others
    assert bind_inputs(Dataset.of("d", columns(np.zeros(50)), time=times), LAG, {}).starts.tolist() == [0]


def test_time_starts_again_after_a_gap():
    data = Dataset.of("d", columns([0, 1, NAN, 3, 4]), time=np.arange(5.0))
    assert bind_inputs(data, TIMED, {}).columns["t"].tolist() == [0, 1, 0, 1]


def test_a_step_that_is_even_but_for_rounding_is_one_number():
    bound = bind_inputs(Dataset.of("d", columns(np.zeros(1000)), time=0.1 * np.arange(1000) + 7e4), TIMED, {})
    assert np.unique(bound.columns["dt"]).size == 1


@pytest.mark.parametrize("time", [[0.0, 0.0], [5.0, 1.0], [0.0, 100.0]])
def test_the_step_of_pieces_of_one_sample_is_positive(time):
    bound = bind_inputs(Dataset.of("d", columns(np.zeros(2)), time=time, piece_starts=[0, 1]), TIMED, {})
    assert np.all(bound.columns["dt"] > 0)


def test_a_single_sample_has_a_step():
    bound = bind_inputs(Dataset.of("d", columns([1.0]), time=[4.0]), TIMED, {})
    assert bound.columns["dt"][0] > 0
    assert bound.columns["t"].tolist() == [0.0]


def test_samples_that_are_not_scored_are_marked():
    data = Dataset.of("d", columns([1, NAN, 3]), scored=[False, True, True])
    assert bind_inputs(data, STEADY, {}).scored.tolist() == [False, True]


def test_an_input_may_be_read_from_a_channel_of_another_name():
    data = Dataset.of("d", {"speed": [1.0, 2.0], "v": [0.0, 0.0]})
    assert bind_inputs(data, STEADY, {"u": "speed"}).columns["u"].tolist() == [1.0, 2.0]


def test_a_function_of_time_needs_time_stamps():
    with pytest.raises(InputError, match=r"dataset bench: .*time stamps"):
        bind_inputs(Dataset.of("bench", columns([1.0, 2.0])), TIMED, {})


def test_a_dataset_without_remaining_samples_is_empty():
    for graph, time in ((STEADY, None), (TIMED, np.arange(2.0)), (LAG, np.arange(2.0))):
        bound = bind_inputs(Dataset.of("d", columns([NAN, NAN]), time=time), graph, {})
        assert (bound.count, bound.starts.size, bound.columns["u"].size) == (0, 0, 0)


def test_memory_without_time_runs_over_the_samples():
    bound = bind_inputs(Dataset.of("d", columns([1, NAN, 3])), formula("y = prev(u, 0) + v").graph, {})
    assert (bound.kept.tolist(), bound.starts.tolist()) == ([0, 2], [0, 1])


def test_a_dataset_of_which_all_is_kept_is_not_copied():
    data = Dataset.of("d", columns(np.arange(4.0)), time=np.arange(4.0))
    for graph in (STEADY, LAG):
        assert bind_inputs(data, graph, {}).columns["u"] is data["u"].values


def test_without_memory_dropped_points_may_stay_if_they_do_not_count():
    data = Dataset.of("d", columns([1, NAN, 3]), scored=[True, True, False])
    whole = bind_inputs(data, STEADY, {}).whole
    assert (whole.count, whole.picked, whole.scored.tolist()) == (3, None, [True, False, False])
    assert whole.columns["u"] is data["u"].values


def test_the_clock_of_dropped_points_is_unknown():
    data = Dataset.of("d", columns([0, 1, NAN, 3, 4]), time=np.arange(5.0))
    assert np.nan_to_num(bind_inputs(data, TIMED, {}).whole.columns["t"], nan=-1.0).tolist() == [0, 1, -1, 0, 1]


def test_only_the_clock_in_use_is_built():
    data = Dataset.of("d", columns(np.arange(4.0)), time=np.arange(4.0))
    assert bind_inputs(data, formula("y = u * t").graph, {}).clock.keys() == {"t"}
    assert bind_inputs(data, LAG, {}).clock.keys() == {"dt"}


def test_a_pause_of_the_recording_starts_a_new_piece():
    time = np.array([0.0, 0.1, 0.2, 0.3, 9.0, 9.1, 9.2])
    bound = bind_inputs(Dataset.of("d", columns(range(7)), time=time), TIMED, {})
    assert bound.starts.tolist() == [0, 4]
    assert bound.columns["dt"] == pytest.approx([0.1] * 7)
    assert bound.columns["t"] == pytest.approx([0, 0.1, 0.2, 0.3, 0, 0.1, 0.2])


def test_a_pause_as_long_as_an_allowed_gap_is_a_step():
    time = np.array([0.0, 0.1, 0.2, 0.3, 9.0, 9.1, 9.2])
    bound = bind_inputs(Dataset.of("d", columns(range(7)), time=time, max_gap=10.0), TIMED, {})
    assert bound.starts.tolist() == [0]
    assert bound.columns["dt"][4] == pytest.approx(8.7)


def test_uneven_steps_are_not_pauses():
    time = np.cumsum(np.tile([0.05, 0.2, 0.1, 0.9], 5))
    assert bind_inputs(Dataset.of("d", columns(range(20)), time=time), TIMED, {}).starts.tolist() == [0]


def test_the_time_between_two_recordings_is_not_a_step():
    time = np.concatenate([np.arange(5) / 10, 500 + np.arange(5) / 10])
    bound = bind_inputs(Dataset.of("d", columns(range(10)), time=time, piece_starts=[0, 5], max_gap=1000.0), TIMED, {})
    assert bound.starts.tolist() == [0, 5]


def test_the_warmup_begins_anew_after_every_gap():
    time = np.arange(10) / 10
    data = Dataset.of("d", columns([0, 1, 2, 3, NAN, 5, 6, 7, 8, 9]), time=time, warmup=0.2)
    bound = bind_inputs(data, LAG, {})
    assert bound.kept[bound.scored].tolist() == [2, 3, 7, 8, 9]


def test_the_warmup_adds_to_what_is_not_scored():
    scored = np.array([True, True, True, False, True])
    data = Dataset.of("d", columns(range(5)), time=np.arange(5.0), warmup=2.0, scored=scored)
    assert np.flatnonzero(bind_inputs(data, LAG, {}).scored).tolist() == [2, 4]
