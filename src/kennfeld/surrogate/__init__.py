"""Data-driven models: trained on recordings, stored as one readable file, used in a formula like any node."""
