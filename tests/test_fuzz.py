"""The script that damages files: it reads every kind, says what it did, and finds what is wrong."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "scripts" / "fuzz.py"


def run(*arguments, **environment):
    command = [sys.executable, str(SCRIPT), "--workers", "1", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | environment, timeout=300, check=False
    )
    return done.returncode, done.stdout.strip().splitlines()


def test_damaged_files_of_every_kind_end_in_data_or_findings():
    status, lines = run("--count", "300", "--seed", "7")
    assert lines[-1].startswith("seed 7: 300 damaged files, 0 failures"), "\n".join(lines)
    assert status == 0


def test_damaged_networks_end_in_a_network_or_one_message():
    pytest.importorskip("onnx", reason="the package onnx is not installed")
    status, lines = run("--count", "40", "--seed", "3", "--kinds", "network .onnx")
    assert lines[-1].startswith("seed 3: 40 damaged files, 0 failures"), "\n".join(lines)
    assert status == 0


def test_one_file_can_be_made_again(tmp_path):
    made = []
    for name in "ab":
        status, lines = run("--only", "12", "--keep", str(tmp_path / name))
        assert status == 0
        made.append(Path(lines[0].split(": ")[1]).read_bytes())
    assert made[0] == made[1]


def test_a_crash_is_a_failure_and_does_not_end_the_run(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import sys, os\n"
        "if 'fuzz' in ' '.join(sys.orig_argv) or 'spawn' in ' '.join(sys.orig_argv):\n"
        "    import kennfeld.calfiles.dcm.lines as lines\n"
        "    real = lines.split_blocks\n"
        "    def split(text, notes):\n"
        "        if 'KENNFELD' not in text:\n"
        "            os._exit(11)\n"
        "        return real(text, notes)\n"
        "    import kennfeld.calfiles.dcm.reader as reader\n"
        "    reader.split_blocks = split\n"
    )
    status, lines = run("--count", "12", "--kinds", "calibration .dcm", PYTHONPATH=str(tmp_path))
    assert status == 1
    assert any("crash, exit status 11" in line for line in lines)
    assert "12 damaged files" in lines[-1]
