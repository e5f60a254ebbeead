"""Import of Simulink files (`.slx`, `.mdl`, `.sldd`) without MATLAB; no code of a file is ever executed.

Stages, from the bottom up: `reader` parses a file into a tree of systems, blocks and lines; `variables` collects values
from workspaces, dictionaries and scripts; `expressions` evaluates block fields on graph nodes; `flattening` dissolves
subsystems; `lowering` turns flat blocks into graph nodes by the block handlers in `blocks`; `matlab_function` and
`stateflow` lower code and charts; `importing` is the public entry.
"""
