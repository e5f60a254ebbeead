"""Lowering of imperative MATLAB code, as in MATLAB Function blocks and Stateflow charts, to graphs.

    context = EvaluationContext(builder, workspace=..., functions={"f": definition}, unknown=hook)
    interpreter = StatementInterpreter(context, {"u": nodes})
    interpreter.run(parse_script(text).statements)
    interpreter.names["y"]

- `EvaluationContext` is shared by all code of a block: the graph, the functions that the code may call, the parameters
  it may name, and the limits on unrolled code.
- `StatementInterpreter` follows one path through code. `names` are its variables: arrays of nodes `Int[rows, columns]`,
  texts, and the classes of `symbolic_values`. Values are immutable, so that they can be kept.
- `run(statements)` follows statements; `value(tree)` and `nodes(tree)` evaluate an expression; `truth(value)` returns
  the node of a condition; `assign(target, value)` sets a variable or a part of it.
- `decide(condition, yes, no)` builds both sides of a decision by `yes()` and `no()`; the variables of both are merged
  by `select`. Conditions known on a path are not evaluated again (`path_facts`).
- `call(function, arguments, wanted)` runs a `FunctionDefinition` with variables of its own.
- `context.unknown(interpreter, name, argument_trees, wanted)` handles functions that neither the code nor the library
  has: it evaluates the arguments by `interpreter.value`, may change `names`, and returns the results, or None.
- `persistent` variables are in `state.kept` by (function, name): set them before and read them after the run. `global`
  variables are there by ("global", name); the host provides them.
- `ProgramError`, with the line, is raised for code that a graph cannot express.

The functions of the library are in `library/`, by family.
"""
