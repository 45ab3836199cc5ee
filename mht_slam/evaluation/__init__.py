"""Metrics, baselines and significance: how results are judged."""
