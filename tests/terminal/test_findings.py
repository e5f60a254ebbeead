from dataclasses import replace

from kennfeld.optimize.trust import Direction, Trust
from kennfeld.terminal.findings import left_open

ONE = Direction("Scaling A by 1.01 changes nothing.", "Pin a value of A.", {}, True, 0.0, float("inf"))


def test_nothing_is_said_where_nothing_is_open():
    assert left_open(Trust()) == []


def test_each_direction_is_a_line_with_its_mend():
    heading, line = left_open(Trust(directions=(ONE,)))
    assert heading == "What the data leave open:"
    assert line == "  Scaling A by 1.01 changes nothing. Pin a value of A."


def test_at_most_three_are_shown_and_the_rest_is_counted():
    many = tuple(replace(ONE, sentence=f"Number {i}.") for i in range(8))
    _, *lines, last = left_open(Trust(directions=many))
    assert [line.split(". ")[0].strip() for line in lines] == [f"Number {i}" for i in range(3)]
    assert last == "  and 5 more; see result.json"
