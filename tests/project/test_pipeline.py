"""Datasets of a project: files, channels, calculated channels, samples that count."""

from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import Location
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.preprocessing.recordings import find_databases, find_recordings


def timed(shop, name="bench.csv", samples=6, **columns):
    n = np.linspace(1000, 3000, samples)
    shop.csv(name, {"time [s]": np.arange(samples) * 0.1, "n [rpm]": n, "Load": n / 100, "Torque": n / 10} | columns)


def dataset(shop, which=0):
    assert shop.errors() == []
    return shop.project.problem().datasets[which]


def test_each_matching_file_is_a_piece_in_the_order_of_its_name(shop):
    for name, speed in (("run_2", [2000, 2500]), ("run_1", [1000, 1100, 1500]), ("run_3", [3000])):
        shop.bench(f"{name}.csv", speed)
    data = dataset(shop.change('"bench.csv"', '"run_*.csv"'))
    assert (data.name, data.piece_starts.tolist()) == ("run", [0, 3, 5])
    assert data["n"].values.tolist() == [1000, 1100, 1500, 2000, 2500, 3000]


def test_files_of_the_cache_are_not_recordings(shop):
    shop.bench("bench.parquet")
    shop.write(".kennfeld/cache/1-2-3.parquet", b"kept")
    shop.write("kennfeld/cache/a.parquet", b"mine")
    files = [
        path.removeprefix(str(shop.folder))[1:].replace("\\", "/")
        for path in find_recordings(shop.folder, "**/*.parquet")
    ]
    assert files == ["bench.parquet", "kennfeld/cache/a.parquet"]


def test_a_file_that_two_patterns_match_is_read_once(shop):
    assert dataset(shop.change('"bench.csv"', '"bench.csv", "b*.csv"')).samples == 6


def test_files_in_folders_and_with_absolute_paths_match(shop):
    shop.bench("data/a.csv")
    shop.bench("data/deep/b.csv")
    assert dataset(shop.change('"bench.csv"', '"data/**/*.csv"')).samples == 12
    absolute = (shop.folder / "data" / "a.*").as_posix()
    assert dataset(shop.change('"data/**/*.csv"', f'"{absolute}"')).samples == 6


def test_brackets_in_the_name_of_an_existing_file_are_not_a_pattern(shop):
    shop.bench("run[1].csv")
    assert dataset(shop.change('"bench.csv"', '"run[1].csv"')).samples == 6


def test_a_dataset_has_its_stated_name_or_that_of_its_file(shop):
    assert dataset(shop).name == "bench"
    assert dataset(shop.change('files = ["bench.csv"]', 'files = "bench.csv"\nname = "engine"')).name == "engine"


def test_use_weight_and_gap_reach_the_dataset(shop):
    shop.add('[[dataset]]\nfiles = "bench.csv"\nname = "other"\nuse = "test"\nweight = 2.5')
    data = dataset(shop, 1)
    assert (data.use, data.weight) == ("test", 2.5)


def test_a_sheet_of_a_workbook_stays_with_each_file_that_matches(tmp_path):
    for name in ("b.xlsx", "a.xlsx", "c#1.csv"):
        (tmp_path / name).touch()
    assert find_recordings(tmp_path, "*.xlsx#Measured") == [
        f"{tmp_path / name}#Measured" for name in ("a.xlsx", "b.xlsx")
    ]
    assert find_recordings(tmp_path, "b.xlsx#Measured") == [f"{tmp_path / 'b.xlsx'}#Measured"]
    assert find_recordings(tmp_path, "c#1.csv") == [str(tmp_path / "c#1.csv")]


def test_a_pattern_without_files_names_the_nearest(shop):
    error = shop.change('"bench.csv"', '"benhc.csv"').error()
    assert error == "kennfeld.toml [[dataset]] 1 files: benhc.csv matches no file. Did you mean bench.csv?"


def test_a_pattern_without_similar_files_names_the_whole_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    entry = DatasetEntry(location=Location("kennfeld.toml"), files=("a.csv",), dbc=("gone.dbc",))
    _, (finding,) = find_databases(Path(), entry)
    assert finding.remedy == f"Paths are relative to the folder {tmp_path.resolve()}."


def test_a_missing_folder_is_named(shop):
    assert shop.change('"bench.csv"', '"dat/*.csv"').error().endswith("dat does not exist.")


def test_two_datasets_of_one_name_are_a_finding(shop):
    error = shop.add('[[dataset]]\nfiles = "bench.csv"').error()
    assert "[[dataset]] 2 name: duplicate dataset name bench" in error


def test_a_missing_channel_is_named_with_the_nearest_and_its_use(shop):
    shop.change('Speed = "n"', 'Speed = "nn"')
    assert shop.error() == "bench.csv: has no channel nn, the input Speed of the function. Did you mean n?"


def test_an_input_without_a_channel_shows_the_line_to_write(shop):
    shop.bench("bench.csv", **{"n [rpm]": None, "rotation": [1.0] * 6})
    error = shop.change('[channels]\nSpeed = "n"\n', "").error()
    assert "bench.csv: has no channel Speed, the input Speed of the function. It has Load, Torque, rotation." in error
    assert 'Name its channel in [channels]: Speed = "..."' in error


def test_an_input_that_may_be_a_scalar_comes_with_the_section_that_defines_it(shop):
    shop.bench("bench.csv", **{"n [rpm]": None})
    [finding] = shop.change('[channels]\nSpeed = "n"\n', "").findings()
    assert finding.excerpt == "[parameters.Speed]\ninitial = 1.0"
    shop.toml = shop.toml.replace("[calibration]", '[channels]\nSpeed = "m"\n[calibration]')
    assert [finding.excerpt for finding in shop.findings()] == [""]


def test_a_channel_missing_in_many_files_is_one_finding(shop):
    for i in range(5):
        shop.bench(f"run{i}.csv", **{"Load": None})
    assert "run0.csv and 4 more: has no channel Load" in shop.change('"bench.csv"', '"run*.csv"').error()


def test_findings_of_a_reader_come_with_the_others(shop):
    shop.write("bench.csv", "n,Load,Torque\n1000,10,15\n1100,x,16\n1200,11,17\n")
    errors = shop.change('initial = "start.json"', 'initial = "nothing.dcm"').errors()
    assert any("bench.csv line 3, column Load: must be a number, got 'x'" in e for e in errors)
    assert any("file nothing.dcm does not exist" in e for e in errors)


def test_another_kind_of_file_with_a_known_ending_is_named(shop):
    shop.write("bench.csv", b"%PDF-1.7" + b"\0" * 200)
    assert "this is a PDF file, which cannot be read as a measurement" in shop.error()


def test_a_file_without_samples_is_a_finding(shop):
    shop.write("bench.csv", "n,Load,Torque\n")
    assert shop.error().startswith("bench.csv line 1: there are names but no row of numbers below them")


def test_calculated_channels_may_use_each_other_in_any_order(shop):
    shop.bench("bench.csv", **{"Load": None, "air": [1.0, 2, 3, 4, 5, 6]})
    shop.add('[calculated]\nLoad = "twice + 1"\ntwice = "2 * air"')
    assert dataset(shop)["Load"].values.tolist() == [3, 5, 7, 9, 11, 13]


def test_a_calculated_channel_with_memory_restarts_at_each_piece(shop):
    for name in ("run1.csv", "run2.csv"):
        timed(shop, name, 3)
    shop.change('"bench.csv"', '"run?.csv"').add('[calculated]\nLoad = "prev(n, -1) + 0 * t"')
    assert dataset(shop)["Load"].values.tolist() == [-1, 1000, 2000, -1, 1000, 2000]


def test_a_calculated_channel_is_nan_where_its_source_is(shop):
    shop.bench("bench.csv", **{"Load": None, "air": [1.0, np.nan, 3, 4, 5, 6]})
    shop.add('[calculated]\nLoad = "prev(air, 0)"')
    assert np.isnan(dataset(shop)["Load"].values).tolist() == [False, True, False, False, False, False]


def test_a_constant_may_be_a_calculated_channel(shop):
    shop.bench("bench.csv", **{"Load": None})
    assert "channel Load is constant (12) in the training data" in shop.add('[calculated]\nLoad = "12"').warning()


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("2 * n +", "kennfeld.toml [calculated] Load, column 8: incomplete expression"),
        ("Load * 2", "[calculated] Load: circular definition: Load -> Load"),
        ("air * 2", "bench.csv: has no channel air, which [calculated] Load needs"),
        ("n + dt", "[calculated] Load: Load requires time stamps, but dataset bench has none"),
    ],
)
def test_a_wrong_calculated_channel_is_a_finding(shop, formula, expected):
    assert expected in shop.add(f'[calculated]\nLoad = "{formula}"').error()


def test_a_loop_of_calculated_channels_is_named(shop):
    shop.add('[calculated]\nLoad = "a"\na = "b + n"\nb = "a"')
    assert "circular definition: a -> b -> a" in shop.error()


def test_an_unused_calculated_channel_is_a_warning(shop):
    assert "[calculated] air: unused channel" in shop.add('[calculated]\nair = "n / 2"').warning()


def test_a_condition_excludes_samples_from_the_score(shop):
    data = dataset(shop.change('"bench.csv"]', '"bench.csv"]\nwhere = "n > 1200 and Load < 13"'))
    assert data.scored.tolist() == [False, True, True, False, True, False]


def test_a_condition_may_use_channels_that_the_function_does_not_read(shop):
    shop.bench("bench.csv", **{"%valid": [1.0, 0, 1, np.nan, 1, 1]})
    data = dataset(shop.change('"bench.csv"]', '"bench.csv"]\nwhere = "%%%valid%"'))
    assert data.scored.tolist() == [True, False, True, False, True, True]


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ("n >", "[[dataset]] 1 where, column 4: incomplete expression"),
        ("lambda1 > 1", "bench.csv: has no channel lambda1, the condition `where`"),
        ("n > 9999", "[[dataset]] 1 where: n > 9999 is true at no sample"),
        ("t > 1", "[[dataset]] 1 where: the condition requires time stamps, but the data have none"),
    ],
)
def test_a_wrong_condition_is_a_finding(shop, condition, expected):
    assert expected in shop.change('"bench.csv"]', f'"bench.csv"]\nwhere = "{condition}"').error()


def test_a_condition_on_a_wrong_calculated_channel_adds_no_finding(shop):
    shop.change('"bench.csv"]', '"bench.csv"]\nwhere = "air > 1"').add('[calculated]\nair = "n *"')
    assert "[calculated] air" in shop.error()


def test_a_warmup_excludes_the_begin_of_each_piece_from_the_score(shop):
    timed(shop, "run1.csv", 4)
    timed(shop, "run2.csv", 3)
    shop.change('"bench.csv"]', '"run?.csv"]\nwarmup = 0.2')
    assert dataset(shop).scored.tolist() == [False, False, True, True, False, False, True]


def test_a_warmup_longer_than_the_data_is_a_finding(shop):
    timed(shop)
    assert "warmup: 60 s is longer than every piece" in shop.change('"bench.csv"]', '"bench.csv"]\nwarmup = 60').error()


@pytest.mark.parametrize("key", ["warmup = 1.0", "max_gap = 1.0"])
def test_keys_that_require_time_stamps_are_a_finding_without_them(shop, key):
    assert "requires time stamps, but the data have none" in shop.change('"bench.csv"]', f'"bench.csv"]\n{key}').error()


def test_steady_data_are_shifted_by_whole_samples(shop):
    shop.change('"bench.csv"]', '"bench.csv"]\nshift = { Torque = -1 }')
    before = (
        np.interp([1000, 1500, 2000, 2500, 3000, 1200], [1000, 2000, 3000], [1, 2, 3]) * [10, 11, 12, 13, 10, 11] + 5
    )
    np.testing.assert_allclose(dataset(shop)["Torque"].values, [*before[1:], np.nan])


def test_steady_data_cannot_be_shifted_by_half_a_sample(shop):
    shop.change('"bench.csv"]', '"bench.csv"]\nshift = { Torque = 0.5 }')
    assert "shift: 0.5 samples of Torque" in shop.error()


def test_time_data_are_shifted_in_seconds_in_each_file(shop):
    timed(shop, "run1.csv", 3)
    timed(shop, "run2.csv", 3)
    shop.change('"bench.csv"]', '"run?.csv"]\nshift = { Torque = 0.1 }')
    np.testing.assert_allclose(dataset(shop)["Torque"].values, [np.nan, 100, 200, np.nan, 100, 200])


def test_a_calculated_channel_can_be_shifted(shop):
    shop.bench("bench.csv", **{"Load": None})
    shop.change('"bench.csv"]', '"bench.csv"]\nshift = { Load = 1 }').add('[calculated]\nLoad = "n / 100"')
    np.testing.assert_allclose(dataset(shop)["Load"].values, [np.nan, 10, 15, 20, 25, 30])


def test_a_shift_of_an_unknown_channel_is_a_finding(shop):
    shop.change('"bench.csv"]', '"bench.csv"]\nshift = { Torqe = 1 }')
    assert "shift: channel Torqe is not used. Did you mean Torque?" in shop.error()


def test_a_raster_resamples_the_data_to_an_even_grid(shop):
    timed(shop)
    data = dataset(shop.change('"bench.csv"]', '"bench.csv"]\nraster = 0.25'))
    np.testing.assert_allclose(data.time, [0, 0.25, 0.5])
    np.testing.assert_allclose(data["n"].values, [1000, 2000, 3000])


def test_a_finer_model_step_makes_samples_between_the_data(shop):
    timed(shop)
    shop.text += "Late = PT1(Predict, 1)\n"
    shop.change('file = "sensor.kf"', 'file = "sensor.kf"\nstep = 0.05')
    data = dataset(shop)
    assert (data.samples, int(data.scored.sum())) == (11, 6)
    assert np.isnan(data["Torque"].values).sum() == 5
    assert not np.isnan(data["n"].values).any()


def test_a_model_step_that_does_not_divide_the_data_is_a_finding(shop):
    timed(shop)
    shop.text = "step 0.03\n" + shop.text + "Late = PT1(Predict, 1)\n"
    assert "[[dataset]] 1: the data's step of 0.1 s is not a whole multiple of the model's step" in shop.error()


def test_the_step_of_a_model_without_memory_is_ignored(shop):
    timed(shop)
    assert dataset(shop.change('file = "sensor.kf"', 'file = "sensor.kf"\nstep = 0.03')).samples == 6


def test_a_target_that_one_dataset_lacks_is_a_warning(shop):
    shop.bench("other.csv", **{"Torque [Nm]": None})
    shop.add('[[dataset]]\nfiles = "other.csv"')
    assert "dataset other has no channel Torque; Predict is not scored there" in shop.warning()


POWER = '[[dataset]]\nfiles = "other.csv"\n[[criterion]]\nnode = "Predict"\ntarget = { channel = "Power" }'


def test_a_separate_dataset_for_another_criterion_does_not_warn(shop):
    shop.bench("other.csv", **{"Torque [Nm]": None, "Power [Nm]": np.arange(6)})
    shop.add(POWER)
    assert shop.findings() == []


def test_a_target_missing_in_one_of_several_datasets_is_a_warning(shop):
    """Both criteria are scored on the first dataset, so the second may have lost a channel."""
    shop.bench("bench.csv", **{"Power [Nm]": np.arange(6)})
    shop.bench("other.csv", **{"Torque [Nm]": None, "Power [Nm]": np.arange(6)})
    shop.add(POWER)
    assert "dataset other has no channel Torque; Predict is not scored there" in shop.warning()


def test_a_target_that_one_file_lacks_is_nan_there(shop):
    shop.bench("bench2.csv", **{"Torque [Nm]": None})
    data = dataset(shop.change('"bench.csv"', '"bench*.csv"'))
    assert np.isnan(data["Torque"].values).tolist() == [False] * 6 + [True] * 6


def test_files_with_other_units_are_a_warning(shop):
    shop.bench("bench2.csv", **{"Torque [Nm]": None, "Torque [bar]": np.arange(6)})
    warnings = shop.change('"bench.csv"', '"bench*"').warnings()
    assert any("channel Torque is in Nm in one file and in bar in another" in text for text in warnings)


def test_files_with_and_without_time_cannot_be_combined(shop):
    timed(shop, "bench2.csv")
    assert "mixes recordings with and without time stamps" in shop.change('"bench.csv"', '"bench*.csv"').error()


def test_a_model_with_memory_in_time_needs_time(shop):
    shop.text += "Late = PT1(Predict, 1)\n"
    assert "1 (bench): the function requires time steps, but dataset bench has no time stamps" in shop.error()


def test_no_training_dataset_is_a_finding(shop):
    error = shop.change('"bench.csv"]', '"bench.csv"]\nuse = "test"').error()
    assert "[[dataset]]: no dataset is used for training" in error


def test_inputs_that_never_have_values_together_are_a_finding(shop):
    nan = np.nan
    shop.bench("bench.csv", **{"n [rpm]": [1e3, 2e3, 3e3, nan, nan, nan], "Load": [nan, nan, nan, 1, 2, 3]})
    assert "no sample of dataset bench has all inputs: n is missing in 50%, Load is missing in 50%" in shop.error()


def test_a_dataset_has_its_warmup_and_its_longest_gap(shop):
    timed(shop)
    shop.change('"bench.csv"]', '"bench.csv"]\nwarmup = 0.2\nmax_gap = 0.5')
    assert (dataset(shop).warmup, dataset(shop).max_gap) == (0.2, 0.5)


def test_warnings_of_a_reader_are_those_of_the_project(shop):
    shop.bench("bench.csv", **{"Torque [Nm]": [15, 21.5, np.inf, 37.5, 43, -np.inf]})
    assert shop.warnings()[0] == "bench.csv line 4, column Torque: 2 of 6 values are infinite and treated as missing"
