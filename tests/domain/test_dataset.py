import dataclasses

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.domain.dataset import Channel, Dataset, concatenate


def bench(**attributes):
    return Dataset.of("bench", {"Speed": [1000, 2000, 3000], "Torque": [80.0, np.nan, 95.0]}, **attributes)


def test_a_channel_holds_doubles_that_nobody_changes():
    channel = Channel("Speed", [1, 2, 3], "rpm")
    assert channel.values.dtype == np.float64
    assert len(channel) == 3
    with pytest.raises(ValueError, match="read-only"):
        channel.values[0] = 5


def test_a_channel_keeps_its_own_copy():
    source = np.array([1.0, 2.0])
    channel = Channel("Speed", source)
    source[:] = 9
    assert channel.values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("values", [3.0, np.zeros((2, 2))])
def test_a_channel_is_one_list_of_numbers(values):
    with pytest.raises(ArgumentError, match="channel Speed must be one-dimensional, got shape"):
        Channel("Speed", values)


def test_a_dataset_is_a_mapping_of_channels():
    data = bench(units={"Speed": "rpm"})
    assert list(data) == ["Speed", "Torque"]
    assert len(data) == 2
    assert data["Speed"].unit == "rpm"
    assert data["Torque"].unit == ""
    assert data.samples == 3
    assert (data.weight, data.use, data.time, data.scored) == (1.0, "training", None, None)


def test_a_data_frame_is_a_source():
    pandas = pytest.importorskip("pandas")
    data = Dataset.of("bench", pandas.DataFrame({"Speed": [1, 2], 7: [3.0, 4.0]}))
    assert list(data) == ["Speed", "7"]


def test_an_unknown_channel_is_named_with_the_nearest():
    with pytest.raises(KeyError, match=r"Sped is not a channel of dataset bench. Did you mean Speed\?"):
        bench()["Sped"]
    assert "Sped" not in bench()


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"time": np.zeros(2)}, r"time of dataset bench has shape \(2,\), its channels have 3 samples"),
        ({"time": np.zeros((3, 1))}, r"time of dataset bench has shape \(3, 1\)"),
        ({"time": [0.0, 1.0, 1.0]}, "time of dataset bench does not increase at sample 2: 1 s, then 1 s"),
        ({"time": [0.0, -1.0, 1.0]}, "does not increase at sample 1: 0 s, then -1 s"),
        ({"time": [0.0, np.nan, 1.0]}, "does not increase at sample 1: 0 s, then nan s"),
        ({"weight": -1.0}, "weight=-1 of dataset bench must be a finite number >= 0"),
        ({"weight": np.nan}, "weight=nan of dataset bench"),
        ({"weight": np.inf}, "weight=inf of dataset bench"),
        ({"piece_starts": []}, r"piece_starts=\[\] of dataset bench must rise from 0 within 3 samples"),
        ({"piece_starts": [1]}, r"piece_starts=\[1\]"),
        ({"piece_starts": [0, 0]}, r"piece_starts=\[0, 0\]"),
        ({"piece_starts": [0, 2, 1]}, r"piece_starts=\[0, 2, 1\]"),
        ({"piece_starts": [0, 3]}, r"piece_starts=\[0, 3\]"),
        ({"scored": [True]}, "scored of dataset bench must have one entry per sample, 3"),
    ],
)
def test_contradictory_attributes_are_refused(attributes, message):
    with pytest.raises(ArgumentError, match=message):
        bench(**attributes)


def test_channels_of_different_length_are_refused():
    with pytest.raises(ArgumentError, match="channels of dataset bench differ in length: a 1, b 2"):
        Dataset.of("bench", {"a": [1], "b": [1, 2]})


def test_a_duplicate_channel_is_refused():
    with pytest.raises(ArgumentError, match="dataset bench has channel a twice"):
        Dataset("bench", (Channel("a", [1]), Channel("a", [2])))


def test_an_unknown_use_is_refused():
    with pytest.raises(ArgumentError, match="validation"):
        bench(use="validation")


def test_time_may_start_again_at_a_piece():
    data = bench(time=[5.0, 6.0, 0.0], piece_starts=[0, 2])
    assert data.time.tolist() == [5.0, 6.0, 0.0]
    assert list(data.pieces) == [slice(0, 2), slice(2, 3)]


def test_time_without_channels_counts_samples():
    data = Dataset("clock", (), time=np.array([0.0, 0.1]))
    assert data.samples == 2


def test_time_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        bench(time=[0.0, 1.0, 2.0]).time[0] = 3


@pytest.mark.parametrize("attribute", ["piece_starts", "scored"])
def test_a_dataset_keeps_its_own_copy_of_arrays(attribute):
    source = np.array([0, 1]) if attribute == "piece_starts" else np.array([True, False, True])
    kept = source.copy()
    data = bench(**{attribute: source})
    source[-1] = 0
    np.testing.assert_array_equal(getattr(data, attribute), kept)


def test_a_dataset_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        bench().weight = 2.0


def test_an_empty_dataset_has_one_empty_piece():
    data = Dataset("none", ())
    assert data.samples == 0
    assert list(data.pieces) == [slice(0, 0)]


def test_channels_are_added_and_replaced():
    data = bench(weight=3.0).with_channels(Channel("Speed", [1, 2, 3]), Channel("Load", [4, 5, 6]))
    assert list(data) == ["Speed", "Torque", "Load"]
    assert data["Speed"].values.tolist() == [1, 2, 3]
    assert data.weight == 3.0
    with pytest.raises(ArgumentError, match="differ in length"):
        data.with_channels(Channel("Short", [1]))


@pytest.mark.parametrize("chosen", [np.array([2, 0]), [2, 0]])
def test_samples_of_steady_data_are_picked_in_order(chosen):
    data = bench(scored=np.array([True, False, False]), piece_starts=[0, 2]).select(chosen)
    assert data["Speed"].values.tolist() == [3000, 1000]
    assert data.scored.tolist() == [False, True]
    assert data.piece_starts.tolist() == [0]


def test_a_mask_picks_samples():
    assert bench().select([True, False, True])["Speed"].values.tolist() == [1000, 3000]
    assert bench().select(np.zeros(3, bool)).samples == 0


def test_scored_may_be_given_as_a_list():
    assert bench(scored=[True, False, True]).select([1]).scored.tolist() == [False]


def test_samples_with_time_cannot_be_picked():
    with pytest.raises(ArgumentError, match="dataset bench has time stamps"):
        bench(time=[0.0, 1.0, 2.0]).select([0])


def test_recordings_join_as_pieces_over_the_channels_they_share():
    one = Dataset.of("one", {"a": [1, 2], "b": [3, 4]}, units={"a": "s"}, time=[0.0, 1.0], weight=2.0, use="test")
    two = Dataset.of("two", {"c": [0, 0, 0], "a": [5, 6, 7]}, time=[0.5, 0.7, 0.1], piece_starts=[0, 2])
    data = concatenate("all", [one, two])
    assert list(data) == ["a"]
    assert data["a"].values.tolist() == [1, 2, 5, 6, 7]
    assert data["a"].unit == "s"
    assert data.piece_starts.tolist() == [0, 2, 4]
    assert data.time.tolist() == [0.0, 1.0, 0.5, 0.7, 0.1]
    assert (data.name, data.weight, data.use) == ("all", 2.0, "test")


def test_joined_recordings_keep_their_scored_samples():
    one, two = bench(scored=np.array([True, False, True])), bench()
    assert concatenate("all", [one, two]).scored.tolist() == [True, False, True, True, True, True]
    assert concatenate("all", [two, two]).scored is None


def test_recordings_with_and_without_time_do_not_join():
    with pytest.raises(ArgumentError, match="dataset all mixes recordings with and without time stamps"):
        concatenate("all", [bench(), bench(time=[0.0, 1.0, 2.0])])


def test_no_recording_makes_no_dataset():
    with pytest.raises(ArgumentError, match="dataset all needs at least one recording"):
        concatenate("all", [])


@pytest.mark.parametrize("warmup", [-1.0, float("nan"), float("inf")])
def test_a_warmup_is_a_number_of_seconds(warmup):
    with pytest.raises(ArgumentError, match="warmup"):
        Dataset.of("d", {"u": [1.0]}, time=[0.0], warmup=warmup)
