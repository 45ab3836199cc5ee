"""Readers of public recordings and of our own scan files."""
