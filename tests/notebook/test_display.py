"""Values in notebooks: HTML that is complete, escaped, self-contained and of a bounded size."""

import re
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import Finding, FindingList, Findings, Location

VOID = {"meta", "br", "input"}
EVIL = "<script>alert('x')</script>"


class Reader(HTMLParser):
    """Collects elements and text; complains about elements that are closed in the wrong order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.texts, self.attributes = [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def shown(value):
    return Reader(value._repr_html_())


def text_of(value):
    return " ".join(shown(value).texts)


@pytest.fixture(scope="module")
def result():
    data = {"x": [0.0, 1, 2, 3, 4, 5], "z": [0.0, 1, 4, 9, 16, 25]}
    start = kf.ParameterSet([kf.Curve("C", range(6), [1.0] * 6), kf.Scalar("a", 1.0)])
    return kf.calibrate("y = a * C(x)", data, start, target="z")


def table(rows=12, columns=9):
    x = kf.Axis(np.linspace(700, 6000, rows), "Speed", "rpm")
    return kf.Map("Torque", x, np.linspace(0, 100, columns), np.arange(float(rows * columns)).reshape(rows, columns))


def recording(samples=50, channels=3, name="drive"):
    time = np.arange(samples) * 0.1
    return kf.Dataset.of(name, {f"c{i}": np.sin(time + i) for i in range(channels)}, time=time)


def values(result):
    finding = Finding(Location("a.toml", 3), "is odd", "Change it.", severity="warning")
    validation = kf.cross_validate("y = b * x", {"x": [1.0, 2, 3, 4], "z": [1.0, 2, 3, 5]}, {"b": 0.0}, "z", folds=2)
    return [
        *(kf.Scalar("K", 2.0), kf.Block("B", [1, 2]), kf.Curve("C", [0, 1], [2, 3]), table()),
        *(kf.Cube("Q", [[0, 1], [0, 1], [2, 3]], np.arange(8.0).reshape(2, 2, 2)), result.parameters),
        *(recording(), recording()["c0"], result, result.trust, validation),
        *(finding, FindingList([finding]), Findings([finding])),
    ]


def test_all_values_are_displayed_by_complete_elements_without_scripts_or_links(result):
    for value in values(result):
        page = shown(value)
        assert page.tags[0] == "div"
        assert {"script", "link", "img", "iframe", "style"}.isdisjoint(page.tags)
        assert not [name for name, content in page.attributes if name.startswith("on") or "http" in (content or "")]


@pytest.mark.parametrize(
    "value",
    [
        kf.Scalar(EVIL, 1.0, unit=EVIL, description=EVIL),
        kf.Curve(EVIL, kf.Axis([0, 1], EVIL, EVIL), [1, 2], unit=EVIL),
        kf.Map(EVIL, kf.Axis([0, 1], EVIL), kf.Axis([0, 1], name=EVIL), [[1, 2], [3, 4]], description=EVIL),
        kf.ParameterSet([kf.Scalar(EVIL, 1.0, unit=EVIL)], [kf.Text(f"{EVIL} ", EVIL)]),
        kf.Dataset.of(EVIL, {EVIL: [1.0, 2.0]}, units={EVIL: EVIL}),
        kf.Channel(EVIL, [1.0, 2.0], EVIL, EVIL),
        FindingList([Finding(Location(EVIL), EVIL, EVIL, EVIL)]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_names_are_escaped(value):
    assert "script" not in shown(value).tags
    assert EVIL in text_of(value)


def test_characters_that_cannot_be_seen_are_escapes():
    assert "Sp\\u202eeed" in text_of(kf.Scalar("Sp\u202eeed", 1.0))


def test_a_curve_is_a_line_and_a_map_a_picture_of_its_cells_with_all_values():
    assert shown(kf.Curve("C", [0, 1, 2], [2, 3, 4])).tags.count("polyline") == 1
    page = shown(table())
    assert page.tags.count("rect") == 12 * 9
    assert page.tags.count("td") == 12 * 9
    assert "Speed [rpm]" in page.texts


def test_radial_basis_functions_have_a_name_for_each_number():
    bells = kf.Expansion(0.0, [0.01], [5.0], [[2500.0]], [[800.0]], hinges=[(0, 3000.0, 0.125)])
    bump = kf.RBF("Bump", bells, inputs=["Speed"])
    text = text_of(bump)
    assert all(bump.value_name(i) in text for i in range(bump.size))
    assert "change of the slope in Speed at 3000" in text
    assert "0.125" in text


def test_bounds_and_locks_are_shown():
    assert "bounds 0 to 9, 2 values locked" in text_of(kf.Curve("C", [0, 1], [2, 3], lower=0, upper=9, locked=True))
    assert "bounds that differ" in text_of(kf.Curve("C", [0, 1], [2, 3], lower=[0, 1]))


def test_a_dataset_has_a_strip_for_each_channel_and_names_missing_ones():
    page = shown(kf.Dataset.of("bench", {"n": [1.0, np.nan, 3.0], "T": [1.0, 2.0, 3.0]}))
    assert page.tags.count("svg") == 2
    assert page.texts[-10:] == ["n", "1", "2", "3", "1", "T", "1", "2", "3", "0"]
    assert "3 samples" in " ".join(page.texts)


@pytest.mark.parametrize(
    ("value", "note"),
    [
        (table(500, 400), "abbreviated: 500 x 400 values"),
        (kf.Curve("Long", range(5000), range(5000)), "abbreviated: 1 x 5000 values"),
        (recording(20_000, 300), "280 of 300 rows are not shown"),
        (kf.ParameterSet([kf.Scalar(f"K{i}", i) for i in range(900)]), "880 of 900 rows are not shown"),
        (FindingList([Finding(Location("a", i), "odd") for i in range(900)]), "880 of 900 rows are not shown"),
    ],
    ids=["map", "curve", "dataset", "set", "findings"],
)
def test_large_values_are_abbreviated(value, note):
    assert note in text_of(value)
    assert len(value._repr_html_()) < 250_000


@pytest.mark.parametrize(
    "value",
    [
        kf.Dataset("empty", ()),
        kf.Dataset.of("none", {"x": []}),
        kf.Channel("unknown", [np.nan, np.nan]),
        kf.Channel("huge", [-1.7e308, 1.7e308]),
        kf.Curve("point", [3.0], [1.0]),
        kf.Curve("constant", [0, 1], [1.0, 1.0]),
        kf.Map("line", [1], [1, 2], [[1, 2]]),
        kf.Map("missing", [0, 1], [0, 1], [[np.nan, 1], [2, np.nan]]),
        kf.Map("huge", [-1.7e308, 1.7e308], [0, 1], [[-1.7e308, 1], [1.7e308, 0]]),
        kf.ParameterSet(),
        FindingList(),
        kf.Trust(),
    ],
    ids=lambda value: f"{type(value).__name__} {getattr(value, 'name', '')}",
)
def test_degenerate_values_have_a_display(value):
    assert not re.search(r'="-?(nan|inf)', value._repr_html_())
    shown(value)


def test_a_result_names_what_the_data_do_not_determine(result):
    assert "Parameters not determined by the data:" in text_of(result)
    assert "if anything: kennfeld.design(result, direction=1)" in text_of(result)
    assert "Parameters not determined by the data:" in str(result)
    assert "Scaling a by 1.01" in str(result)


def test_findings_come_with_location_and_remedy_and_errors_first():
    findings = FindingList(
        [Finding(Location("a", 3), "odd", "Fix it.", severity="remark"), Finding(Location("b"), "bad")]
    )
    text = text_of(findings)
    assert text.index("bad") < text.index("odd") < text.index("Fix it.")
    assert "1 error, 1 remark" in text
    assert "No findings" in text_of(FindingList())


def test_the_findings_of_a_check_are_displayed_and_remain_a_list(tmp_path):
    from kennfeld.project.demo import write

    findings = kf.Project.read(write("torque", tmp_path)).check()
    assert isinstance(findings, list)
    assert shown(findings).tags[0] == "div"


def test_types_load_no_display_before_they_are_shown():
    code = (
        "import sys, kennfeld as kf\nscalar = kf.Scalar('K', 1.0)\nkf.Dataset.of('d', {'x': [1.0]})\n"
        "before = 'kennfeld.notebook' in sys.modules\nscalar._repr_html_()\n"
        "print(before, 'kennfeld.notebook' in sys.modules, *{'pandas', 'matplotlib'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
