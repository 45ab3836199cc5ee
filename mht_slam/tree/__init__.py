"""The hypothesis tree over the scans of a run: propose, associate, solve, prune."""
