"""The project file alone: syntax, keys, types, and what later versions bring."""

import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.project import Project
from tests.draws import few_or_many


def test_a_valid_project_has_no_findings(shop):
    assert shop.findings() == []


def test_reading_opens_only_the_project_file(shop):
    shop.change('file = "sensor.kf"', 'file = "not there.kf"')
    assert shop.project.file.model.file == "not there.kf"


def test_a_project_has_the_name_of_its_folder_or_its_file(shop):
    assert shop.project.name == shop.folder.name
    shop.path.rename(shop.folder / "torque.toml")
    assert Project.read(shop.folder / "torque.toml").name == "torque"


def test_output_formats_become_file_endings(shop):
    shop.change('initial = "start.json"', 'initial = "start.json"\noutput = ["dcm", "csv", "cdfx", "JSON"]')
    assert shop.project.formats == (".dcm", ".csv", ".cdfx", ".json")


def test_the_optimizer_section_becomes_options(shop):
    shop.add(
        "[optimizer]\nmethod = 'gauss-newton'\nstarts = 4\nspread = 0.2\ncontinuation = 'off'\nmax_iterations = 7\n"
        "tolerance = 1e-4\nsave_every = 5\nseed = 3"
    )
    options = shop.project.options
    assert (options.max_iterations, options.tolerance, options.continuation) == (7, 1e-4, "off")
    assert (options.starts, options.spread, options.seed, options.save_every) == (4, 0.2, 3, 5)


def test_a_missing_project_file_names_the_nearest(shop):
    assert shop.path.is_file()
    with pytest.raises(InputError, match=r"the project file does not exist\. Did you mean kennfeld\.toml"):
        Project.read(shop.folder / "kenfeld.toml")


def test_a_syntax_error_has_its_line_column_and_excerpt(shop):
    shop.change('node = "Predict"', "node = Predict")
    with pytest.raises(InputError) as raised:
        Project.read(shop.path)
    (finding,) = raised.value.findings
    assert str(finding.location) == "kennfeld.toml line 14, column 8"
    assert finding.excerpt == "node = Predict\n       ^"
    assert "Text needs quotes" in str(finding)


def test_a_truncated_project_file_is_an_error(shop):
    shop.toml = shop.toml[: shop.toml.index("bench.csv") + 3]
    assert "kennfeld.toml line 8" in shop.error()


@pytest.mark.parametrize(
    ("added", "message"),
    [
        (
            '[model]\nfile = "b.kf"',
            "line 17: duplicate of section [model], which begins in line 1. Merge the two sections.",
        ),
        (
            "[dataset]\nname = 'a'",
            "line 17: duplicate of section [dataset], which begins in line 7. "
            "Merge the two sections. A list of them is written [[dataset]].",
        ),
        (
            "[parameters.Gain]\nfree = true\n[ parameters . Gain ]\nunit = 'Nm'",
            "line 19: duplicate of section [parameters.Gain], which begins in line 17. Merge the two sections.",
        ),
        ("[units]\nn = 'rpm'\nn = 'rpm'", "line 19: duplicate key n. Remove one of them."),
        ("[units]\nn = 'rpm'\nn = 'rpm'\n[optimizer]\nseed = 1", "line 19: duplicate key n. Remove one of them."),
        ("[parameters.Gain]\nx = { count = 3, count = 4 }", "line 18: duplicate key count. Remove one of them."),
    ],
)
def test_duplicates_are_errors_with_their_line(shop, added, message):
    assert shop.add(added).error() == f"kennfeld.toml {message}"


def test_windows_paths_in_double_quotes_get_a_hint(shop):
    shop.change('"bench.csv"', r'"data\Users\bench.csv"')
    assert "Write paths with / or in single quotes" in shop.error()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[model]\nfile = '\xe4.kf'\n", "kennfeld.toml line 2: byte 0xe4 is not valid UTF-8. Save the file as UTF-8."),
        (b"PK\x03\x04\0\0", "this is a binary file"),
        (b"a = " + b"[" * 5000, "brackets are nested too deeply"),
        (b"a = " + b"1" * 5000, "a value cannot be read"),
        (b"[model]\na" + b".a" * 50_000 + b" = 1", "kennfeld.toml line 2: the key a.a.a"),
        (b"[model" + b" . 'a b'" * 50_000 + b"]", "kennfeld.toml line 1: the key model . 'a b'"),
        (b"x = {y = 1, a" + b".a" * 50_000 + b" = 1}", "has more than 32 parts"),
    ],
)
def test_files_of_another_kind_are_distinguished(shop, content, expected):
    path = shop.path
    path.write_bytes(content)
    with pytest.raises(InputError, match=expected.replace("(", r"\(")):
        Project.read(path)


def test_a_project_file_of_many_megabytes_is_refused_unread(shop):
    path = shop.path
    with path.open("r+b") as file:
        file.truncate(30_000_000)
    with pytest.raises(InputError, match=r"the project file has 30 MB; the maximum is 20 MB\. Move large tables"):
        Project.read(path)


def test_many_dots_in_texts_and_comments_do_not_count_as_keys(shop):
    dots = "-." * 100
    path = shop.path
    path.write_text(f"# {dots}\n{path.read_text()}\n[units]\nx = '{dots}'\n")
    Project.read(path)


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(shop):
    path = shop.path
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert Project.read(path).check() == []


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("[modell]\nx = 1", "[modell]: unknown section. Did you mean model?"),
        ("[optimizer]\nmax_iteration = 5", "[optimizer] max_iteration: unknown key. Did you"),
        ("[optimizer]\nmax_iterations = '5'", "[optimizer] max_iterations: must be an integer >= 1, got '5'"),
        ("[optimizer]\nmax_iterations = true", "max_iterations: must be an integer >= 1, got true"),
        ("[optimizer]\ntolerance = 0", "[optimizer] tolerance: must be > 0, got 0"),
        ("[optimizer]\ntolerance = nan", "[optimizer] tolerance: must be a number, got nan"),
        ("[optimizer]\ncontinuation = 'of'", "[optimizer] continuation: unknown value 'of'. Did you mean off?"),
        ("[dataset2]", "[dataset2]: unknown section. Did you mean dataset?"),
        ("[[dataset]]\nfiles = ''", "[[dataset]] 2 files: must be a text or a list of texts, got ''"),
        ("[[dataset]]\nfiles = [1]", "[[dataset]] 2 files: must be a text or a list of texts, got [1]"),
        ("[[dataset]]\nname = 'a'", "[[dataset]] 2 files: the key is missing"),
        ("[[dataset]]\nfiles = 'a'\nuse = 'training data'", "[[dataset]] 2 use: unknown value 'training data'"),
        ("[[dataset]]\nfiles = 'a'\nweight = -1", "[[dataset]] 2 weight: must be >= 0, got -1"),
        ("[[dataset]]\nfiles = 'a'\nraster = 0", "[[dataset]] 2 raster: must be > 0, got 0"),
        ("[[dataset]]\nfiles = 'a'\nwhere = 3", "[[dataset]] 2 where: must be a text, got 3"),
        ("[[dataset]]\nfiles = 'a'\nshift = 3", "[[dataset]] 2 shift: must be a table, got 3"),
        ("[[dataset]]\nfiles = 'a'\nshift = {a = 'b'}", "[[dataset]] 2 shift a: must be a number, got 'b'"),
        ("[[criterion]]\nnode = 'a'", "[[criterion]] 2 target: the key is missing"),
        ("[[criterion]]\nnode = 'a'\ntarget = []", "2 target: must be a channel, a node or a number, got []"),
        ("[[criterion]]\nnode = 'a'\ntarget = {}", "[[criterion]] 2 target: must be either a channel or a node"),
        ("[[criterion]]\nnode = 'a'\ntarget = {chanel = 'b'}", "chanel: unknown key"),
        (
            "[[criterion]]\nnode = 'a'\ntarget = 1\nloss = 'hubert'\ndelta = 2",
            "loss: unknown value 'hubert'. Did you mean huber?",
        ),
        ("[[criterion]]\nnode = 'a'\ntarget = 1\ndelta = 2", f"delta requires the loss {' or '.join(ROBUST_LOSSES)}"),
        ("[parameters]\nGain = 3", "[parameters] Gain: must be a section, got 3. Write a section [parameters.Gain]."),
        ("[parameters.Gain]\nfree = 'yes'", "[parameters.Gain] free: must be true or false, got 'yes'"),
        ("[parameters.Gain]\nbounds = 3", "[parameters.Gain] bounds: must be a lower and an upper bound"),
        ("[parameters.Gain]\nbounds = [0, 'high']", "bounds: upper bound: must be a number, got 'high'"),
        ("[parameters.Gain]\nbounds = [nan, 1]", "bounds: lower bound: must be a number, got nan"),
        (
            "[parameters.Gain]\nbounds = [2, [1, 3]]",
            "bounds: lower bound 2 exceeds upper bound 1 at value 1",
        ),
        (
            "[parameters.Gain]\nbounds = [[1, 2, 3], [1, 3]]",
            "lower and upper bounds have different shapes, [3] and [2]",
        ),
        ("[parameters.Gain]\ninitial = [[1, 2], [3]]", "initial: rows must have equal length, got 2 and 1"),
        ("[parameters.Gain]\ninitial = [1, nan]", "[parameters.Gain] initial: value number 2 must be finite, got nan"),
        ("[parameters.Gain]\ninitial = []", "[parameters.Gain] initial: lists must not be empty"),
        ("[parameters.Gain]\nsmoothness = -1", "[parameters.Gain] smoothness: must be >= 0, got -1"),
        ("[parameters.Gain]\nsmoothness = {q = 1}", "[parameters.Gain] smoothness q: unknown key"),
        ("[parameters.Gain]\nlock = 'nodata'", "lock: must be a lock, got 'nodata'"),
        ("[parameters.Gain]\nlock = [{x = [2, 1]}]", "lock 1 x: must be the first and the last axis value"),
        ("[parameters.Gain]\npin = [{at = [1]}]", "[parameters.Gain] pin 1 value: the key is missing"),
        ("[parameters.Gain]\npin = {at = [1]}", "must be a list of pins, got"),
        ("[parameters.Gain]\nextrapolation = 'none'", "extrapolation: unknown value 'none'"),
        ("[parameters.Gain]\nx = [1, 2]", "[parameters.Gain] x: must be a table, got a list"),
        ("[parameters.Gain]\nx = {breakpoints = [1, 3, 2]}", "breakpoint 3 (2) does not exceed breakpoint 2 (3)"),
        ("[parameters.Gain]\nx = {breakpoints = 3}", "x breakpoints: must be a list of finite numbers"),
        ("[parameters.Gain]\nx = {begin = 0, end = 1}", "x: the axis has only begin, end"),
        ("[parameters.Gain]\nx = {begin = 1, end = 0, count = 3}", "x end: must be > begin = 1, got 0"),
        (
            "[parameters.Gain]\nx = {begin = -1e308, end = 1e308, count = 3}",
            "x end: is too far from begin = -1e+308, got 1e+308",
        ),
        ("[parameters.Gain]\nx = {begin = 0, end = 1, count = 1}", "x count: must be an integer >= 2, got 1"),
        ("[parameters.Gain]\nx = {begin = 0, end = 1, count = 999999}", "must be <= 100000, got 999999"),
        ("[parameters.Gain]\nx = {breakpoints = [1, 2], count = 2}", "breakpoints contradict begin, end and count"),
        ("[parameters.Gain]\nx = {axis = 'A', count = 2}", "x: the keys of a group axis belong in its own section"),
        ("[optimizer]\nstarts = 1000000000", "[optimizer] starts: must be <= 10000, got 1000000000"),
        ("[axes.A]\naxis = 'B'", "[axes.A] axis: unknown key"),
    ],
)
def test_each_wrong_key_is_one_finding(shop, section, expected):
    shop.add(section)
    assert expected in "\n".join(shop.errors())
    assert all(error.startswith("kennfeld.toml ") for error in shop.errors())
    with pytest.raises(InputError):
        Project.read(shop.path)


@pytest.mark.parametrize("smoothness", ["'auto'", "{ x = 'auto' }"])
def test_smoothness_may_be_automatic(shop, smoothness):
    problem = shop.add(f"[parameters.Gain]\nsmoothness = {smoothness}").project.problem()
    assert problem.automatic_names == ("Gain",)


def test_an_invalid_smoothness_is_refused(shop):
    expected = "smoothness x: must be a number >= 0 or \"auto\", got 'automatic'"
    assert expected in shop.add("[parameters.Gain]\nsmoothness = { x = 'automatic' }").error()


def test_a_shift_may_be_automatic_for_each_channel(shop):
    shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nshift = { Torque = "auto", n = 1 }')
    assert shop.project.problem().unknown_shifts == {"bench": ("Torque",)}


def test_a_shift_is_automatic_for_named_channels_only(shop):
    shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nshift = "auto"')
    assert 'shift = "auto" must name a channel. Write shift = { Channel = "auto" }.' in shop.error()


def test_a_channel_that_others_are_calculated_from_has_no_automatic_shift(shop):
    shop.change('files = ["bench.csv"]', 'files = ["bench.csv"]\nshift = { Load = "auto" }')
    shop.change('Speed = "n"', 'Speed = "n"\nLoad = "half"').add("[calculated]\nhalf = 'Load / 2'")
    assert 'the shift of Load cannot be "auto" because [calculated] half reads it' in shop.error()


def test_a_test_dataset_cannot_estimate_a_shift(shop):
    shop.bench("fresh.csv")
    shop.add("[[dataset]]\nfiles = 'fresh.csv'\nuse = 'test'\nshift = { Torque = 'auto' }")
    assert 'shift = "auto" for Torque must be set on a training dataset' in shop.error()


def test_an_unknown_output_format_is_refused(shop):
    shop.change('initial = "start.json"', 'output = ["dmc"]')
    assert "unknown calibration format 'dmc'. Did you mean dcm?" in shop.error()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('[model]\nfile = "sensor.kf"\n', "", "[model]: the section is missing"),
        ('file = "sensor.kf"', "", "[model] file: the key is missing"),
        ("[model]", "[[model]]", "[model]: must be one section, got [[model]]. Write [model] with single brackets."),
        ("[[dataset]]", "[dataset]", "[[dataset]]: must be a section, got {'files': ['bench.csv']}"),
        ('[[dataset]]\nfiles = ["bench.csv"]\n', "", "[[dataset]]: the section is missing"),
        ('[[criterion]]\nnode = "Predict"\ntarget = "Torque"\n', "", "[[criterion]]: the section is missing"),
        ('Speed = "n"', "Speed = 3", "[channels] Speed: must be a text, got 3"),
        ("[model]", "speed = 1\n[model]", "kennfeld.toml speed: unknown key"),
    ],
)
def test_missing_and_misspelt_sections_are_named(shop, old, new, expected):
    assert expected in shop.change(old, new).error()


def test_all_problems_of_the_file_come_at_once(shop):
    shop.add("[optimizer]\ntolerance = 'x'\nmax_iterations = 0\n[foo]\n[parameters.Gain]\nbonds = [0, 1]")
    assert len(shop.errors()) == 4


STEADY = """[channels.calculated]
half = "n / 2"
[units]
n = "rpm"
[[dataset]]
cache = false
steady = [{ channel = "n", window = 5, tolerance = 1 }, { channel = "half", window = 1, tolerance = 0.5 }]
"""
TOKENS = [*'=[]{}",.#', "\n", "nan", "-1", "true", "'", "[[dataset]]", "x = 1", "1e999", "inf", '"', "é", "\t"]


@few_or_many(data=st.data(), few=25, many=400)
def test_a_damaged_project_file_is_read_or_refused(shop, sound_toml, data):
    text = (
        sound_toml.replace("[[dataset]]", STEADY)
        + "\n[parameters.Gain]\nx = { input = 'Speed', count = 3 }\nbounds = [0, inf]\nlock = [{ x = [1, 2] }]\n"
    )
    for _ in range(data.draw(st.integers(1, 3))):
        first = data.draw(st.integers(0, len(text)))
        last = data.draw(st.integers(first, min(len(text), first + 12)))
        text = text[:first] + data.draw(st.sampled_from(TOKENS)) + text[last:]
    shop.toml = text
    path, findings = shop.path, []
    try:
        findings += Project.read(path).check()
    except InputError as error:
        findings += error.findings
    assert all(str(finding) and str(finding.location) for finding in findings)


def test_calculated_channels_may_stand_within_the_channels(shop):
    shop.change('Speed = "n"', 'Speed = "n"\n[channels.calculated]\ntwice = "2 * n"').add(
        '[calculated]\nhalf = "n / 2"'
    )
    file = shop.project.file
    assert file.channels == {"Speed": "n"}
    assert file.calculated == {"twice": "2 * n", "half": "n / 2"}


def test_a_channel_that_is_calculated_in_two_places_is_an_error(shop):
    shop.change('Speed = "n"', 'Speed = "n"\n[channels.calculated]\nhalf = "n / 2"').add('[calculated]\nhalf = "n / 3"')
    assert (
        shop.error()
        == "kennfeld.toml [channels] calculated half: duplicate of the channel in [calculated]. Remove one."
    )


def test_an_input_may_be_called_calculated(shop):
    shop.change('Speed = "n"', 'Speed = "n"\ncalculated = "Torque"')
    assert shop.project.file.channels == {"Speed": "n", "calculated": "Torque"}


def test_a_formula_must_be_text(shop):
    shop.change('Speed = "n"', 'Speed = "n"\n[channels.calculated]\nhalf = 3')
    assert "[channels] calculated half: must be a text, got 3" in shop.error()
