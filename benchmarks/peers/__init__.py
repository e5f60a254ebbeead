"""Other solvers on the torque problem, one a file, each a function that `benchmarks.measure.apart` can call."""
