"""GTSAM factors of bearing-only geometry, for any GTSAM user."""
