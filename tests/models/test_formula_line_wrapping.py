"""Long statements on several lines."""

import pytest

from kennfeld.models.formula import formula, to_lines, to_text
from kennfeld.models.formula.line_wrapping import WIDTH, wrap
from tests.draws import few_or_many
from tests.models.formula_graphs import graphs, one_nan

LONG = [f"%signal number {at}, [rpm]%" for at in range(12)]


def test_a_short_statement_stays_on_its_line():
    assert wrap("y = a + b") == ["y = a + b"]


@pytest.mark.parametrize(
    "expression",
    [
        " + ".join(LONG),
        " * ".join(LONG),
        " and ".join(f"not {name}" for name in LONG),
        f"max({', '.join(LONG[:8])})",
        f"-({' - '.join(LONG)}) ^ 2 / ({LONG[0]} - -1)",
        f"sin({' + '.join(LONG)}) - cos({' - '.join(LONG)})",
    ],
)
def test_a_long_statement_is_broken_where_the_language_continues_it(expression):
    lines = wrap(f"y[Nm] = {expression}")
    assert len(lines) > 1
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith("y[Nm] = ")
    assert all(line.startswith("    ") and not line[4:5].isspace() for line in lines[1:])
    assert formula("\n".join(lines)).graph == formula(f"y[Nm] = {expression}").graph


def test_each_condition_of_a_long_chain_begins_a_line():
    chain = "".join(f"if(x == {at}, {LONG[at]}, " for at in range(6)) + "0" + ")" * 6
    lines = wrap(f"y = {chain}")
    assert [line.strip().partition("if(")[2][:6] for line in lines] == [f"x == {at}" for at in range(6)]
    assert formula("\n".join(lines)).graph == formula(f"y = {chain}").graph


def test_what_cannot_be_broken_stays_whole():
    name = f"%{'long ' * 40}%"
    assert wrap(f"y = {name}") == [f"y = ({name})"]
    assert formula("\n".join(wrap(f"y = {name} + 1"))).graph == formula(f"y = {name} + 1").graph


@few_or_many(graphs(), few=12, many=200)
def test_every_graph_is_arranged_as_text_that_reads_back_to_it(graph):
    lines = to_lines(graph, 0.01)
    assert one_nan(formula("\n".join(line.text for line in lines)).graph) == one_nan(formula(to_text(graph)).graph)
    assert [line.node for line in lines if line.defines] == list(graph.names)
