"""Neural networks and tree ensembles of ONNX files, as functions and models."""
