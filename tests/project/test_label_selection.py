"""Label lists that select the parameters to fit, and the list of those that have changed."""

import pytest

from kennfeld.calfiles.label_list import read_label_list
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.project.results import write


@pytest.fixture
def listed(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = "@airpath.lab"')
    return shop


def free_names(shop):
    return shop.project.problem().free_names


def test_a_list_selects_its_labels(listed):
    listed.write("airpath.lab", "[RAMCELL]\nSpeed;10ms\n[LABEL]\noffset;;a comment\n")
    assert free_names(listed) == ("offset",)
    assert listed.findings() == []


def test_lists_and_patterns_add_up(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = ["@airpath.lab", "Ga*"]')
    shop.write("airpath.lab", "offset\n")
    assert free_names(shop) == ("Gain", "offset")


def test_names_in_a_list_are_not_patterns(listed):
    listed.text = listed.text.replace("offset", "%off[set]*%")
    start = [Curve("Gain", Axis([1000, 2000, 3000], input="Speed"), [1.0, 1.0, 1.0]), Scalar("off[set]*", 0.0)]
    listed.values("start.json", *start)
    listed.add("[parameters.'off[set]*']\ninitial = 0.0")
    listed.write("airpath.lab", "off[set]*\n")
    assert free_names(listed) == ("off[set]*",)
    listed.write("airpath.lab", "*\nGain\n")
    assert free_names(listed) == ("Gain",)


def test_a_function_stands_for_its_labels(listed):
    axis = Axis([1000, 2000, 3000], input="Speed")
    listed.values("start.json", Curve("Gain", axis, [1.0, 1.0, 1.0], functions=["AirPath"]), Scalar("offset", 0.0))
    listed.write("airpath.lab", "[FUNCTION]\nAirPath\n")
    assert free_names(listed) == ("Gain",)
    assert listed.findings() == []


def test_a_group_axis_in_a_list_is_known(listed):
    axis = Axis([1000, 2000, 3000], input="Speed", name="AxisSpeed")
    listed.values("start.json", Curve("Gain", axis, [1.0, 1.0, 1.0]), Scalar("offset", 0.0))
    listed.write("airpath.lab", "Gain\nAxisSpeed\n")
    assert listed.findings() == []


def test_unknown_names_are_reported_at_once_with_the_nearest(listed):
    listed.write("airpath.lab", "Gain\nofset\nKfTrq\nKlEta\n")
    assert listed.warning() == (
        "kennfeld.toml [calibration] free: airpath.lab lists 3 labels (ofset, KfTrq, KlEta) that the function does not "
        "use. Did you mean offset instead of ofset?"
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "airpath.lab lists no labels. Write the names under [LABEL]."),
        (
            "[RAMCELL]\nSpeed\nLoad\n",
            "airpath.lab lists no labels, only measured variables under [RAMCELL]: Speed, Load. "
            "Write the names under [LABEL].",
        ),
        ("gain\n", "airpath.lab lists no parameter of the function: gain. Did you mean Gain instead of gain?"),
        ("\0\0", "airpath.lab: is not a label list. Write a text file with a name a line."),
    ],
)
def test_a_list_without_a_match_is_an_error(listed, content, message):
    listed.write("airpath.lab", content)
    assert f"kennfeld.toml [calibration] free: {message}" in listed.errors()


def test_a_missing_list_is_an_error_with_the_nearest(listed):
    listed.write("airpaht.lab", "Gain\n")
    assert "kennfeld.toml [calibration] free: airpath.lab: file not found. Did you mean airpaht.lab?" in listed.errors()


def test_a_step_accepts_lists(shop):
    shop.write("airpath.lab", "offset\nKfTrq\n")
    shop.add('[[step]]\nfree = "@airpath.lab"')
    assert shop.project.options.steps[0].free == ("offset",)
    assert shop.warning() == (
        "kennfeld.toml [[step]] 1 free: airpath.lab lists 1 label (KfTrq) that the function does not use"
    )


def test_a_calibration_lists_its_changed_labels(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nfree = ["offset"]\nresults = ["lab"]')
    project = shop.project
    written = write(project.calibrate(), project, shop.folder / "results")
    assert shop.folder / "results" / "changed.lab" in written
    assert read_label_list(shop.folder / "results" / "changed.lab").labels == ("offset",)


def test_changed_labels_of_a_calibration_select_those_of_the_next_one(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\nresults = ["lab"]')
    project = shop.project
    write(project.calibrate(), project, shop.folder / "results")
    shop.change('results = ["lab"]', 'free = "@results/changed.lab"')
    assert free_names(shop) == ("Gain", "offset")
