"""Transitions through the edges of subcharts, which files store as a whole and in pieces."""

from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import simulink
from tests.draws import mostly_slow
from tests.importers.simulink.chart_runs import U, V, both, drawn_chart
from tests.importers.simulink.simulink_files import LAYOUTS, Chart
from tests.importers.simulink.test_charts import NESTED

UV = [("u", "INPUT_DATA"), ("v", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("z", "OUTPUT_DATA")]
# through two edges at once, from a junction in a subchart, and to the inner edge of the state around both
DEEP = Chart(
    {
        "S": "S\nen: z += 1;", "A": "A\nex: z += 10;", "A1": "A1\nen: y = 1;", "A2": "A2\nen: y = 2;",
        "A21": "A21\ndu: y += 0.125;", "B": "B\nen: z -= 5;", "B1": "B1\nen: y = 4;",
    },
    [
        ("", "S", ""), ("", "A", ""), ("", "A1", ""), ("", "A21", ""), ("", "B1", ""),
        ("A1", "J", "[u > 0]"), ("J", "B1", "[v > 0.3]{z += 100;}"), ("J", "A2", ""),
        ("A21", "B1", "[u < -0.5]/z = 0;"), ("A21", "S", "[v > 1.2]", "S"), ("B1", "A21", "[u > 0.8]"),
        ("B", "A", "[v < -0.6]"),
    ],
    UV,
    parents={"A": "S", "B": "S", "A1": "A", "A2": "A", "A21": "A2", "J": "A", "B1": "B"},
    junctions=("J",),
)  # fmt: skip


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
@pytest.mark.parametrize(
    ("chart", "subcharts"),
    [(NESTED, ("A", "B")), (NESTED, ("B",)), (DEEP, ("A", "B")), (DEEP, ("A2", "A", "S")), (DEEP, ("A2", "B"))],
)
def test_a_transition_through_the_edge_of_a_subchart_is_one_transition(chart, subcharts, layout, tmp_path):
    drawn = replace(chart, subcharts=subcharts)
    assert any(keys for *_, keys in drawn.drawn()), "nothing crosses an edge"
    for result, expected in both(drawn, tmp_path, {"u": U, "v": V}, ("y", "z"), layout=layout):
        np.testing.assert_allclose(result, expected)


def test_a_piece_without_the_whole_transition_is_reported(tmp_path):
    drawn = drawn_chart(replace(NESTED, subcharts=("A", "B")), ("u", "v"), ("y", "z"))
    path = drawn.write(tmp_path, "mdl")
    path.write_text(path.read_text().replace("subLink [", "subLink [9"))
    with pytest.raises(InputError, match="is a piece of one through a subchart, which the file lacks as a whole"):
        simulink(path)
