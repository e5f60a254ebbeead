"""Cost, gradient and Gauss-Newton matrix over all samples."""
