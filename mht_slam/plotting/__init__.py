"""Matplotlib figures of cells, maps and comparisons."""
