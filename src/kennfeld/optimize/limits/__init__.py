"""What values and outputs must keep."""
