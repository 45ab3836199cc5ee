"""The research bench: every method on the same scenes, users' own among them."""
