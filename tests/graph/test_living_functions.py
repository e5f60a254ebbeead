"""Functions of this process, which no other process has, though it may have one of the same name and number."""

from kennfeld.graph import GraphBuilder, external_function
from kennfeld.graph.external_function import ExternalFunction, living_functions


def graph_nodes(function):
    builder = GraphBuilder()
    builder.external(function, builder.input("x"))
    return builder.nodes


def test_the_same_number_in_another_process_is_another_function(monkeypatch):
    nodes = graph_nodes(ExternalFunction("f", 1, 1, "module:load_living", ("f", 0), batched=True))
    keys = set()
    for process in ("one", "two"):
        monkeypatch.setattr(external_function, "_PROCESS", process)
        keys.add(living_functions(nodes))
    assert len(keys) == 2


def test_a_function_of_a_file_is_the_same_in_all_processes(tmp_path):
    function = ExternalFunction("f", 1, 1, "module:load_from_file", (str(tmp_path / "f.py"), "f", "digest"))
    assert living_functions(graph_nodes(function)) == ()
