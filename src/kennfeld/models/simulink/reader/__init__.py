"""Simulink files: from their bytes, in any layout, to a tree of systems, blocks and lines."""
