import json
from dataclasses import dataclass, field

import numpy as np
import pytest

from kennfeld.project.results import write
from kennfeld.report import from_folder
from kennfeld.report.page import page
from kennfeld.report.report_data import collect_report_data
from kennfeld.report.stored_result import TrustSummary, summarise_trust
from kennfeld.report.undetermined_section import _surrogate_errors
from kennfeld.surrogate import SurrogateQuality
from tests.surrogate.surrogates import dynamic_surrogate


@dataclass
class Direction:
    sentence: str
    remedy: str
    determined: bool = False


@dataclass
class NullSpace:
    sentence: str = ""
    advice: str = ""


@dataclass
class Trust:
    informed: dict = field(default_factory=dict)
    samples: dict = field(default_factory=dict)
    deviation: dict = field(default_factory=dict)
    leverage: dict = field(default_factory=dict)
    by_smoothness: dict = field(default_factory=dict)
    directions: tuple = ()
    null_space: NullSpace = field(default_factory=NullSpace)
    holdings: tuple = ()
    remark: str = ""
    noise: float = 1.0


def test_a_trust_may_have_informed_values_alone():
    informed = {"a": np.array([True, False])}
    assert summarise_trust(Trust(informed=informed)) == TrustSummary(informed=informed)


def test_an_empty_trust_has_an_empty_summary():
    assert summarise_trust(Trust()) == TrustSummary()


def calibrated(shop):
    toml = (
        '[parameters.C]\nx = { input = "x", begin = 0, end = 4, count = 3 }\ninitial = 1\n[parameters.k]\ninitial = 0\n'
    )
    project = shop.project("y = C(x) + k\n", toml, {"x": np.tile([0.5, 1.5, 2.0], 9), "m": np.arange(27.0) % 5})
    return project, project.calibrate()


def document(shop, trust):
    project, result = calibrated(shop)
    return page(collect_report_data(project, result, (), summarise_trust(trust)))


def test_a_page_shows_deviations_directions_and_leverage(shop, opened):
    trust = Trust(
        informed={"C": np.array([True, True, False]), "k": np.array(True)},
        samples={"C": np.array([9, 27, 0])},
        deviation={"C": np.array([0.25, 0.0, np.inf]), "k": np.array(np.inf)},
        leverage={"C": np.array([0.9, 1.0, 0.0])},
        by_smoothness={"C": np.array([False, False, True])},
        directions=(Direction("Adding 1 to C and -1 to k has no effect on the fit.", "Pin <one> value of C."),),
    )
    page = opened(document(shop, trust))
    (figure,) = page.figures("parameter")
    assert figure["deviation"] == [0.25, 0.0, -1]
    assert figure["samples"] == [9, 27, 0]
    assert figure["informed"] == [1, 1, 0]
    assert figure["bySmoothness"] == [0, 0, 1]
    assert "Adding 1 to C and -1 to k has no effect on the fit. Pin <one> value of C." in page.words_in_a_row
    assert "not determined" in page.words_in_a_row
    assert "studentized" in page.words_in_a_row


def test_coupled_but_determined_directions_are_listed_apart_without_a_remedy(shop, opened):
    directions = (
        Direction("Raising C has no effect on the fit.", "Pin one value of C."),
        Direction("Scaling k has little effect on the fit.", "Pin k.", determined=True),
    )
    words = opened(document(shop, Trust(directions=directions))).words_in_a_row
    assert "Raising C has no effect on the fit. Pin one value of C." in words
    assert "Coupled, but determined: Scaling k has little effect on the fit." in words
    assert "Pin k." not in words


def test_samples_are_counted_from_the_data_if_there_is_no_trust(shop, opened):
    page = opened(document(shop, Trust()))
    (figure,) = page.figures("parameter")
    assert figure["samples"] == [18, 27, 0]
    assert (figure["deviation"], figure["informed"], figure["bySmoothness"]) == (None, None, None)
    assert "standardised" in page.words_in_a_row


def test_a_page_shows_values_at_limits_and_an_early_end_of_the_search(shop, opened):
    page = opened(document(shop, Trust(holdings=("The limit y <= 2 is met.",), remark="The search was <stopped>.")))
    assert "The limit y <= 2 is met." in page.words_in_a_row
    assert "The search was <stopped>." in page.words_in_a_row


def test_a_page_shows_the_number_of_undetermined_changes_with_a_remedy(shop, opened):
    space = NullSpace("7 combinations of values of C and k are undetermined.", "To determine them, pin <all> of C.")
    page = opened(document(shop, Trust(null_space=space)))
    assert page.words_in_a_row.count("7 combinations of values of C and k are undetermined.") == 2  # and as a warning
    assert "To determine them, pin <all> of C." in page.words_in_a_row


def test_fitted_breakpoints_are_a_table(shop, opened, tmp_path):
    toml = '[parameters.C]\nx = { input = "x", breakpoints = "free", begin = 0, end = 4, count = 3 }\ninitial = 1\n'
    x = np.linspace(0, 4, 60)
    project = shop.project("y = C(x)\n", toml, {"x": x, "m": np.abs(x - 1.3) + 0.01 * np.sin(99 * x)})
    result = project.calibrate()
    write(result, project, tmp_path / "results")
    for report in (opened(page_of(project, result)), opened(from_folder(project, tmp_path / "results"))):
        words = report.words_in_a_row
        assert "Breakpoints axis breakpoint unit before after change std deviation samples" in words
        assert f"{result.trust.deviation['C.x'][1]:.3g}" in words


def page_of(project, result):
    return page(collect_report_data(project, result, (), summarise_trust(result.trust)))


def test_arrays_of_another_shape_are_omitted(shop, opened):
    page = opened(document(shop, Trust(deviation={"C": np.zeros(7)})))
    assert page.figures("parameter")[0]["deviation"] is None


class TestStored:
    """The trust in the folder of a run."""

    HEAD = "parameter,x,y,z,w,value,unit,deviation,scatter,samples,leverage,informed,by_smoothness\n"
    LINES = (
        "C,0,,,,1,,0.25,0.2,9,0.9,1,0",
        "C,2,,,,1,,inf,0,27,0,0,0",
        "C,4,,,,1,,,0,0,0,1,1",
        "k,,,,,0,,0.5,0.5,27,1,1,0",
    )
    DIRECTIONS = ({"sentence": "This has no effect on the fit.", "remedy": "Pin it."},)

    @pytest.fixture
    def folder(self, shop, tmp_path):
        project, result = calibrated(shop)
        self.project = project
        write(result, project, tmp_path / "results")
        stored = json.loads((tmp_path / "results" / "result.json").read_text(encoding="utf-8"))
        null_space = {"sentence": "One combination of values is undetermined.", "remedy": "Pin k."}
        stored["trust"] = {"directions": list(self.DIRECTIONS), "null_space": null_space}
        del stored["files"]  # what follows was written by no run
        (tmp_path / "results" / "result.json").write_text(json.dumps(stored), encoding="utf-8")
        (tmp_path / "results" / "trust.csv").write_text(self.HEAD + "\n".join(self.LINES) + "\n", encoding="utf-8")
        return tmp_path / "results"

    def test_the_trust_of_a_folder_is_read(self, folder, opened):
        page = opened(from_folder(self.project, folder))
        (figure,) = page.figures("parameter")
        assert figure["deviation"] == [0.25, -1, None]
        assert figure["samples"] == [9, 27, 0]
        assert figure["informed"] == [1, 0, 1]
        assert figure["bySmoothness"] == [0, 0, 1]
        assert "This has no effect on the fit. Pin it." in page.words_in_a_row
        assert "One combination of values is undetermined. Pin k." in page.words_in_a_row
        assert "studentized" in page.words_in_a_row

    @pytest.mark.parametrize(
        "content", ["", "a,b\n1,2\n", HEAD + "C,0,,,,1,,x,0.2,9,0.9,1,0\n", HEAD + LINES[0] + "\n"]
    )
    def test_a_trust_that_is_damaged_or_of_other_tables_is_omitted(self, folder, content, opened):
        (folder / "trust.csv").write_text(content, encoding="utf-8")
        (figure,) = opened(from_folder(self.project, folder)).figures("parameter")
        assert figure["samples"] == [18, 27, 0]
        assert figure["deviation"] is None


def test_errors_of_surrogates_are_listed_with_those_of_linear_models():
    errors = {"free run": 0.1, "ARX": 0.25}
    rows = tuple(SurrogateQuality("drive", "test", mode, 40, rmse, 0.9, 1.0) for mode, rmse in errors.items())
    text = str(_surrogate_errors([dynamic_surrogate(quality=rows)]))
    for cell in ("engine", "drive", "free run", "0.1000", "ARX", "0.2500"):
        assert f">{cell}<" in text
    assert _surrogate_errors([]) is None
