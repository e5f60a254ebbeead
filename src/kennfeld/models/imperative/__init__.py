"""Code of MATLAB Function blocks, and of whatever else runs statements of MATLAB, as graphs.

    desk = Desk(builder, workspace=..., functions={"f": definition}, unknown=hook)
    body = Body(desk, {"u": nodes})
    body.run(parse_script(text).statements)
    body.names["y"]

- `Desk` (desk.py) is what all code of a block shares: the graph, the functions that the code may call, the parameters
  that it may name, and the budget of everything that is unrolled.
- `Body` (body.py) is one path through code. `body.names` are its variables: arrays of nodes `Int[rows, columns]`,
  texts, `Struct`, `Cells`, `Handle` (values.py). They are replaced, never changed, so that one may keep them.
- `body.run(statements)` follows statements; `body.value(tree)` and `body.nodes(tree)` evaluate an expression;
  `body.truth(value)` is the node of a condition; `body.assign(target, value)` gives a variable or a part of it a value.
- `body.decide(condition, yes, no)` builds both sides of a decision: `yes()` and `no()` run with the same body, whose
  variables are joined by `select` afterwards. What is known of conditions on a path is used: a condition that an outer
  decision has settled is not asked again.
- `body.call(function, arguments, wanted)` runs a `FunctionDefinition` with variables of its own.
- `desk.unknown(body, name, argument_trees, wanted)` is asked for a function that neither the code nor the library has:
  it evaluates the arguments with `body.value`, may change `body.names`, and returns the results, `()` of none, or None.
- `persistent` variables are in `body.state.kept` by (function, name): set it before and read it after the run.
- `global` variables are in `body.state.kept` by ("global", name), where the host puts them.
- Everything raises `CodeError` (errors.py) where a graph cannot follow; it knows the line.

The functions of the library are in functions/, by family.
"""
