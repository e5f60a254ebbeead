"""Files that run with the modules beside them."""

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model


def test_each_print_of_a_called_function_prints_once_and_to_standard_error(tmp_path, capsys):
    (tmp_path / "beside.py").write_text("def passed_on(x):\n    print('beside', x)\n    return x\n")
    (tmp_path / "f.py").write_text(
        "import sys\nfrom beside import passed_on\nprint('loaded')\n"
        "def f(x):\n    print('called', x, sep='=')\n    return passed_on(x) + {0: 1.0}[0]\n"
    )
    model = as_model(read_function_file("f.py:f", tmp_path))
    values = evaluate(model.graph, {"x": np.array([1.0, 2.0, 3.0])}, ParameterSet())["f"]
    assert values.tolist() == [2.0, 3.0, 4.0]
    output = capsys.readouterr()
    assert output.out == ""
    assert [line.partition("=")[0].split()[0] for line in output.err.splitlines()] == ["loaded", "called", "beside"]
