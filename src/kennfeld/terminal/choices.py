"""What a calibration chose by itself, as lines for a person."""

from kennfeld.optimize import Result

__all__ = ["choices"]


def choices(result: Result) -> list[str]:
    """A line for each table with automatic smoothness, and for each channel whose shift was found."""
    shifts = [
        f"shift of {channel} in {name}: {shift:g}"
        for name, channels in result.shifts.items()
        for channel, shift in channels.items()
    ]
    return [
        *shifts,
        *(
            f"smoothness of {name}: {', '.join(f'{axis} {factor:.3g}' for axis, factor in factors.items())}"
            for name, factors in result.smoothness.items()
        ),
    ]
