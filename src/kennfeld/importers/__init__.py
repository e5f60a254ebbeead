"""Models of other tools: Simulink, ASCET, C, Python, FMU, ONNX."""
