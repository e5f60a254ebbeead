import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import StaticSurrogate, read_surrogate, recognises_surrogate, write_surrogate
from kennfeld.surrogate.uncertainty import Uncertainty
from tests.surrogate.surrogates import dynamic_surrogate, random_expansion, static_surrogate


@pytest.mark.parametrize("made", [static_surrogate(), dynamic_surrogate(), dynamic_surrogate(validity=None, units=())])
def test_a_surrogate_comes_back_as_it_was(made, tmp_path):
    path = tmp_path / "model.json"
    write_surrogate(made, path)
    read = read_surrogate(path)
    assert type(read) is type(made)
    assert read.expansion == made.expansion
    assert repr(read.quality) == repr(made.quality)
    for name in set(vars(made)) - {"expansion", "validity", "quality", "_looks"}:
        assert getattr(read, name) == getattr(made, name)
    if made.validity is not None:
        x = np.random.default_rng(0).normal(size=(20, made.expansion.inputs))
        np.testing.assert_array_equal(read.validity.distance(x), made.validity.distance(x))
    first = path.read_text("utf-8")
    write_surrogate(read, path)
    assert path.read_text("utf-8") == first
    assert recognises_surrogate(first)
    assert [one.name for one in tmp_path.iterdir()] == ["model.json"]


finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=30)
@given(
    offset=finite,
    weights=arrays.arrays(np.float64, 3, elements=finite),
    widths=arrays.arrays(np.float64, (3, 1), elements=st.floats(5e-324, 1e308)),
)
def test_every_number_comes_back_bit_for_bit(offset, weights, widths, tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "model.json"
    expansion = Expansion(offset, [1 / 3], weights, [[0.1], [-0.0], [1e-310]], widths)
    write_surrogate(StaticSurrogate("f", ("x",), "y", (), expansion), path)
    assert read_surrogate(path).expansion == expansion


def test_a_plane_without_centres_can_be_stored(tmp_path):
    expansion = Expansion(1.0, [2.0, 3.0], [], np.empty((0, 2)), np.empty((0, 2)))
    write_surrogate(StaticSurrogate("f", ("a", "b"), "y", (), expansion), tmp_path / "f.json")
    assert read_surrogate(tmp_path / "f.json").expansion == expansion


def uncertain_surrogate():
    e = random_expansion(0, 2, 3)
    expansion = Expansion(e.offset, e.slopes, e.weights, e.centres, e.widths, "matern52")
    uncertainty = Uncertainty(1.5, 1 / 3, [0.01, 0.02, 1e-8])
    return StaticSurrogate("f", ("a", "b"), "y", (), expansion, None, (), uncertainty, ("a remark",))


def test_kernel_deviation_and_remarks_come_back_as_they_were(tmp_path):
    surrogate, path = uncertain_surrogate(), tmp_path / "f.json"
    write_surrogate(surrogate, path)
    read = read_surrogate(path)
    assert (read.expansion, read.remarks) == (surrogate.expansion, surrogate.remarks)
    x = np.random.default_rng(0).normal(size=(9, 2))
    np.testing.assert_array_equal(read.deviation(x), surrogate.deviation(x))
    assert np.all(read.deviation(x) >= 1 / 3)


def test_a_file_of_another_kernel_is_not_read_as_one_of_version_1(tmp_path):
    write_surrogate(uncertain_surrogate(), tmp_path / "f.json")
    write_surrogate(static_surrogate(), tmp_path / "g.json")
    contents = [json.loads((tmp_path / name).read_text("utf-8")) for name in ("f.json", "g.json")]
    assert [content["version"] for content in contents] == [2, 1]
    assert not {"kernel", "uncertainty", "remarks"} & {*contents[1], *contents[1]["expansion"]}


def test_hinges_come_back_in_a_file_that_earlier_readers_refuse(tmp_path):
    e = random_expansion(0, 2, 3)
    hinges = ((1, 1 / 3, -2.0), (0, 0.1, 1e-7))
    bent = Expansion(e.offset, e.slopes, e.weights, e.centres, e.widths, "matern52", hinges)
    write_surrogate(StaticSurrogate("f", ("a", "b"), "y", (), bent), tmp_path / "f.json")
    assert read_surrogate(tmp_path / "f.json").expansion == bent
    assert json.loads((tmp_path / "f.json").read_text("utf-8"))["version"] == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["expansion"].update(kernel="cosine"), "kernel='cosine' of an expansion must be gaussian or"),
        (lambda c: c["uncertainty"].update(noise=-1), "noise=-1.0 of an uncertainty must be a finite number >= 0"),
        (lambda c: c["uncertainty"].update(nugget=[1.0]), "nugget of an uncertainty must be one number per centre, 3"),
        (lambda c: c["uncertainty"].update(nugget=[0, 1, 1]), "must be one number > 0 per centre"),
        (lambda c: c["uncertainty"].pop("signal"), "uncertainty signal: is missing"),
        (lambda c: c.update(remarks=7), "remarks: must be a list of texts, got 7"),
    ],
)
def test_a_broken_uncertainty_is_reported(tmp_path, change, message):
    path = broken(tmp_path, change, uncertain_surrogate())
    with pytest.raises(InputError, match=re.escape(message)):
        read_surrogate(path)


def test_a_dynamic_surrogate_has_gaussian_bells():
    e = random_expansion(1, 5, 4)
    matern = Expansion(e.offset, e.slopes, e.weights, e.centres, e.widths, "matern52")
    with pytest.raises(ArgumentError, match="kernel='matern52' of dynamic surrogate engine must be gaussian"):
        dynamic_surrogate(expansion=matern)


def broken(tmp_path, change, surrogate=None):
    path = tmp_path / "model.json"
    write_surrogate(surrogate or dynamic_surrogate(), path)
    content = json.loads(path.read_text("utf-8"))
    change(content)
    path.write_text(json.dumps(content), "utf-8")
    with pytest.raises(InputError) as caught:
        read_surrogate(path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("expansion"), "model.json expansion: is missing"),
        (lambda c: c.update(kind="kennfeld-dynamc-surrogate"), "Did you mean kennfeld-dynamic-surrogate?"),
        (
            lambda c: c.update(version=7),
            "model.json version: version 7 is not supported, only 1, 2 and 3. Update kennfeld.",
        ),
        (
            lambda c: c["expansion"].update(offset=None),
            "model.json expansion offset: must be a finite number, got None",
        ),
        (lambda c: c["expansion"]["weights"].append("x"), "model.json expansion weights:"),
        (lambda c: c["expansion"]["weights"].append(1.0), "centres of an expansion have shape (4, 5)"),
        (lambda c: c["expansion"]["widths"][0].__setitem__(0, -1), "widths of an expansion must be > 0"),
        (lambda c: c["expansion"]["centres"][0].pop(), "model.json expansion centres:"),
        (lambda c: c["validity"].update(threshold=3), "threshold=3.0 of a validity range"),
        (lambda c: c["quality"][0].update(use="never"), "model.json quality 1: unknown use 'never'"),
        (lambda c: c.update(lags=[[0, 2], [1.5]]), "model.json lags 2: must be a list of whole numbers, got [1.5]"),
        (lambda c: c.update(lags=[[0, 2]]), "one tuple for each of 2 inputs"),
        (lambda c: c.update(step="fast"), "model.json step: must be a finite number, got 'fast'"),
        (lambda c: c.update(limits=[1]), "model.json limits: must be two numbers or null, got [1]"),
        (lambda c: c.update(inputs="throttle"), "model.json inputs: must be a list of texts, got 'throttle'"),
        (lambda c: c.update(expansion=None), "model.json expansion: must be a table, got None"),
        (lambda c: c.update(name=None), "model.json name: must be text, got None"),
        (lambda c: c.update(lags=[[0, 2], None]), "model.json lags 2: must be a list of whole numbers, got None"),
        (lambda c: c.update(limits=[False, 9]), "model.json limits: must be two numbers or null, got [False, 9]"),
        (
            lambda c: c["expansion"].update(weights=None),
            "expansion weights: must be a list of finite numbers, got None",
        ),
        (lambda c: c["expansion"].update(slopes=["1"] * 5), "expansion slopes: must be a list of finite numbers, got"),
        (lambda c: c["expansion"].update(hinge=[[0, 1, 2]]), "expansion hinge: unknown key. Did you mean hinges?"),
        (
            lambda c: c["expansion"].update(hinges=None),
            "must be a list of rows of input, position and height, got None",
        ),
        (lambda c: c["expansion"].update(hinges=[[0, "1", 2]]), "must be a list of rows of input, position and height"),
    ],
)
def test_a_broken_file_is_reported_with_its_place(change, message, tmp_path):
    assert message in broken(tmp_path, change)


def test_all_problems_are_reported_at_once(tmp_path):
    def change(content):
        content["step"], content["start"] = "fast", None
        del content["output"]

    message = broken(tmp_path, change)
    assert len(message.splitlines()) == 3
    assert "train" in message.casefold()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'{"kind": ', "model.json line 1, column 10: this is not valid JSON"),
        (b"[]", "model.json: this is not a surrogate file"),
        (b"\xff\xfe", "model.json: this is not UTF-8 text"),
    ],
)
def test_a_file_other_than_a_surrogate_is_reported(text, message, tmp_path):
    (tmp_path / "model.json").write_bytes(text)
    with pytest.raises(InputError) as caught:
        read_surrogate(tmp_path / "model.json")
    assert message in str(caught.value)


def test_a_missing_file_offers_the_nearest_name(tmp_path):
    write_surrogate(static_surrogate(), tmp_path / "engine.json")
    with pytest.raises(InputError, match=r"Did you mean engine\.json\?"):
        read_surrogate(tmp_path / "engin.json")
    with pytest.raises(InputError, match="cannot be written"):
        write_surrogate(static_surrogate(), tmp_path / "missing" / "engine.json")


def test_the_file_is_readable(tmp_path):
    write_surrogate(dynamic_surrogate(expansion=random_expansion(1, 5, 30)), tmp_path / "model.json")
    lines = (tmp_path / "model.json").read_text("utf-8").splitlines()
    assert 60 < len(lines) < 400
    assert '  "output_lags": [1, 3],' in lines
