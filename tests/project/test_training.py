"""Training files: what they say, and every problem of theirs."""

import re
import signal

import numpy as np
import pytest

from kennfeld import cli
from kennfeld.base.errors import InputError
from kennfeld.project.surrogate_training import Training, read_training
from kennfeld.surrogate import read_surrogate
from kennfeld.surrogate.training import SurrogateSettings
from kennfeld.terminal.progress import Interrupt

STATIC = """\
[surrogate]
inputs = ["n", "Load"]
output = "Torque"
starts = 1

[[dataset]]
files = ["bench.csv"]
"""

DYNAMIC = """\
[surrogate]
kind = "dynamic"
inputs = ["u"]
output = "level"

[[dataset]]
files = ["tank.csv"]
"""


@pytest.fixture
def training(shop):
    """Return a function that writes a training file, with parts of it replaced."""

    def write(text=STATIC, *changes, name="engine.toml"):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        shop.write(name, text)
        return shop.folder / name

    time = np.arange(60) * 1.0
    u = np.where(time % 20 < 10, 1.0, 0.4)
    shop.csv("tank.csv", {"time [s]": time, "u": u, "level [m]": np.cumsum(u - 0.7)})
    return write


def problems(path):
    """All problems, without the lines of the training file, which `test_a_problem_has_its_line` checks."""
    try:
        findings = read_training(path).check()[1]
    except InputError as error:
        findings = error.findings
    return [re.sub(r"^engine.toml line \d+", "engine.toml", str(finding)) for finding in findings]


def test_a_problem_has_its_line(training):
    path = training(
        DYNAMIC, ('"level"\n', '"level"\nstep = 0\n\nlags = { u = [0], v = [-1] }\n'), ('["tank.csv"]', "1")
    )
    with pytest.raises(InputError) as raised:
        read_training(path)
    assert [(f.location.line, f.location.path) for f in raised.value.findings] == [
        (5, "[surrogate] step"),
        (7, "[surrogate] lags v"),
        (7, "[surrogate] lags v"),
        (10, "[[dataset]] 1 files"),
    ]


def the_problem(path):
    (problem,) = problems(path)
    return problem


def test_missing_keys_have_the_defaults_of_python(training):
    file = read_training(training(DYNAMIC))
    assert file.settings == SurrogateSettings("engine", ("u",), "level", kind="dynamic")
    assert file.target.name == "engine.json"
    assert read_training(training(DYNAMIC, name="surrogate.toml")).settings.name == "level"


def test_every_key_is_read(training):
    keys = (
        'name = "tank"\nfile = "t.json"\nmethod = "sparse"\ncentres = 12\nseed = 3\nstarts = 2\nstep = 0.5\n'
        "lags = { u = [0, 2] }\noutput_lags = [1, 3]\nlongest_lag = 7\nlimits = [0, 10]\nfree_run = false\n"
        "moves_centres = true\nhold = 0.5\niterations = 4\nheld = 'u'\nstructure = 'narx'\nkinks = false\n"
    )
    file = read_training(training(DYNAMIC, ("[[dataset]]", f"{keys}[[dataset]]")))
    assert file.target.name == "t.json"
    assert file.settings == SurrogateSettings(
        *("tank", ("u",), "level", "dynamic"),
        method="sparse",
        centres=12,
        seed=3,
        starts=2,
        step=0.5,
        lags={"u": (0, 2)},
        output_lags=(1, 3),
        longest_lag=7,
        limits=(0.0, 10.0),
        free_run=False,
        moves_centres=True,
        hold=0.5,
        iterations=4,
        held=("u",),
        structure="narx",
        kinks=False,
    )


def test_all_problems_of_a_file_are_reported_at_once(training):
    keys = (
        'method = "exact"\ncentres = 0\nseed = -1\nstarts = 1.5\nstep = 0\nlags = { v = [-1] }\noutput_lags = [0]\n'
        'longest_lag = "a"\nlimits = [3, 1]\nfree_run = 1\nhold = -2\niterations = 0\nfile = "no/x.json"\ncolour = 1\n'
    )
    messages = problems(training(DYNAMIC, ('"level"\n', f'"level"\n{keys}'), ('["u"]', '["u", "level"]')))
    named = [message.removeprefix("engine.toml [surrogate] ").partition(":")[0] for message in messages]
    assert sorted(named) == sorted(
        [
            *("output", "method", "centres", "seed", "starts", "step", "lags v", "lags v", "lags u", "lags level"),
            *("output_lags", "longest_lag", "limits", "free_run", "hold", "iterations", "file", "colour"),
        ]
    )


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('["n", "Load"]', "[]", "engine.toml [surrogate] inputs: the list is empty"),
        ('"Torque"\n', '"n"\n', "engine.toml [surrogate] output: n is also an input"),
        ("starts = 1", "hold = 1", 'hold requires a dynamic surrogate. Write kind = "dynamic", or remove it.'),
        ("starts = 1", 'file = "engine.toml"', "engine.toml is this training file"),
        ("starts = 1", 'file = "."', "file: . is a folder"),
        ('["bench.csv"]\n', '["bench.csv"]\nweight_channel = "n"', "1 weight_channel: weight_channel is not supported"),
        ('["bench.csv"]\n', '["bench.csv"]\nshift = { n = "auto" }', "Write the shift as a number."),
        ('["bench.csv"]\n', '["bench.csv"]\nuse = "test"', "no dataset is used for training"),
        ('"bench.csv"', '"bnch.csv"', "Did you mean bench.csv?"),
        ('"Load"', '"Laod"', "bench.csv: has no channel Laod, an input of the surrogate"),
        ("[surrogate]", "[modle]\n[surrogate]", "unknown section"),
    ],
)
def test_a_problem_has_its_location_and_remedy(training, old, new, expected):
    assert expected in the_problem(training(STATIC, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('["u"]\n', '["u"]\nlags = { u = [] }\n', "lags u: must be integers >= 0, in samples, got []"),
        ('["u"]\n', '["u"]\nlags = "all"\n', "lags: must be a table, got 'all'"),
        ('["u"]\n', '["u"]\noutput_lags = []\n', "output_lags: must be integers >= 1, in samples, got []"),
        ('"tank.csv"', '"bench.csv"', "has no channel"),
    ],
)
def test_a_problem_of_a_dynamic_surrogate_has_its_location_and_remedy(training, old, new, expected):
    assert any(expected in message for message in problems(training(DYNAMIC, (old, new))))


def test_a_constant_channel_is_an_error(training, shop):
    shop.bench("bench.csv", Load=np.full(6, 12.0))
    assert the_problem(training()).startswith(
        "engine.toml [surrogate]: channel Load is constant (12) in the training data"
    )


def test_a_dynamic_surrogate_needs_time_and_pieces_without_gaps(training, shop):
    shop.csv("tank.csv", {"u": np.arange(9), "level": np.arange(9)})
    assert "requires time stamps" in the_problem(training(DYNAMIC))
    level = np.where(np.arange(20) % 4 == 0, np.nan, np.arange(20))
    shop.csv("tank.csv", {"time [s]": np.arange(20), "u": np.arange(20), "level": level})
    assert "all gap-free pieces of the training data are too short" in the_problem(training(DYNAMIC))


def test_a_static_surrogate_learns_from_the_plateaus_of_recordings(training, shop):
    level = np.repeat([1.0, 3.0, 2.0, 5.0, 4.0, 6.0], 10)
    shop.csv("bench.csv", {"time [s]": np.arange(60.0), "n": 1000 * level, "Load": level**2, "Torque": 2 * level})
    steady = 'files = ["bench.csv"]\nsteady = { channel = "n", window = 5, tolerance = 10 }'
    path = training(STATIC, ('files = ["bench.csv"]', steady))
    [data] = read_training(path).datasets()
    assert data["Torque"].values.tolist() == [2, 6, 4, 10, 8, 12]
    assert "6 plateaus" in the_problem(path)


def test_a_dynamic_surrogate_cannot_learn_from_plateaus(training):
    steady = 'files = ["tank.csv"]\nsteady = { channel = "u", window = 5, tolerance = 0 }'
    messages = problems(training(DYNAMIC, ('files = ["tank.csv"]', steady)))
    assert any("requires time stamps" in message for message in messages)


def test_units_can_be_stated_if_files_have_none(training, shop):
    shop.bench("bench2.csv", **{"n [rpm]": None, "n": 100 * np.arange(6)})
    text = STATIC.replace('"bench.csv"', '"bench*.csv"') + '[units]\nn = "rad/s"\n'
    assert problems(training(text)) == []
    assert read_training(training(text)).datasets()[0]["n"].unit == "rad/s"


def test_check_identifies_a_training_file(training, capsys):
    path = training()
    assert cli.run(["check", str(path)]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        f"{path}: a training file, no problem found",
        "static surrogate Torque = engine(n, Load); 6 training samples in bench",
        f"Next: kennfeld surrogate train {path}",
    ]
    assert err == ""
    assert not (path.parent / "engine.json").exists()


def test_check_gives_problems_of_file_and_data_on_stderr(training, capsys):
    assert cli.run(["check", str(training(STATIC, ('"bench.csv"', '"bnch.csv"')))]) == 2
    assert capsys.readouterr().err.startswith("engine.toml line 7 [[dataset]] 1 files: bnch.csv matches no file")
    assert cli.run(["check", str(training(STATIC, ("starts = 1", "starts = 0")))]) == 2
    assert "starts: must be an integer >= 1, got 0" in capsys.readouterr().err


def test_a_file_that_check_accepts_can_be_trained(training, shop, capsys):
    shop.bench("bench.csv", speed=np.linspace(1000, 3000, 30))
    path = training()
    assert cli.run(["check", str(path)]) == 0
    assert cli.run(["surrogate", "train", str(path)]) == 0
    assert read_surrogate(shop.folder / "engine.json").inputs == ("n", "Load")
    capsys.readouterr()
    assert cli.run(["info", str(shop.folder / "engine.json")]) == 0
    assert "n           rpm   1000  3000" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["calibrate", "simulate", "report"])
def test_other_commands_refuse_a_training_file(training, capsys, command):
    assert cli.run([command, str(training())]) == 2
    message = "engine.toml: this is a training file, not a project. Run `kennfeld surrogate train`.\n"
    assert capsys.readouterr().err == message


def test_a_project_is_refused_as_a_training_file(shop, capsys):
    assert cli.run(["surrogate", "train", str(shop.path)]) == 2
    expected = "kennfeld.toml: this is a project, not a training file. Run `kennfeld calibrate`.\n"
    assert capsys.readouterr().err == expected


def test_info_describes_a_training_file(training, capsys):
    assert cli.run(["info", str(training())]) == 0
    out = capsys.readouterr().out
    assert out.startswith("engine.toml: training file of the static surrogate Torque = engine(n, Load)\n")
    assert "bench.csv" in out


def press_at(monkeypatch, count):
    """Press Ctrl-C when the training asks for the given time whether to stop."""
    asked, stopped = [], Interrupt.stopped

    def press(self):
        asked.append(self)
        if len(asked) == count:
            signal.raise_signal(signal.SIGINT)
        return stopped(self)

    monkeypatch.setattr(Interrupt, "stopped", press)


@pytest.mark.parametrize(("text", "inputs"), [(STATIC, ("n", "Load")), (DYNAMIC, ("u",))], ids=["static", "dynamic"])
@pytest.mark.parametrize("count", [2, 5])
def test_ctrl_c_writes_the_best_surrogate_so_far(training, shop, capfd, monkeypatch, text, inputs, count):
    shop.bench("bench.csv", speed=np.linspace(800, 3000, 60))
    path = training(text)
    press_at(monkeypatch, count)
    assert cli.run(["surrogate", "train", str(path)]) == 130
    out, err = capfd.readouterr()
    assert "Press Ctrl-C again to exit without results" in err
    assert "warning: engine.json: the training was stopped; the surrogate is the best so far. Train again." in err
    assert f"Written to {shop.folder / 'engine.json'}" in out
    assert read_surrogate(shop.folder / "engine.json").inputs == inputs


def test_ctrl_c_before_the_training_writes_no_file(training, shop, capsys, monkeypatch):
    path = training(DYNAMIC)
    monkeypatch.setattr(Training, "datasets", lambda *_: signal.raise_signal(signal.SIGINT))
    assert cli.run(["surrogate", "train", str(path)]) == 130
    assert "before there was anything to write" in capsys.readouterr().err
    assert not (shop.folder / "engine.json").exists()


def test_a_quiet_training_has_no_output(training, shop, capsys):
    shop.bench("bench.csv", speed=np.linspace(800, 3000, 60))
    assert cli.run(["surrogate", "train", str(training()), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (shop.folder / "engine.json").is_file()


def test_a_file_that_is_listed_twice_is_reported(training, shop, capsys):
    shop.bench("bench.csv", speed=np.linspace(1000, 3000, 12))
    again = 'files = ["bench.csv"]\n\n[[dataset]]\nname = "again"\nfiles = ["bench.csv"]'
    path = training(STATIC, ('files = ["bench.csv"]', again))
    message = " ".join(problems(path))
    assert "file bench.csv is used 2 times, by bench, again" in message
    assert "12 of 24 training rows repeat the inputs of another row" in message
    assert cli.run(["surrogate", "train", str(path)]) == 0
    printed = " ".join(capsys.readouterr().err.split())
    assert "file bench.csv is used 2 times" in printed
    assert "12 of 24 rows repeat the inputs of another row; they count as one point with less noise" in printed


@pytest.mark.slow
def test_the_surrogate_has_the_number_of_centres_of_the_file(training, shop):
    shop.bench("bench.csv", speed=np.linspace(1000, 3000, 30))
    path = training(STATIC, ("starts = 1", 'starts = 1\ncentres = 7\nkernel = "matern52"'))
    assert cli.run(["surrogate", "train", str(path)]) == 0
    expansion = read_surrogate(shop.folder / "engine.json").expansion
    assert (expansion.size, expansion.kernel) in [(7, "matern52"), (0, "gaussian")]
