"""The section of a report on missing terms: proposals of every kind, and how they look in a browser."""

import pytest

from kennfeld.analysis.missing.proposing import SearchScope
from kennfeld.report import document
from kennfeld.report.report_data import ReportedProposals
from tests.analysis.missing.drawn_proposals import every_kind
from tests.app.browser import tab
from tests.report.report_projects import scalars


def report(calibrated, **more):
    own, scope = calibrated(scalars), SearchScope(nodes=("y",), least=0.3)
    return document(own.project, own.result, proposals=ReportedProposals(every_kind(), scope, **more))


def test_proposals_of_every_kind_have_their_numbers_and_pictures(calibrated, opened):
    page = opened(report(calibrated, made="2026-01-01 12:00:00"))
    words = page.words_in_a_row
    for number, change in enumerate(
        [
            "Scale drag [1] by a curve of Öl °C",
            "Add a map of x and z to y",
            "Delay y by a PT1 of about 0.333 s",
            "Delay y by 3 steps",
            "Add an offset of each recording to y",
        ],
        1,
    ):
        assert f"{number} {change}" in words
        assert f'href="#missing-{number}"' in page.text
    assert "2026-01-01 12:00:00, for the calibration of this report: 27 candidates scored." in words
    assert "Restricted to nodes y. Terms that explain less than 0.300 Nm were left out." in words
    forms = [(figure["form"], len(figure["now"])) for figure in page.figures("term")]
    # a delay has no values, and the value of an offset for other recordings is none
    assert forms == [("multiply", 3), ("add", 6), ("lag", 1), ("offset", 2)]
    assert page.figures("term")[3]["points"] == [1, 2]


def test_proposals_that_are_not_about_the_result_are_named_but_not_shown(calibrated, opened):
    page = opened(report(calibrated, made="yesterday", change="the values have"))
    assert "The list of proposals of yesterday is not shown: the values have changed since." in page.words_in_a_row
    assert page.figures("term") == []


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_terms_are_drawn_and_read_under_the_mouse(calibrated, tmp_path, theme):
    path = tmp_path / "report.html"
    path.write_text(report(calibrated), encoding="utf-8")
    with tab((1024, 768), theme) as page:
        page.goto(path.as_uri() + "#missing")
        hosts = page.locator("figure.term [data-figure]")
        for at in range(4):
            hosts.nth(at).scroll_into_view_if_needed()
            page.wait_for_function("node => node.dataset.drawn === 'yes'", arg=hosts.nth(at).element_handle())
        curve = hosts.first.locator("canvas")
        curve.scroll_into_view_if_needed()
        box = curve.bounding_box()
        page.mouse.move(box["x"] + 60, box["y"] + 40)
        assert page.locator(".tooltip").inner_text().startswith("factor 0.333")
