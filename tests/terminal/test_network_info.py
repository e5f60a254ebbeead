"""`kennfeld info` of ONNX networks."""

import json

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from onnx import helper

from kennfeld.cli import run
from tests.importers.onnx.networks import perceptron, random_layers, save

pytestmark = pytest.mark.guests


def test_info_shows_inputs_outputs_layers_and_operators(tmp_path, capsys):
    path = perceptron(tmp_path / "net.onnx", random_layers([4, 8, 1], kind=np.float32), kind=np.float32)
    assert run(["info", str(path)]) == 0
    text = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert lines[0] == "net.onnx: ONNX network, 3 operators, 49 constants"
    assert "x 1 x 4 float32 x[0] ... x[3]" in lines
    assert "layer1 4 8 40" in lines
    assert "Gemm 2" in lines
    assert "computed in double" in text


def test_info_names_unsupported_operators(tmp_path, capsys):
    path = save(tmp_path / "net.onnx", [helper.make_node("Det", ["x"], ["y"])], {"x": [1, 1]}, {"y": []})
    assert run(["info", str(path), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["content"] == "network"
    assert content["operators"] == {"Det": 1}
    assert "operator Det is not supported" in content["remarks"][0]


def test_info_of_a_damaged_file_is_one_message(tmp_path, capsys):
    (tmp_path / "net.onnx").write_bytes(b"\x01\x02\x03")
    assert run(["info", str(tmp_path / "net.onnx")]) != 0
    assert "not an ONNX file" in capsys.readouterr().err
