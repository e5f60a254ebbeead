"""MSQ, the tunes of TunerStudio."""
