"""Reader: Simulink files of any layout parsed to a tree of systems, blocks and lines."""
