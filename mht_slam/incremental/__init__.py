"""Scan after scan: the multi-hypothesis estimator over one open window and a settled past."""
