"""Simulink files (`.slx`, `.mdl`, `.sldd`), read without MATLAB; nothing in a file is ever executed.

From the ground up: `files` makes a tree of blocks and lines, `variables` finds values, `expressions` puts MATLAB
expressions on the graph, `flattening` dissolves subsystems, `code` follows MATLAB Functions, `weaving` turns blocks
into the graph by the rules in `blocktypes`, `stateflow` follows charts; `importing` makes a model of it all.
"""
