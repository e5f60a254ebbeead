"""Dataclasses behave as those of the standard library."""

import copy
import dataclasses
import inspect
import pickle
from dataclasses import FrozenInstanceError, field, fields, replace
from functools import cached_property

import pytest
from hypothesis import strategies as st

from kennfeld.base.lazy_dataclass import _deferred_dataclass as deferred
from kennfeld.base.lazy_dataclass import dataclass
from tests.draws import few_or_many

NAMES = ("missing", "beta", "method", "set_field", "default_beta")


@dataclass(frozen=True)
class Point:
    """A point."""

    x: float
    y: float = 1.0
    names: tuple[str, ...] = field(default_factory=tuple, compare=False)

    @cached_property
    def length(self) -> float:
        """The distance from the origin."""
        return float((self.x**2 + self.y**2) ** 0.5)


@dataclass(frozen=True)
class Named(Point):
    """A point with a name."""

    name: str = "P"

    def __post_init__(self):
        object.__setattr__(self, "name", self.name.upper())


def settings():
    """Fields in an order that Python admits: name, default, keyword alone, in comparisons, in the text, in init."""
    kinds = st.sampled_from(["required", "default", "factory"])
    one = st.tuples(kinds, st.booleans(), st.booleans(), st.booleans())
    return st.lists(one, min_size=1, max_size=len(NAMES))


def build(decorator, described, **arguments):
    """Return a class with fields as described."""
    members, annotations, optional = {}, {}, False
    for name, (kind, keyword, compared, shown) in zip(NAMES, described, strict=False):
        optional |= kind != "required"
        default = {"required": {}, "default": {"default": 7}, "factory": {"default_factory": list}}[kind]
        keyword |= kind == "required" and optional  # it cannot follow one with a default
        members[name] = field(kw_only=keyword, compare=compared, repr=shown, **default)
        annotations[name] = object
    return decorator(**arguments)(type("Built", (), {**members, "__annotations__": annotations, "__doc__": "Built."}))


@few_or_many(settings(), st.booleans(), st.booleans(), st.data(), few=20, many=100)
def test_any_fields_give_the_methods_of_the_standard_library(described, frozen, eq, data):
    own, standard = (build(each, described, frozen=frozen, eq=eq) for each in (deferred, dataclasses.dataclass))
    assert str(inspect.signature(own)) == str(inspect.signature(standard))
    values = [
        {f.name: data.draw(st.integers(0, 1)) for f in fields(standard) if f.default is dataclasses.MISSING}
        for _ in range(2)
    ]
    first, second = (own(**each) for each in values)
    expected, other = (standard(**each) for each in values)
    assert repr(first) == repr(expected)
    assert (first == second) == (expected == other)
    assert (own.__hash__ is None) == (standard.__hash__ is None)
    if frozen and eq:
        assert hash(first) == hash(expected)
    assert vars(first) == vars(expected)


def test_required_fields_must_be_set():
    with pytest.raises(TypeError, match=r"Point\.__init__\(\) missing 1 required positional argument: 'x'"):
        Point()


def test_frozen_fields_are_neither_assigned_nor_deleted():
    point = Point(1.0)
    with pytest.raises(FrozenInstanceError, match="cannot assign to field 'x'"):
        point.x = 2.0
    with pytest.raises(FrozenInstanceError, match="cannot delete field 'x'"):
        del point.x


def test_other_fields_are_assigned():
    @dataclass
    class Counter:
        count: int = 0
        steps: list[int] = field(default_factory=list, init=False)

    counter = Counter()
    counter.count += 1
    counter.steps.append(1)
    assert (counter, Counter().steps) == (counter, [])
    assert repr(counter).endswith("Counter(count=1, steps=[1])")
    with pytest.raises(TypeError, match="unhashable"):
        hash(counter)


def test_a_class_inherits_fields_and_properties():
    named = Named(3.0, 4.0, name="q")
    assert (named.length, named.name, [f.name for f in fields(named)]) == (5.0, "Q", ["x", "y", "names", "name"])
    assert named != Point(3.0, 4.0)
    assert Point(3.0, 4.0) == Point(3.0, 4.0, ("other",))
    assert len({Point(1.0), Point(1.0), Point(2.0)}) == 2


def test_classes_of_the_standard_library_inherit_as_from_their_own():
    @dataclasses.dataclass(frozen=True)
    class Weighted(Point):
        weight: float = 2.0

    assert repr(Weighted(1.0)).endswith("Weighted(x=1.0, y=1.0, names=(), weight=2.0)")
    with pytest.raises(TypeError, match="cannot inherit non-frozen dataclass from a frozen one"):
        dataclasses.dataclass(type("Loose", (Point,), {}))
    with pytest.raises(TypeError, match="cannot inherit non-frozen dataclass from a frozen one"):
        dataclass(type("Loose", (Point,), {}))


def test_instances_are_replaced_copied_and_pickled():
    named = Named(3.0, name="q")
    assert replace(named, x=1.0) == Named(1.0, name="q")
    assert copy.deepcopy(named) == pickle.loads(pickle.dumps(named)) == named


def test_methods_of_the_class_itself_are_kept():
    @dataclass(frozen=True)
    class Plain:
        value: int

        def __eq__(self, other):
            return True

        def __hash__(self):
            return 1

        def __repr__(self):
            return "plain"

    assert (repr(Plain(1)), hash(Plain(2)), Plain(1) == Plain(2)) == ("plain", 1, True)


def test_a_class_may_have_an_init_of_its_own():
    @dataclass(frozen=True, init=False)
    class Doubled:
        value: int

        def __init__(self, half):
            object.__setattr__(self, "value", 2 * half)

    assert Doubled(2).value == 4


def test_instances_are_matched_by_position():
    match Point(1.0, 2.0):
        case Point(x, y):
            assert (x, y) == (1.0, 2.0)


def test_signature_and_annotations_are_those_of_the_fields():
    assert str(inspect.signature(Named)).startswith("(x: float, y: float = 1.0, names: tuple[str, ...] = ")
    assert Named.__init__.__qualname__ == "Named.__init__"


def test_a_recursive_instance_is_shown():
    @dataclass
    class Node:
        following: object = None

    node = Node()
    node.following = node
    assert repr(node).endswith("Node(following=...)")


def test_no_method_is_written_before_its_first_call():
    @dataclass(frozen=True)
    class Unused:
        value: int

    assert type(vars(Unused)["__init__"]).__name__ == "_Deferred"
    Unused(1)
    assert inspect.isfunction(vars(Unused)["__init__"])
    assert type(vars(Unused)["__repr__"]).__name__ == "_Deferred"
