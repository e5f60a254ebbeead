"""The list of `kennfeld propose` in the results folder: shown as long as it is about the result."""

import json
import shutil

import numpy as np
import pytest

from kennfeld import Project, cli
from kennfeld.calfiles import write
from kennfeld.project.missing_terms import calibrated_values
from kennfeld.project.proposal_file import ProposalSubject, read_proposals
from kennfeld.report import from_folder
from tests.app.questions import WaitingSession
from tests.project.test_missing_terms import write_bench
from tests.report.report_projects import Page

SCOPE = ["--kind", "add", "--channel", "oil", "--node", "drag"]


@pytest.fixture(scope="module")
def proposed(tmp_path_factory):
    """Return the folder of a calibrated bench with its list of proposals."""
    folder = tmp_path_factory.mktemp("proposed")
    path = str(write_bench(folder, samples=60))
    assert cli.run(["calibrate", path]) == 0
    assert cli.run(["propose", path, *SCOPE]) == 0
    return folder


@pytest.fixture
def folder(proposed, tmp_path):
    return shutil.copytree(proposed, tmp_path / "bench")


def section(folder):
    """Return the report on a folder, and its words."""
    page = Page(from_folder(Project.read(folder / "kennfeld.toml"), folder / "results"))
    return page, page.words_in_a_row


def test_a_report_shows_the_proposals_with_their_pictures(folder):
    page, words = section(folder)
    [figure] = page.figures("term")
    assert (figure["parameter"], figure["input"], figure["criterion"]) == ("AddDragOil", "oil", "y")
    assert sum(figure["counts"]) == 180
    # what the errors share over the channel is gone with the term
    means = [np.sqrt(np.nanmean(np.array(figure[name], dtype=float) ** 2)) for name in ("before", "after")]
    assert means[1] < 0.3 * means[0]
    assert "Restricted to channels oil; nodes drag; kinds add." in words
    assert "for the calibration of this report" in words
    assert "would take" not in words  # the estimate of the calibration is replaced
    content = json.loads((folder / "results" / "proposals.json").read_text(encoding="utf-8"))
    assert content["proposals"][0]["text"].startswith("Add a curve of oil to drag: RMSE")


def test_a_list_is_about_one_function_with_its_recordings_and_values(folder):
    project = Project.read(folder / "kennfeld.toml")
    result = project.problem().parameters
    stored = read_proposals(folder / "results").subject
    assert stored.change(ProposalSubject.of(project, result)) == "the values have"
    # a channel that the function does not read
    file = folder / "run_1.csv"
    file.write_text(file.read_text(encoding="utf-8").replace(",ok\n", ",no\n", 1), encoding="utf-8")
    page, words = section(folder)
    assert "is not shown: the recordings have changed since. Run kennfeld propose kennfeld.toml again." in words
    assert not page.figures("term")
    (folder / "kennfeld.toml").write_text(
        (folder / "kennfeld.toml").read_text(encoding="utf-8").replace("lock = true", "smoothness = 1"),
        encoding="utf-8",
    )
    assert "the function, the project or its data have changed since" in section(folder)[1]


def test_what_changes_no_number_leaves_a_list_as_it_is(folder):
    path = folder / "kennfeld.toml"
    path.write_text(path.read_text(encoding="utf-8") + '[report]\ntitle = "Bench 3"\n', encoding="utf-8")
    assert section(folder)[0].figures("term")


def test_a_damaged_list_is_a_warning_and_the_report_as_without_it(folder):
    file = folder / "results" / "proposals.json"
    file.write_text(file.read_text(encoding="utf-8").replace('"picture"', '"image"'), encoding="utf-8")
    page, words = section(folder)
    assert "proposals.json: not a valid list of proposals (KeyError: 'picture'). Run kennfeld propose again." in words
    assert "Estimated by one linearisation" in words
    assert not page.figures("term")


def test_the_app_takes_a_list_over_and_applies_it_at_the_values_that_it_is_about(folder):
    path = folder / "kennfeld.toml"
    opened = WaitingSession(path)
    assert opened.ask("missing")["found"]["old"]  # at the start
    opened.session.project.close()
    # the same problem, from the values of the run
    text = path.read_text(encoding="utf-8")
    path.write_text('calibration.initial = "results/parameters.json"\n' + text.replace("initial = 1.0\n", ""), "utf-8")
    opened = WaitingSession(path)
    shown = opened.ask("missing")["found"]
    assert (shown["old"], len(shown["proposals"])) == (False, 1)
    opened.ask("apply-term", number=0)
    after = opened.session.require_view().now.scores[0].rmse
    assert after == pytest.approx(shown["proposals"][0]["training"]["after"], rel=1e-5)
    assert opened.ask("missing")["found"]["old"]
    opened.session.undo()
    assert not opened.ask("missing")["found"]["old"]


def test_a_search_begins_at_fitted_breakpoints(tmp_path):
    path = write_bench(tmp_path, planted="", samples=60)
    text = path.read_text(encoding="utf-8").replace(
        "[parameters.CurveDrag]\nx = {", "[parameters.CurveDrag]\nx = { free = true,"
    )
    path.write_text(text.replace("lock = true", "smoothness = 0.01"), encoding="utf-8")
    results = tmp_path / "results"
    results.mkdir()
    problem = Project.read(path).problem()
    curve = problem.parameters["CurveDrag"]
    moved = curve.changed(axes=(curve.axes[0].changed(breakpoints=np.array([0.0, 0.3, 1.0])),))
    write(problem.parameters.with_parameters(moved), results / "parameters.json")
    own = calibrated_values(Project.read(path), problem)["CurveDrag"].axes[0]
    assert (own.breakpoints.tolist(), own.free) == ([0.0, 0.3, 1.0], True)
