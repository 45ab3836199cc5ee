"""From an association to a GTSAM graph, its estimate, likelihood and Laplace evidence."""
