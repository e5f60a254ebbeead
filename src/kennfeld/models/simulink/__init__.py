"""Simulink files (`.slx`, `.mdl`, `.sldd`), read without MATLAB; nothing in a file is ever executed."""
