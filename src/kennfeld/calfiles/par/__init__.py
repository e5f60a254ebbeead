"""Parameter files of CANape (`.par`)."""
