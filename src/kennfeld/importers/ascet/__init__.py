"""ASCET models: classes and tasks in ESDL as graphs of one time step."""
