from dataclasses import replace

from kennfeld.optimize.trust import ActiveLimit, Direction, NullSpace, Trust
from kennfeld.optimize.trust.undetermined import undetermined_lines

ONE = Direction("Scaling A by 1.01 has no effect on the fit.", "Pin a value of A.", {}, True, 0.0, float("inf"))


def lines_on(trust):
    return undetermined_lines(trust, "; see result.json")


def test_a_determined_fit_has_no_lines():
    assert lines_on(Trust()) == []


def test_each_direction_is_a_line_with_its_remedy():
    heading, line = lines_on(Trust(directions=(ONE,)))
    assert heading == "Parameters not determined by the data:"
    assert line == "  Scaling A by 1.01 has no effect on the fit. Pin a value of A."


def test_the_number_of_undetermined_changes_comes_first_with_its_remedy():
    space = NullSpace(7, sentence="7 combinations of values of A and B are undetermined.", advice="Pin all of B.")
    _, first, second = lines_on(Trust(directions=(ONE,), null_space=space))
    assert first == "  7 combinations of values of A and B are undetermined. Pin all of B."
    assert second == f"  {ONE}"


def test_the_only_change_is_listed_once():
    space = NullSpace(1, sentence="One combination of values of A is undetermined.", advice="Pin A.")
    assert lines_on(Trust(directions=(ONE,), null_space=space))[1:] == [f"  {ONE}"]


def test_at_most_three_directions_are_listed_and_the_others_counted():
    many = tuple(replace(ONE, sentence=f"Number {i}.") for i in range(8))
    _, *lines, last = lines_on(Trust(directions=many))
    assert [line.split(". ")[0].strip() for line in lines] == [f"Number {i}" for i in range(3)]
    assert last == "  and 5 more; see result.json"


def test_active_limits_of_outputs_come_last():
    active = ActiveLimit("y <= 2", "The limit y <= 2 is reached at 3 samples.", 3, 1, ("k",))
    close = ActiveLimit("minimum distance of C.x", "Breakpoints 2 and 3 of C.x are at their minimum distance.", 0, 1)
    assert lines_on(Trust(directions=(ONE,), holdings=(active, close)))[2:] == [
        "Active output limits:",
        "  The limit y <= 2 is reached at 3 samples.",
    ]


def test_an_incomplete_search_is_reported_first():
    assert (
        lines_on(Trust(remark="The search ended with status stopped.", directions=(ONE,)))[0]
        == "The search ended with status stopped."
    )
