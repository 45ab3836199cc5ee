"""Evidence by integration: exact for three scans, and what other evidence is made of."""
