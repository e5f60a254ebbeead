"""Where the files of a model's scripts are searched."""

import scipy

from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_runs import alone


def imported(folder, script, sources=(), **options):
    """The report on a gain of `K`, whose script is `scripts/init.m`."""
    (folder / "scripts").mkdir()
    path = folder / "scripts" / "init.m"
    path.write_text(script)
    return import_simulink(alone("Gain", Gain="K").write(folder), parameters=[path, *sources], **options).report


def saved(folder, name="vals.mat", value=5.0):
    folder.mkdir(exist_ok=True)
    scipy.io.savemat(folder / name, {"K": value})
    return folder / name


def test_a_script_loads_a_data_file_from_a_further_folder(tmp_path):
    saved(tmp_path / "sub")
    (parameter,) = imported(tmp_path, "load('vals.mat')", folders=[tmp_path / "sub"]).parameters
    assert parameter.smallest == 5.0


def test_a_script_loads_a_data_file_from_the_folder_of_the_model(tmp_path):
    saved(tmp_path)
    assert imported(tmp_path, "load vals").whole


def test_the_folder_of_the_script_comes_first(tmp_path):
    saved(tmp_path, value=1.0)
    (tmp_path / "m").mkdir()
    saved(tmp_path / "m", value=2.0)
    script = tmp_path / "m" / "init.m"
    script.write_text("load vals")
    path = alone("Gain", Gain="K").write(tmp_path)
    assert import_simulink(path, parameters=[script], folders=[tmp_path]).report.parameters[0].smallest == 2.0


def test_folders_in_the_name_of_a_file_are_those_of_another_machine(tmp_path):
    saved(tmp_path / "sub")
    script = r"load('C:\Users\me\project\vals.mat')"
    assert imported(tmp_path, script, folders=[tmp_path / "sub"]).whole


def test_a_data_file_among_the_parameters_is_the_one_that_a_script_loads(tmp_path):
    path = saved(tmp_path / "elsewhere", value=4.0)
    report = imported(tmp_path, "load('../data/vals.mat'); K = K + 1;", [path])
    assert report.whole


def test_a_script_runs_another_one_from_a_further_folder(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "gains.m").write_text("K = 3;")
    assert imported(tmp_path, "gains", folders=[tmp_path / "sub"]).parameters[0].smallest == 3.0


def test_files_that_scripts_need_in_vain_are_missing_files(tmp_path):
    report = imported(tmp_path, "load('vals.mat')\nrun('gains.m')\nbase_values\nfigure\n")
    assert report.missing_files == dict.fromkeys(("vals.mat", "gains.m", "base_values.m"), "init.m")
