"""Evidence by integration: what Laplace's approximation is held against."""
