import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from kennfeld.domain import parameter_set as module
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet, use_writer
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar, parameter
from kennfeld.domain.texts import Text
from tests.draws import mostly_slow


def tables():
    x, y = [0.0, 1.0], [0.0, 1.0, 2.0]
    return [
        Scalar("K", 1.5),
        Block("B", [1.0, 2.0]),
        Curve("C", x, [1, 2]),
        Map("M", x, y, np.arange(6).reshape(2, 3)),
        Cube("Q3", [x, y, x], np.zeros((2, 3, 2))),
        Cube("Q4", [x, x, x, y], np.zeros((2, 2, 2, 3))),
    ]


def test_every_table_states_its_kind():
    assert [p.kind for p in tables()] == ["scalar", "block", "curve", "map", "cube", "cube"]
    assert [p.size for p in tables()] == [1, 2, 2, 6, 12, 24]
    assert [len(p.axes) for p in tables()] == [0, 0, 1, 2, 3, 4]
    assert [len(p.index_axes) for p in tables()] == [0, 1, 1, 2, 3, 4]


def test_a_scalar_has_a_value():
    assert Scalar("K", 2).value == 2.0
    assert isinstance(Scalar("K", 2).value, float)


def test_a_map_holds_x_first():
    table = Map("M", [10, 20], [1, 2, 3], [[11, 12, 13], [21, 22, 23]])
    assert table.values[1, 0] == 21


def test_a_block_is_searched_by_position():
    block = Block("B", np.zeros((2, 3)))
    assert [axis.breakpoints.tolist() for axis in block.index_axes] == [[0.0, 1.0], [0.0, 1.0, 2.0]]


@pytest.mark.parametrize("values", [3.0, np.zeros((1, 1, 1, 1, 1))])
def test_a_block_has_one_to_four_dimensions(values):
    with pytest.raises(ArgumentError, match=f"value block B needs one to four dimensions, got {np.ndim(values)}"):
        Block("B", values)


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_a_cube_has_three_or_four_axes(count):
    with pytest.raises(ArgumentError, match=f"cube Q needs 3 or 4 axes, got {count}"):
        Cube("Q", [[0, 1]] * count, np.zeros((2,) * count))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Curve("C", [0, 1], [1, 2, 3]), r"C has values of shape \(3,\), its axes require \(2,\)"),
        (
            lambda: Map("M", [0, 1], [0, 1, 2], np.zeros((3, 2))),
            r"M has values of shape \(3, 2\), its axes require \(2, 3\)",
        ),
        (lambda: Scalar("K", [1.0]), r"K has values of shape \(1,\), its axes require \(\)"),
        (lambda: Curve("C", [0, 1], [1, 2], lower=[0, 0, 0]), r"lower of C has shape \(3,\), its values have \(2,\)"),
        (lambda: Curve("C", [0, 1], [1, 2], upper=np.zeros((2, 2))), r"upper of C has shape \(2, 2\)"),
        (lambda: Curve("C", [0, 1], [1, 2], locked=[True] * 3), r"locked of C has shape \(3,\)"),
        (
            lambda: Curve("C", [0, 1], [1, 2], lower=[0, 3], upper=2),
            r"C\[1\] has the lower bound 3 above its upper bound 2",
        ),
        (lambda: Scalar("K", 1, lower=2, upper=1), "K has the lower bound 2 above its upper bound 1"),
        (
            lambda: Map("M", [0, 1], [0, 1], np.zeros((2, 2)), lower=[[0, 0], [0, 9]], upper=1),
            r"M\[1, 1\] has the lower bound 9",
        ),
        (lambda: Scalar("K", 1, lower=np.nan), "K has the lower bound nan"),
    ],
)
def test_contradictory_attributes_are_refused(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()


def test_an_unknown_extrapolation_is_refused():
    with pytest.raises(ArgumentError, match="lineer"):
        Curve("C", [0, 1], [1, 2], extrapolation="lineer")


def test_bounds_and_locks_are_spread_over_the_values():
    table = Map("M", [0, 1], [0, 1, 2], np.zeros((2, 3)), lower=-1, upper=[1, 2, 3], locked=[[True], [False]])
    assert table.lower.tolist() == [[-1.0] * 3] * 2
    assert table.upper.tolist() == [[1.0, 2.0, 3.0]] * 2
    assert table.locked.tolist() == [[True] * 3, [False] * 3]


def test_without_bounds_everything_is_allowed():
    assert (Scalar("K", 1).lower, Scalar("K", 1).upper, Scalar("K", 1).locked) == (-np.inf, np.inf, False)


@pytest.mark.parametrize("frozen", tables(), ids=lambda p: p.name)
def test_a_parameter_cannot_be_changed(frozen):
    with pytest.raises(dataclasses.FrozenInstanceError):
        frozen.unit = "Nm"
    for array in (frozen.values, frozen.lower, frozen.upper, frozen.locked):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_values_at_a_bound_are_neither_locked_nor_fixed_by_equal_bounds():
    curve = Curve("C", range(6), [0, 1, 5, 6, 1, 2], lower=[1, 1, 1, 1, 1, 2], upper=[5, 5, 5, 5, 5, 2])
    assert curve.at_bound.tolist() == [True, True, True, True, True, False]
    assert curve.changed(locked=np.arange(6) < 2).at_bound.tolist() == [False, False, True, True, True, False]
    assert not Scalar("K", 1.0).at_bound


@pytest.mark.parametrize("attribute", ["values", "lower", "upper", "locked"])
def test_a_parameter_keeps_its_own_copy_of_arrays(attribute):
    source = np.zeros(2, dtype=bool if attribute == "locked" else float)
    table = Curve("C", [0, 1], **({"values": np.zeros(2)} | {attribute: source}))
    source[:] = 1
    assert not getattr(table, attribute).any()


@pytest.mark.parametrize("original", tables(), ids=lambda p: p.name)
def test_other_values_leave_the_rest(original):
    bounded = original.with_bounds(-5, 50)
    other = bounded.with_values(bounded.values + 1)
    assert type(other) is type(original)
    assert np.array_equal(other.values, original.values + 1)
    assert np.array_equal(other.lower, bounded.lower)
    assert other.axes == original.axes
    assert bounded.with_values((original.values + 1).ravel()) == other


def test_values_of_another_size_are_refused_by_name():
    with pytest.raises(ArgumentError, match="C"):
        Curve("C", [0, 1], [1, 2]).with_values([1, 2, 3])


def test_values_of_a_transposed_shape_are_refused():
    with pytest.raises(ArgumentError, match="M"):
        Map("M", [0, 1], [0, 1, 2], np.zeros((2, 3))).with_values(np.arange(6).reshape(3, 2))


def test_other_bounds_replace_both():
    table = Curve("C", [0, 1], [1, 2]).with_bounds(lower=0, upper=[3, 4])
    assert (table.lower.tolist(), table.upper.tolist()) == ([0, 0], [3, 4])
    assert table.with_bounds().upper.tolist() == [np.inf, np.inf]


def test_changed_checks_again():
    with pytest.raises(ArgumentError, match="its axes require"):
        Curve("C", [0, 1], [1, 2]).changed(axes=(Axis([0, 1, 2]),))


def test_changed_keeps_the_kind():
    other = Map("M", [0, 1], [0, 1], np.zeros((2, 2))).changed(name="N", unit="Nm", extrapolation="linear")
    assert (type(other), other.name, other.unit, other.extrapolation) == (Map, "N", "Nm", "linear")


@pytest.mark.parametrize(
    "change",
    [{"name": "D"}, {"unit": "s"}, {"description": "d"}, {"values": np.array([1.0, 3.0])}, {"lower": np.array(0.0)},
     {"upper": np.array(9.0)}, {"locked": np.array(True)}, {"extrapolation": "linear"}, {"axes": (Axis([0, 2]),)}],
)  # fmt: skip
def test_parameters_are_equal_by_everything_they_hold(change):
    table = Curve("C", [0, 1], [1, 2])
    assert table == Curve("C", [0, 1], [1, 2])
    assert hash(table) == hash(Curve("C", [0, 1], [1, 2]))
    assert table.changed(**change) != table


def test_values_that_are_not_numbers_are_equal():
    assert Curve("C", [0, 1], [1, np.nan]) == Curve("C", [0, 1], [1, np.nan])


def test_kinds_differ():
    assert Block("C", [1, 2]) != Curve("C", [0, 1], [1, 2])
    assert Scalar("K", 1) != 1


def test_parameter_picks_the_kind_by_the_axes():
    built = [parameter("P", np.zeros((2,) * n), [Axis([0, 1])] * n) for n in range(5)]
    assert [type(p) for p in built] == [Scalar, Curve, Map, Cube, Cube]
    with pytest.raises(ArgumentError, match="P has 5 axes; tables have at most 4"):
        parameter("P", np.zeros((2,) * 5), [Axis([0, 1])] * 5)


def test_parameter_hands_attributes_on():
    assert parameter("K", 2.0, unit="s", lower=1.0).lower == 1.0


def test_a_set_is_a_mapping_in_order():
    parameters = ParameterSet([Scalar("b", 1), Scalar("a", 2)])
    assert list(parameters) == ["b", "a"]
    assert len(parameters) == 2
    assert "a" in parameters
    assert "c" not in parameters
    assert parameters["a"].value == 2
    assert parameters.get("c") is None


def test_a_set_asks_for_the_nearest_name():
    with pytest.raises(KeyError, match=r"MapOptTorqe is not a parameter of this set. Did you mean MapOptTorque\?"):
        ParameterSet([Scalar("MapOptTorque", 1)])["MapOptTorqe"]
    with pytest.raises(KeyError, match=r"'x is not a parameter of this set\.'"):
        ParameterSet()["x"]


def test_a_duplicate_name_is_refused():
    with pytest.raises(ArgumentError, match="parameter K is defined twice"):
        ParameterSet([Scalar("K", 1), Scalar("K", 1)])


def test_group_axes_are_shared_by_name():
    group = Axis([0, 1], name="G")
    parameters = ParameterSet([Curve("A", group, [1, 2]), Curve("B", Axis([0, 1], name="G"), [1, 2])])
    assert parameters.axes == (group,)


def test_tables_that_disagree_on_a_group_axis_are_refused():
    message = r"group axis G has different breakpoints in B and in A: \[0.0, 2.0\] and \[0.0, 1.0\]"
    with pytest.raises(ArgumentError, match=message):
        ParameterSet([Curve("A", Axis([0, 1], name="G"), [1, 2]), Curve("B", Axis([0, 2], name="G"), [1, 2])])
    with pytest.raises(ArgumentError, match="G has different breakpoints in the set and in A"):
        ParameterSet([Curve("A", Axis([0, 1], name="G"), [1, 2])], axes=[Axis([5, 6], name="G")])


def test_group_axes_without_a_table_are_kept():
    spare = Axis([5, 6], name="spare")
    assert ParameterSet([], axes=[spare, Axis([1, 2])]).axes == (spare,)


def test_sets_are_equal_by_what_they_hold():
    def sample_set(value=1, text="t", axis=5):
        return ParameterSet([Scalar("K", value)], [Text("T", text)], [Axis([axis, 9], name="G")])

    assert sample_set() == sample_set()
    assert hash(sample_set()) == hash(sample_set())
    assert sample_set() != sample_set(value=2)
    assert sample_set() != sample_set(text="u")
    assert sample_set() != sample_set(axis=6)
    assert sample_set() != {"K": 1}


def test_merging_replaces_in_place_and_appends():
    first = ParameterSet([Scalar("a", 1), Scalar("b", 2)], [Text("s", "old"), Text("t", "keep")])
    second = ParameterSet([Scalar("c", 4), Scalar("a", 3)], [Text("s", "new")])
    merged = first.merged(second)
    assert [(name, p.value) for name, p in merged.items()] == [("a", 3), ("b", 2), ("c", 4)]
    assert merged.texts == (Text("s", "new"), Text("t", "keep"))
    assert list(first) == ["a", "b"]


def test_merging_takes_the_group_axis_of_the_newer_tables():
    old, new = Axis([0, 1], name="G"), Axis([0, 2], name="G")
    merged = ParameterSet([Curve("A", old, [1, 2])]).merged(ParameterSet([Curve("A", new, [1, 2])]))
    assert merged.axes == (new,)


def test_merging_sets_whose_tables_disagree_on_a_group_axis_is_refused():
    with pytest.raises(ArgumentError, match="group axis G"):
        ParameterSet([Curve("A", Axis([0, 1], name="G"), [1, 2])]).with_parameters(
            Curve("B", Axis([0, 2], name="G"), [1, 2])
        )


def test_with_parameters_replaces_and_adds():
    parameters = ParameterSet([Scalar("a", 1)]).with_parameters(Scalar("a", 2), Scalar("b", 3))
    assert [p.value for p in parameters.values()] == [2, 3]


def test_select_keeps_the_order_asked_for():
    parameters = ParameterSet([Scalar("a", 1), Scalar("b", 2), Scalar("c", 3)])
    assert list(parameters.select(["c", "a"])) == ["c", "a"]
    with pytest.raises(KeyError, match="d is not a parameter"):
        parameters.select(["d"])


def test_saving_hands_the_set_to_the_writer(monkeypatch):
    written = []
    monkeypatch.setattr(module, "_writer", None)
    monkeypatch.setattr(module, "_FORMATS", "kennfeld.domain.parameters")
    parameters = ParameterSet([Scalar("a", 1)])
    with pytest.raises(ArgumentError, match="no calibration format is registered"):
        parameters.save("x.dcm")
    use_writer(lambda values, path: written.append((values, path)))
    parameters.save("x.dcm")
    assert written == [(parameters, Path("x.dcm"))]


@pytest.mark.parametrize("first", mostly_slow(["", "import kennfeld as kf; kf.InputError; "], 1))
def test_a_set_is_saved_by_whoever_imports_the_types_alone(tmp_path, first):
    imports = "from kennfeld.domain.parameter_set import ParameterSet; from kennfeld.domain.parameters import Scalar; "
    script = f"{first}{imports}ParameterSet([Scalar('a', 1)]).save('a.json')"
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["a"]["value"] == 1


def test_a_text_is_of_kind_text():
    assert (Text("T", "abc").kind, Text("T", "abc").description) == ("text", "")


def test_a_later_group_axis_must_agree_with_the_tables_that_stay():
    first = ParameterSet([Curve("D", Axis([1, 2], name="S"), [1, 2])])
    with pytest.raises(ArgumentError, match="group axis S has different breakpoints"):
        first.merged(ParameterSet(axes=[Axis([1, 3], name="S")]))
    moved = ParameterSet([Curve("D", Axis([1, 3], name="S"), [1, 2])])
    assert first.merged(moved).axes[0].breakpoints.tolist() == [1, 3]


def test_a_later_text_replaces_a_number_of_its_name_and_the_other_way_round():
    number, text = ParameterSet([Scalar("K", 1)]), ParameterSet(texts=[Text("K", "a")])
    assert number.merged(text) == text
    assert text.merged(number) == number


def with_variants():
    first, second = (Scalar("K", value, variant=f"Engine={value}") for value in (1, 2))
    return ParameterSet([first, Scalar("L", 3)], [Text("T", "a")], others=[second, Text("T", "b", variant="Engine=2")])


def test_a_variant_is_chosen_for_all_labels_that_have_it():
    chosen = with_variants().in_variant("Engine=2")
    assert (chosen["K"].value, chosen["L"].value, chosen.texts[0].text) == (2, 3, "b")
    assert chosen.everything == with_variants().everything
    assert sorted(chosen.variants) == ["Engine=1", "Engine=2"]


def test_an_unknown_variant_is_refused_with_those_that_there_are():
    with pytest.raises(ArgumentError, match=r"no parameter has the variant 'Engine=3'.*Engine=1, Engine=2"):
        with_variants().in_variant("Engine=3")


class ComparedName(str):
    """A name that counts how often it is hashed or compared."""

    count = 0

    def __hash__(self):
        ComparedName.count += 1
        return super().__hash__()

    def __eq__(self, other):
        ComparedName.count += 1
        return super().__eq__(other)


@pytest.mark.parametrize("choose", [ParameterSet.select, ParameterSet.without])
def test_a_choice_takes_each_variant_once(choose):
    names = [ComparedName(f"K{k}") for k in range(100)]
    values = ParameterSet(
        [Scalar(name, 1.0, variant="Engine=1") for name in names],
        others=[Scalar(name, 2.0, variant="Engine=2") for name in names],
    )
    ComparedName.count = 0
    assert len(choose(values, names[50:]).others) == 50
    assert ComparedName.count < 25 * len(names)  # 5 000 comparisons and more if each is compared with each


def test_new_values_without_a_variant_replace_those_that_count():
    merged = with_variants().with_parameters(Scalar("K", 7))
    assert (merged["K"].value, merged["K"].variant) == (7, "Engine=1")
    assert [thing.variant for thing in merged.others] == ["Engine=2", "Engine=2"]


def test_a_duplicate_variant_of_a_label_is_refused():
    with pytest.raises(ArgumentError, match="K is defined twice in the variant ''"):
        ParameterSet([Scalar("K", 1)], others=[Scalar("K", 2)])


def test_leaving_names_out_leaves_all_their_variants_out():
    assert [thing.name for thing in with_variants().without(["K"]).everything.values()] == ["L", "T", "T"]
    assert list(with_variants().select(["K"]).everything) == [("K", "Engine=1"), ("K", "Engine=2")]


def test_a_name_and_a_variant_are_a_key():
    assert with_variants()["K", "Engine=2"].value == 2
    with pytest.raises(KeyError, match="K is not a parameter of this set in the variant 'Engine=3'"):
        with_variants()["K", "Engine=3"]


@pytest.mark.parametrize("extrapolation", ["clip", "linear"])
def test_a_table_is_looked_up_as_by_the_function(extrapolation):
    rng = np.random.default_rng(3)
    table = kf.Map("M", [0, 1, 3], [5], rng.random((3, 1)), extrapolation=extrapolation)
    cube = kf.Cube("Q", [[0, 1], [0, 2, 3], [1, 2]], rng.random((2, 3, 2)), extrapolation=extrapolation)
    x, y, z = (rng.uniform(-1, 4, 40) for _ in range(3))
    x[0], x[1] = np.nan, 3.0
    nodes = kf.simulate("a = M(x, y)\nb = Q(x, y, z)", {"x": x[1:], "y": y[1:], "z": z[1:]}, [table, cube])
    np.testing.assert_allclose(table(x, y)[1:], nodes["a"].values, rtol=1e-13)
    np.testing.assert_allclose(cube(x, y, z)[1:], nodes["b"].values, rtol=1e-12)
    assert np.isnan(table(x, y)[0])
    assert table(1.0, 5.0) == table.values[1, 0]


def test_numpy_takes_a_parameter_for_its_values():
    curve = kf.Curve("C", [0, 1], [2.0, 3.0])
    assert np.asarray(curve).tolist() == [2.0, 3.0]
    assert np.asarray(curve, dtype=np.float32).dtype == np.float32
    assert float(kf.Scalar("K", 2.5)) == kf.Scalar("K", 2.5)() == 2.5


def test_texts_of_values_are_short():
    curve = kf.Curve("C", kf.Axis([0, 1], input="Speed"), [2.0, 3.0], unit="Nm")
    assert repr(curve) == "Curve('C', 2 values over Speed, unit='Nm')"
    many = kf.ParameterSet(kf.Scalar(f"K{i}", 1.0) for i in range(9))
    assert repr(many) == "ParameterSet(9 values: K0, K1, K2, K3, K4, K5 and 3 more)"
    data = kf.Dataset.of("bench", {"x": np.zeros(5000)}, time=np.arange(5000.0))
    assert repr(data) == "Dataset('bench', 5000 samples over 4999 s: x)"
    assert repr(kf.formula("y = a * x", parameters=["a"])) == "Model('formula', inputs: x; parameters: a; outputs: y)"
