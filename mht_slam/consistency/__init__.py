"""Bounded errors: the complete set of associations that one straight path can explain."""
