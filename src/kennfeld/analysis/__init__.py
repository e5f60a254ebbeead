"""How far a calibration can be trusted."""

from kennfeld.analysis.cross_validation import CrossValidation, FoldQuality, cross_validate, cross_validated

__all__ = ["CrossValidation", "FoldQuality", "cross_validate", "cross_validated"]
