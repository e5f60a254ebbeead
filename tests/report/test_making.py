"""Whole reports: the properties that those of all projects in `conftest.py` share."""

import json
import re
import shutil

import numpy as np
import pytest

from kennfeld import InputError, cli
from kennfeld.project import Project
from kennfeld.project.results import write
from kennfeld.report import document, document_safely, from_folder
from tests.app.browser import tab
from tests.draws import mostly_slow
from tests.report.report_projects import (
    PROJECTS,
    a_cube,
    a_failed_fit,
    a_map,
    limited,
    scattered,
    several_files,
    two_criteria,
)


def test_every_report_is_self_contained_and_agrees_with_its_result(project, opened):
    result, page = project.result, opened(project.report)
    assert page.addresses
    assert all(address.startswith("#") for address in page.addresses)
    assert "link" not in page.tags
    assert "img" not in page.tags
    assert "default-src 'none'" in page.policy
    assert page.data["result"] == json.loads(json.dumps(result.as_json()))
    assert result.status in page.words_in_a_row
    for row in result.quality:
        if row.samples and np.isfinite(row.rmse_after):
            assert f"{row.rmse_after:.4g}"[:5] in page.words_in_a_row


def test_every_report_can_be_written_before_a_calibration(project, opened):
    page = opened(document(project.project))
    assert page.data["result"] is None
    assert "Not calibrated yet" in page.words_in_a_row
    assert "not calibrated yet" in page.words_in_a_row


@pytest.mark.parametrize(
    "project",
    mostly_slow(PROJECTS, [a_map, a_cube, limited, a_failed_fit, two_criteria]),
    ids=lambda build: build.__name__,
    indirect=True,
)
def test_the_report_of_a_folder_equals_the_one_of_the_run(project, tmp_path, opened):
    direct = opened(project.report)
    write(project.result, project.project, tmp_path / "results", {"report.html": direct.text})
    again = opened(from_folder(Project.read(project.project.path), tmp_path / "results"))
    assert again.data["result"] == direct.data["result"]
    for figure, other in zip(again.data["figures"], direct.data["figures"], strict=True):
        if figure["kind"] == "parameter":
            assert (figure["name"], figure["after"], figure["before"]) == (
                other["name"],
                other["after"],
                other["before"],
            )
    assert (tmp_path / "results" / "report.html").read_text(encoding="utf-8") == direct.text


@pytest.mark.parametrize(
    "project",
    mostly_slow(PROJECTS, [a_map, a_cube, limited, several_files]),
    ids=lambda build: build.__name__,
    indirect=True,
)
def test_a_browser_draws_every_picture(project, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(project.report, encoding="utf-8")
    with tab() as page:
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready=yes]")
        page.evaluate("dispatchEvent(new Event('beforeprint'))")  # draws those that are not in view, too
        assert page.locator("[data-failed]").count() == 0
        assert page.locator("[data-drawn=yes]").count() >= 3


def test_a_report_calls_data_unseen_only_if_they_are(shop, opened):
    toml, (training, other) = "[parameters.a]\ninitial = 0\n", (scattered(100, seed) for seed in (0, 1))
    for test, unseen in ((other, True), (training, False)):
        project = shop.project("y = a * x\n", toml, training, test=test)
        words = opened(document(project, project.calibrate(), project.check())).words_in_a_row
        assert ("On unseen test data" in words) is unseen
        assert ("the calibration generalises to unseen data" in words) is unseen
        assert ("On test data, some of which are also training data" in words) is not unseen
        assert ("the test file fresh.csv has the same content as the training file bench.csv" in words) is not unseen


def test_title_author_and_comment_are_in_the_head_and_escaped(shop, opened):
    toml = '[parameters.a]\ninitial = 0\n[report]\ntitle = "Torque <b>B48</b>"\nauthor = "A. & B."\n'
    comment = 'comment = """\nFirst <script>alert(1)</script>\nline.\n\nSecond."""\n'
    project = shop.project("y = a * x\n", toml + comment, scattered())
    page = opened(document(project))
    words = page.words_in_a_row
    assert words.startswith("Torque <b>B48</b> ")
    assert "A. & B." in words
    assert "First <script>alert(1)</script> line. Second." in words
    assert "<script>alert(1)" not in page.text
    assert "Torque <b>" not in page.text
    assert page.text.count("<title>Torque &lt;b&gt;B48&lt;/b&gt;</title>") == 1
    assert (
        cli.run(
            ["report", str(project.path), "--title", "Another", "--author", "C.", "-o", str(shop.folder / "a.html")]
        )
        == 0
    )
    words = opened((shop.folder / "a.html").read_text(encoding="utf-8")).words_in_a_row
    assert words.startswith("Another ")
    assert "C." in words.split("Calibration report")[0]
    assert "Second." in words


def recording_rows(page):
    """Return the words of the section on recordings."""
    words = page.words_in_a_row
    return words[
        words.index("The worst recordings first.") : words.index("Measured and calculated", words.index("RMSE there"))
    ]


def test_a_report_lists_recordings_worst_first_and_folds_long_lists(calibrated, opened):
    result = calibrated(several_files).result
    rows = recording_rows(opened(calibrated(several_files).report))
    names = re.findall(r"drive_\d\d\.csv", rows)
    assert names == [f"drive_{number:02d}.csv" for number in range(14, -1, -1)]
    assert "fresh.csv" not in rows
    assert rows.index("drive_05.csv") < rows.index("5 more recordings") < rows.index("drive_04.csv")
    worst = next(row.worst for row in result.recordings if row.file == "drive_14.csv")
    assert (worst.begin, worst.end) == pytest.approx((30, 35), abs=6)
    assert str(worst) in rows


def test_a_report_on_the_start_values_lists_recordings(calibrated, opened):
    rows = recording_rows(opened(document(calibrated(several_files).project)))
    assert "RMSE before" not in rows
    assert rows.count("drive_") == 15


def test_a_report_on_single_files_has_no_list_of_recordings(shop, opened):
    assert "The worst recordings first." not in opened(document(a_map(shop))).words_in_a_row


def test_a_report_says_that_a_constant_target_has_no_r2(shop, opened):
    flat = scattered(100, 1) | {"m": np.full(100, 0.1)}
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", scattered(100), test=flat)
    for result in (None, project.calibrate()):
        words = opened(document(project, result)).words
        assert words.count("constant target") == (1 if result is None else 2)


def test_the_report_of_a_folder_shows_the_shifts_of_its_run(shop, tmp_path, opened):
    x = np.sin(np.arange(400) / 5.0) * (1 + np.arange(400) / 200)
    late = np.roll(3 * x + 1, 2)
    time = np.arange(400) * 0.1
    toml = "[parameters.a]\ninitial = 0\n[parameters.b]\ninitial = 0\n"
    project = shop.project("y = a + b * x\n", toml, {"time [s]": time, "x": x, "m": late})
    text = project.path.read_text(encoding="utf-8")
    project.path.write_text(text.replace('"bench.csv"]\n', '"bench.csv"]\nshift = { m = "auto" }\n'), encoding="utf-8")
    project = Project.read(project.path)
    result = project.calibrate()
    assert result.shifts == {"bench": {"m": pytest.approx(-0.2, abs=0.02)}}
    direct = opened(document(project, result, project.check()))
    write(result, project, tmp_path / "results", {})
    again = opened(from_folder(Project.read(project.path), tmp_path / "results"))
    assert direct.figures("strip") == again.figures("strip") != []
    assert "have changed since" not in again.words_in_a_row


def test_parameters_come_in_the_order_of_their_change(shop, opened):
    toml = "".join(
        f"[parameters.{n}]\nx = {{ breakpoints = [0, 10] }}\ninitial = {v}\n" for n, v in (("A", 5), ("B", 5))
    )
    data = {"x": np.linspace(0, 10, 50), "m": np.full(50, 5.0), "u": np.full(50, 50.0)}
    criterion = '\n[[criterion]]\nnode = "y"\ntarget = "m"\n[[criterion]]\nnode = "z"\ntarget = "u"\n'
    project = shop.project("y = A(x)\nz = B(x)\n", toml, data, criterion=criterion)
    page = opened(document(project, project.calibrate()))
    assert [figure["name"] for figure in page.figures("parameter")] == ["B", "A"]


NASTY = '<script>alert("x")</script>&\'"'


def test_names_cannot_become_markup(shop, opened):
    text = f"y = M(%{NASTY}%)\n"
    toml = '[parameters.M]\nx = { breakpoints = [0, 10] }\ninitial = 0\nunit = "<b>"\n'
    toml += f'description = """{NASTY} </script>"""\n'
    data = {'"' + NASTY.replace('"', '""') + '"': [1.0, 2.0, 3.0], "m": [1.0, 2.0, 4.0]}
    project = shop.project(text, toml, data)
    page = opened(document(project, project.calibrate(), project.check()))
    assert page.tags.count("script") == 2  # the data, and what draws them
    assert NASTY in page.words_in_a_row
    assert page.figures("parameter")[0]["unit"] == "<b>"
    assert page.figures("parameter")[0]["axes"][0]["title"] == NASTY


@pytest.mark.slow
@pytest.mark.parametrize("count", [30_000, pytest.param(300_000, marks=pytest.mark.slow)])
def test_a_long_recording_makes_no_large_report(shop, opened, count):
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 10, count)
    project = shop.project(
        "y = C(x)\n",
        '[parameters.C]\nx = { input = "x", count = 5 }\ninitial = 0\n',
        {"time [s]": np.arange(count) * 0.01, "x": x.round(3), "m": (x + rng.normal(size=count)).round(3)},
    )
    page = opened(document(project, project.calibrate()))
    assert len(page.text) < 4_000_000  # samples for the zoomed strip included
    (strip,) = page.figures("strip")
    assert not strip["whole"]
    assert len(strip["x"]) == len(strip["error"]) <= 4002
    (scatter,) = page.figures("scatter")
    assert len(scatter["measured"]) <= 3020
    assert sum(page.figures("histograms")[0]["own"]["after"]["counts"]) == count


@pytest.mark.slow
def test_many_datasets_share_the_size_of_a_report(shop, opened):
    for i in range(20):
        rng = np.random.default_rng(i)
        shop.csv(f"part_{i:02}.csv", {"x": rng.uniform(0, 9, 4500), "m": rng.normal(size=4500)})
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", {"x": [1.0], "m": [1.0]})
    toml = project.path.read_text(encoding="utf-8")
    toml += "".join(f'[[dataset]]\nfiles = ["part_{i:02}.csv"]\n' for i in range(20))
    project.path.write_text(toml, encoding="utf-8")
    project = Project.read(project.path)
    text = document(project, project.calibrate())
    assert len(opened(text).figures("strip")) == 21
    assert len(text) < 3_000_000  # 4.5 million if each had all the room


def test_a_report_lists_active_limits(shop, opened):
    project = limited(shop)
    words = opened(document(project, project.calibrate())).words_in_a_row
    assert "slope along x from 0 to 1.1" in words
    assert "C, k equality C(0) + " in words
    assert "y - z -∞ to 11 x > 2" in words


def test_a_report_warns_of_a_stale_result(shop, opened, tmp_path):
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", {"x": [1.0, 2, 3], "m": [1.0, 2, 4]})
    write(project.calibrate(), project, tmp_path / "results")
    shop.csv("bench.csv", {"x": [1.0, 2, 3], "m": [5.0, 2, 4]})
    page = opened(from_folder(Project.read(project.path), tmp_path / "results"))
    assert "cannot be reproduced" in page.words_in_a_row


def test_a_report_attributes_a_worse_fit_to_smoothness(shop, opened, tmp_path):
    """The start is right; the curve that smoothness asks for is not."""
    x = np.linspace(0, 9, 10)
    toml = '[parameters.C]\nx = { input = "x", begin = 0, end = 9, count = 10 }\nsmoothness = 1e4\ninitial = '
    fresh = {"x": x + 0.5, "m": 5 * np.sin(x + 0.5)}
    columns = {"x": x, "m": 5 * np.sin(x)}
    project = shop.project("y = C(x)\n", toml + str((5 * np.sin(x) + 0.1).tolist()) + "\n", columns, test=fresh)
    result = project.calibrate()
    write(result, project, tmp_path / "results")
    for page in (opened(document(project, result)), opened(from_folder(project, tmp_path / "results"))):
        words = page.words_in_a_row
        assert "Smoothness outweighs the data: the RMSE of y on bench rises from 0.1 to" in words
        assert result.warnings[0].remedy in words
        assert "follow noise" not in words
        assert "generalises" not in words


def without_manifest(results):
    content = json.loads((results / "result.json").read_text(encoding="utf-8"))
    del content["files"]
    (results / "result.json").write_text(json.dumps(content), encoding="utf-8")


class TestFolder:
    @pytest.fixture
    def project(self, shop):
        return shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", {"x": [1.0, 2, 3], "m": [1.0, 2, 4]})

    def test_a_folder_without_a_result_shows_the_start(self, project, tmp_path, opened):
        assert opened(from_folder(project, tmp_path / "results")).data["result"] is None

    @pytest.mark.parametrize("name", ["result.json", "parameters.json", "trace.csv"])
    def test_a_missing_file_of_a_folder_is_named(self, project, tmp_path, name):
        write(project.calibrate(), project, tmp_path / "results")
        (tmp_path / "results" / name).unlink()
        with pytest.raises(InputError, match=rf"{name}: file not found.*calibrate again"):
            from_folder(project, tmp_path / "results")

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("result.json", "{}", "not a valid result file"),
            ("result.json", "[", "not a valid result file"),
            ("result.json", '{"quality": [{}]}', "not a valid result file"),
            ("trace.csv", "a,b\n1,2\n", "not a valid trace file"),
            ("parameters.json", '{"b": {"kind": "scalar", "unit": "", "value": 1}}', "parameter a is missing"),
            ("parameters.json", '{"a": {"kind": "curve", "unit": "", "x": [0, 1], "values": [1, 2]}}', "has 1 axes"),
        ],
    )
    def test_a_damaged_file_of_a_folder_is_named(self, project, tmp_path, name, content, message):
        results = tmp_path / "results"
        write(project.calibrate(), project, results)
        if name != "result.json":
            without_manifest(results)
        (results / name).write_text(content, encoding="utf-8")
        with pytest.raises(InputError, match=message):
            from_folder(project, results)

    def test_a_folder_without_a_manifest_is_read(self, project, tmp_path, opened):
        write(project.calibrate(), project, tmp_path / "results")
        without_manifest(tmp_path / "results")
        assert opened(from_folder(project, tmp_path / "results")).data["result"]["status"] == "converged"

    @pytest.mark.parametrize("names", [["parameters.json"], ["trace.csv"], ["parameters.json", "trust.csv"]])
    def test_a_folder_with_files_of_two_runs_is_refused(self, shop, project, tmp_path, names):
        write(project.calibrate(), project, tmp_path / "results")
        shop.csv("bench.csv", {"x": [1.0, 2, 3], "m": [5.0, 2, 4]})
        other = Project.read(project.path)
        write(other.calibrate(), other, tmp_path / "other")
        for name in names:
            shutil.copy(tmp_path / "other" / name, tmp_path / "results" / name)
        listed = rf"results: {', '.join(names)} do(es)? not belong to result.json: written by another run.*again\."
        with pytest.raises(InputError, match=listed):
            from_folder(project, tmp_path / "results")

    def test_a_file_of_the_manifest_that_is_missing_is_named(self, project, tmp_path):
        write(project.calibrate(), project, tmp_path / "results")
        (tmp_path / "results" / "trust.csv").unlink()
        with pytest.raises(InputError, match=r"trust\.csv: the file is missing\. Run kennfeld calibrate again\.$"):
            from_folder(project, tmp_path / "results")

    def test_files_of_a_run_that_was_killed_while_it_replaced_them_are_read(self, project, tmp_path, opened):
        results = tmp_path / "results"
        write(project.calibrate(), project, results)
        scratch = results / ".kennfeld-0"
        scratch.mkdir()
        for name in ("trace.csv", "result.json"):
            (results / name).replace(scratch / name)
        (scratch / "names").write_text('["parameters.json", "trace.csv", "result.json"]', encoding="utf-8")
        assert opened(from_folder(project, results)).data["result"]["status"] == "converged"
        assert not scratch.exists()

    def test_a_calibration_file_of_another_run_is_a_warning(self, project, tmp_path, opened):
        write(project.calibrate(), project, tmp_path / "results")
        (tmp_path / "results" / "parameters.dcm").write_text("KONSERVIERUNG_FORMAT 2.0\n", encoding="utf-8")
        words = opened(from_folder(project, tmp_path / "results")).words_in_a_row
        assert "parameters.dcm does not belong to result.json" in words


def test_a_report_that_fails_becomes_a_page_with_the_error(shop, monkeypatch):
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 0\n", {"x": [1.0], "m": [1.0]})
    result = project.calibrate()

    def fails(*_):
        raise ZeroDivisionError("<so>")

    monkeypatch.setattr("kennfeld.report.page.page", fails)
    text = document_safely(project, result)
    assert "could not be created" in text
    assert "ZeroDivisionError: &lt;so&gt;" in text
