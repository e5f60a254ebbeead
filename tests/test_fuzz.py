"""The script that damages files: it reads every kind, says what it did, and finds what is wrong."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz import Campaign, main, put, read
from fuzz_models import stored_networks
from fuzz_sample import Sample
from fuzz_samples import CORE, GUESTS

SCRIPT = Path(__file__).parents[1] / "scripts" / "fuzz.py"
GAIN, SPEED = (
    f"KONSERVIERUNG_FORMAT 2.0\n\n{block}\nEND\n".encode()
    for block in ("FESTWERT Gain\n   WERT 12.5", "STUETZSTELLENVERTEILUNG Speed 2\n   ST/X 700 1000")
)
SAMPLES = [Sample("calibration .dcm", "a.dcm", {"a.dcm": content}) for content in (GAIN, SPEED)]


def run(*arguments):
    command = [sys.executable, str(SCRIPT), "--workers", "1", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    return done.returncode, done.stdout.strip().splitlines()


@pytest.mark.parametrize(
    "maker",
    [*CORE, *(pytest.param(maker, marks=pytest.mark.guests) for maker in GUESTS)],
    ids=lambda maker: maker.__name__.strip("_"),
)
def test_a_damaged_file_of_every_kind_ends_in_data_or_findings(maker, tmp_path):
    samples = list(maker(12))
    for number in range(len({sample.kind for sample in samples})):
        _, path = put(samples, 12, number, tmp_path / str(number))
        read(path)


@pytest.mark.slow
def test_many_damaged_files_of_every_kind_end_in_data_or_findings():
    status, lines = run("--count", "100", "--seed", "7")
    assert lines[-1].startswith("seed 7: 100 damaged files, 0 failures"), "\n".join(lines)
    assert status == 0


@pytest.mark.guests
def test_damaged_networks_end_in_a_network_or_one_message(tmp_path):
    pytest.importorskip("onnx", reason="the package onnx is not installed")
    networks = list(stored_networks(3))
    for number in range(15):
        _, path = put(networks, 3, number, tmp_path / str(number))
        read(path)


def test_one_file_is_kept_and_read(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("fuzz.samples", lambda *_: SAMPLES)
    assert main(["--only", "12", "--keep", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert Path(lines[0].split(": ")[1]).parent == tmp_path
    assert lines[1] in ("read", "refused")


def test_the_script_starts_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    status, lines = run("--help")
    assert (status, lines[0][:14]) == (0, "usage: fuzz.py")


@pytest.mark.slow
def test_another_process_makes_the_same_file_again(tmp_path):
    contents = []
    for name in "ab":
        status, lines = run("--only", "12", "--keep", str(tmp_path / name))
        assert status == 0
        contents.append(Path(lines[0].split(": ")[1]).read_bytes())
    assert contents[0] == contents[1]


def test_a_number_makes_the_same_file_again(tmp_path):
    for number in range(20):
        first, second = (put(SAMPLES, 0, number, tmp_path / name)[1].read_bytes() for name in "ab")
        assert first == second


@pytest.mark.slow
def test_a_crash_is_a_failure_and_does_not_end_the_run(tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(
        "import sys, os\n"
        "if 'spawn' in ' '.join(sys.orig_argv):\n"
        "    import kennfeld.calfiles.dcm.lines as lines\n"
        "    real = lines.split_blocks\n"
        "    def split(text, notes):\n"
        "        if 'FESTWERT' in text:\n"
        "            os._exit(11)\n"
        "        return real(text, notes)\n"
        "    import kennfeld.calfiles.dcm.reader as reader\n"
        "    reader.split_blocks = split\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    files = {number: put(SAMPLES, 0, number, tmp_path / str(number))[1].read_bytes() for number in range(9)}
    crashing = [number for number, content in files.items() if b"FESTWERT" in content]
    assert 0 < len(crashing) < 5
    [outcome] = Campaign(0, 9, 1, SAMPLES).run().values()
    assert outcome.files == 9
    assert outcome.failures == [(number, "crash, exit status 11") for number in crashing]
